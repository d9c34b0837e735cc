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
from tactape_fab.sense import ElasticContact, Frame, Scene, SensorProfile, iterate_frames, load_sensor
from tactape_fab.sense.decode.dots.rim import ONE_SIDED
from tactape_fab.sense.decode.grid.beliefs import Beliefs, beliefs_of
from tactape_fab.sense.decode.grid.pose import Pose
from tactape_fab.sense.decode.pixels.patches import BLURS_MM, fitted, pixel_fit, settled_patches
from tactape_fab.sense.decode.pixels.refine import (
    AT_RIM,
    AT_RIM_STEP,
    HEIGHT_ERROR,
    LEAST_INNER,
    LEVEL_ERROR,
    PULL_MM,
    PULL_SCATTER,
    PULL_WEIGHT,
    RIM_MM,
    USUAL_MM,
    _doubt,
    _rim_law,
    _squared_distance,
    at_rim,
    mm_of_px,
)
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


@pytest.mark.parametrize("rotation_deg", [0.0, 30.0, 90.0])
def test_a_pose_is_exact_whichever_way_the_parts_lie(rotation_deg: float) -> None:
    tape = replace(TAPE, part=replace(TAPE.part, rotation_deg=rotation_deg))
    frame = next(frames(1, slope=0.0, tape=tape))
    fix, plain = (Localizer(tape, SENSOR, refine=how).locate(frame.depth) for how in ("pixels", "dots"))
    assert fix.refined == "pixels" and fix.position_mm != plain.position_mm
    assert np.abs(pose_error(fix, frame)[:2]).max() < 0.001 and fix.px_per_mm == pytest.approx(16.0, rel=1e-3)


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


def test_the_turn_of_a_light_press_is_as_exact_as_said() -> None:
    """The pressure draws refined centres along their parts, too, if less than maxima: 1.8 standard deviations without that."""
    seen = list(iterate_frames(TAPE, 16, 9, scene=Scene(elastic=ElasticContact(force_n=1.0), slope_noise=SLOPE)))
    localizer = Localizer(TAPE, refine="pixels")
    fixes = [localizer.locate(frame.depth) for frame in seen]
    turns = [pose_error(fix, frame)[2] ** 2 / fix.covariance[2, 2] for fix, frame in zip(fixes, seen, strict=True)]  # type: ignore[index]
    # middles between edges may scatter less than the pixels' centres, and are kept then
    assert sum(fix.refined == "pixels" for fix in fixes) >= 8 and np.mean(turns) < 1.3**2


def test_a_bent_tape_without_pressure_is_left_to_the_dots() -> None:
    """Its dots are laid flat, which the pixels are not: NEES/3 was 169 round 16 mm."""
    bent = Scene(contact="strip", cylinder_radius_mm=16.0, contact_turn_deg=30.0)
    sensor = replace(plane_gel(), slope_noise=SLOPE)
    seen = list(iterate_frames(TAPE, 6, 7, sensor, bent))
    localizer = Localizer(TAPE, sensor, refine="pixels")
    fixes = [localizer.locate(frame.depth) for frame in seen]
    assert {fix.refined for fix in fixes} == {"dots"} and "bent" in str(fixes[0].refine_reason)
    assert np.mean([nees(fix, frame) for fix, frame in zip(fixes, seen, strict=True)]) < 2.0


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


# Its steps


@pytest.mark.parametrize("seed", range(4))
def test_a_squared_distance_is_that_of_the_inverse_covariance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root, move = rng.normal(size=(3, 3)), rng.normal(size=3)
    covariance, (x, y, z) = root @ root.T + np.eye(3), move.tolist()
    assert _squared_distance((x, y, z), covariance.tolist()) == pytest.approx(move @ np.linalg.solve(covariance, move))


def pose_at(x_mm: float = 5.0, theta_rad: float = 0.3, *, agree: int = 40, sigma_mm: float = 0.01, known: bool = True) -> Pose:
    """A pose whose position and angle are known to 4 um and 1.2 mrad, or not at all."""
    covariance = np.diag([0.004**2, 0.004**2, 0.0012**2]) if known else np.full((3, 3), np.inf)
    return Pose(
        position_mm=np.array([x_mm, 7.0]),
        theta_rad=theta_rad,
        px_per_mm=16.0,
        covariance=covariance,
        agree=np.arange(50) < agree,
        sigma_mm=sigma_mm,
        camera=np.zeros((2, 3)),
    )


