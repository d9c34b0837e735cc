"""Inked areas of an AprilTag 36h11, within the limits of a legend printer."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
import shapely

from tactape_fab.texture.frames import BoolArray, FloatArray
from tactape_fab.texture.tag import SIDE_CELLS, tag_cells


@dataclass(frozen=True, slots=True, kw_only=True)
class Ink:
    """Areas to print, each a polygon without holes, relative to the tag's centre (mm, y up).

    Their union is the printed image; areas that were cut to remove a hole overlap along the cut.
    """

    areas_mm: tuple[FloatArray, ...]


def tag_ink(tag_id: int, *, cell_mm: float, gap_mm: float, bleed_mm: float, legend_is_light: bool) -> Ink:
    """Areas of ink that show the tag.

    A light legend prints the light cells and the ring, a dark one the dark cells. Two inked cells that meet only at a
    corner are both chamfered, so that `gap_mm` stays free between them after an ink bleed of `bleed_mm`.

    cell_mm: Side of a cell.
    gap_mm, bleed_mm: Least gap between inked areas, and ink bleed per edge.
    legend_is_light: Whether the legend ink is lighter than what it is printed on.
    """
    light = tag_cells(tag_id)
    inked = light if legend_is_light else ~light
    row, column = np.nonzero(inked)
    half = SIDE_CELLS / 2
    x, y = (column - half) * cell_mm, (half - 1 - row) * cell_mm
    image = shapely.union_all(shapely.box(x, y, x + cell_mm, y + cell_mm))
    # A chamfer is leg / sqrt(2) away from the corner, on both cells: 2 (gap/2 + bleed) apart as drawn, of which the ink takes one
    # bleed on each side
    leg_mm = (gap_mm / 2 + bleed_mm) * sqrt(2.0)
    corners = _corner_contacts(inked)
    # row 0 is the upper one, and a corner's row counts cell borders from the top
    if len(corners):
        cx, cy = (corners[:, 1] - half) * cell_mm, (half - corners[:, 0]) * cell_mm
        arms = np.array([(leg_mm, 0.0), (0.0, leg_mm), (-leg_mm, 0.0), (0.0, -leg_mm)])
        image = shapely.difference(image, shapely.union_all(shapely.polygons(np.stack([cx, cy], axis=1)[:, None] + arms)))
    # normalised, so that the order of parts and their first vertices do not depend on how GEOS united the cells
    parts = shapely.get_parts(shapely.normalize(image))
    # chamfers for a gap of several cells leave no ink: an empty polygon, which has no vertex
    parts = parts[~shapely.is_empty(parts)]
    return Ink(areas_mm=tuple(area for part in parts for area in _without_holes(part, cell_mm / 10)))


def most_gap_mm(cell_mm: float, bleed_mm: float) -> float:
    """Gap at which the chamfers of a cell's four corners meet in its middle, and leave none of its ink."""
    return cell_mm * sqrt(2.0) - 2 * bleed_mm


def _corner_contacts(inked: BoolArray) -> np.ndarray:
    """(row, column) of grid corners where exactly two inked cells meet, diagonally."""
    nw, ne, sw, se = inked[:-1, :-1], inked[:-1, 1:], inked[1:, :-1], inked[1:, 1:]
    return np.argwhere((nw & se & ~ne & ~sw) | (ne & sw & ~nw & ~se)) + 1


def _without_holes(polygon: shapely.Polygon, overlap_mm: float) -> list[FloatArray]:
    """Cut a polygon through its holes until no piece has one; pieces overlap by twice `overlap_mm` along each cut, so that no
    hairline opens between them.
    """
    if not polygon.interiors:
        return [np.array(polygon.exterior.coords)[:-1]]
    x_low, y_low, x_high, y_high = polygon.bounds
    # a cut through the middle of a hole turns it into a notch of each piece: pieces have fewer holes, so the recursion ends
    cut = polygon.interiors[0].centroid.y
    pieces: list[FloatArray] = []
    for low, high in ((y_low - 1.0, cut + overlap_mm), (cut - overlap_mm, y_high + 1.0)):
        piece = shapely.intersection(polygon, shapely.box(x_low - 1.0, low, x_high + 1.0, high))
        for part in shapely.get_parts(piece):
            # a cut that touches a cell's side may leave lines or points as well
            if part.geom_type == "Polygon":
                pieces += _without_holes(part, overlap_mm)
    return pieces
