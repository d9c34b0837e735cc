"""Check of nested shells of a mesh: whether each bounds a body or a cavity at its place."""

from __future__ import annotations

import numpy as np

from tactape_fab.base.errors import SpecError
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.surface.charts import connected
from tactape_fab.texture.frames import FloatArray, IntArray

_MOST_COST, _BOXES_OF_ONE = 20_000_000, 10
"""Limit of the pairs of point and triangle, which take some three seconds, and number of bounding boxes that cost as much as a
pair."""
_POINTS = 9


def wrong_shells(mesh: Mesh) -> tuple[int, FloatArray]:
    """Number of shells that bound neither a body nor a cavity, and the middle of the first (mm).

    mesh: Closed, without intersecting shells. The winding number is 0 outside a body and 1 inside: an outward shell is valid
        where the others give 0, an inward one, of a cavity, where they give 1. A body in a body would count twice in volumes.

    Raises SpecError if so many shells are nested that the check would take minutes.
    """
    faces = mesh.faces
    shells, label = connected(faces.ravel(), np.roll(faces, 1, axis=1).ravel(), len(mesh.vertices_mm))
    if shells == 1:
        return 0, np.zeros(3)
    # triangles grouped by shell
    owner = label[faces[:, 0]]
    order = np.argsort(owner, kind="stable")
    corners = mesh.corners_mm[order]
    ends = np.cumsum(np.bincount(owner, minlength=shells))
    starts = np.r_[0, ends[:-1]]
    low, high = np.minimum.reduceat(corners.min(axis=1), starts), np.maximum.reduceat(corners.max(axis=1), starts)
    middles, cost = (low + high) / 2, 0
    bounds = np.ascontiguousarray(np.concatenate([low, -high], axis=1).T)  # contiguous by axis, which is several times faster
    outward = np.add.reduceat(_volumes6(corners - np.repeat(middles, ends - starts, axis=0)[:, None]), starts) > 0
    wrong = np.zeros(shells, dtype=bool)
    for shell in range(shells):
        around = np.logical_and.reduce(bounds <= bounds[:, shell, None], axis=0)
        around[shell] = False
        cost += shells // _BOXES_OF_ONE
        if not around.any():
            wrong[shell] = not outward[shell]
            continue
        there = np.concatenate([np.arange(starts[k], ends[k]) for k in np.flatnonzero(around)])
        # several points, as some of a shell that touches another are on it
        own: IntArray = np.unique(np.linspace(starts[shell], ends[shell] - 1, _POINTS).astype(np.int64))
        cost += len(there) * len(own)
        if cost > _MOST_COST:
            raise SpecError(f"SURFACE has {shells} shells, too many of them in others; give a mesh of one part")
        depth = np.median([_winding(corners[there], point) for point in corners[own].mean(axis=1)])
        wrong[shell] = round(float(depth)) != (0 if outward[shell] else 1)
    return int(wrong.sum()), middles[int(wrong.argmax())]


def _volumes6(corners: FloatArray) -> FloatArray:
    """Six times the signed volume of each triangle's tetrahedron with the origin."""
    return np.asarray(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])))


def _winding(corners: FloatArray, point_mm: FloatArray) -> float:
    """Winding number of closed shells about a point: the solid angles of their triangles over that of a sphere."""
    # A. van Oosterom, J. Strackee: The Solid Angle of a Plane Triangle, IEEE Trans. Biomed. Eng. 30 (1983), Eq. 8
    a, b, c = np.moveaxis(corners - point_mm, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a)))
    half = np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), la * lb * lc + ab * lc + bc * la + ca * lb)
    return float(half.sum() / (2 * np.pi))
