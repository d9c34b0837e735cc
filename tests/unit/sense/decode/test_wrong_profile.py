"""Reasons that name what is wrong in a sensor profile: the remedy typed into the profile locates the frame, and foreign frames
keep their reasons."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from math import cos, pi, sin
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pytest

from tactape_fab import Localizer
from tactape_fab.base.templates import templates_folder
from tactape_fab.sense import load_sensor, simulate
from tactape_fab.sense.decode import wrong_profile as module
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.result import SOLID_DOTS
from tactape_fab.sense.decode.rule import GOOD_TRUST, SCALE_ERROR
from tactape_fab.sense.decode.wrong_profile import (
    LEAST_AXIS,
    LEAST_NEAREST,
    LEAST_PITCH,
    LEAST_POWER,
    MOST_NEAREST,
    MOST_PITCH,
    SURE_SHARE,
    _centred,
    _flipped,
    _nearest,
    _pitch,
    _powers,
)
from tactape_fab.texture.frames import FloatArray
from tests.bench.impostors import other_surface, plain_grid, random_bumps, random_symbols
from tests.contacts import CENTRE, DELTA, POSE, TAPE, W, dots, is_near, tape_of

Frame = npt.NDArray[np.float32]
MINI = load_sensor("gelsight-mini")
POSES = [POSE, ((28.0, 14.0), -112.0), ((60.5, 21.3), 7.0)]
REMEDY = re.compile(r"(sign|mirror|px_per_mm) = (\[[^\]]*\]|[-\w.]+)")


def typed(reason: str, path: Path) -> Path:
    """A copy of the profile with what a reason says to set."""
    text = (templates_folder() / "sensors" / "gelsight-mini.toml").read_text(encoding="utf-8")
    remedies = REMEDY.findall(reason[reason.index("set ") :])
    assert remedies, reason
    for key, value in remedies:
        text, count = re.subn(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
        assert count == 1
    path.write_text(text, encoding="utf-8")
    return path


def at_scale(px_per_mm: float, k: int) -> Frame:
    return simulate(TAPE, *POSES[k], sensor=replace(MINI, px_per_mm=(px_per_mm, px_per_mm)), seed=k)


WRONG: list[tuple[str, Callable[[int], Frame], str]] = [
    (
        "sign",
        lambda k: -simulate(TAPE, *POSES[k], seed=k),
        r"the frame's sign is inverted: it shows \S+ with sign = -1; set sign = -1 in",
    ),
    ("height map of gs_sdk, px", lambda k: -15.77 * simulate(TAPE, *POSES[k], seed=k), "set sign = -1 in the sensor profile"),
    (
        "mirror",
        lambda k: simulate(TAPE, *POSES[k], seed=k)[:, ::-1],
        "is mirrored: it shows .* from behind; set mirror = true in",
    ),
    ("sign and mirror", lambda k: -simulate(TAPE, *POSES[k], seed=k)[:, ::-1], "set sign = -1 and mirror = true in"),
    (
        "scale -25 %",
        lambda k: at_scale(11.93, k),
        r"a grid of 1[78]\.\d px was found, W 1.5 mm at the profile's 16 px/mm is 24.0 px; it shows",
    ),
    ("scale +25 %", lambda k: at_scale(20.0, k), r"a grid of (29|30)\.\d px was found, .* set px_per_mm = \[(19.|20)"),
    ("half the size", lambda k: at_scale(8.0, k), r"a grid of (11|12)\.\d px was found, .* set px_per_mm = \[(7.9|8)"),
    ("sign and scale", lambda k: -at_scale(12.8, k), r"set sign = -1 and px_per_mm = \[1[23]\.\d+, 1[23]"),
]


@pytest.mark.parametrize(("make", "words"), [case[1:] for case in WRONG], ids=[case[0] for case in WRONG])
def test_the_remedy_typed_into_the_profile_locates(
    localizer: Localizer, tmp_path: Path, make: Callable[[int], Frame], words: str
) -> None:
    for k, pose in enumerate(POSES):
        frame = make(k)
        fix = localizer.locate(frame)
        assert not fix.located and re.search(words, str(fix.reason)), fix.reason
        put_right = Localizer([TAPE], typed(str(fix.reason), tmp_path / "mine.toml")).locate(frame)
        assert put_right.located and is_near(put_right, *pose), put_right.reason


def test_a_negative_sign_and_a_mirror_are_turned_back(tmp_path: Path) -> None:
    sensor = replace(MINI, sign=-1, mirror=True)
    localizer = Localizer([TAPE], sensor)
    frame = simulate(TAPE, *POSE, sensor=sensor)
    assert "set sign = 1 in the sensor profile" in str(localizer.locate(-frame).reason)
    assert "set mirror = false in the sensor profile" in str(localizer.locate(frame[:, ::-1]).reason)


def test_quarter_turns_are_not_seen_but_in_theta() -> None:
    """docs/localization.md: on a tape that lies straight, rotate90 is too small by theta_deg / 90."""
    square = replace(MINI, width_px=260, height_px=260)
    for missing, theta_deg in enumerate((0.0, 90.0, 180.0, -90.0)):
        frame = simulate(TAPE, POSE[0], 0.0, sensor=replace(square, rotate90=missing))
        assert is_near(Localizer([TAPE], square).locate(frame), POSE[0], theta_deg)


def test_oblong_pixels_stay_oblong() -> None:
    sensor = replace(MINI, px_per_mm=(20.0, 15.0))
    frame = simulate(TAPE, *POSE, sensor=sensor)
    reason = str(Localizer([TAPE], replace(MINI, px_per_mm=(16.0, 12.0))).locate(frame).reason)
    found = re.search(r"px_per_mm = \[([\d.]+), ([\d.]+)\]", reason)
    assert found is not None, reason
    assert (float(found[1]), float(found[2])) == pytest.approx((20.0, 15.0), rel=0.01)


@pytest.mark.parametrize("pitch_mm", [1.3, 1.7, 1.8, 1.85])
def test_a_tape_of_another_pitch_is_not_located(localizer: Localizer, pitch_mm: float) -> None:
    """Symbols say nothing of a pitch: it would be the registered tape at another scale, with places off by millimetres."""
    sensor = localizer.sensor
    other = replace(TAPE, pitch_mm=pitch_mm, displacement_mm=pitch_mm / 6)
    for k in range(3):
        depth = simulate(other, ((20.0 + 3.0 * k) * pitch_mm / W, 15.0), 30.0 + 20.0 * k, sensor=sensor, seed=k)
        found = localizer.locate(depth)
        named = re.search(r"or name a tape of W ([\d.]+) mm", str(found.reason))
        assert not found.located and named and float(named[1]) == pytest.approx(pitch_mm, rel=0.04), found.reason


@pytest.mark.parametrize("off", [-0.08, 0.08])
def test_a_scale_somewhat_beyond_the_tolerance_is_still_located(localizer: Localizer, off: float) -> None:
    sensor = localizer.sensor
    assert sensor.scale_tolerance < abs(off) < sensor.scale_tolerance + SCALE_ERROR
    u, v = sensor.px_per_mm
    depth = simulate(TAPE, (20.0, 15.0), 30.0, sensor=replace(sensor, px_per_mm=(u * (1.0 + off), v * (1.0 + off))), seed=1)
    found = localizer.locate(depth)
    assert found.located and found.px_per_mm == pytest.approx(u * (1.0 + off), rel=0.005)


def test_a_fixed_scale_that_is_off_is_named() -> None:
    reason = str(Localizer([TAPE], fixed_scale=True).locate(at_scale(17.6, 0)).reason)
    assert "set px_per_mm = [17." in reason, reason


def test_a_noisy_tape_with_scattered_parts_is_named_on_its_grid(localizer: Localizer) -> None:
    sensor = replace(MINI, px_per_mm=(12.8, 12.8))
    for k, pose in enumerate(POSES):
        reason = str(localizer.locate(simulate(TAPE, *pose, sensor=sensor, seed=k, noise=2.0, placement_mm=0.05)).reason)
        assert f"it shows {TAPE.name} at another scale" in reason, reason


def test_dots_alone_show_scale_and_mirror(localizer: Localizer) -> None:
    assert "set px_per_mm = [11.9, 11.9]" in str(localizer.locate_dots(dots(px_per_mm=11.9)).reason)
    assert "set mirror = true" in str(localizer.locate_dots((dots() - CENTRE) * (-1.0, 1.0) + CENTRE).reason)


def test_a_code_alone_names_its_sector() -> None:
    localizer = Localizer.from_code(TAPE.code, W, DELTA)
    frame = simulate(TAPE, *POSE, contact_mm=(15.0, 13.0))
    assert localizer.locate(frame).located
    assert "it shows sector 7 with sign = -1" in str(localizer.locate(-frame).reason)


def test_dots_of_no_tape_on_another_grid_have_its_pitch_named(localizer: Localizer) -> None:
    frame = simulate(TAPE, *POSE, sensor=replace(MINI, px_per_mm=(12.0, 12.0)), parts=random_symbols(TAPE))
    reason = str(localizer.locate(frame).reason)
    found = re.search(
        r"a grid of (\S+) px was found, W 1.5 mm at the profile's 16 px/mm is 24.0 px; set px_per_mm = \[(\S+), ", reason
    )
    assert found is not None, reason
    assert (float(found[1]), float(found[2])) == pytest.approx((18.0, 12.0), rel=0.03)
    assert re.search(r"in the sensor profile, or name a tape of W 1\.1\d mm if it is one$", reason), reason


def smooth(sigma_px: float, seed: int) -> Frame:
    """Noise that is smooth over some pixels."""
    cycles = np.hypot(np.fft.fftfreq(240)[:, None], np.fft.rfftfreq(320))
    noise = np.fft.rfft2(np.random.default_rng(seed).normal(size=(240, 320)))
    return np.fft.irfft2(noise * np.exp(-2.0 * (np.pi * sigma_px * cycles) ** 2), (240, 320)).astype(np.float32)


def surface(kind: Literal["blank", "ball", "ridges"]) -> Callable[[int], Frame]:
    return lambda k: other_surface(kind, seed=k)


FOREIGN: dict[str, Callable[[int], Frame]] = {
    "another tape": lambda k: simulate(tape_of(3, (100, 50)), *POSES[k % 3], seed=k),
    "random symbols": lambda k: simulate(TAPE, *POSES[k % 3], seed=k, parts=random_symbols(TAPE, k)),
    "a plain grid": lambda k: simulate(TAPE, *POSES[k % 3], seed=k, parts=plain_grid(TAPE)),
    "a plain grid of another pitch": lambda k: simulate(
        TAPE, *POSES[k % 3], seed=k, parts=plain_grid(TAPE), sensor=replace(MINI, px_per_mm=(12.0, 12.0))
    ),
    "random bumps": lambda k: simulate(TAPE, *POSES[k % 3], seed=k, parts=random_bumps(TAPE, k)),
    "blank": surface("blank"),
    "ball": surface("ball"),
    "ridges": surface("ridges"),
    "white noise": lambda k: smooth(0.0, k),
    "smooth noise": lambda k: smooth(4.0, k),
    "smoother noise": lambda k: smooth(10.0, k),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_foreign_frames_keep_their_reasons(localizer: Localizer, name: str) -> None:
    for k in range(9):
        for sign in (1, -1):
            fix = localizer.locate(sign * FOREIGN[name](k))
            assert not fix.located
            assert re.match(
                "the dots stand on no grid|may be no tape of ours|no dot|only |looks like|too few", str(fix.reason)
            ), fix.reason


def test_small_contacts_keep_their_reasons(localizer: Localizer) -> None:
    """Contacts that are too small to be located show a grid, and it is the profile's."""
    reasons = [
        str(localizer.locate(simulate(TAPE, (20.0 + k, 15.0), 13.0 * k, seed=k, contact_mm=(6.0, 5.5))).reason) for k in range(20)
    ]
    assert any(reason != "None" for reason in reasons)
    assert not any("set " in reason for reason in reasons), reasons


