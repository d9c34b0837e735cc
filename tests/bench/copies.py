"""What a frame costs in copies of itself, in one run: contacts of several sizes, both worlds, a tag beside them, and threads.

    python -m tests.bench.copies [--frames 200] [--rounds 5] [--write]

prints the table of docs/localization.md, or puts it there. A copy is that of 320x240 single-precision pixels which were read just
before, into memory that is there: `depth.copy()` takes up to four times as long, by what the allocator does. Each round times
copies, tags and both worlds, one after the other; of each frame the least processor time of all rounds counts: p50 and p99 are
over frames, not over what else the machine did. Threads are timed on the clock: two that decode, the least of ten times, and one
beside another that never waits.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from os import getloadavg
from pathlib import Path
from threading import Event, Thread
from time import perf_counter_ns, process_time_ns
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
TRIES = 10
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


def threads_gain(localizers: list[Localizer], frames: list[Depth]) -> float:
    """Times as many frames a second as one thread, a thread and a localizer for each of some cores; the least times count."""

    def decode(localizer: Localizer) -> None:
        for frame in frames:
            localizer.locate(frame)

    spent: tuple[list[int], list[int]] = ([], [])
    with ThreadPoolExecutor(len(localizers)) as pool:
        for _ in range(TRIES):
            for some, times in zip((localizers[:1], localizers), spent, strict=True):
                start = perf_counter_ns()
                list(pool.map(decode, some))
                times.append(perf_counter_ns() - start)
    return len(localizers) * min(spent[0]) / min(spent[1])


def beside_busy_ms(localizer: Localizer, frames: list[Depth]) -> FloatArray:
    """Time of each frame, on the clock, while another thread computes in Python without an end."""
    spent, ended = [], Event()

    def compute() -> None:
        while not ended.is_set():
            sum(range(100))

    other = Thread(target=compute, daemon=True)
    other.start()
    try:
        for frame in frames:
            start = perf_counter_ns()
            localizer.locate(frame)
            spent.append(1e-6 * (perf_counter_ns() - start))
    finally:
        ended.set()
        other.join()
    return np.array(spent)


def table(frames: int, rounds: int) -> str:
    """The table in Markdown."""
    localizers = {world: Localizer([registered_tape()], world=world) for world in WORLDS}
    lines = [
        "| contact | " + " | ".join(f"{world} world: p50 | p99 | p99 / p50" for world in WORLDS) + " | tag / p50 |",
        "|---" * (2 + 3 * len(WORLDS)) + "|",
    ]
    tags = tag_frames(20)
    default: list[Depth] = []
    spent_ns, copy_ns, tag_ns = [], [], []
    for row in CONTACTS:
        depths = [frame.depth for frame in frames_of(row, frames)]
        default = default or depths
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
    gains = {
        world: threads_gain([Localizer([registered_tape()], world=world) for _ in range(2)], default[:50] * 4) for world in WORLDS
    }
    said = ", ".join(f"{gain:.2f} in the {world} world" for world, gain in gains.items())
    beside = {world: np.percentile(beside_busy_ms(localizer, default), [50, 90]) for world, localizer in localizers.items()}
    busy = ", ".join(f"{p50:.1f} and {p90:.1f} ms in the {world} world" for world, (p50, p90) in beside.items())
    return (
        "\n".join(lines)
        + f"\n\nA copy took {unit / 1e3:.1f} µs, a tag {np.median(tag_ns) / 1e6:.2f} ms; {frames} frames a contact, "
        f"load average {getloadavg()[0]:.0f}.\n"
        + f"Two threads decode so many times the frames of one: {said}.\n"
        + f"Beside a thread that computes in Python p50 and p90 of a frame's time are {busy}.\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.copies", description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=200, help="of each contact")
    parser.add_argument("--rounds", type=int, default=5)
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
