"""Makes the tables of choose.md: contacts simulated and decoded. Run: python docs/make_choose.py (takes a minute)"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tactape_fab import TapeSpec
from tactape_fab.decode import Localizer
from tactape_fab.make import examine
from tactape_fab.simulate import Scene, simulate_frames
from tactape_fab.texture.tape import Tape

PAGE = Path(__file__).parent / "choose.md"
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


def least_size_mm(tape: Tape, sensor: str) -> str:
    """The smallest round contact of `SIZES_MM` that is always located."""
    for size_mm in SIZES_MM:
        if located(tape, sensor, Scene(contact_mm=(size_mm, size_mm)))[0] == FRAMES:
            return f"{size_mm:g} mm"
    return f"above {SIZES_MM[-1]:g} mm"


def pitch_table() -> str:
    head = [
        "| W | parts in a cm² | " + " | ".join(f"smallest contact, `{sensor}`" for sensor in SENSORS) + " |",
        "|---|---|---|---|",
    ]
    rows = []
    for pitch_mm in PITCHES_MM:
        tape = tape_of(pitch_mm, pitch_mm / 6)
        sizes = " | ".join(least_size_mm(tape, sensor) for sensor in SENSORS)
        rows.append(f"| {pitch_mm:g} mm | {100 / pitch_mm**2:.0f} | {sizes} |")
    return "\n".join([*head, *rows]) + "\n"


def displacement_table() -> str:
    columns = " | ".join(f"{1000 * placement_mm:g} µm" for placement_mm in PLACEMENTS_MM)
    head = [f"| Δ | {columns} |", "|---|" + "---|" * len(PLACEMENTS_MM)]
    rows = []
    for displacement_mm in DISPLACEMENTS_MM:
        tape = tape_of(1.5, displacement_mm)
        scenes = [Scene(contact_mm=(10.0, 10.0), placement_mm=placement_mm) for placement_mm in PLACEMENTS_MM]
        found = [located(tape, SENSORS[0], scene) for scene in scenes]
        cells = [f"{100 * count // FRAMES} %, {error_um:.1f} µm" if count else "0 %" for count, error_um in found]
        rows.append(f"| {displacement_mm:g} mm | " + " | ".join(cells) + " |")
    return "\n".join([*head, *rows]) + "\n"


TABLES = {"pitch": pitch_table, "displacement": displacement_table}

if __name__ == "__main__":
    text = PAGE.read_text(encoding="utf-8")
    for name, table in TABLES.items():
        start, end = f"<!-- {name} -->\n", f"<!-- /{name} -->"
        head, _, rest = text.partition(start)
        text = f"{head}{start}{table()}{end}{rest.partition(end)[2]}"
    PAGE.write_text(text, encoding="utf-8")
