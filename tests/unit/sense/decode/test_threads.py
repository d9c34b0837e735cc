"""Threads at the same time, each with a Localizer of its own or all with one, give the answers of one thread alone."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import Any

import numpy as np
import pytest

from tactape_fab import Localizer
from tests.contacts import tape_of
from tests.unit.sense.decode.test_touch import contacts, touch

ROUNDS = 5


def answers(localizer: Localizer, depths: list[np.ndarray]) -> list[dict[str, Any]]:
    return [localizer.locate(depth).to_mapping(0) | {"elapsed_ms": 0.0} for depth in depths]


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
