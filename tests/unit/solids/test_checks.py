"""What keeps the solid models of a tape from being built, said before anything is; and that nothing else does."""

from __future__ import annotations

import re
from dataclasses import replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab import TapeSpec, make_kit
from tactape_fab.base.errors import SpecError
from tactape_fab.solids.checks import form_problems, hole_problems
from tactape_fab.solids.forms import Cylinder, SolidForm
from tactape_fab.solids.rise import foot_loop_mm
from tactape_fab.texture.board import Board
from tactape_fab.texture.tape import Tape
from tests.solids import BLOCK, DOME, tape_of
from tests.unit.solids.mesh.test_meshes import checked


def said(tape: Tape, form: SolidForm) -> str:
    problems = form_problems(tape, form)
    assert len(problems) >= 1
    return "; ".join(problem.message for problem in problems)


def test_an_element_larger_than_its_cell_is_refused() -> None:
    text = said(tape_of(DOME, 5, 5, displacement_mm=0.449), SolidForm())
    assert "part = 'dome' is larger than its cell: displaced by 0.449 mm it reaches 0.749 mm" in text
    assert "more than 0.748 mm" in text
    assert "--w" in text
    assert form_problems(tape_of(DOME, 5, 5, displacement_mm=0.448), SolidForm()) == []


@pytest.mark.parametrize("pitch_mm", [0.8, 0.871])  # larger than its cell on a plane, and round the cylinder only
def test_the_pitch_of_a_refusal_is_enough_round_the_cylinder_too(pitch_mm: float) -> None:
    form = SolidForm(cylinder=Cylinder(radius_mm=5.0))
    tape = tape_of(DOME, 5, 5, pitch_mm=pitch_mm, displacement_mm=0.133)
    found = re.search(r"use --w ([\d.]+) --delta 0\.133, or a ", said(tape, form))
    assert found is not None
    assert form_problems(tape_of(DOME, 5, 5, pitch_mm=float(found[1]), displacement_mm=0.133), form) == []


@pytest.mark.parametrize(("around", "axis"), [("x", 0), ("y", 1)])
@pytest.mark.parametrize("shell", ["segment", "whole"])
def test_a_tape_that_overlaps_itself_is_refused(around: Any, axis: int, shell: Any) -> None:
    tape = tape_of(BLOCK, 12, 9)
    length = tape.board.size_mm[axis]
    radius = length / 2 / pi - 0.01
    text = said(tape, SolidForm(cylinder=Cylinder(radius_mm=radius, around=around, shell=shell)))
    assert "overlap itself" in text
    longest = float(text.split("largest length that fits is ")[1].split(" mm")[0])
    slit = 0.1 if shell == "segment" else 0.0
    assert longest <= 2 * pi * radius - slit < longest + 0.001


def test_a_slit_is_refused() -> None:
    tape = tape_of(BLOCK, 12, 9)
    radius = (tape.board.size_mm[0] + 0.09) / 2 / pi
    text = said(tape, SolidForm(cylinder=Cylinder(radius_mm=radius)))
    assert "a slit of 0.090 mm" in text
    assert "--shell whole" in text
    assert form_problems(tape, SolidForm(cylinder=Cylinder(radius_mm=radius, shell="whole"))) == []


def test_a_cylinder_thinner_than_its_base_is_refused() -> None:
    tape = tape_of(BLOCK, 4, 4)
    assert "is below 2.10 mm" in said(tape, SolidForm(base_mm=2.0, cylinder=Cylinder(radius_mm=2.0)))
    assert form_problems(tape, SolidForm(base_mm=2.0, negative=True, cylinder=Cylinder(radius_mm=2.0))) == []


def test_holes_and_cylinders_do_not_go_together() -> None:
    tape = tape_of(BLOCK, 8, 8, holes_mm=[(5.0, 5.0, 1.0)])
    assert "no holes" in said(tape, SolidForm(cylinder=Cylinder(radius_mm=50.0)))


@pytest.mark.parametrize("rotation_deg", [0.1, 89.6, 90.4, -0.49, 180.3])
def test_blocks_almost_parallel_to_the_axis_are_refused(rotation_deg: float) -> None:
    tape = tape_of(replace(BLOCK, rotation_deg=rotation_deg), 8, 8)
    form = SolidForm(cylinder=Cylinder(radius_mm=16.0))
    assert "multiple of 90" in said(tape, form)
    assert form_problems(replace(tape, part=replace(DOME, rotation_deg=rotation_deg)), form) == []


