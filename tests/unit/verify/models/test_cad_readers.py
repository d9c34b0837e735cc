"""What readers of the models answer is compared with what is expected: right answers pass, and each wrong figure is said."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab.base import launch
from tactape_fab.base.errors import Check
from tactape_fab.solids.elements import element_volume_mm3
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.step.solid import solid_step
from tactape_fab.solids.volume import solid_volume_mm3
from tactape_fab.texture.cpl import PLACEMENTS, CplContent
from tactape_fab.verify.models import cad_readers
from tactape_fab.verify.models.cad_readers import (
    CPU_S,
    CPU_S_OF_OWN,
    MEMORY_BYTES,
    MEMORY_PER_BYTE,
    _answer,
    _check_centres,
    _check_occurrences,
    _check_solid,
    _is_own,
    _kernels,
    _limits,
    _lines,
    _run,
    _slicer,
    _trimesh,
)
from tactape_fab.verify.models.expected import Expected, film_centre_mm
from tactape_fab.verify.models.step_text import step_text
from tests.solids import DATE, tape_of

TAPE = tape_of(columns=3, rows=2)
VOLUME_MM3, ELEMENT_MM3 = 90.0, element_volume_mm3(TAPE.part)
EXPECTED = Expected(
    volume_mm3=VOLUME_MM3,
    tolerance=1e-6,
    loose_tolerance=1e-4,
    mesh_tolerance_mm3=0.01,
    faces=36,
    bodies=1,
    centre_mm=np.array([1.0, 2.0, 0.5]),
    steps={},
)
ANGLES_DEG = np.linspace(30.0, 80.0, TAPE.part_count)
CPL = CplContent(
    table=PLACEMENTS["generic"],
    headers=(),
    lines=(),
    designators=tuple(TAPE.designators()),
    xy_mm=TAPE.part_xy_mm(),
    sides=(),
    rotation_deg=ANGLES_DEG,
    texts={},
)
Change = Callable[[dict[str, Any]], object]


def said(check: Check, says: str) -> None:
    """Check that a line passes if nothing is to be said, and else says so alone."""
    assert check.passed == (not says)
    assert says in check.message and (check.passed or "; " not in check.message), check.message


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({}, ""),
        ({"volume_mm3": VOLUME_MM3 * (1 - 0.9e-6)}, ""),
        ({"volume_mm3": VOLUME_MM3 * (1 + 1.1e-6)}, "is 1.1e-06 from 90.000000 mm3"),
        ({"volume_mm3": float("nan")}, "volume nan mm3"),
        ({"solids": 2}, "2 solids instead of 1"),
        ({"solids": 0}, "0 solids instead of 1"),
        ({"faces": 35}, "35 faces instead of 36"),
        ({"valid": False}, "the solid is not valid"),
        ({"centre_mm": [1.0, 2.0, 0.50009]}, ""),
        ({"centre_mm": [1.0, 2.00011, 0.5]}, "its centre of mass is 0.110 um from where its shape has it"),
        ({"centre_mm": None}, ""),
        ({"error": "it could not be read"}, "it could not be read"),
    ],
)
def test_a_solid_has_its_volume_faces_and_centre(change: dict[str, Any], says: str) -> None:
    found = {"solids": 1, "faces": 36, "valid": True, "volume_mm3": VOLUME_MM3, "centre_mm": [1.0, 2.0, 0.5], **change}
    said(_check_solid(EXPECTED, "OCCT", found), says)
    assert _check_solid(replace(EXPECTED, centre_mm=None), "OCCT", {**found, "centre_mm": [9.0, 9.0, 9.0]}).passed == (
        not says or "centre" in says
    )


def occurrences() -> dict[str, Any]:
    """As the reader has them: name, place, and the x and z axes."""
    angle = np.radians(ANGLES_DEG)
    rows = [
        [name, x, y, 0.0, np.cos(a), np.sin(a), 0.0, 0.0, 0.0, 1.0]
        for name, (x, y), a in zip(CPL.designators, CPL.xy_mm, angle, strict=True)
    ]
    (length, width, height), thick = TAPE.part.body_mm, TAPE.board.thickness_mm
    film = solid_volume_mm3(TAPE, SolidForm(base_mm=thick)) - TAPE.part_count * ELEMENT_MM3
    part = [ELEMENT_MM3, 0.0, 0.0, height / 2, -length / 2, -width / 2, 0.0, length / 2, width / 2, height]
    board = [film, *film_centre_mm(TAPE), 0.0, 0.0, -thick, *TAPE.board.size_mm, 0.0]
    return {
        "occurrences": [["board", 0, 0, 0, 1, 0, 0, 0, 0, 1], *rows],
        "products": {"a": [part], "b": [board]},
    }


def put(row: int, column: int, by: float) -> Change:
    def change(found: dict[str, Any]) -> None:
        found["occurrences"][row][column] += by

    return change


def of_product(name: str, column: int, by: float) -> Change:
    def change(found: dict[str, Any]) -> None:
        found["products"][name][0][column] += by

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda _: None, ""),
        (lambda found: found["occurrences"].reverse(), ""),
        (put(2, 1, 0.0009), ""),
        (put(2, 1, 0.002), "R2 is 2.00 um off its CPL row"),
        (put(3, 2, -0.002), "R3 is 2.00 um off its CPL row"),
        (put(3, 3, 0.003), "R3 is 3.00 um off its CPL row"),
        (put(4, 4, 2e-6), "R4 is turned otherwise"),
        (put(4, 5, -2e-6), "R4 is turned otherwise"),
        (put(5, 9, -2.0), "R5 is turned otherwise"),
        (put(5, 8, 1e-5), "R5 is turned otherwise"),
        (put(0, 2, 0.01), "the board does not lie at the origin"),
        (put(0, 9, -2.0), "the board does not lie at the origin"),
        (lambda found: found["occurrences"].pop(), "occurrences that differ from the CPL: R6"),
        (lambda found: found["occurrences"].pop(0), "occurrences that differ from the CPL: board"),
        (lambda found: found["occurrences"].append(["R9", *found["occurrences"][1][1:]]), "differ from the CPL: R9"),
        (lambda found: found["occurrences"].append(found["occurrences"][1]), "two occurrences have one name"),
        (lambda found: found["products"].pop("a"), "1 products with 1 solids, not a board and a part of one each"),
        (lambda found: found["products"]["a"].append(found["products"]["a"][0]), "2 products with 3 solids"),
        (lambda found: found["products"].update(c=[]), "3 products with 2 solids"),
        (of_product("a", 0, 1e-4), "no product has the part's"),
        (of_product("b", 0, 1e-2), "no product has the board's"),
        (of_product("a", 3, 0.001), "the part's centre of mass or its bounds are not"),
        (of_product("a", 6, -0.23), "the part's centre of mass or its bounds are not"),
        (of_product("b", 8, 0.001), "the board's centre of mass or its bounds are not"),
        (lambda found: found.update(error="no answer within 3 s"), "no answer within 3 s"),
    ],
)
def test_occurrences_are_those_of_the_cpl(change: Change, says: str) -> None:
    found = occurrences()
    change(found)
    said(_check_occurrences(TAPE, found, CPL), says)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda _: None, ""),
        (lambda rows: rows.reverse(), ""),
        (lambda rows: rows[1].__setitem__(0, rows[1][0] + 0.0009), ""),
        (lambda rows: rows[1].__setitem__(0, rows[1][0] + 0.002), "the centre of a solid is 2.00 um off its CPL row"),
        (lambda rows: rows[1].__setitem__(2, rows[1][2] - 0.002), "the centre of a solid is 2.00 um off its CPL row"),
        (lambda rows: rows[1].__setitem__(slice(0, 2), rows[2][:2]), "two solids are nearest to one row of the CPL"),
        (lambda rows: rows.pop(1), "6 solids, 5 of them parts, where a board and 6 parts should be"),
        (lambda rows: rows.pop(0), "6 solids, 6 of them parts, where a board and 6 parts should be"),
        (lambda rows: rows[1].__setitem__(3, ELEMENT_MM3 * 1.01), "7 solids, 5 of them parts"),
    ],
)
def test_centres_are_those_of_the_cpl(change: Callable[[list[list[float]]], object], says: str) -> None:
    height_mm = TAPE.part.body_mm[2]
    rows = [[5.0, 5.0, -0.05, 12.0], *([x, y, height_mm / 2, ELEMENT_MM3] for x, y in CPL.xy_mm.tolist())]
    change(rows)
    said(_check_centres(TAPE, rows, CPL), says)


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    paths = {role: tmp_path / role for role in ("stl", "3mf")}
    for path in paths.values():
        path.write_bytes(b"x" * 100)
    return paths


def ended(stdout: str, stderr: str = "", status: int = 0) -> subprocess.CompletedProcess[str]:
    return subprocess.CompletedProcess([], status, stdout, stderr)


INFO = "volume = 90.005\nmanifold = yes\nnumber_of_parts =  1\n"


@pytest.mark.parametrize(
    ("run", "says"),
    [
        (ended(INFO), ""),
        (ended(INFO.replace("90.005", "90.011")), "its volume is 90.011 mm3, not 90.000"),
        (ended(INFO.replace("90.005", "89.98")), "its volume is 89.980 mm3, not 90.000"),
        (ended(INFO.replace("yes", "no")), "it is not manifold"),
        (ended(INFO.replace("  1", "  2")), "2 parts instead of 1"),
        ("it took more than 5 s of processor time", "it took more than 5 s of processor time"),
    ],
)
def test_a_slicer_finds_one_closed_body(
    run: subprocess.CompletedProcess[str] | str, says: str, files: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(launch, "installed", lambda _: "slicer")
    monkeypatch.setattr(cad_readers, "_run", lambda *_: run)
    checks = _slicer(TAPE, EXPECTED, files, None)
    assert [check.name for check in checks] == ["stl by PrusaSlicer", "3mf by PrusaSlicer"]
    for check in checks:
        said(check, says)
    assert checks[0].passed == (checks[0].message == "manifold, 1 part, 90.005 mm3")


@pytest.mark.parametrize(
    ("found", "says"),
    [
        ((True, True, 1, 90.0099), ""),
        ((True, True, 1, 90.0101), "its volume is 90.010 mm3, not 90.000"),
        ((True, True, 1, float("nan")), "its volume is nan mm3, not 90.000"),
        ((False, True, 1, 90.0), "it is not watertight"),
        ((True, False, 1, 90.0), "neighbouring triangles face opposite ways"),
        ((True, True, 2, 90.0), "2 bodies instead of 1"),
    ],
)
def test_trimesh_finds_one_closed_body(
    found: tuple[bool, bool, int, float], says: str, files: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cad_readers, "_run", lambda *_: ended("ANSWER " + json.dumps({str(files["stl"]): found})))
    (check,) = _trimesh(TAPE, EXPECTED, files, None)
    said(check, says)
    monkeypatch.setattr(cad_readers, "_run", lambda *_: ended("", "Traceback\nValueError: no mesh", 1))
    (check,) = _trimesh(TAPE, EXPECTED, files, None)
    said(check, "it could not be read: ValueError: no mesh")


def test_answers_are_a_line_of_json_or_the_reason_why_there_is_none() -> None:
    assert _answer(ended('noise\nANSWER {"a": 1}\nnoise')) == {"a": 1}
    assert _answer("no answer within 3 s") == {"error": "no answer within 3 s"}
    assert _answer(ended("", "one\ntwo\n", 1)) == {"error": "it could not be read: two"}
    assert _answer(ended("", "", 3)) == {"error": "it could not be read: exit status 3"}
    assert len(_answer(ended("", "x" * 999, 3))["error"]) < 250


def test_limits_grow_with_the_files(tmp_path: Path) -> None:
    small, large = tmp_path / "small", tmp_path / "large"
    small.write_bytes(b"x")
    large.write_bytes(b"x" * 3_000_000)
    assert _limits([small]) == (CPU_S, MEMORY_BYTES + MEMORY_PER_BYTE)
    assert _limits([small], own=True)[0] == CPU_S_OF_OWN
    assert _limits([large, small]) == (CPU_S * 3.000001, MEMORY_BYTES + MEMORY_PER_BYTE * 3_000_001)


def test_a_program_that_does_not_end_or_does_not_start_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(error: Exception) -> Callable[..., object]:
        def run(*_: object, **__: object) -> object:
            raise error

        return run

    monkeypatch.setattr(launch, "run", fails(subprocess.TimeoutExpired("x", 1.0)))
    assert _run(["x"], (5.0, 1 << 30)) == "no answer within 1800 s"
    monkeypatch.setattr(launch, "run", fails(OSError("no such program")))
    assert _run(["x"], (5.0, 1 << 30)) == "no such program"
    seen: list[object] = []

    def limited(arguments: list[str], **limits: float) -> list[str]:
        seen.append(limits)
        return arguments

    monkeypatch.setattr(launch, "limited", limited)
    monkeypatch.setattr(launch, "run", lambda *_, **__: ended("x"))
    monkeypatch.setattr(launch, "too_long", lambda _: False)
    done = _run(["x"], (5.5, 7))
    assert isinstance(done, subprocess.CompletedProcess) and done.stdout == "x"
    assert seen == [{"cpu_s": 11, "memory_bytes": 7}]
    monkeypatch.setattr(launch, "too_long", lambda _: True)
    assert str(_run(["x"], (5.5, 7))).startswith("it took more than 6 s of processor time")


def test_lines_of_readers_are_told_in_their_order() -> None:
    told: list[tuple[str, int, int]] = []
    runs = []
    for name in ("A", "B"):
        future = Future[list[Check]]()
        future.set_result([Check(name=name, passed=True, message="")])
        runs.append((name, future))
    assert [check.name for check in _lines(runs, lambda *words: told.append(words))] == ["A", "B"]
    assert told == [("models read by A: reader", 0, 2), ("models read by B: reader", 1, 2)]


def line(name: str, passed: bool = True) -> list[Check]:
    return [Check(name=name, passed=passed, message="")]


@pytest.mark.parametrize(("passed", "names"), [(True, ["FreeCAD", "OCCT"]), (False, ["OCCT"])])
def test_freecad_reads_what_others_write_only_where_occt_finds_nothing(
    passed: bool, names: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files of which nobody knows whether a kernel ends: the same entities as ours, or none is asked."""
    own = solid_step(TAPE, SolidForm(), name="t", date=DATE, rgb=(0.2, 0.4, 0.6))
    path = tmp_path / "solid.step"
    path.write_bytes(own)
    paths, steps = {"step-solid": path}, {"step-solid": step_text(own)}
    expected = replace(EXPECTED, steps=steps)
    assert _is_own(expected, paths) and not _is_own(EXPECTED, paths)
    path.write_bytes(own.replace(b"(0.,0.,0.23)", b"(0.,0.,0.24)"))
    assert not _is_own(expected, paths)
    monkeypatch.setattr(cad_readers, "_occt", lambda *_: line("OCCT", passed))
    monkeypatch.setattr(cad_readers, "_freecad", lambda *_: line("FreeCAD"))
    assert [check.name for check in _kernels(TAPE, expected, paths, None)] == names
    path.write_bytes(own.replace(b"PLANE(", b"SPHERICAL_SURFACE(", 1))
    (check,) = _kernels(TAPE, expected, paths, None)
    assert check.name == "step-solid by CAD kernels" and check.message.startswith("not given to one: ") and not check.passed


