"""Many kits: processor time of each beside a kit made alone, memory of the processes, and, where the machine is quiet, kits/s.

TACTAPE_BENCH_ABSOLUTE=1 makes all 256 sectors and asserts kits per second.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from pathlib import Path

from pytest_benchmark.fixture import BenchmarkFixture

from tactape_fab import TapeSpec, make_kit
from tests.bench.measure import Timed, peak_memory_mb, run, show

ABSOLUTE = os.environ.get("TACTAPE_BENCH_ABSOLUTE") == "1"
FEW, MANY = 12, 256 if ABSOLUTE else 36
JOBS = 2
MOST_OVER_ONE_ALONE = 1.25
LEAST_KITS_PER_S = 3.0
MOST_MEMORY_MB = 300.0


def arguments(kits: int, output: Path) -> list[str]:
    options = ["--sectors", f"0-{kits - 1}", "--no-3d", "--jobs", str(JOBS), "-o", str(output)]
    return [sys.executable, "-m", "tactape_fab", "make", *options]


def children_s() -> float:
    """Processor time of the processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_a_kit_of_many_costs_hardly_more_than_one_alone(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    alone_s = []
    for i in range(FEW):
        begin = time.process_time()
        make_kit(TapeSpec(sector=i, models=False), tmp_path / "alone" / str(i))
        alone_s.append(time.process_time() - begin)
    used_s: list[float] = []

    def make_many(kits: int) -> None:
        begin = children_s()
        subprocess.run(arguments(kits, tmp_path / str(kits)), check=True, capture_output=True)
        used_s.append(children_s() - begin)

    make_many(FEW)
    whole = Timed(make_many)
    run(benchmark, lambda: whole(MANY), rounds=1)
    each_s = (used_s[1] - used_s[0]) / (MANY - FEW)  # without what it takes to start
    usual_s = sorted(alone_s)[FEW // 2]
    rate = MANY / whole.seconds[0]
    load = os.getloadavg()[0]
    show("processor time of a kit of many", each_s, "s", f"<= {MOST_OVER_ONE_ALONE:g} x {usual_s:.3f} s alone")
    show(f"{MANY} kits, {JOBS} processes, at a load of {load:.1f}", rate, "kits/s", f">= {LEAST_KITS_PER_S:g} on a quiet machine")
    assert each_s <= MOST_OVER_ONE_ALONE * usual_s
    if ABSOLUTE:
        assert rate >= LEAST_KITS_PER_S, f"at a load of {load:.1f} on {os.cpu_count()} processors"


def test_memory_does_not_grow_with_the_number_of_kits(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    few = peak_memory_mb(arguments(FEW, tmp_path / "few"), tmp_path)
    many = run(benchmark, lambda: peak_memory_mb(arguments(MANY, tmp_path / "many"), tmp_path), rounds=1)
    show(f"largest process of {FEW} kits", few, "MB")
    show(f"largest process of {MANY} kits", many, "MB", f"<= {MOST_MEMORY_MB:g}")
    assert many <= 1.1 * few + 5.0
    assert many <= MOST_MEMORY_MB
