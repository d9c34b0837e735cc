"""Makes choose.json and the tables of choose.md: contacts simulated and decoded. Run: python docs/make_choose.py (a minute)"""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # a dependency installs a package `tests`, too

from tactape_fab import Localizer, TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Scene, simulate_frames
from tactape_fab.texture.tape import Tape
from tests.bench.evidence.record import about
from tests.bench.marks import all_replaced, measured_line, stamp

PAGE = Path(__file__).parent / "choose.md"
FIGURES = Path(__file__).parent / "choose.json"
SENSORS = ("gelsight-mini", "digit")
PITCHES_MM = (1.2, 1.35, 1.5, 1.8, 2.2)
DISPLACEMENTS_MM = (0.1, 0.15, 0.2, 0.25, 0.3)
SIZES_MM = (4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0)
PLACEMENTS_MM = (0.0, 0.03, 0.06, 0.09)
FRAMES = 24
SEED = 11


def tape_of(pitch_mm: float, displacement_mm: float) -> Tape:
    """A printed texture, which no rule of a PCB fab keeps from small pitches."""
    spec = TapeSpec(
        sector=7,
        pitch_mm=pitch_mm,
        displacement_mm=displacement_mm,
        size_mm=(60.0, 40.0),
        part="block",
        body_mm=(0.5, 0.25, 0.23),
    )
    return examine(spec).tape


def located(tape: Tape, sensor: str, scene: Scene) -> tuple[int, float]:
    """How many of the contacts are located, and the median error of these, µm."""
    localizer = Localizer([tape], sensor=sensor)
    frames = simulate_frames(tape, FRAMES, SEED, sensor, scene)
    fixes = [localizer.locate(depth) for depth in frames.depth]
    pairs = [(f.position_mm, p) for f, p in zip(fixes, frames.position_mm, strict=True) if f.located and f.position_mm]
    errors = [float(np.hypot(*np.subtract(found, true))) for found, true in pairs]
    assert all(error < tape.pitch_mm / 4 for error in errors), "a wrong answer"
    return len(pairs), 1000 * float(np.median(errors)) if errors else float("nan")


def least_size_mm(tape: Tape, sensor: str) -> float | None:
    """The smallest round contact of `SIZES_MM` that is always located; None where all are too small."""
    for size_mm in SIZES_MM:
        if located(tape, sensor, Scene(contact_mm=(size_mm, size_mm)))[0] == FRAMES:
            return size_mm
    return None


def measure() -> dict[str, Any]:
    """All figures of the page, and what they were measured with."""
    pitches = []
    for pitch_mm in PITCHES_MM:
        tape = tape_of(pitch_mm, pitch_mm / 6)
        pitches.append({"pitch_mm": pitch_mm, "least_size_mm": {sensor: least_size_mm(tape, sensor) for sensor in SENSORS}})
    displacements = []
    for displacement_mm in DISPLACEMENTS_MM:
        tape, cells = tape_of(1.5, displacement_mm), []
        for placement_mm in PLACEMENTS_MM:
            count, error_um = located(tape, SENSORS[0], Scene(contact_mm=(10.0, 10.0), placement_mm=placement_mm))
            cells.append({"placement_mm": placement_mm, "located": count, "error_um": round(error_um, 2) if count else None})
        displacements.append({"displacement_mm": displacement_mm, "cells": cells})
    return {"about": {**about(), **stamp(), "seed": SEED, "frames": FRAMES}, "pitch": pitches, "displacement": displacements}


def pitch_table(rows: list[dict[str, Any]]) -> str:
    head = [
        "| W | parts in a cm² | " + " | ".join(f"smallest contact, `{sensor}`" for sensor in SENSORS) + " |",
        "|---|---|---|---|",
    ]
    out = []
    for row in rows:
        sizes = [row["least_size_mm"][sensor] for sensor in SENSORS]
        words = " | ".join(f"above {SIZES_MM[-1]:g} mm" if size is None else f"{size:g} mm" for size in sizes)
        out.append(f"| {row['pitch_mm']:g} mm | {100 / row['pitch_mm'] ** 2:.0f} | {words} |")
    return "\n".join([*head, *out]) + "\n"


def displacement_table(rows: list[dict[str, Any]]) -> str:
    columns = " | ".join(f"{1000 * placement_mm:g} µm" for placement_mm in PLACEMENTS_MM)
    out = [f"| Δ | {columns} |", "|---|" + "---|" * len(PLACEMENTS_MM)]
    for row in rows:
        cells = [
            f"{100 * cell['located'] // FRAMES} %, {cell['error_um']:.1f} µm" if cell["located"] else "0 %"
            for cell in row["cells"]
        ]
        out.append(f"| {row['displacement_mm']:g} mm | " + " | ".join(cells) + " |")
    return "\n".join(out) + "\n"


TABLES = {"pitch": pitch_table, "displacement": displacement_table}


def made_anew(text: str, content: dict[str, Any]) -> str:
    """The page's text with its tables as the figures have them."""
    line = measured_line([content["about"]])
    return all_replaced(text, {name: table(content[name]) + line for name, table in TABLES.items()})


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    content = measure()
    FIGURES.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(made_anew(PAGE.read_text(encoding="utf-8"), content), encoding="utf-8")