# The steps, by dots put together by hand


def seen_at(shift: float = 1 / 6) -> Any:
    return SimpleNamespace(view=SimpleNamespace(pitch_px=20.0, shift=shift, centre_px=np.array([150.0, 110.0])))


def some_dots(count: int, trust: float = 1.0) -> Dots:
    xy = np.stack(np.divmod(np.arange(count, dtype=np.float64), 5.0), axis=1) * 20.0
    return Dots(xy_px=xy, weights=np.ones(count), trust=np.full(count, trust))


def test_dots_are_mirrored_about_the_image_s_centre() -> None:
    raw = Dots(xy_px=np.array([(140.0, 7.0), (150.0, 8.0)]), weights=np.ones(2), trust=np.ones(2))
    assert _flipped(seen_at(), raw).xy_px.tolist() == [[160.0, 7.0], [150.0, 8.0]]


def test_low_and_doubtful_dots_say_less_of_a_grid_and_high_ones_no_more() -> None:
    xy = np.array([(0.0, 0.0), (10.0, 0.0), (40.0, 8.0)])
    raw = Dots(xy_px=xy, weights=np.array([3.0, 0.25, 1.0]), trust=np.array([1.0, 1.0, 0.5]))
    about, strength = _centred(raw)
    assert strength.tolist() == [1.0, 0.25, 0.5] and about == pytest.approx(xy - (30.0 / 2.5, 4.0 / 2.5))


