"""Upper bounds of the dots' evidence on many tapes at once, from how the phases of neighbouring lines differ.

The difference is the plane's own, the same in all sectors: delta in docs/codes.md, the offset in the paper (section II-A).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tactape_fab.base.jit import inlined_kernel, inner_kernel
from tactape_fab.sense.decode.search.evidence import Floats
from tactape_fab.sense.decode.search.plane_sites import Starts, Steps
from tactape_fab.texture.frames import FloatArray, IntArray

NEVER = -1e30
"""Stands for a bound or evidence of what was counted already, or does not exist."""
DEEP = 7.0
"""Bounds are followed so far (ln) below what matters."""
_FEW = 64
"""Sites that are sorted as they are found; of more all are gone through."""


class Bounds(NamedTuple):
    """Bounds of neighbouring lines for each range of the dots along them, made when first asked for.

    slot (4, 2, m + 1, m + 1): Slot of a turn, axis and range; -1 before it is made.
    used (1,): How many there are.
    differences (2,): The least and the greatest by which phases of neighbouring lines differ: there are no bounds for others.
    pairs (k, m, L): Most that a line and the next can say together, by how much their phases differ.
    triples (k, m, L L): Most that a line and the next two can say together, by both differences.
    pair_most, triple_most, line_most (k, m): Most of them, and of each line.
    buffer (6 L,): Work buffer.
    """

    slot: IntArray
    used: IntArray
    differences: IntArray
    pairs: Floats
    triples: Floats
    pair_most: FloatArray
    triple_most: FloatArray
    line_most: FloatArray
    buffer: Floats


def no_bounds(m: int, length: int, differences: IntArray) -> Bounds:
    """Bounds for dots of at most `m` columns and rows, none made yet."""
    most = 16 * m
    return Bounds(
        np.full((4, 2, m + 1, m + 1), -1, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
        differences,
        np.empty((most, m, length), dtype=np.float32),
        np.empty((most, m, length * length), dtype=np.float32),
        np.empty((most, m)),
        np.empty((most, m)),
        np.empty((most, m)),
        np.empty(6 * length, dtype=np.float32),
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
        _bound_runs(of, slot, lines, dots, count)
    return int(slot)


@inner_kernel(fastmath=True)
def _bound_runs(of: Bounds, slot: int, lines: Floats, dots: tuple[int | np.int64, int], count: int) -> None:
    """Fill `Bounds` for `count` lines (`evidence.add_lines` has the parameters).

    Whatever the sector, phases of lines differ by the plane's steps: the best phase for each step bounds two lines, or three.
    """
    pairs, triples, (low, high) = of.pairs[slot], of.triples[slot], dots
    length, least, greatest = pairs.shape[1], of.differences[0], of.differences[1]
    one, two, three = of.buffer[:length], of.buffer[length : 3 * length], of.buffer[3 * length :]
    for k in range(count):
        for p in range(length):
            one[p] = lines[high, k, p] - lines[low, k, p]
        of.line_most[slot, k] = _most(one, np.int64(0), length)
        if k + 1 < count:
            for p in range(2 * length):
                two[p] = lines[high, k + 1, p] - lines[low, k + 1, p]
            for step in range(least, greatest + 1):
                most = one[0] + two[step]
                for p in range(1, length):
                    most = max(most, one[p] + two[p + step])
                pairs[k, step] = most
            of.pair_most[slot, k] = _most(pairs[k], least, greatest + 1)
        if k + 2 < count:
            for p in range(2 * length):
                three[p] = lines[high, k + 2, p] - lines[low, k + 2, p]
            for p in range(length):
                three[2 * length + p] = three[p]
            _bound_threes(triples[k], one, two, three, of.differences)
            of.triple_most[slot, k] = _most(triples[k], least * length, (greatest + 1) * length)


@inner_kernel(fastmath=True)
def _bound_threes(out: Floats, one: Floats, two: Floats, three: Floats, differences: IntArray) -> None:
    """Most of the sum of three lines for the steps from the first to the second (L), and on to the third (1)."""
    length = len(one)
    for step in range(differences[0], differences[1] + 1):
        most = out[step * length : (step + 1) * length]
        for p in range(length):
            said, third = one[p] + two[p + step], three[p + step :]
            for k in range(length):
                most[k] = max(most[k], said + third[k]) if p > 0 else said + third[k]


@inner_kernel(fastmath=True)
def _most(values: Floats, first: int, last: int) -> float:
    most = values[first]
    for k in range(first + 1, last):
        most = max(most, values[k])
    return float(most)


@inlined_kernel()
def runs_of(lines: int) -> tuple[int, int, int]:
    """Threes, pairs after them, and single lines at the end, of some lines together."""
    return lines // 3, lines % 3 // 2, lines % 3 % 2


@inner_kernel(fastmath=True)
def bound_starts(out: Floats, bounds: Bounds, slot: int, steps: Steps, lines: tuple[int, int]) -> None:
    """Bound of some lines (first, last + 1) together for every place of the first in the plane; NEVER too near its end."""
    first, number = lines[0], lines[1] - lines[0]
    threes, pairs, single = runs_of(number)
    count, rest = len(out) - number + 1, np.float32(bounds.line_most[slot, lines[1] - 1] if single == 1 else 0.0)
    for start in range(len(out)):
        out[start] = rest if start < count else np.float32(NEVER)
    _add_runs(out, bounds.triples[slot, first:], steps[1], (np.int64(0), np.int64(3), np.int64(threes)), count)
    _add_runs(out, bounds.pairs[slot, first:], steps[0], (np.int64(3 * threes), np.int64(2), np.int64(pairs)), count)


@inner_kernel(fastmath=True)
def _add_runs(out: Floats, said: Floats, steps: IntArray, runs: tuple[int, int, int], count: int) -> None:
    """Add what some runs say at every start; ``runs`` are the first line, the lines of each, and how many there are."""
    first, each, number = runs
    for j in range(0, number - 1, 2):  # two at a time, so that the sums pass through memory half as often
        k = first + each * j
        one, two = said[k], said[k + each]
        for start in range(count):
            out[start] += one[steps[start + k]] + two[steps[start + k + each]]
    if number % 2 == 1:
        k = first + each * (number - 1)
        one = said[k]
        for start in range(count):
            out[start] += one[steps[start + k]]


@inner_kernel(fastmath=True)
def most_of_starts(out: FloatArray, values: Floats, place: IntArray, count: int, span: tuple[int, int]) -> None:
    """Largest of some values over the places of the sites at each start."""
    for k in range(span[0], span[1]):
        most = values[place[k]]
        for j in range(place[k] + 1, place[k] + count):
            most = max(most, values[j])
        out[k] = most


@inner_kernel(fastmath=True)
def bound_lines(
    out: FloatArray,
    bounds: Bounds,
    slot: int,
    where: tuple[Steps, IntArray, int],
    lines: tuple[int, int],
    span: tuple[int, int],
    least: float,
) -> None:
    """Bound of some lines together at one place of the sites at each start, followed no farther than `DEEP` below `least`.

    It is the sum of the most of all runs, lowered run by run to the most at their steps.

    where: The axis' `Sites.steps` and `Starts.place`, and the column or row on the tape where the dots' line 0 lies.
    lines: First line and last + 1.
    """
    (steps, starts, place), (first, last), lowest = where, lines, least - DEEP
    threes, pairs, single = runs_of(last - first)
    of_three, of_two, triple_most, pair_most = (
        bounds.triples[slot],
        bounds.pairs[slot],
        bounds.triple_most[slot],
        bounds.pair_most[slot],
    )
    whole, behind = bounds.line_most[slot, last - 1] if single == 1 else 0.0, first + 3 * threes
    for k in range(first, behind, 3):
        whole += triple_most[k]
    for k in range(behind, behind + 2 * pairs, 2):
        whole += pair_most[k]
    for start in range(span[0], span[1]):
        at, bound = starts[start] + place, whole
        for k in range(first, behind, 3):
            bound += of_three[k, steps[1, at + k]] - triple_most[k]
            if bound < lowest:
                break
        if bound >= lowest:
            for k in range(behind, behind + 2 * pairs, 2):
                bound += of_two[k, steps[0, at + k]] - pair_most[k]
                if bound < lowest:
                    break
        out[start] = bound


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


@inlined_kernel()
def survivors_of_starts(
    out: IntArray, bounds: FloatArray, starts: Starts, axis: int, of: tuple[int, int, int], least: float
) -> tuple[int, float, float]:
    """`survivors`, in ascending order, where each start bounds all sites there; ``of`` are class, first site, last + 1."""
    begin, members, span = starts.begin[axis], starts.members[axis], starts.spans[of[0], axis]
    count, deep, shallow, most = 0, 0, 0.0, NEVER
    for k in range(span[0], span[1]):
        bound, sites = bounds[k], begin[k + 1] - begin[k]
        if bound >= least:
            if count + sites <= _FEW:
                for j in range(begin[k], begin[k + 1]):
                    at = count + j - begin[k]
                    while at > 0 and out[at - 1] > members[j]:
                        out[at] = out[at - 1]
                        at -= 1
                    out[at] = members[j]
            count += sites
            continue
        most = max(most, bound)
        if bound < least - DEEP:
            deep += sites
        else:
            shallow += sites * np.exp(bound - least)
    if count > _FEW:  # too many to be sorted
        count = 0
        for site in range(of[1], of[2]):
            if bounds[starts.rank[site, axis]] >= least:
                out[count] = site
                count += 1
    return count, shallow + deep * np.exp(-DEEP), most
