"""The solid models: against the idiomatic way with a CAD kernel in the same run, and their cost by the number of parts.

What is compared runs in processes of its own, each of which imports only what it needs.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tactape_fab import Tape, TapeSpec
from tactape_fab.solids.forms import Cylinder, SolidForm
from tactape_fab.solids.mesh.sheet import texture_mesh
from tactape_fab.solids.mesh.triangles import stl_bytes, threemf_bytes
from tactape_fab.solids.step.assembly import assembly_step
from tactape_fab.solids.step.solid import solid_step
from tests.bench.measure import Timed, command, large_spec, peak_memory_mb, planned, run, show
from tests.bench.solid_peers import OURS, READ, answer, with_build123d
from tests.solids import DATE, step_of

PARTS = 100_000
SIZES = (2_000, 10_000, 50_000, 100_000)
REFERENCE_SIZE = 10_000
MOST_GROWTH = 2.0
RUNS = 5
BOARD_RGB, PART_RGB = (0.8, 0.5, 0.1), (0.1, 0.1, 0.1)


def load() -> str:
    return f"at a load of {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors"


@pytest.fixture(scope="module")
def main_job() -> Tape:
    tape = planned(TapeSpec(sector=7))
    assert tape.part_count == 1984
    return tape


@pytest.fixture(scope="module")
def tapes() -> dict[int, Tape]:
    return {size: planned(large_spec(size)) for size in SIZES}


@pytest.fixture(scope="module")
def both(main_job: Tape, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The main job's solid written by build123d and by us: files, seconds and megabytes."""
    folder = tmp_path_factory.mktemp("solids")
    (folder / "tape.json").write_text(json.dumps(main_job.to_mapping()), encoding="ascii")
    files = {name: str(folder / f"{name}.step") for name in ("peer", "ours")}
    arguments = [str(folder / "tape.json"), files["ours"]]
    result: dict[str, Any] = {"files": files}
    result["ours"] = answer(OURS, *arguments, str(RUNS))
    result["ours_mb"] = peak_memory_mb([sys.executable, "-c", OURS, *arguments, "1"], folder)
    result["peer"] = with_build123d(main_job, Path(files["peer"]))
    result["peer_mb"] = result["peer"]["peak_mb"]
    return result


def test_a_solid_is_written_five_hundred_times_faster(benchmark: BenchmarkFixture, main_job: Tape, both: dict[str, Any]) -> None:
    timed = Timed(lambda: step_of(main_job, SolidForm()))
    run(benchmark, timed, rounds=RUNS)
    peer_s = both["peer"]["build_s"] + both["peer"]["export_s"]
    our_s = both["ours"]["write_s"]
    show("step-solid of 1,984 blocks, build123d fuse", both["peer"]["build_s"], "s")
    show("step-solid of 1,984 blocks, build123d export", both["peer"]["export_s"], "s")
    show("step-solid of 1,984 blocks, tactape-fab to a file", our_s * 1000, "ms")
    show("step-solid of 1,984 blocks, tactape-fab, first in its process", both["ours"]["first_s"] * 1000, "ms")
    show("step-solid of 1,984 blocks, tactape-fab to bytes, in this process", min(timed.seconds) * 1000, "ms")
    show("step-solid, build123d / tactape-fab, time", peer_s / our_s, "times", ">= 500")
    assert peer_s >= 500 * our_s, load()


def test_a_solid_is_four_times_smaller(benchmark: BenchmarkFixture, main_job: Tape, both: dict[str, Any]) -> None:
    sizes = run(benchmark, lambda: {name: Path(path).stat().st_size for name, path in both["files"].items()}, rounds=1)
    show("step-solid, build123d / tactape-fab, size", sizes["peer"] / sizes["ours"], "times", ">= 4")
    show("step-solid, size of a block", sizes["ours"] / main_job.part_count, "bytes", "<= 3900")
    assert sizes["peer"] >= 4 * sizes["ours"]
    assert sizes["ours"] <= 3900 * main_job.part_count


def test_a_solid_needs_a_tenth_of_the_memory(benchmark: BenchmarkFixture, both: dict[str, Any]) -> None:
    run(benchmark, lambda: None, rounds=1)
    show("step-solid, peak memory of the process, build123d", both["peer_mb"], "MB")
    show("step-solid, peak memory of the process, tactape-fab", both["ours_mb"], "MB")
    show("step-solid, build123d / tactape-fab, memory", both["peer_mb"] / both["ours_mb"], "times", ">= 10")
    assert both["peer_mb"] >= 10 * both["ours_mb"]


def test_a_solid_opens_five_times_faster(benchmark: BenchmarkFixture, both: dict[str, Any]) -> None:
    ours = [run(benchmark, lambda: answer(READ, both["files"]["ours"]), rounds=1), answer(READ, both["files"]["ours"])]
    peer = answer(READ, both["files"]["peer"])
    assert {reading["solids"] for reading in (*ours, peer)} == {1}
    our_s = min(reading["read_s"] for reading in ours)
    show("step-solid opened by OCCT, of build123d", peer["read_s"], "s")
    show("step-solid opened by OCCT, of tactape-fab", our_s, "s")
    show("step-solid opened by OCCT, build123d / tactape-fab", peer["read_s"] / our_s, "times", ">= 5")
    assert peer["read_s"] >= 5 * our_s, load()


