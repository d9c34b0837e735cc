"""KiCad's own design-rule check (pcbnew, headless) agrees with ours on boards just above and just below each limit."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tactape_fab import TapeSpec
from tactape_fab.kit.film.layout import Layout, build_layout
from tactape_fab.kit.plan import plan
from tactape_fab.kit.profiles import FabProfile, load_fab, load_part
from tactape_fab.kit.rules.spacing import check

JUDGE = Path(__file__).parent / "kicad_judge.py"
PART = load_part("r0201")
KINDS = {
    "pad-pad": "clearance",
    "courtyard": "courtyards_overlap",
    "pad-edge": "copper_edge_clearance",
    "hole-copper": "hole_clearance",
}
STEPS_MM = (-0.05, -0.006, 0.006, 0.05)
"""How far the limits lie from the measured value; KiCad draws round corners with an error of up to 5 um."""

SHAPES: list[dict[str, Any]] = [
    {"pitch_mm": 1.5, "displacement_mm": 0.25},
    {"pitch_mm": 1.3, "displacement_mm": 0.25},
    {"pitch_mm": 1.6, "displacement_mm": 0.3, "rotation_deg": 135.0},
    {"pitch_mm": 1.9, "displacement_mm": 0.2, "rotation_deg": 0.0},
    {"pitch_mm": 1.7, "displacement_mm": 0.28, "rotation_deg": 30.0},
]
COURTYARDS: list[dict[str, Any]] = [
    {"pitch_mm": pitch_mm, "displacement_mm": displacement_mm}
    for displacement_mm, least_mm in ((0.25, 1.490), (0.2, 1.390), (0.3, 1.590), (0.1, 1.190), (0.15, 1.290))
    for pitch_mm in (round(least_mm - 0.008, 3), round(least_mm + 0.008, 3))
]


def layout_of(values: dict[str, Any]) -> tuple[Layout, FabProfile]:
    fab = load_fab("generic-fpc")
    spec = TapeSpec(sector=7, size_mm=(20.0, 16.0), tag="none", corner_radius_mm=0.0, holes_mm=[(9.0, 8.0, 1.5)], **values)
    return build_layout(plan(spec, fab, PART), spec, fab, PART), fab


def with_limits(fab: FabProfile, values_mm: dict[str, float]) -> FabProfile:
    return replace(fab, limits={**fab.limits, **{rule: replace(fab.limits[rule], value_mm=v) for rule, v in values_mm.items()}})


def designs() -> list[tuple[Layout, FabProfile]]:
    """Five arrangements with all limits moved to both sides of what is measured, and ten pitches round touching courtyards."""
    found = []
    for values in SHAPES:
        layout, fab = layout_of(values)
        measured = {f.rule: f.value for f in check(layout, fab, TapeSpec(sector=7)) if f.rule in KINDS and f.value is not None}
        for step_mm in STEPS_MM:
            moved = {rule: round(value + step_mm, 6) for rule, value in measured.items() if rule != "courtyard"}
            found.append((layout, with_limits(fab, moved)))
    return found + [layout_of(values) for values in COURTYARDS]


def as_json(layout: Layout, fab: FabProfile) -> dict[str, Any]:
    return {
        "parts_xy_mm": layout.parts_xy_mm.tolist(),
        "rotation_deg": layout.tape.part.rotation_deg,
        "size_mm": layout.tape.board.size_mm,
        "holes_mm": layout.tape.board.holes,
        "part": {
            "pad_mm": PART.pads.size_mm,
            "radius_mm": PART.pads.corner_radius_mm,
            "offset_mm": PART.pads.offset_mm,
            "courtyard_mm": PART.courtyard_mm,
        },
        "limits_mm": {rule: fab.limits[rule].value_mm for rule in KINDS},
    }


@pytest.fixture(scope="module")
def verdicts(kicad_python: str) -> list[tuple[dict[str, bool], dict[str, int]]]:
    """For each design: our broken rules, and KiCad's violations by kind."""
    cases = designs()
    text = json.dumps([as_json(*case) for case in cases])
    run = subprocess.run([kicad_python, str(JUDGE)], input=text, capture_output=True, encoding="utf-8", check=False)
    assert run.returncode == 0, run.stderr[-2000:]
    ours = [{f.rule: f.passed for f in check(layout, fab, TapeSpec(sector=7)) if f.rule in KINDS} for layout, fab in cases]
    return list(zip(ours, json.loads(run.stdout), strict=True))


def test_there_are_30_designs(verdicts: list[tuple[dict[str, bool], dict[str, int]]]) -> None:
    assert len(verdicts) == 30


@pytest.mark.parametrize("rule", KINDS)
def test_kicad_agrees(verdicts: list[tuple[dict[str, bool], dict[str, int]]], rule: str) -> None:
    passed = [ours[rule] for ours, _ in verdicts]
    assert {True, False} == set(passed)
    by_kicad = [theirs.get(KINDS[rule], 0) == 0 for _, theirs in verdicts]
    assert passed == by_kicad
