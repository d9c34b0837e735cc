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
from tactape_fab.kit.panel.geometry import CORNER_RADIUS_MM, Panel
from tactape_fab.texture.frames import FloatArray, snap_mm, to_nm
from tactape_fab.texture.shapes import board_outline

_ARC_QUARTER = 16
"""Number of chords per quarter circle of a slot's round end."""


def tab_middles_mm(panel: Panel) -> tuple[FloatArray, FloatArray]:
    """Centres of the tabs across vertical slots, and across horizontal ones, mm; shapes (k, 2)."""
    found: dict[bool, dict[tuple[int, int], tuple[float, float]]] = {True: {}, False: {}}
    for place in panel.places:
        (x, y), (width, height), half = place.low_mm, place.extent_mm, panel.gap_mm / 2
        for upright, count, side, along in ((True, place.tabs_x, height, y), (False, place.tabs_y, width, x)):
            # each of `count` tabs is in the middle of one of `count` equal parts of the side
            steps = along + side * (np.arange(count) + 0.5) / max(count, 1)
            # half a gap outside the tape: the middle of the slot
            ends = (x - half, x + width + half) if upright else (y - half, y + height + half)
            for middle in [(end, step) if upright else (step, end) for end in ends for step in steps.tolist()]:
                # compared in whole nanometres, as two tapes give the middle of a shared slot with different rounding
                a, b = to_nm(np.array(middle)).tolist()
                found[upright].setdefault((a, b), middle)  # neighbours in a grid share their tabs
    upright_mm, level_mm = (np.array([*found[way].values()]).reshape(-1, 2) for way in (True, False))
    return upright_mm, level_mm


def _cut_area(panel: Panel) -> Any:
    """Union of slots and tapes: everything within the rails of a grid, or each packed tape with the slot around it."""
    frames = [((panel.rail_mm,) * 2, tuple(side - 2 * panel.rail_mm for side in panel.size_mm))]
    if panel.grid is None:
        gap_mm = panel.gap_mm
        frames = [
            ((place.low_mm[0] - gap_mm, place.low_mm[1] - gap_mm), tuple(side + 2 * gap_mm for side in place.extent_mm))
            for place in panel.places
        ]
    # outer corners have a radius of half the gap, as a router bit as wide as the slot leaves them
    return shapely.union_all([shapely.Polygon(board_outline((w, h), panel.gap_mm / 2) + low) for low, (w, h) in frames])


def _tab(middle: FloatArray, panel: Panel, *, upright: bool) -> Any:
    """Outline of a tab across a slot; its sides are the round ends of the slot."""
    # the discs are tab + gap apart, and each takes half a gap from its side of the tab, whose narrowest width is then tab_mm
    along_mm, half_gap = (panel.tab_mm + panel.gap_mm) / 2, panel.gap_mm / 2
    along = np.array([0.0, 1.0]) if upright else np.array([1.0, 0.0])
    # across the slot the box is twice as wide as the slot, so that no sliver
    # of it is left beside the tab; the rest overlaps tape and rail
    half = along_mm * along + 2 * half_gap * along[::-1]
    ends = [shapely.Point(middle + side * along_mm * along).buffer(half_gap, quad_segs=_ARC_QUARTER) for side in (-1, 1)]
    return shapely.difference(shapely.box(*(middle - half), *(middle + half)), shapely.union_all(ends))


def slots_mm(panel: Panel) -> tuple[FloatArray, ...]:
    """Outlines of the slots, counter-clockwise, not closed, snapped to 1 nm; from the lower left on.

    Raises SpecError if a tape would not be held by any tab.
    """
    inner = _cut_area(panel)
    tapes = [shapely.Polygon(place.outline_mm) for place in panel.places]
    upright, level = tab_middles_mm(panel)
    tabs = [*(_tab(m, panel, upright=True) for m in upright), *(_tab(m, panel, upright=False) for m in level)]
    pieces = shapely.get_parts(shapely.difference(inner, shapely.union_all([*tapes, *tabs])))
    # a slot that is a closed ring holds nothing inside
    if any(len(piece.interiors) for piece in pieces):
        raise SpecError(Problem("tabs", "tabs hold no tape to the rails; use --tabs xy"))
    outlines = [_distinct(snap_mm(np.array(orient(piece).exterior.coords)[:-1])) for piece in pieces]
    # rings start at the lowest, then leftmost vertex: GEOS may start anywhere, and files must be reproducible
    turned = [np.roll(outline, -int(np.lexsort(outline.T)[0]), axis=0) for outline in outlines]
    return tuple(sorted(turned, key=lambda outline: (outline[0, 1], outline[0, 0])))


def _distinct(outline: FloatArray) -> FloatArray:
    """A closed outline without consecutive points that snapping made equal."""
    return np.asarray(outline[(outline != np.roll(outline, 1, axis=0)).any(axis=1)])


def panel_drawing(name: str, drawings: Sequence[Drawing], panel: Panel) -> Drawing:
    """The drawing of a panel with the drawings of its tapes, in the order of `Panel.places`."""
    tapes = joined(drawings, [(place.offset_mm, place.turned) for place in panel.places])
    key = "/".join([name, panel.key, *(drawing.project.key for drawing in drawings)])
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
