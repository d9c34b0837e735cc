"""Charts: maps of a flat texture onto a surface; the common interface of meshes and CAD faces, and their frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, radians
from typing import Any, Protocol

import numpy as np

from tactape_fab.base.errors import SpecError, refuse
from tactape_fab.base.fields import Fields
from tactape_fab.solids.mesh.triangles import unit
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

_NEAR_Z_DEG = 10.0
_MOST_FACE = 1_000_000
_FURTHEST_MM = 100_000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """Placement of a texture on a surface.

    face: Face of a STEP model, from 0 in the file's order; None for the face at `at_mm`, else the largest.
    at_mm: Point of the surface in model coordinates for the middle of the texture's grid; None for the face's centre, or for a
        mesh the point vertically above its centroid.
    up: Direction of board +y, projected into the surface; None for +z, or +y where the normal is within 10 degrees of +z or -z.
    """

    face: int | None = None
    at_mm: tuple[float, float, float] | None = None
    up: tuple[float, float, float] | None = None


def read_placement(values: Mapping[str, Any]) -> Placement:
    """A placement from untrusted values. Raises SpecError with every value that is refused."""
    table = Fields(values)
    placement = Placement(
        face=table.integer("face", low=0, high=_MOST_FACE) if "face" in values else None,
        at_mm=_triple(table, "at_mm", "mm", "give X,Y,Z in mm, a point of the surface"),
        up=_triple(table, "up", "", "give a direction X,Y,Z, such as 0,0,1"),
    )
    if placement.up is not None and not any(placement.up) and not table.refused("up"):
        table.problem("up", f"up = {','.join(f'{v:g}' for v in placement.up)} is no direction; give three numbers, not all zero")
    refuse(table.problems)
    return placement


def _triple(table: Fields, key: str, unit: str, remedy: str) -> tuple[float, float, float] | None:
    if key not in table.values:
        return None
    x, y, z = table.numbers(key, 3, low=-_FURTHEST_MM, high=_FURTHEST_MM, unit=unit, remedy=remedy)
    return x, y, z


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frames:
    """Places on a surface with the board's axes there; model coordinates, mm.

    Attributes
    ----------
    points_mm, x_axis, normal : ndarray, shape (n, 3)
        Board x and the outward normal are unit vectors at right angles; board y is ``normal x x_axis``.
    facet : ndarray of int, shape (n,)
        Triangle of a mesh, or 0.
    walked_mm : ndarray, shape (n,)
        Length of the path from the middle: less than the offset if the surface ends before.
    arrived : ndarray of bool, shape (n,)
    """

    points_mm: FloatArray
    x_axis: FloatArray
    normal: FloatArray
    facet: IntArray
    walked_mm: FloatArray
    arrived: BoolArray

    @property
    def y_axis(self) -> FloatArray:
        return np.cross(self.normal, self.x_axis)

    def __getitem__(self, which: BoolArray | IntArray) -> Frames:
        return Frames(**{name: getattr(self, name)[which] for name in self.__slots__})


class Chart(Protocol):
    """A surface with a place and an up direction on it."""

    @property
    def centre(self) -> Frames:
        """The middle of the texture: one frame."""

    def frames(self, offset_mm: FloatArray) -> Frames:
        """Frames at points of the flat board; `offset_mm`, shape (n, 2), is relative to the centre, board x and y."""

    def feet(self, frames: Frames, outline_mm: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Heights of the surface over the tangent planes of places, at the points `outline_mm`, shape (k, 2), of these planes.

        Returns height_mm (n, k): Along the normal, negative below the tangent plane.
        Returns on_surface (n, k): Whether the surface extends to there.
        """


def board_x(normal: FloatArray, up: tuple[float, float, float] | None) -> FloatArray:
    """Direction of board x for the outward `normal`, with board y along the projection of `up`; shape (3,).

    Raises SpecError if `up` is not a direction, or is parallel to the normal.
    """
    if up is None:
        near_z = abs(float(normal[2])) > cos(radians(_NEAR_Z_DEG))
        up = (0.0, 1.0, 0.0) if near_z else (0.0, 0.0, 1.0)
    direction = np.array(up, dtype=np.float64)
    shown = ",".join(f"{v:g}" for v in up)
    length = float(np.linalg.norm(direction))
    if direction.shape != (3,) or not np.isfinite(length) or length == 0:
        raise SpecError(f"up = {shown} is no direction; give three numbers, not all zero")
    # board y x normal = board x, as x, y and the normal are right-handed
    x = np.cross(direction / length, normal)
    if np.linalg.norm(x) < 1e-3:
        at = ", ".join(f"{v:.3f}" for v in normal)
        raise SpecError(f"up = {shown} is parallel to the surface's normal ({at}) there; give a direction along the surface")
    return unit(x)


def turned(vectors: FloatArray, old: FloatArray, new: FloatArray) -> FloatArray:
    """Vectors transported by the smallest rotation from normal `old` to `new`, and made perpendicular to it; (n, 3)."""
    # Rodrigues' formula with a = k sin = old x new: v cos + a x v + a (a . v) (1 - cos) / sin^2, whose last factor is
    # 1 / (1 + cos); bounded beyond 120 deg, which no step of a path reaches
    axis = np.cross(old, new)
    cosine = np.einsum("ij,ij->i", old, new)[:, None]
    along = np.einsum("ij,ij->i", axis, vectors)[:, None]
    moved = vectors * cosine + np.cross(axis, vectors) + axis * (along / (1.0 + np.maximum(cosine, -0.5)))
    # rounding errors of thousands of steps would otherwise move the axes out of the tangent plane
    moved -= new * np.einsum("ij,ij->i", moved, new)[:, None]
    return unit(moved)


def nearest(points: FloatArray, queries: FloatArray, count: int = 1, within_mm: float = np.inf) -> tuple[FloatArray, IntArray]:
    """Distances and indices of the `count` points nearest to each query; shapes (q,) or (q, count).

    If none is within `within_mm`, the distance is infinite, and the index is the number of points.
    """
    from scipy.spatial import cKDTree

    distance, index = cKDTree(points).query(queries, k=count, distance_upper_bound=within_mm)
    return np.asarray(distance, dtype=np.float64), np.asarray(index, dtype=np.int64)


def connected(one: IntArray, other: IntArray, count: int) -> tuple[int, IntArray]:
    """Connected components of `count` items joined by pairs: their number, and the component of each item, shape (count,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    groups, label = connected_components(coo_array((np.ones(len(one)), (one, other)), shape=(count, count)), directed=False)
    return int(groups), label
