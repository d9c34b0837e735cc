"""The mark engraved in the back, as exact STEP faces: walls, floors and islands, and their loops in the back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mark import Mark, back_mm, floor_mm, mark_of
from tactape_fab.solids.step.part21 import Step, Writer, reversed_steps
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape

_ENTITIES_A_CORNER = 60
"""Upper bound of the entities per corner of a loop."""
Steps = Sequence[Step]


def entities_of_mark(mark: Mark | None) -> int:
    """Upper bound of the number of entities of a mark."""
    loops = [] if mark is None else [loop for outer, islands in mark.polygons() for loop in (outer, *islands)]
    return _ENTITIES_A_CORNER * sum(map(len, loops)) + 100 * bool(loops)


class MarkedBase(ABC):
    """Common part of flat and wrapped bases: the sense of loops, and the mark in the back.

    (a, b) are coordinates on the back; a level is a height or a radius; `above_mm` is the level of the surface with the elements.
    """

    def __init__(self, w: Writer, tape: Tape, form: SolidForm, above_mm: float) -> None:
        self._w, self._flip, self._mark = w, form.negative, mark_of(tape, form)
        self._back_mm, self._floor_mm = above_mm + back_mm(tape, form), above_mm + floor_mm(tape, form, self._mark)

    @abstractmethod
    def _point(self, ab: Sequence[float] | FloatArray, level: float) -> FloatArray:
        """A point in the file's frame."""

    @abstractmethod
    def _mark_edge(self, start: str, end: str, p: FloatArray, q: FloatArray, level: float) -> str:
        """An edge between two vertices at p and q: a line, or an arc around the cylinder."""

    @abstractmethod
    def _mark_wall(self, p: FloatArray, q: FloatArray) -> str:
        """The surface between back and floor, with its normal to the left of the direction from p to q."""

    @abstractmethod
    def _level(self, level: float) -> str:
        """The surface of back or floor."""

    def _loop(self, steps: Steps) -> str:
        """A loop, given with the material on the left as seen from outside a texture; reversed for a mould."""
        return self._w.loop(reversed_steps(steps) if self._flip else steps)

    def _mark_faces(self, from_board: FloatArray, *, same_sense: bool) -> tuple[list[str], list[str]]:
        """Loops of the mark in the back, and its faces: walls, floor and islands of each figure.

        from_board (2, 2): From board (x, y) to (a, b).
        same_sense: Whether the material is behind the surfaces of back and floor.
        """
        if self._mark is None:
            return [], []
        level, floor = self._level(self._back_mm), self._level(self._floor_mm)
        bounds, faces = [], []
        for outer, islands in self._mark.polygons():
            rims = [self._mark_walls(loop @ from_board.T) for loop in (outer, *islands)]
            # islands are inside the pocket, so only the outer loop of a figure is a hole of the back
            bounds.append(self._loop(rims[0][0]))
            faces += [wall for _, _, walls in rims for wall in walls]
            # the floor is on the pocket's side of the loop, the back on the other, so the loop is reversed
            bottom = [self._loop([(edge, False) for edge, _ in reversed(low)]) for _, low, _ in rims]
            faces.append(self._w.face(bottom, floor, same_sense=same_sense))
            # an island's top is part of the back, with the same surface and sense
            faces += [self._w.face([self._loop(top)], level, same_sense=same_sense) for top, _, _ in rims[1:]]
        return bounds, faces

    def _mark_walls(self, corners: FloatArray) -> tuple[Steps, Steps, list[str]]:
        """Edges of a loop in the back and in the floor, and the walls between; the pocket is on the loop's left."""
        after, levels = np.roll(corners, -1, axis=0), (self._back_mm, self._floor_mm)
        ends = [[self._w.vertex(self._point(corner, level)) for corner in corners] for level in levels]
        edges = [
            [self._mark_edge(a, b, p, q, level) for a, b, p, q in zip(row, [*row[1:], row[0]], corners, after, strict=True)]
            for row, level in zip(ends, levels, strict=True)
        ]
        rises = [
            self._w.line_edge(low, high, *(self._point(corner, level) for level in levels))
            for low, high, corner in zip(*ends, corners, strict=True)
        ]
        walls = []
        for k, (p, q) in enumerate(zip(corners, after, strict=True)):
            # along the loop on the floor, against it on the back; rises run from back to floor
            steps = [(edges[0][k], False), (rises[k], True), (edges[1][k], True), (rises[(k + 1) % len(rises)], False)]
            walls.append(self._w.face([self._loop(steps)], self._mark_wall(p, q)))
        return [(edge, True) for edge in edges[0]], [(edge, True) for edge in edges[1]], walls
