"""What a frame costs in copies of itself, in one run: contacts of several sizes, both worlds, and a tag beside them.

    python -m tests.bench.copies [--frames 200] [--rounds 15] [--write]

prints the table of docs/localization.md, or puts it there. A copy is that of 320x240 single-precision pixels which were read just
before, into memory that is there: `depth.copy()` takes up to four times as long, by what the allocator does. Each round times
copies, tags and both worlds, one after the other; of each frame the least processor time of all rounds counts: p50 and p99 are
over frames, not over what else the machine did.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from os import getloadavg
from pathlib import Path
from time import process_time_ns
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab import Localizer
from tactape_fab.base.jit import COMPILED
from tactape_fab.sense import ElasticContact, Scene
from tactape_fab.sense.decode.settings import World
from tactape_fab.texture.frames import FloatArray
from tests.bench.localization_accuracy import tag_detector, tag_frames
from tests.bench.localization_rows import Row, frames_of, registered_tape
from tests.bench.marks import write_between

PAGE = Path(__file__).parents[2] / "docs" / "localization.md"
CONTACTS = (
    *(
        Row(name=f"{wide:g}x{high:g} mm", scenes=(Scene(contact_mm=(wide, high)),))
        for wide, high in ((14.0, 10.0), (11.0, 9.0), (7.0, 7.0), (6.0, 6.0))
    ),
    Row(name="over the tape's edge", edge=True),
    Row(name="tilted by 5°", scenes=(Scene(elastic=ElasticContact(tilt_deg=(5.0, 0.0))),)),
    Row(name="round 16 mm", scenes=(Scene(elastic=ElasticContact(cylinder_radius_mm=16.0), contact_turn_deg=30.0),)),
)
WORLDS: tuple[World, World] = ("closed", "open")
Depth = npt.NDArray[np.float32]


def costs(calls: list[Callable[[Any], object]], inputs: list[list[Any]], rounds: int) -> list[FloatArray]:
    """Least processor time (ns) of each call for each of its inputs; each round makes all calls, one after the other."""
    best = [np.full(len(of), np.inf) for of in inputs]
    for _ in range(rounds):
        for call, of, least in zip(calls, inputs, best, strict=True):
            call(of[0])  # its code is in the caches
            for i, one in enumerate(of):
                start = process_time_ns()
                call(one)
                least[i] = min(least[i], process_time_ns() - start)
    return best


def table(frames: int, rounds: int) -> str:
    """The table in Markdown."""
    localizers = {world: Localizer([registered_tape()], world=world) for world in WORLDS}
    lines = [
        "| contact | " + " | ".join(f"{world} world: p50 | p99 | p99 / p50" for world in WORLDS) + " | tag / p50 |",
        "|---" * (2 + 3 * len(WORLDS)) + "|",
    ]
    tags = tag_frames(20)
    spent_ns, copy_ns, tag_ns = [], [], []
    for row in CONTACTS:
        depths = [frame.depth for frame in frames_of(row, frames)]
        twice = [depth for depth in depths for _ in range(2)]
        copy = partial(np.copyto, np.empty_like(depths[0]))
        calls = [copy, tag_detector().detect, *(localizer.locate for localizer in localizers.values())]
        copies, tag, *worlds = costs(calls, [twice, tags, depths, depths], rounds)
        copy_ns.append(float(np.median(copies[1::2])))  # of pixels in the cache
        tag_ns.append(float(np.median(tag)))
        spent_ns.append([np.percentile(spent, [50, 99]) for spent in worlds])
    unit = min(copy_ns)  # where the buffers lie makes a copy cost up to twice as much
    for row, percentiles, tag_p50 in zip(CONTACTS, spent_ns, tag_ns, strict=True):
        cells = [f"{p50 / unit:.1f} | {p99 / unit:.1f} | {p99 / p50:.2f}" for p50, p99 in percentiles]
        gain = " and ".join(f"{tag_p50 / p50:.1f}" for p50, _ in percentiles)
        lines.append(f"| {row.name} | {' | '.join(cells)} | {gain} |")
    return (
        "\n".join(lines)
        + f"\n\nA copy took {unit / 1e3:.1f} µs, a tag {np.median(tag_ns) / 1e6:.2f} ms; {frames} frames a contact, "
        f"load average {getloadavg()[0]:.0f}.\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.copies", description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=200, help="of each contact")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--write", action="store_true", help="put the table into docs/localization.md")
    asked = parser.parse_args()
    if not COMPILED:
        raise SystemExit("there are no kernels to be timed: numba is missing or switched off")
    found = table(asked.frames, asked.rounds)
    print(found, end="")
    if asked.write:
        write_between(PAGE, "copies", found)


if __name__ == "__main__":
    main()
