"""Threads at the same time, each with a Localizer of its own or all with one, give the answers of one thread alone, as soon."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import Any

import numpy as np
import pytest

from tactape_fab import Localizer, Tape
from tactape_fab.base.jit import COMPILED
from tests.bench.stages import dispatchers
from tests.bench.threads import answers, beside_busy_ms
from tests.contacts import tape_of
from tests.unit.sense.decode.test_touch import contacts, touch

ROUNDS = 5


@pytest.mark.parametrize("shared", [True, False], ids=["one Localizer", "one each"])
def test_threads_give_the_answers_of_one(shared: bool) -> None:
    tapes = [tape_of(7), touch(1)]
    first = Localizer(tapes)
    depths = [depth for tape in tapes for _, depth in contacts(tape, 4, 3)]
    localizers = [first] * 2 if shared else [first, Localizer(tapes)]
    expected = answers(first, depths) * ROUNDS
    together = Barrier(2)

    def work(k: int) -> list[dict[str, Any]]:
        together.wait()
        mine = depths if k == 0 else depths[::-1]  # different frames at the same time
        return answers(localizers[k], mine * ROUNDS)

    with ThreadPoolExecutor(2) as pool:
        one, other = pool.map(work, range(2))
    assert one == expected
    assert other == (expected[: len(depths)][::-1]) * ROUNDS


@pytest.fixture
def interval_ms() -> Iterator[float]:
    """After so long a thread that waits for the interpreter's lock has it from another that computes in Python; Python's own."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(0.005)
    yield 1e3 * sys.getswitchinterval()
    sys.setswitchinterval(before)


@pytest.mark.skipif(not COMPILED, reason="a frame takes seconds")
@pytest.mark.parametrize("tape", [tape_of(7), touch(1)], ids=["plane", "matrix"])
def test_a_frame_does_not_wait_for_a_thread_that_computes(tape: Tape, interval_ms: float) -> None:
    depths = [depth for _, depth in contacts(tape, 15, 3)]
    # a few of numpy's functions release the lock, and on some machines the other thread is quick enough to take it
    assert np.median(beside_busy_ms(Localizer([tape], world="open"), depths)) < 3.0 * interval_ms


@pytest.mark.skipif(not COMPILED, reason="nothing is compiled")
def test_only_searches_of_many_places_release_the_lock() -> None:
    """On a busy machine the test above says little: a kernel ends before the other thread is awake."""
    releasing = {
        f"{module.__name__.rpartition('.')[2]}.{name}"
        for module, name, kernel in dispatchers()
        if kernel.targetoptions.get("nogil")
    }
    assert releasing == {"all_places._weigh_many", "matrices._weigh_many", "trace_plane.transform", "trace_plane.summarise"}
