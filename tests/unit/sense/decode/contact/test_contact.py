"""Tilt, indentation and force: of surfaces known exactly, and of tapes in the elastic simulator, which shares no code."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from tactape_fab import Localization, Localizer
from tactape_fab.sense import ElasticContact, Frame, Scene, SensorProfile, iterate_frames, load_sensor
from tactape_fab.sense.decode.contact import surface
from tactape_fab.sense.decode.contact.plane import (
    BENT_SIGMA,
    CORRELATED,
    FAR,
    FLAT_TOLERANCE,
    GAIN,
    GAIN_SIGMA,
    LEAST_ERROR_MM,
    ROUNDNESS,
    SLOPE_FLOOR,
    SLOPE_SHARE,
    Plane,
    _bend,
    dome_of,
    fit_plane,
    level_of,
    terms,
)
from tactape_fab.sense.decode.result import Refined
from tactape_fab.sense.geometry import Gel
from tactape_fab.texture.frames import FloatArray
from tests.contacts import TAPE, dots, nees, pose_error
from tests.thorough import costly, slow

SENSOR = load_sensor("gelsight-mini")
CROWN_MM = (189.0, 113.0)
GEL = Gel(thickness_mm=4.0, modulus_kpa=275.0, poisson=0.485, crown_mm=CROWN_MM)
NOTHING = ["tilt_deg", "tilt_covariance", "indentation_mm", "indentation_sigma_mm", "force_n", "force_sigma_n"]


# Planes


def tops(
    slopes: tuple[float, float], gain: float = GAIN, bend: float = 0.0, middle_mm: tuple[float, float] = (3.0, -1.0)
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Tops of a tape as a sensor shows them that has a share `gain` of all heights; bent along v by `bend`, 1/mm."""
    rng = np.random.default_rng(1)
    at = np.array(middle_mm) + rng.uniform(-4, 4, (40, 2))
    x, y = at.T
    height = 0.3 + slopes[0] * x + slopes[1] * y - x**2 / (2 * CROWN_MM[0]) - y**2 / (2 * CROWN_MM[1]) - bend * y**2 / 2
    return at, gain * height + 0.001 * rng.standard_normal(40), np.ones(40)


def plane_of(at: FloatArray, tops_mm: FloatArray, weights: FloatArray, crown_mm: tuple[float, float] | None = CROWN_MM) -> Plane:
    found = fit_plane(at, tops_mm, weights, crown_mm)
    assert found is not None
    return found


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.035, 0.0), (0.0, -0.05), (0.06, 0.06)])
@pytest.mark.parametrize("gain", [1.0, 0.95, 0.88])
def test_the_crown_tells_what_the_sensor_makes_of_slopes(slopes: tuple[float, float], gain: float) -> None:
    plane = plane_of(*tops(slopes, gain))
    assert plane.flat and plane.gain == pytest.approx(gain, abs=0.04)
    off = plane.rise - (0.3, *slopes)
    assert off @ np.linalg.solve(plane.covariance, off) < 16.0
    assert np.abs(off[1:]).max() < 0.003


