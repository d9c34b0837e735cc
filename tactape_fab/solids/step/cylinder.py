"""The base of a solid on a cylinder, as exact STEP faces: tiles of the outer cylinder, inner cylinder, and walls."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, floor, pi

import numpy as np

from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mark import Mark
from tactape_fab.solids.step.mark_faces import MarkedBase, entities_of_mark
from tactape_fab.solids.step.part21 import Writer, real, wrapped_names
from tactape_fab.solids.step.tiles import CELLS_PER_TILE
from tactape_fab.solids.wrap import Wrap
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape

MOST_STRIP_RAD = 2 * pi / 3
_LEAST_GAP_MM = 0.01
_LEAST_CUT_RAD = 0.02


def _lines_mm(tape: Tape, wrap: Wrap, axis: int, step: int) -> list[float]:
    """Coordinates half way between elements along a (axis 0) or b (axis 1), every `step`-th one, ascending."""
    x0, y0 = tape.board.texture_origin_mm
    corners = np.array([(x0, y0), (x0 + (tape.columns - 1) * tape.pitch_mm, y0 - (tape.rows - 1) * tape.pitch_mm)])
    low, high = np.sort((corners @ wrap.from_board.T)[:, axis])
    count = round((high - low) / tape.pitch_mm) + 1
    return [float(low + (k - 0.5) * tape.pitch_mm) for k in range(step, count, step)]


def strip_angles(tape: Tape, form: SolidForm, wrap: Wrap) -> list[float]:
    """Angles of the borders of the outer cylinder's strips; for a whole shell the last is the first plus a turn."""
    start, end = wrap.ends_rad
    cells = max(1, min(CELLS_PER_TILE, floor(MOST_STRIP_RAD * wrap.radius_mm / tape.pitch_mm)))
    lines = [float(wrap.angle_rad(a)) for a in _lines_mm(tape, wrap, 0, cells)]
    if wrap.cylinder.shell == "segment":
        return [start, *(lines if form.top == "tiles" else []), end]
    gap = 2 * pi - (end - start)
    # the tape closes on itself, and a strip in the gap would be a sliver: the first cut is between elements, and the last
    # strip extends across the joint
    if gap * wrap.radius_mm < _LEAST_GAP_MM:
        return [*lines, lines[0] + 2 * pi]
    # the part of a whole shell without the tape, in strips of at most a third of a turn
    pieces = ceil(gap / MOST_STRIP_RAD)
    bare = [end + gap * k / pieces for k in range(pieces + 1)]
    inside = lines if form.top == "tiles" else []
    return [start, *inside, *bare]


