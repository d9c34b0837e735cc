"""Slots of a panel, and the drawing of a panel with its tapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import shapely
from shapely.geometry.polygon import orient

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.kit.film.drawing import Drawing, Fiducials, Project, joined
from tactape_fab.kit.panel.arrange import CORNER_RADIUS_MM, Panel, outline_of
from tactape_fab.texture.frames import FloatArray, snap_mm

_ARC_QUARTER = 16
"""Number of lines in a quarter of a slot's round end."""


def tab_middles_mm(panel: Panel) -> tuple[FloatArray, FloatArray]:
    """Centres of the tabs across vertical slots, and across horizontal ones, mm; shapes (k, 2)."""

    def along(count: int, side_mm: float, tabs: int) -> FloatArray:
        starts = panel.rail_mm + panel.gap_mm + np.arange(count) * (side_mm + panel.gap_mm)
        places: FloatArray = (starts[:, None] + side_mm * (np.arange(tabs) + 0.5) / max(tabs, 1)).ravel()
        return places

    def across(count: int, side_mm: float) -> FloatArray:
        steps: FloatArray = np.arange(count + 1, dtype=np.float64) * (side_mm + panel.gap_mm)
        return steps + panel.rail_mm + panel.gap_mm / 2

    (width, height), (columns, rows) = panel.tape_mm, (panel.columns, panel.rows)
    upright = np.stack(np.meshgrid(across(columns, width), along(rows, height, panel.tabs_x)), axis=-1).reshape(-1, 2)
    level = np.stack(np.meshgrid(along(columns, width, panel.tabs_y), across(rows, height)), axis=-1).reshape(-1, 2)
    return upright, level


def _tab(middle: FloatArray, panel: Panel, *, upright: bool) -> Any:
    """Outline of a tab across a slot; its sides are the round ends of the slot."""
    along_mm, half_gap = (panel.tab_mm + panel.gap_mm) / 2, panel.gap_mm / 2
    along = np.array([0.0, 1.0]) if upright else np.array([1.0, 0.0])
    half = along_mm * along + 2 * half_gap * along[::-1]
    ends = [shapely.Point(middle + side * along_mm * along).buffer(half_gap, quad_segs=_ARC_QUARTER) for side in (-1, 1)]
    return shapely.difference(shapely.box(*(middle - half), *(middle + half)), shapely.union_all(ends))


def slots_mm(panel: Panel) -> tuple[FloatArray, ...]:
    """Outlines of the slots, counter-clockwise, not closed, snapped to 1 nm; from the lower left on.

    Raises
    ------
    SpecError
        If a tape would not be held by any tab.
    """
    size, inner_radius = np.array(panel.size_mm), panel.gap_mm / 2
    inner_mm = (float(size[0] - 2 * panel.rail_mm), float(size[1] - 2 * panel.rail_mm))
    inner = shapely.Polygon(outline_of(inner_mm, inner_radius) + panel.rail_mm)
    tapes = [shapely.Polygon(panel.tape_outline_mm + offset) for offset in panel.offsets_mm]
    upright, level = tab_middles_mm(panel)
    tabs = [*(_tab(m, panel, upright=True) for m in upright), *(_tab(m, panel, upright=False) for m in level)]
    pieces = shapely.get_parts(shapely.difference(inner, shapely.union_all([*tapes, *tabs])))
    if any(len(piece.interiors) for piece in pieces):
        raise SpecError(Problem("tabs", "tabs hold no tape to the rails; use --tabs xy"))
    outlines = [snap_mm(np.array(orient(piece).exterior.coords)[:-1]) for piece in pieces]
    turned = [np.roll(outline, -int(np.lexsort(outline.T)[0]), axis=0) for outline in outlines]
    return tuple(sorted(turned, key=lambda outline: (outline[0, 1], outline[0, 0])))


def panel_drawing(name: str, drawings: Sequence[Drawing], panel: Panel) -> Drawing:
    """The drawing of a panel with the drawings of its tapes, in the order of `Panel.offsets_mm`."""
    offsets = panel.offsets_mm
    tapes = joined(drawings, offsets)
    key = "/".join([name, repr(panel), *(drawing.project.key for drawing in drawings)])
    return replace(
        tapes,
        project=Project(name=name, key=key, part="Array"),
        size_mm=panel.size_mm,
        corner_radius_mm=CORNER_RADIUS_MM,
        outline_mm=panel.outline_mm,
        holes=(*tapes.holes, *panel.tooling_holes_mm),
        slots_mm=slots_mm(panel),
        fiducials=None
        if not panel.fiducials_mm
        else Fiducials(xy_mm=np.array(panel.fiducials_mm), copper_mm=panel.fiducial_mm, opening_mm=panel.fiducial_opening_mm),
    )