def test_the_nearest_of_dots_is_another_one() -> None:
    assert _nearest(np.array([(0.0, 0.0), (3.0, 4.0), (3.0, 10.0)])) == 5.0


def test_a_perfect_grid_has_all_the_power_and_ridges_have_it_at_one_axis() -> None:
    angle, pitch = 0.3, 7.0
    c, s = cos(angle), sin(angle)
    rows, columns = (a.ravel() for a in np.indices((5, 4)))
    grid = pitch * np.stack([c * columns - s * rows, s * columns + c * rows], axis=1)
    assert _powers(grid, np.full(20, 0.5), angle, pitch) == pytest.approx((1.0, 1.0))
    along = grid + np.outer(np.linspace(0.0, 4.0 * pitch, 20, endpoint=False), (-s, c))
    first, second = _powers(along, np.ones(20), angle, pitch)
    assert first == pytest.approx(1.0) and second < 0.5


def test_the_power_of_dots_off_a_grid_is_that_of_their_waves_sum() -> None:
    """Two dots a third of the pitch apart: |1 + exp(2 pi i / 3)|^2 / 4 = 1/4."""
    assert _powers(np.array([(0.0, 0.0), (4.0, 0.0)]), np.ones(2), 0.0, 12.0) == pytest.approx((0.25, 1.0))


