"""The top face as a planar map: every piece of it in one tile, also where holes and lines meet in awkward ways."""

from __future__ import annotations

from collections import Counter
from math import pi
from typing import Any

import numpy as np
import pytest
import shapely

from tactape_fab.base.errors import RenderError
from tactape_fab.solids.step.tiles import Step, TopMap, top_map
from tactape_fab.texture.tape import Tape
from tests.solids import BLOCK, DOME, tape_of

PLAIN = tape_of(BLOCK, 13, 13)
X0, Y0 = PLAIN.board.texture_origin_mm
LINE_X, LINE_Y = X0 + 5.5 * 1.5, Y0 - 5.5 * 1.5
"""A line between two columns of tiles, and one between two rows."""


def polygon(top: TopMap, loop: list[Step], samples: int = 400) -> Any:
    points: list[tuple[float, float]] = []
    for index, forward in loop:
        edge = top.edges[index]
        ends = [top.vertices_mm[v] for v in (edge.start, edge.end)]
        if edge.arc is None:
            path = ends
        else:
            path = [edge.arc.point(a) for a in np.linspace(edge.arc.start_rad, edge.arc.end_rad, samples).tolist()]
            assert path[0] == pytest.approx(ends[0], abs=1e-9)
            assert path[-1] == pytest.approx(ends[1], abs=1e-9)
        points += (path if forward else path[::-1])[:-1]
    return shapely.Polygon(points)


def check(tape: Tape, *, tiled: bool = True) -> TopMap:
    """A map of which every tile is a simple polygon, which covers the board once, and holds every element whole."""
    top = top_map(tape, tiled=tiled)
    uses = Counter(step for tile in top.tiles for loop in tile for step in loop)
    for i, edge in enumerate(top.edges):
        if edge.wall is None:
            assert (uses[i, True], uses[i, False]) == (1, 1)
        else:
            assert (uses[i, True], uses[i, False]) == ((0, 1) if edge.hole else (1, 0))
    outer = [polygon(top, tile[0]) for tile in top.tiles]
    inner = [[polygon(top, loop).exterior for loop in tile[1:]] for tile in top.tiles]
    faces = [shapely.Polygon(rim.exterior, holes) for rim, holes in zip(outer, inner, strict=True)]
    assert all(face.is_valid for face in faces)
    assert all(face.exterior.is_ccw for face in outer)
    assert all(not hole.is_ccw for holes in inner for hole in holes)
    (w, h), r = tape.board.size_mm, tape.board.corner_radius_mm
    area = w * h - (4 - pi) * r**2 - sum(pi * d**2 / 4 for _, _, d in tape.board.holes)
    assert sum(face.area for face in faces) == pytest.approx(area, abs=0.002 * (1 + r))
    assert len(top.rims) == 1 + len(tape.board.holes)
    foot = shapely.Point(0, 0).buffer(0.3) if tape.part.shape == "dome" else shapely.Polygon(block_foot(tape))
    for xy, tile in zip(tape.part_xy_mm().tolist(), top.tile_of_part.tolist(), strict=True):
        assert faces[tile].contains(shapely.affinity.translate(foot, *xy))
    vertices = np.array(top.vertices_mm)
    order = np.lexsort(vertices.T)
    assert np.abs(np.diff(vertices[order], axis=0)).max(axis=1).min() > 1e-4
    return top


def block_foot(tape: Tape) -> Any:
    length, width, _ = tape.part.body_mm
    box = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
    return shapely.affinity.rotate(box, tape.part.rotation_deg, origin=(0, 0)).exterior.coords


@pytest.mark.parametrize(("columns", "rows", "tiles"), [(4, 4, 1), (6, 6, 1), (7, 6, 2), (7, 7, 4), (12, 12, 4), (13, 12, 6)])
def test_tiles_are_six_cells_wide(columns: int, rows: int, tiles: int) -> None:
    tape = tape_of(BLOCK, columns, rows)
    assert len(check(tape).tiles) == tiles
    assert len(check(tape, tiled=False).tiles) == 1


