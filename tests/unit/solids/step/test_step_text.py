"""STEP solids and assemblies as text, every face checked against its surface without a CAD kernel."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timezone
from math import pi
from typing import Any

import numpy as np
import pytest

from tactape_fab.solids.checks import form_problems
from tactape_fab.solids.forms import Cylinder, SolidForm
from tactape_fab.solids.step.assembly import assembly_step
from tactape_fab.solids.step.part21 import real
from tactape_fab.solids.step.solid import solid_step, solid_step_chunks
from tactape_fab.solids.step.wrapped_element_faces import closed_spline
from tactape_fab.texture.tape import Tape
from tests.part21 import Ref, SolidChecker, StepFile, check_solids
from tests.solids import BLOCK, CONE, DATE, DOME, FORMS, PARTS, step_of, tape_of

VARIANTS = [pytest.param(part, form, id=f"{p} {f}") for p, part in PARTS.items() for f, form in FORMS.items()]
FACES = {"block": 5, "dome": 1, "cone": 2}


def around(tape: Tape, gap_mm: float, axis: int = 0) -> float:
    """Radius of a cylinder that a tape goes round but for a gap."""
    return float(np.ceil((tape.board.size_mm[axis] + gap_mm) / 2 / pi * 1e6) / 1e6)


def wrapped(radius_mm: float, **values: Any) -> SolidForm:
    cylinder = Cylinder(radius_mm=radius_mm, around=values.pop("around", "x"), shell=values.pop("shell", "segment"))
    return SolidForm(cylinder=cylinder, **values)


def solid(tape: Tape, form: SolidForm, genus: int) -> SolidChecker:
    assert form_problems(tape, form) == []
    (checker,) = check_solids(step_of(tape, form))
    assert checker.genus == genus
    return checker


@pytest.mark.parametrize(("part", "form"), VARIANTS)
def test_every_variant_is_one_exact_closed_solid(part: Any, form: SolidForm) -> None:
    tape = tape_of(part, 7, 5, omitted=[(0, 0), (6, 4), (3, 3)])
    whole = form.cylinder is not None and form.cylinder.shell == "whole"
    checker = solid(tape, form, genus=int(whole))
    assert len(checker.faces) >= FACES[part.name] * tape.part_count + 3


_NARROW = tape_of(BLOCK, 7, 5, margin_mm=0.02)
_ALL_BUT_ONE = [(i, j) for i in range(8) for j in range(7) if (i, j) != (2, 5)]
STRANGE = {
    "turned 0": (tape_of(replace(BLOCK, rotation_deg=0.0)), SolidForm(), 0),
    "turned 90": (tape_of(replace(BLOCK, rotation_deg=90.0)), SolidForm(), 0),
    "turned 137": (tape_of(replace(BLOCK, rotation_deg=137.0)), SolidForm(negative=True), 0),
    "turned 300": (tape_of(replace(BLOCK, rotation_deg=300.0)), SolidForm(), 0),
    "square, circles and lines on the cylinder": (tape_of(replace(BLOCK, rotation_deg=0.0)), wrapped(16.0), 0),
    "square, round y": (tape_of(replace(BLOCK, rotation_deg=90.0)), wrapped(16.0, around="y"), 0),
    "turned 0.6, long ellipses": (tape_of(replace(BLOCK, rotation_deg=0.6)), wrapped(16.0), 0),
    "turned 30 on a cylinder": (tape_of(replace(BLOCK, rotation_deg=30.0)), wrapped(16.0, around="y", negative=True), 0),
    "turned 300 on a cylinder": (tape_of(replace(BLOCK, rotation_deg=300.0)), wrapped(16.0), 0),
    "least pitch": (tape_of(BLOCK, 8, 8, pitch_mm=0.96, displacement_mm=0.1), SolidForm(), 0),
    "widest pitch": (tape_of(BLOCK, 7, 4, pitch_mm=20.0, displacement_mm=1.0), SolidForm(), 0),
    "odd pitch": (tape_of(BLOCK, 13, 7, pitch_mm=1.234567), wrapped(25.0), 0),
    "pitch of odd nanometres": (tape_of(BLOCK, 13, 7, pitch_mm=1.500001), wrapped(25.0, negative=True), 0),
    "one tile": (tape_of(DOME, 4, 4), SolidForm(), 0),
    "seven columns": (tape_of(DOME, 7, 4), SolidForm(), 0),
    "round ends": (tape_of(BLOCK, 13, 8, radius_mm=min(tape_of(BLOCK, 13, 8).board.size_mm) / 2), SolidForm(), 0),
    "a disc": (tape_of(BLOCK, 8, 8, radius_mm=tape_of(BLOCK, 8, 8).board.size_mm[0] / 2), SolidForm(negative=True), 0),
    "sharp corners": (tape_of(CONE, 8, 8, radius_mm=0.0), SolidForm(), 0),
    "holes on tile lines": (
        tape_of(BLOCK, 13, 13, holes_mm=[(9.9180, 11.0, 1.0), (10.0, 5.0, 2.0), (3.0, 10.1, 0.8)]),
        SolidForm(),
        3,
    ),
    "holes in a mould": (tape_of(DOME, 8, 8, holes_mm=[(9.9, 5.0, 1.0), (3.0, 3.0, 0.5)]), SolidForm(negative=True), 2),
    "one element": (tape_of(BLOCK, 8, 7, omitted=_ALL_BUT_ONE), wrapped(9.0), 0),
    "thin base": (tape_of(BLOCK), SolidForm(base_mm=0.01), 0),
    "small radius": (tape_of(BLOCK, 4, 4, margin_mm=0.3), wrapped(1.8), 0),
    "whole shell without a gap": (_NARROW, wrapped(around(_NARROW, 0.0), shell="whole"), 1),
    "whole shell with almost none": (_NARROW, wrapped(around(_NARROW, 0.011), shell="whole"), 1),
    "whole shell, a wide gap": (_NARROW, wrapped(80.0, shell="whole", negative=True), 1),
    "whole shell, one face as top": (_NARROW, wrapped(around(_NARROW, 0.05), shell="whole", top="single"), 1),
    "segment that almost closes": (_NARROW, wrapped(around(_NARROW, 0.12), top="single"), 0),
    "segment round y that almost closes": (_NARROW, wrapped(around(_NARROW, 0.12, 1), around="y", base_mm=0.5), 0),
    "dome on a small cylinder": (tape_of(DOME, 5, 4, margin_mm=0.3), wrapped(3.0, shell="whole"), 1),
    "shallow cone round y": (
        tape_of(replace(CONE, body_mm=(0.6, 0.6, 0.1)), 5, 4, displacement_mm=0.1),
        wrapped(6.0, around="y", negative=True),
        0,
    ),
    "steep cone": (tape_of(replace(CONE, body_mm=(0.5, 0.5, 1.0), top_mm=0.49)), wrapped(16.0), 0),
}


@pytest.mark.parametrize(("tape", "form", "genus"), STRANGE.values(), ids=STRANGE)
def test_strange_tapes_are_closed_solids_too(tape: Tape, form: SolidForm, genus: int) -> None:
    solid(tape, form, genus)


@pytest.mark.parametrize("height_mm", [0.23, 0.27, 0.29, 0.299])
@pytest.mark.parametrize("radius_mm", [2.0, 5.0, 16.0])
def test_a_dome_that_is_almost_a_half_ball_is_exact_or_refused(height_mm: float, radius_mm: float) -> None:
    """Where the cylinder falls away below the ball's equator a cap has no foot on it."""
    tape = tape_of(replace(DOME, body_mm=(0.6, 0.6, height_mm)), 4, 4, margin_mm=0.3, displacement_mm=0.1)
    form = wrapped(radius_mm, around="y")
    if not form_problems(tape, form):
        solid(tape, form, genus=0)


