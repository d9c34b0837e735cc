"""Pose of dots: who agrees, the posterior against dense matrices, and its covariance against what is drawn."""

from __future__ import annotations

from dataclasses import replace
from math import cos, exp, radians, sin
from typing import NamedTuple

import numpy as np
import pytest

from tactape_fab.sense import load_sensor
from tactape_fab.sense.decode.grid.beliefs import RIM_MM, Beliefs, beliefs_of
from tactape_fab.sense.decode.grid.pose import FEW_DOTS, LEAST_SIGMA_MM, LEAST_WEIGHT, Pose, _agreeing, fit_pose
from tactape_fab.sense.decode.grid.posterior import MOST_CORRELATED
from tactape_fab.sense.decode.rule import AGREE_SIGMAS
from tactape_fab.sense.geometry import Gel, Geometry, camera
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import BoolArray, FloatArray

R = 16.0
SENSOR = load_sensor("gelsight-mini")
STOCK = beliefs_of(SENSOR, fixed_scale=False)
FIXED = beliefs_of(SENSOR, fixed_scale=True)
EXACT = replace(STOCK, sigmas=np.zeros(4))
PLACE, THETA = np.array([20.0, 12.0]), 0.8
SPARSE = np.array([(2.6 * k, 2.6 * row) for row in range(-2, 3) for k in range(-3, 4)])
"""Dots too far apart to push each other, mm from the image centre."""


def turn_of(theta: float) -> FloatArray:
    c, s = cos(theta), sin(theta)
    return np.array([[c, s], [-s, c]])


def pose_dots(
    theta: float, position: tuple[float, float], rng: np.random.Generator, n: int = 30
) -> tuple[FloatArray, FloatArray]:
    offset = rng.uniform(-80, 80, (n, 2))
    return offset, np.asarray(position) + offset / R @ turn_of(theta).T


def contact(rng: np.random.Generator, middle: tuple[float, float] = (0.0, 0.0), radius_mm: float = 5.0) -> FloatArray:
    """Dots on a turned grid of 1.5 mm, displaced by 0.25 mm, within a radius of a contact's middle; (n, 2) mm."""
    k = np.stack(np.meshgrid(np.arange(-8, 9), np.arange(-8, 9)), axis=-1).reshape(-1, 2) + rng.uniform(0, 1, 2)
    shown = (1.5 * k + 0.25 * np.array([[0, -1], [0, 1], [-1, 0], [1, 0]])[rng.integers(0, 4, len(k))]) @ turn_of(
        rng.uniform(0, 7)
    )
    inside: FloatArray = shown[np.hypot(*shown.T) < radius_mm] + middle
    return inside


# Who agrees


class Agreeing(NamedTuple):
    """Who agrees, the weights for the pose's fit, and the robust fit: texture = t0 + factor (p - p0), a dot's error."""

    agree: BoolArray
    keep: FloatArray
    factor: complex
    p0: complex
    t0: complex
    sigma: float


def agreeing(offset: FloatArray, texture: FloatArray, weights: FloatArray, *, fixed: bool = False) -> Agreeing:
    """Five steps of a similarity by reweighted least squares, as complex numbers."""
    base = np.where(weights > LEAST_WEIGHT, np.minimum(weights, 1.0), 0.0)
    if np.count_nonzero(base) < 4:
        base = np.clip(weights, LEAST_WEIGHT, 1.0)
    p, t, keep = offset @ (1, 1j), texture @ (1, 1j), base.copy()
    for _ in range(5):
        p0, t0 = keep @ p / keep.sum(), keep @ t / keep.sum()
        factor = keep @ ((t - t0) * np.conj(p - p0)) / (keep @ np.abs(p - p0) ** 2)
        factor = factor / abs(factor) / R if fixed else factor
        distance = np.abs(t - t0 - factor * (p - p0))
        sigma = max(float(np.median(distance[base > 0])) / 1.177, LEAST_SIGMA_MM)
        keep = base / (1 + (distance / (2.5 * sigma)) ** 2) ** 2
    wider = np.maximum(1.0, 0.6 / np.maximum(base, 1e-9))
    agree: BoolArray = (base > 0) & (distance <= AGREE_SIGMAS * sigma * wider)
    if (count := np.count_nonzero(agree)) >= 4:
        keep = np.where(distance <= AGREE_SIGMAS * sigma * (1 + FEW_DOTS / count) * wider, base, 0.0)
    return Agreeing(agree, keep, complex(factor), complex(p0), complex(t0), sigma)


