"""STEP files read by OCCT, the kernel behind build123d, CadQuery and FreeCAD, in a process of its own."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab import TapeSpec, make_kit
from tactape_fab.solids.elements import CHORD_ERROR_MM
from tactape_fab.texture.tape import Tape
from tests.readers.solids import ASSEMBLY_RGB, NAMES, Variant, read_with_occt, write_assembly
from tests.solids import centre_mm, volume_mm3
from tests.thorough import slow

_READ_ASSEMBLY = """
import json, sys
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.GProp import GProp_GProps
from OCP.Quantity import Quantity_Color
from OCP.STEPCAFControl import STEPCAFControl_Reader
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDF import TDF_ChildIterator, TDF_Label
from OCP.TDocStd import TDocStd_Document
from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool, XCAFDoc_ShapeTool

document = TDocStd_Document(TCollection_ExtendedString("XmlOcaf"))
reader = STEPCAFControl_Reader()
reader.SetNameMode(True)
reader.SetColorMode(True)
reader.ReadFile(sys.argv[1])
assert reader.Transfer(document)
shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
colours = XCAFDoc_DocumentTool.ColorTool_s(document.Main())

def name_of(label):
    found = TDataStd_Name()
    return found.Get().ToExtString() if label.FindAttribute(TDataStd_Name.GetID_s(), found) else ""

def colour_of(shape):
    colour = Quantity_Color()
    for kind in (XCAFDoc_ColorType.XCAFDoc_ColorSurf, XCAFDoc_ColorType.XCAFDoc_ColorGen):
        if colours.GetColor(shape, kind, colour):
            return [colour.Red(), colour.Green(), colour.Blue()]

def children(label):
    iterator = TDF_ChildIterator(label)
    while iterator.More():
        yield iterator.Value()
        iterator.Next()

(whole,) = [label for label in children(shapes.Label()) if XCAFDoc_ShapeTool.IsAssembly_s(label)]
occurrences, products = [], {}
for label in children(whole):
    if not XCAFDoc_ShapeTool.IsComponent_s(label):
        continue
    move = XCAFDoc_ShapeTool.GetLocation_s(label).Transformation()
    matrix = [[move.Value(r, c) for c in range(1, 5)] for r in range(1, 4)]
    product = TDF_Label()
    XCAFDoc_ShapeTool.GetReferredShape_s(label, product)
    shape = XCAFDoc_ShapeTool.GetShape_s(product)
    mass = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, mass, 1e-9)
    middle = mass.CentreOfMass()
    occurrences.append([name_of(label), name_of(product), matrix])
    products[name_of(product)] = {
        "volume_mm3": mass.Mass(), "centre_mm": [middle.X(), middle.Y(), middle.Z()],
        "valid": BRepCheck_Analyzer(shape).IsValid(), "colour": colour_of(shape),
    }