def test_a_reader_that_is_missing_or_says_nothing_is_said(files: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    assert cad_readers._occt(TAPE, EXPECTED, files, None) == cad_readers._freecad(TAPE, EXPECTED, files, None) == []
    paths = {"step-solid": files["stl"], "step-assembly": files["3mf"]}
    monkeypatch.setattr(cad_readers, "find_spec", lambda _: None)
    (check,) = cad_readers._occt(TAPE, EXPECTED, paths, CPL)
    assert check.warning and check.skipped and check.message.endswith('pip install "tactape-fab[cad]"')
    monkeypatch.setattr(launch, "installed", lambda _: None)
    (check,) = cad_readers._freecad(TAPE, EXPECTED, paths, CPL)
    assert check.skipped and check.message.startswith("FreeCAD is not installed")
    monkeypatch.setattr(launch, "installed", lambda _: "freecad")
    monkeypatch.setattr(cad_readers, "_run", lambda *_: ended("", "warning\nno such shape", 1))
    (check,) = cad_readers._freecad(TAPE, EXPECTED, paths, CPL)
    said(check, "it could not be read: no such shape")


def test_readers_are_given_both_files_and_each_answer_is_a_line(files: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    paths = {"step-solid": files["stl"], "step-assembly": files["3mf"]}
    solid = {"solids": 1, "faces": 36, "valid": True, "volume_mm3": VOLUME_MM3 * (1 + 5e-5), "centre_mm": None}
    rows = [[5.0, 5.0, -0.05, 12.0], *([x, y, TAPE.part.body_mm[2] / 2, ELEMENT_MM3] for x, y in CPL.xy_mm.tolist())]
    monkeypatch.setattr(cad_readers, "find_spec", lambda _: True)
    monkeypatch.setattr(launch, "installed", lambda _: "freecad")

    def run(arguments: list[str], _limits: object, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
        if folder is None:
            assert str(files["stl"]) in arguments and str(files["3mf"]) in arguments
            return ended("ANSWER " + json.dumps({"solid": solid, "assembly": occurrences()}))
        script = Path(arguments[1]).read_text()
        assert str(files["stl"]) in script and str(files["3mf"]) in script
        (folder / "answer.json").write_text(json.dumps({"solid": solid, "assembly": {"centres": rows}}))
        return ended("")

    monkeypatch.setattr(cad_readers, "_run", run)
    occt, freecad = (read(TAPE, EXPECTED, paths, CPL) for read in (cad_readers._occt, cad_readers._freecad))
    # FreeCAD computes with the file's own precision, and may be farther off
    assert [(check.name, check.passed) for check in occt] == [("step-solid by OCCT", False), ("step-assembly by OCCT", True)]
    assert [(check.name, check.passed) for check in freecad] == [
        ("step-solid by FreeCAD", True),
        ("step-assembly by FreeCAD", True),
    ]
    # without rows to compare with the assembly has no line
    assert [len(read(TAPE, EXPECTED, paths, None)) for read in (cad_readers._occt, cad_readers._freecad)] == [1, 1]