class CylinderBase(MarkedBase):
    """The base of a solid on a cylinder: edges are written by the constructor, faces once the elements have their names."""

    def __init__(self, w: Writer, tape: Tape, form: SolidForm, wrap: Wrap) -> None:
        super().__init__(w, tape, form, wrap.radius_mm)
        self._wrap = wrap
        self._closed = wrap.cylinder.shell == "whole"
        self._angles = strip_angles(tape, form, wrap)
        lines = _lines_mm(tape, wrap, 1, CELLS_PER_TILE) if form.top == "tiles" else []
        self._b = [wrap.b_mm[0], *lines, wrap.b_mm[1]]
        self._strips, self._tiles_along = len(self._angles) - 1, len(self._b) - 1
        self._up = w.direction(wrap.turn[:, 1])
        self._top = self._grid(wrap.radius_mm, self._b, self._angles)
        self._back_angles, self._marked = (self._angles, 0) if self._mark is None else self._round_mark(self._mark)
        self._back = self._grid(self._back_mm, [self._b[0], self._b[-1]], self._back_angles)
        ab = tape.part_xy_mm() @ wrap.from_board.T
        angle = wrap.angle_rad(ab[:, 0])
        # if the tape closes on itself its first elements are in the strip across the joint
        angle = np.where(angle < self._angles[0], angle + 2 * pi, angle)
        strip = np.searchsorted(self._angles, angle) - 1
        self.tile_of_part = (strip * self._tiles_along + np.searchsorted(self._b, ab[:, 1]) - 1).astype(np.int64)
        self.entities_to_come = 12 * self._strips * (self._tiles_along + 6) + 300 + entities_of_mark(self._mark)

    def _round_mark(self, mark: Mark) -> tuple[list[float], int]:
        """Angles of the borders of the inner cylinder's strips, and the index of the strip with the whole mark."""
        start, end = self._angles[0], self._angles[-1]
        # a third of a turn about the mark's middle; the mark takes at most a quarter
        first = float(self._wrap.angle_rad((np.array(mark.middle_mm) @ self._wrap.from_board.T)[0])) - MOST_STRIP_RAD / 2
        if self._closed:
            return [first + k * MOST_STRIP_RAD for k in range(4)], 0
        # a cut next to an end would leave a sliver, so the mark's strip extends to the end
        cuts = [angle for angle in (first, first + MOST_STRIP_RAD) if start + _LEAST_CUT_RAD < angle < end - _LEAST_CUT_RAD]
        return [start, *cuts, end], int(first in cuts)

    def _grid(
        self, radius_mm: float, b_mm: Sequence[float], angles: Sequence[float]
    ) -> tuple[list[list[str]], list[list[str]], list[list[str]]]:
        """Vertices [strip][along], arcs [strip][along] and lines [strip][along] of a cylinder cut at angles and b."""
        w, wrap = self._w, self._wrap
        own = angles[:-1] if self._closed else angles
        # on a closed shell the last cut is the first one, and shares its vertices and lines
        points = wrap.point(np.array(own)[:, None], np.array(b_mm), radius_mm)
        vertices = [[w.vertex(p) for p in row] for row in points]
        lines = [
            [w.line_edge(vertices[i][j], vertices[i][j + 1], points[i, j], points[i, j + 1]) for j in range(len(b_mm) - 1)]
            for i in range(len(own))
        ]
        centres = [w.point(p) for p in wrap.point(0.0, np.array(b_mm), 0.0)]
        arcs = []
        for i in range(len(angles) - 1):
            # the circle's angle 0 is at the strip's start, and it runs counter-clockwise about the axis, as angles increase
            ref = w.direction(wrap.frames(angles[i])[2])
            ends = vertices[i], vertices[(i + 1) % len(own)]
            circles = [w.add(f"CIRCLE('',{w.axes(centre, self._up, ref)},{real(radius_mm)})") for centre in centres]
            arcs.append([w.edge(a, b, circle) for a, b, circle in zip(*ends, circles, strict=True)])
        if self._closed:
            vertices, lines = [*vertices, vertices[0]], [*lines, lines[0]]
        return vertices, arcs, lines

    def _surface(self, ends_rad: Sequence[float], radius_mm: float) -> str:
        """The cylindrical surface, with its seam opposite to a strip."""
        # u = 0, the seam, is on the opposite side, so that no face crosses it
        ref = -self._wrap.frames((ends_rad[0] + ends_rad[1]) / 2)[2]
        axes = self._w.placement(self._wrap.point(0.0, 0.0, 0.0), self._wrap.turn[:, 1], ref)
        return self._w.add(f"CYLINDRICAL_SURFACE('',{axes},{real(radius_mm)})")

    def faces(self, bounds_of_tile: Sequence[str]) -> list[str]:
        """All faces of the base, each after an adjacent one: inner cylinder, walls, tiles strip by strip."""
        bounds, sunk = self._mark_faces(self._wrap.from_board, same_sense=self._flip)
        back = [self._back_face(strip, bounds if strip == self._marked else []) for strip in range(len(self._back_angles) - 1)]
        walls = self._end_walls() if self._closed else [*self._end_walls(), *self._cut_walls()]
        tiles = []
        for strip in range(self._strips):
            surface = self._surface(self._angles[strip : strip + 2], self._wrap.radius_mm)
            tiles += [self._tile(strip, j, surface, bounds_of_tile) for j in range(self._tiles_along)]
        return [*back, *sunk, *walls, *tiles]

    def _tile(self, i: int, j: int, surface: str, bounds_of_tile: Sequence[str]) -> str:
        _, arcs, lines = self._top
        loop = self._loop([(arcs[i][j], True), (lines[i + 1][j], True), (arcs[i][j + 1], False), (lines[i][j], False)])
        tile = i * self._tiles_along + j
        bounds = bounds_of_tile[tile] if tile < len(bounds_of_tile) else ""
        return self._w.face([loop], surface, bounds=[wrapped_names([bounds])] if bounds else [], same_sense=not self._flip)

    def _back_face(self, i: int, bounds: list[str]) -> str:
        _, arcs, lines = self._back
        loop = self._loop([(lines[i][0], True), (arcs[i][1], True), (lines[i + 1][0], False), (arcs[i][0], False)])
        surface = self._surface(self._back_angles[i : i + 2], self._back_mm)
        # the surface's normal points away from the axis: into the material on a texture's inside, out of it on a mould's outside
        return self._w.face([loop, *bounds], surface, same_sense=self._flip)

    def _point(self, ab: Sequence[float] | FloatArray, level: float) -> FloatArray:
        return self._wrap.point(self._wrap.angle_rad(ab[0]), ab[1], level)

    def _mark_edge(self, start: str, end: str, p: FloatArray, q: FloatArray, level: float) -> str:
        w, wrap = self._w, self._wrap
        if abs(q[0] - p[0]) < abs(q[1] - p[1]):
            return w.line_edge(start, end, self._point(p, level), self._point(q, level))
        # a circle runs counter-clockwise about its axis, which is reversed for the other direction
        axis = np.sign(q[0] - p[0]) * wrap.turn[:, 1]
        axes = w.placement(wrap.point(0.0, p[1], 0.0), axis, wrap.frames(wrap.angle_rad(p[0]))[2])
        return w.edge(start, end, w.add(f"CIRCLE('',{axes},{real(level)})"))

    def _mark_wall(self, p: FloatArray, q: FloatArray) -> str:
        frame, (da, db) = self._wrap.frames(self._wrap.angle_rad(p[0])), np.sign(np.round(q - p, 6))
        # left of the direction (da, db) in the plane of (tangent, axis): (-db, da)
        return self._plane(self._point(p, self._back_mm), da * self._wrap.turn[:, 1] - db * frame[0], frame[2])

    def _level(self, level: float) -> str:
        return self._surface(self._back_angles[self._marked : self._marked + 2], level)

    def _plane(self, point: FloatArray, normal: FloatArray, ref: FloatArray) -> str:
        return self._w.add(f"PLANE('',{self._w.placement(point, normal, ref)})")

    def _radial(self, i: int, end: int) -> str:
        """Edge from the outer to the inner cylinder at the end of a cut."""
        angle, b = self._angles[i], self._b[end]
        points = self._wrap.point(angle, b, np.array([self._wrap.radius_mm, self._back_mm]))
        return self._w.line_edge(self._top[0][i][end], self._back[0][0 if i == 0 else -1][end], points[0], points[1])

    def _end_walls(self) -> list[str]:
        """The two walls perpendicular to the axis; for a whole shell they are rings."""
        top, back = self._top[1], self._back[1]
        # the ring at the low end faces -b: outer arcs against the angle, inner ones along it; at the high end reversed
        first = [(arcs[0], False) for arcs in reversed(top)], [(arcs[0], True) for arcs in back]
        last = [(arcs[-1], True) for arcs in top], [(arcs[-1], False) for arcs in reversed(back)]
        walls = []
        if not self._closed:
            self._corners = [[self._radial(i, end) for i in (0, self._strips)] for end in (0, -1)]
        for end, (outer, inner), sign in ((0, first, -1.0), (-1, last, 1.0)):
            if self._closed:
                loops = [self._loop(outer), self._loop(inner)]
                # the outer bound comes first; for a mould it is the back's, the larger circle
                loops = loops[::-1] if self._flip else loops
            else:
                at_start, at_end = self._corners[end]
                joints = (at_start, at_end) if end == 0 else (at_end, at_start)
                loops = [self._loop([*outer, (joints[0], True), *inner, (joints[1], False)])]
            plane = self._plane(self._wrap.point(0.0, self._b[end], 0.0), sign * self._wrap.turn[:, 1], self._wrap.frames(0.0)[2])
            walls.append(self._w.face(loops, plane))
        return walls

    def _cut_walls(self) -> list[str]:
        """The two walls parallel to the axis at the ends of a segment."""
        lines, back = self._top[2], self._back[2]
        walls = []
        for i, sign in ((0, -1.0), (self._strips, 1.0)):
            low, high = self._corners[0][0 if i == 0 else 1], self._corners[1][0 if i == 0 else 1]
            along = [(edge, True) for edge in lines[i]]
            steps = [*along, (high, True), (back[0 if i == 0 else -1][0], False), (low, False)]
            if sign > 0:
                steps = [(edge, not forward) for edge, forward in reversed(steps)]
            angle = self._angles[i]
            frame = self._wrap.frames(angle)
            plane = self._plane(self._wrap.point(angle, self._b[0], self._wrap.radius_mm), sign * frame[0], frame[2])
            walls.append(self._w.face([self._loop(steps)], plane))
        return walls
