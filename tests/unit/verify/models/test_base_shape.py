"""Vertices of a texture's base: meshes of a stranger are answered, however large or small they are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mesh.sheet import texture_mesh
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.wrap import unwrapped
from tactape_fab.texture.part import TapePart
from tactape_fab.verify.models.base_shape import check_base
from tests.solids import FORMS, PARTS, tape_of


@pytest.mark.parametrize("scale", [1e30, 1e-30])
@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
@pytest.mark.parametrize("part", PARTS.values(), ids=PARTS)
def test_a_mesh_of_another_size_has_no_feet(part: Any, form: SolidForm, scale: float) -> None:
    tape = tape_of(part, 5, 5)
    mesh = texture_mesh(tape, form)
    check = check_base(tape, form, Mesh(vertices_mm=mesh.vertices_mm * scale, faces=mesh.faces))
    assert not check.passed and "25 elements do not stand on the base" in check.message


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
@pytest.mark.parametrize("part", PARTS.values(), ids=PARTS)
def test_one_foot_that_is_not_the_manifest_s_is_counted(part: TapePart, form: SolidForm) -> None:
    tape = tape_of(part, 5, 5)
    mesh = texture_mesh(tape, form)
    assert check_base(tape, form, mesh).passed
    points, centre = unwrapped(mesh.vertices_mm, tape, form), tape.part_xy_mm()[12]
    foot = np.flatnonzero((np.abs(points[:, 2]) < 1e-4) & (np.hypot(*(points[:, :2] - centre).T) < 0.4))
    inwards = mesh.vertices_mm[foot].mean(axis=0) - mesh.vertices_mm[foot]
    for some in (1, len(foot)):
        wrong = mesh.vertices_mm.copy()
        wrong[foot[:some]] += 0.02 * inwards[:some] / np.linalg.norm(inwards[:some], axis=1, keepdims=True)
        check = check_base(tape, form, Mesh(vertices_mm=wrong, faces=mesh.faces))
        assert not check.passed and "1 elements do not stand on the base with the manifest's foot" in check.message


HOLE = (4.65, 4.65, 1.0)


@pytest.mark.parametrize(
    ("which", "by_mm", "says"),
    [
        (lambda x, y, z: z == 0.23, (0.0, 0.0, 0.001), ""),
        (lambda x, y, z: z == 0.0, (0.0, 0.0, 0.0015), ""),
        (
            lambda x, y, z: (z == 0.0) & (x == x.max()) & (y < 2),
            (0.0, 0.0, 0.003),
            "1 vertices on no face of the base and on no element, first",
        ),
        (
            lambda x, y, z: (z < 0.0) & (x == x.max()),
            (0.0, 0.0, -0.003),
            "2 vertices on no face of the base and on no element, first",
        ),
        (lambda x, y, z: (z == 0.0) & (x == x.max()), (0.005, 0.0, 0.0), "the base's top does not end at its outline, by 5.0 um"),
        (lambda x, y, z: (z < 0.0) & (x == x.max()), (0.005, 0.0, 0.0), "the base's back does not end at its outline, by 5.0 um"),
        (lambda x, y, z: (z < 0.0) & (y < 0.3), (0.0, 0.01, 0.0), "the base's back does not end at its outline, by 10.0 um"),
        (lambda x, y, z: z < 0.0, (0.0, 0.0, -1.0), "the base's back does not end at its outline, by inf um"),
        (lambda x, y, z: np.hypot(x - HOLE[0], y - HOLE[1]) < 0.51, (0.003, 0.0, 0.0), ""),
        (lambda x, y, z: (np.hypot(x - HOLE[0], y - HOLE[1]) < 0.51) & (x > HOLE[0] + 0.499), (-0.006, 0.0, 0.0), "inside holes"),
    ],
)
def test_faces_outline_and_holes_of_a_base_are_where_the_manifest_has_them(
    which: Any, by_mm: tuple[float, ...], says: str
) -> None:
    tape = tape_of(PARTS["block"], 5, 5, holes_mm=[HOLE], omitted=[(2, 2)])
    mesh = texture_mesh(tape, SolidForm())
    assert check_base(tape, SolidForm(), mesh).passed
    points = mesh.vertices_mm.copy()
    chosen = which(*points.round(4).T)
    assert chosen.any()
    points[chosen] += by_mm
    check = check_base(tape, SolidForm(), Mesh(vertices_mm=points, faces=mesh.faces))
    assert check.passed == (not says) and says in check.message
