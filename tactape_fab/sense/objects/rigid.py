"""Rigid transforms in space: rotations as matrices, quaternions and angles, and the fit of one set of points to another."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tactape_fab.texture.frames import FloatArray


def from_rpy(rpy_deg: npt.ArrayLike) -> FloatArray:
    """Rotation matrix of roll, pitch and yaw: turns about the fixed axes x, then y, then z, as in URDF; shape (3, 3)."""
    out = np.eye(3)
    for axis, angle in enumerate(np.radians(np.asarray(rpy_deg, dtype=np.float64))):
        # the plane that an axis turns, in cyclic order: y z, z x, x y
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[j, i], turn[i, j] = np.sin(angle), -np.sin(angle)
        out = turn @ out
    return out


def to_quaternion(rotation: FloatArray) -> tuple[float, float, float, float]:
    """The unit quaternion (x, y, z, w) of a rotation matrix, w not negative."""
    r = rotation
    squares = np.array([1 + r[0, 0] - r[1, 1] - r[2, 2], 1 - r[0, 0] + r[1, 1] - r[2, 2], 1 - r[0, 0] - r[1, 1] + r[2, 2]])
    products = np.array(
        [
            (squares[0], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]),
            (r[0, 1] + r[1, 0], squares[1], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]),
            (r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], squares[2], r[1, 0] - r[0, 1]),
            (r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1 + np.trace(r)),
        ]
    )  # 4 q q^T: the longest row has the least rounding error
    # each row is the quaternion times 4 of one of its entries
    row = products[int(np.argmax(np.diag(products)))]
    x, y, z, w = (row / np.linalg.norm(row) * (1.0 if row[3] >= 0.0 else -1.0)).tolist()
    return x, y, z, w


def fit_rigid(points: FloatArray, to_points: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Least-squares rotation and translation from points to others (Kabsch); never a reflection.

    points, to_points (n, 3)
    Returns rotation (3, 3).
    Returns translation (3,).
    Returns rms: Root mean square of the remaining distances.
    """
    middle, to_middle = points.mean(axis=0), to_points.mean(axis=0)
    # the rotation that makes trace(R^T H) largest is U V^T; where that is a reflection, the least singular value's direction is
    # turned
    u, _, vt = np.linalg.svd((to_points - to_middle).T @ (points - middle))
    rotation: FloatArray = u @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))]) @ vt
    translation: FloatArray = to_middle - rotation @ middle
    left = points @ rotation.T + translation - to_points
    return rotation, translation, float(np.sqrt((left * left).sum(axis=1).mean()))


def fit_covariance(points: FloatArray, about_mm: FloatArray, rms: float) -> FloatArray:
    """Covariance of `fit_rigid`'s transform by errors of the points, as large along every axis as its residuals tell.

    points (n, 3): Four and more, where they were fitted to.
    about_mm (3,): Point whose shift is meant.
    rms: As `fit_rigid` returns it.
    Returns (6, 6): Of that point's shift, mm, then of small turns about the axes, rad.
    """
    rates = np.concatenate([_lever(point - about_mm) for point in points])
    # the mean of the variance's posterior, a t distribution's covariance: 3 n coordinates, six of them fitted, two for the mean
    variance = rms**2 * len(points) / (3 * len(points) - 8)
    return np.asarray(variance * np.linalg.inv(rates.T @ rates))


def carried(covariance: FloatArray, by_mm: FloatArray) -> FloatArray:
    """Covariance of a body's small motion for another of its points, (6, 6) as `fit_covariance` has it.

    by_mm (3,): From the first point to the other.
    """
    motion = np.eye(6)
    motion[:3] = _lever(by_mm)
    return np.asarray(motion @ covariance @ motion.T)


def _lever(by_mm: FloatArray) -> FloatArray:
    """Shift of a point by the shift of another and small turns, (3, 6): t + w x d = t - [d] w, with [d] the matrix of d x."""
    x, y, z = by_mm.tolist()
    return np.array([[1.0, 0.0, 0.0, 0.0, z, -y], [0.0, 1.0, 0.0, -z, 0.0, x], [0.0, 0.0, 1.0, y, -x, 0.0]])
