"""The command as a whole process in a fresh interpreter, and a kit of 50,000 parts: its time by stage, and its memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from itertools import count
from pathlib import Path
from statistics import median
from typing import Any

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tactape_fab import verify
from tactape_fab.kit import writer
from tactape_fab.kit.render import preview
from tactape_fab.make import kit as make
from tactape_fab.verify import film
from tactape_fab.verify.layers import lands
from tests.bench.measure import Timed, command, large_spec, peak_memory_mb, run, show

PARTS = 50_000
MOST_SECONDS_LARGE = 60.0
RUNS = 7
MOST_SECONDS_VERIFY = 0.4
_VERIFY = """
import json, sys
from pathlib import Path
from time import process_time
from tactape_fab.verify import verify_folder

def seconds():
    start = process_time()
    assert verify_folder(Path("manifest.json"), quick=True).passed
    return process_time() - start

first, *later = [seconds() for _ in range(9)]
print(json.dumps({"first": first, "best": min(later), "compiler": "numba" in sys.modules}))
"""
MAIN_JOB = ("make", "--sector", "7", "--w", "1.5", "--delta", "0.25")


@pytest.mark.parametrize(
    ("name", "arguments", "most_s"),
    [
        ("make", MAIN_JOB, 1.5),
        ("make --no-verify", (*MAIN_JOB, "--no-verify"), 0.8),
        ("advise", ("advise", "--contact", "6"), 2.0),
        ("advise --process sla", ("advise", "--contact", "5", "--process", "sla", "--tapes", "16"), 2.0),
        ("--help", ("--help",), 0.25),
    ],
    ids=["make", "no-verify", "advise", "advise-sla", "help"],
)
def test_whole_process_answers_soon(
    benchmark: BenchmarkFixture, tmp_path: Path, name: str, arguments: tuple[str, ...], most_s: float
) -> None:
    folders = (tmp_path / str(i) for i in count())

    def once() -> None:
        folder = next(folders)
        folder.mkdir()
        subprocess.run([command(), *arguments], check=True, capture_output=True, cwd=folder)

    process = Timed(once)
    run(benchmark, process, rounds=RUNS)
    show(f"tactape-fab {name}, whole process, median of {RUNS}", median(process.seconds), "s")
    show(f"tactape-fab {name}, whole process, best of {RUNS}", min(process.seconds), "s", f"<= {most_s:g}")
    assert min(process.seconds) <= most_s, f"at a load of {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors"


def test_quick_verification_adds_little_and_loads_no_compiler(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    """What `make` does after writing: seconds of the processor, and apart from them what its libraries take to load."""
    subprocess.run([command(), *MAIN_JOB, "--no-verify", "-o", str(tmp_path / "kit")], check=True, capture_output=True)

    def once() -> dict[str, float]:
        done = subprocess.run([sys.executable, "-c", _VERIFY], check=True, capture_output=True, cwd=tmp_path / "kit")
        answer: dict[str, float] = json.loads(done.stdout)
        return answer

    runs = [once(), once(), run(benchmark, once, rounds=1)]

    best_s = min(r["best"] for r in runs)
    show("verify --quick as make calls it, libraries loaded, best of 24", best_s, "s", f"<= {MOST_SECONDS_VERIFY:g}")
    show("loading libraries in the first call, best of 3", min(r["first"] - r["best"] for r in runs), "s")
    assert best_s <= MOST_SECONDS_VERIFY
    assert not any(r["compiler"] for r in runs)


def test_large_kit_is_made_and_verified_within_a_minute(
    benchmark: BenchmarkFixture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    stages: dict[str, Timed[..., Any]] = {}

    def watch(module: object, function: str, label: str) -> None:
        stages[label] = Timed(getattr(module, function))
        monkeypatch.setattr(module, function, stages[label])

    watch(make, "examine", "plan, layout and rules")
    watch(make, "render_all", "render_all")
    renderers = {f"  {role}": Timed(render) for role, render in writer.RENDERERS.items()}
    stages.update(renderers)
    monkeypatch.setattr(writer, "RENDERERS", {label.strip(): timed for label, timed in renderers.items()})
    watch(writer, "render_preview", "  previews")
    watch(preview, "read_gerber", "    gerbonara reads for them")
    watch(make, "write_kit", "write")
    watch(verify, "verify_folder", "verify --quick")
    watch(film, "read_gerber", "  gerbonara reads")
    watch(lands, "nearest", "  nearest-neighbour search")
    whole = Timed(lambda: make.make_kit(large_spec(PARTS), tmp_path / "kit"))

    kit = run(benchmark, whole, rounds=1)

    assert kit.tape.part_count >= PARTS
    print(f"\nmake_kit of {kit.tape.part_count} parts, seconds by stage (an indented stage is a part of the one above)")
    for label, timed in stages.items():
        print(f"{label:32s} {sum(timed.seconds):8.3f}")
    show("make_kit with verification, in process", whole.seconds[0], "s", f"< {MOST_SECONDS_LARGE:g}")
    assert whole.seconds[0] < MOST_SECONDS_LARGE


def test_large_kit_as_a_process(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    width_mm, height_mm = large_spec(PARTS).size_mm
    arguments = [command(), *MAIN_JOB, "--origin", "0,0", "--size", f"{width_mm}x{height_mm}"]
    process = Timed(lambda: peak_memory_mb(arguments, tmp_path))
    peak_mb = run(benchmark, process, rounds=1)
    show(f"tactape-fab make of {PARTS} parts, whole process, peak memory", peak_mb, "MB")
    show(f"tactape-fab make of {PARTS} parts, whole process", process.seconds[0], "s", f"< {MOST_SECONDS_LARGE:g}")
    assert process.seconds[0] < MOST_SECONDS_LARGE