def test_an_assembly_is_written_at_once(benchmark: BenchmarkFixture, main_job: Tape) -> None:
    timed = Timed(lambda: assembly_step(main_job, name="t", date=DATE, board_rgb=BOARD_RGB, part_rgb=PART_RGB))
    data = run(benchmark, timed, rounds=RUNS)
    show("step-assembly of 1,984 occurrences", min(timed.seconds) * 1000, "ms", "<= 50")
    show("step-assembly, size of an occurrence", len(data) / main_job.part_count, "bytes", "<= 480")
    assert min(timed.seconds) <= 0.05, load()
    assert len(data) <= 480 * main_job.part_count


@pytest.mark.parametrize("radius_mm", [16.0, 25.0, 50.0])
def test_a_solid_on_a_cylinder(benchmark: BenchmarkFixture, main_job: Tape, radius_mm: float) -> None:
    form = SolidForm(cylinder=Cylinder(radius_mm=radius_mm))
    step = Timed(lambda: solid_step(main_job, form, name="t", date=DATE, rgb=PART_RGB))
    data = run(benchmark, step, rounds=RUNS)
    mesh = Timed(lambda: texture_mesh(main_job, form))
    faces = len(mesh().faces)
    show(f"step-solid round R = {radius_mm:g} mm", min(step.seconds) * 1000, "ms", "<= 800")
    show(f"step-solid round R = {radius_mm:g} mm, size of a block", len(data) / main_job.part_count, "bytes")
    show(f"mesh round R = {radius_mm:g} mm, {faces} triangles", mesh.seconds[0] * 1000, "ms")
    assert min(step.seconds) <= 0.8, load()


def test_a_hundred_thousand_blocks(benchmark: BenchmarkFixture, tapes: dict[int, Tape], tmp_path: Path) -> None:
    tape = tapes[PARTS]
    (tmp_path / "tape.json").write_text(json.dumps(tape.to_mapping()), encoding="ascii")
    arguments = [str(tmp_path / "tape.json"), str(tmp_path / "tape.step"), "1"]
    seconds = run(benchmark, lambda: answer(OURS, *arguments), rounds=1)["write_s"]
    peak_mb = peak_memory_mb([sys.executable, "-c", OURS, *arguments], tmp_path)
    size = (tmp_path / "tape.step").stat().st_size
    show(f"step-solid of {tape.part_count} blocks to a file", seconds, "s", "<= 5")
    show(f"step-solid of {tape.part_count} blocks, peak memory of the process", peak_mb, "MB", "< 600")
    show(f"step-solid of {tape.part_count} blocks, size of a block", size / tape.part_count, "bytes", "<= 4200")
    assert seconds <= 5.0, load()
    assert peak_mb < 600
    assert size <= 4200 * tape.part_count  # names of a digit more


def test_a_mesh_of_a_hundred_thousand_blocks(benchmark: BenchmarkFixture, tapes: dict[int, Tape]) -> None:
    timed = Timed(lambda: texture_mesh(tapes[PARTS], SolidForm()))
    mesh = run(benchmark, timed, rounds=3)
    stl, threemf = Timed(stl_bytes), Timed(threemf_bytes)
    show(f"mesh of {PARTS} blocks, {len(mesh.faces)} triangles", min(timed.seconds), "s", "<= 1")
    show("its STL", len(stl(mesh, "t")) / 1e6, "MB")
    show("its STL", stl.seconds[0], "s")
    show("its 3MF", len(threemf(mesh, "t", {}, DATE)) / 1e6, "MB")
    show("its 3MF", threemf.seconds[0], "s")
    assert min(timed.seconds) <= 1.0, load()


def test_cost_of_models_is_linear(benchmark: BenchmarkFixture, tapes: dict[int, Tape]) -> None:
    writers: dict[str, Timed[[Tape], Any]] = {
        "step-solid": Timed(lambda tape: step_of(tape, SolidForm())),
        "step-assembly": Timed(lambda tape: assembly_step(tape, name="t", date=DATE, board_rgb=BOARD_RGB, part_rgb=PART_RGB)),
        "mesh": Timed(lambda tape: texture_mesh(tape, SolidForm())),
    }
    best: dict[str, dict[int, float]] = {name: {} for name in writers}
    for name, writer in writers.items():
        for size in SIZES:
            writer.seconds.clear()
            for _ in range(2 if size == SIZES[-1] else 4):
                writer(tapes[size])
            best[name][size] = min(writer.seconds) / tapes[size].part_count * 1e6
    run(benchmark, lambda: writers["mesh"](tapes[SIZES[0]]), rounds=1)
    print("\n   parts  " + "  ".join(f"{name:>22}" for name in writers))
    for size in SIZES:
        print(f"{size:8d}  " + "  ".join(f"{best[name][size]:15.2f} us/part" for name in writers))
    for name in writers:
        growth = max(best[name][size] for size in SIZES[2:]) / best[name][REFERENCE_SIZE]
        show(f"{name}, time of a part at 50,000 and 100,000 / at {REFERENCE_SIZE}", growth, "times", f"<= {MOST_GROWTH:g}")
        assert growth <= MOST_GROWTH, load()


def test_models_add_little_to_make(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    numbers = count()

    def make(*options: str) -> None:
        folder = tmp_path / str(next(numbers))
        folder.mkdir()
        arguments = ["make", "--sector", "7", *options]
        subprocess.run([command(), *arguments], check=True, capture_output=True, cwd=folder)

    with_models, without = Timed(make), Timed(lambda: make("--no-3d"))
    run(benchmark, with_models, rounds=2 * RUNS, before=without)
    added = min(with_models.seconds) - min(without.seconds)
    show("make, best", min(with_models.seconds), "s")
    show("make --no-3d, best", min(without.seconds), "s")
    show("models of the main job add to make", added, "s", "<= 0.7")
    assert added <= 0.7, load()