@pytest.mark.parametrize(
    ("refined", "why"),
    [
        (pose_at(), None),
        (pose_at(agree=6), None),
        (pose_at(agree=5), "the refined dots give no pose"),
        (pose_at(known=False), "the refined dots give no pose"),
        # of 40 that agree 1.1 times the dots' scatter, and a tenth more
        (pose_at(sigma_mm=0.01209), None),
        (pose_at(sigma_mm=0.01211), "refined dots scatter by 12.1 um, the dots by 10.0 um"),
        # of 8 half as much again
        (pose_at(agree=8, sigma_mm=0.01649), None),
        (pose_at(agree=8, sigma_mm=0.01651), "refined dots scatter by 16.5 um, the dots by 10.0 um"),
        # 4 um and the floor's 3 are 5, 1.2 mrad and 0.5 are 1.3: five times as much is chance in 2e-5
        (pose_at(5.0249), None),
        (pose_at(5.0251), "the pixels move the pose by 25.1 um, more than the dots' errors allow"),
        (pose_at(4.9749), "the pixels move the pose by 25.1 um, more than the dots' errors allow"),
        (pose_at(theta_rad=0.3 + 0.0064), None),
        (pose_at(theta_rad=0.3 + 0.0066), "the pixels move the pose by 0.0 um, more than the dots' errors allow"),
        (pose_at(theta_rad=0.3 + 2 * np.pi + 0.0064), None),
    ],
)
def test_a_refined_pose_is_doubted_where_the_dots_say_otherwise(refined: Pose, why: str | None) -> None:
    assert _doubt(pose_at(), refined) == why


@pytest.mark.parametrize(("px_per_mm", "k1"), [(16.0, 0.0), (32.0, 0.0), (16.0, 0.05)])
def test_pixels_are_so_long_on_the_gel(px_per_mm: float, k1: float) -> None:
    """About the middle of the dots, where a lens makes them shorter or longer."""
    size = (round(20 * px_per_mm), round(15 * px_per_mm))
    geometry = Geometry(aspect=0.04, shear=0.02, k1=k1)
    fit = pixel_fit(replace(SENSOR, px_per_mm=(px_per_mm, px_per_mm), width_px=size[0], height_px=size[1], geometry=geometry))
    at, steps = np.array([[40.0, 30.0], [70.0, 50.0], [55.0, 40.0]]), np.eye(2) * 1e-3
    assert fit.factor == px_per_mm / 16.0
    expected = [(fit.from_px(at[2:] + d) - fit.from_px(at[2:] - d))[0] / 2e-3 for d in steps]
    assert mm_of_px(fit, at) == pytest.approx(np.stack(expected, axis=1), rel=1e-3, abs=1e-6)


