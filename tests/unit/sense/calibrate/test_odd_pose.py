"""Poses that all others contradict: found by what the others say, and none where errors are normal."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.sense.calibrate.odd_pose import odd_poses
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


def found(at: FloatArray, rates: FloatArray) -> list[int]:
    # by all poses, as it is given: least squares over the errors of each kind
    scaled = (rates / SIGMAS[:, None]).reshape(-1, 3)
    z = -np.linalg.lstsq(scaled, (at / SIGMAS).ravel(), rcond=None)[0]
    return [odd.index for odd in odd_poses(lambda x: at + rates @ x, z, np.full(6, 0.1), np.full(6, 1e-4), np.full(3, 1e-3), 2)]


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
