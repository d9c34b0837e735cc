"""Number sequences: every cyclic window is unique, de Bruijn sequences are complete and lexicographically least."""

from __future__ import annotations

from itertools import combinations, product
from math import gcd, prod

import numpy as np
import pytest

from tactape_fab.texture.sequences import NumberSequence, anoto_main, anoto_secondary, de_bruijn

DE_BRUIJN = [(2, 4), (3, 3), (5, 3), (16, 3), (2, 1), (2, 2), (2, 3), (2, 7), (3, 2), (4, 2), (7, 2), (10, 3)]
ANOTO = [anoto_main(), *anoto_secondary()]
ALL = [*(de_bruijn(k, n) for k, n in DE_BRUIJN), *ANOTO]
IDS = [f"base{s.base}-order{s.order}-length{s.length}" for s in ALL]


def cyclic_windows(digits: list[int], order: int) -> list[tuple[int, ...]]:
    twice = digits * 2 if len(digits) >= order else digits * (order + 1)
    return [tuple(twice[i : i + order]) for i in range(len(digits))]


def least_by_search(base: int, order: int) -> list[int]:
    """First sequence in dictionary order whose cyclic windows are all different, found by trying every digit in turn."""
    length: int = base**order
    digits: list[int] = []
    seen: set[tuple[int, ...]] = set()

    def extend() -> bool:
        if len(digits) == length:
            return len(set(cyclic_windows(digits, order))) == length
        for digit in range(base):
            digits.append(digit)
            window = tuple(digits[-order:])
            if len(digits) < order:
                if extend():
                    return True
            elif window not in seen:
                seen.add(window)
                if extend():
                    return True
                seen.remove(window)
            digits.pop()
        return False

    assert extend()
    return digits


def least_by_greed(base: int, order: int) -> list[int]:
    """Martin's rule: after order - 1 times the largest digit, always append the least digit that makes a new window."""
    digits = [base - 1] * (order - 1)
    seen: set[tuple[int, ...]] = set()
    while True:
        tail = tuple(digits[len(digits) - order + 1 :])
        digit = next((d for d in range(base) if (*tail, d) not in seen), None)
        if digit is None:
            return digits[order - 1 :]
        seen.add((*tail, digit))
        digits.append(digit)


@pytest.mark.parametrize("sequence", ALL, ids=IDS)
def test_every_cyclic_window_is_unique(sequence: NumberSequence) -> None:
    windows = cyclic_windows(sequence.digits.tolist(), sequence.order)
    assert len(windows) == len(set(windows)) == sequence.length
    assert set(sequence.digits.tolist()) <= set(range(sequence.base))


@pytest.mark.parametrize(("base", "order"), DE_BRUIJN)
def test_de_bruijn_shows_every_window(base: int, order: int) -> None:
    sequence = de_bruijn(base, order)
    assert sequence.length == base**order
    assert set(cyclic_windows(sequence.digits.tolist(), order)) == set(product(range(base), repeat=order))


@pytest.mark.parametrize(("base", "order"), [(2, 1), (2, 2), (2, 3), (2, 4), (3, 1), (3, 2), (5, 1)])
def test_de_bruijn_is_least_of_all_sequences(base: int, order: int) -> None:
    length = base**order
    every = product(range(base), repeat=length)
    least = next(s for s in every if len(set(cyclic_windows(list(s), order))) == length)
    assert de_bruijn(base, order).digits.tolist() == list(least)


@pytest.mark.parametrize(("base", "order"), [(2, 4), (2, 5), (3, 2), (3, 3), (4, 2), (5, 2)])
def test_de_bruijn_is_first_in_dictionary_order(base: int, order: int) -> None:
    assert de_bruijn(base, order).digits.tolist() == least_by_search(base, order)


@pytest.mark.parametrize(("base", "order"), DE_BRUIJN)
def test_de_bruijn_agrees_with_another_construction(base: int, order: int) -> None:
    assert de_bruijn(base, order).digits.tolist() == least_by_greed(base, order)


def test_de_bruijn_literals() -> None:
    assert "".join(map(str, de_bruijn(2, 4).digits)) == "0000100110101111"
    assert "".join(map(str, de_bruijn(3, 3).digits)) == "000100201101202102211121222"
    assert de_bruijn(16, 3).length == 4096


def test_anoto_lengths_and_orders() -> None:
    assert [(s.length, s.base, s.order) for s in ANOTO] == [(63, 2, 6), (236, 3, 5), (233, 3, 5), (31, 2, 5), (241, 3, 5)]


@pytest.mark.parametrize(
    ("secondary", "reach"),
    [((de_bruijn(3, 3), de_bruijn(5, 3)), 3375), ((de_bruijn(16, 3),), 4096), (anoto_secondary(), 410_815_348)],
    ids=["microdots", "debruijn", "anoto"],
)
def test_secondary_lengths_are_coprime_and_their_product_is_the_reach(secondary: tuple[NumberSequence, ...], reach: int) -> None:
    lengths = [s.length for s in secondary]
    assert all(gcd(a, b) == 1 for a, b in combinations(lengths, 2))
    assert prod(lengths) == reach


@pytest.mark.parametrize("sequence", ALL, ids=IDS)
def test_place_of_window_inverts_the_windows(sequence: NumberSequence) -> None:
    windows = cyclic_windows(sequence.digits.tolist(), sequence.order)
    values = [sum(d * sequence.base ** (sequence.order - 1 - i) for i, d in enumerate(w)) for w in windows]
    assert sequence.window_values().tolist() == values
    assert sequence.place_of_window[values].tolist() == list(range(sequence.length))
    assert (sequence.place_of_window >= 0).sum() == sequence.length


@pytest.mark.parametrize("sequence", ALL, ids=IDS)
def test_sum_before_counts_all_digits_before_an_index(sequence: NumberSequence) -> None:
    digits = sequence.digits.tolist()
    near = np.arange(3 * sequence.length + 2)
    assert sequence.sum_before(near).tolist() == [0, *np.cumsum(digits * 3 + digits[:1] * 2)[: len(near) - 1].tolist()]
    far = 410_815_347
    whole, rest = divmod(far, sequence.length)
    assert int(sequence.sum_before(np.array([far]))[0]) == whole * sum(digits) + sum(digits[:rest])


def test_digits_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        de_bruijn(2, 4).digits[0] = 1


def test_windows_that_do_not_occur_have_no_place_and_tables_cannot_be_changed() -> None:
    sequence = anoto_secondary()[0]
    absent = sorted(set(range(3**5)) - set(sequence.window_values().tolist()))
    assert len(absent) == 243 - 236 and sequence.place_of_window[absent].tolist() == [-1] * 7
    for table in (sequence.place_of_window, sequence.digits):
        with pytest.raises(ValueError, match="read-only"):
            table[0] = 1
