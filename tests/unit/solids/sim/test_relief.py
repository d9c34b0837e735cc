"""Heightfield, normal map and body of a tape, against its parts and against sums over small cubes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tactape_fab.solids.elements import element_volume_mm3
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.sim.body import CHIP_KG_M3, FILM_KG_M3, solid_mass, tape_body
from tactape_fab.solids.sim.relief import LEVELS, png_bytes, relief_of
from tests.solids import FORMS, PARTS, tape_of


@pytest.mark.parametrize("shape", sorted(PARTS))
def test_the_heightfield_holds_every_element_and_nothing_else(shape: str) -> None:
    tape = tape_of(PARTS[shape])
    relief = relief_of(tape)
    xy = tape.part_xy_mm()
    u, v = (np.array([xy[:, 0], tape.board.size_mm[1] - xy[:, 1]]) * relief.px_per_mm).astype(int)
    assert relief.height[v, u] == pytest.approx(tape.part.body_mm[2], abs=0.002)
    volume = float(relief.height.sum()) / relief.px_per_mm**2
    assert volume == pytest.approx(tape.part_count * element_volume_mm3(tape.part), rel=0.03)


def test_the_png_has_16_bits_and_says_how_large_a_pixel_is() -> None:
    tape = tape_of(PARTS["dome"])
    relief = relief_of(tape)
    data = png_bytes(relief.levels(), round(1000 * relief.px_per_mm))
    read = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))
    assert read.dtype == np.uint16 and read.max() <= LEVELS
    assert read * (relief.top_mm / LEVELS) == pytest.approx(relief.height, abs=relief.top_mm / LEVELS)
    at = data.index(b"pHYs") + 4
    assert (int.from_bytes(data[at : at + 4], "big"), data[at + 8]) == (40_000, 1)


def test_normals_lean_away_from_an_element() -> None:
    tape = tape_of(PARTS["dome"])
    relief = relief_of(tape)
    normals = relief.normals().astype(float) / 127.5 - 1
    assert np.linalg.norm(normals, axis=2) == pytest.approx(1.0, abs=0.02)
    x, y = tape.part_xy_mm()[0]
    for way in np.array([(1, 0), (0, 1), (-1, 0), (0.7, -0.7)]):
        px = (np.array([x, tape.board.size_mm[1] - y]) + 0.15 * way * (1, -1)) * relief.px_per_mm
        assert normals[int(px[1]), int(px[0]), :2] @ way > 0.2
    data = png_bytes(relief.normals())
    read = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))
    assert (read[..., ::-1] == relief.normals()).all()


def test_a_large_tape_s_relief_is_coarser() -> None:
    tape = tape_of(PARTS["block"])
    coarse = relief_of(tape, 10_000)
    assert coarse.height.size < 12_000 and coarse.px_per_mm < 40


def test_mass_and_inertia_of_a_tetrahedron_are_those_of_its_points() -> None:
    corners = np.array([(1.0, 2.0, 3.0), (9.0, 1.0, 2.0), (2.0, 8.0, 1.0), (3.0, 2.0, 9.0)])
    mesh = Mesh(vertices_mm=corners, faces=np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]))
    mass, centre, inertia = solid_mass(mesh, 1000.0)
    share = np.random.default_rng(1).dirichlet(np.ones(4), 200_000)
    points = share @ corners / 1000
    assert mass == pytest.approx(abs(np.linalg.det(corners[1:] - corners[0])) / 6 * 1e-9 * 1000)
    assert centre == pytest.approx(corners.mean(axis=0) / 1000)
    off = points - centre
    expected = mass * ((off * off).sum(axis=1).mean() * np.eye(3) - off.T @ off / len(off))
    assert inertia == pytest.approx(expected, abs=0.01 * np.abs(expected).max())


def test_a_film_weighs_what_film_and_parts_weigh() -> None:
    tape = tape_of(PARTS["block"], columns=20, rows=20)
    body = tape_body(tape, None)
    w, h = tape.board.size_mm
    film = FILM_KG_M3 * w * h * tape.board.thickness_mm * 1e-9
    parts = CHIP_KG_M3 * 400 * element_volume_mm3(tape.part) * 1e-9
    assert body.mass == pytest.approx(film + parts)
    assert body.inertia[2, 2] == pytest.approx(body.mass * (w * w + h * h) * 1e-6 / 12, rel=0.1)
    assert body.centre[2] == pytest.approx(
        (parts * tape.part.body_mm[2] / 2 - film * tape.board.thickness_mm / 2) / body.mass * 1e-3
    )


@pytest.mark.parametrize("form", ["flat", "R16", "R25 round y", "R6 whole"])
def test_what_collides_covers_the_base(form: str) -> None:
    """Every vertex of the back and of the top without elements is within a tenth of a millimetre of a box."""
    shape, tape = FORMS[form], tape_of(PARTS["dome"])
    body = tape_body(tape, shape)
    points = 1e-3 * body.mesh.vertices_mm
    least = np.full(len(points), np.inf)
    for box in body.boxes:
        angle = float(np.linalg.norm(box.turn))
        turn = cv2.Rodrigues(np.array(box.turn))[0] if angle else np.eye(3)
        local = np.abs((points - box.centre) @ turn)
        least = np.minimum(least, np.maximum(local - box.half, 0).max(axis=1))
    above = least > 1.2e-4
    heights = 1e-3 * tape.part.body_mm[2]
    assert least.max() <= heights + 1e-4 and least.max() > heights / 2
    assert above.mean() < 0.9
    assert body.uv is not None and body.uv.min() >= 0 and body.uv.max() <= 1