print("ANSWER " + json.dumps([name_of(whole), occurrences, products]))
"""


@pytest.fixture(scope="module")
def readings(solid_variants: dict[str, Variant]) -> dict[str, dict[str, Any]]:
    found = read_with_occt([variant.path("step") for variant in solid_variants.values()])
    return {name: found[variant.path("step")] for name, variant in solid_variants.items()}


@pytest.mark.parametrize("name", NAMES)
def test_occt_reads_one_valid_solid(name: str, solid_variants: dict[str, Variant], readings: dict[str, Any]) -> None:
    variant, found = solid_variants[name], readings[name]
    assert (found["solids"], found["valid"]) == (1, True)
    assert found["faces"] == variant.step.count(b"=ADVANCED_FACE(")
    assert found["volume_mm3"] == pytest.approx(volume_mm3(variant.tape, variant.form), rel=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_occt_finds_the_centre_of_mass_where_it_should_be(
    name: str, solid_variants: dict[str, Variant], readings: dict[str, Any]
) -> None:
    """A side that is tilted a little passes every other test."""
    variant = solid_variants[name]
    exact = centre_mm(variant.tape, variant.form)
    a, b, c = np.moveaxis(variant.mesh.corners_mm, 1, 0)
    shares = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    of_mesh = shares @ (a + b + c) / 4 / shares.sum()
    # a mesh cuts off what its chords do, which leaves 2 um with CHORD_ERROR_MM
    assert np.abs(np.array(readings[name]["centre_mm"]) - of_mesh).max() < 0.3 * CHORD_ERROR_MM
    if exact is not None:
        assert np.abs(np.array(readings[name]["centre_mm"]) - exact).max() < 1e-7


@pytest.fixture(scope="module")
def assembly(tmp_path_factory: pytest.TempPathFactory) -> tuple[Tape, Any]:
    path = tmp_path_factory.mktemp("assembly") / "tape.step"
    tape = write_assembly(path)
    run = subprocess.run([sys.executable, "-c", _READ_ASSEMBLY, str(path)], capture_output=True, encoding="utf-8", check=True)
    found = re.search(r"^ANSWER (.*)$", run.stdout, re.MULTILINE)
    assert found is not None
    return tape, json.loads(found[1])


def test_occt_reads_an_occurrence_for_every_designator(assembly: tuple[Tape, Any]) -> None:
    tape, (name, occurrences, products) = assembly
    assert name == "tape"
    assert products.keys() == {"tape-board", "BLOCK"}
    assert [row[0] for row in occurrences] == ["board", *tape.designators()]
    assert [row[1] for row in occurrences] == ["tape-board"] + ["BLOCK"] * tape.part_count


def test_occt_finds_every_occurrence_in_its_place(assembly: tuple[Tape, Any]) -> None:
    tape, (_, occurrences, _) = assembly
    moves = np.array([row[2] for row in occurrences])
    assert np.abs(moves[0] - np.eye(3, 4)).max() == 0.0
    c, s = np.cos(np.pi / 4), np.sin(np.pi / 4)
    turn = np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])
    assert np.abs(moves[1:, :, :3] - turn).max() < 1e-12
    assert np.abs(moves[1:, :2, 3] - tape.part_xy_mm()).max() < 1e-9
    assert np.abs(moves[1:, 2, 3]).max() == 0.0


def test_occt_finds_the_two_products_coloured_and_exact(assembly: tuple[Tape, Any]) -> None:
    tape, (_, _, products) = assembly
    board, part = products["tape-board"], products["BLOCK"]
    assert board["valid"]
    assert part["valid"]
    assert part["volume_mm3"] == pytest.approx(0.6 * 0.3 * 0.23, rel=1e-9)
    assert part["centre_mm"] == pytest.approx([0.0, 0.0, 0.115], abs=1e-9)
    (w, h), r = tape.board.size_mm, tape.board.corner_radius_mm
    holes = np.array(tape.board.holes)
    full, gone = w * h - (4 - np.pi) * r * r, np.pi / 4 * holes[:, 2] ** 2
    assert board["volume_mm3"] == pytest.approx(float(full - gone.sum()) * 0.11, rel=1e-8)
    middle = (full * np.array([w, h]) / 2 - gone @ holes[:, :2]) / (full - gone.sum())
    assert board["centre_mm"] == pytest.approx([*middle.tolist(), -0.055], abs=1e-7)
    for product, expected in ((board, "board"), (part, "part")):  # OCCT keeps colours as 32 bit floats, linear
        linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in ASSEMBLY_RGB[expected]]
        assert product["colour"] == pytest.approx(linear, abs=1e-4)


@slow
def test_large_tapes_of_blocks_round_a_cylinder_have_their_volume(tmp_path: Path) -> None:
    """By the file's own precision OCCT finds 1.5e-7 more or less, and 1e-6 at 150 x 80 mm."""
    spec = TapeSpec(sector=7, part="block", size_mm=(40.0, 34.0), cylinder_mm=36.0, around="x", mark=False)
    kit = make_kit(spec, tmp_path / "kit", verify=False)
    code = "import sys; from tactape_fab.verify.models.occt_reader import read_shape; print(read_shape(sys.argv[1]))"
    step = str(kit.path / kit.files["step-solid"])
    run = subprocess.run([sys.executable, "-c", code, step], capture_output=True, encoding="utf-8", check=True)
    found = ast.literal_eval(run.stdout.splitlines()[-1])
    assert spec.form is not None
    assert found["valid"] and found["volume_mm3"] == pytest.approx(volume_mm3(kit.tape, spec.form), rel=1e-8)


def test_a_file_that_is_no_step_gives_no_solid(tmp_path: Path) -> None:
    """What the mutation tests of verify build on: the reader itself survives."""
    (tmp_path / "x.step").write_bytes(b"ISO-10303-21;\nHEADER;\n" + b"garbage;" * 100)
    run = subprocess.run(
        [sys.executable, "-m", "tactape_fab.verify.models.occt_reader", str(tmp_path / "x.step"), "-"],
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    found = re.search(r"^ANSWER (.*)$", run.stdout, re.MULTILINE)
    assert found is None or "error" in json.loads(found[1])["solid"]
    assert "Traceback" not in run.stderr