def agreeing_of_kernel(offset: FloatArray, texture: FloatArray, weights: FloatArray, *, fixed: bool = False) -> Agreeing:
    n = len(weights)
    fit, keep, agree = np.empty(7), np.empty(n), np.empty(n, dtype=np.bool_)
    _agreeing(offset, texture, weights, R, fixed, LEAST_SIGMA_MM, fit, keep, agree, np.empty((3, n)))
    c, s, u, v, x, y, sigma = fit.tolist()
    return Agreeing(agree, keep, complex(c, -s), complex(u, v), complex(x, y), sigma)


def assert_alike(found: Agreeing, expected: Agreeing) -> None:
    assert (found.agree == expected.agree).all() and found.keep == pytest.approx(expected.keep, rel=1e-6)
    for name in ("factor", "p0", "t0", "sigma"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-9), name


@pytest.mark.parametrize("seed", range(20))
def test_who_agrees_is_said_by_a_robust_similarity(seed: int) -> None:
    rng = np.random.default_rng(seed)
    offset, texture = pose_dots(rng.uniform(-3, 3), (5.0, 7.0), rng)
    offset = offset * rng.uniform(0.95, 1.05, 2) + rng.normal(0, 0.4, offset.shape)
    offset[:4] += rng.choice([-5.0, 5.0], (4, 2))
    weights = rng.uniform(0.05, 1.2, 30)
    expected = agreeing(offset, texture, weights)
    pose = fit_pose(offset, texture, weights, R, replace(STOCK, gel_mm=0.1 * (seed % 2), correlation_mm=4.0))
    assert (pose.agree == expected.agree).all() and 10 < expected.agree.sum() < 30
    assert_alike(agreeing_of_kernel(offset, texture, weights), expected)
    fixed = agreeing(offset, texture, weights, fixed=True)
    assert_alike(agreeing_of_kernel(offset, texture, weights, fixed=True), fixed)
    assert (fit_pose(offset, texture, weights, R, FIXED).agree == fixed.agree).all()


@pytest.mark.parametrize("whole", [2, 3, 4, 5, 6])
def test_of_few_whole_dots_the_faint_ones_count_as_well(whole: int) -> None:
    """From four whole dots on those that are likelier noise are left out, be they right or not."""
    rng = np.random.default_rng(whole)
    offset, texture = pose_dots(0.4, (5.0, 7.0), rng, whole + 3)
    offset += rng.normal(0, 0.1, offset.shape)
    weights = np.where(np.arange(len(offset)) < whole, 1.0, (LEAST_WEIGHT - 0.05))
    found = agreeing_of_kernel(offset, texture, weights)
    assert_alike(found, agreeing(offset, texture, weights))
    assert (found.keep[whole:] > 0.0).any() == (whole < 4)


@pytest.mark.parametrize(("right", "robust"), [(3, True), (4, False)])
def test_four_that_agree_keep_their_own_weights(right: int, robust: bool) -> None:
    """Two others are off by metres, each to its side: three that agree keep the robust weights, which are smaller."""
    rng = np.random.default_rng(1)
    offset, texture = pose_dots(0.4, (5.0, 7.0), rng, right + 2)
    texture += rng.normal(0, 0.02, texture.shape)
    texture[right:] += [(3000.0, 0.0), (-3000.0, 0.0)]
    found = agreeing_of_kernel(offset, texture, np.full(right + 2, 0.9), fixed=True)
    assert found.agree.tolist() == [True] * right + [False] * 2
    assert found.keep[:right].max() < 0.9 if robust else found.keep.tolist() == [0.9] * right + [0.0] * 2