@pytest.mark.parametrize("count", [16, 17])
def test_the_surface_is_a_robust_fit_by_the_tops_median_error(count: int) -> None:
    """By least squares of rows, of which three are what is believed of the curvatures."""
    at, heights, _ = tops((0.03, -0.01))
    at, heights, weights = at[:count], heights[:count], np.linspace(0.0, 1.0, count)
    heights = heights + 0.01 * np.random.default_rng(4).standard_normal(count)
    rows, kept, error = np.array([terms(one) for one in at]), weights, 0.005
    for _ in range(3):
        by, believed = error / BENT_SIGMA, -GAIN * np.array([1 / CROWN_MM[0], 1 / CROWN_MM[1], 0.0])
        all_rows = np.vstack([np.sqrt(kept)[:, None] * rows, np.hstack([np.zeros((3, 3)), by * np.eye(3)])])
        shown = np.linalg.lstsq(all_rows, np.append(np.sqrt(kept) * heights, by * believed))[0]
        off = heights - rows @ shown
        error = float(np.median(np.abs(off[1:]))) / 0.674  # the first weighs nothing
        assert error > LEAST_ERROR_MM
        kept = weights / (1.0 + (off / (FAR * error)) ** 2) ** 2
    plane = plane_of(at, heights, weights)
    assert plane.shown == pytest.approx(shown, rel=1e-6, abs=1e-10)
    expected = np.linalg.inv(all_rows.T @ all_rows) * error**2 * CORRELATED
    assert plane.shown_variance == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_a_flat_tape_is_fitted_to_its_surface_with_a_gain_that_the_crown_shows() -> None:
    """By generalised least squares: height, slopes, and the gain's prior explain the surface's six numbers."""
    plane = plane_of(*tops((0.3, -0.2)))
    shown, crown = plane.shown, np.array([1 / CROWN_MM[0], 1 / CROWN_MM[1], 0.0])
    to_shown = np.eye(6, 4)
    to_shown[3:, 3] = -crown
    known = np.linalg.inv(plane.shown_variance + FLAT_TOLERANCE**2 * np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]))
    prior = np.diag([0.0, 0.0, 0.0, GAIN_SIGMA**-2])
    covariance = np.linalg.inv(to_shown.T @ known @ to_shown + prior)
    at = covariance @ (to_shown.T @ known @ shown + prior @ [0.0, 0.0, 0.0, GAIN])
    assert plane.flat and plane.gain == pytest.approx(at[3])
    assert plane.rise == pytest.approx(at[:3] / at[3])
    rates = np.hstack([np.eye(3), -plane.rise[:, None]]) / at[3]
    errors = rates @ covariance @ rates.T
    errors[1:, 1:] += np.diag(SLOPE_FLOOR**2 + (SLOPE_SHARE * plane.rise[1:]) ** 2)
    assert plane.covariance == pytest.approx(errors, rel=1e-6)


def test_a_bent_tape_is_not_flat_and_its_slope_is_that_of_the_image_s_centre() -> None:
    plane = plane_of(*tops((0.02, 0.01), GAIN, 1 / 15.7))
    assert not plane.flat
    assert plane.rise[1:] == pytest.approx([0.02, 0.01], abs=0.002)
    assert -plane.shown[4] / GAIN == pytest.approx(1 / 15.7 + 1 / CROWN_MM[1], rel=0.05)


def test_only_a_tape_that_is_bent_about_one_axis_has_a_bend() -> None:
    bent = plane_of(*tops((0.02, 0.01), GAIN, 1 / 15.7)).bend
    assert bent is not None and bent.curvature == pytest.approx(-1 / 15.7, rel=0.05)
    assert np.abs(bent.across) == pytest.approx([0.0, 1.0], abs=0.02)
    # by less than a gel's crown may be off
    assert plane_of(*tops((0.0, 0.0), GAIN, 0.0035)).bend is None
    # where no crown is known, that along the axis is taken for that across: 1/189 for 1/113
    other = plane_of(*tops((0.02, 0.01), GAIN, 1 / 15.7), crown_mm=None)
    assert other.bend is not None and not other.known and other.bend.curvature_sigma > bent.curvature_sigma
    assert other.bend.curvature == pytest.approx(-1 / 15.7 - 1 / CROWN_MM[1] + 1 / CROWN_MM[0], abs=0.001)
    assert plane_of(*tops((0.02, 0.01), GAIN, 0.001), crown_mm=None).bend is None
    # a dome may slope as in the contact's middle, 3.2 mm from the image's centre
    at, heights, weights = tops((0.0, 0.0), GAIN)
    dome = plane_of(at, heights - GAIN * (at**2).sum(axis=1) / 40.0, weights)
    assert dome.bend is None and not dome.flat
    assert np.sqrt(dome.covariance[1:, 1:].diagonal()) == pytest.approx(np.hypot(*at.mean(axis=0)) / 20.0, rel=0.05)


