"""Elements of a solid found from points alone: cell, centre and shape error of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tactape_fab.solids.elements import block_corners_mm, sphere_radius_mm
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.wrap import unwrapped, wrap_of
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray, board_to_texture
from tactape_fab.texture.tape import Tape

_RAISED_SHARE = 0.6
"""Points above this fraction of an element's height belong to its top."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Raised:
    """Elements found.

    centres_mm (k, 2): Centres in the board frame, row by row; on a cylinder along the arc at z = 0.
    cells (k,): Row * columns + column of each.
    strays_mm (m, 2): Raised points in no cell.
    shape_error_mm: Largest distance of a raised point from the element's shape.
    """

    centres_mm: FloatArray
    cells: IntArray
    strays_mm: FloatArray
    shape_error_mm: float


def cells_of(tape: Tape, xy_mm: FloatArray) -> tuple[IntArray, BoolArray]:
    """Index (row * columns + column) of the grid cell of each board point, and whether it lies in a cell."""
    with np.errstate(invalid="ignore"):  # what is too far for a number is in no cell, whatever becomes of it
        # displacement and body stay within half a pitch of the grid point, so every corner rounds to its own cell
        cell = np.rint(board_to_texture(xy_mm, tape.board.texture_origin_mm) / tape.pitch_mm).astype(np.int64)
    inside: BoolArray = np.asarray(((cell >= 0) & (cell < (tape.columns, tape.rows))).all(axis=1))
    key: IntArray = cell[:, 1] * tape.columns + cell[:, 0]
    return key, inside


def is_raised(tape: Tape, form: SolidForm, points_mm: FloatArray) -> BoolArray:
    """Which unwrapped points are well above the base (below it, in a mould); shape (n,)."""
    height_mm = tape.part.body_mm[2]
    raised: BoolArray = points_mm[:, 2] > _RAISED_SHARE * height_mm
    if form.negative:
        # in the frame of the texture a mould's back lies above the cavities' floors, which are the tops
        raised &= points_mm[:, 2] < height_mm + form.base_mm / 2
    return raised


def bounds_of_groups(count: int, group: IntArray, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and greatest coordinates of the points of each group, mm; infinite if it has none; shapes (count, axes)."""
    low = np.full((count, points_mm.shape[1]), np.inf)
    high = -low
    np.minimum.at(low, group, points_mm)
    np.maximum.at(high, group, points_mm)
    return low, high


def find_raised(tape: Tape, form: SolidForm, points_mm: FloatArray) -> Raised:
    """Gather the points well above the base (below it, in a mould) by their cells.

    points_mm (n, 3): Vertices of a mesh, or corners of a solid, in the file's frame.
    """
    points = unwrapped(points_mm, tape, form)
    points = points[is_raised(tape, form, points)]
    key, inside = cells_of(tape, points[:, :2])
    count = tape.rows * tape.columns
    low, most = bounds_of_groups(count, key[inside], points[inside, :2])
    there = np.flatnonzero(np.isfinite(low[:, 0]))
    centres = np.zeros((count, 2))
    # bounds of a block turned by any angle, of a circle of a multiple of four points: their middle is the element's
    centres[there] = (low[there] + most[there]) / 2
    offset = np.column_stack([points[inside, :2] - centres[key[inside]], points[inside, 2]])
    return Raised(
        centres_mm=centres[there],
        cells=there,
        strays_mm=points[~inside, :2],
        shape_error_mm=float(shape_errors_mm(tape, form, offset).max(initial=0.0)),
    )


def shape_errors_mm(tape: Tape, form: SolidForm, offset_mm: FloatArray) -> FloatArray:
    """Distance of points above the foot, given relative to their element's centre, from the element's shape, mm; shape (n,)."""
    part = tape.part
    local = offset_mm
    if form.cylinder is not None:
        wrap = wrap_of(tape, form, form.cylinder)
        part = wrap.part
        ab = offset_mm[:, :2] @ wrap.from_board.T
        # unwrapped offsets are arcs: turned back about the axis into the element's tangent frame, where it is not bent
        out = wrap.radius_mm + offset_mm[:, 2]
        angle = ab[:, 0] / wrap.radius_mm
        local = np.column_stack([out * np.sin(angle), ab[:, 1], out * np.cos(angle) - wrap.radius_mm])
    height = part.body_mm[2]
    if part.shape == "block":
        corners = np.column_stack([block_corners_mm(part), np.full(4, height)])
        # every raised vertex of a block must be a corner of its top; the mesh has no others above the foot
        error = np.linalg.norm(local[:, None] - corners, axis=2).min(axis=1)
    elif part.top_mm is not None:
        # a flank has no vertices between foot and top: raised ones are on the top's rim
        error = np.hypot(np.hypot(local[:, 0], local[:, 1]) - part.top_mm / 2, local[:, 2] - height)
    else:
        sphere_mm = sphere_radius_mm(part)
        error = np.abs(np.linalg.norm(local - (0.0, 0.0, height - sphere_mm), axis=1) - sphere_mm)
    return np.asarray(error)
