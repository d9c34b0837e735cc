"""Poses of a robot's flange, held against presses: the sensor on the tape by the arm, relative to where the tape has it."""

from __future__ import annotations

from math import pi

import numpy as np
from scipy.spatial.transform import Rotation

from tactape_fab.texture.frames import FloatArray

SIGMAS = np.array([0.1, 0.1, 0.3, 0.02, 0.02, 0.004])
"""Initial standard deviations: x, y, z of the sensor on the tape, mm, and turns about its axes, rad, in its own frame."""
LEAST_SIGMAS = np.array([0.005, 0.005, 0.01, 0.001, 0.001, 0.0002])
FAR_MM = 2000.0
"""Prior standard deviation of all translations."""
_STARTS = 6


def matrix_of(values: FloatArray) -> FloatArray:
    """Homogeneous matrix of a translation (mm) and a rotation vector (rad); (..., 6) to (..., 4, 4)."""
    out = np.zeros((*values.shape[:-1], 4, 4))
    out[..., :3, :3] = Rotation.from_rotvec(values[..., 3:].reshape(-1, 3)).as_matrix().reshape(*values.shape[:-1], 3, 3)
    out[..., :3, 3], out[..., 3, 3] = values[..., :3], 1.0
    return out


def on_tape(poses: FloatArray, origin_mm: FloatArray) -> FloatArray:
    """Sensor on the tape's board from x, y (texture frame) and theta (docs/frames.md); (..., 3) to (..., 4, 4)."""
    out = np.zeros((*poses.shape[:-1], 4, 4))
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    # R(theta) of the texture frame with its second row negated, as board y is up; z goes into the tape, so that the determinant
    # is 1
    out[..., 0, 0], out[..., 0, 1], out[..., 1, 0], out[..., 1, 1] = c, s, s, -c
    out[..., 2, 2], out[..., 3, 3] = -1.0, 1.0
    out[..., 0, 3], out[..., 1, 3] = origin_mm[0] + poses[..., 0], origin_mm[1] - poses[..., 1]
    return out


def misfits(arm: FloatArray, poses: FloatArray, origin_mm: FloatArray, both: FloatArray) -> FloatArray:
    """The sensor's pose by the arm relative to its pose by the tape: translation (mm) and rotation vector (rad).

    poses (..., m, 3), both (..., 12): The answer is (..., m, 6).
    """
    # P = Y^-1 B X by the arm, and P^-1 of the tape's answer before it
    inverse, of_sensor = np.linalg.inv(matrix_of(both[..., 6:])), matrix_of(both[..., :6])
    off = np.linalg.inv(on_tape(poses, origin_mm)) @ (inverse[..., None, :, :] @ arm @ of_sensor[..., None, :, :])
    turns = Rotation.from_matrix(off[..., :3, :3].reshape(-1, 3, 3)).as_rotvec().reshape(*off.shape[:-2], 3)
    return np.concatenate([off[..., :3, 3], turns], axis=-1)


def turned_starts() -> FloatArray:
    """Initial turns of a sensor on the flange, its axis along the flange's or against it; (12, 4, 4)."""
    flips = matrix_of(np.array([[0.0, 0.0, 0.0, flip, 0.0, 0.0] for flip in (0.0, pi)]))
    turns = matrix_of(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 2.0 * pi * k / _STARTS] for k in range(_STARTS)]))
    return np.asarray(flips[None] @ turns[:, None]).reshape(-1, 4, 4)