def test_dots_that_are_far_off_do_not_agree_and_do_not_matter() -> None:
    rng = np.random.default_rng(3)
    offset, texture = pose_dots(-2.0, (5.0, 7.0), rng)
    offset += rng.normal(0, 0.2, offset.shape)
    offset[:5] += rng.choice([-7.0, 7.0], (5, 2))
    pose = fit_pose(offset, texture, np.ones(30), R, STOCK)
    assert not pose.agree[:5].any() and pose.agree[5:].sum() >= 24
    assert np.hypot(*(pose.position_mm - (5.0, 7.0))) < 0.015


# The mean


@pytest.mark.parametrize("theta_deg", [0.0, 30.0, 179.9, -120.0])
def test_exact_dots_give_the_exact_pose(theta_deg: float) -> None:
    offset = SPARSE * R + (3.0, -8.0)
    texture = PLACE + offset / R @ turn_of(radians(theta_deg)).T
    pose = fit_pose(offset, texture, np.ones(len(offset)), R, STOCK)
    assert pose.position_mm == pytest.approx(PLACE, abs=1e-9)
    assert np.degrees(pose.theta_rad) == pytest.approx(theta_deg, abs=1e-7)
    assert pose.px_per_mm == pytest.approx(R)
    assert pose.agree.all()


def test_another_scale_is_believed_unless_it_is_fixed() -> None:
    rng = np.random.default_rng(2)
    offset, texture = pose_dots(0.3, (20.0, 12.0), rng)
    offset = offset * 1.05 + rng.normal(0, 0.2, offset.shape)
    free = fit_pose(offset, texture, np.ones(30), R, STOCK)
    assert free.px_per_mm == pytest.approx(R * 1.05, rel=3e-3)
    assert free.position_mm == pytest.approx([20.0, 12.0], abs=0.02)
    assert fit_pose(offset, texture, np.ones(30), R, FIXED).px_per_mm == R


def seen_through(at_mm: FloatArray, geometry: Geometry, scale: float = R) -> FloatArray:
    """Pixels from the image centre of points on the gel, through a camera."""
    true = camera((scale, scale), (SENSOR.width_px, SENSOR.height_px), geometry)
    return true.to_px(at_mm) - true.to_px(np.zeros(2))


BENT = Geometry(aspect=-0.04, shear=0.025, k1=0.04)


def test_a_camera_off_its_profile_is_found_out() -> None:
    offset = seen_through(SPARSE, BENT, 1.02 * R)
    pose = fit_pose(offset, PLACE + SPARSE @ turn_of(THETA).T, np.ones(len(offset)), R, replace(STOCK, sigmas=10 * STOCK.sigmas))
    assert pose.position_mm == pytest.approx(PLACE, abs=1e-4)
    assert pose.theta_rad == pytest.approx(THETA, abs=1e-4)
    assert pose.px_per_mm == pytest.approx(1.02 * R, rel=1e-4)


def profile_of(geometry: Geometry, gel: Gel) -> SensorProfile:
    return replace(SENSOR, geometry=geometry, gel=gel)


