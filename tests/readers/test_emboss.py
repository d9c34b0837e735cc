"""Embossed parts opened by PrusaSlicer and FreeCAD: closed, one body, the right volume."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tactape_fab.make.emboss import Embossed, emboss_kit
from tactape_fab.solids.surface.charts import Placement
from tests.readers.solids import slicer_info
from tests.surfaces import ball, box, kit_folder, planned, saddle, step_file
from tests.thorough import slow


@pytest.mark.parametrize("kind", ["stl", "3mf"])
@pytest.mark.parametrize("surface", ["ball", "large patch on a ball", "saddle", "box"])
def test_slicer_takes_embossed_meshes(prusa_slicer: str, tmp_path: Path, surface: str, kind: str) -> None:
    models: dict[str, Any] = {"saddle": saddle, "box": box}
    model = models.get(surface, ball)()
    tape = planned((24.0, 24.0) if surface.startswith("large") else (12.0, 12.0))
    model.export(tmp_path / "part.stl")
    made = emboss_kit(kit_folder(tmp_path / "kit", tape), tmp_path / "part.stl")
    info = slicer_info(prusa_slicer, str(made.path / made.files[kind]))
    assert (info["manifold"], info["number_of_parts"]) == ("yes", "1")
    assert float(info["volume"]) == pytest.approx(made.surface["volume_mm3"], rel=1e-5)


FREECAD_SCRIPT = """
import Part
shape = Part.Shape()
shape.read({path!r})
solid = shape.Solids[0]
print("RESULT", len(shape.Solids), len(shape.Faces), solid.isValid(), solid.isClosed(), repr(solid.Volume))
"""


def freecad_reads(freecad: str, made: Embossed, folder: Path) -> list[str]:
    script = folder / "read.py"
    script.write_text(FREECAD_SCRIPT.format(path=str(made.path / made.files["step-solid"])))
    run = subprocess.run([freecad, str(script)], capture_output=True, encoding="utf-8", check=False, timeout=300, cwd=folder)
    found = re.search(r"^RESULT (.*)$", run.stdout, re.MULTILINE)
    assert found, run.stdout + run.stderr
    return found[1].split()


@slow
@pytest.mark.parametrize("surface", ["plane", "cylinder", "cone"])
def test_freecad_and_slicer_take_embossed_steps(freecad: str, prusa_slicer: str, tmp_path: Path, surface: str) -> None:
    import build123d as bd

    host, placement = {
        "plane": (bd.Solid.make_box(30, 30, 5), Placement(face=5)),
        "cylinder": (bd.Solid.make_cylinder(16, 40), Placement(face=0)),
        "cone": (bd.Solid.make_cone(20, 10, 40), Placement(at_mm=(15.0, 0.0, 20.0))),
    }[surface]
    tape = planned((12.0, 12.0))
    made = emboss_kit(kit_folder(tmp_path / "kit", tape), step_file(tmp_path / "part.step", host), placement=placement)
    solids, faces, valid, closed, volume = freecad_reads(freecad, made, tmp_path)
    assert (solids, faces, valid, closed) == ("1", str(len(host.faces()) + 5 * tape.part_count), "True", "True")
    assert float(volume) == pytest.approx(bd.import_step(made.path / made.files["step-solid"]).volume, rel=1e-7)
    assert float(volume) == pytest.approx(made.surface["volume_mm3"], rel=3e-4)
    info = slicer_info(prusa_slicer, str(made.path / made.files["stl"]))
    assert (info["manifold"], info["number_of_parts"]) == ("yes", "1")
