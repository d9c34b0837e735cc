"""Tapes by their matrices against every place of each, dot by dot: best, weight of all, and the strongest of them."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
import pytest

from tactape_fab.sense.decode.rule import LEAST_DOTS, place_weights
from tactape_fab.sense.decode.search.evidence import tables_of
from tactape_fab.sense.decode.search.groups import count_places, groups_of
from tactape_fab.sense.decode.search.matrices import (
    LARGEST_CONTACT,
    Matrices,
    _by_chance,
    _choose,
    _frame,
    matrices_of,
    weigh_matrices,
)
from tactape_fab.sense.decode.search.single_place import NO_PART
from tactape_fab.sense.decode.search.tally import (
    BEST,
    BOUNDED,
    LEFT_OUT,
    NEXT_STRONGEST,
    STRONGEST,
    TOTAL,
    Tally,
    new_tally,
)
from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import FloatArray, IntArray, SymbolArray

TURNS = np.array([0.4, 0.3, 0.2, 0.1])
CUE = np.log(TURNS)


def shown_of(seed: int, columns: int, rows: int, directions: int, holes: int = 0) -> SymbolArray:
    rng = np.random.default_rng(seed)
    out = rng.integers(0, directions, (rows, columns)).astype(np.uint8)
    out.flat[rng.choice(out.size, holes, replace=False)] = NO_PART
    return out


def codes_around(directions: int) -> IntArray:
    """What a tape shows for each direction of `q`, from the first axis on: E, S, W, N are 2, 3, 1, 0."""
    return np.array([2, 3, 1, 0]) if directions == 4 else DIRECTIONS[8].gray_codes[DIRECTIONS[8].clockwise].astype(np.int64)


def contact(
    shown: SymbolArray, corner: tuple[int, int], turn: int, directions: int, doubt: float, *, dots: int = 16, wrong: int = 0
) -> tuple[IntArray, FloatArray]:
    """Grid points and posteriors of dots of a box of 5 x 5, those beyond the tape at random, some of the others wrong."""
    rng = np.random.default_rng([turn, dots, directions, *(v + 9 for v in corner)])
    box = np.array(list(product(range(5), range(5))))
    cells = box[np.sort(rng.choice(len(box), dots, replace=False))] + corner
    rows, columns = shown.shape
    inside = ((cells >= 0) & (cells < (columns, rows))).all(axis=1)
    codes = rng.integers(0, directions, len(cells))
    seen = shown[cells[inside, 1], cells[inside, 0]].astype(np.int64)
    codes[inside] = np.where(seen == NO_PART, codes[inside], seen)
    codes[:wrong] = (codes[:wrong] + 1) % directions
    first = np.argsort(codes_around(directions))[codes]
    q = np.full((len(cells), directions), doubt / (directions - 1))
    q[np.arange(len(cells)), (first + turn * directions // 4) % directions] = 1.0 - doubt
    q *= rng.uniform(0.8, 1.2, q.shape)
    x, y = cells.T
    nodes = np.stack([(x, y), (-y, x), (-x, -y), (y, -x)][turn], axis=1)
    return nodes + rng.integers(-9, 9, 2), q / q.sum(axis=1, keepdims=True)


class Places(NamedTuple):
    """Places with enough dots on a tape: tape, turn, column, row, ln E, and whether some dots hang over an edge."""

    tape: IntArray
    turn: IntArray
    column: IntArray
    row: IntArray
    value: FloatArray
    over: IntArray


def every_place(tapes: list[SymbolArray], nodes: IntArray, q: FloatArray) -> Places:
    found: list[tuple[int, int, int, int, float, int]] = []
    directions, (k, j) = q.shape[1], nodes.T
    codes = codes_around(directions)
    for turn in range(4):
        cells = np.stack([(k, j), (j, -k), (-k, -j), (-j, k)][turn], axis=1)
        cells = cells - cells.min(axis=0)
        by_code = np.empty_like(q)
        by_code[:, codes] = np.roll(q, -turn * directions // 4, axis=1)
        said, bits = np.zeros((len(q), directions)), np.arange(directions)
        for bit in range(directions.bit_length() - 1):  # each bit is tossed by itself
            one = by_code[:, bits >> bit & 1 == 1].sum(axis=1)
            said += np.log(2.0 * np.where(bits >> bit & 1 == 1, one[:, None], 1.0 - one[:, None]))
        wide, high = (cells.max(axis=0) + 1).tolist()
        for tape, shown in enumerate(tapes):
            rows, columns = shown.shape
            for x, y in product(range(1 - wide, columns), range(1 - high, rows)):
                at = cells + np.array([x, y])
                on = ((at >= 0) & (at < (columns, rows))).all(axis=1)
                if on.sum() < LEAST_DOTS:
                    continue
                seen = shown[at[on, 1], at[on, 0]]
                placed = seen != NO_PART
                value = said[on.nonzero()[0][placed], seen[placed]].sum()
                whole = 0 <= x <= columns - wide and 0 <= y <= rows - high
                found.append((tape, turn, x, y, float(value), 0 if whole else 1))
    return Places(*(np.array(values) for values in zip(*found, strict=True)))


def matrices_from(tapes: list[SymbolArray], directions: int) -> Matrices:
    return matrices_of(tapes, sorted({(shown.shape[1], shown.shape[0]) for shown in tapes}), directions)


def weighed(tapes: list[SymbolArray], nodes: IntArray, q: FloatArray, fits: float = -np.inf) -> tuple[Tally, FloatArray]:
    """The tally of all places, and ln of the weight of a place by turn and by whether dots hang over an edge."""
    matrices = matrices_from(tapes, q.shape[1])
    tables = tables_of(nodes, q, np.empty(0, dtype=np.float32), LARGEST_CONTACT)
    groups = groups_of(tables, matrices.sizes, LEAST_DOTS)
    base = place_weights(count_places([groups], [matrices.classes]), TURNS, 1.0)
    tally = new_tally(fits=fits)
    weigh_matrices(tables, matrices, LEAST_DOTS, base, CUE, tally)
    return tally, base


SMALL = [shown_of(1, 9, 8, 4), shown_of(2, 9, 8, 4, holes=6), shown_of(3, 12, 7, 4)]
WIDE = [shown_of(4, 70, 6, 4, holes=9)]
EIGHT = [shown_of(5, 8, 8, 8, holes=2), shown_of(6, 11, 6, 8)]


@pytest.mark.parametrize(
    ("tapes", "touched", "corner", "turn", "doubt", "wrong"),
    [
        (SMALL, 0, (2, 1), 0, 0.02, 0),
        (SMALL, 1, (3, 2), 1, 0.02, 1),
        (SMALL, 2, (-2, 1), 2, 0.02, 0),
        (SMALL, 2, (8, 3), 3, 0.05, 0),
        (SMALL, 1, (2, -2), 1, 0.4, 0),
        (SMALL, 0, (2, 1), 0, 0.02, 6),
        (WIDE, 0, (62, 1), 1, 0.02, 1),
        (WIDE, 0, (-1, -1), 3, 0.05, 0),
        (EIGHT, 0, (1, 2), 2, 0.02, 1),
        (EIGHT, 1, (7, 1), 1, 0.05, 0),
    ],
)
@pytest.mark.parametrize("dots", [15, 22])
def test_places_weigh_what_their_dots_say(
    tapes: list[SymbolArray], touched: int, corner: tuple[int, int], turn: int, doubt: float, wrong: int, dots: int
) -> None:
    directions = 8 if tapes is EIGHT else 4
    nodes, q = contact(tapes[touched], corner, turn, directions, doubt, dots=dots, wrong=wrong)
    tally, base = weighed(tapes, nodes, q)
    found = every_place(tapes, nodes, q)
    score, likelihood = found.value + base[found.turn, found.over], found.value + CUE[found.turn]
    best, strongest = int(score.argmax()), int(likelihood.argmax())
    assert tally.sums[BEST] == pytest.approx(score[best])
    place = (found.turn[best], found.tape[best], found.column[best], found.row[best])
    assert tuple(tally.best_place) == (*place, -1, -1)  # no sector's u and v
    total = float(np.exp(score - score[best]).sum())
    enough = score[best] > 0.0
    assert total * (1 - 1e-6) <= tally.sums[TOTAL] <= total * (1 + 1e-6) + (1e-5 if enough else np.exp(-3.9))
    assert tally.sums[TOTAL] - tally.sums[BOUNDED] <= total * (1 + 1e-6)
    # all that was not looked at is no likelier than its bound, and no bound hides what matters
    assert max(tally.sums[STRONGEST], tally.sums[LEFT_OUT]) >= likelihood[strongest] - 1e-6
    if enough:
        assert tally.sums[STRONGEST] == pytest.approx(likelihood[strongest])
        at = found.turn[strongest], found.tape[strongest], found.column[strongest], found.row[strongest]
        assert tuple(tally.strongest_place[:4]) == at
        second = np.sort(likelihood)[-2]
        assert max(tally.sums[NEXT_STRONGEST], tally.sums[LEFT_OUT]) >= second - 1e-6
        # what was not looked at hardly weighs, all together: 14.5 below the answer and 2 more, in ln
        least = score[best] - 14.5 - np.log(len(score)) - 2.0
        assert tally.sums[LEFT_OUT] <= max(least - base[np.isfinite(base)].min(), second) + 1e-6
        assert tally.sums[LEFT_OUT] < likelihood[strongest] - 8.0


def test_where_nothing_fits_only_the_best_place_is_asked_for() -> None:
    nodes, q = contact(shown_of(90, 9, 8, 4), (2, 1), 1, 4, 0.3)
    tally, base = weighed(SMALL, nodes, q, fits=0.0)
    found = every_place(SMALL, nodes, q)
    score = found.value + base[found.turn, found.over]
    assert score.max() < 0.0
    assert tally.sums[BEST] == pytest.approx(score.max()) and tally.sums[TOTAL] == np.inf and tally.sums[BOUNDED] == 0.0
    known, _ = weighed(SMALL, nodes, q, fits=-1e6)
    assert np.exp(score - score.max()).sum() <= known.sums[TOTAL] < np.inf


def test_one_dot_that_says_nothing_is_as_none() -> None:
    nodes, q = contact(SMALL[0], (2, 1), 0, 4, 0.02)
    more = np.vstack([nodes, nodes.min(axis=0) - (0, 1)])
    even = np.vstack([q, np.full(4, 0.25)])
    (tally, base), (other, base_of_more) = weighed(SMALL, nodes, q), weighed(SMALL, more, even)
    assert other.sums[BEST] - base_of_more[0, 0] == pytest.approx(tally.sums[BEST] - base[0, 0])


def test_so_many_dots_are_counted_that_chance_leaves_fewest_places() -> None:
    """A place remains with w wrong symbols while the w smallest losses are 30 at most: by chance so many are wrong, or fewer.

    One dot: its loss of 20 is within 30, all places remain. Two: 12 is, 12 + 20 not, so one wrong symbol of two, 1 - (3/4)^2 =
    0.44. Three: 10 + 12 is, two of three, 1 - (3/4)^3 = 0.58. Four: 5 + 10 + 12 is, three of four, 0.68.
    """
    lost, floor = np.array([20.0, 12.0, 10.0, 5.0]), np.full(5, np.nan)
    assert _choose(lost, _by_chance(4), floor) == 2
    assert floor[:3].tolist() == [0.0, 12.0, 32.0]
    # dots that each lose more than a place may leave 4^-k: 4^-9 is the first below 1e-5
    every, strong = np.full(31, np.nan), np.full(30, 31.0)
    assert _choose(strong, _by_chance(4), every) == 9
    assert every[:10] == pytest.approx(31.0 * np.arange(10))


@pytest.mark.parametrize("directions", [4, 8])
def test_dots_that_lose_most_come_first(directions: int) -> None:
    """A wrong symbol costs a dot what its best symbol is ahead of its second: least if one bit alone is wrong."""
    tapes = SMALL if directions == 4 else EIGHT
    nodes, q = contact(tapes[0], (2, 1), 0, directions, 0.02)
    frame = _frame(tables_of(nodes, q, np.empty(0, dtype=np.float32), LARGEST_CONTACT), matrices_from(tapes, directions))
    codes, by_code = np.arange(directions), np.empty_like(q)
    by_code[:, codes_around(directions)] = q
    said = np.zeros_like(q)
    for bit in range(directions.bit_length() - 1):
        one = by_code[:, codes >> bit & 1 == 1].sum(axis=1, keepdims=True)
        said += np.log(2.0 * np.where(codes >> bit & 1 == 1, one, 1.0 - one))
    ranked = np.sort(said, axis=1)
    lost = np.sort(ranked[:, -1] - ranked[:, -2])[::-1]
    counted = len(frame.floor) - 1
    assert counted > 0 and np.diff(frame.floor) == pytest.approx(lost[:counted][::-1])
    best = frame.evidence.max(axis=2)
    # most that the dots after so many can say: all of them, all but the first, none
    assert frame.rest[:, 0] == pytest.approx(best.sum(axis=1)) and (frame.rest[:, -1] == 0.0).all()
    assert frame.rest[:, :-1] - frame.rest[:, 1:] == pytest.approx(best)
    # in all columns and rows; in the first column alone; in no column
    first = frame.cells[:, :, 0] == 0
    assert frame.most[:, -1, -1] == pytest.approx(best.sum(axis=1))
    assert frame.most[:, 1, -1] == pytest.approx((best * first).sum(axis=1)) and (frame.most[:, 0] == 0.0).all()


@pytest.mark.parametrize("symbols", [4, 8])
def test_wrong_symbols_by_chance_are_binomial(symbols: int) -> None:
    found = _by_chance(symbols)
    wrong = 1.0 - 1.0 / symbols
    assert found[0, 0] == 1.0 and found[5, 5] == pytest.approx(1.0)
    assert found[3, 0] == pytest.approx((1.0 / symbols) ** 3)
    assert found[3, 1] == pytest.approx((1.0 / symbols) ** 3 + 3 * wrong / symbols**2)
