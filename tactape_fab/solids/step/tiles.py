"""The board's top face cut into tiles by lines between elements, as a planar map with arcs and holes.

CAD kernels take quadratic time in the number of a face's inner loops, of which tiles of 6 x 6 cells have few.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import acos, asin, atan2, cos, hypot, pi, sin

import numpy as np

from tactape_fab.base.errors import RenderError
from tactape_fab.solids.elements import reach_mm
from tactape_fab.texture.board import Board
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.tape import Tape

CELLS_PER_TILE = 6
_LEAST_EDGE_MM = 0.002
_NUDGES = (0.0, 0.3, -0.3, 0.6, -0.6, 0.45, -0.45, 0.15, -0.15, 0.75, -0.75)
_SAMPLES = 8

Point = tuple[float, float]
Step = tuple[int, bool]
"""An edge, and whether it is followed from its start to its end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Arc:
    """A counter-clockwise arc about `centre_mm`, from `start_rad` to the larger `end_rad`."""

    centre_mm: Point
    radius_mm: float
    start_rad: float
    end_rad: float

    def point(self, angle_rad: float) -> Point:
        """The point at an angle, mm, also beyond the arc's ends."""
        return self.centre_mm[0] + self.radius_mm * cos(angle_rad), self.centre_mm[1] + self.radius_mm * sin(angle_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapEdge:
    """An edge of the map; `wall` is the number of its side, corner or hole, None for a line between tiles."""

    start: int
    end: int
    arc: Arc | None
    wall: int | None
    hole: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TopMap:
    """The top face as a planar map (board frame, mm).

    edges: Edges of outline and holes are counter-clockwise about the board and about the hole.
    tiles: Loops of every tile, the outer one first, with the material on the left.
    rims: The outline and every hole as one loop each, with the material on the left.
    tile_of_part (n,): Tile below each placed part, in designator order.
    """

    vertices_mm: list[Point]
    edges: list[MapEdge]
    tiles: list[list[list[Step]]]
    rims: list[list[Step]]
    tile_of_part: IntArray


def top_map(tape: Tape, *, tiled: bool) -> TopMap:
    """Cut a tape's top face into tiles of 6 x 6 cells, or leave it whole.

    Lines are half way between two columns or rows of elements; if one is nearly tangent to a hole or at the end of a rounded
    corner, all are shifted slightly.
    """
    reach = np.array(reach_mm(tape.part)) + tape.displacement_mm
    # distance of a line from the next element at any displacement; shifts take at most three quarters of it
    slack = np.maximum(tape.pitch_mm / 2 - reach, 0.0)
    x0, y0 = tape.board.texture_origin_mm
    columns = np.arange(CELLS_PER_TILE, tape.columns, CELLS_PER_TILE) - 0.5 if tiled else np.empty(0)
    rows = np.arange(CELLS_PER_TILE, tape.rows, CELLS_PER_TILE) - 0.5 if tiled else np.empty(0)
    for nudge in _NUDGES:
        xs = (x0 + columns * tape.pitch_mm + nudge * slack[0]).tolist()
        ys = (y0 - rows[::-1] * tape.pitch_mm + nudge * slack[1] / 2).tolist()
        drawing = _Drawing(tape.board, xs, ys)
        if drawing.clean():
            return drawing.map(tape.part_xy_mm())
    raise RenderError("the solid's top face cannot be cut into tiles between its holes; use --top single")


def _outline(board: Board) -> Iterator[tuple[Point, Point, Arc | None]]:
    """Sides and corners counter-clockwise from the lower left corner's end."""
    (w, h), r = board.size_mm, board.corner_radius_mm
    sides = (((r, 0.0), (w - r, 0.0)), ((w, r), (w, h - r)), ((w - r, h), (r, h)), ((0.0, h - r), (0.0, r)))
    centres = ((w - r, r), (w - r, h - r), (r, h - r), (r, r))
    for k, ((a, b), centre) in enumerate(zip(sides, centres, strict=True)):
        if hypot(b[0] - a[0], b[1] - a[1]) > _LEAST_EDGE_MM / 2:
            yield a, b, None
        if r > 0.0:
            # the corner after the bottom side turns from -90 deg to 0, and so on counter-clockwise
            arc = Arc(centre_mm=centre, radius_mm=r, start_rad=(k - 1) * pi / 2, end_rad=k * pi / 2)
            yield b, sides[(k + 1) % 4][0], arc


class _Drawing:
    """Lines, outline and holes, cut at their intersections."""

    def __init__(self, board: Board, xs: Sequence[float], ys: Sequence[float]) -> None:
        self.board, self.xs, self.ys = board, xs, ys
        self.vertices: list[Point] = []
        self.edges: list[MapEdge] = []
        self._on_line: dict[tuple[int, int], list[tuple[float, int, int]]] = {}  # (axis, line) -> (place, vertex, side)
        self._outline_edges()
        self._hole_edges()
        self._line_edges()

    def _vertex(self, point: Point) -> int:
        self.vertices.append(point)
        return len(self.vertices) - 1

    def _cross(self, axis: int, line: int, point: Point, vertex: int, into: bool) -> None:
        """Record that tile line `line` of `axis` crosses a rim; `into`: followed upward it enters the material."""
        self._on_line.setdefault((axis, line), []).append((point[1 - axis], vertex, 1 if into else -1))

    def _outline_edges(self) -> None:
        pieces = list(_outline(self.board))
        starts = [self._vertex(a) for a, _, _ in pieces]
        for k, (a, b, arc) in enumerate(pieces):
            cuts = sorted(self._cuts_of_side(a, b) if arc is None else self._cuts_of_arc(arc, hole=False))
            self._chain(starts[k], starts[(k + 1) % len(pieces)], arc, cuts, wall=k)
        self._walls = len(pieces)

    def _hole_edges(self) -> None:
        for x, y, d in self.board.holes:
            circle = Arc(centre_mm=(x, y), radius_mm=d / 2, start_rad=0.0, end_rad=2 * pi)
            cuts = sorted(self._cuts_of_arc(circle, hole=True))
            # two halves, as a circle as one edge would start and end at the same vertex
            if not cuts:
                cuts = [(0.0, self._vertex(circle.point(0.0))), (pi, self._vertex(circle.point(pi)))]
            for (a, start), (b, end) in zip(cuts, [*cuts[1:], (cuts[0][0] + 2 * pi, cuts[0][1])], strict=True):
                arc = Arc(centre_mm=(x, y), radius_mm=d / 2, start_rad=a, end_rad=b)
                self.edges.append(MapEdge(start=start, end=end, arc=arc, wall=self._walls, hole=True))
                self._walls += 1

    def _cuts_of_side(self, a: Point, b: Point) -> Iterator[tuple[float, int]]:
        axis = 0 if a[1] == b[1] else 1  # the coordinate that runs
        forward = b[axis] > a[axis]
        for line, place in enumerate(self.xs if axis == 0 else self.ys):
            if min(a[axis], b[axis]) < place < max(a[axis], b[axis]):
                point = (place, a[1]) if axis == 0 else (a[0], place)
                vertex = self._vertex(point)
                # the board is left of a side: a line along y enters it across a side to +x, a line along x across one to -y
                self._cross(axis, line, point, vertex, into=forward if axis == 0 else not forward)
                yield abs(place - a[axis]), vertex

    def _cuts_of_arc(self, arc: Arc, *, hole: bool) -> Iterator[tuple[float, int]]:
        for axis, lines in ((0, self.xs), (1, self.ys)):
            centre, r = arc.centre_mm[axis], arc.radius_mm
            for line in range(bisect_left(lines, centre - r), bisect_left(lines, centre + r)):
                # x = c + r cos or y = c + r sin of the angle: two angles for each line
                ratio = min(max((lines[line] - centre) / r, -1.0), 1.0)
                angles = (acos(ratio), 2 * pi - acos(ratio)) if axis == 0 else (asin(ratio), pi - asin(ratio))
                for angle in angles:
                    # relative to the arc's start, half-open, so that no crossing belongs to two arcs
                    turned = arc.start_rad + (angle - arc.start_rad) % (2 * pi)
                    if turned >= arc.end_rad:
                        continue
                    x, y = arc.point(turned)
                    point = (lines[line], y) if axis == 0 else (x, lines[line])
                    vertex = self._vertex(point)
                    # a line leaves the board at the far half of a corner's circle, but enters it at the far half of a hole's
                    upper = (sin(turned) if axis == 0 else cos(turned)) > 0.0
                    self._cross(axis, line, point, vertex, into=upper == hole)
                    yield turned, vertex

    def _chain(self, start: int, end: int, arc: Arc | None, cuts: list[tuple[float, int]], *, wall: int) -> None:
        """Add the edges of the outline from start to end through the cuts, all of one wall."""
        a = 0.0 if arc is None else arc.start_rad
        for b, vertex in [*cuts, (0.0 if arc is None else arc.end_rad, end)]:
            piece = None if arc is None else Arc(centre_mm=arc.centre_mm, radius_mm=arc.radius_mm, start_rad=a, end_rad=b)
            self.edges.append(MapEdge(start=start, end=vertex, arc=piece, wall=wall))
            start, a = vertex, b

    def _spans(self, axis: int, line: int) -> list[tuple[float, int, float, int]]:
        """Pieces of a tile line inside the material: (from, vertex, to, vertex)."""
        cuts = sorted(self._on_line.get((axis, line), []))
        # gaps, from out to into, are holes
        return [(a, u, b, v) for (a, u, into), (b, v, out) in pairwise(cuts) if into == 1 and out == -1]

    def _line_edges(self) -> None:
        crossings: dict[int, list[tuple[float, int]]] = {line: [] for line in range(len(self.ys))}
        for line, x in enumerate(self.xs):
            for a, u, b, v in self._spans(0, line):
                start = u
                # lines along y make the vertices at crossings of two lines, which those along x reuse below
                for across in range(bisect_left(self.ys, a), bisect_left(self.ys, b)):
                    vertex = self._vertex((x, self.ys[across]))
                    crossings[across].append((x, vertex))
                    self.edges.append(MapEdge(start=start, end=vertex, arc=None, wall=None))
                    start = vertex
                self.edges.append(MapEdge(start=start, end=v, arc=None, wall=None))
        for line in range(len(self.ys)):
            for a, u, b, v in self._spans(1, line):
                start = u
                for x, vertex in crossings[line]:
                    if a < x < b:
                        self.edges.append(MapEdge(start=start, end=vertex, arc=None, wall=None))
                        start = vertex
                self.edges.append(MapEdge(start=start, end=v, arc=None, wall=None))

    def clean(self) -> bool:
        """Whether no two vertices nearly coincide, and every line alternately enters and leaves the material."""
        import shapely

        points = shapely.points(np.array(self.vertices))
        # each vertex is found by itself, so with as many pairs as vertices no two are near
        near = shapely.STRtree(points).query(points, predicate="dwithin", distance=_LEAST_EDGE_MM)
        turns = all([side for _, _, side in sorted(cuts)] == [1, -1] * (len(cuts) // 2) for cuts in self._on_line.values())
        return turns and near.shape[1] == len(points) and not self._touches()

    def _touches(self) -> bool:
        """Whether a line is nearly tangent to a hole, or at the end of a rounded corner."""
        (w, h), r = self.board.size_mm, self.board.corner_radius_mm
        for axis, lines, length in ((0, self.xs, w), (1, self.ys, h)):
            bounds = [r, length - r, *(hole[axis] + s * hole[2] / 2 for hole in self.board.holes for s in (-1, 1))]
            if any(abs(place - bound) < _LEAST_EDGE_MM for bound in bounds for place in _near(lines, bound)):
                return True
        return False

    # Faces

    def map(self, parts_xy_mm: FloatArray) -> TopMap:
        """Trace the faces and find the tile of every part."""
        loops = self._loops()
        polygons = [self._polygon(loop) for loop in loops]
        areas = [_area(polygon) for polygon in polygons]
        # traced with the material on the left: counter-clockwise around a tile, clockwise around a hole that no line cuts
        outer, inner = ([loop for loop, area in zip(loops, areas, strict=True) if area * s > 0.0] for s in (1, -1))
        tiles = [[loop] for loop in outer]
        find = _Finder([polygon for polygon, area in zip(polygons, areas, strict=True) if area > 0.0], self.xs, self.ys)
        on_rim = np.array([self.vertices[self.edges[loop[0][0]].start] for loop in inner]).reshape(-1, 2)
        for tile, loop in zip(find(on_rim).tolist(), inner, strict=True):
            tiles[tile].append(loop)
        return TopMap(vertices_mm=self.vertices, edges=self.edges, tiles=tiles, rims=self._rims(), tile_of_part=find(parts_xy_mm))

    def _polygon(self, loop: Sequence[Step]) -> list[Point]:
        points: list[Point] = []
        for index, forward in loop:
            edge = self.edges[index]
            if edge.arc is None:
                points.append(self.vertices[edge.start if forward else edge.end])
                continue
            angles = np.linspace(edge.arc.start_rad, edge.arc.end_rad, _SAMPLES + 1)
            # without its end, the start of the next edge; chords suffice for the sign of an area and the nearest tile
            points += [edge.arc.point(a) for a in (angles[:-1] if forward else angles[:0:-1]).tolist()]
        return points

    def _direction(self, index: int, forward: bool) -> float:
        """Direction in which a half-edge leaves its vertex."""
        edge = self.edges[index]
        if edge.arc is not None:
            return edge.arc.start_rad + pi / 2 if forward else edge.arc.end_rad - pi / 2
        a, b = self.vertices[edge.start], self.vertices[edge.end]
        return atan2(b[1] - a[1], b[0] - a[0]) + (0.0 if forward else pi)

    def _loops(self) -> list[list[Step]]:
        """Loops with the material on the left: at each vertex the leftmost turn is taken."""
        leaving: dict[int, list[tuple[float, Step]]] = {}
        for index, edge in enumerate(self.edges):
            for forward in (True, False):
                # a line has tiles on both sides, a rim on one: on the left of the outline, on the right of a hole's circle
                if edge.wall is None or forward != edge.hole:
                    vertex = edge.start if forward else edge.end
                    leaving.setdefault(vertex, []).append((self._direction(index, forward), (index, forward)))
        unused = {step for rows in leaving.values() for _, step in rows}
        loops = []
        for first in sorted(unused):
            if first not in unused:
                continue
            loop, step = [], first
            while step in unused:
                unused.discard(step)
                loop.append(step)
                edge = self.edges[step[0]]
                vertex = edge.end if step[1] else edge.start
                back = self._arrival(step) + pi
                # by angle clockwise from the reverse direction, which itself comes last because of the 1e-9
                step = min(leaving[vertex], key=lambda row: (back - row[0] - 1e-9) % (2 * pi))[1]
            loops.append(loop)
        return loops

    def _arrival(self, step: Step) -> float:
        """Direction in which a half-edge arrives at its end."""
        edge = self.edges[step[0]]
        if edge.arc is None:
            return self._direction(*step)
        return edge.arc.end_rad + pi / 2 if step[1] else edge.arc.start_rad - pi / 2

    def _rims(self) -> list[list[Step]]:
        outline = [(i, True) for i, edge in enumerate(self.edges) if edge.wall is not None and not edge.hole]
        rims, rim = [outline], []
        for i, edge in enumerate(self.edges):
            if edge.hole:
                rim.append((i, False))
                # edges of a hole are consecutive and counter-clockwise; the loop closes at the start of the first
                if edge.end == self.edges[rim[0][0]].start:
                    rims.append(rim[::-1])
                    rim = []
        return rims


def _near(lines: Sequence[float], place: float) -> Sequence[float]:
    """The lines adjacent to a coordinate."""
    i = bisect_left(lines, place)
    return lines[max(i - 1, 0) : i + 1]


def _area(polygon: Sequence[Point]) -> float:
    return sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(polygon, [*polygon[1:], polygon[0]], strict=True)) / 2


class _Finder:
    """Finds the tile of a point by its cell between lines, and by polygons if a cell has several tiles."""

    def __init__(self, polygons: list[list[Point]], xs: Sequence[float], ys: Sequence[float]) -> None:
        import shapely

        self._xs, self._ys = np.array(xs), np.array(ys)
        of_polygon = np.repeat(np.arange(len(polygons)), [len(polygon) for polygon in polygons])
        self._polygons = shapely.polygons(shapely.linearrings(np.concatenate(polygons), indices=of_polygon))
        cells = self._cells(shapely.get_coordinates(shapely.point_on_surface(self._polygons)))
        self._tiles: dict[int, list[int]] = {}
        for tile, cell in enumerate(cells.tolist()):
            self._tiles.setdefault(cell, []).append(tile)
        # holes and corners may split a cell into several tiles, or leave it without one
        count = np.bincount(cells, minlength=(len(xs) + 1) * (len(ys) + 1))
        self._only = np.full(len(count), -1)
        self._only[cells] = np.where(count[cells] == 1, np.arange(len(cells)), -1)

    def _cells(self, xy_mm: FloatArray) -> IntArray:
        return np.searchsorted(self._xs, xy_mm[:, 0]) * (len(self._ys) + 1) + np.searchsorted(self._ys, xy_mm[:, 1])

    def __call__(self, xy_mm: FloatArray) -> IntArray:
        import shapely

        cells = self._cells(xy_mm)
        found: IntArray = self._only[cells]
        for cell in sorted(set(cells[found < 0].tolist())):
            here = np.flatnonzero(cells == cell)
            tiles = self._tiles[cell]
            points = shapely.points(xy_mm[here])
            # distance 0 is inside; chords cut off a little of arcs, so a point may be in no polygon, and the nearest is taken
            distance = np.array([shapely.distance(self._polygons[t], points) for t in tiles])
            found[here] = np.array(tiles)[distance.argmin(axis=0)]
        return found
