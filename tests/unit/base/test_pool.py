"""Functions called in other processes: every answer once, a lost process costs one, none of them is left."""

from __future__ import annotations

import operator
import os
import time
from concurrent.futures import FIRST_COMPLETED, wait
from contextlib import suppress
from pathlib import Path

import pytest

from tactape_fab.base.errors import LostProcessError
from tactape_fab.base.pool import ProcessPool


class _Slow:
    """Garbage that takes the collector a while; no exception gets out of it."""

    def __init__(self) -> None:
        self.me = self

    def __del__(self) -> None:
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            time.sleep(0.01)


def _leave_garbage(sleep_s: float) -> None:
    _Slow()
    time.sleep(sleep_s)


def _drop_signals(sleep_s: float) -> None:
    """For a second no exception gets out of it."""
    slow = _Slow()
    del slow.me, slow
    time.sleep(sleep_s)


def children() -> list[str]:
    """Processes that this one has started and that have not ended."""
    found: list[str] = []
    for task in Path("/proc/self/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # a thread that has ended meanwhile
            found += (task / "children").read_text().split()
    return [pid for pid in found if b"tactape_fab.base.pool" in command_line(pid)]


def command_line(pid: str) -> bytes:
    with suppress(FileNotFoundError, ProcessLookupError):
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    return b""


def test_every_argument_is_answered_once() -> None:
    with ProcessPool(2) as pool:
        assert list(pool.map(operator.neg, range(20))) == [-i for i in range(20)]
        assert len(children()) == 2
    assert children() == []


def test_no_argument_starts_no_process() -> None:
    with ProcessPool(4):
        assert children() == []


def test_a_lost_process_costs_one_answer() -> None:
    with ProcessPool(1) as pool:
        futures = [pool.submit(os._exit, status) for status in (3, 0, 4)] + [pool.submit(operator.neg, 5)]
        for future, status in zip(futures[:3], (3, 0, 4), strict=True):
            with pytest.raises(LostProcessError) as lost:
                future.result()
            assert lost.value.exit_status == status
        assert futures[3].result() == -5
    assert children() == []


def test_an_exception_is_the_callers() -> None:
    with ProcessPool(1) as pool:
        with pytest.raises(ZeroDivisionError):
            pool.submit(operator.truediv, 1, 0).result()
        assert pool.submit(operator.truediv, 1, 2).result() == 0.5


def test_stopping_ends_the_processes_at_once() -> None:
    pool = ProcessPool(2)
    futures = [pool.submit(time.sleep, s) for s in (0.0, 60.0, 60.0)]
    wait(futures, return_when=FIRST_COMPLETED)
    begin = time.monotonic()
    pool.stop()
    assert time.monotonic() - begin < 10.0
    assert children() == []


def test_stopping_ends_a_process_whose_collector_is_at_work() -> None:
    pool = ProcessPool(1)
    pool.submit(_leave_garbage, 0.0).result()
    time.sleep(0.2)
    begin = time.monotonic()
    pool.stop()
    assert time.monotonic() - begin < 10.0
    assert children() == []


def test_a_signal_that_python_drops_ends_a_process_without_a_word(capfd: pytest.CaptureFixture[str]) -> None:
    pool = ProcessPool(1)
    pool.submit(operator.neg, 1).result()
    pool.submit(_drop_signals, 60.0)
    time.sleep(0.3)
    begin = time.monotonic()
    pool.stop()
    assert time.monotonic() - begin < 10.0  # the process ends by itself: it is killed after twenty seconds
    assert children() == []
    assert capfd.readouterr() == ("", "")


def test_what_a_function_prints_is_no_answer(capfd: pytest.CaptureFixture[str]) -> None:
    with ProcessPool(1) as pool:
        assert pool.submit(print, "words").result() is None
    assert capfd.readouterr() == ("", "words\n")
