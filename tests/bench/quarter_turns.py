"""How often the dots' elongation names the wrong pair of quarter turns, what was said of it, and the answers that are turned.

Run: python -m tests.bench.quarter_turns [--frames N] [--page docs/codes.md]
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from tactape_fab import Localizer
from tactape_fab.sense import Scene, iterate_frames
from tactape_fab.sense.decode.dots.detect import detect
from tactape_fab.sense.decode.rule import LEAST_DOTS
from tests.bench.localization_accuracy import PX_PER_MM, doubt_said, turn_said
from tests.bench.localization_rows import SEED, registered_tape
from tests.bench.marks import command, write_between

CONTACTS_MM = (5.0, 6.0, 7.0, 9.0, 11.0)
BLURS_MM = (0.15, 0.2, 0.25, 0.3)
WORN = Scene(texture_mm=0.08, placement_mm=0.05, rotation_deg=5.0, missing=0.15)
PARTS = {"new": Scene(), "worn": WORN, "worn, noise x4": replace(WORN, noise=4.0)}
"""Worn: two thirds of the imprint, askew and off their places, some gone."""
_TURNED_DEG = 45.0


class Turns:
    """Frames of one scene: ln ratios for the true pair of turns, and the located answers by their turn."""

    def __init__(self) -> None:
        self.ratios: list[float] = []
        self.located = self.quarter = self.half = 0

    def add(self, ratio: float | None, off_deg: float | None) -> None:
        if ratio is not None:
            self.ratios.append(ratio)
        if off_deg is not None:
            self.located += 1
            self.quarter += _TURNED_DEG < abs(off_deg) <= 180.0 - _TURNED_DEG
            self.half += abs(off_deg) > 180.0 - _TURNED_DEG

    @property
    def mistaken(self) -> int:
        return int((np.array(self.ratios) < 0.0).sum())

    @property
    def said(self) -> float:
        """Mistaken ones that the doubt of all frames adds up to."""
        return float(doubt_said(np.array(self.ratios)).sum())

    def merge(self, other: Turns) -> None:
        self.ratios += other.ratios
        self.located, self.quarter = self.located + other.located, self.quarter + other.quarter
        self.half += other.half


def measure(scene: Scene, frames: int, localizer: Localizer) -> Turns:
    """What is said of the turns in frames of a scene, and the turns of the answers."""
    found = Turns()
    for frame in iterate_frames(registered_tape(), frames, SEED + 41, scene=scene):
        few = len(detect(frame.depth, PX_PER_MM).weights) < LEAST_DOTS
        fix = localizer.locate(frame.depth)
        off = None if fix.theta_deg is None else (fix.theta_deg - frame.theta_deg + 180.0) % 360.0 - 180.0
        found.add(None if few else turn_said(frame), off)
    return found


def table(frames: int) -> str:
    """Mistaken turns, happened and said, by contact and blur; and of all together the answers that are turned."""
    head = ["contact", "parts", *(f"blur {blur:g} mm" for blur in BLURS_MM)]
    lines, whole = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"], Turns()
    localizer = Localizer([registered_tape()])
    for parts, scene in PARTS.items():
        for size_mm in CONTACTS_MM:
            cells = []
            for blur_mm in BLURS_MM:
                found = measure(replace(scene, contact_mm=(size_mm, size_mm), elastomer_mm=blur_mm), frames, localizer)
                whole.merge(found)
                grids = max(len(found.ratios), 1)
                cells.append(f"{100 * found.mistaken / grids:.1f} % ({100 * found.said / grids:.1f} %)")
            lines.append(f"| {size_mm:g} mm | {parts} | {' | '.join(cells)} |")
            print(lines[-1], flush=True)
    said = (
        f"{frames} frames a cell, of which a grid was found in {len(whole.ratios):,}. Of all {whole.located:,} answers "
        f"{whole.quarter} were a quarter turn off and {whole.half} a half turn. {command('tests.bench.quarter_turns')}."
    )
    return "\n".join([*lines, "", said, ""])


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.quarter_turns", description=__doc__)
    parser.add_argument("--frames", type=int, default=300, metavar="N")
    parser.add_argument("--page", type=Path)
    asked = parser.parse_args()
    made = table(asked.frames)
    if asked.page is not None:
        write_between(asked.page, "quarter-turns", made)


if __name__ == "__main__":
    main()
