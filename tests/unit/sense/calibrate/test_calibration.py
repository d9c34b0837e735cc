"""Calibration from presses: the truth within what is said, whatever the start; everything that presses cannot say is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from tactape_fab import FrameError, Localizer, SpecError
from tactape_fab.sense import ArmPose, Calibration, SensorProfile, calibrate_sensor
from tactape_fab.sense.calibrate import calibration as calibration_module
from tactape_fab.sense.calibrate.posedness import share_of_perfect
from tactape_fab.sense.calibrate.presses import Frame
from tests.bench import calibration
from tests.tapes import tape_at
from tests.thorough import only_thorough, slow, thorough
from tests.unit.sense.calibrate.sensors import STOCK, TAPE, TRUE, pressed, presses

WRONG = replace(STOCK, px_per_mm=(19.5, 19.5), sign=-1, mirror=True)
"""px/mm 30 % off, both flips wrong."""


STEPS: list[tuple[str, int, int]] = []


@cache
def calibrated() -> Calibration:
    return calibrate_sensor(presses().frames, [TAPE], WRONG, name="mine", progress=lambda *step: STEPS.append(step))


def test_frames_and_adjustments_are_told_as_they_are_done() -> None:
    calibrated()
    assert STEPS[:10] == [("round 1: frames", k + 1, 10) for k in range(10)]
    assert STEPS[10:13] == [("round 1: adjustments", k, 2) for k in range(3)]
    assert STEPS[-3:] == [("pixels: adjustments", k, 2) for k in range(3)]


def figure(found: Calibration, name: str) -> tuple[float, float]:
    """A quantity and its standard deviation."""
    q = next(q for q in found.quantities if q.name == name)
    assert q.sigma is not None
    return q.value, q.sigma


def test_the_camera_is_found_within_what_is_said() -> None:
    found = calibrated()
    assert (found.sensor.sign, found.sensor.mirror, found.sensor.rotate90) == (1, False, 0)
    assert len(found.presses) == found.frames == 10 and found.valid is None
    truth = {
        "px_per_mm_u": 15.0,
        "px_per_mm_v": 15.0,
        "aspect": 0.03,
        "shear": 0.01,
        "k1": 0.03,
        "center_u": 159.5,
        "center_v": 119.5,
    }
    for name, value in truth.items():
        got, sigma = figure(found, name)
        assert abs(got - value) < 4.0 * sigma, name
    assert figure(found, "px_per_mm_u")[1] < 0.02 and figure(found, "aspect")[1] < 1e-3 and figure(found, "k1")[1] < 3e-3
    assert found.sensor.geometry.sigma_aspect == figure(found, "aspect")[1]


@slow
def test_it_is_said_how_many_presses_a_good_camera_takes() -> None:
    found = calibrate_sensor(presses().frames[:6], [TAPE], STOCK)
    six, ten = (share_of_perfect(one.bundle) for one in (found, calibrated()))
    assert ten < six and 0.6 < 10.0 * (ten**2 - 1.0) / (6.0 * (six**2 - 1.0)) < 1.6  # the camera's variance is as one over n
    (note,) = [remark for remark in found.remarks if "to err" in remark]
    wanted, camera = int(note.split("; with ")[1].split(" presses in all")[0]), 6.0 * (six**2 - 1.0)
    assert f"{six:.2f} times as far" in note and 1.0 + camera / wanted <= 1.15**2 < 1.0 + camera / (wanted - 1)


@only_thorough
def test_errors_over_a_perfect_camera_s_are_as_said() -> None:
    """Root mean squares of 8 sets of a DIGIT, of 200 contacts; their scatter is 0.04."""
    (row,) = [row for row in calibration.ROWS if row.sensor == "digit"]
    tape, said, ours, perfect = calibration.tape_of(row)[0], [], [], []
    for k in range(8):
        drawn = list(calibration.presses_of(row, 40, k))
        found = calibrate_sensor([press.depth for press in drawn[:10]], [tape], calibration.start_of(row))
        said.append(share_of_perfect(found.bundle))
        ours += calibration.located_by(found.sensor, tape, drawn[15:])[0]
        perfect += calibration.located_by(calibration.truth_of(row), tape, drawn[15:])[0]
    assert len(ours) == len(perfect) == 200
    measured = np.sqrt(np.square(np.array(ours)[:, :2]).sum() / np.square(np.array(perfect)[:, :2]).sum())
    assert abs(measured / np.mean(said) - 1.0) < 0.08


def test_poses_by_the_camera_of_the_others_are_less_sure() -> None:
    bundle = calibrated().bundle
    alone, anew = (np.linalg.eigvalsh(each) for each in (bundle.poses_alone, bundle.poses_anew))
    assert (alone > 0.0).all() and (alone < anew).all()


def test_gel_and_noise_are_found() -> None:
    found = calibrated()
    assert abs(figure(found, "blur")[0] - 0.15) < 0.03 and abs(figure(found, "amplitude")[0] - 0.12) < 0.015
    assert abs(figure(found, "noise_slope")[0] - 0.032) < 0.002 and figure(found, "noise_white")[0] < 0.5
    assert found.sensor.gel.displacement_um == 0.0 and found.sensor.slope_noise == figure(found, "noise_slope")[0]


def test_heights_and_noise_are_in_mm_whatever_the_unit_of_the_frames() -> None:
    found = calibrate_sensor([frame * 1000 for frame in presses().frames], [TAPE], replace(WRONG, depth_unit_mm=0.001))
    for name in ("amplitude", "noise_slope"):
        assert figure(found, name) == pytest.approx(figure(calibrated(), name), rel=1e-3)


def test_held_out_presses_fit_as_well() -> None:
    held = calibrated().held_out
    assert held is not None and held.folds == 5
    assert 0.9 * held.inside_um < held.outside_um < 1.5 * held.inside_um < 20.0


def test_contacts_are_located_better_than_by_the_stock_profile() -> None:
    tests = pressed(TRUE, 15, 9, (5.0, 3.5), 0.0)
    off: dict[str, float] = {}
    nees: list[float] = []
    profiles: dict[str, SensorProfile] = {
        "stock": replace(STOCK, px_per_mm=(15.0, 15.0)),
        "mine": calibrated().sensor,
        "true": TRUE,
    }
    for name, sensor in profiles.items():
        localizer, errors = Localizer([TAPE], sensor), []
        for frame, pose in zip(tests.frames, tests.poses, strict=True):
            fix = localizer.locate(frame)
            assert fix.located and fix.position_mm is not None and fix.covariance is not None and fix.theta_deg is not None
            turn = (fix.theta_deg - pose[2] + 180.0) % 360.0 - 180.0
            error = np.array([*(np.array(fix.position_mm) - pose[:2]), np.radians(turn)])
            errors.append(error)
            if name == "mine":
                nees.append(float(error @ np.linalg.solve(fix.covariance, error)) / 3.0)
        off[name] = float(np.sqrt(np.mean(np.array(errors)[:, :2] ** 2)))
    assert off["mine"] < 0.7 * off["stock"]
    assert 0.4 < np.mean(nees) < 1.8


@only_thorough
def test_a_gel_that_moves_is_seen_to() -> None:
    made = pressed(TRUE, 12, 4, (6.0, 4.5), 0.0, gel_displacement_um=80.0)
    found = calibrate_sensor(made.frames, [TAPE], STOCK)
    moved, sigma = figure(found, "gel_displacement")
    assert abs(moved - 80.0) < 4.0 * sigma < 80.0
    along, sigma = figure(found, "gel_correlation")
    assert abs(along - 4.0) < 4.0 * sigma < 4.0
    assert found.sensor.gel.displacement_um == moved


@pytest.mark.parametrize(
    ("rotate90", "sign", "mirror"), [thorough(0, 1, True), (1, -1, False), thorough(2, -1, True), thorough(3, 1, True)]
)
def test_orientation_comes_from_one_press_of_known_direction(rotate90: int, sign: int, mirror: bool) -> None:
    true = replace(TRUE, sign=sign, mirror=mirror, rotate90=rotate90)
    made = presses(first_theta=20.0)
    frames = [_delivered(frame, true) for frame in made.frames[:7]]
    found = calibrate_sensor(frames, [TAPE], "generic", known_theta=(0, 20.0)).sensor
    assert (found.sign, found.mirror, found.rotate90) == (sign, mirror, rotate90)
    assert (found.width_px, found.height_px) == (320, 240) and found.frame_shape == frames[0].shape
    assert abs(found.geometry.aspect - 0.03) < 2e-3 and abs(found.geometry.shear - 0.01) < 2e-3
    fix = Localizer([TAPE], found).locate(frames[3])
    assert fix.position_mm is not None and np.allclose(fix.position_mm, made.poses[3][:2], atol=0.05)


@slow
@pytest.mark.parametrize(("rotate90", "crown_mm"), [(0, (189.0, 113.0)), (1, (113.0, 189.0))])
def test_the_gel_s_crown_turns_with_the_image(rotate90: int, crown_mm: tuple[float, float]) -> None:
    frames = [_delivered(frame, replace(TRUE, rotate90=rotate90)) for frame in presses(first_theta=20.0).frames[:7]]
    turned = replace(STOCK, rotate90=0, width_px=frames[0].shape[1], height_px=frames[0].shape[0])
    found = calibrate_sensor(frames, [TAPE], turned, known_theta=(0, 20.0)).sensor
    assert (found.rotate90, found.gel.crown_mm, found.gel.poisson) == (rotate90, crown_mm, STOCK.gel.poisson)


@slow
def test_what_a_profile_s_mask_hides_stays_hidden() -> None:
    """Markers printed on the gel: their depths change from frame to frame, and look like dots."""
    v, u = np.mgrid[:240, :320]
    shown = ~((((u + 12) % 40 - 20) ** 2 + ((v + 7) % 40 - 20) ** 2) <= 2.5**2)
    rng, frames = np.random.default_rng(0), []
    for frame in presses().frames:
        frames.append(frame + np.where(shown, 0.0, 0.15 + 0.02 * rng.standard_normal(shown.shape)))
    found = calibrate_sensor(frames, [TAPE], replace(STOCK, mask=shown))
    assert found.valid is not None and (found.valid == shown).all() and found.sensor.mask is not None
    assert (found.sensor.mask == shown).all() and abs(found.sensor.geometry.aspect - 0.03) < 2e-3


def _delivered(frame: Frame, sensor: SensorProfile) -> Frame:
    """A canonical frame as a sensor of another orientation delivers it."""
    turned = np.rot90(frame, -sensor.rotate90)
    return np.ascontiguousarray(sensor.sign * (turned[:, ::-1] if sensor.mirror else turned))


@only_thorough
def test_blind_borders_are_found_and_kept_clear_of() -> None:
    frames = [frame.copy() for frame in presses(14).frames]
    for frame in frames:
        frame[:, :20] = 0.0
    found = calibrate_sensor(frames, [TAPE], STOCK)
    assert found.valid is not None and not found.valid[:, :25].any() and found.valid[:, 40:].all()
    assert found.sensor.mask is not None and abs(found.sensor.geometry.aspect - 0.03) < 3e-3


@slow
def test_more_presses_in_the_middle_do_not_make_the_lens_known() -> None:
    """Errors that all dots share remain: 20 presses said 0.0025 of k1, and were off by 0.008."""
    with pytest.raises(SpecError, match="all contacts are in the middle of the image"):
        calibrate_sensor(pressed(TRUE, 20, 3, (0.5, 0.5), 20.0).frames, [TAPE], STOCK)


def empty_frames() -> list[Frame]:
    rng = np.random.default_rng(0)
    return [rng.standard_normal((240, 320)).astype(np.float32) * 0.005 for _ in range(8)]


def holes(frames: list[Frame]) -> list[Frame]:
    return [np.where(np.arange(320) < 200, np.nan, frame).astype(np.float32) for frame in frames]


BAD: dict[str, tuple[Callable[[], list[Any]], str]] = {
    "none at all": (list, "there are no frames; give depth maps of some ten presses"),
    "constant": (
        lambda: [np.full((240, 320), 3.0)] * 8,
        "no frame shows anything: frame 0 is constant: 3 in every pixel",
    ),
    "NaN": (lambda: [np.full((240, 320), np.nan)] * 8, "frame 0 is NaN or infinite in every pixel"),
    "mostly NaN": (lambda: holes(presses().frames), "is NaN or infinite in 6[23] % of its pixels"),
    "no dots": (empty_frames, "is not seen in any of 8 frames, by either sign, mirrored or not"),
    "one press": (
        lambda: presses().frames[:1],
        "only 1 press .*can be used, and a calibration needs 6; press the tape some ten times",
    ),
    "five presses": (lambda: presses().frames[:5], "only 5 presses"),
    "one press among empty frames": (lambda: [presses().frames[0], *empty_frames()], "only 1 press of 9 frames"),
    "all in the middle": (
        lambda: presses(10, 2, (0.0, 0.0)).frames,
        "all contacts are in the middle of the image: .* press near the four corners",
    ),
    "two shapes": (
        lambda: [presses().frames[0], presses().frames[1][:200]],
        "frame 1 is 200 x 320 px, the others are 240 x 320",
    ),
    "too small": (lambda: [np.zeros((8, 8))], "frame 0 is no depth map"),
    "a stack": (lambda: [np.zeros((3, 240, 320))], r"frame 0 is no depth map: shape \(3, 240, 320\)"),
    "words": (lambda: [np.array([["a"] * 20] * 20)], "frame 0 is no depth map"),
}


@pytest.mark.parametrize("case", BAD)
def test_frames_that_say_too_little_are_refused_with_the_remedy(case: str) -> None:
    drawn, words = BAD[case]
    frames = drawn()
    with pytest.raises((SpecError, FrameError), match=words):
        calibrate_sensor(frames, [TAPE], STOCK)


def test_another_tape_is_named() -> None:
    other = tape_at(9, (62, 32))
    with pytest.raises(SpecError, match=r"show another tape: it looks like sector 7 of microdots-4x4.*give its kit"):
        calibrate_sensor(presses().frames, [other], TRUE)


def test_presses_on_tapes_of_one_name_are_refused() -> None:
    other = replace(tape_at(9, (62, 32)), name=TAPE.name)
    with pytest.raises(SpecError, match=r"tapes of sectors 7 and 9 are both named .* make one of them with another name"):
        calibrate_sensor(presses().frames, [TAPE, other], TRUE)


def test_a_tape_of_another_pitch_is_not_found() -> None:
    other = replace(TAPE, pitch_mm=5.0, displacement_mm=0.8)
    with pytest.raises(SpecError, match=r"is not seen in any of 10 frames.*check that it is the tape that was pressed"):
        calibrate_sensor(presses().frames, [other], TRUE)


@pytest.mark.parametrize(
    ("known", "words"),
    [
        ((99, 0.0), "known_theta = 99,0: frame 99 is not from 0 to 9"),
        ((0, 1000.0), "known_theta = 0,1000: 1000 deg is not from -360 to 360"),
        ((0, nan), "known_theta = 0,nan: nan deg is not from -360 to 360 deg; give one of those"),
        ((0, -inf), "known_theta = 0,-inf: -inf deg is not from -360 to 360 deg"),
        ((0, 10**400), r"known_theta = \(0, 1000.*\.\.\. is no array of numbers; give the index of a frame and its angle: 0,90"),
        ((0, 65.0), "known_theta = 0,65: the frame is said to be at 65 deg and seen at 20.* is 45 deg from a quarter turn"),
    ],
)
def test_a_known_direction_that_cannot_be_is_refused(known: tuple[int, float], words: str) -> None:
    with pytest.raises(SpecError, match=words):
        calibrate_sensor(presses().frames, [TAPE], TRUE, known_theta=known)


@only_thorough
def test_remarks_say_what_cannot_be_observed() -> None:
    said = " ".join(calibrated().remarks)
    assert "quarter turns of the image cannot be told" in said and "known_theta=FRAME,DEG" in said
    cropped = calibrate_sensor([frame[10:, 20:] for frame in presses().frames], [TAPE], STOCK)
    assert any("frames are 230 x 300 px (height x width), those of 'gelsight-mini' 240 x 320" in r for r in cropped.remarks)
    alike = pressed(TRUE, 10, 5, (5.0, 3.5), 30.0, alike=True).frames
    assert any("all presses are turned alike" in r for r in calibrate_sensor(alike, [TAPE], TRUE).remarks)


def held(frames: list[Frame], times: int) -> list[Frame]:
    """Frames of presses that are held, each with noise of its own."""
    rng = np.random.default_rng(3)
    return [frame + rng.normal(0.0, 5e-4, frame.shape).astype(np.float32) for frame in frames for _ in range(times)]


@slow
def test_frames_of_one_press_that_is_held_count_once() -> None:
    found, once = (
        calibrate_sensor(held(presses().frames[:7], 3), [TAPE], TRUE),
        calibrate_sensor(presses().frames[:7], [TAPE], TRUE),
    )
    assert sorted(press.frame // 3 for press in found.presses) == list(range(7)) and found.frames == 21
    assert any(re.match(r"14 frames show the presses of others again \(frame \d", remark) for remark in found.remarks)
    for name in ("px_per_mm_u", "aspect"):
        assert figure(found, name)[1] == pytest.approx(figure(once, name)[1], rel=0.15)


@slow
def test_of_a_press_that_is_held_the_frame_with_a_pose_of_the_arm_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    frames, seen = held(presses().frames[:6], 2), list[int]()
    monkeypatch.setattr(calibration_module, "find_hand_eye", lambda _bundle, found, *_: seen.extend(p.frame for p in found))
    for posed in (0, 1):
        poses = [ArmPose(frame=k, flange_to_base=np.eye(4)) for k in range(posed, 12, 2)]
        calibrate_sensor(frames, [TAPE], TRUE, arm_poses=poses)
    assert seen == [*range(0, 12, 2), *range(1, 12, 2)]


def test_few_presses_that_are_held_are_refused() -> None:
    """Four of ten frames each were taken for forty presses."""
    with pytest.raises(SpecError, match=r"^only 4 presses of 8 frames can be used.*4 frames show the presses of others again"):
        calibrate_sensor(held(presses().frames[:4], 2), [TAPE], TRUE)


@slow
def test_a_frame_that_is_there_twice_counts_once() -> None:
    frames = presses().frames
    found, once = (calibrate_sensor([*frames, *more], [TAPE], TRUE) for more in (frames[:4], ()))
    assert found.quantities == once.quantities and len(found.presses) == 10
    said = "4 frames are earlier ones again, value by value (frame 10 is frame 0); what is there twice counts once"
    assert said in found.remarks
    # a repeated frame's known direction is that of the frame; it was refused as one without dots
    seen = r"known_theta = 10,65: the frame is said to be at 65 deg and seen at"
    with pytest.raises(SpecError, match=seen):
        calibrate_sensor([*frames, frames[0]], [TAPE], TRUE, known_theta=(10, 65.0))
    few = r"only 3 presses of 12 frames can be used, and a calibration needs 6; .*; 9 frames are earlier ones again, value"
    with pytest.raises(SpecError, match=few):
        calibrate_sensor([*frames[:3]] * 4, [TAPE], TRUE)


@slow
def test_a_bad_frame_among_good_ones_is_only_said() -> None:
    frames = [*presses().frames, np.full((240, 320), 1.0, dtype=np.float32)]
    found = calibrate_sensor(frames, [TAPE], TRUE)
    assert len(found.presses) == 10 and "frame 10 is constant: 1 in every pixel" in found.remarks
    assert found.quantities == calibrate_sensor(presses().frames, [TAPE], TRUE).quantities  # noise, too
