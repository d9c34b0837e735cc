"""Rotations and fits, against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactape_fab.base.errors import SpecError
from tactape_fab.sense.geometry import from_quaternion
from tactape_fab.sense.objects.mount import Mount
from tactape_fab.sense.objects.rigid import carried, fit_covariance, fit_rigid, from_rpy, to_quaternion
from tactape_fab.texture.frames import FloatArray

RNG = np.random.default_rng(5)
SHIFT_MM = np.array([1.0, 2.0, 3.0])
HALF_TURNS = [180.0 * np.array(axis) / np.linalg.norm(axis) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, -2, 3), (-3, 1, 2))]


def test_roll_pitch_and_yaw_turn_about_fixed_axes() -> None:
    for rpy_deg in RNG.uniform(-180, 180, (50, 3)):
        np.testing.assert_allclose(from_rpy(rpy_deg), Rotation.from_euler("xyz", rpy_deg, degrees=True).as_matrix(), atol=1e-12)


@pytest.mark.parametrize("turn_deg", [0.0, 1e-7, 1.0, -1.0])
def test_quaternions_are_scipy_s_near_half_turns_too(turn_deg: float) -> None:
    turns = [Rotation.from_rotvec(v * (1 + turn_deg / 180.0), degrees=True) for v in HALF_TURNS]
    for rotation in (*turns, *Rotation.random(100, random_state=3)):
        found, expected = np.array(to_quaternion(rotation.as_matrix())), rotation.as_quat()
        assert np.linalg.norm(found) == pytest.approx(1.0) and found[3] >= 0.0
        assert abs(found @ expected) == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_allclose(from_quaternion(3.0 * found), rotation.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("flat", [False, True])
def test_points_are_fitted_by_a_rotation_never_by_a_reflection(flat: bool) -> None:
    points = RNG.normal(size=(9, 3)) * [1.0, 1.0, 0.0 if flat else 1.0] + [5.0, -2.0, 1.0]
    for rotation in Rotation.random(20, random_state=4):
        noise = RNG.normal(0.0, 1e-3, points.shape)
        turned, shift, rms = fit_rigid(points, rotation.apply(points) + SHIFT_MM + noise)
        assert np.linalg.det(turned) == pytest.approx(1.0)
        np.testing.assert_allclose(turned, rotation.as_matrix(), atol=6e-3)
        np.testing.assert_allclose(shift, SHIFT_MM, atol=4e-2)
        assert 5e-4 < rms < 3e-3
    mirrored = points * [1.0, 1.0, -1.0]
    assert np.linalg.det(fit_rigid(points, mirrored)[0]) == pytest.approx(1.0)


@pytest.mark.parametrize("matrix", [np.diag([1.0, 1.0, -1.0]), 2.0 * np.eye(3), np.eye(3) + 1e-3])
def test_a_mount_takes_no_reflection_and_no_scale(matrix: FloatArray) -> None:
    with pytest.raises(SpecError, match=r"is no rotation; give a rotation matrix \(3, 3\)"):
        Mount(surface="plane", rotation=matrix, position_mm=np.zeros(3))


def test_the_covariance_of_a_fit_is_that_of_fits_to_points_with_errors() -> None:
    """Over its own estimate of the points' errors, the squared error of a fit to four corners is 1 for each degree of freedom."""
    square, about_mm = 8.0 * np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]) + [20.0, 4.0, 0.0], np.zeros(3)
    squares = []
    for _ in range(1500):
        turned, shift, rms = fit_rigid(square, square + RNG.normal(0.0, 0.05, square.shape))
        error = np.array([*shift, *Rotation.from_matrix(turned).as_rotvec()])
        squares.append(error @ np.linalg.solve(fit_covariance(square, about_mm, rms), error) / 6)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.15)


def test_a_covariance_is_carried_to_another_point_of_the_body() -> None:
    root = np.linalg.cholesky(np.diag([0.2, 0.1, 0.3, 0.01, 0.02, 0.01]) ** 2 + 1e-5)
    motions = RNG.normal(size=(20_000, 6)) @ root.T
    by_mm = np.array([30.0, -5.0, 12.0])
    moved = np.column_stack([motions[:, :3] + np.cross(motions[:, 3:], by_mm), motions[:, 3:]])
    found = carried(root @ root.T, by_mm)
    assert np.cov(np.linalg.solve(np.linalg.cholesky(found), moved.T)) == pytest.approx(np.eye(6), abs=0.05)
