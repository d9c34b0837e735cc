"""The solid models as build123d objects. Importing build123d takes a second or two."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from typing import Any

import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.solids.cad import assembly, texture_part
from tactape_fab.solids.forms import Cylinder, SolidForm
from tests.solids import BLOCK, CONE, DOME, tape_of, volume_mm3
from tests.thorough import costly


@costly
@pytest.mark.parametrize(
    ("part", "form"),
    [
        (BLOCK, None),
        (DOME, SolidForm(base_mm=1.2, top="single")),
        (CONE, SolidForm(negative=True)),
        (BLOCK, SolidForm(cylinder=Cylinder(radius_mm=16.0))),
    ],
    ids=["block", "dome", "mould", "cylinder"],
)
def test_a_texture_is_a_build123d_part(part: Any, form: SolidForm | None) -> None:
    from build123d import Part

    tape = tape_of(part, 4, 4)
    made = texture_part(tape, form)
    assert isinstance(made, Part)
    assert made.label == "t"
    assert made.is_valid
    assert len(made.solids()) == 1
    assert made.volume == pytest.approx(volume_mm3(tape, form or SolidForm()), rel=1e-6)
    if form is None:
        box = made.bounding_box()
        assert tuple(box.min) == pytest.approx((0.0, 0.0, -0.8), abs=1e-6)
        assert tuple(box.max) == pytest.approx((*tape.board.size_mm, 0.23), abs=1e-6)


def test_a_texture_can_be_added_to_other_parts() -> None:
    from build123d import Box, Pos

    tape = tape_of(BLOCK, 4, 4)
    w, h = tape.board.size_mm
    grip = Pos(w / 2, h / 2, -0.8 - 2.5) * Box(5, 5, 5)
    joined = texture_part(tape) + grip
    assert len(joined.solids()) == 1
    assert joined.volume == pytest.approx(volume_mm3(tape, SolidForm()) + 125.0, rel=1e-6)


def test_an_assembly_has_a_child_for_every_designator() -> None:
    tape = tape_of(replace(BLOCK, rotation_deg=30.0), 5, 4)
    made = assembly(tape)
    assert [child.label for child in made.children] == ["board", *tape.designators()]
    assert len(made.solids()) == 1 + tape.part_count
    for child, (x, y) in zip(made.children[1:], tape.part_xy_mm().tolist(), strict=True):
        assert tuple(child.center()) == pytest.approx((x, y, 0.115), abs=1e-6)
        assert tuple(child.location.position) == pytest.approx((x, y, 0.0), abs=1e-6)
        assert pytest.approx(30.0) == child.location.orientation.Z
        assert child.volume == pytest.approx(0.6 * 0.3 * 0.23)
    assert made.children[1].wrapped.IsPartner(made.children[2].wrapped)


def test_what_cannot_be_built_is_a_spec_error() -> None:
    with pytest.raises(SpecError, match="overlap itself"):
        texture_part(tape_of(BLOCK, 12, 4), SolidForm(cylinder=Cylinder(radius_mm=2.0)))
    with pytest.raises(SpecError, match="texture_part"):
        assembly(tape_of(DOME, 4, 4))


def test_importing_the_module_imports_no_kernel() -> None:
    program = "import sys; import tactape_fab.solids.cad; print('build123d' in sys.modules, 'OCP' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, encoding="utf-8", check=True)
    assert done.stdout.split() == ["False", "False"]