@pytest.mark.parametrize(("crown_mm", "roundness"), [(CROWN_MM, 0.0), (None, ROUNDNESS)])
def test_a_bend_is_as_sure_as_its_surface_and_the_crown_s_roundness(
    crown_mm: tuple[float, float] | None, roundness: float
) -> None:
    at, heights, weights = tops((0.02, 0.01), GAIN, 0.03)
    plane = plane_of(at, heights, weights, crown_mm=crown_mm)
    assert plane.bend is not None
    x, y = at.mean(axis=0)
    of_surface = plane.shown_variance[1:, 1:] / GAIN**2 + np.diag([0.0, 0.0, roundness**2, roundness**2, 0.0])
    along = np.array([-1.0, 0.0, -x, 0.0, -y])  # the axis is along u
    gain_error = GAIN_SIGMA / GAIN
    assert plane.bend.along_sigma == pytest.approx(
        np.hypot(np.sqrt(along @ of_surface @ along), gain_error * plane.bend.along), rel=0.02
    )
    of_curvature = np.hypot(np.sqrt(of_surface[3, 3]), gain_error * plane.bend.curvature)
    assert plane.bend.curvature_sigma == pytest.approx(of_curvature, rel=0.02)
    across = np.array([0.0, 1.0, 0.0, y, x])
    saddle = 0.0 if crown_mm is not None else 1.0 / CROWN_MM[1] - 1.0 / CROWN_MM[0]
    slope = np.hypot(np.sqrt(across @ of_surface @ across), gain_error * (0.01 - y * (0.03 + saddle)))
    assert plane.bend.angle_sigma == pytest.approx(slope, rel=0.05)


@pytest.mark.parametrize(("along", "is_bent"), [(0.0095, True), (0.012, False)])
def test_a_curvature_along_the_axis_within_two_deviations_is_none(along: float, is_bent: bool) -> None:
    """Of 0.002 + 2 x 0.004 of the tape's curvatures, which are those shown over the gain and less the crown's."""
    crown = np.array([1 / CROWN_MM[0], 1 / CROWN_MM[1], 0.0])
    shown = GAIN * np.array([0.3, 0.0, 0.0, -along - crown[0], -0.03 - crown[1], 0.0])
    variance = GAIN**2 * np.diag([0.0, 1e-6, 1e-6, 0.003**2, 0.004**2, 0.001**2])
    bend, known = _bend(shown, variance, crown, np.zeros(2), 0.0)
    assert (bend is not None) == is_bent
    if bend is not None:
        assert known and bend.curvature == pytest.approx(-0.03) and bend.curvature_sigma == pytest.approx(0.004)


@pytest.mark.parametrize(
    ("curvatures", "level"),
    [
        ((-0.005, -0.001, 0.0), None),  # bent by 0.004, which is no bend
        ((-0.006, -0.001, 0.0), None),  # nor is 0.005
        ((-0.0065, -0.001, 0.0), 0.001),
        ((-0.001, -0.0065, 0.0), 0.001),
        ((-0.0115, -0.0055, 0.0), 0.0055),
        ((-0.0125, -0.0065, 0.0), None),  # a crown that is more than the bend beside it
        ((-0.0295, -0.0095, 0.0), 0.0095),
        ((-0.0305, -0.0105, 0.0), None),  # more than any gel's
        ((-0.0285, 0.0015, 0.0), -0.0015),
        ((-0.0275, 0.0025, 0.0), None),  # hollow
        ((0.0285, -0.0015, 0.0), 0.0015),
        ((-0.00375, -0.00375, 0.00275), 0.001),  # turned by 45 degrees
    ],
)
def test_a_crown_that_leaves_a_tape_bent_about_one_axis(curvatures: tuple[float, float, float], level: float | None) -> None:
    assert level_of(np.array(curvatures)) == (None if level is None else pytest.approx(level))


