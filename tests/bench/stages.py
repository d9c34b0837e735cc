"""Where a frame's time goes: each stage of the decoder, in compiled kernels and in Python between them.

    python -m tests.bench.stages [--frames 20] [--rounds 30] [--write]

prints the tables of docs/localization.md, or puts them there. The second table is of processor time without clocks, over that of
its first row, taken in turn with it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial, wraps
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from time import perf_counter_ns, process_time_ns
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab import Localizer
from tactape_fab.base.jit import COMPILED
from tactape_fab.sense import decode, load_sensor
from tests.bench.localization_rows import ROWS, frames_of, registered_tape
from tests.bench.marks import write_between

STAGES = {
    "input": ("localizer", "canonical_depths"),
    "dots": ("square_image", "frame_dots"),
    "rim": ("localizer", "settled"),
    "edges": ("square_image", "middles"),
    "grid": ("rank", "_fits"),
    "symbols": ("rank", "posteriors"),
    "registered places": ("rank", "_place"),
    "unregistered tapes": ("accept", "_doubt"),
    "pose": ("accept", "fit_pose"),
    "pixels": ("accept", "refine"),
}
"""Stages by the function that each is, and the module that calls it."""
REST = "the rest"
PAGE = Path(__file__).parents[2] / "docs" / "localization.md"
Stages = dict[str, npt.NDArray[np.float64]]
"""Microseconds in all, in kernels, and kernels called, by stage."""


@dataclass
class Clock:
    """Nanoseconds of one frame by stage: in all, in kernels, and how many kernels Python called."""

    open: list[str] = field(default_factory=lambda: [REST])
    spent: dict[str, list[int]] = field(default_factory=dict)

    def begin(self) -> None:
        self.spent = {name: [0, 0, 0] for name in (*STAGES, REST)}

    def staged(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, its time taken from the stage that calls it and added to its own."""

        @wraps(function)
        def timed(*args: Any, **options: Any) -> Any:
            self.open.append(name)
            start = perf_counter_ns()
            try:
                return function(*args, **options)
            finally:
                spent = perf_counter_ns() - start
                self.open.pop()
                self.spent[name][0] += spent
                self.spent[self.open[-1]][0] -= spent

        return timed

    def kernel(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The kernel, its time added to that in kernels of the stage that calls it."""

        def timed(*args: Any) -> Any:
            spent = self.spent[self.open[-1]]
            start = perf_counter_ns()
            out = function(*args)
            spent[1] += perf_counter_ns() - start
            spent[2] += 1
            return out

        return timed


def dispatchers() -> list[tuple[ModuleType, str, Any]]:
    """Kernels of the decoder, of every module that has them."""
    from numba.core.dispatcher import Dispatcher

    modules = [import_module(found.name) for found in walk_packages(decode.__path__, f"{decode.__name__}.")]
    return [(module, name, value) for module in modules for name, value in vars(module).items() if isinstance(value, Dispatcher)]


@contextmanager
def instrumented(clock: Clock) -> Iterator[None]:
    """A clock round every stage and every kernel that Python calls."""
    kernels: dict[int, Callable[..., Any]] = {}
    found = dispatchers()
    staged = [(import_module(f"{decode.__name__}.{module}"), name) for module, name in STAGES.values()]
    before = [*found, *((module, name, getattr(module, name)) for module, name in staged)]
    try:
        for module, name, value in found:
            setattr(module, name, kernels.setdefault(id(value), clock.kernel(value)))
        for stage, (module, name) in zip(STAGES, staged, strict=True):
            setattr(module, name, clock.staged(stage, getattr(module, name)))
        yield
    finally:
        for module, name, value in before:
            setattr(module, name, value)


def measured(localizer: Localizer, frames: list[Any], rounds: int) -> Stages:
    """Microseconds in all, in kernels, and kernels called, of each stage: mean over frames of the quickest of some rounds."""
    for frame in frames:
        localizer.locate(frame)  # every kernel is compiled, and in the processor's cache
    clock, best = Clock(), []
    with instrumented(clock):
        for frame in frames:
            found: list[tuple[int, dict[str, list[int]]]] = []
            for _ in range(rounds):
                clock.begin()
                start = perf_counter_ns()
                localizer.locate(frame)
                spent = perf_counter_ns() - start
                clock.spent[REST][0] += spent
                found.append((spent, clock.spent))
            best.append(min(found, key=lambda one: one[0])[1])
    stages = {name: np.mean([found[name] for found in best], axis=0) / (1e3, 1e3, 1.0) for name in (*STAGES, REST)}
    return {name: row for name, row in stages.items() if row[0] > 0.0}


def table(setups: dict[str, Stages]) -> str:
    """The stages of some set-ups as a table in Markdown."""
    lines = [
        "| | " + " | ".join(f"{name}: kernels | in them, µs | in Python, µs" for name in setups) + " |",
        "|---" * (1 + 3 * len(setups)) + "|",
    ]
    nothing = np.zeros(3)
    for stage in (*STAGES, REST, "**a frame**"):
        cells = []
        for stages in setups.values():
            whole, inside, calls = stages.get(stage, nothing) if stage in (*STAGES, REST) else np.sum([*stages.values()], axis=0)
            cells += [f"{calls:.0f}", f"{inside:.0f}", f"{whole - inside:.0f}"]
        lines.append(f"| {' | '.join([stage, *cells])} |")
    return "\n".join(lines) + "\n"


def ratios(calls: dict[str, Callable[[Any], object]], frames: list[Any], rounds: int) -> str:
    """Median over frames of the least processor time of some rounds, over that of the first call, as a table in Markdown."""
    spent = np.empty((len(calls), len(frames), rounds + 1))
    for at in range(rounds + 1):
        for k, call in enumerate(calls.values()):
            for i, frame in enumerate(frames):
                start = process_time_ns()
                call(frame)
                spent[k, i, at] = process_time_ns() - start
    p50 = np.median(spent[:, :, 1:].min(axis=2), axis=1)  # in the first round caches were cold
    lines = ["| p50 of processor time | over the first |", "|---|---|"]
    lines += [f"| {name} | {share:.2f} |" for name, share in zip(calls, p50 / p50[0], strict=True)]
    return "\n".join(lines) + "\n"


def _written(localizer: Localizer, frame: Any) -> None:
    localizer.locate(frame).to_mapping(0)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.stages", description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--write", action="store_true", help="put the table into docs/localization.md")
    asked = parser.parse_args()
    if not COMPILED:
        raise SystemExit("there are no kernels to be timed: numba is missing or switched off")
    localizers = {
        "closed world": Localizer([registered_tape()], world="closed"),
        "open world": Localizer([registered_tape()]),
        "open, to the pixels": Localizer([registered_tape()], refine="pixels"),
    }
    frames = [frame.depth for frame in frames_of(ROWS[0], asked.frames)]
    found = table({name: measured(localizer, frames, asked.rounds) for name, localizer in localizers.items()})
    bare = Localizer([registered_tape()], replace(load_sensor("gelsight-mini"), depth_unit_mm=None))
    compared: dict[str, Callable[[Any], object]] = {
        "open world, without what tilt and force need": bare.locate,
        "open world": localizers["open world"].locate,
        "open world, with the tilt and the force that `to_mapping` asks for": partial(_written, localizers["open world"]),
        "open world, to the pixels": localizers["open, to the pixels"].locate,
    }
    found += "\n" + ratios(compared, frames, asked.rounds)
    print(found, end="")
    if asked.write:
        write_between(PAGE, "stages", found)


if __name__ == "__main__":
    main()