@pytest.mark.parametrize("radius_mm", [0.0, 0.5, 1.0, 3.0, 5.0])
@pytest.mark.parametrize("tiled", [True, False])
def test_corners_may_be_round(radius_mm: float, tiled: bool) -> None:
    check(tape_of(DOME, 13, 8, radius_mm=radius_mm), tiled=tiled)


@pytest.mark.parametrize(("columns", "rows"), [(8, 8), (13, 8), (8, 13)])
def test_ends_may_be_half_circles(columns: int, rows: int) -> None:
    tape = tape_of(BLOCK, columns, rows)
    top = check(tape_of(BLOCK, columns, rows, radius_mm=min(tape.board.size_mm) / 2))
    assert sum(edge.arc is None for edge in top.edges if edge.wall is not None) <= 2 * (1 + columns // 6 + rows // 6)


HOLES = {
    "inside a tile": [(X0 + 3.0, Y0 - 3.0, 1.2)],
    "on a line": [(LINE_X, Y0 - 3.0, 1.2)],
    "on a crossing": [(LINE_X, LINE_Y, 1.2)],
    "beside a crossing": [(LINE_X + 0.1, LINE_Y - 0.1, 1.2)],
    "over a whole tile": [(X0 + 8.5 * 1.5, Y0 - 8.5 * 1.5, 13.1)],
    "two that leave a neck": [(LINE_X, Y0 - 3.0, 2.0), (LINE_X, Y0 - 5.1, 2.0)],
    "3-4-5: a line through where the other crosses": [(LINE_X + 0.3, LINE_Y + 0.4, 1.0)],
    "5-12-13": [(LINE_X - 0.5, LINE_Y + 1.2, 2.6)],
    "five in a row": [(X0 + 1.5 * k, LINE_Y, 0.8) for k in (2, 4, 6, 8, 10)],
    "many": [(X0 + 2.25 * i, Y0 - 2.25 * j, 0.9) for i in range(8) for j in range(8)],
}
TANGENT = {
    f"tangent at {side} of {d} mm": [(LINE_X + dx * d / 2, LINE_Y + dy * d / 2 + 0.4 * dx, d)]
    for d in (0.8, 1.0, 1.3)
    for side, dx, dy in (("left", 1, 0), ("right", -1, 0), ("below", 0, 1), ("above", 0, -1))
}
NEARLY = {
    f"line {off:g} mm inside a hole": [(LINE_X + 0.5 - off, Y0 - 3.1, 1.0)]
    for off in (1e-9, 1e-6, 1e-5, 1e-4, 0.001, 0.0025, 0.01)
}


@pytest.mark.parametrize("holes", [*HOLES.values(), *TANGENT.values(), *NEARLY.values()], ids=[*HOLES, *TANGENT, *NEARLY])
@pytest.mark.parametrize("tiled", [True, False])
def test_holes_may_lie_anywhere(holes: list[tuple[float, float, float]], tiled: bool) -> None:
    check(tape_of(BLOCK, 13, 13, holes_mm=holes), tiled=tiled)


def test_a_line_moves_aside_for_every_tangent_hole() -> None:
    """To the last bit: neither a line that only touches nor one that misses by rounding."""
    for ulps in range(-4, 5):
        x = LINE_X + 0.5
        for _ in range(abs(ulps)):
            x = float(np.nextafter(x, x + np.sign(ulps)))
        check(tape_of(BLOCK, 13, 13, holes_mm=[(x, Y0 - 3.1, 1.0)]))


def test_a_board_that_cannot_be_tiled_names_the_remedy() -> None:
    """Elements as large as their cells leave lines no room beside a hole that one of them touches."""
    tape = tape_of(DOME, 13, 13, displacement_mm=0.4479, holes_mm=[])
    x0, y0 = tape.board.texture_origin_mm
    at = x0 + 5.5 * 1.5
    with pytest.raises(RenderError, match="--top single"):
        top_map(tape_of(DOME, 13, 13, displacement_mm=0.4479, holes_mm=[(at + 0.5, y0 - 3.1, 1.0)]), tiled=True)
    assert top_map(tape_of(DOME, 13, 13, displacement_mm=0.4479, holes_mm=[(at + 0.5, y0 - 3.1, 1.0)]), tiled=False)
