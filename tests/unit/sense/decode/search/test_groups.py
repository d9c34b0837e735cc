"""Groups of places against every place by itself."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from tactape_fab.sense.decode.search.evidence import tables_of
from tactape_fab.sense.decode.search.groups import (
    COLUMNS,
    FIRST_COLUMN,
    FIRST_ROW,
    LAST_COLUMN,
    LAST_ROW,
    OVER,
    ROWS,
    Groups,
    X,
    Y,
    count_places,
    groups_of,
    likelier_turn,
)
from tactape_fab.texture.frames import FloatArray, IntArray

LEAST = 6
SIZES = np.array([(4, 12), (9, 7), (3, 3), (30, 20)])
NO_SIGNS = np.empty(0, dtype=np.float32)


def contact(seed: int, wide: int = 5, high: int = 4, dots: int = 11) -> tuple[IntArray, FloatArray]:
    """Dots of a box, whose corners are there."""
    rng = np.random.default_rng(seed)
    box = np.array(list(product(range(wide), range(high))))
    chosen = {0, len(box) - 1, *rng.choice(len(box), dots - 2, replace=False).tolist()}
    nodes = box[sorted(chosen)] + rng.integers(-9, 9, 2)
    return nodes, rng.dirichlet(np.full(4, 0.4), len(nodes))


def grouped(seed: int) -> tuple[Groups, list[IntArray], list[FloatArray]]:
    """Groups, cells of the dots in each turn, and the most that each dot can say with its x and with its y bit."""
    nodes, q = contact(seed)
    k, j = nodes.T
    turns = [np.stack(at, axis=1) for at in ((k, j), (j, -k), (-k, -j), (-j, k))]
    most = []
    for turn in range(4):
        e, s, w, n = np.roll(q, -turn, axis=1).T
        mean = (np.log(2 * (e + n)) + np.log(2 * (w + s)) + np.log(2 * (n + w)) + np.log(2 * (e + s))) / 4
        x, y = np.abs(np.log((w + s) / (e + n))) / 2, np.abs(np.log((e + s) / (n + w))) / 2
        most.append(np.stack([mean + x, mean + y], axis=1))
    return groups_of(tables_of(nodes, q, NO_SIGNS, 24), SIZES, LEAST), [at - at.min(axis=0) for at in turns], most


@pytest.mark.parametrize("seed", range(4))
def test_every_place_with_enough_dots_is_in_one_group(seed: int) -> None:
    found, turns, most = grouped(seed)
    for (turn, cells), (k, (columns, rows)) in product(enumerate(turns), enumerate(SIZES.tolist())):
        first, last = found.spans[turn, k]
        wide, high = (cells.max(axis=0) + 1).tolist()
        seen = dict[tuple[int, int], int]()
        for g in range(first, last):
            of = found.fields[g].tolist()
            assert found.limits[g, 2] == pytest.approx(np.log(of[COLUMNS] * of[ROWS]))
            for x, y in product(range(of[X], of[X] + of[COLUMNS]), range(of[Y], of[Y] + of[ROWS])):
                assert (x, y) not in seen
                seen[x, y] = g
        for x, y in product(range(-wide, columns + 1), range(-high, rows + 1)):
            at = cells + np.array([x, y])
            on = ((at >= 0) & (at < (columns, rows))).all(axis=1)
            assert ((x, y) in seen) == (on.sum() >= LEAST)
            if (x, y) not in seen:
                continue
            of, limit = found.fields[seen[x, y]].tolist(), found.limits[seen[x, y]]
            whole = 0 <= x <= columns - wide and 0 <= y <= rows - high
            assert of[OVER] == (0 if whole else 1)
            assert (of[FIRST_COLUMN], of[LAST_COLUMN]) == (max(0, -x), min(wide, columns - x))
            assert (of[FIRST_ROW], of[LAST_ROW]) == (max(0, -y), min(high, rows - y))
            assert limit[:2] == pytest.approx(most[turn][on].sum(axis=0), abs=1e-9)
        whole_ones = [g for g in range(first, last) if found.fields[g, OVER] == 0]
        assert whole_ones in ([], [first])  # one group of all places with all dots on the tape, and it comes first


def test_places_of_all_tapes_are_counted_by_turn_and_edge() -> None:
    """Classes of sites: the first and last + 1, their size, tapes a site, and whether dots may hang over edges."""
    found, turns, _ = grouped(0)
    one = np.array([(0, 3, 1, 1, 1, 0), (3, 5, 3, 7, 0, 0)])
    other = np.array([(0, 2, 0, 2, 1, 0)])
    counts = count_places([found, found], [one, other])
    expected = np.zeros((4, 2))
    for turn, cells in enumerate(turns):
        wide, high = (cells.max(axis=0) + 1).tolist()
        for size, tapes, over_too in ((1, 3, True), (3, 14, False), (0, 4, True)):
            columns, rows = SIZES[size].tolist()
            for x, y in product(range(-wide, columns + 1), range(-high, rows + 1)):
                at = cells + np.array([x, y])
                if ((at >= 0) & (at < (columns, rows))).all(axis=1).sum() >= LEAST:
                    over = 0 if 0 <= x <= columns - wide and 0 <= y <= rows - high else 1
                    expected[turn, over] += tapes * (over == 0 or over_too)
    assert np.array_equal(counts, expected)


@pytest.mark.parametrize(
    ("turn", "order"), [((0.4, 0.1, 0.4, 0.1), [0, 2, 1, 3]), ((0.1, 0.4, 0.1, 0.4), [1, 3, 0, 2]), ((0.25,) * 4, [0, 2, 1, 3])]
)
def test_likelier_turns_come_first(turn: tuple[float, ...], order: list[int]) -> None:
    likelier = getattr(likelier_turn, "py_func", likelier_turn)
    assert [likelier(k, np.log(turn)) for k in range(4)] == order
