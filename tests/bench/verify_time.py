"""Time of `verify` and time to its first line, beside that of `make`: processor time, which a busy machine changes little.

    python -m tests.bench.verify_time [--quick | --reproduce] [MAKE OPTIONS...]

Two cores that make the default kit in 1.5 s need at least half of all processor time; the readers share it, so that the whole
also takes at least as long as the slowest of them. `--reproduce` compares `verify --reproduce` with `make`, run in turns.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from dataclasses import dataclass

USUAL_MAKE_S, CORES = 1.5, 2
TURNS, MOST_BEYOND_S = 5, 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    first_s: float
    wall_s: float
    cpu_s: float
    lines: int


def timed(*arguments: str, folder: str) -> Run:
    """Run a command; seconds to its first line, to its end, and of all processors."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.perf_counter()
    command = [sys.executable, "-m", "tactape_fab", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=folder) as process:
        assert process.stdout is not None
        process.stdout.readline()
        first_s = time.perf_counter() - begin
        lines = 1 + len(process.stdout.readlines())
    wall_s = time.perf_counter() - begin
    assert process.returncode == 0, arguments
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - spent.ru_utime - spent.ru_stime
    return Run(first_s=first_s, wall_s=wall_s, cpu_s=cpu_s, lines=lines)


def reproduced(options: list[str]) -> None:
    """Print what making a kit again and comparing its bytes takes beyond making it."""
    with tempfile.TemporaryDirectory() as folder:
        timed("make", *options, "-o", "kit", folder=folder)
        turns = [
            (
                timed("make", *options, "-o", f"kit{k}", folder=folder).cpu_s,
                timed("verify", "kit", "--reproduce", folder=folder).cpu_s,
            )
            for k in range(TURNS)
        ]
    made_s, again_s = (min(column) for column in zip(*turns, strict=True))
    print(f"make {made_s:.2f} s, verify --reproduce {again_s:.2f} s of processors, the least of {TURNS} turns each")
    print(f"beyond make: {again_s - made_s:+.2f} s; asked at most {MOST_BEYOND_S} s")


def main() -> None:
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="time `verify --quick`")
    parser.add_argument("--reproduce", action="store_true", help="time `verify --reproduce` beside `make`")
    given, asked = parser.parse_known_args()
    if given.reproduce:
        reproduced(asked or ["--sector", "7"])
        return
    quick = ["--quick"] * given.quick
    with tempfile.TemporaryDirectory() as folder:
        timed("make", *(asked or ["--sector", "7"]), "-o", "kit", folder=folder)  # the first run loads files into memory
        made = timed("make", *(asked or ["--sector", "7"]), "-o", "again", folder=folder)
        timed("verify", "kit", *quick, folder=folder)  # the first run compiles the decoder
        run = timed("verify", "kit", *quick, folder=folder)
    scale = USUAL_MAKE_S / made.cpu_s
    print(f"make: {made.cpu_s:.1f} s of processors, {made.wall_s:.1f} s by the clock")
    print(f"verify: {run.cpu_s:.1f} s of processors, {run.wall_s:.1f} s by the clock")
    print(f"first of its {run.lines} lines after {run.first_s:.1f} s")
    print(f"on {CORES} cores that make this kit in {USUAL_MAKE_S} s: {run.cpu_s * scale / CORES:.1f} s if they share it evenly")


if __name__ == "__main__":
    main()
