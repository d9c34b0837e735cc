"""Planar part of a texture's mesh: cells, the rest of the board around them, and their triangulation, with shared vertices.

Working coordinates are (a, b): board x and y, or arc length and place along a cylinder. On a cylinder everything is cut by
lines of constant a, so close that a flat triangle between two of them is on the cylinder within the tolerance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, pi, sqrt

import numpy as np
import shapely

from tactape_fab.solids.elements import block_corners_mm, reach_mm
from tactape_fab.solids.rise import foot_radius_mm
from tactape_fab.solids.wrap import Wrap
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray, IntArray
from tactape_fab.texture.shapes import board_outline, inset_mm, signed_area_mm2
from tactape_fab.texture.tape import Tape

CHORD_ERROR_MM = 0.001
"""Largest distance of a triangle from a cylinder, mm."""
HOLE_CHORD_ERROR_MM = 0.002
_LEAST_MARGIN_MM = 0.05
_CLEAR_MM = 0.001
_KEY_DECIMALS = 7
_CLEAR_OF_CORNER_MM = 0.01
_MOST_MOVES = 40


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lattice:
    """Lines of constant a and b between the cells of the grid, and the board's ends.

    a_mm, b_mm: Borders of cells, ascending; cell (i, j) is between lines i, i + 1 and j, j + 1.
    slices: Number of slices of each cell along a; 1 on a plane.
    a_fine_mm: Borders of cells and of their slices along a.
    a_all_mm: All lines along a, board ends included.
    cell_of_part (n, 2): (i, j) of every placed part.
    local_mm (n, 2): Centre of every placed part, (a, b).
    """

    a_mm: FloatArray
    b_mm: FloatArray
    slices: int
    a_fine_mm: FloatArray
    a_all_mm: FloatArray
    cell_of_part: IntArray
    local_mm: FloatArray


def build_lattice(tape: Tape, wrap: Wrap | None) -> Lattice:
    """Lines half way between neighbouring grid points; the outermost lie inside the board."""
    turn = np.eye(2) if wrap is None else wrap.from_board
    cells = tape.cells()
    grid = np.array([(0, 0), (tape.columns - 1, tape.rows - 1)])
    x0, y0 = tape.board.texture_origin_mm
    ends = (np.array([x0, y0]) + grid * tape.pitch_mm * (1.0, -1.0)) @ turn.T
    low, high = ends.min(axis=0), ends.max(axis=0)
    board = np.array([(0.0, 0.0), tape.board.size_mm]) @ turn.T
    board_low, board_high = board.min(axis=0), board.max(axis=0)
    reach = np.array(reach_mm(tape.part)) @ np.abs(turn).T + tape.displacement_mm
    lines = [_axis_lines(low[k], high[k], board_low[k], board_high[k], tape.pitch_mm, reach[k]) for k in (0, 1)]
    centre = (np.array([x0, y0]) + cells * tape.pitch_mm * (1.0, -1.0)) @ turn.T
    slices = 1
    fine = across = lines[0]
    if wrap is not None:
        # sagitta of a chord of length s on a circle of radius R: s^2 / 8R
        step_mm = sqrt(8 * wrap.radius_mm * CHORD_ERROR_MM)
        slices = ceil(float(np.diff(lines[0]).max()) / step_mm)
        fine = _sliced(lines[0], low[0] + np.arange(len(lines[0]) - 1) * tape.pitch_mm, slices, _kept_clear_mm(tape, wrap))
        # a whole shell continues from the board's end to its beginning: the last line is the first one, a turn later
        end = board_high[0] if wrap.cylinder.shell == "segment" else board_low[0] + 2 * pi * wrap.radius_mm
        across = np.concatenate([_between(board_low[0], fine[0], step_mm)[:-1], fine[:-1], _between(fine[-1], end, step_mm)])
    return Lattice(
        a_mm=lines[0],
        b_mm=lines[1],
        slices=slices,
        a_fine_mm=fine,
        a_all_mm=across,
        cell_of_part=np.rint((centre - low) / tape.pitch_mm).astype(np.int64),
        local_mm=tape.part_xy_mm() @ turn.T,
    )


def _kept_clear_mm(tape: Tape, wrap: Wrap) -> FloatArray:
    """Arc offsets from a grid point at which an element, at any displacement, has a corner, begins or ends."""
    if wrap.part.shape == "block":
        offsets = block_corners_mm(wrap.part)[:, 0]
    else:
        offsets = foot_radius_mm(wrap.part, wrap.radius_mm, np.array([0.0, pi])) * (1.0, -1.0)
    arcs = wrap.radius_mm * np.arcsin(offsets / wrap.radius_mm)
    # components along x; those along y are the same set, so it does not matter which board axis is wrapped
    moved_mm = tape.displacement_mm * np.unique(DIRECTIONS_XY[: tape.directions, 0])
    return np.unique((arcs[:, None] + moved_mm).ravel())


def _sliced(lines: FloatArray, centres: FloatArray, slices: int, clear_mm: FloatArray) -> FloatArray:
    """Cell borders and the lines that slice each cell, none of these near a corner of an element.

    A line that only touched a foot would make a vertex on one side of it only.
    """
    # fractions of each cell's own width, as the outermost cells may be narrower than a pitch
    shares = np.arange(1, slices) / slices
    inner = lines[:-1, None] + shares * np.diff(lines)[:, None]
    offset = inner - centres[:, None]
    for _ in range(_MOST_MOVES):
        apart = offset[..., None] - clear_mm
        nearest = np.take_along_axis(apart, np.abs(apart).argmin(axis=-1)[..., None], axis=-1)[..., 0]
        near = np.abs(nearest) < _CLEAR_OF_CORNER_MM
        if not near.any():
            break
        # always moved to the same side, until no line is near a corner; 40 moves are 0.4 mm
        offset = np.where(near, offset - nearest + 1.01 * _CLEAR_OF_CORNER_MM, offset)
    fine = np.concatenate([lines[:-1, None], centres[:, None] + offset], axis=1).ravel()
    return np.append(fine, lines[-1])


def _between(a: float, b: float, step_mm: float) -> FloatArray:
    return np.linspace(a, b, max(ceil((b - a) / step_mm), 1) + 1)


def _axis_lines(low: float, high: float, board_low: float, board_high: float, pitch: float, reach: float) -> FloatArray:
    count = round((high - low) / pitch) + 1
    lines: FloatArray = low + (np.arange(count + 1, dtype=np.float64) - 0.5) * pitch
    # if half a pitch beyond the last grid points is off the board, the line is half way between its end and the elements
    if lines[0] < board_low + _LEAST_MARGIN_MM:
        lines[0] = (board_low + low - reach) / 2
    if lines[-1] > board_high - _LEAST_MARGIN_MM:
        lines[-1] = (board_high + high + reach) / 2
    return lines


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rims:
    """Outline and holes as closed polygons (a, b): the outline counter-clockwise, the holes clockwise.

    ``closed`` is True if the ends of the outline along a coincide, as on a whole shell.
    """

    outline: FloatArray
    holes: tuple[FloatArray, ...]
    closed: bool = False


def build_rims(tape: Tape, lattice: Lattice, wrap: Wrap | None) -> Rims:
    """Rims of a board, mm: those of its outline and holes, or of the rectangle that is wrapped round a cylinder."""
    if wrap is None:
        outline = board_outline(tape.board.size_mm, tape.board.corner_radius_mm)
        return Rims(outline=outline, holes=tuple(_circle(*hole) for hole in tape.board.holes))
    a, (low, high) = lattice.a_all_mm, wrap.b_mm
    outline = np.concatenate([np.column_stack([a, np.full_like(a, low)]), np.column_stack([a[::-1], np.full_like(a, high)])])
    return Rims(outline=outline, holes=(), closed=wrap.cylinder.shell == "whole")


def _circle(x: float, y: float, diameter: float) -> FloatArray:
    """A hole clockwise."""
    # sagitta of a chord of n: d / 2 (1 - cos(pi / n)) <= e; tiny holes get 16 corners
    points = max(16, ceil(pi / np.arccos(max(1 - 2 * HOLE_CHORD_ERROR_MM / diameter, 0.5))))
    angle = -np.arange(points) * (2 * pi / points)
    return np.stack([x + diameter / 2 * np.cos(angle), y + diameter / 2 * np.sin(angle)], axis=1)


def whole_cells(tape: Tape, lattice: Lattice, wrap: Wrap | None) -> IntArray:
    """Indices of placed parts whose entire cell is inside the outline and clear of every hole."""
    if wrap is not None:
        # on a cylinder there are no holes or rounded corners (`checks`), and every line is inside the board
        return np.arange(tape.part_count)
    i, j = lattice.cell_of_part.T
    a, b = lattice.a_mm, lattice.b_mm
    corners = np.stack([np.stack([a[i + di], b[j + dj]], axis=1) for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1))], axis=1)
    good = inset_mm(corners, tape.board.size_mm, tape.board.corner_radius_mm).min(axis=1) > _CLEAR_MM
    for x, y, d in tape.board.holes:
        # distance of a hole's centre from a cell along each axis, 0 inside
        gap_a = np.maximum(np.maximum(a[i] - x, x - a[i + 1]), 0.0)
        gap_b = np.maximum(np.maximum(b[j] - y, y - b[j + 1]), 0.0)
        good &= np.hypot(gap_a, gap_b) > d / 2 + _CLEAR_MM
    return np.flatnonzero(good)


def cell_loops(lattice: Lattice, parts: IntArray) -> list[FloatArray]:
    """Boundary loops of the union of the cells of `parts`, with the cells on the left and all lattice vertices on them."""
    columns, rows = len(lattice.a_mm) - 1, len(lattice.b_mm) - 1
    # padded by empty cells, so that borders need no special case
    mask = np.zeros((columns + 2, rows + 2), dtype=bool)
    i, j = lattice.cell_of_part[parts].T
    mask[i + 1, j + 1] = True
    following: dict[tuple[int, int], list[tuple[int, int]]] = {}
    # for an empty neighbour on each side, the edge from corner a to corner b with the cell on its left
    for (di, dj), (ai, aj), (bi, bj) in (
        ((0, -1), (0, 0), (1, 0)),
        ((1, 0), (1, 0), (1, 1)),
        ((0, 1), (1, 1), (0, 1)),
        ((-1, 0), (0, 1), (0, 0)),
    ):
        border = mask[1:-1, 1:-1] & ~mask[1 + di : columns + 1 + di, 1 + dj : rows + 1 + dj]
        for ci, cj in np.argwhere(border).tolist():
            following.setdefault((ci + ai, cj + aj), []).append((ci + bi, cj + bj))
    loops = []
    while following:
        at = next(iter(following))
        loop: list[tuple[int, int]] = []
        while at in following:
            ways = following[at]
            # two edges leave a corner at which two cells touch diagonally
            way = ways[0] if len(ways) == 1 or not loop else min(ways, key=lambda to: _turn(loop[-1], at, to))
            ways.remove(way)
            if not ways:
                del following[at]
            loop.append(at)
            at = way
        loops.append(_with_slices(lattice, np.array(loop)))
    return loops


def _turn(before: tuple[int, int], at: tuple[int, int], to: tuple[int, int]) -> int:
    """Sort key that is smallest for the leftmost turn, so that diagonally touching cells are separate loops."""
    return -((at[0] - before[0]) * (to[1] - at[1]) - (at[1] - before[1]) * (to[0] - at[0]))


def _with_slices(lattice: Lattice, loop: IntArray) -> FloatArray:
    a, b, n = lattice.a_mm, lattice.b_mm, lattice.slices
    points = []
    for (i, j), (k, _) in zip(loop.tolist(), np.roll(loop, -1, axis=0).tolist(), strict=True):
        points.append((a[i], b[j]))
        if k != i and n > 1:
            inside = lattice.a_fine_mm[min(i, k) * n + 1 : max(i, k) * n]
            points += [(x, b[j]) for x in (inside if k > i else inside[::-1]).tolist()]
    return np.array(points)


def rest_of_board(rims: Rims, loops: list[FloatArray], feet: list[FloatArray]) -> shapely.Geometry:
    """The board less holes, whole cells, and the feet of elements in other cells."""
    board = shapely.Polygon(rims.outline, list(rims.holes))
    outer = [loop for loop in loops if signed_area_mm2(loop) > 0.0]
    inner = [loop for loop in loops if signed_area_mm2(loop) < 0.0]
    islands = [shapely.Polygon(loop) for loop in inner]
    fields = [shapely.Polygon(loop) for loop in outer]
    rest = board
    for field in fields:
        # a clockwise loop is an island of the board among cells
        holes = [island.exterior.coords for island in islands if field.contains(island.representative_point())]
        rest = rest.difference(shapely.Polygon(field.exterior.coords, holes))
    for foot in feet:
        rest = rest.difference(shapely.Polygon(foot))
    return rest


def triangulated(region: shapely.Geometry, cuts_mm: FloatArray | None) -> Iterator[FloatArray]:
    """Counter-clockwise triangles of a region, shape (k, 3, 2), without new vertices; cut along lines of constant a if given."""
    pieces = [region]
    if cuts_mm is not None:
        _, low, _, high = region.bounds
        # triangles across a line of the lattice would deviate from the cylinder by more than the tolerance
        strips = shapely.box(cuts_mm[:-1], low - 1.0, cuts_mm[1:], high + 1.0)
        pieces = list(shapely.intersection(region, strips))
    for piece in pieces:
        for polygon in shapely.get_parts(piece):
            if polygon.geom_type != "Polygon" or polygon.is_empty:
                continue
            # adds no points, so that neighbours share the vertices of their common border
            parts = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
            corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
            u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
            wrong = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] < 0.0
            corners[wrong] = corners[wrong][:, ::-1]
            yield corners


class Numbers:
    """Numbers points of the plane; equal points get the same number."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[float, float], int] = {}
        self.points: list[tuple[float, float]] = []

    def __call__(self, points_mm: FloatArray) -> IntArray:
        """Numbers of points, shape (..., 2) -> (...)."""
        flat = points_mm.reshape(-1, 2)
        # rounded, as GEOS may change the last bits in intersections; + 0.0 turns -0.0 into 0.0
        keys = np.round(flat, _KEY_DECIMALS) + 0.0
        numbers = []
        for key, point in zip(map(tuple, keys.tolist()), flat.tolist(), strict=True):
            number = self._numbers.setdefault(key, len(self.points))
            if number == len(self.points):
                self.points.append((point[0], point[1]))
            numbers.append(number)
        return np.array(numbers, dtype=np.int64).reshape(points_mm.shape[:-1])
