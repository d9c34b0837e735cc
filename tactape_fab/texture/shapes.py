"""Vectorised geometry of outlines, shared by plan, layout and rules (mm)."""

from __future__ import annotations

from math import acos, atan2, ceil, cos, pi, radians, sin

import numpy as np
import numpy.typing as npt

from tactape_fab.texture.frames import FloatArray, snap_mm

CORNER_POINTS = 9
"""Vertices per rounded corner of a land: with corners of 0.1 mm the chords then lose 0.1 % of a pad's area."""
CHORD_ERROR_MM = 0.0005
"""Largest distance of a polyline from the arc of the board's outline, mm."""


def rotate(xy_mm: npt.ArrayLike, angle_deg: float) -> FloatArray:
    """Turn points counter-clockwise about the origin; shape (..., 2)."""
    c, s = cos(radians(angle_deg)), sin(radians(angle_deg))
    # points are rows, so that the matrix is the transpose of [[c, -s], [s, c]]
    turned: FloatArray = np.asarray(xy_mm, dtype=np.float64) @ np.array([[c, s], [-s, c]])
    return turned


def outline_corner_points(corner_radius_mm: float) -> int:
    """Vertices per corner that keep the chords of the board's outline within CHORD_ERROR_MM of its arc."""
    if corner_radius_mm <= CHORD_ERROR_MM:
        return 2
    # the sagitta of a chord of angle a is r (1 - cos(a / 2)), which bounds a; a quarter circle of k chords has k + 1 vertices
    return max(CORNER_POINTS, ceil(pi / 4 / acos(1 - CHORD_ERROR_MM / corner_radius_mm)) + 1)


def rounded_rectangle(
    size_mm: tuple[float, float], corner_radius_mm: float = 0.0, corner_points: int = CORNER_POINTS
) -> FloatArray:
    """Vertices of a rounded rectangle about the origin, counter-clockwise, not closed; shape (k, 2)."""
    half = np.array(size_mm) / 2
    if corner_radius_mm == 0.0:
        square: FloatArray = half * np.array([(1, -1), (1, 1), (-1, 1), (-1, -1)], dtype=np.float64)
        return square
    angle = np.linspace(0.0, pi / 2, corner_points) + np.array([-pi / 2, 0.0, pi / 2, pi])[:, None]
    centre = (half - corner_radius_mm) * np.array([(1, -1), (1, 1), (-1, 1), (-1, -1)])
    corners = centre[:, None] + corner_radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    # straight sides join the last vertex of a corner and the first of the next
    points: FloatArray = corners.reshape(-1, 2)
    apart = np.hypot(*(points - np.roll(points, 1, axis=0)).T) > 1e-9  # at a full-radius end two corners share a vertex
    distinct: FloatArray = points[apart]
    return distinct


def board_outline(size_mm: tuple[float, float], corner_radius_mm: float) -> FloatArray:
    """Vertices of a board's outline, its lower left corner at the origin, within CHORD_ERROR_MM of its arcs; shape (k, 2)."""
    return rounded_rectangle(size_mm, corner_radius_mm, outline_corner_points(corner_radius_mm)) + np.array(size_mm) / 2


def placed_outline(size_mm: tuple[float, float], corner_radius_mm: float, rotation_deg: float) -> FloatArray:
    """Vertices of a rotated rounded rectangle about the origin, snapped to 1 nm, as it is written and measured; shape (k, 2)."""
    return snap_mm(rotate(rounded_rectangle(size_mm, corner_radius_mm), rotation_deg))


def outlines_at(xy_mm: FloatArray, outline_mm: FloatArray) -> FloatArray:
    """An outline, shape (k, 2), at each of n places: ``xy_mm[:, None] + outline_mm`` in a tenth of the time; shape (n, k, 2)."""
    vertices = np.empty((len(xy_mm), *outline_mm.shape))
    for axis in (0, 1):
        np.add(xy_mm[:, axis, None], outline_mm[:, axis], out=vertices[..., axis])
    return vertices


def reach_mm(outline_mm: FloatArray) -> tuple[float, float]:
    """Largest |x| and largest |y| of an outline's vertices, mm."""
    x, y = np.abs(outline_mm).max(axis=0)
    return float(x), float(y)


def area_mm2(outline_mm: FloatArray) -> float:
    """Area of a simple polygon, shape (k, 2), of either orientation."""
    return abs(signed_area_mm2(outline_mm))


def signed_area_mm2(outline_mm: FloatArray) -> float:
    """Area of a simple polygon, shape (k, 2); negative if it runs clockwise."""
    x, y = outline_mm.T
    # shoelace formula
    return float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2


def inset_mm(xy_mm: FloatArray, size_mm: tuple[float, float], corner_radius_mm: float) -> FloatArray:
    """Distance of points from the board's outline, positive inside.

    The outline is convex, so the least value over a polygon's vertices is the distance of the whole polygon.

    xy_mm (..., 2): Points in the board frame.
    size_mm, corner_radius_mm: The board: lower-left corner at the origin.
    Returns (...).
    """
    half = np.array(size_mm) / 2
    # signed distance of a rounded rectangle: that of the rectangle inset by the radius, less the radius; the sign is flipped, as
    # positive is inside
    x, y = np.moveaxis(np.abs(xy_mm - half) - (half - corner_radius_mm), -1, 0)
    # maximum of two arrays: a reduction along an axis of length 2 takes numpy many times as long
    inset: FloatArray = corner_radius_mm - np.hypot(np.maximum(x, 0.0), np.maximum(y, 0.0)) - np.minimum(np.maximum(x, y), 0.0)
    return inset


def axis_angle_deg(vector_xy: tuple[float, float]) -> float:
    """Direction of a line through the origin, in [0, 180) degrees."""
    return float(np.degrees(atan2(vector_xy[1], vector_xy[0])) % 180.0)
