"""Makes robot.json and the tables of robot.md. Run: python docs/make_robot.py [PART…] (a quarter of an hour for all parts)"""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # a dependency installs a package `tests`, too

from tests.bench import camera, tracking
from tests.bench.evidence.record import about
from tests.bench.marks import all_replaced, measured_line, stamp

PAGE = Path(__file__).parent / "robot.md"
FIGURES = Path(__file__).parent / "robot.json"
COURSES = 20
TRAP_COURSES = 40
SLIP_COURSES = 40
TAG_CELLS_MM = (0.5, 1.0, 2.0)
VIEWS = 60
SLIP_SIZE_MM = 8.0
SLIPS = ((0.05, 0.0), (0.1, 0.0), (0.2, 0.0), (0.0, 0.5), (0.0, 1.0), (0.0, 2.0))


def measure_motions() -> list[dict[str, Any]]:
    return [tracking.measure(name, size, COURSES) for name in tracking.MOTIONS for size in tracking.SIZES_MM]


def measure_traps() -> list[dict[str, Any]]:
    return [tracking.measure(name, size, TRAP_COURSES) for name in tracking.TRAPS for size in tracking.SIZES_MM]


def measure_slips() -> list[dict[str, Any]]:
    return [tracking.slips(shift, turn, SLIP_SIZE_MM, SLIP_COURSES) for shift, turn in SLIPS]


def measure_camera() -> list[dict[str, Any]]:
    return [camera.measure(cell_mm, VIEWS) for cell_mm in TAG_CELLS_MM]


def _rate(row: dict[str, Any], world: str, way: str) -> str:
    return f"{100 * row[world][way]['right'] // row['counted']}"  # 100 only where all are


def motions_table(rows: list[dict[str, Any]]) -> str:
    """Share of frames located, by a frame alone and tracked."""
    sizes = sorted({row["size_mm"] for row in rows})
    out = ["| | world | " + " | ".join(f"{size:g} mm" for size in sizes) + " |", "|---|---|" + "---|" * len(sizes)]
    for name in dict.fromkeys(row["course"] for row in rows):
        of = [row for row in rows if row["course"] == name]
        for world in ("open", "closed"):
            cells = [f"{_rate(row, world, 'single')} → {_rate(row, world, 'tracked')} %" for row in of]
            out.append(f"| {name if world == 'open' else ''} | {world} | " + " | ".join(cells) + " |")
    return "\n".join(out) + "\n"


def accuracy_table(rows: list[dict[str, Any]]) -> str:
    """Errors of located frames by size: the largest figure of all motions."""
    out = ["| contact | | error p50 | p95 | θ p50 | p95 |", "|---|---|---|---|---|---|"]
    for size in sorted({row["size_mm"] for row in rows}):
        for way, said in (("single", "one frame alone"), ("tracked", "tracked")):
            found = [row["open"][way] for row in rows if row["size_mm"] == size and row["open"][way]["right"] >= 20]
            if found:
                um = [f"{1000 * max(one[f'{p}_mm'] for one in found):.0f} µm" for p in ("p50", "p95")]
                deg = [f"{max(one[f'{p}_deg'] for one in found):.2f}°" for p in ("p50", "p95")]
                out.append(f"| {size:g} mm | {said} | " + " | ".join([*um, *deg]) + " |")
    return "\n".join(out) + "\n"


def traps_table(rows: list[dict[str, Any]]) -> str:
    """False fixes, and what is located of what can be."""
    out = ["| | answers | false, one frame alone | false, tracked | located at 8 mm |", "|---|---|---|---|---|"]
    for name in dict.fromkeys(row["course"] for row in rows):
        of = [row for row in rows if row["course"] == name]
        false = {
            way: sum(row[world][way]["false"] for row in of for world in ("open", "closed") if world in row)
            for way in ("single", "tracked")
        }
        frames = sum(row["frames"] * (1 + ("closed" in row)) for row in of)
        last = f"{_rate(of[-1], 'open', 'single')} → {_rate(of[-1], 'open', 'tracked')} %"
        out.append(f"| {name} | {frames} | {false['single']} | {false['tracked']} | {last} |")
    return "\n".join(out) + "\n"


def slips_table(rows: list[dict[str, Any]]) -> str:
    out = ["| step | contacts | told within two frames | later | told before it |", "|---|---|---|---|---|"]
    for row in rows:
        step = f"{row['shift_mm']:g} mm" if row["shift_mm"] else f"{row['turn_deg']:g}°"
        out.append(f"| {step} | {row['courses']} | {row['at_once']} | {row['later']} | {row['false']} |")
    return "\n".join(out) + "\n"


def camera_table(rows: list[dict[str, Any]]) -> str:
    """Errors of points of the texture, near the tag and all over it."""
    out = ["| tag | found | pose | near the tag: p50, p95, most | the whole tape: p50, p95, most |", "|---|---|---|---|---|"]
    for row in rows:
        for name in ("detector", "refined", "ten refined"):
            if f"{name}, near" not in row:
                continue
            cells = [", ".join(f"{v:.3f}" for v in row[f"{name}, {where}"].values()) + " mm" for where in ("near", "whole")]
            first = name == "detector"
            said = f"{row['side_mm']:g} mm (`--tag-cell {row['cell_mm']:g}`)" * first
            found = f"{row['found']} of {row['views']}" * first
            out.append(f"| {said} | {found} | {POSES[name]} | " + " | ".join(cells) + " |")
    return "\n".join(out) + "\n"


POSES = {"detector": "the detector's", "refined": "refined", "ten refined": "median of ten refined"}
MEASURES = {"motions": measure_motions, "traps": measure_traps, "slips": measure_slips, "camera": measure_camera}
TABLES = {
    "motions": ("motions", motions_table),
    "accuracy": ("motions", accuracy_table),
    "traps": ("traps", traps_table),
    "slips": ("slips", slips_table),
    "camera": ("camera", camera_table),
}


def made_anew(text: str, content: dict[str, Any]) -> str:
    """The page's text with its tables as the figures have them."""
    tables = {
        name: table(content[part]) + measured_line([content["measured"][part]])
        for name, (part, table) in TABLES.items()
        if part in content
    }
    return all_replaced(text, tables)


def main(parts: list[str]) -> None:
    for name in parts or MEASURES:
        found = MEASURES[name]()
        content: dict[str, Any] = json.loads(FIGURES.read_text(encoding="utf-8")) if FIGURES.exists() else {}
        content[name] = found
        measured = {**content.get("measured", {}), name: {**about(), **stamp()}}
        ordered = {"measured": measured, **{key: content[key] for key in MEASURES if key in content}}
        FIGURES.write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")
        PAGE.write_text(made_anew(PAGE.read_text(encoding="utf-8"), ordered), encoding="utf-8")


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", help="all unless named")
    main(parser.parse_args().parts)
