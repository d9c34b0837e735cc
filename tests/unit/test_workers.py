"""One function in several processes: every answer once, a lost process costs one, none of them is left."""

from __future__ import annotations

import operator
import os
import time
from contextlib import closing
from multiprocessing import active_children

from tactape_fab.workers import Lost, answers


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


def test_every_argument_is_answered_once() -> None:
    with closing(answers(operator.neg, range(20), 2)) as results:
        assert sorted(results) == [(i, -i) for i in range(20)]
    assert active_children() == []


def test_no_argument_starts_no_process() -> None:
    with closing(answers(operator.neg, [], 4)) as results:
        assert list(results) == []
        assert active_children() == []


def test_a_lost_process_costs_one_answer() -> None:
    with closing(answers(os._exit, [3, 0, 4], 1)) as results:
        assert list(results) == [(i, Lost(exit_status=status)) for i, status in enumerate((3, 0, 4))]
    assert active_children() == []


def test_closing_ends_the_processes_at_once() -> None:
    with closing(answers(time.sleep, [0.0, 60.0, 60.0], 2)) as results:
        assert next(results) == (0, None)
        assert len(active_children()) == 2
        begin = time.monotonic()
    assert time.monotonic() - begin < 10.0
    assert active_children() == []


def test_closing_ends_a_process_whose_collector_is_at_work() -> None:
    with closing(answers(_leave_garbage, [0.0, 60.0], 1)) as results:
        assert next(results) == (0, None)
        time.sleep(0.2)
        begin = time.monotonic()
    assert time.monotonic() - begin < 10.0
    assert active_children() == []
