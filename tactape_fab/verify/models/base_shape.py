"""Check of the base in a texture's mesh by its vertices: faces, outline and holes of the base, feet and flanks of elements.

The volume does not show errors that are small, or that cancel.
"""

from __future__ import annotations

from math import pi

import numpy as np

from tactape_fab.base.errors import Check
from tactape_fab.solids.elements import block_corners_mm
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mark import back_mm, floor_mm, mark_of
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.rise import foot_radius_mm
from tactape_fab.solids.wrap import unwrapped, wrap_of
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray
from tactape_fab.texture.shapes import inset_mm
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.models.raised import cells_of, is_raised, shape_errors_mm

_LEVEL_MM, _PLACE_MM = 0.002, 0.005
"""Tolerances: STL has 24 bits of mantissa, 0.03 um at 500 mm; round feet and holes are polygons with vertices on the curve."""
_SAGITTA_MM = 0.02
"""Largest sagitta of a round foot's chords: they have at most 0.015 mm, and four times that if a vertex is missing."""


def check_base(tape: Tape, form: SolidForm, mesh: Mesh) -> Check:
    """Check that every vertex that is not on an element's top is on a face of the base, and that every element has its foot."""
    points = unwrapped(mesh.vertices_mm, tape, form)
    mark = mark_of(tape, form) if form.mark else None
    back, floor = back_mm(tape, form), floor_mm(tape, form, mark)
    on_top, on_back, on_floor = (np.abs(points[:, 2] - level) <= _LEVEL_MM for level in (0.0, back, floor))
    cells, offset = _about_elements(tape, points)
    flank = _on_flank(tape, form, points, cells, offset)
    lost = ~(on_top | on_back | on_floor | flank | is_raised(tape, form, points))
    problems = []
    if lost.any():
        x, y, z = points[lost][0]
        where = f"first at ({x:.3f}, {y:.3f}, {z:.3f}) mm"
        problems.append(f"{int(lost.sum())} vertices on no face of the base and on no element, {where}")
    for what, on in (("top", on_top), ("back", on_back)):
        if (off := _outline_mm(tape, form, points[on, :2])) > _LEVEL_MM:
            problems.append(f"the base's {what} does not end at its outline, by {off * 1000:.1f} um")
    inside = _inside_holes(tape, points[:, :2])
    if inside.any():
        problems.append(f"{int(inside.sum())} vertices are inside holes")
    if (wrong := _wrong_feet(tape, form, cells[on_top], offset[on_top])) > 0:
        problems.append(f"{wrong} elements do not stand on the base with the manifest's foot")
    right = "every other vertex is on a face of the base, its outline, a hole, or an element's flank or foot"
    return Check(name="stl base", passed=not problems, message="; ".join(problems) or right)


def _about_elements(tape: Tape, points: FloatArray) -> tuple[IntArray, FloatArray]:
    """Cell of the element near each point, -1 for none, and offset from the element in the board's plane; (n,), (n, 2)."""
    key, inside = cells_of(tape, points[:, :2])
    element = np.full(tape.rows * tape.columns, -1)
    element[tape.cells() @ (1, tape.columns)] = np.arange(tape.part_count)
    index: IntArray = np.where(inside, element[np.where(inside, key, 0)], -1)
    return index, points[:, :2] - tape.part_xy_mm()[index]


def _on_flank(tape: Tape, form: SolidForm, points: FloatArray, cells: IntArray, offset: FloatArray) -> BoolArray:
    """Mask of the points on an element's side between foot and top, where only spherical caps have vertices."""
    on = np.zeros(len(points), dtype=bool)
    if tape.part.shape == "dome" and tape.part.top_mm is None:
        some = (cells >= 0) & (points[:, 2] > 0.0) & (points[:, 2] < tape.part.body_mm[2])
        on[some] = shape_errors_mm(tape, form, np.column_stack([offset[some], points[some, 2]])) <= _PLACE_MM
    return on


def _outline_mm(tape: Tape, form: SolidForm, xy_mm: FloatArray) -> float:
    """Largest distance by which points are beyond the outline, or by which a side has none on it; infinite without points."""
    if len(xy_mm) == 0:
        return float("inf")
    low, high, size = xy_mm.min(axis=0), xy_mm.max(axis=0), np.array(tape.board.size_mm)
    sides = np.maximum(np.abs(low), np.abs(high - size))
    if form.cylinder is None:
        beyond = -inset_mm(xy_mm, tape.board.size_mm, tape.board.corner_radius_mm).min()
        return float(max(beyond, *sides))
    # a wrapped base has square corners; a whole shell has no ends along the arc
    whole = form.cylinder.shell == "whole"
    return float(sides[1 if form.cylinder.around == "x" else 0] if whole else sides.max())


def _inside_holes(tape: Tape, xy_mm: FloatArray) -> BoolArray:
    inside = np.zeros(len(xy_mm), dtype=bool)
    for x, y, diameter in tape.board.holes:
        inside |= np.hypot(xy_mm[:, 0] - x, xy_mm[:, 1] - y) < diameter / 2 - _PLACE_MM
    return inside


def _wrong_feet(tape: Tape, form: SolidForm, cells: IntArray, offset_mm: FloatArray) -> int:
    """Number of elements whose foot lacks a vertex among the points on the base's top."""
    there = cells >= 0
    cells, local, part = cells[there], offset_mm[there], tape.part
    radius_mm = np.inf
    if form.cylinder is not None:
        wrap = wrap_of(tape, form, form.cylinder)
        local, part, radius_mm = local @ wrap.from_board.T, wrap.part, wrap.radius_mm
        # from the arc to the tangent plane, in which an element is not bent
        local = np.column_stack([radius_mm * np.sin(local[:, 0] / radius_mm), local[:, 1]])
    if part.shape == "block":
        corners = block_corners_mm(part)
        near = np.linalg.norm(local[:, None] - corners, axis=2) <= _PLACE_MM
        counts = np.stack([np.bincount(cells[near[:, k]], minlength=tape.part_count) for k in range(4)])
        return int((counts == 0).any(axis=0).sum())
    r = np.hypot(*local.T)
    foot = np.full_like(r, part.body_mm[0] / 2)
    if form.cylinder is not None:
        # the foot is equal for all elements, so a table by direction is used: each value takes a bisection
        direction = np.linspace(-pi, pi, 4097)
        foot = np.interp(np.arctan2(local[:, 1], local[:, 0]), direction, foot_radius_mm(part, radius_mm, direction))
    on = np.abs(r - foot) <= _PLACE_MM
    if not on.any():
        return tape.part_count
    cells, direction_rad = cells[on], np.arctan2(local[on, 1], local[on, 0])
    order = np.lexsort([direction_rad, cells])
    cells, direction_rad = cells[order], direction_rad[order]
    # from each vertex to the next, and from the last to the first
    gap = np.diff(direction_rad, append=0.0)
    first = np.flatnonzero(np.diff(cells, prepend=-1))
    last = np.append(first[1:], len(cells)) - 1
    gap[last] = 2 * pi + direction_rad[first] - direction_rad[last]
    widest = np.full(tape.part_count, 2 * pi)
    widest[cells[first]] = np.maximum.reduceat(gap, first)
    # sagitta of a chord over this angle
    return int((part.body_mm[0] / 2 * (1 - np.cos(np.minimum(widest, pi) / 2)) > _SAGITTA_MM).sum())
