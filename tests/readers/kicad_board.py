"""Run by the Python that has KiCad's pcbnew: boards (paths as JSON on stdin) -> what KiCad sees in them (JSON on stdout)."""

from __future__ import annotations

import json
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import pcbnew


def seen(path: str) -> dict[str, Any]:
    board = pcbnew.LoadBoard(path)
    settings = board.GetDesignSettings()
    origin = settings.GetAuxOrigin()

    def at(point: Any) -> list[float]:
        return [(point.x - origin.x) / 1e6, (origin.y - point.y) / 1e6]

    parts, lands = {}, {}
    for footprint in board.GetFootprints():
        parts[footprint.GetReference()] = [*at(footprint.GetPosition()), footprint.GetOrientationDegrees()]
        for pad in footprint.Pads():
            if pad.GetNumber():
                lands[f"{footprint.GetReference()}.{pad.GetNumber()}"] = at(pad.GetPosition())
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "drc.txt"
        assert pcbnew.WriteDRCReport(board, str(report), pcbnew.EDA_UNITS_MILLIMETRES, True)
        text = report.read_text()
    box = board.GetBoardEdgesBoundingBox()
    return {
        "parts": parts,
        "lands": lands,
        "violations": sorted(re.findall(r"^\[(\w+)\]", text, re.MULTILINE)),
        "unconnected": [int(n) for n in re.findall(r"Found (\d+) unconnected", text)],
        "edge_mm": settings.m_CopperEdgeClearance / 1e6,
        "clearance_mm": settings.m_MinClearance / 1e6,
        "size_mm": [box.GetWidth() / 1e6, box.GetHeight() / 1e6],
        "origin_mm": at(pcbnew.wxPoint(box.GetLeft(), box.GetBottom())),
    }


json.dump({path: seen(path) for path in json.load(sys.stdin)}, sys.stdout)
