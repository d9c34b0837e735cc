"""Distances between many outlines at once, as shapely geometries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from tactape_fab.texture.frames import FloatArray

Geometries = npt.NDArray[Any]
"""Array of shapely geometries, one per element."""


def polygons(outlines_mm: Sequence[FloatArray]) -> Geometries:
    """A polygon of each outline, shapes (k, 2)."""
    if not outlines_mm:
        return np.empty(0, dtype=object)
    return np.asarray(shapely.polygons(shapely.linearrings(np.concatenate(outlines_mm), indices=_numbers(outlines_mm))))


def pen_strokes(lines_mm: Sequence[FloatArray], width_mm: float | FloatArray) -> Geometries:
    """Area of a stroke with round ends along each polyline, shapes (k, 2), k >= 2; one width for all or one for each, mm."""
    if not lines_mm:
        return np.empty(0, dtype=object)
    lines = shapely.linestrings(np.concatenate(lines_mm), indices=_numbers(lines_mm))
    # 16 chords per quarter circle are at most r (1 - cos(pi / 64)), or 0.12 % of the radius, inside the circle
    return np.asarray(shapely.buffer(lines, np.asarray(width_mm) / 2, quad_segs=16))


def gaps_mm(shapes: Geometries, ink: Geometries) -> FloatArray:
    """Distance of each shape from the nearest piece of ink, mm; shape of `shapes`, infinite without ink."""
    gaps = np.full(len(shapes), np.inf)
    # an empty tree returns nothing, so the gaps stay infinite; with nodes of two fewer strokes, of many points each, are measured
    tree = shapely.STRtree(ink, node_capacity=2)
    (asked, _), distance = tree.query_nearest(shapes, return_distance=True, all_matches=False)
    gaps[asked] = distance
    return gaps


def _numbers(lines_mm: Sequence[FloatArray]) -> npt.NDArray[np.intp]:
    """Index of the line to which each point belongs, for the concatenated points of all lines."""
    return np.repeat(np.arange(len(lines_mm)), [len(line) for line in lines_mm])
