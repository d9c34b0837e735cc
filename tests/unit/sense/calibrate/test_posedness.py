"""Frames as they are read, and figures of remarks, against all pairs."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab.base.errors import FrameError, SpecError
from tactape_fab.sense.calibrate import posedness
from tactape_fab.sense.calibrate.adjust import Bundle
from tactape_fab.sense.calibrate.camera import parameters
from tactape_fab.sense.calibrate.errors import Errors
from tactape_fab.sense.calibrate.noise import Noise
from tactape_fab.sense.calibrate.posedness import (
    LEAST_PRESSES,
    _listed,
    _spread,
    checked_frames,
    corner_sigma_um,
    empty_corners,
    frame_fault,
    refuse_few,
    refuse_unspread,
    remarks_of,
    share_of_perfect,
    unseen,
    without_repeats,
)
from tactape_fab.sense.calibrate.presses import Press
from tactape_fab.sense.calibrate.result import HeldOut
from tactape_fab.sense.decode.result import SOLID_DOTS
from tactape_fab.sense.geometry import Geometry
from tactape_fab.texture.frames import BoolArray
from tests.unit.sense.calibrate.sensors import STOCK, TAPE

NOISE_FRAME = np.random.default_rng(1).random((20, 30)).astype(np.float32)


@pytest.mark.parametrize("turns_deg", [(0, 0, 0, 20), (170, -170, 175, -5), (89, -89, 90, 91), (45,)])
def test_the_spread_of_turns_is_the_largest_difference_of_two(turns_deg: tuple[float, ...]) -> None:
    apart = [abs((a - b + 90) % 180 - 90) for a in turns_deg for b in turns_deg]
    assert np.degrees(_spread(np.radians(turns_deg))) == pytest.approx(max(apart))


def test_masked_depth_is_a_hole() -> None:
    depth = np.arange(400.0).reshape(20, 20)
    hidden = depth % 7 == 0
    (image,), bad = checked_frames([np.ma.array(np.where(hidden, -9999.0, depth), mask=hidden)])
    np.testing.assert_array_equal(image, np.where(hidden, np.nan, depth))
    assert image.dtype == np.float32 and bad == []


def holed(count: int) -> np.ndarray:
    """A frame with so many of its 600 pixels NaN."""
    out = NOISE_FRAME.copy()
    out.flat[:count] = np.nan
    return out


@pytest.mark.parametrize(
    ("frame", "fault"),
    [
        (NOISE_FRAME, None),
        (holed(300), None),
        (holed(330), "is NaN or infinite in 55 % of its pixels"),
        (holed(600), "is NaN or infinite in every pixel"),
        (np.where(holed(200) > 0.0, np.float32(2.5), np.nan), "is constant: 2.5 in every pixel"),
    ],
)
def test_a_frame_s_own_fault_is_named(frame: np.ndarray, fault: str | None) -> None:
    assert frame_fault(frame) == fault
    images, bad = checked_frames([NOISE_FRAME, frame])
    assert len(images) == 2 and bad == ([] if fault is None else [f"frame 1 {fault}"])


def test_frames_that_are_none_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SpecError, match="frame 1 is 20 x 31 px, the others are 20 x 30"):
        checked_frames([NOISE_FRAME, np.zeros((20, 31))])
    with pytest.raises(SpecError, match="there are no frames"):
        checked_frames([])
    with pytest.raises(SpecError, match="no frame shows anything: frame 0 is constant: 0 in every pixel"):
        checked_frames([np.zeros((16, 16))])
    for wrong in (
        np.zeros((15, 16)),
        np.zeros((16, 15)),
        np.zeros(99),
        np.full((16, 16), "x"),
        np.zeros((16, 16), dtype=complex),
    ):
        with pytest.raises(FrameError, match="frame 0 is no depth map: shape"):
            checked_frames([wrong])
    assert checked_frames([NOISE_FRAME[:16, :16]])[1] == []
    monkeypatch.setattr(posedness, "MOST_FRAMES", 2)
    assert len(checked_frames([NOISE_FRAME] * 2)[0]) == 2
    with pytest.raises(SpecError, match="there are more than 2 frames"):
        checked_frames([NOISE_FRAME] * 3)


def test_frames_that_are_there_again_are_emptied_and_said() -> None:
    a, b = NOISE_FRAME, NOISE_FRAME[::-1].copy()
    assert without_repeats([a, b])[1] == []
    kept, said = without_repeats([a, b, b, a])
    assert [bool(np.isnan(image).all()) for image in kept] == [False, False, True, True] and kept[1] is b
    assert said == ["2 frames are earlier ones again, value by value (frame 2 is frame 1); what is there twice counts once"]
    assert without_repeats([a, a])[1][0].startswith("1 frame is an earlier one again, value by value (frame 1 is frame 0)")


def press_at(*px: tuple[float, float], theta: float = 0.0) -> Press:
    n, none = len(px), np.zeros((len(px), 2))
    return Press(
        frame=0,
        tape="t",
        seen_px=np.array(px, dtype=float).reshape(-1, 2),
        rim_mm=none,
        texture_mm=none,
        weights=np.ones(n),
        interior=np.ones(n, dtype=bool),
        pushed=none,
        pulled=none,
        position_mm=(0.0, 0.0),
        theta_rad=theta,
    )


def fix(reason: str | None = None) -> Any:
    return SimpleNamespace(located=reason is None, reason=reason)


def test_too_few_presses_are_refused_with_the_commonest_reason() -> None:
    one = press_at((1.0, 2.0))
    refuse_few([one] * LEAST_PRESSES)
    with pytest.raises(SpecError, match=r"only 5 presses can be used, and a calibration needs 6; press the tape some ten times"):
        refuse_few([one] * 5)
    answers = [fix(), fix("few dots"), fix("no grid"), fix("few dots"), fix("it is empty")]
    with pytest.raises(SpecError, match=r"only 1 press of 5 frames \(few dots, mostly\) can be used.*; frame 4 is constant$"):
        refuse_few([one], answers, [True, True, True, True, False], ["frame 4 is constant"])
    with pytest.raises(SpecError, match=r"at least once; frame 5 is so; frame 6 is so; frame 7 is so$"):
        refuse_few([one], bad=[f"frame {k} is so" for k in range(5, 9)])


def test_why_no_frame_shows_a_tape_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def said(*answers: tuple[str | None, int], bad: int = 0) -> tuple[str, str]:
        fixes = [SimpleNamespace(reason=reason, n_dots=n_dots) for reason, n_dots in answers]
        monkeypatch.setattr(posedness, "Localizer", lambda *_, **__: SimpleNamespace(locate=fixes.__getitem__))
        images: Any = range(len(answers))
        found = unseen(images, [f"frame {k} is so" for k in range(bad)], [TAPE], STOCK)
        return found.key, found.message

    other = "looks like sector 8 of a tape that is not registered"
    key, named = said(("few dots", 3), (other, 40), ("few dots", 3))
    assert (key, named) == ("tape", f"the frames show another tape: it {other}; give its kit")
    key, few = said(("no grid", 2), (None, SOLID_DOTS - 1), bad=4)
    assert key == "frames" and few.startswith("tape-7 is not seen in any of 2 frames")
    assert few.endswith(
        f"at most {SOLID_DOTS - 1} dots; press harder, or flatter, until the parts show as dots; "
        "frame 0 is so; frame 1 is so; frame 2 is so"
    )
    _, many = said(("no grid", SOLID_DOTS), ("few dots", 2), ("no grid", 9))
    assert f"though there are up to {SOLID_DOTS} dots (no grid); check that it is the tape" in many and many.endswith("colour")


def test_corners_of_the_image_without_a_dot_are_named() -> None:
    u, v = np.array(STOCK.centre_px)
    assert empty_corners([press_at((1.51 * u, 1.51 * v), (0.4 * u, 0.4 * v))], STOCK) == ["upper right", "lower left"]
    assert empty_corners([press_at((1.51 * u, 1.49 * v)), press_at((1.6 * u, 0.4 * v))], STOCK) == [
        *("upper left", "lower left", "lower right"),
    ]
    assert _listed(["upper left"]) == "upper left corner"
    assert _listed(["upper left", "upper right", "lower left"]) == "upper left, upper right and lower left corners"


def bundle_of(count: int = 4, anew: float = 1.0) -> Bundle:
    """An adjustment whose presses are located `anew` times as variably by the camera of the others as by a perfect one."""
    alone = np.tile(np.diag([1.0, 3.0, 50.0, 9.0]), (count, 1, 1))
    none = np.empty(0)
    return Bundle(
        sensor=STOCK,
        values=none,
        covariance=none,
        free=none > 0.0,
        push_mm=0.0,
        poses=np.zeros((count, 4)),
        poses_alone=alone,
        poses_anew=alone * np.array([anew, anew, 1.0, 1.0])[:, None],
        residual_mm=(),
        errors=Errors(),
    )


def test_the_share_of_a_perfect_camera_is_that_of_all_presses() -> None:
    # of the variance that the camera of n - 1 presses adds, (n - 1) / n are there with n
    assert share_of_perfect(bundle_of(4, 1.4)) == pytest.approx(np.sqrt(1.0 + 0.4 * 3 / 4))
    assert share_of_perfect(bundle_of(10, 1.0)) == 1.0


def test_the_camera_s_error_is_that_of_what_the_mask_shows() -> None:
    """Of a scale that is known to a thousandth, that of the place farthest from the middle, along one of two axes."""
    u, v = np.meshgrid(np.arange(STOCK.width_px), np.arange(STOCK.height_px))
    right_px, down_px = u - STOCK.centre_px[0], v - STOCK.centre_px[1]

    def farthest_px(mask: BoolArray | None, geometry: Geometry = STOCK.geometry) -> float:
        sensor = replace(STOCK, mask=mask, geometry=geometry)
        bundle = replace(bundle_of(), sensor=sensor, values=parameters(sensor), covariance=np.diag([1e-6, 0, 0, 0, 0, 0]))
        return float(corner_sigma_um(bundle) * np.sqrt(2.0) * STOCK.px_per_mm[0])

    corner_px = np.hypot(*STOCK.centre_px)
    assert farthest_px(None) == farthest_px(down_px > -500.0) == pytest.approx(corner_px, rel=1e-6)
    # of places on a grid of eighths of the image
    assert farthest_px((np.abs(right_px) < 50.0) & (down_px > 60.0)) == pytest.approx(np.hypot(39.9, 119.5), rel=1e-3)
    # a mask that shows none of these
    assert farthest_px(down_px > 500.0) == farthest_px(None)
    # the middle is the pose's, also where the lens has another
    assert farthest_px(np.hypot(right_px, down_px) < 1.0, Geometry(k1=0.03, center_px=(170.0, 110.0))) < 1.0


@pytest.mark.parametrize(
    ("corners", "corner_um", "says"),
    [
        (4, 999.0, None),
        (3, 50.0, None),
        (
            3,
            51.0,
            "no contact reaches the lower right corner of the image: the camera is known to 51 um at the edge of the image, and",
        ),
        (0, 25.0, None),
        (
            0,
            26.0,
            "all contacts are in the middle of the image: the camera is known to 26 um at the edge of the image, and 25 um are",
        ),
    ],
)
def test_presses_that_leave_the_camera_open_are_refused(corners: int, corner_um: float, says: str | None) -> None:
    u, v = STOCK.centre_px.tolist()
    at = [(0.2 * u, 0.2 * v), (1.8 * u, 0.2 * v), (0.2 * u, 1.8 * v), (1.8 * u, 1.8 * v)][:corners]
    presses = [press_at((u, v), *at)]
    if says is None:
        refuse_unspread(presses, bundle_of(), corner_um)
    else:
        with pytest.raises(SpecError, match=says):
            refuse_unspread(presses, bundle_of(), corner_um)


def test_remarks_say_what_is_not_known_and_no_more() -> None:
    quiet = Noise(slope=0.01, white_um=1.0, sigma_slope=0.001, sigma_white_um=0.1, patches=3)
    presses = [press_at((10.0, 10.0), (310.0, 230.0), theta=theta) for theta in (0.0, 0.8, 1.6, 2.4)]
    held = HeldOut(inside_um=5.0, outside_um=7.4, folds=4)
    usual: dict[str, Any] = {
        "presses": presses,
        "bundle": bundle_of(4, 1.0),
        "start": STOCK,
        "frame_shape": STOCK.frame_shape,
        "turn_known": True,
        "corner_um": 15.0,
        "held_out": held,
        "noise": quiet,
        "bad": [],
        "hand_eye": None,
    }
    assert remarks_of(**usual) == []
    # 1.15 as is aimed at, to the figures that are shown
    assert remarks_of(**{**usual, "bundle": bundle_of(4, 1.0 + (1.154**2 - 1.0) * 4 / 3)}) == []
    changes: list[tuple[dict[str, Any], list[str]]] = [
        ({"bad": [f"frame {k} is bad" for k in range(7)]}, [f"frame {k} is bad" for k in range(5)]),
        ({"frame_shape": (120, 160)}, ["frames are 120 x 160 px (height x width), those of 'gelsight-mini' 240 x 320"]),
        ({"turn_known": False}, ["quarter turns of the image cannot be told from presses: rotate90 = 0"]),
        (
            {"bundle": bundle_of(4, 1.0 + (1.3**2 - 1.0) * 4 / 3)},
            [
                "by the covariance of the presses, positions are expected to err 1.30 times as far (rms, no median) as by a "
                "perfect camera; with 9 presses in all"
            ],
        ),
        (
            {"corner_um": 15.1},
            ["the camera is known to 15 um at the edge of the image: presses at the upper right and lower left corners"],
        ),
        (
            {"presses": [replace(press, theta_rad=t) for press, t in zip(presses, (0.1, 3.3, 0.2, 0.1), strict=True)]},
            ["all presses are turned alike, within 6 deg"],
        ),
        ({"held_out": replace(held, outside_um=7.6)}, ["presses that were left out fit worse, 7.6 um against 5.0"]),
        ({"noise": None}, ["no part of any frame is off contact"]),
        ({"noise": replace(quiet, patches=0)}, ["no part of any frame is off contact"]),
        ({"noise": replace(quiet, slope=1.5)}, ["slopes have a noise of 1.5 rms a pixel, and depths one of 1 um, too much"]),
        ({"hand_eye": SimpleNamespace(remarks=["of the arm"])}, ["of the arm"]),
    ]
    for change, says in changes:
        found = remarks_of(**{**usual, **change})
        assert len(found) == len(says) and all(a.startswith(b) for a, b in zip(found, says, strict=True)), found
    without = replace(STOCK, depth_unit_mm=None)
    found = remarks_of(**{**usual, "bundle": replace(bundle_of(), sensor=without)})
    assert found == ["'gelsight-mini' says no unit of the depth: amplitude and noise are in the frame's unit"]
