"""Bounds and counts behind the tables of docs/codes.md."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from tactape_fab import Localizer
from tests.bench import dot_records
from tests.bench.code_bounds import largest_code, most_distance
from tests.bench.code_table import least_contact, located
from tests.bench.code_trust import SUBJECTS, foreign, own, tape_of_code
from tests.bench.dot_records import recorded
from tests.bench.quarter_turns import Turns
from tests.bench.touch_rungs import DESIGNS, designed
from tests.bench.touch_rungs import located as located_on_design
from tests.thorough import THOROUGH, only_thorough, some


@pytest.fixture(autouse=True, scope="module")
def _few_records() -> Iterator[None]:
    """Dots of contacts are drawn from a quarter of the frames that the tables themselves rest on."""
    recorded.cache_clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dot_records, "RECORDED", dot_records.RECORDED // 4)
        patch.setattr(dot_records, "RECORDED_AT_EDGES", dot_records.RECORDED_AT_EDGES // 4)
        yield
    recorded.cache_clear()


@pytest.mark.parametrize(("length", "distance", "words"), [(24, 8, 4096), (16, 6, 256), (23, 7, 4096), (13, 6, 40)])
def test_the_bound_is_delsartes(length: int, distance: int, words: int) -> None:
    """Golay's and the Nordstrom-Robinson code meet it; of (13, 6) the bound is 40, the best code has 32."""
    assert largest_code(length, distance) == pytest.approx(words, rel=1e-6)
    assert most_distance(length, words) == distance


def test_no_code_has_a_distance_of_more_words_than_there_are() -> None:
    assert (most_distance(18, 1 << 18), most_distance(18, (1 << 18) + 1)) == (1, 0)


@only_thorough
def test_contacts_on_the_tape_are_right_and_on_others_not_located() -> None:
    tape = tape_of_code("trace-22")
    localizer = Localizer([tape])
    found = own("trace-22", 44, localizer)
    assert (found.contacts, found.wrong) == (44, 0) and found.located > 28 and found.said < 0.01
    for subject in SUBJECTS[:3]:
        assert foreign("trace-22", subject, 22, localizer).located == 0


def test_larger_contacts_are_located_more_often() -> None:
    localizer = Localizer([tape_of_code("trace-22")])
    shares = [located("trace-22", localizer, size_mm, 0.0, some(40)) for size_mm in (5.0, 6.0, 9.0)]
    assert shares == sorted(shares) and shares[0] < 0.5 < shares[2]
    if THOROUGH:
        assert 5.25 <= float(least_contact("trace-22", localizer, 0.0, 40).split()[0]) <= 7.0


def test_turns_are_counted_by_their_sign_and_their_answers() -> None:
    turns = Turns()
    for ratio, off_deg in ((3.0, 1.0), (-1.0, 91.0), (None, None), (50.0, -179.0)):
        turns.add(ratio, off_deg)
    assert (turns.mistaken, turns.located, turns.quarter, turns.half) == (1, 3, 1, 1)
    assert turns.said == pytest.approx(1 / (1 + np.exp(3.0)) + 1 / (1 + np.exp(1.0)) + 0.02)


@only_thorough
def test_distance_counts_where_only_tapes_are_in_reach() -> None:
    """By default p_tape bounds small contacts, so that the world with `max_p_tape` locates more of the same ones."""
    tape, _ = designed(DESIGNS["`touch-2`, long parts"])
    (by_default, told), wrong = located_on_design(tape, 5.25, 20)
    assert wrong == 0 and by_default < 5 < told
