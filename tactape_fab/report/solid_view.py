"""The solid for the page's shaded view: triangles of the written STL, up to the number that is drawn at once."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.report.arrays import packed
from tactape_fab.solids.mesh.stl import stl_corner_pieces
from tactape_fab.texture.frames import BoolArray, FloatArray

Corners = npt.NDArray[np.float32]

MOST_TRIANGLES = 40_000
_STEPS = 0xFFFF


def solid_view(file: bytes | Path, centre_mm: npt.ArrayLike | None = None) -> dict[str, Any]:
    """Triangles of an STL, quantised to 65,535 steps along each axis of their extent.

    file: The STL; with a path, only the drawn triangles and one corner of the others are in memory.
    centre_mm (3,): Point around which a part of a larger mesh is shown; default: its upper middle.
    """
    with BytesIO(file) if isinstance(file, bytes) else file.open("rb") as stream:
        # first pass: one corner of each triangle, 12 of its 50 bytes; second pass: the chosen ones
        first = np.concatenate([corners[:, 0] for corners in stl_corner_pieces(stream)])
        total = len(first)
        shown = np.ones(total, dtype=bool) if total <= MOST_TRIANGLES else _nearest(first, centre_mm)
        pieces, begin = [], 0
        for piece in stl_corner_pieces(stream):
            pieces.append(piece[shown[begin : begin + len(piece)]])
            begin += len(piece)
    corners = np.concatenate(pieces)
    low, high = _bounds(corners)
    # at least 1e-9 mm, as a flat mesh has no height
    step = np.maximum((high - low) / _STEPS, 1e-9)
    steps = np.rint((corners - low) / step).astype(np.uint64).reshape(-1, 3)
    # three coordinates of 16 bits as one number: equal corners of triangles
    # become one vertex. Rounding is half a step at most, 1/131,070 of the extent
    vertices, faces = np.unique(steps[:, 0] << 32 | steps[:, 1] << 16 | steps[:, 2], return_inverse=True)
    return {
        "vertices": packed(vertices[:, None] >> np.array([32, 16, 0], dtype=np.uint64) & _STEPS, "<u2"),
        "faces": packed(faces, "<u4" if len(vertices) > _STEPS else "<u2"),
        "low_mm": low.tolist(),
        "step_mm": step.tolist(),
        "shown": len(corners),
        "total": total,
    }


def _nearest(first: Corners, centre_mm: npt.ArrayLike | None) -> BoolArray:
    """Whether each triangle is one of those whose first corners, shape (n, 3), are nearest to a point."""
    if centre_mm is None:
        low, high = _bounds(first)
        # the middle of the upper side: the point of the mesh nearest to it is on the texture
        above = np.append((low[:2] + high[:2]) / 2, high[2])
        point = first[_apart(first, above).argmin()]
    else:
        point = np.asarray(centre_mm)
    chosen = np.zeros(len(first), dtype=bool)
    # argpartition: the nearest are needed, not their order
    chosen[np.argpartition(_apart(first, point), MOST_TRIANGLES)[:MOST_TRIANGLES]] = True
    return chosen


def _bounds(points: Corners) -> tuple[FloatArray, FloatArray]:
    """Least and largest coordinates of points, shape (..., 3); axis by axis, which is many times as fast."""
    axes = [points[..., axis] for axis in range(3)]
    return np.array([a.min() for a in axes], dtype=np.float64), np.array([a.max() for a in axes], dtype=np.float64)


def _apart(points: Corners, point: npt.NDArray[Any]) -> FloatArray:
    """The largest of the distances along the three axes; shape (n,)."""
    # the largest of three differences bounds a cube: no squares, and a cube of the mesh is shown
    apart: FloatArray = np.abs(points[:, 0] - float(point[0]))
    for axis in (1, 2):  # one after the other: large meshes
        np.maximum(apart, np.abs(points[:, axis] - float(point[axis])), out=apart)
    return apart