@pytest.mark.parametrize("height_mm", [0.05, 0.1, 0.23])
@pytest.mark.parametrize("radius_mm", [2.0, 3.0, 6.0, 16.0])
@pytest.mark.parametrize("top_mm", [None, 0.1, 0.5])
def test_a_dome_s_foot_on_a_cylinder_stays_in_its_cell_or_is_refused(height_mm: float, radius_mm: float, top_mm: float) -> None:
    """The lower the surface falls, the wider the foot: wider than the dome's own diameter."""
    part = replace(DOME, body_mm=(0.6, 0.6, height_mm), top_mm=top_mm)
    tape = tape_of(part, 4, 4, displacement_mm=0.44, margin_mm=0.3)
    form = SolidForm(base_mm=0.3, cylinder=Cylinder(radius_mm=radius_mm))
    if not form_problems(tape, form):
        foot = foot_loop_mm(part, radius_mm, 360)
        arc = radius_mm * np.arcsin(foot[:, 0].max() / radius_mm)
        assert 0.44 + max(arc, foot[:, 1].max()) <= 0.75
        checked(tape, form)


@pytest.mark.parametrize(
    ("margin_mm", "radius_mm", "shell"), [(0.02, 6.0, "segment"), (0.02, 3.5, "whole"), (0.3, 6.0, "segment")]
)
def test_a_foot_beyond_the_end_of_the_base_is_refused(margin_mm: float, radius_mm: float, shell: Any) -> None:
    tape = tape_of(replace(DOME, body_mm=(0.6, 0.6, 0.1)), 7, 4, displacement_mm=0.05, margin_mm=margin_mm)
    form = SolidForm(base_mm=0.3, cylinder=Cylinder(radius_mm=radius_mm, shell=shell))
    if not form_problems(tape, form):
        checked(tape, form)
    else:
        assert margin_mm == 0.02


def test_all_problems_come_together() -> None:
    tape = tape_of(replace(DOME, body_mm=(1.2, 1.2, 0.23)), 8, 8, holes_mm=[(5.0, 5.0, 1.0)])
    keys = [p.key for p in form_problems(tape, SolidForm(cylinder=Cylinder(radius_mm=2.0)))]
    assert keys == ["part", "cylinder_mm", "holes_mm"]


@pytest.mark.parametrize(
    ("holes", "words"),
    [
        ([(8.0, 8.0, 2.0), (10.0, 8.0, 3.0)], ["--hole 10,8,3 overlaps --hole 8,8,2"]),
        ([(8.0, 8.0, 2.0), (8.0, 8.0, 2.0)], ["--hole 8,8,2 overlaps --hole 8,8,2"]),
        ([(8.0, 8.0, 4.0), (8.0, 8.5, 1.0)], ["--hole 8,8.5,1 overlaps --hole 8,8,4"]),
        ([(1.2, 1.2, 2.0)], ["--hole 1.2,1.2,2 reaches beyond the outline"]),
        ([(8.0, 8.0, 2.0), (10.01, 8.0, 2.0), (2.0, 2.0, 1.0)], []),
    ],
)
def test_holes_that_no_solid_has_are_refused(holes: list[tuple[float, float, float]], words: list[str]) -> None:
    board = Board(size_mm=(20.0, 16.0), texture_origin_mm=(1.0, 15.0), corner_radius_mm=3.0, thickness_mm=0.8, holes=tuple(holes))
    found = [problem.message for problem in hole_problems(board)]
    assert [message.removeprefix("holes_mm: ").split(", as in no")[0] for message in found] == words


@pytest.mark.parametrize("more", [{"part": "block"}, {}, {"models": False, "sim": True}])
@pytest.mark.parametrize("holes", [((18.7, 18.1, 2.4), (19.6, 20.6, 3.6)), ((0.9, 0.9, 1.6),)])
def test_they_are_refused_though_rules_are_forced(more: dict[str, Any], holes: Any, tmp_path: Path) -> None:
    radius: dict[str, Any] = {"corner_radius_mm": 5.0, "tag": "none"} if len(holes) == 1 else {}
    with pytest.raises(SpecError, match=r"overlaps|beyond the outline"):
        make_kit(TapeSpec(sector=7, size_mm=(40.0, 40.0), holes_mm=holes, **radius, **more), tmp_path / "kit", force=True)