# The checker itself: what it is there to notice


def _change(pattern: str, change: Callable[[re.Match[str]], str], nth: int = 0) -> Callable[[str], str]:
    def edit(text: str) -> str:
        found = list(re.finditer(pattern, text))[nth]
        return text[: found.start()] + change(found) + text[found.end() :]

    return edit


def _tilted(text: str) -> str:
    """The plane of one block's side turned by 1e-6 about the vertical."""
    file = StepFile(text.encode())
    plane = [entity for _, entity in file.of_kind("PLANE")][-3]
    placement = file[plane.values[1]]
    x, y, _ = file.vector(placement.values[2])
    own = max(file.entities) + 1
    c, s = np.cos(1e-6), np.sin(1e-6)
    turned = f"#{own}=DIRECTION('',({real(c * x - s * y)},{real(c * y + s * x)},0.));\n"
    old = f"AXIS2_PLACEMENT_3D('',#{placement.values[1].number},#{placement.values[2].number},"
    at = text.rindex(old)
    text = text[:at] + text[at:].replace(f",#{placement.values[2].number},", f",#{own},", 1)
    return text.replace("ENDSEC;\nEND-ISO", turned + "ENDSEC;\nEND-ISO")


BROKEN = {
    "a tilted plane": (_tilted, "off its PLANE"),
    "a vertex moved by 10 nm": (
        _change(r"(CARTESIAN_POINT\('',\( *-?\d+\.\d{7})(\d)", lambda m: f"{m[1]}{(int(m[2]) + 1) % 10}", nth=-1),
        "off its",
    ),
    "an edge followed backward": (_change(r"(ORIENTED_EDGE\([^)]*)\.T\.\)", lambda m: m[1] + ".F.)", nth=-1), "does not close"),
    "a face turned over": (_change(r"(ADVANCED_FACE\(.*?)\.T\.\)", lambda m: m[1] + ".F.)", nth=-1), "outer loops"),
    "a face missing": (_change(r"(CLOSED_SHELL\('',\()#\d+,", lambda m: m[1]), "times forward"),
    "a name undefined": (_change(r"#1(\d+)=DIRECTION", lambda m: f"#99{m[1]}=DIRECTION", nth=-1), "without an entity"),
    "a radius": (_change(r"(CYLINDRICAL_SURFACE\('',#\d+),1\.\)", lambda m: m[1] + ",1.0001)"), "off its CYLINDRICAL"),
}


