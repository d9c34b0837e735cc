"""What the rungs of a designed code locate: the same contacts on designs that ask for other distances, for docs/touch-code.md.

Run: python -m tests.bench.touch_rungs [--frames N] [--page docs/touch-code.md]

Images are drawn, with parts that are long, so that a contact shows its quarter turn. All designs are touched at the same places.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from time import process_time

from tactape_fab import Localizer, Tape
from tactape_fab.sense import Scene, iterate_frames
from tactape_fab.sense.decode.settings import World
from tactape_fab.texture.touch.design import HIGHER_RUNGS, RUNGS, Rung, design
from tactape_fab.texture.touch.patches import patch_distances
from tests.bench.localization_measure import is_right
from tests.bench.localization_rows import SECTOR, SEED, registered_tape
from tests.bench.marks import command, write_between

SIZES_MM = (4.75, 5.25, 5.75, 6.25)
WORLDS: tuple[tuple[World, float | None], ...] = (("open", None), ("closed", 0.01))
"""World and bound on the chance to be no tape of ours. By default that chance bounds all small contacts, whatever the code."""
_NONE = (0, 0, 0, 0, 0)
_LONG = HIGHER_RUNGS[4, False, True]
DESIGNS: dict[str, tuple[Rung, ...]] = {
    "no repair": (Rung(own=_NONE, across=_NONE),),
    "`touch-1`": RUNGS[4, False, False],
    "`touch-2`, round parts": HIGHER_RUNGS[4, False, False],
    "`touch-2`, long parts": _LONG,
    "aim (2, 4, 7, 10, 14)": (*_LONG, Rung(own=(2, 4, 7, 10, 14), across=_NONE, quarter=(1, 2, 4, 7, 9), effort=4)),
}
"""Rungs tried; a design keeps the last one that it reaches."""


def designed(rungs: tuple[Rung, ...]) -> tuple[Tape, float]:
    """The benchmark's tape with a design of these rungs, and the processor time it took, s."""
    like, start = registered_tape(), process_time()
    symbols = design(SECTOR, like.symbols.shape, rungs={(4, False, True): rungs}, half_turns=True)
    took_s = process_time() - start
    return replace(like, name="designed", code="touch-2", origin=(0, 0), symbols=symbols, tag=None), took_s


def located(tape: Tape, size_mm: float, frames: int) -> tuple[list[int], int]:
    """Contacts located in each of the `WORLDS`, and the wrong ones of all."""
    localizers = [Localizer([tape], world=world, max_p_tape=limit, refine="dots") for world, limit in WORLDS]
    counts, wrong = [0] * len(WORLDS), 0
    for frame in iterate_frames(tape, frames, SEED, scene=Scene(contact_mm=(size_mm, size_mm))):
        for k, localizer in enumerate(localizers):
            fix = localizer.locate(frame.depth)
            right = is_right(fix, frame, tape)
            counts[k] += fix.located and right
            wrong += fix.located and not right
    return counts, wrong


def table(frames: int) -> str:
    """Bits reached and contacts located, a row a design."""
    head = ("rungs", "bits, 0 and 180°", "bits, all turns", "design", *(f"{size:g} mm" for size in SIZES_MM), "wrong")
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for name, rungs in DESIGNS.items():
        tape, took_s = designed(rungs)
        found = patch_distances(tape.symbols, tape.present, half_turns=True)
        halves = ", ".join(str(patch.half_turns[0]) if patch.half_turns else "-" for patch in found)
        counts = [located(tape, size, frames) for size in SIZES_MM]
        cells = [name, halves, ", ".join(str(patch.bits) for patch in found), f"{took_s:.0f} s"]
        cells += [", ".join(f"{100 * count / frames:.1f}" for count in of_worlds) + " %" for of_worlds, _ in counts]
        lines.append(f"| {' | '.join([*cells, str(sum(wrong for _, wrong in counts))])} |")
        print(lines[-1], flush=True)
    said = "Located in an open world at the usual trust, and in a closed world with `--max-p-tape` 0.01"
    return "\n".join([*lines, "", f"{said}; {frames} contacts a size; {command('tests.bench.touch_rungs')}.", ""])


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.touch_rungs", description=__doc__)
    parser.add_argument("--frames", type=int, default=1000, metavar="N", help="a size and a design")
    parser.add_argument("--page", type=Path)
    asked = parser.parse_args()
    made = table(asked.frames)
    if asked.page is not None:
        write_between(asked.page, "rungs", made)


if __name__ == "__main__":
    main()
