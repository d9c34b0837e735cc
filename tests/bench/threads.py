"""How many times the frames of one thread several threads decode, and whether their answers are those of one thread.

    python -m tests.bench.threads [--python PROGRAM]... [--threads 2] [--write]

asks this Python, and every other one that is named, such as a free-threaded one: that needs numpy, numba and nothing else. All
decode the same frames. Times are those on the clock, the least of ten.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event, Thread
from time import perf_counter_ns
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab import Localizer, Tape
from tactape_fab.texture.frames import FloatArray

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "localization.md"
FRAMES = 50
TRIES = 10
Depth = npt.NDArray[np.float32]


def answers(localizer: Localizer, frames: Sequence[Depth]) -> list[dict[str, Any]]:
    """What the frames say, without how long it took."""
    return [localizer.locate(frame).to_mapping(0) | {"elapsed_ms": 0.0} for frame in frames]


def threads_gain(localizers: Sequence[Localizer], frames: Sequence[Depth]) -> tuple[float, float]:
    """Times as many frames a second as one thread, a thread for each localizer; and one thread's time for a frame (ms)."""

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
    return len(localizers) * min(spent[0]) / min(spent[1]), 1e-6 * min(spent[0]) / len(frames)


def beside_busy_ms(localizer: Localizer, frames: Sequence[Depth]) -> FloatArray:
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


def _differing(localizers: Sequence[Localizer], frames: Sequence[Depth]) -> int:
    """Answers of threads at the same time that are not those of one thread; each thread begins with another frame."""
    expected = answers(localizers[0], frames)

    def work(k: int) -> int:
        first = k * len(frames) // len(localizers)
        found = answers(localizers[k], [*frames[first:], *frames[:first]])
        return sum(one != other for one, other in zip(found, [*expected[first:], *expected[:first]], strict=True))

    with ThreadPoolExecutor(len(localizers)) as pool:
        return sum(pool.map(work, range(len(localizers))))


def measured(kit: Path, frames: Path, threads: int) -> list[list[str]]:
    """What this Python makes of the frames, in both worlds: with a `Localizer` for each thread, and with one for all.

    Raises
    ------
    SystemExit
        When an answer of several threads is not that of one.
    """
    tape, depths, lines = Tape.load(kit), list(np.load(frames)), []
    for world in ("closed", "open"):
        each = [Localizer([tape], world=world) for _ in range(threads)]
        for localizers in (each, each[:1] * threads):
            if differing := _differing(localizers, depths):
                raise SystemExit(f"{differing} answers of {threads} threads are not those of one, in the {world} world")
        own, alone_ms = threads_gain(each, depths)
        shared, _ = threads_gain(each[:1] * threads, depths)
        busy_ms = np.percentile(beside_busy_ms(each[0], depths * 4), [50, 90])
        cells = [f"{alone_ms:.2f}", f"{own:.2f}", f"{shared:.2f}", "{:.2f} and {:.2f}".format(*busy_ms)]
        lines.append([world, *cells])
    return lines


def table(programs: Sequence[str], threads: int) -> str:
    """The table in Markdown, a line for each Python and world."""
    from tactape_fab import TapeSpec, make_kit  # no part of the robot's half, which others run
    from tests.bench.localization_rows import Row, frames_of

    lines = [
        f"| Python | world | ms a frame, one thread | frames of {threads} threads, times those of one: a `Localizer` each | "
        "one for all | ms beside a busy thread: p50 and p90 |",
        "|---" * 6 + "|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        kit, frames = Path(folder, "kit"), Path(folder, "frames.npy")
        make_kit(TapeSpec(sector=7), kit, verify=False)
        np.save(frames, np.array([frame.depth for frame in frames_of(Row(name="14x10 mm"), FRAMES)]))
        for program in programs:
            command = [program, "-m", "tests.bench.threads", "--threads", str(threads), "--measure", str(kit), str(frames)]
            environment = {**os.environ, "PYTHONPATH": str(ROOT)}
            run = subprocess.run(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, check=True)
            said = json.loads(run.stdout)
            lines += [f"| {' | '.join([said['python'], *cells])} |" for cells in said["lines"]]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.threads", description=__doc__.splitlines()[0])
    parser.add_argument("--python", action="append", default=[], metavar="PROGRAM", help="another Python, asked as well")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1, help="as many as there are cores")
    parser.add_argument("--write", action="store_true", help="put the table into docs/localization.md")
    parser.add_argument("--measure", nargs=2, type=Path, metavar=("KIT", "FRAMES.npy"), help="this Python alone, as JSON")
    asked = parser.parse_args()
    if asked.measure:
        kit, frames = asked.measure
        python = sys.version.split()[0] + (", free-threaded" if sysconfig.get_config_var("Py_GIL_DISABLED") else "")
        json.dump({"python": python, "lines": measured(kit, frames, asked.threads)}, sys.stdout)
        return
    found = table([sys.executable, *asked.python], asked.threads)
    print(found, end="")
    if asked.write:
        from tests.bench.marks import write_between

        write_between(PAGE, "threads", found)


if __name__ == "__main__":
    main()