@pytest.mark.parametrize(("edit", "says"), BROKEN.values(), ids=BROKEN)
def test_the_checker_notices(edit: Callable[[str], str], says: str) -> None:
    text = step_of(tape_of(BLOCK, 4, 4), SolidForm()).decode("ascii")
    check_solids(text.encode())
    changed = edit(text)
    assert changed != text
    with pytest.raises(AssertionError, match=says):
        check_solids(changed.encode())


# The file


@pytest.mark.parametrize("form", [FORMS["flat"], FORMS["negative"], FORMS["R16"], FORMS["R6 whole"]])
def test_every_face_is_listed_after_a_neighbour(form: SolidForm) -> None:
    """What OCCT asks of a file that it is to open fast."""
    (checker,) = check_solids(step_of(tape_of(BLOCK, 13, 8), form))
    owners: dict[Ref, list[int]] = {}
    for i, face in enumerate(checker.faces):
        for bound in checker.file[face].values[1]:
            for oriented in checker.file[checker.file[bound].values[1]].values[1]:
                owners.setdefault(checker.file[oriented].values[3], []).append(i)
    first_neighbour = dict.fromkeys(range(len(checker.faces)), len(checker.faces))
    for a, b in owners.values():
        first_neighbour[a], first_neighbour[b] = min(first_neighbour[a], b), min(first_neighbour[b], a)
    assert [i for i in range(1, len(checker.faces)) if first_neighbour[i] >= i] == []


