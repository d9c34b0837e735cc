"""Upper bounds of the dots' evidence on many tapes at once, from how the phases of neighbouring lines differ.

The difference is the plane's own, the same in all sectors: delta in docs/codes.md, the offset in the paper (section II-A).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tactape_fab.base.jit import inlined_kernel, inner_kernel
from tactape_fab.sense.decode.search.evidence import Floats
from tactape_fab.sense.decode.search.plane_sites import START, Steps
from tactape_fab.texture.frames import FloatArray, IntArray

NEVER = -1e30
"""Stands for a bound or evidence of what was counted already, or does not exist."""
DEEP = 7.0
"""Bounds are followed so far (ln) below what matters."""


class Bounds(NamedTuple):
    """Bounds of neighbouring lines for each range of the dots along them, made when first asked for.

    slot (4, 2, m + 1, m + 1): Slot of a turn, axis and range; -1 before it is made.
    used (1,): How many there are.
    pairs (k, (m + 1) // 2, L): Most that lines 2 j and 2 j + 1 can say together, by how much their phases differ.
    pair_most, line_most (k, (m + 1) // 2) and (k, m): Most of them, and of each line.
    room (3 L,): Work buffer.
    """

    slot: IntArray
    used: IntArray
    pairs: Floats
    pair_most: FloatArray
    line_most: FloatArray
    room: Floats


def no_bounds(m: int, length: int) -> Bounds:
    """Bounds for dots of at most `m` columns and rows, none made yet."""
    most, pairs = 16 * m, (m + 1) // 2
    return Bounds(
        np.full((4, 2, m + 1, m + 1), -1, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
        np.empty((most, pairs, length), dtype=np.float32),
        np.empty((most, pairs)),
        np.empty((most, m)),
        np.empty(3 * length, dtype=np.float32),
    )


@inner_kernel()
def slot_of(of: Bounds, lines: Floats, turn: int, axis: int, dots: tuple[int | np.int64, int], count: int) -> int:
    """Slot of the bounds for a range of dots along the lines (first, last + 1); made when first asked for."""
    low, high = dots
    slot = of.slot[turn, axis, low, high]
    if slot < 0:
        if of.used[0] == len(of.pairs):  # begin again
            of.used[0] = 0
            for t in range(4):
                for a in range(2):
                    for i in range(of.slot.shape[2]):
                        for j in range(of.slot.shape[3]):
                            of.slot[t, a, i, j] = -1
        slot = of.used[0]
        of.used[0] += 1
        of.slot[turn, axis, low, high] = slot
        bound_pairs(of, slot, lines, dots, count)
    return int(slot)


@inner_kernel(fastmath=True)
def bound_pairs(of: Bounds, slot: int, lines: Floats, dots: tuple[int | np.int64, int], count: int) -> None:
    """Fill `Bounds` for `count` lines (`evidence.add_lines` has the parameters)."""
    pairs, pair_most, line_most, (low, high) = of.pairs[slot], of.pair_most[slot], of.line_most[slot], dots
    length = pairs.shape[1]
    one, two = of.room[:length], of.room[length:]
    for k in range(0, count, 2):
        for p in range(length):
            one[p] = lines[high, k, p] - lines[low, k, p]
        line_most[k] = _most(one, length)
        if k + 1 == count:
            for p in range(length):
                pairs[k // 2, p] = line_most[k]
            pair_most[k // 2] = line_most[k]
            continue
        for p in range(2 * length):
            two[p] = lines[high, k + 1, p] - lines[low, k + 1, p]
        line_most[k + 1] = _most(two, length)
        # whatever the sector, the phases differ by the plane's step: the best phase for each step bounds both lines
        for step in range(length):
            most = one[0] + two[step]
            for p in range(1, length):
                most = max(most, one[p] + two[p + step])
            pairs[k // 2, step] = most
        pair_most[k // 2] = _most(pairs[k // 2], length)


@inner_kernel(fastmath=True)
def _most(values: Floats, count: int) -> float:
    most = values[0]
    for k in range(1, count):
        most = max(most, values[k])
    return float(most)


@inner_kernel(fastmath=True)
def bound_starts(out: Floats, pairs: Floats, steps: Steps, lines: int) -> None:
    """Bound of all lines together for every start in the plane; starts without so many lines after them have none."""
    count, last = len(out) - lines + 1, (lines + 1) // 2 - 1
    for start in range(len(out)):
        out[start] = np.float32(0.0) if start < count else np.float32(NEVER)
    for k in range(0, last, 2):  # two at a time, so that the sums pass through memory half as often
        one, two = pairs[k], pairs[k + 1]
        for start in range(count):
            out[start] += one[steps[start + 2 * k]] + two[steps[start + 2 * k + 2]]
    if last % 2 == 0:
        one = pairs[last]
        for start in range(count):
            out[start] += one[steps[start + 2 * last]]


@inner_kernel(fastmath=True)
def most_of_sites(out: FloatArray, values: Floats, table: IntArray, axis: int, count: int, span: tuple[int, int]) -> None:
    """Largest of some values over the places of each site."""
    for site in range(span[0], span[1]):
        at = table[site, START, axis]
        most = values[at]
        for k in range(at + 1, at + count):
            most = max(most, values[k])
        out[site] = most


@inlined_kernel()
def bound_lines(
    out: FloatArray,
    bounds: Bounds,
    slot: int,
    where: tuple[Steps, IntArray, int, int],
    lines: tuple[int, int, int],
    sites: tuple[int, int],
    least: float,
) -> None:
    """Bound of some lines together at one place of each site, followed no farther than `DEEP` below `least`.

    where: The axis' `Sites.steps`, `Sites.table`, the axis, and the column or row on the tape where the dots' line 0 lies.
    lines: First line, last + 1, and how many the dots have.
    """
    first, last, count = lines
    alone = bounds.line_most[slot, first] if first % 2 == 1 else 0.0
    if last % 2 == 1 and last < count:
        alone += bounds.line_most[slot, last - 1]
    pairs = ((first + 1) // 2, (last + 1) // 2 if last == count else last // 2)
    _follow(out, (bounds.pairs[slot], bounds.pair_most[slot]), alone, where, pairs, sites, least - DEEP)


@inner_kernel(fastmath=True)
def _follow(
    out: FloatArray,
    most: tuple[Floats, FloatArray],
    alone: float,
    where: tuple[Steps, IntArray, int, int],
    span: tuple[int, int],
    sites: tuple[int, int],
    least: float,
) -> None:
    """`bound_lines` for whole pairs: the sum of their most, lowered pair by pair to the most at their step."""
    pairs, pair_most = most
    steps, table, axis, place = where
    whole = alone
    for k in range(span[0], span[1]):
        whole += pair_most[k]
    for site in range(sites[0], sites[1]):
        at, bound = table[site, START, axis] + place, whole
        for k in range(span[0], span[1]):
            bound += pairs[k, steps[at + 2 * k]] - pair_most[k]
            if bound < least:
                break
        out[site] = bound


@inlined_kernel()
def survivors(out: IntArray, bounds: FloatArray, first: int, last: int, least: float) -> tuple[int, float, float]:
    """Sites whose bound is not below `least`: how many; the others' weight in sites at `least`; and the largest bound of them."""
    count, deep, shallow, most = 0, 0, 0.0, NEVER
    for site in range(first, last):
        bound = bounds[site]
        if bound >= least:
            out[count] = site
            count += 1
            continue
        most = max(most, bound)
        if bound < least - DEEP:  # perhaps not followed to its end: counted as if only so deep
            deep += 1
        else:
            shallow += np.exp(bound - least)
    return count, shallow + deep * np.exp(-DEEP), most