@pytest.mark.parametrize(
    ("curvature", "crown_mm", "share"),
    [(0.0, CROWN_MM, 0.0), (0.01, CROWN_MM, 0.5), (0.015, CROWN_MM, 0.25), (0.03, CROWN_MM, 0.0), (0.03, None, 0.5)],
)
def test_wide_bends_and_those_beside_an_unknown_crown_may_be_domes(
    curvature: float, crown_mm: tuple[float, float] | None, share: float
) -> None:
    assert dome_of(plane_of(*tops((0.02, 0.01), GAIN, curvature), crown_mm=crown_mm)) == pytest.approx(share, abs=0.06)


@pytest.mark.parametrize(("level", "share"), [(0.0, 0.0), (0.002, 0.25), (0.006, 0.5)])
def test_tops_that_are_bent_along_the_axis_too_may_be_those_of_a_dome(level: float, share: float) -> None:
    at, _, weights = tops((0.0, 0.0))
    bent_mm = 0.3 - GAIN * (0.03 * at[:, 1] ** 2 + level * at[:, 0] ** 2) / 2.0
    assert dome_of(plane_of(at, bent_mm, weights, crown_mm=None)) == pytest.approx(share, abs=0.06)


def test_tops_of_no_film_say_how_unsure_their_slope_is() -> None:
    """Domes beside the image's centre, as the imprint model has: by tops alone they lie level in their middle, or slope there."""
    scene, told = Scene(contact_offset_mm=(3.0, -2.0), contact_mm=(7.0, 7.0), tilt_mm_per_mm=(0.0, 0.0)), []
    for frame in iterate_frames(TAPE, 3, 3, scene=scene):
        fix = located(frame)
        assert fix.tilt_deg is not None and fix.tilt_covariance is not None
        error = np.radians(fix.tilt_deg)
        told.append(error @ np.linalg.solve(fix.tilt_covariance, error) / 2)
        assert np.hypot(*fix.tilt_deg) > 4.0
    assert np.mean(told) < 2.0  # it was 150


def test_one_top_that_is_none_moves_nothing() -> None:
    at, heights, weights = tops((0.03, 0.0))
    heights[7] += 0.2
    assert plane_of(at, heights, weights).rise[1:] == pytest.approx([0.03, 0.0], abs=0.002)


def test_without_the_crown_slopes_are_less_sure() -> None:
    known, unknown = plane_of(*tops((0.03, 0.0))), plane_of(*tops((0.03, 0.0)), crown_mm=None)
    assert not unknown.flat and unknown.covariance[1, 1] > 4 * known.covariance[1, 1]


def test_tops_close_together_leave_the_curvature_to_the_gel_s_own() -> None:
    """0.4 mm wide they hardly show any, so that what was believed of it counts: it moves nothing that agrees with it."""
    at = np.array((3.0, -1.0)) + np.random.default_rng(2).uniform(-0.2, 0.2, (12, 2))
    shown = GAIN * np.array([0.3, 0.03, -0.02, -1 / CROWN_MM[0], -1 / CROWN_MM[1], 0.0])
    tops_mm = np.array([terms(one) @ shown for one in at])
    assert plane_of(at, tops_mm, np.ones(12)).shown == pytest.approx(shown, abs=1e-6)


def test_few_tops_or_tops_in_a_line_are_no_plane_to_be_sure_of() -> None:
    at, heights, weights = tops((0.03, 0.0))
    assert fit_plane(at[:7], heights[:7], weights[:7], CROWN_MM) is None
    line = np.column_stack([np.linspace(-4, 4, 40), np.zeros(40)])
    found = fit_plane(line, heights, weights, CROWN_MM)
    assert found is None or found.covariance[2, 2] > 0.02**2


# Frames


@cache
def localizer(sensor: SensorProfile = SENSOR) -> Localizer:
    return Localizer([TAPE], sensor=sensor)


@cache
def frame_of(force_n: float, **options: Any) -> Frame:
    return next(iterate_frames(TAPE, 1, 21, scene=Scene(elastic=ElasticContact(force_n=force_n, **options))))


def located(frame: Frame, sensor: SensorProfile = SENSOR) -> Localization:
    fix = localizer(sensor).locate(frame.depth)
    assert fix.located
    return fix