@pytest.mark.parametrize("form", [FORMS["flat"], FORMS["single"], FORMS["R16"], FORMS["R50 single"]])
def test_a_tile_has_at_most_36_elements(form: SolidForm) -> None:
    (checker,) = check_solids(step_of(tape_of(BLOCK, 13, 8), form))
    most = max(len(checker.file[face].values[1]) for face in checker.faces)
    assert most == (37 if form.top == "tiles" else 1 + 13 * 8)


def test_a_file_has_name_date_units_and_colour() -> None:
    tape = tape_of(DOME, 4, 4)
    date = datetime(2026, 5, 4, tzinfo=timezone.utc)
    data = solid_step(tape, SolidForm(), name="a 'tape'", date=date, rgb=(0.1, 0.2, 0.3))
    file = StepFile(data)
    assert "'a ''tape''','2026-05-04T00:00:00',(''),(''),'tactape-fab','tactape-fab'" in file.header
    assert [entity.values[0] for _, entity in file.of_kind("PRODUCT")] == ["'a ''tape'''"]
    assert [entity.values[1:] for _, entity in file.of_kind("COLOUR_RGB")] == [[0.1, 0.2, 0.3]]
    (_, solid_entity), (_, styled) = *file.of_kind("MANIFOLD_SOLID_BREP"), *file.of_kind("STYLED_ITEM")
    assert file[styled.values[2]] is solid_entity
    assert data == solid_step(tape, SolidForm(), name="a 'tape'", date=date, rgb=(0.1, 0.2, 0.3))
    unused = set(file.entities) - set(file.used)
    roots = {file.entities[number].kind for number in unused}
    assert roots <= {
        "APPLICATION_PROTOCOL_DEFINITION",
        "PRODUCT_RELATED_PRODUCT_CATEGORY",
        "SHAPE_DEFINITION_REPRESENTATION",
        "MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION",
        "DIRECTION",
    }


def test_a_solid_comes_in_pieces() -> None:
    tape = tape_of(BLOCK, 60, 40)
    pieces = list(solid_step_chunks(tape, SolidForm(), name="t", date=DATE, rgb=(0.5, 0.5, 0.5)))
    assert b"".join(pieces) == step_of(tape, SolidForm())
    assert len(pieces) > 4
    assert len(b"".join(pieces)) / tape.part_count < 3900


def test_a_solid_without_elements_is_a_plate() -> None:
    tape = tape_of(BLOCK, 4, 4, omitted=[(i, j) for i in range(4) for j in range(4)])
    assert len(solid(tape, SolidForm(), genus=0).faces) == 1 + 8 + 1


@pytest.mark.parametrize("radius_mm", [0.2, 1.0, 3.0])
def test_a_closed_spline_goes_through_its_curve_and_closes_smoothly(radius_mm: float) -> None:
    angle = np.arange(64) * (2 * pi / 64)
    curve = np.stack([np.cos(angle), np.sin(angle), 0.1 * np.cos(2 * angle)], axis=1) * radius_mm
    controls, knots, multiplicities = closed_spline(curve)
    assert len(controls) == sum(multiplicities) - 6
    assert (controls[0] == controls[-1]).all()
    from scipy.interpolate import BSpline

    spline = BSpline(np.repeat(knots, multiplicities), controls, 5)
    at = np.linspace(0, knots[-1], 1000)
    turn = at / knots[-1] * 2 * pi
    exact = np.stack([np.cos(turn), np.sin(turn), 0.1 * np.cos(2 * turn)], axis=1) * radius_mm
    assert np.abs(spline(at) - exact).max() < 2e-6 * radius_mm
    for derivative in (1, 2):
        ends = spline([0.0, knots[-1]], nu=derivative)
        assert np.abs(ends[0] - ends[1]).max() < 1e-9


# The assembly


