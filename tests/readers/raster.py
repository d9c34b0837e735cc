"""Truth for the readers' pictures: a layout's own polygons as pixel coverage, without any Gerber in between."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely
from shapely.geometry.polygon import orient

from tactape_fab.kit.film.layout import Flashes, Layout

PX_PER_MM = 40
LAYERS = ("copper-top", "coverlay-top", "paste-top", "legend-top", "profile")
_SCAN_LINES_PER_PX = 8
_PROFILE_LINE_MM = 0.1

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """The part of the board that a picture shows, at `PX_PER_MM`, board +y up."""

    left_mm: float
    bottom_mm: float
    width_px: int
    height_px: int

    @property
    def right_mm(self) -> float:
        return self.left_mm + self.width_px / PX_PER_MM

    @property
    def top_mm(self) -> float:
        return self.bottom_mm + self.height_px / PX_PER_MM


def board_window(layout: Layout, margin_mm: float = 0.5) -> Window:
    """The whole board and a margin, in which nothing should be drawn but half of the profile's line."""
    width_px, height_px = (round((side_mm + 2 * margin_mm) * PX_PER_MM) for side_mm in layout.tape.board.size_mm)
    return Window(left_mm=-margin_mm, bottom_mm=-margin_mm, width_px=width_px, height_px=height_px)


def layer_edges_mm(layout: Layout, layer: str) -> Floats:
    """Edges of a layer's areas, each with the area on its left; shape (m, 2, 2). Areas do not overlap."""
    if layer == "legend-top":
        legend = layout.legend
        inked: list[Any] = [shapely.Polygon(area) for area in legend.areas_mm]
        inked += [shapely.LineString(stroke).buffer(legend.line_mm / 2, quad_segs=16) for stroke in legend.strokes_mm]
        return polygon_edges_mm(shapely.union_all(inked))
    if layer == "profile":
        return polygon_edges_mm(shapely.LinearRing(layout.outline_mm).buffer(_PROFILE_LINE_MM / 2, quad_segs=16))
    flashes: dict[str, Flashes] = {"copper-top": layout.pads, "coverlay-top": layout.openings, "paste-top": layout.paste}
    outline_mm = flashes[layer].outline_mm
    ring_mm = np.concatenate([outline_mm, outline_mm[:1]])
    side_mm = np.stack([ring_mm[:-1], ring_mm[1:]], axis=1)
    edges_mm: Floats = (flashes[layer].xy_mm[:, None, None] + side_mm).reshape(-1, 2, 2)
    return edges_mm


def polygon_edges_mm(area: Any) -> Floats:
    """Edges of shapely polygons, each with the area on its left; shape (m, 2, 2)."""
    polygons = [orient(polygon) for polygon in shapely.get_parts(area)]
    rings = [np.array(ring.coords) for polygon in polygons for ring in (polygon.exterior, *polygon.interiors)]
    return np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])


def area_mm2(edges_mm: Floats) -> float:
    """Area on the left of the edges."""
    (x1, y1), (x2, y2) = edges_mm[:, 0].T, edges_mm[:, 1].T
    return float(np.sum(x1 * y2 - x2 * y1) / 2)


def coverage(edges_mm: Floats, window: Window) -> npt.NDArray[np.float32]:
    """Share of each pixel that lies left of the edges, row 0 at the top: exact along x, by scan lines along y."""
    low_mm = (window.left_mm, window.bottom_mm)
    (x1, y1), (x2, y2) = ((edges_mm - low_mm) * PX_PER_MM).transpose(1, 2, 0)
    line1, line2 = y1 * _SCAN_LINES_PER_PX - 0.5, y2 * _SCAN_LINES_PER_PX - 0.5
    first = np.ceil(np.minimum(line1, line2)).astype(np.int64)
    count = np.ceil(np.maximum(line1, line2)).astype(np.int64) - first
    edge = np.repeat(np.arange(len(count)), count)
    line = first[edge] + np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    x = x1[edge] + (line - line1[edge]) / (line2 - line1)[edge] * (x2 - x1)[edge]
    column = np.floor(x).astype(np.int64)
    row = window.height_px - 1 - line // _SCAN_LINES_PER_PX
    if (column < 0).any() or (column >= window.width_px).any() or (row < 0).any() or (row >= window.height_px).any():
        raise ValueError("the window does not hold the whole layer")
    weight = np.where(line1 > line2, 1.0, -1.0)[edge] / _SCAN_LINES_PER_PX  # an edge that goes down has its area at the right
    width = window.width_px + 1
    cell = row * width + column
    steps = np.bincount(cell, weight * (column + 1 - x), minlength=window.height_px * width)
    steps += np.bincount(cell + 1, weight * (x - column), minlength=window.height_px * width)
    return np.cumsum(steps.reshape(-1, width), axis=1, dtype=np.float64)[:, :-1].astype(np.float32)


def iou(picture: npt.NDArray[np.float32], truth: npt.NDArray[np.float32]) -> float:
    """Intersection over union of two coverages of one shape."""
    assert picture.shape == truth.shape
    return float(np.minimum(picture, truth).sum(dtype=np.float64) / np.maximum(picture, truth).sum(dtype=np.float64))