def at_rim_by_hand(texture: FloatArray, neighbours: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The mean unit vector to neighbours within 2.5 mm, and what is missing of the median height inside, less 0.02."""
    inwards, share = np.zeros_like(texture), np.zeros(len(height))
    for i, at in enumerate(texture):
        to = neighbours - at
        length = np.hypot(*to.T)
        near = (length > 0.0) & (length < RIM_MM)
        mean = (to[near] / length[near, None]).sum(axis=0) / max(int(near.sum()), 1)
        share[i] = np.hypot(*mean)
        inwards[i] = mean / max(share[i], 1e-9)
    outer = share > ONE_SIDED
    inside, ranked = np.sort(height[~outer]), np.sort(height)
    # with fewer than four inside, the median of the higher half of all
    level = inside[len(inside) // 2] if len(inside) >= 4 else ranked[len(ranked) // 2 + (len(ranked) - len(ranked) // 2) // 2]
    low = np.clip(0.98 - height / level, 0.0, 1.0)
    return np.where(outer[:, None], inwards, 0.0), np.where(outer, low, 0.0)


@pytest.mark.parametrize(("columns", "rows", "inner"), [(6, 5, 12), (3, 2, 0), (4, 3, 2)])
def test_dots_with_all_neighbours_to_one_side_are_at_the_rim(columns: int, rows: int, inner: int) -> None:
    rng = np.random.default_rng(columns)
    k, row = np.meshgrid(np.arange(columns), np.arange(rows))
    dots: FloatArray = np.stack([1.5 * k.ravel(), 1.5 * row.ravel()], axis=1)
    height = rng.uniform(0.5, 1.3, len(dots))
    inwards, low = at_rim(dots, dots, height)
    expected = at_rim_by_hand(dots, dots, height)
    assert inwards == pytest.approx(expected[0], abs=1e-12) and low == pytest.approx(expected[1])
    assert np.count_nonzero((inwards == 0.0).all(axis=1)) == inner and (low > 0.0).any() and (low == 0.0).any()
    # the corner dot's are to the right, below, and between both
    assert inwards[0] == pytest.approx([0.5**0.5] * 2)
    # neighbours that are no dots of these count as well
    few = [0, 1, 2, columns]
    assert np.array_equal(at_rim(dots[few], dots, height[few])[0], inwards[few])


def rim_law(
    error: FloatArray, gel: FloatArray, inwards: FloatArray, low: FloatArray, own: FloatArray, view: Beliefs
) -> tuple[FloatArray, FloatArray]:
    """The law of `_rim_law` by dense matrices: how far each dot is drawn, and its weight."""
    missing = np.where(low > 0.0, low + LEVEL_ERROR, 0.0)
    noise, law = HEIGHT_ERROR * np.sqrt(own), missing / (1 + 2 * missing)
    likely = 1 / (1 + np.exp((AT_RIM - missing / noise) / AT_RIM_STEP))
    drawn, unsure = likely * law, likely * (noise**2 + (PULL_SCATTER * law) ** 2 + (1 - likely) * law**2)
    weight = np.tile(1 / (own + PULL_MM**2 * (drawn**2 + unsure) + USUAL_MM**2), 2)
    # x, y and the turn, then scale, aspect, shear and k1 in their standard deviations: p = (1 + k1 r^2 / r_corner^2) A q
    (x, y), one, none = gel.T, np.ones(len(own)), np.zeros(len(own))
    dx, dy = x - view.centre_mm[0], y - view.centre_mm[1]
    square = (dx / view.corner_mm[0]) ** 2 + (dy / view.corner_mm[1]) ** 2
    s = view.sigmas
    u = [one, none, -y, s[0] * x, s[1] * x / 2, s[2] * y, s[3] * square * dx]
    v = [none, one, x, s[0] * y, -s[1] * y / 2, none, s[3] * square * dy]
    rates = np.concatenate([np.stack(u, axis=1), np.stack(v, axis=1)])
    prior = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
    solved = np.linalg.solve(rates.T @ (weight[:, None] * rates) + prior, rates.T @ (weight * error.T.ravel()))
    left = error - (rates @ solved).reshape(2, -1).T
    pull = (PULL_WEIGHT * PULL_MM + drawn @ (left * inwards).sum(axis=1)) / (PULL_WEIGHT + drawn @ drawn)
    pull = min(max(pull, 0.0), 2 * PULL_MM)
    by_rim, variance = pull * drawn[:, None] * inwards, own + pull**2 * unsure
    whole = pull**2 * unsure <= own
    if np.count_nonzero(whole) >= LEAST_INNER:
        squares, owns, middle = np.sort(((left - by_rim)[whole] ** 2).sum(axis=1)), np.sort(own[whole]), int(whole.sum()) // 2
        variance = variance + max(squares[middle] / (2 * np.log(2)) - owns[middle], 0.0)
    return by_rim, variance.min() / variance


@pytest.mark.parametrize("seed", range(6))
def test_the_rim_s_law_is_that_of_dense_matrices(seed: int) -> None:
    """Dots that the rim draws by nothing, by some, and by more than it may; of few whole ones no scatter is told."""
    rng = np.random.default_rng(seed)
    n = 5 if seed == 5 else 24
    gel, own = rng.uniform(-5.0, 5.0, (n, 2)), rng.uniform(0.001, 0.004, n) ** 2
    low = np.where(rng.random(n) < (0.9 if seed == 5 else 0.4), rng.uniform(0.0, 0.4, n), 0.0)
    inwards = -gel / np.hypot(*gel.T)[:, None]
    error = (0.0, 0.2, 0.4, 0.8, -0.4, 0.2)[seed] * low[:, None] * inwards + rng.normal(0.0, 0.01, (n, 2))
    view = replace(beliefs_of(SENSOR, fixed_scale=False), centre_mm=np.array([0.4, -0.3]))
    given, weights = (error.copy(), low.copy()), np.empty(n)
    _rim_law(
        given[0], gel, inwards, given[1], own, view.sigmas, view.centre_mm, view.corner_mm, np.empty((7, 2, n)), np.zeros((7, 8)),
        weights,
    )  # fmt: skip
    by_rim, expected = rim_law(error, gel, inwards, low, own, view)
    assert given[0] == pytest.approx(by_rim, abs=1e-9) and weights == pytest.approx(expected, rel=1e-6)