@pytest.mark.parametrize("tilt_deg", [(0.0, 0.0), (2.0, 0.0), (0.0, -2.0), (5.0, 0.0), (-3.5, 3.5)])
@pytest.mark.parametrize("force_n", [1.0, 5.0])
def test_tilt_and_force_of_a_press_are_found(tilt_deg: tuple[float, float], force_n: float) -> None:
    frame = frame_of(force_n, tilt_deg=tilt_deg)
    fix = located(frame)
    assert fix.tilt_deg is not None and fix.tilt_covariance is not None and fix.force_n is not None
    off = np.radians(np.asarray(fix.tilt_deg) - tilt_deg)
    assert np.degrees(np.abs(off)).max() < (0.1 if tilt_deg == (0.0, 0.0) else 0.3)
    assert off @ np.linalg.solve(fix.tilt_covariance, off) < 20.0
    assert fix.force_n == pytest.approx(force_n, rel=0.1)
    error = np.asarray(fix.position_mm) - frame.position_mm
    assert fix.covariance is not None and error @ np.linalg.solve(fix.covariance[:2, :2], error) < 30.0


def test_a_cylinder_is_felt_without_tilt() -> None:
    fix = located(frame_of(2.0, cylinder_radius_mm=30.0))
    assert fix.tilt_deg is not None and np.abs(fix.tilt_deg).max() < 0.2
    assert fix.contact is not None and fix.contact.plane is not None and not fix.contact.plane.flat
    assert fix.force_n == pytest.approx(2.0, rel=0.1)


def test_indentation_grows_with_force() -> None:
    found = [located(frame_of(force_n)).indentation_mm for force_n in (1.0, 2.0, 5.0)]
    assert 0.1 < found[0] < found[1] < found[2] < 0.6  # type: ignore[operator]


def test_a_frame_without_a_zero_says_the_same_by_what_lies_beside_the_contact() -> None:
    frame = frame_of(2.0)
    fix, bare = located(frame), located(replace(frame, depth=frame.depth - frame.depth.mean()))
    assert bare.tilt_deg == pytest.approx(fix.tilt_deg, abs=1e-3)
    assert bare.force_n == pytest.approx(2.0, rel=0.1)
    assert bare.indentation_mm == pytest.approx(fix.indentation_mm, abs=0.03)
    unknown = replace(SENSOR, gel=replace(SENSOR.gel, modulus_kpa=None))
    blind = located(replace(frame, depth=frame.depth - frame.depth.mean()), unknown)
    assert (blind.indentation_mm, blind.force_n) == (None, None) and blind.tilt_deg is not None


