"""What readers must find in models, beside shapely's areas and trimesh's volumes and centres."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import shapely
import trimesh

from tactape_fab.solids.forms import Cylinder, SolidForm
from tactape_fab.solids.mesh.sheet import texture_mesh
from tactape_fab.verify.models.expected import expected_of_embossed, expected_of_kit, faces_of, film_centre_mm, solid_centre_mm
from tests.solids import BLOCK, DOME, tape_of

TAPE = tape_of(BLOCK, 9, 5, holes_mm=[(2.4, 2.4, 1.0), (9.0, 3.0, 1.5)])
ROUND = Cylinder(radius_mm=16.0)
STEP: Any = SimpleNamespace(data=b"#1=ADVANCED_FACE('');\n#2 = ADVANCED_FACE ('');\n#3=FACE('');")


def test_the_centre_of_a_bare_board_is_that_of_its_area() -> None:
    (width, height), radius_mm = TAPE.board.size_mm, TAPE.board.corner_radius_mm
    area = shapely.box(radius_mm, radius_mm, width - radius_mm, height - radius_mm).buffer(radius_mm, quad_segs=200)
    for x, y, diameter in TAPE.board.holes:
        area -= shapely.Point(x, y).buffer(diameter / 2, quad_segs=200)
    assert film_centre_mm(TAPE) == pytest.approx((area.centroid.x, area.centroid.y, -0.055), abs=1e-5)


@pytest.mark.parametrize(
    "form", [SolidForm(), SolidForm(base_mm=2.0), SolidForm(negative=True), SolidForm(negative=True, base_mm=0.4)]
)
def test_volume_and_centre_of_a_flat_solid_are_those_of_its_mesh(form: SolidForm) -> None:
    # without arcs a mesh has no chords
    tape = tape_of(BLOCK, 9, 5, radius_mm=0.0, omitted=[(0, 0), (1, 0), (2, 1)])
    mesh = texture_mesh(tape, form)
    solid = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)
    expected = expected_of_kit(tape, form, {})
    assert expected.volume_mm3 == pytest.approx(solid.volume) and expected.centre_mm == pytest.approx(solid.center_mass)
    assert (expected.faces, expected.bodies, list(expected.steps)) == (0, 1, ["step-solid"])


@pytest.mark.parametrize(
    ("part", "form", "tolerance", "loose", "centred"),
    [
        (BLOCK, SolidForm(), 1e-7, 1e-7, True),
        (BLOCK, SolidForm(mark=True), 1e-7, 1e-7, False),
        (DOME, SolidForm(), 1e-7, 1e-7, False),
        (BLOCK, SolidForm(cylinder=ROUND), 1e-7, 1e-5, False),
        (DOME, SolidForm(cylinder=ROUND), 1e-6, 1e-5, False),
    ],
)
def test_tolerances_are_as_the_readers_need_them(
    part: Any, form: SolidForm, tolerance: float, loose: float, centred: bool
) -> None:
    tape = tape_of(part, 5, 5)
    found = expected_of_kit(tape, form, {"step-solid": STEP})
    assert (found.tolerance, found.loose_tolerance, found.faces) == (tolerance, loose, 2)
    assert (found.centre_mm is not None) == centred == (solid_centre_mm(tape, form) is not None)


def test_a_user_s_own_part_is_as_its_mesh_has_it() -> None:
    found = expected_of_embossed(500.0, 3, {})
    assert found.mesh_tolerance_mm3 == pytest.approx(0.05)
    assert (found.volume_mm3, found.bodies, found.faces) == (500.0, 3, 0)
    assert (found.tolerance, found.loose_tolerance, found.centre_mm) == (1e-3, 1e-3, None)
    assert faces_of({"step-solid": STEP}) == 2