@pytest.mark.parametrize("displacement_um", [0.0, 100.0])
@pytest.mark.parametrize("centre", [None, (140.0, 150.0)])
def test_the_posterior_is_that_of_dense_matrices(displacement_um: float, centre: tuple[float, float] | None) -> None:
    """All unknowns and all errors of dots as one normal vector; derivatives by differences of the profile's own camera."""
    rng = np.random.default_rng(11)
    known = Geometry(center_px=centre, sigma_px_per_mm=0.05, sigma_aspect=0.004, sigma_shear=0.003, sigma_k1=0.01)
    sensor = profile_of(known, Gel(displacement_um=displacement_um, correlation_mm=3.0))
    offset = seen_through(SPARSE, replace(known, aspect=0.003, shear=-0.002, k1=0.006), 1.002 * R)
    offset = offset + rng.normal(0, 0.3, offset.shape)
    texture, weights = PLACE + SPARSE @ turn_of(THETA).T, np.where(np.arange(len(SPARSE)) % 3 == 0, 1 - 1e-6, 1.0)
    pose = fit_pose(offset, texture, weights, R, beliefs_of(sensor, fixed_scale=False))

    def on_texture(x: FloatArray) -> FloatArray:
        scale = R * exp(x[3])
        cam = camera((scale, scale), (320, 240), Geometry(aspect=x[4], shear=x[5], k1=x[6], center_px=centre))
        q = cam.from_px(offset + SENSOR.centre_px) - cam.from_px(SENSOR.centre_px)
        return np.asarray((x[:2] + q @ turn_of(x[2]).T).T.ravel())

    known_by = np.diag([0.0, 0.0, 0.0, *(1.0 / np.square([0.05 / R, 0.004, 0.003, 0.01]))])
    squares = ((offset[:, None] - offset) ** 2).sum(axis=-1) / R**2
    one = np.diag(pose.sigma_mm**2 / np.sqrt(weights) + RIM_MM**2 * (1 - weights) ** 1.75)
    one = one + (displacement_um / 1000) ** 2 * np.exp(-squares / 18.0)
    none = np.zeros_like(one)
    errors = np.block([[one, none], [none, one]])
    x = np.array([*PLACE, THETA, 0.0, 0.0, 0.0, 0.0])
    for _ in range(6):
        steps = np.diag(np.full(7, 1e-6))
        derivatives = np.stack([(on_texture(x + d) - on_texture(x - d)) / 2e-6 for d in steps], axis=1)
        every = np.linalg.inv(derivatives.T @ np.linalg.inv(errors) @ derivatives + known_by)
        left = derivatives.T @ np.linalg.inv(errors) @ (texture.T.ravel() - on_texture(x))
        x = x + every @ (left - known_by @ x)
    expected = every[:3, :3]
    spread = np.sqrt(np.diag(expected))
    assert pose.agree.all()
    assert (np.abs(pose.position_mm - x[:2]) < 0.02 * spread[:2]).all()
    assert abs(pose.theta_rad - x[2]) < 0.02 * spread[2]
    assert pose.px_per_mm == pytest.approx(R * exp(x[3]), rel=2e-5)
    assert np.abs(pose.covariance - expected).max() < 0.03 * np.outer(spread, spread).max()
    assert np.abs((pose.covariance - expected) / np.outer(spread, spread)).max() < 0.03


# The covariance


@pytest.mark.parametrize(
    ("geometry", "middle", "radius_mm", "displacement_um", "sigma_mm", "scale"),
    [
        (Geometry(), (0.0, 0.0), 5.0, 0.0, 0.018, 1.0),
        (Geometry(), (4.0, 3.0), 5.0, 0.0, 0.006, 1.01),
        (Geometry(aspect=0.05), (3.0, 2.0), 5.0, 0.0, 0.018, 1.0),
        (Geometry(shear=0.02), (0.0, 0.0), 5.0, 0.0, 0.018, 1.0),
        (Geometry(k1=0.05), (3.0, 2.0), 5.0, 0.0, 0.018, 0.98),
        (Geometry(), (0.0, 0.0), 2.5, 0.0, 0.1, 1.0),
        (Geometry(), (1.0, 0.0), 4.0, 100.0, 0.018, 1.0),
    ],
    ids=["default", "off-centre", "aspect", "shear", "lens", "few dots", "gel"],
)
def test_the_covariance_is_true(
    geometry: Geometry,
    middle: tuple[float, float],
    radius_mm: float,
    displacement_um: float,
    sigma_mm: float,
    scale: float,
) -> None:
    rng = np.random.default_rng(5)
    beliefs = beliefs_of(profile_of(Geometry(), Gel(displacement_um=displacement_um)), fixed_scale=False)
    squares = []
    for _ in range(300):
        at = contact(rng, middle, radius_mm)
        theta = rng.uniform(-3, 3)
        texture = PLACE + at @ turn_of(theta).T
        apart = ((at[:, None] - at) ** 2).sum(axis=-1)
        gel = (displacement_um / 1000) ** 2 * np.exp(-apart / 32.0) + 1e-12 * np.eye(len(at))
        shown = at + np.linalg.cholesky(gel) @ rng.normal(size=at.shape) + rng.normal(0, sigma_mm, at.shape)
        pose = fit_pose(seen_through(shown, geometry, scale * R), texture, np.ones(len(at)), R, beliefs)
        error = np.array([*(pose.position_mm - PLACE), np.angle(np.exp(1j * (pose.theta_rad - theta)))])
        squares.append(error @ np.linalg.solve(pose.covariance, error) / 3)
    # of 300 frames the mean scatters by 0.05, more with few dots: t of few degrees of freedom has long tails
    assert 0.8 < np.mean(squares) < 1.25


