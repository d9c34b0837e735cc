"""Functions mapped over many things: the same results in the same order whoever works, a dead worker costs a second try."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from tactape_fab.base.errors import LostProcessError, Problem, TactapeError
from tactape_fab.base.pool import Workers, checked_workers, mapped, mapped_as_done, usual_workers
from tests.unit.base.test_pool import children


def drawn(seed: int) -> bytes:
    """Bytes that belong to an item, after a time that does not."""
    time.sleep(random.random() / 50)
    return random.Random(seed).randbytes(64)


def dies_once(marks: Path, item: int) -> int:
    """Kill the process that works on each third item for the first time."""
    mark = marks / str(item)
    if item % 3 == 0 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return -item


def dies(item: int) -> int:
    """Kill whichever process works on item 1."""
    if item == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return -item


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_results_are_the_same_bytes_whoever_works(workers: Workers) -> None:
    assert b"".join(mapped(drawn, range(24), workers)) == b"".join(random.Random(i).randbytes(64) for i in range(24))
    assert children() == []


def test_results_come_as_they_are_done() -> None:
    found = dict(mapped_as_done(drawn, range(10), 2))
    assert found == {i: random.Random(i).randbytes(64) for i in range(10)}


def test_a_killed_process_costs_its_item_a_second_try(tmp_path: Path) -> None:
    assert list(mapped(partial(dies_once, tmp_path), range(8), 2)) == [-i for i in range(8)]


def test_an_item_that_kills_twice_is_the_callers() -> None:
    def lost(item: int, error: LostProcessError) -> int:
        assert error.exit_status == -signal.SIGKILL
        return 100 + item

    assert list(mapped(dies, range(4), 2, lost=lost)) == [0, 101, -2, -3]
    with pytest.raises(
        TactapeError, match=r"^a process was ended by signal 9, and so did another one .*; .* use fewer --workers$"
    ):
        list(mapped(dies, range(4), 2))


def test_items_are_drawn_as_they_are_needed() -> None:
    taken: list[int] = []

    def items() -> Iterator[int]:
        for i in range(1000):
            taken.append(i)
            yield i

    with closing(mapped(abs, items(), 2)) as results:
        assert [next(results) for _ in range(3)] == [0, 1, 2]
    assert len(taken) <= 3 + 8
    assert children() == []


@pytest.mark.parametrize("value", [0, 65, 1.5, True, "two", "http://h:1", "tcp://h", "tcp://:8786x", "tcp://h:8786/../x"])
def test_what_is_no_number_of_workers_is_refused(value: object) -> None:
    problems: list[Problem] = []
    checked_workers(value, problems)
    assert [p.message.partition(" = ")[0] for p in problems] == ["workers"]
    assert "tcp://localhost:8786" in problems[0].message


def test_workers_are_a_number_or_an_address() -> None:
    problems: list[Problem] = []
    values = (3, "tcp://10.0.0.7:8786", "tls://lab:8786", None)
    assert [checked_workers(v, problems) for v in values] == [3, "tcp://10.0.0.7:8786", "tls://lab:8786", usual_workers()]
    assert problems == []
