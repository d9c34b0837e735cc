"""Vertices of a texture's base: meshes of a stranger are answered, however large or small they are."""

from __future__ import annotations

from typing import Any

import pytest

from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mesh.sheet import texture_mesh
from tactape_fab.solids.mesh.triangles import Mesh
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