def assembly_of(tape: Tape) -> StepFile:
    data = assembly_step(tape, name="t", date=DATE, board_rgb=(0.8, 0.5, 0.1), part_rgb=(0.1, 0.1, 0.1))
    checkers = check_solids(data)
    assert [checker.genus for checker in checkers] == [len(tape.board.holes), 0]
    assert len(checkers[1].faces) == 6
    return StepFile(data)


@pytest.mark.parametrize(
    "tape",
    [
        tape_of(BLOCK, 4, 4),
        tape_of(BLOCK, 12, 10, holes_mm=[(5.0, 5.0, 1.2), (9.9, 9.9, 0.8)]),
        tape_of(replace(BLOCK, rotation_deg=30.0), 40, 30, radius_mm=8.0, pitch_mm=1.234567, displacement_mm=0.123456),
    ],
    ids=["16", "with holes", "more than a thousand"],
)
def test_an_assembly_has_every_designator_in_its_place(tape: Tape) -> None:
    file = assembly_of(tape)
    assert len(file.of_kind("PRODUCT")) == 3
    assert {entity.values[0] for _, entity in file.of_kind("PRODUCT")} == {"'t'", "'t-board'", "'BLOCK'"}
    angle = np.radians(tape.part.rotation_deg)
    places: dict[str, Any] = {}
    for _, link in file.of_kind("CONTEXT_DEPENDENT_SHAPE_REPRESENTATION"):
        relation, usage_shape = (file[value] for value in link.values)
        usage = file[usage_shape.values[2]]
        assert usage.kind == "NEXT_ASSEMBLY_USAGE_OCCURRENCE"
        assert usage.values[0] == usage.values[1]
        plain, with_move, _ = relation.values
        moved = file[with_move.values[0]]
        origin, placement = (file.axes(value) for value in moved.values[2:])
        assert (origin[0] == 0).all()
        assert (origin[1] == np.eye(3)).all()
        used_shape, whole_shape = (file[value] for value in plain.values[2:])
        assert moved.values[3] in whole_shape.values[1]
        assert moved.values[2] in used_shape.values[1]
        places[str(usage.values[0]).strip("'")] = placement
    at, turn = places.pop("board")
    assert (at == 0).all()
    assert (turn == np.eye(3)).all()
    assert sorted(places) == sorted(tape.designators())
    for name, (x, y) in zip(tape.designators(), tape.part_xy_mm().tolist(), strict=True):
        at, turn = places[name]
        assert np.abs(at - (x, y, 0.0)).max() < 1e-9
        assert np.abs(turn[0] - (np.cos(angle), np.sin(angle), 0.0)).max() < 1e-9
        assert (turn[2] == (0.0, 0.0, 1.0)).all()
    colours = [entity.values[1:] for _, entity in file.of_kind("COLOUR_RGB")]
    assert colours == [[0.8, 0.5, 0.1], [0.1, 0.1, 0.1]]
    styled = [file[entity.values[2]].kind for _, entity in file.of_kind("STYLED_ITEM")]
    assert styled == ["MANIFOLD_SOLID_BREP"] * 2


def test_the_prototype_stands_on_its_origin() -> None:
    tape = tape_of(BLOCK, 4, 4)
    file = assembly_of(tape)
    part = SolidChecker(file, file.of_kind("MANIFOLD_SOLID_BREP")[1][0])
    part.check()
    corners = np.array([edge.points[0] for edge in part.edges.values()])
    assert corners.min(axis=0).tolist() == [-0.3, -0.15, 0.0]
    assert corners.max(axis=0).tolist() == [0.3, 0.15, 0.23]
    board = SolidChecker(file, file.of_kind("MANIFOLD_SOLID_BREP")[0][0])
    board.check()
    points = np.concatenate([edge.points for edge in board.edges.values()])
    assert points.min(axis=0).tolist() == pytest.approx([0.0, 0.0, -0.11])
    assert points.max(axis=0).tolist() == pytest.approx([*tape.board.size_mm, 0.0])