def test_what_is_exact_is_no_part_of_the_covariance() -> None:
    rng = np.random.default_rng(8)
    offset = SPARSE * R + rng.normal(0, 0.3, SPARSE.shape)
    texture, ones = PLACE + SPARSE @ turn_of(THETA).T, np.ones(len(SPARSE))
    wide, exact = (fit_pose(offset + np.array([70.0, 40.0]), texture, ones, R, beliefs) for beliefs in (STOCK, EXACT))
    assert (np.linalg.eigvalsh(wide.covariance - 1.001 * exact.covariance) > -1e-12).all()
    u, v = (SPARSE + np.array([70.0, 40.0]) / R).T
    one, none = np.ones(len(u)), np.zeros(len(u))
    rows = np.concatenate([np.stack([one, none, v], axis=1), np.stack([none, one, -u], axis=1)])
    turned = np.eye(3)
    turned[:2, :2] = turn_of(exact.theta_rad)
    expected = turned @ np.linalg.inv(rows.T @ rows) @ turned.T * exact.sigma_mm**2
    assert exact.covariance == pytest.approx(expected, rel=0.02, abs=1e-3 * np.abs(expected).max())


def test_neighbours_that_push_each_other_add_no_error() -> None:
    rng = np.random.default_rng(9)
    at = contact(rng)
    apart = at[:, None] - at
    squares = (apart**2).sum(axis=-1) + 1e3 * np.eye(len(at))
    push = (apart * np.exp((1.0 - squares) / (2 * 0.43**2))[..., None]).sum(axis=1)
    pose, still = (
        fit_pose((at + amount * push + rng.normal(0, 0.01, at.shape)) * R, PLACE + at, np.ones(len(at)), R, STOCK)
        for amount in (0.03, 0.0)
    )
    assert 0.03 * np.sqrt((push**2).mean()) > 0.01
    assert pose.agree.sum() >= len(at) - 3 and still.agree.all()
    assert pose.sigma_mm < 0.013 and still.sigma_mm < 0.013


# Degenerate dots


def finite_or_open(pose: Pose) -> bool:
    """A pose with numbers and a proper covariance, or none at all."""
    assert pose.finite == bool(np.isfinite(pose.position_mm).all() and np.isfinite(pose.covariance).all())
    assert (pose.position_mm.shape, pose.covariance.shape, pose.camera.shape) == ((2,), (3, 3), (2, 3))
    if np.isfinite(pose.position_mm).all():
        return bool(np.isfinite(pose.covariance).all() and (np.linalg.eigvalsh(pose.covariance) > 0).all())
    return bool(np.isinf(pose.covariance).any() and np.isnan(pose.theta_rad))


