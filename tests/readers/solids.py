"""Every kind of solid on a small tape, written once, and read by kernels and slicers in processes of their own."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mesh.sheet import texture_mesh
from tactape_fab.solids.mesh.triangles import Mesh, stl_bytes, threemf_bytes
from tactape_fab.solids.step.assembly import assembly_step
from tactape_fab.texture.tape import Tape
from tests.solids import BLOCK, DATE, FORMS, PARTS, step_of, tape_of

HOLES_MM = [(5.3, 5.2, 0.9), (9.6, 3.0, 0.7)]
NAMES = [f"{part} {form}" for part in PARTS for form in FORMS]
ASSEMBLY_RGB = {"board": (0.8, 0.5, 0.1), "part": (0.1, 0.2, 0.3)}
_OCCT = """
import json, sys
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.GProp import GProp_GProps
from OCP.STEPControl import STEPControl_Reader
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer

def count(shape, kind):
    explorer, found = TopExp_Explorer(shape, kind), 0
    while explorer.More():
        found += 1
        explorer.Next()
    return found

answer = {}
for path in sys.argv[1:]:
    reader = STEPControl_Reader()
    reader.ReadFile(path)
    reader.TransferRoots()
    shape = reader.OneShape()
    mass = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, mass, 1e-9)
    middle = mass.CentreOfMass()
    answer[path] = {
        "solids": count(shape, TopAbs_ShapeEnum.TopAbs_SOLID),
        "faces": count(shape, TopAbs_ShapeEnum.TopAbs_FACE),
        "valid": bool(BRepCheck_Analyzer(shape).IsValid()),
        "volume_mm3": mass.Mass(),
        "centre_mm": [middle.X(), middle.Y(), middle.Z()],
    }
print("ANSWER " + json.dumps(answer))
"""
_FREECAD = """
import json
import Part
answer = {{}}
for path in {paths!r}:
    shape = Part.Shape()
    shape.read(path)
    answer[path] = {{
        "solids": len(shape.Solids), "faces": len(shape.Faces), "valid": bool(shape.isValid()),
        "volume_mm3": sum(solid.Volume for solid in shape.Solids),
        "centres": [list(solid.CenterOfMass) + [solid.Volume] for solid in shape.Solids],
    }}
with open({answer!r}, "w") as stream:
    json.dump(answer, stream)
"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Variant:
    """A tape's solid in its three files; of an assembly there is STEP alone."""

    tape: Tape
    form: SolidForm
    mesh: Mesh
    folder: Path

    def path(self, ending: str) -> str:
        return str(self.folder / f"tape.{ending}")

    @property
    def step(self) -> bytes:
        return Path(self.path("step")).read_bytes()


def write_variant(name: str, folder: Path) -> Variant:
    """A tape of 7 x 5 cells, one of them empty, on two tiles; flat ones have two holes."""
    part, _, form_name = name.partition(" ")
    form = FORMS[form_name]
    holes = HOLES_MM if form.cylinder is None else []
    tape = tape_of(PARTS[part], 7, 5, holes_mm=holes, omitted=[(2, 4)])
    return written(tape, form, folder / name.replace(" ", "-"))


def written(tape: Tape, form: SolidForm, folder: Path) -> Variant:
    folder.mkdir()
    mesh = texture_mesh(tape, form)
    variant = Variant(tape=tape, form=form, mesh=mesh, folder=folder)
    Path(variant.path("step")).write_bytes(step_of(tape, form))
    Path(variant.path("stl")).write_bytes(stl_bytes(mesh, "t"))
    Path(variant.path("3mf")).write_bytes(threemf_bytes(mesh, "t", {}, DATE))
    return variant


def assembly_tape() -> Tape:
    return tape_of(BLOCK, 12, 10, holes_mm=HOLES_MM, radius_mm=2.0)


def write_assembly(path: Path) -> Tape:
    tape = assembly_tape()
    board_rgb, part_rgb = ASSEMBLY_RGB["board"], ASSEMBLY_RGB["part"]
    path.write_bytes(assembly_step(tape, name="tape", date=DATE, board_rgb=board_rgb, part_rgb=part_rgb))
    return tape


def read_with_occt(paths: Sequence[str]) -> dict[str, dict[str, Any]]:
    run = subprocess.run([sys.executable, "-c", _OCCT, *paths], capture_output=True, encoding="utf-8", check=True)
    found = re.search(r"^ANSWER (.*)$", run.stdout, re.MULTILINE)
    assert found is not None, run.stdout[-2000:]
    answer: dict[str, dict[str, Any]] = json.loads(found[1])
    return answer


def read_with_freecad(program: str, paths: Sequence[str], folder: Path) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = answer_of_freecad(program, _FREECAD, folder, paths=list(paths))
    return found


def answer_of_freecad(program: str, script: str, folder: Path, **values: object) -> Any:
    """What a script for FreeCAD writes as JSON to the file {answer}."""
    file, answer = folder / "read.py", folder / "answer.json"
    file.write_text(script.format(answer=str(answer), **values), encoding="utf-8")
    run = subprocess.run([program, str(file)], capture_output=True, encoding="utf-8", check=False, stdin=subprocess.DEVNULL)
    assert answer.exists(), run.stdout[-2000:] + run.stderr[-2000:]
    return json.loads(answer.read_bytes())


def slicer_info(program: str, path: str) -> dict[str, str]:
    """What `prusa-slicer --info` says of a file: a value for each key."""
    run = subprocess.run([program, "--info", path], capture_output=True, encoding="utf-8", check=True, timeout=120)
    return dict(re.findall(r"^(\w+) =\s*(\S+)", run.stdout, re.MULTILINE))
