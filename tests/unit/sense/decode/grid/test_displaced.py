"""A displaced gel shows in the residuals of one frame, and the covariance says by how much the pose is off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab import Localizer
from tactape_fab.sense import Scene, iterate_frames, load_sensor
from tactape_fab.sense.decode.grid.beliefs import RIM_MM, Beliefs, beliefs_of
from tactape_fab.sense.decode.grid.displaced import LEAST_FREEDOM, LEAST_SHARE, SEEN, displaced
from tactape_fab.sense.decode.grid.pose import Pose, fit_pose
from tactape_fab.sense.decode.grid.posterior import MOST_CORRELATED, errors_of
from tactape_fab.texture.frames import FloatArray
from tests.contacts import TAPE
from tests.thorough import some

R, OWN_MM, LONG_MM = 16.0, 0.005, 4.0
STOCK = beliefs_of(load_sensor("gelsight-mini"), fixed_scale=False)


def grid(half_mm: float) -> FloatArray:
    """Dots 1.6 mm apart within an ellipse; (n, 2) mm from the image centre. They are too far apart to push each other."""
    at = 1.61 * np.stack(np.meshgrid(np.arange(-8, 9), np.arange(-8, 9)), axis=-1).reshape(-1, 2)
    return np.asarray(at[np.hypot(at[:, 0] / half_mm, at[:, 1] / (0.8 * half_mm)) < 1.0])


def fitted(gel_mm: float, seed: int, *, half_mm: float = 6.0, beliefs: Beliefs = STOCK) -> tuple[Pose, FloatArray]:
    """A pose at the origin fitted to dots that are displaced by a Gaussian process, and their weights."""
    rng, at = np.random.default_rng(seed), grid(half_mm)
    smooth = errors_of(at, np.full(len(at), OWN_MM**2), np.zeros((0, 0)), gel_mm**2, LONG_MM)
    weights = np.ones(len(at))
    return fit_pose(R * at, at + np.linalg.cholesky(smooth) @ rng.standard_normal(at.shape), weights, R, beliefs), weights


def squared(pose: Pose) -> float:
    error = np.array([*pose.position_mm, pose.theta_rad])
    return float(error @ np.linalg.solve(pose.covariance, error)) / 3.0


@pytest.mark.parametrize(("gel_mm", "known_mm", "before"), [(0.02, 0.0, 12.0), (0.08, 0.0, 20.0), (0.1, 0.02, 8.0)])
def test_errors_of_a_displaced_gel_are_as_large_as_said(gel_mm: float, known_mm: float, before: float) -> None:
    beliefs = replace(STOCK, gel_mm=known_mm)
    plain, said = [], []
    for seed in range(120):
        pose, weights = fitted(gel_mm, seed, beliefs=beliefs)
        plain.append(squared(pose))
        said.append(squared(displaced(pose, beliefs, weights)))
    assert np.mean(plain) > before
    assert 0.5 < np.mean(said) < 1.7  # most of it from the few frames in which a small displacement does not show
    assert np.percentile(said, 95) < 4.0


def test_of_many_dots_some_are_enough() -> None:
    poses = [fitted(0.05, seed, half_mm=13.0) for seed in range(40)]
    assert len(poses[0][1]) > 1.5 * MOST_CORRELATED
    assert np.mean([squared(pose) for pose, _ in poses]) > 15.0
    assert 0.5 < np.mean([squared(displaced(pose, STOCK, weights)) for pose, weights in poses]) < 1.6


def test_a_gel_that_stays_costs_little() -> None:
    count = 160
    poses = [fitted(0.0, seed) for seed in range(count)]
    after = [displaced(pose, STOCK, weights) for pose, weights in poses]
    changed = [pose.covariance.trace() > before.covariance.trace() for pose, (before, _) in zip(after, poses, strict=True)]
    assert sum(changed) <= 0.25 * count
    assert 0.6 < np.mean([squared(pose) for pose in after]) < 1.3


def test_a_displacement_changes_what_is_said_and_not_the_pose() -> None:
    pose, weights = fitted(0.08, 3)
    found = displaced(pose, STOCK, weights)
    assert np.array_equal(found.position_mm, pose.position_mm)
    assert (found.theta_rad, found.px_per_mm) == (pose.theta_rad, pose.px_per_mm)
    assert np.array_equal(found.agree, pose.agree)
    assert (np.linalg.eigvalsh(found.covariance - pose.covariance) > 0.0).all()
    assert np.array_equal(found.camera[0], pose.camera[0])
    assert (found.camera[1] > pose.camera[1]).all()


def test_low_dots_that_a_rim_draws_are_no_displacement() -> None:
    at = grid(6.0)
    weights = np.where(np.abs(at[:, 1]) > 3.0, 0.5, 1.0)
    # both ends the same way, which neither a turn nor a camera explains
    drawn = at + 0.4 * RIM_MM * (1.0 - weights)[:, None] ** 0.875 * np.array([1.0, 0.0])
    pose = fit_pose(R * at, drawn + OWN_MM * np.random.default_rng(1).standard_normal(at.shape), np.ones(len(at)), R, STOCK)
    assert displaced(pose, STOCK, np.ones(len(at))).covariance.trace() > pose.covariance.trace()
    assert displaced(pose, STOCK, weights) is pose


def test_poses_without_dots_stay() -> None:
    pose = fit_pose(np.zeros((1, 2)), np.zeros((1, 2)), np.ones(1), R, STOCK)
    assert displaced(pose, STOCK, np.ones(1)) is pose


@pytest.mark.parametrize(("known_mm", "half_mm", "step"), [(0.0, 6.0, 1), (0.0, 4.0, 1), (0.03, 5.0, 1), (0.0, 11.0, 2)])
def test_the_added_covariance_is_that_of_dense_matrices(known_mm: float, half_mm: float, step: int) -> None:
    """Of more than a hundred dots every other one stands for two where the fit weighs them."""
    beliefs = replace(STOCK, gel_mm=known_mm)
    pose, weights = fitted(0.12, 5, half_mm=half_mm, beliefs=beliefs)
    dots = pose.fitted
    assert dots is not None
    n, seen_mm, rates = len(dots.errors_mm2), dots.seen_mm[::step], dots.rates[:9, :, ::step].reshape(9, -1)
    assert (step - 1) * MOST_CORRELATED < n <= step * MOST_CORRELATED
    apart = ((seen_mm[:, None] - seen_mm) ** 2).sum(axis=2)
    alike, own = (np.kron(np.eye(2), one) for one in (np.exp(-apart / (2.0 * LONG_MM**2)), np.diag(dots.errors_mm2[::step])))
    known = known_mm**2 * alike
    # priors as errors of the dots; the pose's are flat: 10 m and 10 rad
    priors = rates.T @ np.diag([1e8, 1e8, 1e2] + [1.0] * 6) @ rates
    target = dots.rates[9, :, ::step].ravel() + dots.state @ rates

    def likelihood(errors: FloatArray, by: FloatArray) -> tuple[float, float]:
        """Score and information of the variance of errors `by` in the law of all dots, priors included."""
        inverse = np.linalg.inv(errors + priors)
        left = inverse @ target
        return 0.5 * (left @ by @ left - np.trace(inverse @ by)), 0.5 * float(np.trace(inverse @ by @ inverse @ by))

    score, information = likelihood(own + known, alike)
    above, variance = score / np.sqrt(information), score / information
    assert above > SEEN
    score, information = likelihood(own + known + variance * alike, own)
    factor = max(1.0 + score / information, LEAST_SHARE)
    score, information = likelihood(factor * own + known + variance * alike, alike)
    variance = max(variance + score / information, LEAST_SHARE * variance)
    freedom = max(2.0 * variance**2 * information, LEAST_FREEDOM)
    variance *= (1.0 - (SEEN / above) ** 2) * freedom / (freedom - 2.0)
    estimate = dots.covariance @ rates @ np.linalg.inv(own / step + known)
    expected = (variance * estimate @ alike @ estimate.T)[:3, :3]
    added = displaced(pose, beliefs, weights).covariance - pose.covariance
    assert added == pytest.approx(dots.turn @ expected @ dots.turn.T, rel=0.02, abs=1e-9)
    assert n > 10


def test_frames_of_a_displaced_gel_say_so() -> None:
    scene, localizer = Scene(gel_displacement_um=30.0), Localizer(TAPE)
    squares, sheared = [], []
    for frame in iterate_frames(TAPE, some(32), seed=4, scene=scene):
        fix = localizer.locate(frame.depth)
        assert (
            fix.located
            and fix.covariance is not None
            and fix.theta_deg is not None
            and fix.strain is not None
            and fix.strain_sigma is not None
        )
        turn = np.radians((fix.theta_deg - frame.theta_deg + 180.0) % 360.0 - 180.0)
        error = np.array([*(np.array(fix.position_mm) - frame.position_mm), turn])
        squares.append(float(error @ np.linalg.solve(fix.covariance, error)) / 3.0)
        shear, sigma = fix.strain[1], fix.strain_sigma[1]
        sheared.append(0.0 if shear is None or sigma is None else shear / sigma)
    assert np.mean(squares) < 1.6
    assert np.mean(np.square(sheared)) < 2.0