@pytest.mark.parametrize("gel_mm", [0.0, 0.1])
@pytest.mark.parametrize("beliefs", [STOCK, FIXED, EXACT], ids=["stock", "fixed", "exact"])
@pytest.mark.parametrize(
    "at",
    [
        np.zeros((8, 2)),
        np.full((8, 2), 3.0),
        SPARSE[:1],
        SPARSE[:2],
        SPARSE[:3],
        np.array([[0.0, 0.0], [1.5, 0.0], [0.0, 1.5], [1.5, 1.5]]),
        np.array([[1.5 * k, 0.0] for k in range(8)]),
        np.array([[0.0, 1.5 * k] for k in range(8)]),
    ],
    ids=["centre", "one place", "1", "2", "3", "4", "row", "column"],
)
def test_degenerate_dots_give_a_pose_or_say_that_they_do_not(at: FloatArray, beliefs: Beliefs, gel_mm: float) -> None:
    known = replace(beliefs, gel_mm=gel_mm, correlation_mm=4.0)
    for texture in (PLACE + at, PLACE + at + np.random.default_rng(1).normal(0, 0.02, at.shape)):
        pose = fit_pose(at * R, texture, np.ones(len(at)), R, known)
        assert finite_or_open(pose)
        if len(at) >= 4 and np.ptp(at) > 1.0:
            assert np.hypot(*(pose.position_mm - PLACE)) < 0.2 and np.isfinite(pose.covariance).all()


def test_light_dots_and_many_dots_give_a_pose() -> None:
    rng = np.random.default_rng(4)
    at = rng.uniform(-9.0, 9.0, (3 * MOST_CORRELATED, 2))
    for beliefs in (STOCK, replace(STOCK, gel_mm=0.05, correlation_mm=4.0)):
        pose = fit_pose(at * R, PLACE + at + rng.normal(0, 0.02, at.shape), rng.uniform(0.0, 1.0, len(at)), R, beliefs)
        assert finite_or_open(pose) and np.hypot(*(pose.position_mm - PLACE)) < 0.15
    faint = fit_pose(SPARSE * R, PLACE + SPARSE, np.full(len(SPARSE), 1e-3), R, STOCK)
    assert faint.position_mm == pytest.approx(PLACE, abs=0.01)


def test_of_many_dots_on_a_gel_that_gives_those_of_most_weight_are_used() -> None:
    """Lighter ones are off by 10 um: without a gel that gives they count, with one they are left out."""
    rng = np.random.default_rng(6)
    at, light = rng.uniform(-9.0, 9.0, (MOST_CORRELATED + 40, 2)), np.arange(MOST_CORRELATED + 40) % 3 == 1
    light[np.flatnonzero(light)[40:]] = False
    texture, weights = PLACE + at + (0.01, 0.0) * light[:, None], np.where(light, 0.9, 1.0)
    given = replace(EXACT, gel_mm=0.05, correlation_mm=4.0)
    stiff, gives = (fit_pose(at * R, texture, weights, R, beliefs, smoothed=False) for beliefs in (EXACT, given))
    assert np.count_nonzero(light) == 40 and stiff.agree.all() and gives.agree.all()
    assert gives.position_mm == pytest.approx(PLACE, abs=1e-9) and stiff.position_mm[0] - PLACE[0] > 0.001


def test_a_shift_that_all_dots_share_is_in_the_covariance() -> None:
    """By 0.1 mm along the image's u, times an unknown of variance 1."""
    rng = np.random.default_rng(7)
    offset, texture = SPARSE * R, PLACE + SPARSE @ turn_of(THETA).T + rng.normal(0, 0.01, SPARSE.shape)
    ones, along = np.ones(len(SPARSE)), turn_of(THETA) @ (1.0, 0.0)
    sure = fit_pose(offset, texture, ones, R, EXACT)
    unsure = fit_pose(offset, texture, ones, R, EXACT, unsure_px=np.tile([0.1 * R, 0.0], (len(SPARSE), 1)))
    assert (unsure.covariance - sure.covariance)[:2, :2] == pytest.approx(0.01 * np.outer(along, along), abs=1e-6)
    assert unsure.position_mm == pytest.approx(sure.position_mm, abs=1e-6)


