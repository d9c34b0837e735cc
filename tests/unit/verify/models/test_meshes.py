"""Models of a kit: right ones pass each line, and one change fails the line that is about it."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab.base.errors import Check
from tactape_fab.solids.forms import Cylinder, SolidForm
from tactape_fab.solids.mesh.sheet import texture_mesh
from tactape_fab.solids.mesh.triangles import Mesh, stl_bytes, threemf_bytes
from tactape_fab.solids.step.assembly import assembly_step
from tactape_fab.solids.step.solid import solid_step
from tactape_fab.texture.frames import BoolArray, FloatArray
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.models.meshes import check_models, mesh_volume_tolerance_mm3
from tests.solids import BLOCK, CONE, DATE, DOME, tape_of, volume_mm3

FORM, RGB = SolidForm(), (0.2, 0.4, 0.6)
TAPES = {part.name: tape_of(part, 5, 5) for part in (BLOCK, DOME, CONE)}


def models(tape: Tape, form: SolidForm = FORM, **others: Any) -> dict[str, Check]:
    """The lines about the models of a tape, of which some are of another tape, mesh or text."""
    mesh = others["mesh"] if "mesh" in others else texture_mesh(others.get("other", tape), form)
    data = {
        "stl": stl_bytes(mesh, "t"),
        "3mf": threemf_bytes(others.get("threemf", mesh), "t", {}, DATE),
        "step-solid": solid_step(others.get("other", tape), form, name="t", date=DATE, rgb=RGB),
        "step-assembly": assembly_step(tape, name="t", date=DATE, board_rgb=RGB, part_rgb=RGB),
    }
    for role, change in others.get("changes", {}).items():
        data[role] = change(data[role])
    files = {role: WrittenFile(path=role, data=text) for role, text in data.items()}
    return {check.name: check for check in check_models(tape, form, files, mesh, others.get("cpl"))}


@pytest.mark.parametrize("form", [FORM, SolidForm(mark=True), SolidForm(negative=True)], ids=["plain", "marked", "mould"])
@pytest.mark.parametrize("tape", TAPES.values(), ids=TAPES)
def test_right_models_pass_every_line(tape: Tape, form: SolidForm) -> None:
    lines = models(tape, form)
    assert all(check.passed for check in lines.values()) and ("stl mark" in lines) == form.mark
    own = {"block": 125, "dome": 25, "cone": 50}[tape.part.name]
    assert f"{own} of them elements'" in lines["step-solid"].message and "not compared in its text" in lines["step-solid"].message
    assert form.mark or lines["stl"].figure == pytest.approx(volume_mm3(tape, form), abs=0.1)


@pytest.mark.parametrize("tape", TAPES.values(), ids=TAPES)
def test_elements_that_are_not_the_manifest_s_are_counted_in_both_models(tape: Tape) -> None:
    longer = replace(tape.part, body_mm=(tape.part.body_mm[0] + 0.02, *tape.part.body_mm[1:]))
    for other, says in (
        (replace(tape, displacement_mm=0.27), "25 elements are misplaced, worst by 20.0 um at ("),
        (tape_of(tape.part, 5, 5, omitted=[(2, 2)]), "24 elements where the manifest has 25: 1 are missing, 0 too many"),
        (replace(tape, part=longer), "elements differ from the manifest's shape by 10.0 um" if tape.part is BLOCK else ""),
    ):
        lines = models(tape, other=other)
        assert says in lines["stl places"].message and says in lines["step-solid"].message
        assert not lines["stl base"].passed


def test_domes_off_the_grid_and_without_a_place_are_told_from_misplaced_ones() -> None:
    tape = TAPES["dome"]
    x, y = tape.board.texture_origin_mm
    beside = replace(tape, board=replace(tape.board, texture_origin_mm=(x + 1.5, y)))
    assert "5 elements are off the grid" in models(tape, other=beside, mesh=texture_mesh(tape, FORM))["step-solid"].message
    nowhere = {"step-solid": lambda data: data.replace(b"=SPHERICAL_SURFACE('',#", b"=SPHERICAL_SURFACE('',#9999999", 2)}
    assert "23 elements where the manifest has 25: 2 are missing" in models(tape, changes=nowhere)["step-solid"].message


def moved(at: Callable[[FloatArray], BoolArray], by_mm: tuple[float, ...], tape: Tape = TAPES["block"]) -> Mesh:
    mesh = texture_mesh(tape, FORM)
    points = mesh.vertices_mm.copy()
    points[at(points)] += by_mm
    return Mesh(vertices_mm=points, faces=mesh.faces)


def with_another_part(data: bytes) -> bytes:
    """A 3MF whose first file, the table of types, has a blank more."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(stream, "w") as new:
        for k, entry in enumerate(old.infolist()):
            new.writestr(entry, old.read(entry) + b" " * (k == 0))
    return stream.getvalue()


