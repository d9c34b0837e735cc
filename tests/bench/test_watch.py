"""How late `watch` is on a replay of 1,000 frames, how many it could do, and its memory over 10,000.

Rates that are asserted are of processor time, both threads together; latencies are of the clock, and of the machine's other work.
TACTAPE_BENCH_ABSOLUTE=1 asserts those as well.
"""

from __future__ import annotations

import gc
import json
import os
import re
import subprocess
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from threading import Event
from time import process_time

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tactape_fab import Kit, Tape
from tactape_fab.sense import load_sensor, simulate_frames, text_message
from tactape_fab.sense.files.depth_maps import FrameFile, open_frame_file
from tactape_fab.sense.files.jobs import Job, Located
from tactape_fab.sense.live.counts import Tally
from tactape_fab.sense.live.mcap_log import McapLog
from tactape_fab.sense.live.replay import replay
from tactape_fab.sense.live.sources import Frame, Source, Trouble
from tactape_fab.sense.live.watch import Watch, watch
from tests.bench.measure import command, run, show

COUNT, DIFFERENT = 1000, 100
MANY = 10_000
HZ = 100.0
MOST_P50_MS, MOST_P99_MS = 6.0, 10.0
MOST_GROWTH_MB = 4.0
MOST_INDEX_BYTES = 2000
SUMMARY = re.compile(r"located (\d+) of (\d+) frames at ([\d.]+) Hz; latency p50 ([\d.]+) ms, p99 ([\d.]+) ms")
ABSOLUTE = os.environ.get("TACTAPE_BENCH_ABSOLUTE") == "1"


@pytest.fixture(scope="module")
def recording(default_kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A thousand frames, 0.01 s apart."""
    depth = simulate_frames(default_kit.tape, DIFFERENT, seed=1).depth
    path = tmp_path_factory.mktemp("recording") / "frames.npz"
    np.savez(path, depth=np.concatenate([depth] * (COUNT // DIFFERENT)), timestamp=np.arange(COUNT) / HZ)
    return path


def job(tape: Tape) -> Job:
    return Job(files=(), sensor=load_sensor("gelsight-mini"), tapes=[tape], code=None, settings={})


def resident_mb() -> float:
    """Memory of this process now, 10^6 bytes."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def again(file: FrameFile, times: int) -> Source:
    """A file over and over."""

    def source(stop: Event) -> Iterator[Frame | Trouble]:
        for _ in range(times):
            yield from replay(file, float("inf"))(stop)

    return source


def test_a_replay_at_a_hundred_frames_a_second(benchmark: BenchmarkFixture, default_kit: Kit, recording: Path) -> None:
    """The command as a user runs it, its answers in a file."""
    arguments = [command(), "watch", str(recording), "--tape", str(default_kit.path), "--json"]

    def whole() -> str:
        with (recording.parent / "answers.jsonl").open("wb") as stream:
            return subprocess.run(arguments, stdout=stream, stderr=subprocess.PIPE, check=True, encoding="utf-8").stderr

    said = run(benchmark, whole, rounds=1)
    found = SUMMARY.search(said)
    assert found is not None, said
    located, answered, hz, p50_ms, p99_ms = (float(value) for value in found.groups())
    dropped = COUNT - int(answered)
    show("1,000 frames at 100 Hz: answered", answered, "", "= 1000")
    show("located", located, "")
    show("dropped", dropped, "", "= 0")
    show("rate", hz, "Hz", ">= 99")
    show("latency p50", p50_ms, "ms", f"<= {MOST_P50_MS:g}")
    show("latency p99", p99_ms, "ms", f"<= {MOST_P99_MS:g}")
    answers = [json.loads(line) for line in (recording.parent / "answers.jsonl").read_text().splitlines()]
    assert len(answers) == answered and sum(answer["located"] for answer in answers) == located >= 0.99 * answered
    assert [answer["timestamp"] for answer in answers] == [answer["frame"] / HZ for answer in answers]
    if ABSOLUTE:
        assert dropped == 0 and hz >= 99.0
        assert p50_ms <= MOST_P50_MS and p99_ms <= MOST_P99_MS


def test_what_it_could_do(benchmark: BenchmarkFixture, default_kit: Kit, recording: Path) -> None:
    """Frames in a second of one processor: read, located, made to JSON; and the same with an MCAP file beside it."""
    file = open_frame_file(recording)
    watched = Watch(job=job(default_kit.tape), source=replay(file, float("inf")))

    def whole(log: McapLog | None) -> float:
        found = watch(watched, Tally(), Event())
        first = next(located for located in found if located is not None)
        start, count = process_time(), 0
        for located in found:
            if located is not None:
                text_message(located.frame, located.fix)
                count += 1
                if log is not None:
                    log.write(located)
        assert first.fix.located and count == COUNT - 1
        return count / (process_time() - start)

    hz = run(benchmark, lambda: whole(None), rounds=1)
    show("frames in a second of a processor", hz, "Hz", f">= {HZ:g}")
    with McapLog(recording.parent / "touch.mcap") as log:
        logged_hz = whole(log)
    (recording.parent / "touch.mcap").unlink()
    show("with --mcap", logged_hz, "Hz", f">= {HZ:g}")
    assert hz >= HZ and logged_hz >= HZ


@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="resident memory is read from /proc/self/statm, which is not here"
)
def test_memory_over_ten_thousand_frames(benchmark: BenchmarkFixture, default_kit: Kit, recording: Path) -> None:
    """Resident memory after a thousand frames, and after ten thousand."""
    file = open_frame_file(recording)
    watched = Watch(job=job(default_kit.tape), source=again(file, MANY // COUNT))

    def whole() -> tuple[float, float]:
        tally, used_mb = Tally(), []
        for located in watch(watched, tally, Event()):
            if located is not None:
                text_message(located.frame, located.fix)
                if tally.answered in (COUNT, MANY - 1):
                    used_mb.append(resident_mb())
        assert (tally.answered, tally.dropped) == (MANY, 0)
        return used_mb[0], used_mb[1]

    after_some, after_many = run(benchmark, whole, rounds=1)
    show("memory after 1,000 frames", after_some, "MB")
    show("growth over the next 9,000", after_many - after_some, "MB", f"<= {MOST_GROWTH_MB:g}")
    assert after_many - after_some <= MOST_GROWTH_MB


def test_what_an_mcap_file_keeps_in_memory(benchmark: BenchmarkFixture, default_kit: Kit, recording: Path) -> None:
    """Its index is written at the end: bytes for each frame until then."""
    file = open_frame_file(recording)
    sensor = load_sensor("gelsight-mini")
    found = watch(Watch(job=job(default_kit.tape), source=replay(file, float("inf"))), Tally(), Event())
    fix = next(located.fix for located in found if located is not None and located.fix.timestamp is not None)
    depth = next(iter(file.frames()))
    located = Located(frame=1, depth=depth, sensor=sensor, fix=fix)
    used = []

    def whole() -> None:
        with McapLog(recording.parent / "index.mcap") as log:
            tracemalloc.start()
            for k in range(220):
                if k % 100 == 20:
                    used.append(tracemalloc.get_traced_memory()[0])
                log.write(located)
            tracemalloc.stop()
        (recording.parent / "index.mcap").unlink()

    run(benchmark, whole, rounds=1)
    each = (used[-1] - used[0]) / 100 / (len(used) - 1)
    show("index of an MCAP file", each, "bytes a frame", f"<= {MOST_INDEX_BYTES}")
    assert each <= MOST_INDEX_BYTES
