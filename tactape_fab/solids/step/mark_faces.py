"""The mark sunk into the back, as exact STEP faces: walls, floors and islands, and the loops that they leave in the back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tactape_fab.solids.mark import Mark
from tactape_fab.solids.step.part21 import Writer
from tactape_fab.texture.frames import FloatArray

_ENTITIES_A_CORNER = 60
"""More than are written for a corner of a loop."""
Steps = Sequence[tuple[str, bool]]


def entities_of_mark(mark: Mark | None) -> int:
    """Entities that a mark takes, or a few more."""
    loops = [] if mark is None else [loop for outer, islands in mark.polygons() for loop in (outer, *islands)]
    return _ENTITIES_A_CORNER * sum(map(len, loops)) + 100 * bool(loops)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Back:
    """The geometry of a back; (a, b) are its coordinates, a level is a height or a radius.

    from_board (2, 2): From board (x, y) to (a, b).
    levels_mm: Of the back and of the mark's floor.
    point: (a, b), level -> point in the file's frame.
    edge: Names of two vertices, their (a, b), level -> edge between them, straight or round the cylinder.
    wall: (a, b) of two corners -> surface between back and floor, its normal to the left of the way from one to the other.
    surface: Level -> surface of back or floor.
    loop: Edges, with the material on the left seen from outside a texture -> loop.
    same_sense: Whether the material is behind the surfaces of back and floor.
    """

    from_board: FloatArray
    levels_mm: tuple[float, float]
    point: Callable[[FloatArray, float], FloatArray]
    edge: Callable[[str, str, FloatArray, FloatArray, float], str]
    wall: Callable[[FloatArray, FloatArray], str]
    surface: Callable[[float], str]
    loop: Callable[[Steps], str]
    same_sense: bool


def mark_faces(w: Writer, mark: Mark | None, back: Callable[[], Back]) -> tuple[list[str], list[str]]:
    """Loops of a mark in the back, and its faces: walls, floor and islands of each figure."""
    if mark is None:
        return [], []
    of = back()
    level, floor = (of.surface(level) for level in of.levels_mm)
    bounds, faces = [], []
    for outer, islands in mark.polygons():
        rims = [_walls(w, of, loop @ of.from_board.T) for loop in (outer, *islands)]
        # islands lie inside the pocket: only the outer loop of a figure is a hole of the back
        bounds.append(of.loop(rims[0][0]))
        faces += [wall for _, _, walls in rims for wall in walls]
        # the floor lies on the pocket's side of the loop, the back on the other: the loop backwards
        bottom = [of.loop([(edge, False) for edge, _ in reversed(low)]) for _, low, _ in rims]
        faces.append(w.face(bottom, floor, same_sense=of.same_sense))
        # an island's top is a piece of the back: the same surface and sense
        faces += [w.face([of.loop(top)], level, same_sense=of.same_sense) for top, _, _ in rims[1:]]
    return bounds, faces


def _walls(w: Writer, of: Back, corners: FloatArray) -> tuple[Steps, Steps, list[str]]:
    """Edges of a loop in the back and in the floor, and the walls between them; the pocket is on the loop's left."""
    after = np.roll(corners, -1, axis=0)
    ends = [[w.vertex(of.point(corner, level)) for corner in corners] for level in of.levels_mm]
    edges = [
        [of.edge(a, b, p, q, level) for a, b, p, q in zip(row, [*row[1:], row[0]], corners, after, strict=True)]
        for row, level in zip(ends, of.levels_mm, strict=True)
    ]
    rises = [
        w.line_edge(low, high, *(of.point(corner, level) for level in of.levels_mm))
        for low, high, corner in zip(*ends, corners, strict=True)
    ]
    walls = []
    for k, (p, q) in enumerate(zip(corners, after, strict=True)):
        # along the floor as the loop goes, along the back against it; rises run from back to floor
        steps = [(edges[0][k], False), (rises[k], True), (edges[1][k], True), (rises[(k + 1) % len(rises)], False)]
        walls.append(w.face([of.loop(steps)], of.wall(p, q)))
    return [(edge, True) for edge in edges[0]], [(edge, True) for edge in edges[1]], walls
