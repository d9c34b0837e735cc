"""The mark in the back of printed textures: read as it was meant, in every form of a solid, and missed where it is wrong."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from tactape_fab.solids.forms import Cylinder, SolidForm
from tactape_fab.solids.mark import LEAST_CELL_MM, mark_of, raster, read_raster
from tactape_fab.solids.mesh.sheet import texture_mesh
from tactape_fab.solids.mesh.stl import mesh_problems, read_stl
from tactape_fab.solids.mesh.triangles import Mesh, stl_bytes
from tactape_fab.solids.volume import solid_volume_mm3
from tactape_fab.texture.part import TapePart
from tactape_fab.verify.models.back_mark import check_mark
from tactape_fab.verify.models.meshes import mesh_volume_tolerance_mm3
from tests.solids import BLOCK, DOME, FORMS, tape_of

MARKED = {name: replace(form, mark=True) for name, form in FORMS.items()}
FLAT = SolidForm(mark=True)


def test_every_sector_is_read_as_itself() -> None:
    assert [read_raster(raster(sector)) for sector in range(4000)] == list(range(4000))


def test_no_two_cells_meet_in_a_corner_alone() -> None:
    cells = np.pad(raster(1234567890), 1).astype(int)
    a, b, c, d = cells[:-1, :-1], cells[:-1, 1:], cells[1:, :-1], cells[1:, 1:]
    assert not ((a == d) & (b == c) & (a != b)).any()


@pytest.mark.parametrize("name", MARKED)
@pytest.mark.parametrize("part", [DOME, BLOCK], ids=["dome", "block"])
def test_a_marked_solid_is_one_body_and_says_its_sector(name: str, part: TapePart) -> None:
    tape, form = replace(tape_of(part, 13, 11), sector=86), MARKED[name]
    mesh = read_stl(stl_bytes(texture_mesh(tape, form), "x"))
    assert mesh_problems(mesh) == []
    assert mesh.volume_mm3 == pytest.approx(solid_volume_mm3(tape, form), abs=mesh_volume_tolerance_mm3(tape, form))
    assert solid_volume_mm3(tape, form) < solid_volume_mm3(tape, FORMS[name])
    check = check_mark(tape, form, mesh)
    assert check.passed, check.message
    assert "sector 86" in check.message


def test_a_wrong_mark_is_found() -> None:
    tape = replace(tape_of(DOME, 13, 11), sector=7)
    mesh = texture_mesh(tape, FLAT)
    turned = Mesh(vertices_mm=(mesh.vertices_mm - (*tape.board.size_mm, 0.0)) * (-1.0, -1.0, 1.0), faces=mesh.faces)
    seen_through = Mesh(vertices_mm=(mesh.vertices_mm - (tape.board.size_mm[0], 0.0, 0.0)) * (-1.0, 1.0, 1.0), faces=mesh.faces)
    bare = texture_mesh(tape, SolidForm())
    other = texture_mesh(replace(tape, sector=1), FLAT)
    wrong = [check_mark(tape, FLAT, of) for of in (turned, seen_through, bare, other)]
    assert [check.passed for check in wrong] == [False] * 4
    assert "shows 1, not sector 7" in wrong[-1].message


def test_a_mark_stays_clear_of_holes_and_edges() -> None:
    tape = tape_of(DOME, 13, 11)
    x, y = middle = (tape.board.size_mm[0] / 2, tape.board.size_mm[1] / 2)
    tape = replace(tape, board=replace(tape.board, holes=((x, y, 3.0),)))
    mark = mark_of(tape, FLAT)
    assert mark is not None
    corners = np.concatenate([loop for outer, islands in mark.polygons() for loop in (outer, *islands)])
    assert np.hypot(*(corners - middle).T).min() > 1.5
    assert (corners > 1.0).all()
    assert (corners < np.array(tape.board.size_mm) - 1.0).all()
    assert mark.cell_mm >= LEAST_CELL_MM


@pytest.mark.parametrize("around", ["x", "y"])
@pytest.mark.parametrize("columns", range(5, 13))
def test_a_mark_round_a_cylinder_stays_clear_of_edges(columns: int, around: Literal["x", "y"]) -> None:
    tape = tape_of(DOME, columns, 5)
    mark = mark_of(tape, SolidForm(mark=True, cylinder=Cylinder(radius_mm=8.0, around=around)))
    assert mark is not None
    corners = np.concatenate([loop for outer, islands in mark.polygons() for loop in (outer, *islands)])
    assert (corners > 1.0 - 1e-9).all() and (corners < np.array(tape.board.size_mm) - 1.0 + 1e-9).all()


def test_a_back_without_a_place_has_no_mark() -> None:
    tape = replace(tape_of(DOME, 4, 4), sector=3968)
    assert mark_of(tape, FLAT) is None
    assert mark_of(tape, SolidForm()) is None
    assert check_mark(tape, FLAT, texture_mesh(tape, FLAT)).message == "the back has no place for a mark"