def pitch_of(
    monkeypatch: pytest.MonkeyPatch,
    lattices: list[tuple[float, float]],
    *,
    nearest: float = 0.9,
    powers: tuple[float, float] = (0.9, 0.9),
    dots: Dots | None = None,
    shift: float = 1 / 6,
) -> tuple[float | None, list[tuple[Any, ...]]]:
    """The pitch that is found where these (pitch, power) are the grids, and how they were asked for."""
    asked: list[tuple[Any, ...]] = []

    def find(xy: FloatArray, strength: FloatArray, *of: Any) -> FloatArray:
        asked.append(of)
        return np.array([(0.1, pitch, 0.0, 0.0, power) for pitch, power in lattices]).reshape(-1, 5)

    monkeypatch.setattr(module, "find_lattices", find)
    monkeypatch.setattr(module, "_nearest", lambda xy: nearest)
    monkeypatch.setattr(module, "_powers", lambda *_: powers)
    return _pitch(seen_at(shift), some_dots(SOLID_DOTS) if dots is None else dots), asked


def test_grids_are_looked_for_within_the_pitches_that_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    _, ((middle_px, share, most),) = pitch_of(monkeypatch, [])
    assert middle_px * (1.0 - share) == pytest.approx(LEAST_PITCH * 20.0)
    assert middle_px * (1.0 + share) == pytest.approx(MOST_PITCH * 20.0) and most == module.MOST_GRIDS


def test_a_grid_needs_as_many_trusted_dots_as_a_solid_contact(monkeypatch: pytest.MonkeyPatch) -> None:
    for count, trust, found in (
        (SOLID_DOTS, 1.0, 1.0),
        (SOLID_DOTS - 1, 1.0, None),
        (SOLID_DOTS, GOOD_TRUST, None),
        (SOLID_DOTS, GOOD_TRUST + 1e-9, 1.0),
    ):
        assert pitch_of(monkeypatch, [(1.0, 0.9)], dots=some_dots(count, trust))[0] == found


def test_a_grid_needs_its_share_of_the_power_that_displaced_dots_keep(monkeypatch: pytest.MonkeyPatch) -> None:
    for shift in (1 / 6, 1 / 12):
        least = max(SURE_SHARE * ((1.0 + cos(2.0 * pi * shift)) / 2.0) ** 2, LEAST_POWER)
        for power, found in ((least + 1e-9, 1.0), (least - 1e-9, None)):
            assert pitch_of(monkeypatch, [(1.0, power)], shift=shift)[0] == found


def test_the_grid_of_most_power_is_the_one_that_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert pitch_of(monkeypatch, [(1.0, 0.7), (1.1, 0.9), (0.9, 0.8)])[0] == 1.1


def test_dots_of_a_grid_are_a_pitch_apart_and_show_both_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    for nearest, found in (
        (LEAST_NEAREST, 1.0),
        (LEAST_NEAREST - 1e-9, None),
        (MOST_NEAREST, 1.0),
        (MOST_NEAREST + 1e-9, None),
    ):
        assert pitch_of(monkeypatch, [(1.0, 0.9)], nearest=nearest)[0] == found
    for powers, found in (((0.9, LEAST_AXIS), 1.0), ((0.9, LEAST_AXIS - 1e-9), None), ((LEAST_AXIS - 1e-9, 0.9), None)):
        assert pitch_of(monkeypatch, [(1.0, 0.9)], powers=powers)[0] == found
    # the next grid is taken where the first one's dots are not a pitch apart
    assert pitch_of(monkeypatch, [(2.0, 0.95), (1.0, 0.9)], nearest=1.0)[0] == 1.0
