"""Run by the Python that has KiCad's pcbnew: boards out of JSON on stdin, counts of design-rule violations as JSON on stdout.

Every board has parts of two rounded pads and a courtyard, an outline, unplated holes, and the limits to judge by.
"""

from __future__ import annotations

import json
import re
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pcbnew

Point = Sequence[float]
Design = dict[str, Any]

MM = pcbnew.FromMM


def point(xy: Point) -> Any:
    return pcbnew.wxPointMM(xy[0], -xy[1])


def lines(add: Callable[[Point, Point, int], None], corners: Sequence[Point], layer: int) -> None:
    for i, corner in enumerate(corners):
        add(corner, corners[(i + 1) % len(corners)], layer)


def footprint(board: Any, part: Design, number: int, clearance_mm: float) -> Any:
    placed = pcbnew.FOOTPRINT(board)
    placed.SetReference(f"R{number}")
    placed.Reference().SetVisible(False)
    placed.SetAttributes(pcbnew.FP_SMD)
    board.Add(placed)
    net = pcbnew.NETINFO_ITEM(board, f"R{number}")  # one for both pads: their own gap is another rule's
    board.Add(net)
    for i, side in enumerate((-1, 1)):
        pad = pcbnew.PAD(placed)
        pad.SetAttribute(pcbnew.PAD_ATTRIB_SMD)
        pad.SetLayerSet(pcbnew.PAD.SMDMask())
        pad.SetShape(pcbnew.PAD_SHAPE_ROUNDRECT)
        pad.SetSize(pcbnew.wxSizeMM(*part["pad_mm"]))
        pad.SetRoundRectRadiusRatio(part["radius_mm"] / min(part["pad_mm"]))
        pad.SetPos0(pcbnew.wxPointMM(side * part["offset_mm"], 0.0))
        pad.SetNumber(str(i + 1))
        pad.SetLocalClearance(MM(clearance_mm))
        placed.Add(pad)
        pad.SetNet(net)
    half = [size / 2 for size in part["courtyard_mm"]]
    corners = [(-half[0], -half[1]), (half[0], -half[1]), (half[0], half[1]), (-half[0], half[1])]

    def add(a: Point, b: Point, layer: int) -> None:
        line = pcbnew.FP_SHAPE(placed, pcbnew.SHAPE_T_SEGMENT)
        line.SetLayer(layer)
        line.SetWidth(MM(0.01))
        line.SetStart0(pcbnew.wxPointMM(*a))
        line.SetEnd0(pcbnew.wxPointMM(*b))
        placed.Add(line)

    lines(add, corners, pcbnew.F_CrtYd)
    return placed


def build(design: Design) -> Any:
    board = pcbnew.BOARD()
    for number, xy in enumerate(design["parts_xy_mm"], start=1):
        placed = footprint(board, design["part"], number, design["limits_mm"]["pad-pad"])
        placed.SetPosition(point(xy))
        placed.SetOrientation(10.0 * design["rotation_deg"])

    def edge(a: Point, b: Point, layer: int) -> None:
        line = pcbnew.PCB_SHAPE(board)
        line.SetShape(pcbnew.SHAPE_T_SEGMENT)
        line.SetLayer(layer)
        line.SetWidth(MM(0.001))
        line.SetStart(point(a))
        line.SetEnd(point(b))
        board.Add(line)

    width, height = design["size_mm"]
    lines(edge, [(0, 0), (width, 0), (width, height), (0, height)], pcbnew.Edge_Cuts)
    for x, y, diameter in design["holes_mm"]:
        hole = pcbnew.FOOTPRINT(board)
        pad = pcbnew.PAD(hole)
        pad.SetAttribute(pcbnew.PAD_ATTRIB_NPTH)
        pad.SetLayerSet(pcbnew.PAD.UnplatedHoleMask())
        pad.SetShape(pcbnew.PAD_SHAPE_CIRCLE)
        pad.SetSize(pcbnew.wxSizeMM(diameter, diameter))
        pad.SetDrillSize(pcbnew.wxSizeMM(diameter, diameter))
        hole.Add(pad)
        hole.SetPosition(point((x, y)))
        board.Add(hole)
    settings, limits = board.GetDesignSettings(), design["limits_mm"]
    settings.m_MinClearance = MM(limits["pad-pad"])
    settings.m_CopperEdgeClearance = MM(limits["pad-edge"])
    settings.m_HoleClearance = MM(limits["hole-copper"])
    return board


def judge(design: Design, folder: Path) -> dict[str, int]:
    """Number of violations of each kind that KiCad's own check reports."""
    path = folder / "board.kicad_pcb"
    board = build(design)
    board.SetFileName(str(path))
    report = folder / "report.txt"
    assert pcbnew.WriteDRCReport(board, str(report), pcbnew.EDA_UNITS_MILLIMETRES, False)
    counts: dict[str, int] = {}
    for kind in re.findall(r"^\[(\w+)\]:", report.read_text(encoding="utf-8"), flags=re.MULTILINE):
        counts[kind] = counts.get(kind, 0) + 1
    return counts


with tempfile.TemporaryDirectory() as name:
    json.dump([judge(design, Path(name)) for design in json.load(sys.stdin)], sys.stdout)