def test_a_mesh_may_lose_to_chords_2_um_of_the_area_that_is_curved() -> None:
    tape, holed = TAPES["block"], tape_of(BLOCK, 5, 5, holes_mm=[(4.65, 4.65, 2.0)], omitted=[(2, 2)])
    whole, segment = (SolidForm(cylinder=Cylinder(radius_mm=6.0, shell=shell)) for shell in ("whole", "segment"))
    flat, hole, more, less, mould = (
        mesh_volume_tolerance_mm3(of, form)
        for of, form in ((tape, FORM), (holed, FORM), (tape, whole), (tape, segment), (tape, replace(segment, negative=True)))
    )
    # walls of 0.8 mm round the board, and round the hole
    assert (flat, hole - flat) == pytest.approx((0.002 * 4 * 9.3 * 0.8, 0.002 * 2 * np.pi * 0.8), rel=0.03)
    # 37.7 mm round against 9.3 mm; a mould's back is 0.8 + 0.23 mm farther out
    assert (more / less, mould / less) == pytest.approx((12 * np.pi / 9.3, (7.03 / 6) ** 2), rel=0.03)


RIGHT = texture_mesh(TAPES["block"], FORM)
NAMES = tuple(f"R{k}" for k in range(1, 26))
PLACES = TAPES["block"].part_xy_mm()
CPL = SimpleNamespace(designators=NAMES, xy_mm=PLACES)


@pytest.mark.parametrize(
    ("line", "others", "says"),
    [
        ("stl", {"mesh": moved(lambda p: p[:, 2] < 0, (0.0, 0.0, -0.01))}, "mm3, not 70.083"),
        ("stl", {"mesh": Mesh(vertices_mm=RIGHT.vertices_mm, faces=RIGHT.faces[1:])}, "edge"),
        (
            "stl places",
            {"mesh": moved(lambda p: (p[:, 2] < 0) & (p[:, 0] == 0) & (p[:, 1] < 2), (0, 0, 1))},
            "raised vertices off the grid, first at (0.000,",
        ),
        ("3mf", {"threemf": moved(lambda p: np.arange(len(p)) == 7, (0.00001, 0.0, 0.0))}, "a corner is off the STL by 10"),
        (
            "3mf",
            {"threemf": Mesh(vertices_mm=RIGHT.vertices_mm, faces=RIGHT.faces[1:])},
            "its 883 triangles are not the STL's 884",
        ),
        ("3mf", {"changes": {"3mf": lambda data: data + b" "}}, "behind its package"),
        ("3mf", {"threemf": moved(lambda p: p[:, 0] > -1, (2e-6, 0.0, 0.0))}, ""),
        ("3mf", {"threemf": moved(lambda p: p[:, 0] > -1, (4e-6, 0.0, 0.0))}, "a corner is off the STL by 4."),
        ("3mf", {"threemf": Mesh(vertices_mm=RIGHT.vertices_mm[:-1], faces=RIGHT.faces)}, "name vertices that it does not have"),
        ("3mf", {"changes": {"3mf": with_another_part}}, "its package is not written as usual"),
        ("3mf", {"threemf": Mesh(vertices_mm=RIGHT.vertices_mm, faces=RIGHT.faces[:0])}, "name vertices that it does not have"),
        (
            "step-solid",
            {"changes": {"step-solid": lambda data: data.replace(b"=CLOSED_SHELL(", b"=OPEN_SHELL(")}},
            "1 solids of 0 shells",
        ),
        (
            "step-solid",
            {"changes": {"step-solid": lambda data: data.replace(b"=ADVANCED_FACE(", b"=FACE(", 8)}},
            "127 faces, fewer than",
        ),
        (
            "step-solid",
            {"changes": {"step-solid": lambda data: data.replace(b"POINT('',(", b"POINT('',(1 ", 9)}},
            "points that are none",
        ),
        (
            "step-solid",
            {"changes": {"step-solid": lambda data: data.replace(b"POINT('',(", b"POINT('',(9E9", 9)}},
            "points that are none",
        ),
        ("step-assembly", {"cpl": CPL}, ""),
        ("step-assembly", {"cpl": SimpleNamespace(designators=NAMES, xy_mm=PLACES + 0.0006)}, ""),
        (
            "step-assembly",
            {"cpl": SimpleNamespace(designators=NAMES, xy_mm=PLACES + 0.003 * np.eye(25, 2) * (1, 0))},
            "R1 is 3.0 um off its CPL row",
        ),
        ("step-assembly", {"cpl": SimpleNamespace(designators=("C1", *NAMES[1:]), xy_mm=PLACES)}, "the CPL has 25: C1, R1"),
        ("step-assembly", {"changes": {"step-assembly": lambda data: data.replace(b"'R7','R7'", b"'R7','R8'")}}, "has two names"),
        (
            "step-assembly",
            {"changes": {"step-assembly": lambda data: data.replace(b"'R7','R7'", b"'R8','R8'")}},
            "CPL has 25: R7",
        ),
    ],
)
def test_each_line_names_what_is_wrong(line: str, others: dict[str, Any], says: str) -> None:
    check = models(TAPES["block"], **others)[line]
    assert check.passed == (not says) and says in check.message, check.message


def test_places_that_are_not_compared_have_no_error() -> None:
    check = models(TAPES["block"], cpl=SimpleNamespace(designators=("C1", *NAMES[1:]), xy_mm=PLACES))["step-assembly"]
    assert (check.passed, check.figure) == (False, 0.0)