def test_a_force_that_is_no_number_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where rounding leaves nothing of a frame in another unit."""
    monkeypatch.setattr(surface, "force_on", lambda *_: ((np.nan, np.nan), (0.0, 0.001)))
    fix = located(frame_of(2.0))
    assert (fix.force_n, fix.force_sigma_n, fix.indentation_mm) == (None, None, None) and fix.tilt_deg is not None


def test_depths_are_in_the_profile_s_unit() -> None:
    frame = frame_of(2.0)
    fix, half = located(frame), located(replace(frame, depth=2 * frame.depth), replace(SENSOR, depth_unit_mm=0.5))
    assert half.tilt_deg == pytest.approx(fix.tilt_deg, abs=1e-3)
    assert half.force_n == pytest.approx(fix.force_n, rel=1e-3)


def test_pixels_outside_the_mask_say_nothing() -> None:
    frame = frame_of(1.0)
    mask = np.zeros(frame.depth.shape, dtype=bool)
    mask[16:-16, 16:-16] = True
    wrong = replace(frame, depth=np.where(mask, frame.depth, np.float32(0.5)))
    fix = located(wrong, replace(SENSOR, mask=mask))
    assert fix.force_n == pytest.approx(1.0, rel=0.1)


def test_what_is_not_observable_is_null() -> None:
    frame = frame_of(2.0)
    uncalibrated = located(frame, replace(SENSOR, depth_unit_mm=None))
    lost = localizer().locate(np.zeros_like(frame.depth))
    by_dots = localizer().locate_dots(dots())
    assert by_dots.located and not lost.located
    for fix in (uncalibrated, lost, by_dots):
        assert [getattr(fix, name) for name in NOTHING] == [None] * 6
    gel_unknown = located(frame, replace(SENSOR, gel=Gel()))
    assert (gel_unknown.force_n, gel_unknown.force_sigma_n) == (None, None)
    assert gel_unknown.tilt_deg is not None and gel_unknown.indentation_mm is not None


@pytest.mark.parametrize(
    "change", [lambda d: d - 1.0, lambda d: d - 1000.0, lambda d: d + 1000.0, lambda d: ((d - d.min()) * 5e4).astype(np.uint16)]
)
def test_a_frame_that_counts_from_elsewhere_or_in_another_unit_says_no_depth(change: Callable[[Any], Any]) -> None:
    frame = frame_of(2.0)
    fix = located(replace(frame, depth=change(frame.depth)))
    assert [getattr(fix, name) for name in NOTHING[2:]] == [None] * 4
    assert fix.position_mm == pytest.approx(frame.position_mm, abs=0.02)
    assert fix.transform("texture", origin="gel") is None


@pytest.mark.parametrize(
    "change",
    [lambda d: ((d - d.min()) * 5e4).astype(np.uint16), lambda d: d + np.linspace(0, 40, d.shape[1]), lambda d: d / 1000.0],
)
def test_a_frame_in_another_unit_says_no_tilt(change: Callable[[Any], Any]) -> None:
    frame = frame_of(2.0)
    fix = located(replace(frame, depth=change(frame.depth)))
    assert [getattr(fix, name) for name in NOTHING] == [None] * 6
    upright = located(frame, replace(SENSOR, depth_unit_mm=None))
    pose, covariance = fix.transform("board"), fix.covariance6("board")
    assert pose is not None and covariance is not None
    assert pose == pytest.approx(upright.transform("board"), abs=1e-3)
    assert np.isinf(covariance.diagonal()[2:5]).all()


def test_the_mapping_is_plain_json() -> None:
    told = json.loads(json.dumps(located(frame_of(2.0)).to_mapping(0), allow_nan=False))
    assert np.shape(told["tilt_deg"]) == (2,) and np.shape(told["tilt_covariance"]) == (2, 2)
    assert told["force_n"] > told["force_sigma_n"] > 0 and told["indentation_mm"] > told["indentation_sigma_mm"] > 0
    assert "contact" not in told


@pytest.mark.parametrize("tilt_deg", [(0.0, 0.0), (5.0, 0.0)])
def test_a_tilt_changes_no_decision(tilt_deg: tuple[float, float]) -> None:
    frame = frame_of(2.0, tilt_deg=tilt_deg)
    fix, blind = located(frame), located(frame, replace(SENSOR, depth_unit_mm=None))
    for name in ("tape", "cell", "n_agree", "p_tape", "p_place", "contact_mm"):
        assert getattr(fix, name) == getattr(blind, name)
    assert fix.covariance is not None and blind.covariance is not None
    same = fix.position_mm == blind.position_mm and (fix.covariance == blind.covariance).all()
    assert same if tilt_deg == (0.0, 0.0) else not same


@costly
@pytest.mark.parametrize(("v_deg", "radius_mm"), [(-2.0, None), (2.0, 30.0)])
def test_a_tilted_contact_is_where_it_is(v_deg: float, radius_mm: float | None) -> None:
    """Pressure draws no dot whose edges are seen: with depths in millimetres, and without them, when nothing tells the tilt."""
    press = ElasticContact(force_n=0.5, tilt_deg=(0.0, v_deg), cylinder_radius_mm=radius_mm)
    frames = list(iterate_frames(TAPE, 6, 3, scene=Scene(elastic=press, slope_noise=0.032)))
    off, squares = [], []
    for sensor in (SENSOR, replace(SENSOR, depth_unit_mm=None)):
        localizer = Localizer([TAPE], sensor, refine="dots")
        for frame in frames:
            fix = localizer.locate(frame.depth)
            assert fix.position_mm is not None and fix.covariance is not None
            error, turn = np.asarray(fix.position_mm) - frame.position_mm, np.radians(frame.theta_deg)
            c, s = np.cos(turn), np.sin(turn)
            off.append(s * error[0] + c * error[1])
            squares.append(error @ np.linalg.solve(fix.covariance[:2, :2], error) / 2)
    assert np.abs(np.mean(np.reshape(off, (2, 6)), axis=1)).max() < 0.005  # by maxima 7 and 6 um, without millimetres 14 and 11
    assert max(np.mean(squares[:6]), np.mean(squares[6:])) < 3.5  # 1 within five standard deviations


def test_a_tilted_contact_stays_at_its_dots() -> None:
    """What draws the tops is told by the heights of dots; pixels are not put back by it."""
    frame = frame_of(2.0, tilt_deg=(2.0, 0.0))
    dots, pixels = (Localizer([TAPE], SENSOR, refine=refine).locate(frame.depth) for refine in ("dots", "pixels"))
    assert pixels.refined == "dots" and "tilted" in str(pixels.refine_reason)
    assert pixels.position_mm == dots.position_mm and np.array_equal(np.asarray(pixels.covariance), np.asarray(dots.covariance))


def errors_of(sensor: SensorProfile, scene: Scene, count: int, seed: int, refine: Refined) -> tuple[FloatArray, FloatArray]:
    """Errors of poses, mm, mm and rad, and NEES/3 of each."""
    localizer, errors, squares = Localizer([TAPE], sensor, refine=refine), [], []
    for frame in iterate_frames(TAPE, count, seed, scene=scene):
        fix = localizer.locate(frame.depth)
        errors.append(pose_error(fix, frame))
        squares.append(nees(fix, frame))
    return np.array(errors), np.array(squares)


@slow
def test_a_steep_contact_at_the_image_s_border_is_where_it_is() -> None:
    """All dots are then on one side of the image's centre, and the border cuts the contact off: poses were 20 um off per axis."""
    scene = Scene(elastic=ElasticContact(force_n=2.0, tilt_deg=(5.0, 0.0)), slope_noise=0.032)
    errors, squares = errors_of(SENSOR, scene, 12, 34, "dots")
    assert np.sqrt(np.mean(errors[:, :2] ** 2)) < 0.015
    assert squares.mean() < 2.0  # 1 within six standard deviations


