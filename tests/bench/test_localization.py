"""Localization measured: how often a contact is located and right, how often wrong, how exactly, and how fast.

TACTAPE_BENCH_N frames a row (1000), TACTAPE_BENCH_FALSE frames a kind of impostor (10000); TACTAPE_BENCH_JSON names a
file for all figures; TACTAPE_BENCH_ABSOLUTE=1 asserts milliseconds and not only ratios.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tactape_fab.decode.localizer import Localizer, World
from tactape_fab.profiles import load_sensor
from tactape_fab.simulate import SURFACES, iterate_frames

from .localization_accuracy import accuracy_of, reliability_of, tag_frames, times_ms
from .localization_false import (
    COMMON,
    EDGE_SECTORS,
    FALSE,
    IMPOSTORS,
    NEIGHBOURS,
    OVER_THE_EDGE,
    impostor_dots,
    impostor_frames,
    unregistered_dots,
    unregistered_frames,
)
from .localization_measure import WORLDS, localizer_of, measure, too_few, too_many
from .localization_report import Report
from .localization_rows import COUNT, ROWS, SECTOR, Row, frames_of, registered_tape, tape_of
from .measure import Timed, run

MOST_FALSE = 1e-4
MEDIAN_MS = {"open": 0.7, "closed": 0.5}
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


# Located, though it should not be


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("name", [*IMPOSTORS, "own tape mirrored"])
def test_dots_that_carry_no_code_are_not_located(name: str, world: World, benchmark: BenchmarkFixture, report: Report) -> None:
    accepts = run(benchmark, lambda: impostor_dots(localizer_of(1, world), name, FALSE), rounds=1)
    report.accepts(f"{name}, dots, {world} world", accepts)
    assert not too_many(accepts.located, accepts.frames, MOST_FALSE), str(accepts)


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("name", [*IMPOSTORS, "own tape mirrored", *SURFACES])
def test_depth_maps_that_carry_no_code_are_not_located(
    name: str, world: World, benchmark: BenchmarkFixture, report: Report
) -> None:
    accepts = run(benchmark, lambda: impostor_frames(localizer_of(1, world), name, max(FALSE // 5, 100)), rounds=1)
    report.accepts(f"{name}, depth maps, {world} world", accepts)
    assert not too_many(accepts.located, accepts.frames, MOST_FALSE), str(accepts)


def test_tapes_that_nobody_registered_are_not_located(benchmark: BenchmarkFixture, report: Report) -> None:
    """All other sectors in turn, then the one that came nearest again."""
    localizer = localizer_of(1, "open")
    others = tuple(sector for sector in range(256) if sector != SECTOR)
    spread = run(benchmark, lambda: unregistered_dots(localizer, others, max(FALSE, 7 * len(others))), rounds=1)
    report.accepts("other sectors, dots", spread)
    worst = int(spread.worst.split()[-1]) if spread.worst != "-" else SECTOR + 1
    again = unregistered_dots(localizer, (worst,), FALSE, seed=1)
    report.accepts(f"sector {worst}, dots", again)
    frames = unregistered_frames(localizer, others, max(FALSE // 5, len(others)))
    report.accepts("other sectors, depth maps", frames)
    for accepts in (spread, again, frames):
        assert not too_many(accepts.located, accepts.frames, MOST_FALSE), str(accepts)


def test_neighbours_at_a_common_origin_are_not_located(benchmark: BenchmarkFixture, report: Report) -> None:
    localizer = Localizer([tape_of(SECTOR, COMMON)])
    accepts = run(benchmark, lambda: unregistered_dots(localizer, NEIGHBOURS, FALSE, COMMON), rounds=1)
    report.accepts("neighbours at a common origin, dots", accepts)
    assert not too_many(accepts.located, accepts.frames, MOST_FALSE), str(accepts)


@pytest.mark.parametrize("origin", [COMMON, None], ids=["common origin", "default origins"])
def test_neighbours_beneath_dots_beside_the_tape_are_not_located(
    origin: tuple[int, int] | None, benchmark: BenchmarkFixture, report: Report
) -> None:
    localizer = Localizer([tape_of(SECTOR, origin)])
    accepts = run(
        benchmark,
        lambda: unregistered_dots(localizer, EDGE_SECTORS, max(FALSE // 2, 1000), origin, scenes=OVER_THE_EDGE),
        rounds=1,
    )
    report.accepts(f"over the edge beside bumps, {'default origins' if origin is None else 'common origin'}, dots", accepts)
    assert not too_many(accepts.located, accepts.frames, MOST_FALSE), str(accepts)


# Accuracy


def test_errors_are_near_the_bound_and_the_covariance_is_honest(benchmark: BenchmarkFixture, report: Report) -> None:
    accuracy = run(benchmark, lambda: accuracy_of(localizer_of(1, "open"), ROWS[0], COUNT), rounds=1)
    for name in ("rms", "bound", "ratio", "calibration", "dot_px"):
        report.figure(f"default scene, {name}", np.round(getattr(accuracy, name), 4).tolist())
    report.figure("default scene, nees/3", round(accuracy.nees, 3))
    assert accuracy.frames >= 0.99 * COUNT
    spread = 1 + 3 / np.sqrt(2 * accuracy.frames)  # of a measured rms
    assert (accuracy.rms <= np.array([4.0, 4.0, 0.07]) * spread).all()
    assert (accuracy.ratio <= 1.3 * spread).all()
    assert 0.8 / spread**2 <= accuracy.nees <= 1.3 * spread**2
    assert (accuracy.calibration >= 0.7 / spread**2).all() and (accuracy.calibration <= 1.4 * spread**2).all()


@pytest.mark.parametrize("row", [ROWS[0], ROWS[4], ROWS[5]], ids=lambda row: row.name)
def test_posteriors_of_the_bits_are_calibrated(row: Row, benchmark: BenchmarkFixture, report: Report) -> None:
    """Bits are wrong hardly more often than their posteriors say: overconfidence is what would harm."""
    shown = run(benchmark, lambda: reliability_of(row, max(COUNT // 2, 50)), rounds=1)
    for name in ("bits", "said", "true"):
        report.figure(f"reliability, {row.name}, {name}", np.round(getattr(shown, name), 5).tolist())
    enough = shown.bits >= 200
    wrong, expected = 1.0 - shown.true[enough], 1.0 - shown.said[enough]
    spread = 3 * np.sqrt(np.maximum(wrong, 1e-3) / shown.bits[enough])
    assert (wrong <= 1.5 * expected + 2e-3 + spread).all()


# Speed


def test_a_frame_takes_less_than_a_tag_of_the_same_size(benchmark: BenchmarkFixture, report: Report) -> None:
    detector = pytest.importorskip("pupil_apriltags").Detector(families="tag36h11", nthreads=1, quad_decimate=1.0)
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
        # 6.06 ms is AprilTag's figure on the machine that the targets are for
        assert median / tag_ms <= 1.3 * MEDIAN_MS[world] / 6.06, f"{world} world: {median:.3f} ms, a tag {tag_ms:.3f} ms"


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
