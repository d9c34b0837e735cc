"""The drawing's DXF, opened by FreeCAD: its own reader, without ezdxf."""

from __future__ import annotations

from pathlib import Path

import pytest

from tactape_fab import Kit, Tape
from tests.readers.solids import answer_of_freecad

_FREECAD = """
import json
import FreeCAD, importDXF
FreeCAD.ParamGet("User parameter:BaseApp/Preferences/Mod/Draft").SetBool("dxfUseLegacyImporter", False)
FreeCAD.ParamGet("User parameter:BaseApp/Preferences/Mod/Draft").SetBool("dxfAllowDownload", False)
document = FreeCAD.newDocument("d")
import Import
Import.readDXF({path!r}, document.Name)
document.recompute()
shapes = [o.Shape for o in document.Objects if hasattr(o, "Shape")]
boxes = [(s.BoundBox.XMin, s.BoundBox.YMin, s.BoundBox.XMax, s.BoundBox.YMax) for s in shapes if s.Edges]
with open({answer!r}, "w") as stream:
    json.dump(boxes, stream)
"""


def test_freecad_reads_the_outline_and_the_field_in_millimetres(small_kit: Kit, tmp_path: Path, freecad: str) -> None:
    boxes = answer_of_freecad(freecad, _FREECAD, tmp_path, path=str(small_kit.path / small_kit.files["fab-dxf"]))
    tape = Tape.load(small_kit.path)
    low = [min(box[side] for box in boxes) for side in (0, 1)]
    high = [max(box[side] for box in boxes) for side in (2, 3)]
    assert (*low, *high) == pytest.approx((0.0, 0.0, *tape.board.size_mm), abs=1e-5)
    assert len(boxes) > 20  # the tag and the label, too
