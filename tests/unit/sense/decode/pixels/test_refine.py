"""Poses fitted to the pixels around the dots: exact without noise, as uncertain as they say, never elsewhere than the dots."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tactape_fab import Localization, Localizer, Tape
from tactape_fab.base.errors import SpecError
from tactape_fab.sense import Frame, Scene, SensorProfile, iterate_frames, load_sensor
from tactape_fab.sense.decode.pixels.patches import BLURS_MM, fitted, pixel_fit, settled_patches
from tactape_fab.sense.decode.result import Refined
from tactape_fab.sense.geometry import USUAL_BLUR_MM, Gel, Geometry
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray
from tests.bench.localization_rows import plane_gel
from tests.bench.pixel_bound import slope_noise_mm
from tests.contacts import TAPE, nees, pose_error

SLOPE = 0.032
SENSOR = replace(load_sensor("gelsight-mini"), slope_noise=SLOPE)
CELLS = TAPE.cells()
TEXTURE_MM = CELLS * TAPE.pitch_mm + TAPE.displacement_mm * DIRECTIONS_XY[TAPE.symbols[CELLS[:, 1], CELLS[:, 0]]]


def frames(count: int, slope: float = SLOPE, tape: Tape = TAPE, sensor: SensorProfile = SENSOR, **scene: Any) -> Iterator[Frame]:
    """Frames whose only noise is that of the slopes."""
    rng = np.random.default_rng(7)
    for frame in iterate_frames(tape, count, 3, sensor, Scene(noise=0.0, **scene)):
        yield replace(frame, depth=(frame.depth + slope_noise_mm(rng, frame.depth.shape, slope, 16.0)).astype(np.float32))


def rms_um(fixes: list[Localization], seen: list[Frame]) -> float:
    return float(np.sqrt(np.mean([pose_error(fix, frame)[:2] ** 2 for fix, frame in zip(fixes, seen, strict=True)])) * 1000)


def body_axes(theta_deg: float, px_per_mm: float = 16.0) -> FloatArray:
    """Pixels to mm along the bodies: the long axis stands at rotation - theta, counter-clockwise, in an image with v down."""
    turn = np.radians(theta_deg - TAPE.part.rotation_deg)
    return np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) / px_per_mm


# One dot


def whole(frame: Frame) -> FloatArray:
    """Truth of the dots that are imprinted whole, with their neighbourhood in the image."""
    at = frame.dots_px[frame.dots_imprint > 0.99999]
    return at[(at > 10).all(axis=1) & (at < np.array(frame.depth.shape[::-1]) - 11).all(axis=1)]


@pytest.mark.parametrize("blur_mm", [0.1, 0.15, 0.2])
def test_centres_of_whole_dots_are_exact_without_noise(blur_mm: float) -> None:
    errors = []
    for frame in frames(4, slope=0.0, elastomer_mm=blur_mm):
        truth = whole(frame)
        start = truth + np.random.default_rng(1).uniform(-0.3, 0.3, truth.shape)
        to_body = body_axes(frame.theta_deg)
        found = fitted(pixel_fit(SENSOR), frame.depth, start, to_body, TAPE.part, blur_mm)
        errors.append((start + found.moved_mm @ np.linalg.inv(to_body).T - truth) / 16.0 * 1000)
        assert np.median(found.height) == pytest.approx(0.12, rel=0.1)  # neighbours raise it under a wide blur
    um = np.concatenate(errors)
    assert np.abs(np.median(um, axis=0)).max() < 1.0
    # a wide blur brings the neighbours' flanks into the patch: 2.5 um, in opposite directions
    assert np.median(np.hypot(*um.T)) < (2.0 if blur_mm < 0.2 else 3.0)


def test_variances_of_whole_dots_are_those_of_their_errors() -> None:
    fit, normalised, left = pixel_fit(SENSOR), [], []
    for frame in frames(10):
        truth, to_body = whole(frame), body_axes(frame.theta_deg)
        found = fitted(fit, frame.depth, truth, to_body, TAPE.part, 0.15)
        covariance = found.spread_mm2 * (SLOPE / 16.0) ** 2
        normalised.append(np.einsum("ni,nij,nj->n", found.moved_mm, np.linalg.inv(covariance), found.moved_mm) / 2)
        left.append(found.left / fit.freedom / (SLOPE / 16.0) ** 2)
    assert np.median(np.concatenate(left)) == pytest.approx(1.0, abs=0.1)
    # the median of half a chi-square of 2 degrees of freedom is ln 2; the contact's rim and neighbours add some
    assert 0.9 < np.median(np.concatenate(normalised)) / np.log(2) < 1.4


def test_neighbours_do_not_draw_each_other() -> None:
    """Two parts 1 mm apart: either's flank reaches into the other's patch, and without it in the relief both are 2.7 um off."""
    fit, off, alone = pixel_fit(SENSOR), [], []
    for frame in frames(8, slope=0.0):
        truth, to_body = whole(frame), body_axes(frame.theta_deg)
        apart = np.hypot(*(truth[:, None] - truth).T) / 16.0 + 9.0 * np.eye(len(truth))
        inner = (np.hypot(*((truth - truth.mean(axis=0)) / 16.0).T) < 3.0) & (apart.min(axis=0) < 1.05)
        chosen = truth[inner]
        together = fitted(fit, frame.depth, chosen, to_body, TAPE.part, 0.15, truth)
        off.append(together.moved_mm * 1000)
        alone.append(fitted(fit, frame.depth, chosen, to_body, TAPE.part, 0.15, chosen[:0]).moved_mm * 1000)
    um, alone_um = np.concatenate(off), np.concatenate(alone)
    assert len(um) > 20
    assert np.sqrt((um**2).mean()) < 0.8 and np.sqrt((alone_um**2).mean()) > 2.0


def test_a_dot_at_the_rim_is_put_back_by_what_it_misses() -> None:
    """Contacts of 7x7 mm without noise: a third of their dots stand at the rim, drawn inwards by up to 0.1 mm."""
    seen = list(frames(20, slope=0.0, contact_mm=(7.0, 7.0)))
    fixes = [Localizer(TAPE, SENSOR, refine="pixels").locate(frame.depth) for frame in seen]
    refined = [(fix, frame) for fix, frame in zip(fixes, seen, strict=True) if fix.refined == "pixels"]
    assert len(refined) > 15
    assert rms_um([fix for fix, _ in refined], [frame for _, frame in refined]) < 0.6


def test_a_small_blur_is_found_from_a_start_that_is_wrong() -> None:
    fit = pixel_fit(SENSOR)
    for blur_mm in (0.06, 0.08, 0.1):
        for frame in frames(3, elastomer_mm=blur_mm):
            at, to_body = whole(frame), body_axes(frame.theta_deg)
            found, _ = settled_patches(fit, frame.depth, at, to_body, TAPE.part)
            told = fitted(fit, frame.depth, at, to_body, TAPE.part, blur_mm)
            start = fitted(fit, frame.depth, at, to_body, TAPE.part, USUAL_BLUR_MM)
            off, off_at_start = (abs(np.median(one.imprint) / np.median(told.imprint) - 1.0) for one in (found, start))
            assert off < 0.5 * off_at_start
    assert USUAL_BLUR_MM in BLURS_MM and min(BLURS_MM) < 0.06 and max(BLURS_MM) > 0.4


# Poses


def test_poses_are_better_and_as_uncertain_as_they_say() -> None:
    seen = list(frames(100))
    dots, pixels = Localizer(TAPE, SENSOR), Localizer(TAPE, SENSOR, refine="pixels")
    before, after = [[one.locate(frame.depth) for frame in seen] for one in (dots, pixels)]
    # one of them stays at the dots, which scatter less there
    assert {fix.refined for fix in before} == {"dots"} and sum(fix.refined == "pixels" for fix in after) >= 98
    assert rms_um(after, seen) < 0.9 * rms_um(before, seen) and rms_um(before, seen) < 0.9
    assert 0.6 < np.mean([nees(fix, frame) for fix, frame in zip(after, seen, strict=True)]) < 1.5
    kept = ("tape", "cell", "n_dots", "n_agree", "contact_mm", "p_tape", "p_place")
    for old, new in zip(before, after, strict=True):
        assert [getattr(old, name) for name in kept] == [getattr(new, name) for name in kept]


def test_poses_are_exact_without_noise() -> None:
    seen = list(frames(12, slope=0.0))
    fixes = [Localizer(TAPE, SENSOR, refine="pixels").locate(frame.depth) for frame in seen]
    assert {fix.refined for fix in fixes} == {"pixels"}
    assert np.abs(np.mean([pose_error(fix, frame)[:2] for fix, frame in zip(fixes, seen, strict=True)], axis=0)).max() < 3e-4
    assert rms_um(fixes, seen) < 0.6


@pytest.mark.parametrize("px_per_mm", [(16.0, 14.0), (32.0, 32.0)])
def test_oblong_and_fine_pixels(px_per_mm: tuple[float, float]) -> None:
    size = (round(20 * px_per_mm[0]), round(15 * px_per_mm[1]))
    sensor = replace(SENSOR, px_per_mm=px_per_mm, width_px=size[0], height_px=size[1], slope_noise=None)
    seen = list(iterate_frames(TAPE, 6, 3, sensor, Scene(noise=0.0)))
    fixes = [Localizer(TAPE, sensor, refine="pixels").locate(frame.depth) for frame in seen]
    assert {fix.refined for fix in fixes} == {"pixels"}
    assert rms_um(fixes, seen) < 0.8


@pytest.mark.parametrize("center_px", [None, (170.0, 110.0)])
def test_a_camera_with_shear_and_lens_is_undone(center_px: tuple[float, float] | None) -> None:
    """Of a plane gel: beside the middle of a crowned one, the contact is tilted."""
    sensor = replace(plane_gel(), slope_noise=SLOPE, geometry=Geometry(aspect=0.04, shear=0.02, k1=0.05, center_px=center_px))
    seen = list(frames(12, slope=0.0, sensor=sensor, contact_offset_mm=(2.0, 1.0)))
    fixes = [Localizer(TAPE, sensor, refine="pixels").locate(frame.depth) for frame in seen]
    assert {fix.refined for fix in fixes} == {"pixels"}
    assert rms_um(fixes, seen) < 0.6


@pytest.mark.parametrize("refine", ["dots", "pixels"])
def test_a_crowned_gel_that_is_imprinted_without_pressure_is_in_the_covariance(refine: Refined) -> None:
    """Heights of dots show a slope, but no top is drawn by it; what is taken off for it is about as unsure."""
    seen = list(iterate_frames(TAPE, 24, 19, load_sensor("gelsight-mini"), Scene(contact_offset_mm=(0.0, 3.0))))
    localizer = Localizer(TAPE, refine=refine)
    assert np.mean([nees(localizer.locate(frame.depth), frame) for frame in seen]) < 1.6


def test_a_camera_that_is_not_the_profiles_is_in_the_covariance() -> None:
    seen = list(frames(30, contact_offset_mm=(3.0, 2.0), aspect_error=0.03, shear_error=0.02, k1_error=0.03))
    localizer = Localizer(TAPE, SENSOR, refine="pixels")
    fixes = [localizer.locate(frame.depth) for frame in seen]
    assert sum(fix.refined == "pixels" for fix in fixes) > 25
    assert np.mean([nees(fix, frame) for fix, frame in zip(fixes, seen, strict=True)]) < 1.5


def test_wide_blurs_are_left_to_the_dots_where_these_scatter_less() -> None:
    seen = list(frames(20, elastomer_mm=0.25))
    localizer, plain = Localizer(TAPE, SENSOR, refine="pixels"), Localizer(TAPE, SENSOR)
    fixes = [localizer.locate(frame.depth) for frame in seen]
    assert sum(str(fix.refine_reason).startswith("refined dots scatter by") for fix in fixes) >= 8
    assert rms_um(fixes, seen) < rms_um([plain.locate(frame.depth) for frame in seen], seen)


def test_a_wrong_blur_in_the_profile_does_hardly_any_harm() -> None:
    seen = list(frames(40))
    before = rms_um([Localizer(TAPE, SENSOR).locate(frame.depth) for frame in seen], seen)
    for wrong_mm in (0.075, 0.3):
        localizer = Localizer(TAPE, replace(SENSOR, gel=Gel(blur_mm=wrong_mm)), refine="pixels")
        assert rms_um([localizer.locate(frame.depth) for frame in seen], seen) <= 1.03 * before


def test_bumps_beside_dots_move_no_pose() -> None:
    seen = list(frames(15, bumps=8))
    fixes = [Localizer(TAPE, SENSOR, refine="pixels").locate(frame.depth) for frame in seen]
    assert rms_um(fixes, seen) < 1.5


# Falling back


def test_domes_are_left_to_the_dots() -> None:
    tape = replace(TAPE, part=replace(TAPE.part, shape="dome", body_mm=(0.5, 0.5, 0.2)))
    frame = next(frames(1, tape=tape))
    fix, plain = (Localizer(tape, SENSOR, refine=how).locate(frame.depth) for how in ("pixels", "dots"))
    assert (fix.refined, fix.refine_reason) == ("dots", "the parts are no boxes of known size")
    assert (fix.position_mm, fix.theta_deg) == (plain.position_mm, plain.theta_deg)
    assert plain.refine_reason is None


def test_parts_larger_than_a_patch_are_left_to_the_dots() -> None:
    tape = replace(TAPE, part=replace(TAPE.part, body_mm=(3.0, 3.0, 0.3)))
    fix = Localizer(tape, SENSOR, refine="pixels").locate(next(frames(1)).depth)
    assert fix.located and fix.refined == "dots" and str(fix.refine_reason).startswith("parts of 3 mm are larger")


def test_too_few_whole_dots_are_left_as_they_are() -> None:
    mask = np.zeros((SENSOR.height_px, SENSOR.width_px), dtype=bool)
    mask[:, ::12] = True  # no patch is whole
    frame = next(frames(1))
    fit = pixel_fit(replace(SENSOR, mask=mask))
    assert not fit.usable.any()
    assert pixel_fit(SENSOR).usable.sum() == (240 - 18) * (320 - 18)
    fix = Localizer(TAPE, replace(SENSOR, mask=~mask), refine="pixels").locate(frame.depth)
    assert fix.located and fix.refined == "dots" and fix.refine_reason == "only 0 dots have all the pixels around them"


def test_a_residual_beyond_the_noise_is_left_to_the_dots() -> None:
    quiet = replace(SENSOR, slope_noise=SLOPE / 8)
    fix = Localizer(TAPE, quiet, refine="pixels").locate(next(frames(1)).depth)
    assert fix.refined == "dots" and fix.refine_reason is not None and "times the slopes' noise" in fix.refine_reason


def test_dots_of_others_have_no_pixels() -> None:
    frame = next(frames(1))
    fix = Localizer(TAPE, SENSOR, refine="pixels").locate_dots(frame.dots_px[frame.dots_imprint > 0.5])
    assert fix.located and fix.refined == "dots"


def test_a_profile_that_knows_its_blur_is_refined_unless_the_dots_are_asked_for() -> None:
    frame, knows = next(frames(1)), replace(SENSOR, gel=Gel(blur_mm=0.15))
    told = [(SENSOR, {}), (knows, {}), (knows, {"refine": "dots"}), (knows, {"refine": "pixels"})]
    fixes = [Localizer(TAPE, sensor, **how).locate(frame.depth) for sensor, how in told]  # type: ignore[arg-type]
    assert [fix.refined for fix in fixes] == ["dots", "pixels", "dots", "pixels"]
    assert fixes[0].position_mm == fixes[2].position_mm and fixes[1].position_mm == fixes[3].position_mm
    assert Localizer(TAPE, knows, method="paper").locate(frame.depth).refined is None
    assert Localizer.from_code("microdots-4x4", 1.5, 0.25, knows).locate(frame.depth).refined in (None, "dots")


def test_what_is_not_located_is_not_refined() -> None:
    fix = Localizer(TAPE, SENSOR, refine="pixels").locate(np.zeros((240, 320)))
    assert (fix.located, fix.refined, fix.refine_reason) == (False, None, None)


# What is said


def test_the_answer_says_what_it_rests_on() -> None:
    fix = Localizer(TAPE, SENSOR, refine="pixels").locate(next(frames(1)).depth)
    said = json.loads(json.dumps(fix.to_mapping(0)))
    assert (said["refined"], said["refine_reason"]) == ("pixels", None)


@pytest.mark.parametrize("options", [{"refine": "pixel"}, {"refine": 1}, {"refine": "pixels", "method": "paper"}])
def test_other_values_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(SpecError, match=r"refine = .*pixels"):
        Localizer(TAPE, **options)