def test_what_measured_places_are_unsure_by_is_each_dot_s_own() -> None:
    """Exact dots about the centre: the variance of their mean is that of one over their number."""
    n = len(SPARSE)
    pose = fit_pose(SPARSE * R, PLACE + SPARSE @ turn_of(THETA).T, np.ones(n), R, EXACT, placed_mm=np.full(n, 0.05))
    assert pose.covariance[:2, :2] == pytest.approx(0.05**2 / n * np.eye(2), rel=0.05, abs=1e-8)


def test_middles_between_edges_err_half_as_much_by_the_rim() -> None:
    """Exact dots of half a weight: all the error is the rim's."""
    weights = np.full(len(SPARSE), 0.5)
    fits = [fit_pose(SPARSE * R, PLACE + SPARSE @ turn_of(THETA).T, weights, R, EXACT, by_edges=by).fitted for by in (0.0, 1.0)]
    by_maxima, by_edges = (fit.errors_mm2 for fit in fits if fit is not None)
    assert by_maxima == pytest.approx(RIM_MM**2 * 0.5**1.75, rel=0.1)
    assert by_edges == pytest.approx(by_maxima / 4.0, rel=0.1)


# Places that nothing draws


def test_refined_places_have_variances_of_one_over_their_weights() -> None:
    rng, squares = np.random.default_rng(4), []
    for _ in range(300):
        gel = contact(rng, radius_mm=4.0)
        weights = rng.uniform(0.3, 1.0, len(gel))
        offset = R * (gel + 0.004 * rng.standard_normal(gel.shape) / np.sqrt(weights)[:, None])
        pose = fit_pose(offset, PLACE + gel @ turn_of(THETA).T, weights, R, EXACT, least_sigma_mm=0.0005, smoothed=False)
        error = np.array([*(pose.position_mm - PLACE), pose.theta_rad - THETA])
        squares.append(error @ np.linalg.solve(pose.covariance, error) / 3)
    assert 0.85 < np.mean(squares) < 1.15


def test_refined_places_are_not_pushed_back() -> None:
    rng = np.random.default_rng(2)
    gel = contact(rng)
    texture, weights = PLACE + gel @ turn_of(THETA).T, rng.uniform(0.7, 1.0, len(gel))
    refined, tops = (fit_pose(R * gel, texture, weights, R, EXACT, smoothed=smoothed) for smoothed in (False, True))
    assert np.abs(refined.position_mm - PLACE).max() < 1e-9
    assert np.abs(tops.position_mm - PLACE).max() > 1e-5
    assert refined.sigma_mm < tops.sigma_mm


@pytest.mark.parametrize("gel_mm", [0.0, 0.05])
@pytest.mark.parametrize("theta", [0.0, 0.8, -2.5])
def test_small_moves_of_the_dots_change_the_pose_as_a_fit_anew_does(theta: float, gel_mm: float) -> None:
    rng = np.random.default_rng(5)
    seen_mm = contact(rng, (1.0, -0.5))
    texture = PLACE + seen_mm @ turn_of(theta).T + rng.normal(0.0, 0.001, seen_mm.shape)
    beliefs, weights = replace(STOCK, gel_mm=gel_mm, correlation_mm=2.0), rng.uniform(0.7, 1.0, len(seen_mm))
    pose = fit_pose(R * seen_mm, texture, weights, R, beliefs)
    u, v = seen_mm.T
    moves_mm = 1e-4 * np.array([np.ones_like(seen_mm), np.stack([v, -u], axis=1), np.stack([u * v, u], axis=1)])
    assert pose.fitted is not None and pose.used is not None and len(pose.used) == len(seen_mm)
    for moved_mm, change in zip(moves_mm, pose.fitted.changes(moves_mm), strict=True):
        other = fit_pose(R * (seen_mm + moved_mm), texture, weights, R, beliefs)
        anew = np.array([*(other.position_mm - pose.position_mm), other.theta_rad - pose.theta_rad])
        assert np.abs(anew).max() > 2e-5 and change == pytest.approx(anew, abs=0.03 * np.abs(anew).max())