@pytest.mark.parametrize("refine", ["dots", "pixels"])
def test_a_crown_that_no_pressure_goes_with_moves_no_pose(refine: Refined) -> None:
    """The imprint model has none: contacts beside the image's centre look tilted, and are not."""
    scene = Scene(contact_offset_mm=(4.0, 3.0), slope_noise=0.032)
    errors, squares = errors_of(SENSOR, scene, 12, 34, refine)
    plain, _ = errors_of(replace(SENSOR, gel=replace(SENSOR.gel, crown_mm=None)), scene, 12, 34, refine)
    assert np.abs(errors - plain).max() < 0.002
    assert squares.mean() < 2.0


def test_pixels_of_a_tilted_contact_are_left() -> None:
    frame = frame_of(2.0, tilt_deg=(0.0, -3.0))
    fix, by_dots = Localizer([TAPE], SENSOR, refine="pixels").locate(frame.depth), located(frame)
    assert fix.refined == "dots" and fix.refine_reason is not None and "tilted" in fix.refine_reason
    assert fix.position_mm == by_dots.position_mm


def test_the_answer_keeps_nothing_of_the_caller_s_frame() -> None:
    frame = frame_of(2.0)
    depth = frame.depth.copy()
    fix, again = localizer().locate(depth), located(frame)
    depth[:] = 0.0
    assert fix.tilt_deg == again.tilt_deg and fix.force_n == again.force_n
