"""Poses in space: the sensor's image over a tape that may be tilted, as a 4x4 matrix, and its covariance."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, hypot, inf, sin, sqrt

import numpy as np

from tactape_fab.texture.frames import FloatArray

Surface = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Where a texture point (2,) is in space, (3,) mm, and the texture's axes there as columns, (3, 3): x, y, and z into the tape."""
_STEP = 1e-6


def texture_plane(at_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The texture frame itself, as a `Surface`."""
    return np.array([at_mm[0], at_mm[1], 0.0]), np.eye(3)


def image_pose(surface: Surface, state: FloatArray) -> FloatArray:
    """The image's frame on a surface; shape (4, 4), mm.

    state (6,): x and y of the texture point under the image centre, mm; theta, rad; slopes of the tape along image u and v,
        positive where it rises towards the sensor; distance of the frame's origin from that point along its own z, mm.
    """
    x, y, theta, rise_u, rise_v, ahead_mm = state.tolist()
    point, axes = surface(np.array([x, y]))
    c, s = cos(theta), sin(theta)
    # image to texture is R(theta) = [[c, s], [-s, c]] (paper, Eq. 12); the tilt is in the image's axes, so it comes first
    turn = axes @ np.array([(c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)]) @ _upright(rise_u, rise_v)
    out = np.eye(4)
    out[:3, :3] = turn
    out[:3, 3] = point + turn[:, 2] * ahead_mm
    return out


def _upright(rise_u: float, rise_v: float) -> FloatArray:
    """The least rotation that brings the normal of z = -(rise_u x + rise_v y), into the tape, to the z axis (Rodrigues)."""
    rise = hypot(rise_u, rise_v)
    if rise == 0.0:
        return np.eye(3)
    length = sqrt(1.0 + rise * rise)
    u, v, c, s = rise_u / rise, rise_v / rise, 1.0 / length, rise / length
    # about (v, -u, 0), which is across the slope
    return np.array(
        [(c + v * v * (1 - c), -u * v * (1 - c), -u * s), (-u * v * (1 - c), c + u * u * (1 - c), -v * s), (u * s, v * s, c)]
    )


def with_more(covariance: FloatArray, more: FloatArray | None) -> FloatArray:
    """The sum of two covariances (6, 6); what has infinite variance in the first keeps it, and has no covariances."""
    if more is None:
        return covariance
    known = np.isfinite(covariance.diagonal())
    return covariance + np.where(known[:, None] & known, more, 0.0)


def pose_covariance(surface: Surface, state: FloatArray, covariance: FloatArray) -> FloatArray:
    """Covariance of `image_pose`, shape (6, 6): of its origin in mm, then of small turns about the surface's axes x, y, z in rad.

    surface, state: As for `image_pose`.
    covariance (6, 6): Of the state; an infinite variance marks an unknown entry, and has no covariances.
    """
    unknown = ~np.isfinite(covariance.diagonal())
    here, rates = image_pose(surface, state), np.empty((6, 6))
    # central differences: their error is of the order of step^2, 1e-12, and rounding 1e-16 / step, 1e-10 of a coordinate
    for k in range(6):
        ahead, behind = (image_pose(surface, state + side * _STEP * np.eye(6)[k]) for side in (0.5, -0.5))
        # dR R^T is the cross-product matrix of the turn, in the axes that `surface` is given in; half the difference leaves its
        # skew part
        spin = (ahead[:3, :3] - behind[:3, :3]) @ here[:3, :3].T / _STEP
        rates[:3, k] = (ahead[:3, 3] - behind[:3, 3]) / _STEP
        rates[3:, k] = (spin[2, 1] - spin[1, 2]) / 2, (spin[0, 2] - spin[2, 0]) / 2, (spin[1, 0] - spin[0, 1]) / 2
    # infinity times a rate of 0 would be NaN: infinite variances are propagated separately, to the outputs that depend on them
    known = np.where(unknown[:, None] | unknown, 0.0, covariance)
    found: FloatArray = rates @ known @ rates.T
    found = (found + found.T) / 2
    lost = (np.abs(rates[:, unknown]) > 1e-6).any(axis=1)
    found[lost], found[:, lost] = 0.0, 0.0
    found[lost, lost] = inf
    return found
