"""Localization measured: how often a contact is located and right, how often wrong, how exactly, and how fast.

TACTAPE_BENCH_N frames a row (1000), TACTAPE_BENCH_FALSE frames a kind of impostor (10000); TACTAPE_BENCH_JSON names a
file for all figures; TACTAPE_BENCH_ABSOLUTE=1 asserts milliseconds and not only ratios. False accepts at full size are
counted by `python -m tests.bench.false_accepts`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Barrier
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tactape_fab import Localizer
from tactape_fab.sense import Scene, iterate_frames, load_sensor
from tactape_fab.sense.decode.result import Refined
from tactape_fab.sense.geometry import Geometry
from tests.bench.false_accepts import SECTORS_DOTS, bound_of, by_subject, plan, worst_jobs
from tests.bench.false_tally import DECADES, Tally, total
from tests.bench.localization_accuracy import accuracy_of, reliability_of, tag_detector, tag_frames, times_ms, turns_of
from tests.bench.localization_false import Job, count
from tests.bench.localization_measure import WORLDS, localizer_of, measure, measure_code, too_few, too_many
from tests.bench.localization_report import Report
from tests.bench.localization_rows import CODE_ROWS, COUNT, ROWS, Row, frames_of, registered_tape
from tests.bench.measure import Timed, run
from tests.bench.stages import measured

MOST_FALSE = 1e-4
MEDIAN_MS = {"open": 0.7, "closed": 0.5}
CALIBRATED = ("contact 11x9", "noise x2", "blur 0.25 mm", "30 % parts missing", "6x6", "5x5")
FALSE = int(os.environ.get("TACTAPE_BENCH_FALSE", "10000"))
ABSOLUTE = os.environ.get("TACTAPE_BENCH_ABSOLUTE") == "1"


@pytest.fixture(scope="module")
def report() -> Iterator[Report]:
    collected = Report()
    yield collected
    collected.write()


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_contacts_are_located_and_right(row: Row, benchmark: BenchmarkFixture, report: Report) -> None:
    figures = run(benchmark, lambda: measure(row), rounds=1)
    report.row(row, figures)
    for world in WORLDS:
        shown = figures[world]
        asked = row.target if row.target is not None else 0.9 * shown.limit_rate
        assert shown.wrong == 0, f"{row.name}, {world} world: {shown.wrong} of {shown.frames} located at a wrong place"
        assert not too_few(shown.right, shown.frames, asked), (
            f"{row.name}, {world} world: {shown.right} of {shown.frames} located and right, asked are {100 * asked:.1f} %"
        )


@pytest.mark.parametrize("row", CODE_ROWS, ids=lambda row: row.name)
def test_large_contacts_are_located_from_the_code_alone(row: Row, benchmark: BenchmarkFixture, report: Report) -> None:
    shown = run(benchmark, lambda: measure_code(row), rounds=1)
    report.row(row, {"code": shown})
    asked = row.target or 1.0
    assert shown.wrong == 0, f"{row.name}: {shown.wrong} of {shown.frames} located at a wrong place"
    assert not too_few(shown.right, shown.frames, asked), (
        f"{row.name}: {shown.right} of {shown.frames} located and right, asked are {100 * asked:.1f} %"
    )


# Located, though it should not be

PLAN = plan(max(FALSE // 255, 8), FALSE)
KINDS = sorted({job.kind for job in PLAN})


def not_too_often(kind: str, tally: Tally) -> None:
    """Located at most as often as the rule says; p_tape of what is no code is small at most as often as a bound may be."""
    assert not too_many(tally.located, tally.frames, MOST_FALSE), f"{kind}: {tally}, {tally.accepted}"
    if bound_of(kind) == "p_tape":
        for k, frames in enumerate(tally.decades["p_tape"][: DECADES // 2], 1):
            assert not too_many(frames, tally.frames, 10.0**-k), f"{kind}: p_tape <= 1e-{k} in {frames} of {tally.frames}"


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != SECTORS_DOTS])
def test_what_is_not_registered_is_not_located(kind: str, benchmark: BenchmarkFixture, report: Report) -> None:
    tally = run(benchmark, lambda: total(count(job) for job in PLAN if job.kind == kind), rounds=1)
    report.tally(kind, tally)
    not_too_often(kind, tally)


def test_tapes_that_nobody_registered_are_not_located(benchmark: BenchmarkFixture, report: Report) -> None:
    """All other sectors in turn as dots, then the one that came nearest through depth maps."""
    done: dict[Job, Tally] = {}
    run(benchmark, lambda: done.update((job, count(job)) for job in PLAN if job.kind == SECTORS_DOTS), rounds=1)
    spread = total(by_subject(done, SECTORS_DOTS).values())
    report.tally(SECTORS_DOTS, spread)
    jobs = worst_jobs(done, FALSE)
    again = total(map(count, jobs))
    report.tally(f"{jobs[0].subject}, depth maps", again)
    for tally in (spread, again):
        not_too_often(SECTORS_DOTS, tally)


# Accuracy


CALIBRATED_CAMERA = Geometry(sigma_px_per_mm=0.008, sigma_aspect=0.0005, sigma_shear=0.0005, sigma_k1=0.002)


@pytest.mark.parametrize(
    ("camera", "theta_deg", "theta_ratio"),
    # the bound is for a known camera: the turn of the image's rows is less exact where nobody measured the shear
    [(Geometry(), 0.09, 1.6), (CALIBRATED_CAMERA, 0.07, 1.3)],
    ids=["stock profile", "calibrated camera"],
)
def test_errors_are_near_the_bound_and_the_covariance_is_honest(
    camera: Geometry, theta_deg: float, theta_ratio: float, benchmark: BenchmarkFixture, report: Report
) -> None:
    localizer = Localizer([registered_tape()], replace(load_sensor("gelsight-mini"), geometry=camera))
    accuracy = run(benchmark, lambda: accuracy_of(localizer, ROWS[0], COUNT), rounds=1)
    scene = "default scene" if camera == Geometry() else "default scene, calibrated camera"
    for name in ("rms", "bound", "ratio", "calibration", "dot_px"):
        report.figure(f"{scene}, {name}", np.round(getattr(accuracy, name), 4).tolist())
    report.figure(f"{scene}, nees/3", round(accuracy.nees, 3))
    assert accuracy.frames >= 0.99 * COUNT
    spread = 1 + 3 / np.sqrt(2 * accuracy.frames)  # of a measured rms
    assert (accuracy.rms <= np.array([4.0, 4.0, theta_deg]) * spread).all()
    assert (accuracy.ratio <= np.array([1.3, 1.3, theta_ratio]) * spread).all()
    assert 0.8 / spread**2 <= accuracy.nees <= 1.3 * spread**2
    assert (accuracy.calibration >= 0.7 / spread**2).all() and (accuracy.calibration <= 1.4 * spread**2).all()


@pytest.mark.parametrize("row", [row for row in ROWS if row.name in CALIBRATED], ids=lambda row: row.name)
def test_posteriors_of_the_bits_are_calibrated(row: Row, benchmark: BenchmarkFixture, report: Report) -> None:
    """Bits are wrong hardly more often than their posteriors say: overconfidence is what would harm."""
    shown = run(benchmark, lambda: reliability_of(row, max(COUNT // 2, 50)), rounds=1)
    for name in ("bits", "said", "true"):
        report.figure(f"reliability, {row.name}, {name}", np.round(getattr(shown, name), 5).tolist())
    enough = shown.bits >= 200
    wrong, expected = 1.0 - shown.true[enough], 1.0 - shown.said[enough]
    spread = 3 * np.sqrt(np.maximum(wrong, 1e-3) / shown.bits[enough])
    assert (wrong <= 1.5 * expected + 2e-3 + spread).all()


def test_the_turns_that_elongations_name_are_calibrated(benchmark: BenchmarkFixture, report: Report) -> None:
    """Wrong no more often than said, in frames like those of the table and in some that are far worse."""
    like = [row for row in ROWS if row.name in (*CALIBRATED, "strip 4.5 mm", "scale off by 6 %")]
    worse = [Row(name="", scenes=(Scene(noise=4.0), Scene(noise=6.0), Scene(elastomer_mm=0.35)))]
    count = max(COUNT // 10, 20)
    usual = run(benchmark, lambda: turns_of(like, count), rounds=1)
    for name, shown in (("rows", usual), ("worse", turns_of(worse, 6 * count))):
        for figure in ("frames", "wrong", "said"):
            report.figure(f"turns by elongation, {name}, {figure}", np.round(getattr(shown, figure), 4).tolist())
        spread = 3 * np.sqrt(np.maximum(shown.said * (1.0 - shown.said), 1e-3) / np.maximum(shown.frames, 1))
        assert (shown.wrong <= shown.said + spread).all()
    assert usual.frames[-1] > 0.9 * count * len(like)


# Speed


def test_a_frame_takes_less_than_a_tag_of_the_same_size(benchmark: BenchmarkFixture, report: Report) -> None:
    pytest.importorskip("pupil_apriltags")
    detector = tag_detector()
    frames = [frame.depth for frame in frames_of(ROWS[0], 100)]
    report.figure("load average", [round(v, 2) for v in os.getloadavg()])
    tags = tag_frames(20)
    found = sum(len(detector.detect(tag)) for tag in tags)
    assert found == len(tags)
    tag_ms = float(np.median(times_ms(detector.detect, tags, 5)))
    report.figure("AprilTag 3, 320x240, median ms", round(tag_ms, 3))
    medians = {}
    for world in WORLDS:
        times = times_ms(localizer_of(1, world).locate, frames, 5)
        medians[world] = float(np.median(times))
        report.figure(f"{world} world, 320x240, p50 p95 p99 ms", np.percentile(times, [50, 95, 99]).round(3).tolist())
        if ABSOLUTE:
            assert medians[world] <= MEDIAN_MS[world]
            assert np.percentile(times, 99) <= 1.0
    run(benchmark, lambda: localizer_of(1, "open").locate(frames[0]), rounds=50)
    for world, median in medians.items():
        # 6.06 ms is AprilTag's figure on the machine that the targets are for; on a slower one the ratio decides
        kept = median <= MEDIAN_MS[world] or median / tag_ms <= 1.3 * MEDIAN_MS[world] / 6.06
        assert kept, f"{world} world: {median:.3f} ms, a tag {tag_ms:.3f} ms"


@pytest.mark.parametrize("refine", ["dots", "pixels"])
def test_python_calls_few_kernels(refine: Refined, benchmark: BenchmarkFixture, report: Report) -> None:
    """Between two kernels a thread waits for all others, so they are counted; the table is that of docs/localization.md."""
    localizer, frames = Localizer([registered_tape()], refine=refine), [frame.depth for frame in frames_of(ROWS[0], 10)]
    stages = run(benchmark, lambda: measured(localizer, frames, 10), rounds=1)
    whole, inside, calls = np.sum(list(stages.values()), axis=0)
    report.figure(f"{refine}: kernels a frame, µs in them, us in Python", [round(calls, 1), round(inside), round(whole - inside)])
    assert calls <= (25 if refine == "dots" else 33)
    assert whole - inside <= 1.5 * (1 if refine == "dots" else 2) * inside


def test_many_tapes_and_large_frames_take_little_longer(benchmark: BenchmarkFixture, report: Report) -> None:
    tape = registered_tape()
    frames = [frame.depth for frame in frames_of(ROWS[0], 40)]
    one = float(np.median(times_ms(localizer_of(1, "open").locate, frames, 3)))
    many = float(np.median(times_ms(localizer_of(256, "open").locate, frames, 1)))
    sensor = replace(load_sensor("gelsight-mini"), width_px=640, height_px=480, px_per_mm=(32.0, 32.0), correlated_px=12.0)
    large = Localizer([tape], sensor)
    big_frames = [frame.depth for frame in iterate_frames(tape, 40, 3, sensor)]
    big = run(benchmark, lambda: float(np.median(times_ms(large.locate, big_frames, 3))), rounds=1)
    report.figure("256 tapes, median ms", round(many, 3))
    report.figure("640x480, median ms", round(big, 3))
    # targets 0.7, 1.5 and 2 ms
    assert many <= 1.3 * one * 1.5 / 0.7
    assert big <= 1.3 * one * 2.0 / 0.7
    if ABSOLUTE:
        assert many <= 1.5 and big <= 2.0


def test_a_localizer_is_ready_within_a_second(benchmark: BenchmarkFixture, report: Report) -> None:
    seconds = Timed(lambda: Localizer([registered_tape()]))
    run(benchmark, seconds, rounds=3)
    report.figure("Localizer ready, s", round(max(seconds.seconds), 3))
    assert max(seconds.seconds) <= 1.0


def test_the_first_start_ever_takes_ten_seconds_of_processor_time(
    benchmark: BenchmarkFixture, report: Report, tmp_path: Path
) -> None:
    """The whole process, with every child that it starts: what compiling costs, however many cores there are."""

    def ready() -> tuple[dict[str, Any], str]:
        command = [sys.executable, "-m", "tests.bench.first_start", "--here"]
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
        done = subprocess.run(command, env=environment, check=True, capture_output=True, encoding="utf-8")
        return json.loads(done.stdout), done.stderr

    first, word = run(benchmark, ready, rounds=1)
    again, silence = ready()
    first_s, again_s = first["all"], again["all"]
    report.figure("Localizer ready, first time ever and in a new process, processor s", [round(first_s, 1), round(again_s, 2)])
    assert "compiles its decoder" in word and silence == ""
    assert first["kernels"] and not again["kernels"]
    assert again_s <= 0.3 * first_s
    if ABSOLUTE:
        assert first_s <= 10.0


def _decode_together(meeting: Barrier, seconds: Queue[float]) -> None:
    """What one of some processes does: a Localizer of its own, then the frames at the same time as the others."""
    localizer, frames = Localizer([registered_tape()]), [frame.depth for frame in frames_of(ROWS[0], 40)]
    for _ in range(5):
        meeting.wait()
        start = perf_counter()
        for _ in range(5):
            for frame in frames:
                localizer.locate(frame)
        seconds.put(perf_counter() - start)


def _seconds_together(processes: int) -> float:
    """Least seconds that the slowest of some processes takes for its frames, on the clock."""
    context = get_context("spawn")
    meeting, seconds = context.Barrier(processes), context.Queue()
    all_of_them: list[BaseProcess] = [context.Process(target=_decode_together, args=(meeting, seconds)) for _ in range(processes)]
    for process in all_of_them:
        process.start()
    found: list[float] = [max(seconds.get() for _ in range(processes)) for _ in range(5)]
    for process in all_of_them:
        process.join()
    return min(found)


def test_processes_decode_more_frames_than_one(benchmark: BenchmarkFixture, report: Report) -> None:
    """N processes against one, the best try counts; `tests.bench.threads` has the same of threads."""
    cores = len(os.sched_getaffinity(0))
    if cores < 2:
        pytest.skip("one core")
    localizer, depth = Localizer([registered_tape()]), next(frames_of(ROWS[0], 1)).depth
    processes = cores * _seconds_together(1) / _seconds_together(cores)
    run(benchmark, lambda: localizer.locate(depth), rounds=20)
    report.figure(f"{cores} processes, times the frames of one", round(processes, 2))
    assert processes > 1.2
    if ABSOLUTE:
        assert processes >= 0.9 * cores
