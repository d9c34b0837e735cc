"""Poses that all others contradict: found by what the others say, and none where errors are normal."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import f

from tactape_fab.sense.calibrate.odd_pose import _held, _rates, odd_poses
from tactape_fab.texture.frames import FloatArray

SIGMAS = np.array([0.03, 0.03, 0.1, 0.01, 0.01, 0.001])
COUNT = 10


def said(seed: int, lever: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Residuals (m, 6) of poses at 0, and their derivatives by a shift along x and y, and by a reach, told by tilts."""
    rng = np.random.default_rng(seed)
    rates = np.zeros((COUNT, 6, 3))
    rates[:, 0, 0] = rates[:, 1, 1] = 1.0
    rates[:, :2, 2] = rng.normal(0.0, 0.02, (COUNT, 2))
    rates[3, :2, 2] *= lever
    return rng.standard_normal((COUNT, 6)) * SIGMAS, rates


def found(at: FloatArray, rates: FloatArray, most: int = 2) -> list[int]:
    # by all poses, as it is given: least squares over the errors of each kind
    scaled = (rates / SIGMAS[:, None]).reshape(-1, 3)
    z = -np.linalg.lstsq(scaled, (at / SIGMAS).ravel(), rcond=None)[0]
    odd = odd_poses(lambda x: at + rates @ x, z, np.full(6, 0.1), np.full(6, 1e-4), np.full(3, 1e-3), most)
    return [pose.index for pose in odd]


def test_normal_errors_have_no_odd_pose() -> None:
    assert [found(*said(seed)) for seed in range(30)] == [[]] * 30


@pytest.mark.parametrize("kind", [0, 1, 5])
def test_a_pose_that_is_off_is_found(kind: int) -> None:
    at, rates = said(3)
    at[6, kind] += 1.0 if kind < 5 else 0.03
    assert found(at, rates) == [6]


def test_a_pose_that_decides_what_the_others_leave_open_is_found() -> None:
    """A reach that is 50 mm too large fits a pose of ten times the tilt, so that all others are off by more than it."""
    at, rates = said(4, lever=10.0)
    at[3] -= rates[3] @ (0.0, 0.0, 50.0)
    assert found(at, rates) == [3]


def test_two_poses_that_hide_each_other_are_found() -> None:
    """Off by the same, either is by all others, of which the other is one, hardly off at all."""
    at, rates = said(5)
    at[[2, 7], 0] += 2.0
    assert found(at, rates) == [2, 7]
    assert found(at, rates, most=1) == []
    at[9, 0] += 2.0
    assert len(found(at, rates, most=3)) < 3


def test_errors_of_height_and_tilt_are_no_fault() -> None:
    at, rates = said(5)
    at[2, 2:5] = 3.0, 0.3, -0.3
    assert found(at, rates) == []


def test_a_gel_that_slid_by_little_is_no_fault() -> None:
    at, rates = said(6)
    at[:, :2] /= 100.0
    at[2, 0] += 0.25
    assert found(at, rates) == []
    at[2, 0] += 0.25
    assert found(at, rates) == [2]


def test_a_pose_is_held_against_the_mean_of_the_others() -> None:
    """Shifts and turn are unknowns: of n others the mean errs by sigma / sqrt(n), and sigma has n - 1 degrees of freedom."""
    at, n = np.random.default_rng(8).normal(size=(COUNT, 6)), COUNT - 1
    rates = np.tile(np.eye(6)[:, [0, 1, 5]], (COUNT, 1, 1))
    (chance,), (off,), (sigmas,) = _held(at, rates, np.zeros(3), np.array([[0]]), np.ones(6), np.full(6, 1e-9), np.full(3, 1e-9))
    seen = [0, 1, 5]
    assert off[0, seen] == pytest.approx(at[0, seen] - at[1:, seen].mean(axis=0))
    assert sigmas[seen] == pytest.approx(at[1:, seen].std(axis=0, ddof=1))
    assert sigmas[2:5] == pytest.approx(np.sqrt((at[1:, 2:5] ** 2).mean(axis=0)))
    ratio = (off[0, seen] ** 2 / (sigmas[seen] ** 2 * (1.0 + 1.0 / n))).sum() / 3
    assert chance == pytest.approx(f.sf(ratio, 3, n - 1))


def test_what_is_known_before_counts_as_another_pose() -> None:
    """Four residuals x - 1 of sigma 1, and 4 x: the least of 4 (x - 1)^2 + 16 x^2 is at 0.2, a step of -1.8 from 2."""
    at, rates = np.ones((5, 6)), np.tile(np.eye(6)[:, :1], (5, 1, 1))
    _, (off,), (sigmas,) = _held(at, rates, np.array([2.0]), np.array([[0]]), np.ones(6), np.ones(6), np.array([4.0]))
    assert off[0] == pytest.approx([-0.8, 1, 1, 1, 1, 1]) and sigmas == pytest.approx(np.ones(6))


def test_rates_are_the_derivatives() -> None:
    found = _rates(lambda z: np.array([[z[0] ** 2, z[0] * z[1], np.sin(z[1]), 1.0, z[1], -z[0]]]), np.array([3.0, 0.5]))
    assert found[0] == pytest.approx(np.array([(6, 0), (0.5, 3), (0, np.cos(0.5)), (0, 0), (0, 1), (-1, 0)]), abs=1e-8)
