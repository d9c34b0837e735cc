"""Untrusted STEP files: counted before a CAD kernel sees them, and given to it for a short time only."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path

import pytest

from tactape_fab.base.errors import Check
from tactape_fab.solids.forms import Cylinder, SolidForm
from tactape_fab.solids.step.assembly import assembly_step
from tactape_fab.solids.step.solid import solid_step
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.models import cad_readers
from tactape_fab.verify.models import step_text as step_text_module
from tactape_fab.verify.models.expected import Expected, expected_of_kit
from tactape_fab.verify.models.step_text import foreign_entities, shell_problems, step_problems, step_text, written_steps
from tests.surfaces import planned

Change = Callable[[bytes], bytes]
TAPE, FORM = planned(), SolidForm()
DATE, RGB = datetime(2026, 5, 4, tzinfo=timezone.utc), (0.25, 0.5, 0.125)
SOLID = solid_step(TAPE, FORM, name=TAPE.name, date=DATE, rgb=RGB)
ASSEMBLY = assembly_step(TAPE, name=TAPE.name, date=DATE, board_rgb=RGB, part_rgb=RGB)


def files_of(**data: bytes) -> dict[str, WrittenFile]:
    return {role.replace("_", "-"): WrittenFile(path=f"models/{role}.step", data=text) for role, text in data.items()}


def expected_of(files: dict[str, WrittenFile]) -> Expected:
    return expected_of_kit(TAPE, FORM, files)


def written(folder: Path, files: dict[str, WrittenFile]) -> dict[str, Path]:
    paths = {role: folder / f"{role}.step" for role in files}
    for role, path in paths.items():
        path.write_bytes(files[role].data)
    return paths


@pytest.mark.parametrize(
    "form", [FORM, SolidForm(negative=True), SolidForm(cylinder=Cylinder(radius_mm=30.0, around="x", shell="segment"))]
)
def test_what_this_version_writes_is_known_whatever_its_date_and_colour(form: SolidForm) -> None:
    title = f"{TAPE.name} mould" if form.negative else TAPE.name
    data = solid_step(TAPE, form, name=title, date=DATE, rgb=RGB)
    own = written_steps(TAPE, form, files_of(step_assembly=ASSEMBLY))
    assert step_text(data) == own["step-solid"]
    assert step_text(ASSEMBLY) == own["step-assembly"]


def swap(old: bytes, new: bytes) -> Change:
    def change(data: bytes) -> bytes:
        assert old in data
        return data.replace(old, new, 1)

    return change


STRANGE: dict[str, tuple[Change, str]] = {
    "a spline": (swap(b"=PLANE(", b"=B_SPLINE_SURFACE_WITH_KNOTS("), "1 of B_SPLINE_SURFACE_WITH_KNOTS"),
    "in small letters": (swap(b"=PLANE(", b"=toroidal_surface("), "1 of TOROIDAL_SURFACE"),
    "with a space": (swap(b"=PLANE(", b"=OFFSET_SURFACE \n("), "1 of OFFSET_SURFACE"),
    "behind a comment": (swap(b"=PLANE(", b"=OFFSET_SURFACE/**/("), "comments"),
    "of several kinds": (swap(b"=PLANE(", b"=(BOUNDED_SURFACE()PLANE("), "1 of BOUNDED_SURFACE"),
    "another file": (swap(b"DATA;\n", b"DATA;\n#1=EXTERNALLY_DEFINED_ITEM('',#2);\n"), "EXTERNALLY_DEFINED_ITEM"),
    "many faces": (swap(b"DATA;\n", b"DATA;\n" + b"#1=ADVANCED_FACE('',(#2),#3,.T.);\n" * 5000), "of ADVANCED_FACE"),
    "many solids": (swap(b"DATA;\n", b"DATA;\n" + b"#1=MANIFOLD_SOLID_BREP('',#2);\n" * 100), "of MANIFOLD_SOLID_BREP"),
    "a long header": (swap(b"HEADER;\n", b"HEADER;\n" + b"A();" * 1000), "a long header"),
    "Arabic digits": (swap(b"#10=", "#1\u0660=".encode()), "beyond ASCII"),
    "no data": (swap(b"\nDATA;\n", b"\nDATA ;\n"), "a long header"),
}


@pytest.mark.parametrize(("change", "says"), STRANGE.values(), ids=STRANGE.keys())
def test_a_strange_file_is_given_to_no_kernel(change: Change, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for reader in ("_occt", "_freecad"):
        monkeypatch.setattr(cad_readers, reader, lambda *_: pytest.fail("a kernel was started"))
    files = files_of(step_solid=change(SOLID))
    (check,) = cad_readers._kernels(TAPE, expected_of(files), written(tmp_path, files), None)
    assert not check.passed and says in check.message


def test_what_another_version_may_write_is_read() -> None:
    """Some more of each kind, other numbers."""
    own = step_text(SOLID)
    for change in (
        swap(b"DATA;\n", b"DATA;\n" + b"#1=PLANE('',#2);\n" * 40),
        swap(b"CARTESIAN_POINT('',(", b"CARTESIAN_POINT('',(1"),
    ):
        other = step_text(change(SOLID))
        assert other.digest != own.digest and foreign_entities(other, own) is None


OTHERWISE: dict[str, tuple[Change, str]] = {
    "as it is": (lambda data: data, ""),
    "at the limit": (swap(b"(1.E-06)", b"(1.E-05)"), ""),
    "uncertain": (swap(b"(1.E-06)", b"(2.E-05)"), "its points are uncertain by 2e-05 mm, more than 1e-05 mm"),
    "in centimetres": (swap(b".MILLI.", b".CENTI."), "a unit of it is no millimetre, radian or steradian: "),
    "in metres": (swap(b".MILLI.", b"$"), "SI_UNIT($,.METRE.)"),
    "in the unit behind a space": (swap(b"LENGTH_UNIT()", b"LENGTH_UNIT ( )"), ""),
    "without ends of lines": (lambda data: data.replace(b"\n", b""), ""),
    "without the radian": (swap(b"((#5,#6,#7))", b"((#5,#7))"), "it has shapes whose units are not the millimetre"),
    "without uncertainty": (swap(b"_ASSIGNED_CONTEXT((#8))", b"_ASSIGNED_CONTEXT((#7))"), "it has shapes whose units are not"),
    "in a context without units": (swap(b",#387),#9)", b",#387),#10)"), "it has shapes whose units are not the millimetre"),
    "shown by none": (swap(b",#387),#9)", b"),#9)"), "its solids are not each shown once"),
    "shown twice": (swap(b",#387),#9)", b",#387,#387),#9)"), "its solids are not each shown once"),
    "without a solid": (swap(b"=MANIFOLD_SOLID_BREP(", b"=FACETED_BREP("), "its solids are not each shown once"),
    "with a second solid": (swap(b"DATA;\n", b"DATA;\n#1=BREP_WITH_VOIDS('',#386,());\n"), "its solids are not each shown"),
    "with a comment": (swap(b"DATA;\n", b"DATA;\n/* */"), "it has a comment"),
    "cut off": (lambda data: data[:-9], "it is no whole ISO 10303-21 file"),
    "begun late": (lambda data: data[1:], "it is no whole ISO 10303-21 file"),
}


@pytest.mark.parametrize(("change", "says"), OTHERWISE.values(), ids=OTHERWISE.keys())
def test_units_and_solids_of_a_file_are_read(change: Change, says: str) -> None:
    said = step_problems(change(SOLID))
    assert bool(said) == bool(says) and says in "".join(said)


def test_a_user_s_part_may_be_less_certain() -> None:
    assert step_problems(swap(b"(1.E-06)", b"(0.1)")(SOLID), 0.1) == []


@pytest.mark.parametrize("at_once", [1, 5_000])
@pytest.mark.parametrize("data", [SOLID, ASSEMBLY], ids=["solid", "assembly"])
def test_shells_are_read_piece_by_piece(data: bytes, at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(step_text_module, "_AT_ONCE", at_once)
    assert list(shell_problems(data)) == []
    other = swap(b"=ORIENTED_EDGE('',*,*,#", b"=ORIENTED_EDGE('',*,*,#9")(data)
    assert list(shell_problems(other)) == ["an edge is not used once in each direction"]


def test_freecad_is_given_what_occt_finds_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = files_of(step_solid=SOLID + b" ")
    expected, paths = expected_of(files), written(tmp_path, files)
    line = Check(name="step-solid by OCCT", passed=True, message="")
    for found, count in ((line, 2), (replace(line, passed=False), 1), (replace(line, passed=False, warning=True), 2)):
        monkeypatch.setattr(cad_readers, "_occt", lambda *_, found=found: [found])
        monkeypatch.setattr(cad_readers, "_freecad", lambda *_: [line])
        assert len(cad_readers._kernels(TAPE, expected, paths, None)) == count


def test_files_of_this_version_have_more_time(tmp_path: Path) -> None:
    files = files_of(step_solid=SOLID, step_assembly=ASSEMBLY)
    expected, paths = expected_of(files), written(tmp_path, files)
    assert cad_readers._is_own(expected, paths)
    paths["step-assembly"].write_bytes(ASSEMBLY.replace(b"0.23", b"0.24", 1))
    assert not cad_readers._is_own(expected, paths)
    small, large = tmp_path / "small", tmp_path / "large"
    small.write_bytes(b"")
    large.write_bytes(bytes(3_000_000))
    limits = [cad_readers._limits([path], own=own)[0] for path in (small, large) for own in (False, True)]
    assert limits == [5.0, 30.0, 15.0, 90.0]


def test_a_reader_out_of_time_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cad_readers, "_LOADED_S", 0)
    said = cad_readers._run([sys.executable, "-S", "-c", "while 1: pass"], (1.0, 1 << 30))
    assert isinstance(said, str) and "1 s of processor time" in said and "verify --quick" in said
