"""The mark of a printed texture: its sector's number and an arrow to board +y, engraved in the back.

There is no room in the field, and most margins are narrower than a digit that a printer resolves; the back has room, and stays
flat with an engraved mark. Digits and arrow consist of square cells with sides along the board's axes, which on a cylinder are
arcs and straight lines.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import pi

import numpy as np
import shapely

from tactape_fab.solids.element_lattice import build_lattice
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.wrap import wrap_of
from tactape_fab.texture.frames import BoolArray, FloatArray
from tactape_fab.texture.shapes import signed_area_mm2
from tactape_fab.texture.tape import Tape

LEAST_CELL_MM, MOST_CELL_MM = 0.4, 2.0
"""Side of a cell, which is the width of a stroke: what SLA and a nozzle of 0.4 mm print, and what is read at arm's length."""
DEPTH_MM, MOST_SHARE_OF_BASE = 0.4, 0.4
CLEAR_MM = 1.0
"""Least distance of the mark from outline and holes."""
_SHARE_OF_HEIGHT, _SHARE_OF_WIDTH, _MOST_TURN_RAD = 0.6, 0.8, pi / 2
_PLACES, _SHIFT_MM = 7, 0.013
_DIGITS = (
    ("111", "101", "101", "101", "111"),
    ("010", "110", "010", "010", "111"),
    ("111", "001", "111", "100", "111"),
    ("111", "001", "111", "001", "111"),
    ("101", "101", "111", "001", "001"),
    ("111", "100", "111", "001", "111"),
    ("111", "100", "111", "101", "111"),
    ("111", "001", "001", "001", "001"),
    ("111", "101", "111", "101", "111"),
    ("111", "101", "111", "001", "111"),
)
"""Digits in which no two cells touch only at a corner."""
_ARROW = ("00100", "01110", "11111", "00100", "00100")


def _cells(rows: tuple[str, ...]) -> BoolArray:
    return np.array([[cell == "1" for cell in row] for row in rows])


def raster(sector: int) -> BoolArray:
    """The mark's cells as they are read from the back, first row on top; shape (5, columns)."""
    gap = np.zeros((len(_ARROW), 1), dtype=bool)
    pieces = [piece for digit in str(sector) for piece in (_cells(_DIGITS[int(digit)]), gap)]
    return np.concatenate([*pieces, gap, _cells(_ARROW)], axis=1)


def read_raster(cells: BoolArray) -> int | None:
    """The number beside an arrow that points up; None if the cells are not a mark."""
    known: dict[tuple[str, ...], str] = {digit: str(k) for k, digit in enumerate(_DIGITS)}
    # blank columns separate the figures; every second piece is one, from the first on, as the mark has no blank margin
    empty = ~cells.any(axis=0)
    pieces = np.split(cells, np.flatnonzero(np.diff(empty)) + 1, axis=1)[::2]
    texts = [tuple("".join("01"[int(cell)] for cell in row) for row in piece) for piece in pieces]
    digits = [known.get(text) for text in texts[:-1]]
    if not digits or None in digits or texts[-1] != _ARROW:
        return None
    return int("".join(digit for digit in digits if digit is not None))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mark:
    """The cells of a mark on the back, in board coordinates.

    cells (5, columns): Row by row from board +y, from the left as seen from the back.
    middle_mm: Board place of its middle.
    mirrored: Whether the back is seen from below, so that columns run to board -x; not so on a mould.
    """

    cells: BoolArray
    cell_mm: float
    depth_mm: float
    middle_mm: tuple[float, float]
    mirrored: bool

    def board_mm(self, column_row: FloatArray) -> FloatArray:
        """Board places of corners of cells, given as columns and rows from the upper left corner of the mark."""
        rows, columns = self.cells.shape
        # rows count downward while board y points up; a back seen from below is mirrored along x
        turn = (-1.0 if self.mirrored else 1.0, -1.0)
        return np.array(self.middle_mm) + (column_row - np.array([columns, rows]) / 2) * self.cell_mm * turn

    def polygons(self) -> list[tuple[FloatArray, list[FloatArray]]]:
        """Outline and islands of every connected figure in board coordinates, engraved cells on the left of each loop."""
        # united in integer coordinates, in which cells share sides exactly
        boxes = [shapely.box(c, r, c + 1, r + 1) for r, c in np.argwhere(self.cells).tolist()]
        figures = shapely.get_parts(shapely.union_all(boxes).simplify(0.0))
        return [
            (self._loop(figure.exterior, ccw=True), [self._loop(ring, ccw=False) for ring in figure.interiors])
            for figure in figures
        ]

    def _loop(self, ring: shapely.LinearRing, *, ccw: bool) -> FloatArray:
        loop = self.board_mm(shapely.get_coordinates(ring)[:-1])
        corners = loop - np.roll(loop, 1, axis=0)
        turns = corners[:, 0] * np.roll(corners, -1, axis=0)[:, 1] - corners[:, 1] * np.roll(corners, -1, axis=0)[:, 0]
        loop = loop[turns != 0.0]  # simplify keeps the first point, even on a straight side
        return np.asarray(loop if (signed_area_mm2(loop) > 0.0) == ccw else loop[::-1])


