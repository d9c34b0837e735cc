"""What the benchmarks share: large tapes, time of calls, memory of whole processes, and how a figure is printed."""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Sequence
from math import isqrt
from pathlib import Path
from time import perf_counter
from typing import Any, Generic, ParamSpec, TypeVar

from pytest_benchmark.fixture import BenchmarkFixture

from tactape_fab import Tape, TapeSpec
from tactape_fab.kit.plan import plan
from tactape_fab.kit.profiles import load_fab, load_part

P = ParamSpec("P")
R = TypeVar("R")

_STRIP_AND_MARGINS_MM, _MARGINS_MM = 11.0, 3.0
_PEAK_OF_CHILD = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


class Timed(Generic[P, R]):
    """A function that keeps the seconds of each of its calls."""

    def __init__(self, function: Callable[P, R]) -> None:
        self._function = function
        self.seconds: list[float] = []

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        start = perf_counter()
        try:
            return self._function(*args, **kwargs)
        finally:
            self.seconds.append(perf_counter() - start)


def run(benchmark: BenchmarkFixture, function: Callable[[], R], rounds: int, before: Callable[[], Any] | None = None) -> R:
    """Let pytest-benchmark call a function `rounds` times, with `before` ahead of each, untimed; the last answer."""

    def setup() -> None:
        if before is not None:
            before()

    result: R = benchmark.pedantic(function, setup=setup, rounds=rounds)  # type: ignore[no-untyped-call]
    return result


def large_spec(parts: int) -> TapeSpec:
    """A spec of about square outline whose tape carries at least `parts` parts, and hardly more."""
    side_mm = 1.5 * isqrt(parts)
    return TapeSpec(sector=7, origin=(0, 0), size_mm=(side_mm + _STRIP_AND_MARGINS_MM, side_mm + _MARGINS_MM))


def planned(spec: TapeSpec) -> Tape:
    """The tape of a spec of a film."""
    return plan(spec, load_fab(spec.fab or "generic-fpc"), load_part(spec.part))


def command() -> str:
    """Path of the installed tactape-fab command."""
    found = shutil.which("tactape-fab", path=sysconfig.get_path("scripts"))
    assert found is not None, "tactape-fab is not installed beside this interpreter"
    return found


def peak_memory_mb(arguments: Sequence[str], folder: Path) -> float:
    """Largest resident memory of a process and its children, 10^6 bytes; run in `folder`.

    A small interpreter starts it: the figure of a process would otherwise hold the memory of the one that started it.
    """
    launcher = [sys.executable, "-I", "-S", "-c", _PEAK_OF_CHILD]
    run = subprocess.run([*launcher, *arguments], check=True, capture_output=True, encoding="utf-8", cwd=folder)
    unit = 1 if sys.platform == "darwin" else 1024
    return int(run.stdout) * unit / 1e6


def show(name: str, value: float, unit: str, target: str = "") -> None:
    """Print a figure on a line of its own."""
    print(f"\n{name}: {value:.3f} {unit}" + (f" (target {target})" if target else ""), end="", flush=True)
