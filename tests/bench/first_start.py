"""Processor time of the first start ever, when nothing is compiled yet, and the kernels that take the most of it.

    python -m tests.bench.first_start [--world open] [--kernels 10]

starts a new process with an empty cache for each world, and makes a `Localizer` of one tape in it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from typing import Any, Literal, get_args

World = Literal["open", "closed"]


def processor_s() -> float:
    """Processor time of this process and of those that it started."""
    used = [resource.getrusage(of) for of in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(of.ru_utime + of.ru_stime for of in used)


def started(world: World) -> dict[str, Any]:
    """Seconds in all, of imports, and of every function compiled, less those that it compiles in turn."""
    import numba.core.event as events

    from tactape_fab import Localizer
    from tests.bench.localization_rows import registered_tape

    class Compiled(events.Listener):
        """Processor time of what is compiled, each moment's counted for the innermost function."""

        def __init__(self) -> None:
            self.seconds: dict[str, float] = {}
            self.open: list[str] = []
            self.since = 0.0

        def _count(self) -> None:
            now = processor_s()
            if self.open:
                self.seconds[self.open[-1]] = self.seconds.get(self.open[-1], 0.0) + now - self.since
            self.since = now

        def on_start(self, event: Any) -> None:
            self._count()
            function = event.data["dispatcher"].py_func
            self.open.append(f"{function.__module__.removeprefix('tactape_fab.sense.decode.')}.{function.__qualname__}")

        def on_end(self, event: Any) -> None:
            self._count()
            self.open.pop()

    tape, heard = registered_tape(), Compiled()
    ready_s = processor_s()
    events.register("numba:compile", heard)  # type: ignore[no-untyped-call]
    Localizer([tape], world=world)
    return {"all": processor_s(), "imports": ready_s, "kernels": heard.seconds}


def first_start(world: World) -> dict[str, Any]:
    """`started` in a new process with an empty cache."""
    with tempfile.TemporaryDirectory() as cache:
        command = [sys.executable, "-m", "tests.bench.first_start", "--here", "--world", world]
        done = subprocess.run(command, env=os.environ | {"NUMBA_CACHE_DIR": cache}, check=True, stdout=subprocess.PIPE)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def table(world: World, found: dict[str, Any], count: int) -> str:
    """Lines for one world: all of it, then the costliest functions."""
    kernels = sorted(found["kernels"].items(), key=lambda item: -item[1])
    compiled, rest = sum(found["kernels"].values()), sum(s for _, s in kernels[count:])
    lines = [
        f"{world} world: {found['all']:.1f} s of processor time, {found['imports']:.1f} s before the Localizer, "
        f"{compiled:.1f} s for {len(kernels)} functions"
    ]
    lines += [f"{seconds:8.2f}  {name}" for name, seconds in kernels[:count]]
    return "\n".join([*lines, f"{rest:8.2f}  {max(len(kernels) - count, 0)} others"])


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.first_start", description=__doc__)
    parser.add_argument("--world", choices=get_args(World), help="both unless said")
    parser.add_argument("--kernels", type=int, default=10, metavar="N", help="functions listed, the costliest first")
    parser.add_argument("--here", action="store_true", help="measure this process, and print it as JSON")
    chosen = parser.parse_args()
    if chosen.here:
        print(json.dumps(started(chosen.world or "open")))
        return
    for world in (chosen.world,) if chosen.world else get_args(World):
        print(table(world, first_start(world), chosen.kernels), flush=True)


if __name__ == "__main__":
    main()
