"""The KiCad position file, line by line as KiCad's own exporter writes it for the same parts."""

from __future__ import annotations

import json
import os
import subprocess

import pytest

from tactape_fab import TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.render.cpl_bom import render_cpl

EXPORT = """
import json, sys
import pcbnew
board = pcbnew.BOARD()
for name, value, package, x_mm, y_mm, rotation_deg in json.load(sys.stdin):
    part = pcbnew.FOOTPRINT(board)
    part.SetReference(name)
    part.SetValue(value)
    part.SetFPID(pcbnew.LIB_ID("Resistor_SMD", package))
    part.SetAttributes(pcbnew.FP_SMD)
    part.SetPosition(pcbnew.wxPointMM(x_mm, -y_mm))
    part.SetOrientation(round(rotation_deg * 10))
    board.Add(part)
sys.stdout.write(pcbnew.PLACE_FILE_EXPORTER(board, True, True, False, True, False, False, True).GenPositionData())
"""


@pytest.mark.parametrize("rotation_deg", [45.0, 0.0, 180.0, 225.0, 359.9])
def test_kicad_writes_the_same_lines(rotation_deg: float, kicad_python: str) -> None:
    spec = TapeSpec(
        sector=7,
        size_mm=(40.0, 30.0),
        pitch_mm=2.2,
        displacement_mm=0.1,
        assembly="kicad",
        rotation_deg=rotation_deg,
        models=False,
    )
    examined = examine(spec)
    (artifact,) = render_cpl(examined.drawing, examined.fab)
    lines = artifact.data.decode("ascii").splitlines()
    part, xy_mm = examined.layout.part, examined.layout.parts_xy_mm.tolist()
    parts = [[f"R{i}", part.value, part.footprint, x, y, rotation_deg] for i, (x, y) in enumerate(xy_mm, start=1)]
    environment = {**os.environ, "PYTHONPATH": ""}
    run = subprocess.run(
        [kicad_python, "-c", EXPORT], input=json.dumps(parts), capture_output=True, encoding="utf-8", check=True, env=environment
    )
    kicad = run.stdout.splitlines()
    assert len(lines) == len(xy_mm) + 6
    assert lines[2:5] == kicad[2:5]
    assert sorted(lines[5:]) == sorted(line for line in kicad[5:] if line)
