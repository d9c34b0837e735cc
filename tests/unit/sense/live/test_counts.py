"""Counts that another thread reads while an answer is counted."""

from __future__ import annotations

from typing import Any

from tactape_fab import Localization
from tactape_fab.sense.live.counts import Tally


class Watched(Tally):
    """Notes what is there at the moment that an answer counts."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "answered" and value == 1:
            self.then = (self.located, self.latencies.count, self.last)
        super().__setattr__(name, value)


def test_an_answer_counts_once_all_of_it_is_there() -> None:
    tally, fix = Watched(), Localization(located=True, status="solid", n_dots=30)
    tally.answer(fix, arrived_s=0.0)
    assert tally.then == (1, 1, fix)
    assert (tally.answered, tally.located) == (1, 1)
