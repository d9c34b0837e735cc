"""An embossed model: its body, volume, rows and tops, each wrong one said, on elements that stand on a slanted face."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.surface.placements import Placed
from tactape_fab.texture.frames import FloatArray
from tactape_fab.verify.models.embossed import _board_positions, _check_body, _check_rows, _check_tops, _check_volume, _tops
from tests.solids import tape_of

TAPE = tape_of(columns=4, rows=3)
LENGTH, WIDTH, HEIGHT = TAPE.part.body_mm
# x axis and normal of a face that is turned and leans, and its y axis
NORMAL = np.array([0.6, 0.0, 0.8])
X_AXIS = np.array([0.8, 0.0, -0.6]) * np.cos(0.3) + np.array([0.0, 1.0, 0.0]) * np.sin(0.3)
AXES = np.stack([X_AXIS, np.cross(NORMAL, X_AXIS), NORMAL])
AT_MM = np.array([10.0, -4.0, 7.0])


def placed() -> Placed:
    """The tape on that face, board coordinates along its axes."""
    n, parts, cells = TAPE.part_count, TAPE.part_xy_mm(), TAPE.cells()
    grid = TAPE.board.texture_origin_mm + cells * TAPE.pitch_mm * (1.0, -1.0)
    return Placed(
        designators=tuple(TAPE.designators()),
        cells=cells,
        points_mm=np.c_[parts, np.zeros(n)] @ AXES + AT_MM,
        grid_mm=np.c_[grid, np.zeros(n)] @ AXES + AT_MM,
        x_axis=np.tile(X_AXIS, (n, 1)),
        normal=np.tile(NORMAL, (n, 1)),
    )


PLACED = placed()
BOX = np.array([(x, y, z) for z in (0.0, HEIGHT) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))], dtype=float)
FACES = [
    (0, 2, 1),
    (0, 3, 2),
    (4, 5, 6),
    (4, 6, 7),
    *(f for i in range(4) for f in ((i, (i + 1) % 4, i + 4), ((i + 1) % 4, (i + 1) % 4 + 4, i + 4))),
]


def mesh_of(off_mm: FloatArray | None = None, gone: tuple[int, ...] = (), height_mm: float = HEIGHT) -> Mesh:
    """Boxes at the tape's places, each moved by so much along the face's axes, turned by 45 degrees as its parts."""
    off = np.zeros((TAPE.part_count, 3)) if off_mm is None else off_mm
    c, s = np.cos(np.pi / 4), np.sin(np.pi / 4)
    box = BOX * (LENGTH / 2, WIDTH / 2, height_mm / HEIGHT)
    box[:, :2] = box[:, :2] @ np.array([[c, s], [-s, c]])
    kept = [k for k in range(TAPE.part_count) if k not in gone]
    vertices = np.concatenate([PLACED.points_mm[k] + (box + off[k]) @ AXES for k in kept])
    faces = np.concatenate([np.array(FACES) + 8 * i for i in range(len(kept))])
    return Mesh(vertices_mm=vertices, faces=faces)


def moved(part: int, *by_mm: float) -> FloatArray:
    off = np.zeros((TAPE.part_count, 3))
    off[part] = by_mm
    return off


@pytest.mark.parametrize(
    ("mesh", "says"),
    [
        (mesh_of(), "12 elements stand where the placements say, within 0.00 µm"),
        (mesh_of(moved(4, 0.0009, 0.0, 0.0)), "within 0.90 µm"),
        (mesh_of(moved(4, 0.002, 0.0, 0.0)), "R5 stands 0.0020 mm from its place"),
        (mesh_of(moved(5, 0.0, -0.003, 0.0)), "R6 stands 0.0030 mm from its place"),
        (mesh_of(moved(6, 0.0, 0.0, -0.002)), "R7 stands 0.0020 mm from its place"),
        (mesh_of(height_mm=HEIGHT + 0.01), "stands 0.0100 mm from its place"),
        (mesh_of(gone=(2, 9)), "2 elements are not there, such as R3, R10"),
        # as low as a foot
        (mesh_of(height_mm=0.5 * HEIGHT), "12 elements are not there, such as R1, R2, R3, R4, R5"),
    ],
)
def test_tops_stand_at_their_places(mesh: Mesh, says: str) -> None:
    check = _check_tops(TAPE, PLACED, *_tops(TAPE, PLACED, mesh))
    assert says in check.message and check.passed == ("within" in says)


def test_positions_on_the_board_are_those_of_the_mesh() -> None:
    found = _board_positions(TAPE, PLACED, *_tops(TAPE, PLACED, mesh_of(moved(3, 0.02, -0.01, 0.0), gone=(7,))))
    parts = TAPE.part_xy_mm()
    parts[3] += (0.02, -0.01)
    assert found == pytest.approx(np.delete(parts, 7, axis=0), abs=1e-9)


def test_a_part_s_surface_beside_an_element_is_not_its_top() -> None:
    """A fold of the part, higher than the elements beside it."""
    mesh, reach_mm = mesh_of(), (LENGTH + WIDTH) / 8**0.5

    def with_fold(beside: float) -> Mesh:
        at = np.array([[beside * reach_mm, 0.0, 1.2 * HEIGHT], [0.0, -beside * reach_mm, 0.7 * HEIGHT]])
        return Mesh(vertices_mm=np.concatenate([mesh.vertices_mm, PLACED.points_mm[4:6] + at @ AXES]), faces=mesh.faces)

    assert _check_tops(TAPE, PLACED, *_tops(TAPE, PLACED, with_fold(1.11))).passed
    assert not _check_tops(TAPE, PLACED, *_tops(TAPE, PLACED, with_fold(1.09))).passed


def test_vertices_beyond_a_cell_are_of_no_element() -> None:
    """A wall beside the texture, nearer than a pitch and a half to its last grid points, and the part's face below them."""
    mesh, reach_mm = mesh_of(), TAPE.pitch_mm / 2**0.5 + HEIGHT
    last = int(PLACED.cells[:, 0].argmax())
    away = PLACED.grid_mm[last] + np.array([[reach_mm + 0.01, 0.0, 0.0], [1.0, 0.0, 0.99 * reach_mm], [1.0, 0.0, 0.0]]) @ AXES
    more = Mesh(vertices_mm=np.concatenate([mesh.vertices_mm, away]), faces=mesh.faces)
    (owner, tops), (own, own_tops) = _tops(TAPE, PLACED, more), _tops(TAPE, PLACED, mesh)
    assert owner.tolist() == own.tolist() and np.array_equal(tops, own_tops)
    assert len(own) == 4 * TAPE.part_count and np.bincount(own).tolist() == [4] * TAPE.part_count


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({}, "12 elements as in the manifest"),
        ({"designators": PLACED.designators[::-1]}, "its designators are not the tape's"),
        ({"cells": PLACED.cells[::-1]}, "its columns and rows are not the tape's"),
        ({"normal": PLACED.normal * (1.0 + 4e-7)}, "12 elements as in the manifest"),
        ({"normal": PLACED.normal * (1.0 + 6e-7)}, "its axes are not unit vectors at right angles"),
        ({"x_axis": PLACED.x_axis * (1.0 - 6e-7)}, "its axes are not unit vectors at right angles"),
        ({"x_axis": PLACED.x_axis @ np.array([[1.0, 0, 0], [0, 1, 0], [2e-6, 0, 1]])}, "its axes are not unit vectors"),
        ({"grid_mm": PLACED.grid_mm + 0.05 * AXES[0]}, "its grid points of R1, R2,"),
    ],
)
def test_rows_of_the_placements_are_the_tape_s(changes: dict[str, object], says: str) -> None:
    check = _check_rows(TAPE, replace(PLACED, **changes), 0.0)  # type: ignore[arg-type]
    assert check.message.startswith(says) and check.passed == ("manifest" in says)


def test_body_and_volume_are_the_manifest_s() -> None:
    mesh = mesh_of()
    volume_mm3 = TAPE.part_count * LENGTH * WIDTH * HEIGHT
    for share, passed in ((1.0, True), (1.0 + 0.9e-6, True), (1.0 - 0.9e-6, True), (1.0 + 1.1e-6, False), (1.0 - 1.1e-6, False)):
        assert _check_volume(mesh, volume_mm3 * share).passed == passed
    assert _check_body(mesh, 12, []).message == "144 triangles, watertight, 12 shells"
    one = Mesh(vertices_mm=mesh.vertices_mm[:8], faces=mesh.faces[:12])
    assert _check_body(one, 1, []).message == "12 triangles, watertight, one body"
    assert (_check_body(one, 2, []).passed, _check_body(one, 2, []).message) == (False, "1 body instead of 2")
    assert _check_body(one, 1, ["bytes behind"]).message == "bytes behind"
    opened = Mesh(vertices_mm=one.vertices_mm, faces=one.faces[:-1])
    assert not _check_body(opened, 1, []).passed