def mark_of(tape: Tape, form: SolidForm) -> Mark | None:
    """The mark of a tape's solid; None if the form has none, or the back has no room for a readable one."""
    if not form.mark:
        return None
    cells = raster(tape.sector)
    return next(_marks(tape, form, cells), None)


def _marks(tape: Tape, form: SolidForm, cells: BoolArray) -> Iterator[Mark]:
    """Marks that fit, the largest first, then those nearest to the middle."""
    size_mm = np.array(tape.board.size_mm)
    widths = np.array([_SHARE_OF_WIDTH, _SHARE_OF_HEIGHT]) * size_mm
    if form.cylinder is not None:
        round_it = 0 if form.cylinder.around == "x" else 1
        # at most a quarter turn, as the STEP file has the whole mark in one strip of a third of a turn
        widths[round_it] = min(widths[round_it], _MOST_TURN_RAD * form.cylinder.radius_mm)
    rows, columns = cells.shape
    largest_mm = min(float((widths / (columns, rows)).min()), MOST_CELL_MM)
    board = shapely.box(CLEAR_MM, CLEAR_MM, *(size_mm - CLEAR_MM))
    for x, y, d in tape.board.holes:
        board = board.difference(shapely.Point(x, y).buffer(d / 2 + CLEAR_MM))
    cell_mm = np.floor(largest_mm * 10.0) / 10.0
    steps = np.arange(-_PLACES, _PLACES + 1) / (2 * _PLACES + 2)
    places = sorted(((x, y) for x in steps.tolist() for y in steps.tolist()), key=lambda at: (at[0] ** 2 + at[1] ** 2, at))
    while cell_mm >= LEAST_CELL_MM:
        for x, y in places:
            middle = size_mm * (0.5 + np.array([x, y]))
            half = np.array([columns, rows]) * cell_mm / 2
            if board.contains(shapely.box(*(middle - half), *(middle + half))):
                mark = Mark(
                    cells=cells,
                    cell_mm=float(cell_mm),
                    depth_mm=round(min(DEPTH_MM, MOST_SHARE_OF_BASE * form.base_mm), 3),
                    middle_mm=(float(middle[0]), float(middle[1])),
                    mirrored=not form.negative,
                )
                yield mark if form.cylinder is None else _between_cuts(mark, tape, form, board)
        cell_mm = round(cell_mm - 0.1, 1)


def _between_cuts(mark: Mark, tape: Tape, form: SolidForm, room: shapely.Geometry) -> Mark:
    """The mark shifted slightly around the cylinder, within `room`, so that no side of a cell is near a cut of the mesh."""
    assert form.cylinder is not None
    wrap = wrap_of(tape, form, form.cylinder)
    # a side on or beside a cut would make slivers, or two vertices so near that a reader merges them
    cuts = build_lattice(tape, wrap).a_all_mm
    corners = np.stack(np.meshgrid(*(np.arange(n + 1.0) for n in mark.cells.shape[::-1]), indexing="ij"), axis=-1).reshape(-1, 2)
    sides = np.unique(np.round(mark.board_mm(corners) @ wrap.from_board.T, 6)[:, 0])
    shifts = np.arange(40) * _SHIFT_MM
    # sides (k, 1, 1) + shifts (1, 40, 1) against cuts: for each shift the distance of the nearest pair
    apart = np.abs((sides[:, None] + shifts)[..., None] - cuts).min(axis=(0, 2))
    moved = np.array(mark.middle_mm) + np.column_stack([shifts, np.zeros(len(shifts))]) @ wrap.from_board
    half = np.array(mark.cells.shape[::-1]) * mark.cell_mm / 2
    # the unshifted place is within the room
    fits = shapely.covers(room, shapely.box(*(moved - half).T, *(moved + half).T))
    x, y = moved[int(np.where(fits, apart, -1.0).argmax())]
    return replace(mark, middle_mm=(float(x), float(y)))


def _levels(height_mm: float, base_mm: float, negative: bool) -> tuple[float, float]:
    """Height of the back over the surface with the elements, and the direction from it into the base."""
    # before a mould is turned over, its base is above the surface, behind the cavities
    return (height_mm + base_mm, -1.0) if negative else (-base_mm, 1.0)


def back_mm(tape: Tape, form: SolidForm) -> float:
    """Height of the back over the surface with the elements, mm."""
    return _levels(tape.part.body_mm[2], form.base_mm, form.negative)[0]


def floor_mm(tape: Tape, form: SolidForm, mark: Mark | None) -> float:
    """Height of the mark's floor over the surface with the elements, mm; without a mark that of the back."""
    level_mm, inward = _levels(tape.part.body_mm[2], form.base_mm, form.negative)
    return level_mm + inward * (0.0 if mark is None else mark.depth_mm)


def mark_volume_mm3(tape: Tape, form: SolidForm) -> float:
    """Volume that the mark removes."""
    mark = mark_of(tape, form)
    if mark is None:
        return 0.0
    area_mm2 = int(mark.cells.sum()) * mark.cell_mm**2
    if form.cylinder is None:
        return area_mm2 * mark.depth_mm
    r = form.cylinder.radius_mm
    # cells are measured as arcs at z = 0: a width w spans w / R rad, and a ring's sector has |R1^2 - R2^2| / 2 per radian
    return area_mm2 / r * abs((r + back_mm(tape, form)) ** 2 - (r + floor_mm(tape, form, mark)) ** 2) / 2
