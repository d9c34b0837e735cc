"""Finding of a solid's elements from points: cell, centre and shape error of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tactape_fab.solids.elements import block_corners_mm, sphere_radius_mm
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.wrap import unwrapped, wrap_of
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray, board_to_texture
from tactape_fab.texture.tape import Tape

_RAISED_SHARE = 0.6
"""Fraction of an element's height above which points belong to its top."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Raised:
    """The elements that were found.

    centres_mm (k, 2): Centres in the board frame, row by row; on a cylinder along the arc at z = 0.
    cells (k,): Cell of each, row * columns + column.
    strays_mm (m, 2): Raised points outside all cells.
    shape_error_mm: Largest distance of a raised point from the element's shape.
    """

    centres_mm: FloatArray
    cells: IntArray
    strays_mm: FloatArray
    shape_error_mm: float


def cells_of(tape: Tape, xy_mm: FloatArray) -> tuple[IntArray, BoolArray]:
    """Grid cell (row * columns + column) of each board point, and whether it is in a cell."""
    with np.errstate(invalid="ignore"):  # points too far away for an integer are in no cell
        # displacement and body are within half a pitch of the grid point, so every corner rounds to its cell
        cell = np.rint(board_to_texture(xy_mm, tape.board.texture_origin_mm) / tape.pitch_mm).astype(np.int64)
    inside: BoolArray = np.asarray(((cell >= 0) & (cell < (tape.columns, tape.rows))).all(axis=1))
    key: IntArray = cell[:, 1] * tape.columns + cell[:, 0]
    return key, inside


def is_raised(tape: Tape, form: SolidForm, points_mm: FloatArray) -> BoolArray:
    """Mask of the unwrapped points well above the base (in a mould below it); shape (n,)."""
    height_mm = tape.part.body_mm[2]
    raised: BoolArray = points_mm[:, 2] > _RAISED_SHARE * height_mm
    if form.negative:
        # in the texture's frame a mould's back is above the floors of the cavities, which are the tops
        raised &= points_mm[:, 2] < height_mm + form.base_mm / 2
    return raised


def bounds_of_groups(count: int, group: IntArray, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Minimum and maximum coordinates of the points of each group, mm; infinite if it has none; shapes (count, axes)."""
    low = np.full((count, points_mm.shape[1]), np.inf)
    high = -low
    np.minimum.at(low, group, points_mm)
    np.maximum.at(high, group, points_mm)
    return low, high


def find_raised(tape: Tape, form: SolidForm, points_mm: FloatArray) -> Raised:
    """Find the elements from the points well above the base (in a mould below it), by their cells.

    points_mm (n, 3): Vertices of a mesh, or corners of a solid, in the file's frame.
    """
    points = unwrapped(points_mm, tape, form)
    points = points[is_raised(tape, form, points)]
    key, inside = cells_of(tape, points[:, :2])
    count = tape.rows * tape.columns
    low, most = bounds_of_groups(count, key[inside], points[inside, :2])
    there = np.flatnonzero(np.isfinite(low[:, 0]))
    centres = np.zeros((count, 2))
    # the middle of the bounds is the element's, for a block at any angle and for a circle of a multiple of four points
    centres[there] = (low[there] + most[there]) / 2
    offset = np.column_stack([points[inside, :2] - centres[key[inside]], points[inside, 2]])
    return Raised(
        centres_mm=centres[there],
        cells=there,
        strays_mm=points[~inside, :2],
        shape_error_mm=float(shape_errors_mm(tape, form, offset).max(initial=0.0)),
    )


def shape_errors_mm(tape: Tape, form: SolidForm, offset_mm: FloatArray) -> FloatArray:
    """Distance of points above the foot, given relative to their element's centre, from the element's surface, mm; shape (n,)."""
    part = tape.part
    local = offset_mm
    if form.cylinder is not None:
        wrap = wrap_of(tape, form, form.cylinder)
        part = wrap.part
        ab = offset_mm[:, :2] @ wrap.from_board.T
        # unwrapped offsets are arcs; they are transformed to the element's tangent frame, in which it is not bent
        out = wrap.radius_mm + offset_mm[:, 2]
        angle = ab[:, 0] / wrap.radius_mm
        local = np.column_stack([out * np.sin(angle), ab[:, 1], out * np.cos(angle) - wrap.radius_mm])
    height = part.body_mm[2]
    if part.shape == "block":
        corners = np.column_stack([block_corners_mm(part), np.full(4, height)])
        # every raised vertex of a block is a corner of its top, as the mesh has no others above the foot
        error = np.linalg.norm(local[:, None] - corners, axis=2).min(axis=1)
    elif part.top_mm is not None:
        # a flank has no vertices between foot and top, so raised ones are on the top's rim
        error = np.hypot(np.hypot(local[:, 0], local[:, 1]) - part.top_mm / 2, local[:, 2] - height)
    else:
        sphere_mm = sphere_radius_mm(part)
        error = np.abs(np.linalg.norm(local - (0.0, 0.0, height - sphere_mm), axis=1) - sphere_mm)
    return np.asarray(error)
