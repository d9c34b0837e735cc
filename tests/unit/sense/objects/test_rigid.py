"""Rotations and fits, against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactape_fab.base.errors import SpecError
from tactape_fab.sense.geometry import from_quaternion
from tactape_fab.sense.objects.mount import Mount
from tactape_fab.sense.objects.rigid import fit_rigid, from_rpy, to_quaternion
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
