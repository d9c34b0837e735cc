"""Upper bounds of the dots' evidence on many tapes at once, from how the phases of neighbouring lines differ.

The difference is the plane's own, the same in all sectors: delta in docs/codes.md, the offset in the paper (section II-A).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tactape_fab.base.jit import inlined_kernel, inner_kernel
from tactape_fab.sense.decode.search.evidence import Floats
from tactape_fab.sense.decode.search.plane_sites import Starts, Steps
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

NEVER = -1e30
"""Bound or evidence of a place that does not exist or was already counted."""
DEEP = 7.0
"""A bound is no longer refined once it is so far (ln) below the least that matters."""
WAYS = 3
"""Number of partitions of the lines into runs that `runs_of` knows."""
_FEW = 64
"""Up to so many surviving sites are sorted by insertion; for more, all sites are scanned in order."""


class Bounds(NamedTuple):
    """Bounds of neighbouring lines for each range of the dots along them, made when first asked for.

    slot (4, 2, m + 1, m + 1): Slot of a turn, axis and range; -1 before it is made.
    used (1,): Number of slots in use.
    differences (2,): Least and greatest phase difference of neighbouring lines; only these have bounds.
    made (2, k, m): Whether the pairs, and the triples, that begin with a line are computed.
    pairs (k, m, L): Largest evidence of a line and the next together, by their phase difference.
    triples (k, m, L L): Largest evidence of a line and the next two together, by both differences.
    pair_most, triple_most, line_most (k, m): Largest of these over all differences, and of each line alone.
    buffer (6 L + 2 L L,): Work buffer.
    """

    slot: IntArray
    used: IntArray
    differences: IntArray
    made: BoolArray
    pairs: Floats
    triples: Floats
    pair_most: FloatArray
    triple_most: FloatArray
    line_most: FloatArray
    buffer: Floats


def no_bounds(m: int, length: int, differences: IntArray) -> Bounds:
    """Bounds for dots of at most `m` columns and rows, none made yet."""
    # 4 turns, 2 axes, and some 2 m ranges of the dots along a line: all of them, or without those beyond one edge of the tape
    most = 16 * m
    return Bounds(
        np.full((4, 2, m + 1, m + 1), -1, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
        differences,
        np.empty((2, most, m), dtype=np.bool_),
        np.empty((most, m, length), dtype=np.float32),
        np.empty((most, m, length * length), dtype=np.float32),
        np.empty((most, m)),
        np.empty((most, m)),
        np.empty((most, m)),
        np.empty(6 * length + 2 * length * length, dtype=np.float32),
    )


@inner_kernel(fastmath=True)
def slot_of(
    of: Bounds,
    lines: Floats,
    turn: int,
    axis: int,
    dots: tuple[int | np.int64, int],
    count: int,
    span: tuple[int | np.int64, int],
    way: int,
) -> int:
    """Slot of the bounds for a range of dots along the lines (first, last + 1); made when first asked for.

    It has bounds of each of the `count` lines, and of the runs that `runs_of` makes of a span of them, as `bound_starts` and
    `bound_lines` need.
    """
    low, high = dots
    slot = of.slot[turn, axis, low, high]
    if slot < 0:
        # full: tapes that are smaller than the contact cut dots off at both edges, in more ways than there are slots
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
        length = of.pairs.shape[2]
        one = of.buffer[:length]
        for k in range(count):
            _fill_range(one, lines, dots, k)
            of.line_most[slot, k] = _most(one, np.int64(0), length)
            of.made[0, slot, k] = of.made[1, slot, k] = False
    before, threes, after = runs_of(span[1] - span[0], way)
    for j in range(threes):
        bound_three(of, slot, lines, dots, span[0] + before + 3 * j)
    if before == 2:
        bound_two(of, slot, lines, dots, span[0])
    if after == 2:
        bound_two(of, slot, lines, dots, span[1] - 2)
    return int(slot)


@inlined_kernel()
def _fill_range(out: Floats, lines: Floats, dots: tuple[int | np.int64, int], line: int) -> None:
    """Fill in the evidence of a range of the dots along a line, for the first len(out) phases."""
    low, high = dots
    for p in range(len(out)):
        out[p] = lines[high, line, p] - lines[low, line, p]


@inner_kernel(fastmath=True)
def bound_two(of: Bounds, slot: int, lines: Floats, dots: tuple[int | np.int64, int], line: int) -> None:
    """Fill `Bounds.pairs` for a line and the next, unless they are there (`evidence.add_lines` has the parameters).

    Whatever the sector, phases of lines differ by the plane's steps: the best phase for each step bounds two lines, or three.
    """
    if of.made[0, slot, line]:
        return
    length, least, greatest = of.pairs.shape[2], of.differences[0], of.differences[1]
    one, two, pairs = of.buffer[:length], of.buffer[length : 3 * length], of.pairs[slot, line]
    _fill_range(one, lines, dots, line)
    _fill_range(two, lines, dots, line + 1)
    # phases of neighbours differ by delta, so max over p of x[p] + x'[p + delta] bounds both wherever they lie
    for step in range(least, greatest + 1):
        most = one[0] + two[step]
        for p in range(1, length):
            most = max(most, one[p] + two[p + step])
        pairs[step] = most
    of.pair_most[slot, line] = _most(pairs, least, greatest + 1)
    of.made[0, slot, line] = True


@inner_kernel(fastmath=True)
def bound_three(of: Bounds, slot: int, lines: Floats, dots: tuple[int | np.int64, int], line: int) -> None:
    """Fill `Bounds.triples` for a line and the next two, unless they are there."""
    if of.made[1, slot, line]:
        return
    length, least, greatest = of.pairs.shape[2], of.differences[0], of.differences[1]
    one, two, three = of.buffer[:length], of.buffer[length : 3 * length], of.buffer[3 * length : 6 * length]
    _fill_range(one, lines, dots, line)
    _fill_range(two, lines, dots, line + 1)
    _fill_range(three[: 2 * length], lines, dots, line + 2)
    for p in range(length):
        three[2 * length + p] = three[p]
    _bound_threes(of.triples[slot, line], one, two, three, of.buffer[6 * length :], of.differences)
    of.triple_most[slot, line] = _most(of.triples[slot, line], least * length, (greatest + 1) * length)
    of.made[1, slot, line] = True


@inner_kernel(fastmath=True)
def _bound_threes(out: Floats, one: Floats, two: Floats, three: Floats, both: Floats, differences: IntArray) -> None:
    """Most of the sum of three lines for the steps from the first to the second (L), and on to the third (1).

    two, three (2 L,), (3 L,): Phases twice and three times over; ``both`` (2 L L,) is a work buffer.
    """
    length, least = len(one), differences[0]
    # entry (p, k): the second line at phase p and the third k further on; the first at p - step makes the sum of three
    for p in range(least, differences[1] + length):
        for k in range(length):
            both[p * length + k] = two[p] + three[p + k]
    most = out[least * length : (differences[1] + 1) * length]
    for p in range(length):
        # all steps at once: sums of the second and the third line are contiguous in memory, and long loops vectorise
        _raise(most, one[p], both[(p + least) * length :], p == 0)


@inner_kernel(fastmath=True)
def _raise(out: Floats, one: float, others: Floats, first: bool) -> None:
    """Set each value to the maximum of itself and a sum with another; if `first`, to the sum."""
    if first:
        for k in range(len(out)):
            out[k] = one + others[k]
    else:
        for k in range(len(out)):
            out[k] = max(out[k], one + others[k])


@inner_kernel(fastmath=True)
def _most(values: Floats, first: int, last: int) -> float:
    most = values[first]
    for k in range(first + 1, last):
        most = max(most, values[k])
    return float(most)


@inner_kernel()
def runs_of(lines: int, way: int) -> tuple[int, int, int]:
    """Lines taken together before threes (0 to 2), how many threes, and lines taken together after them (0 to 2).

    Lines can be taken together in three ways (`WAYS`), whose bounds differ: the least of them holds. Three lines and fewer are
    one run in each, and what they say is known exactly.
    """
    left, before = lines % 3, 0
    if lines > 3 and way == 1:
        before = left if left > 0 else 1
    elif lines > 3 and way == 2:
        before = 1 if left == 2 else 2
    threes = (lines - before) // 3
    return before, threes, lines - before - 3 * threes


@inner_kernel(fastmath=True)
def bound_starts(out: Floats, bounds: Bounds, slot: int, steps: Steps, lines: tuple[int, int], way: int) -> None:
    """Fill in the bound of some lines (first, last + 1) together for every place of the first in the plane; NEVER at its end."""
    first, number = lines[0], lines[1] - lines[0]
    before, threes, after = runs_of(number, way)
    # a line by itself is bounded by its largest entry, which is the same at every start
    count, behind, rest = len(out) - number + 1, before + 3 * threes, np.float32(0.0)
    if before == 1:
        rest += np.float32(bounds.line_most[slot, first])
    if after == 1:
        rest += np.float32(bounds.line_most[slot, lines[1] - 1])
    for start in range(len(out)):
        out[start] = rest if start < count else np.float32(NEVER)
    pairs = bounds.pairs[slot, first:]
    _add_runs(out, bounds.triples[slot, first:], steps[1], (np.int64(before), np.int64(3), np.int64(threes)), count)
    _add_runs(out, pairs, steps[0], (np.int64(behind), np.int64(2), np.int64(after // 2)), count)
    _add_runs(out, pairs, steps[0], (np.int64(0), np.int64(2), np.int64(before // 2)), count)


@inner_kernel(fastmath=True)
def _add_runs(out: Floats, bounds: Floats, steps: IntArray, runs: tuple[int, int, int], count: int) -> None:
    """Add the bounds of some runs at every start; ``runs`` are the first line, the lines of each run, and the number of runs."""
    first, each, number = runs
    for j in range(0, number - 1, 2):  # two at a time, so that the sums pass through memory half as often
        k = first + each * j
        one, two = bounds[k], bounds[k + each]
        for start in range(count):
            out[start] += one[steps[start + k]] + two[steps[start + k + each]]
    if number % 2 == 1:
        k = first + each * (number - 1)
        one = bounds[k]
        for start in range(count):
            out[start] += one[steps[start + k]]


@inner_kernel(fastmath=True)
def _larger(out: Floats, some: Floats, others: Floats) -> None:
    for k in range(len(out)):
        out[k] = max(some[k], others[k])


@inner_kernel(fastmath=True)
def largest_of(values: Floats, count: int, buffers: Floats) -> tuple[Floats, int]:
    """Largest of as many neighbouring values as a power of two, at least half of `count`, from each on; and how many those are.

    Two of them, which overlap, have any `count` neighbours between them. ``buffers`` are two as long as the values, overwritten.
    """
    largest, target, other, width, windows = values, buffers[0], buffers[1], 1, len(values)
    # doubling: the largest of 2 w neighbours is the larger of two windows of w, w apart; log2(count) passes in all
    while 2 * width <= count:  # of one value, of two, of four ...
        windows -= width
        _larger(target[:windows], largest, largest[width:])
        largest, target, other, width = target, other, target, 2 * width
    return largest, width


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
    _, threes, after = runs_of(last - first, np.int64(0))
    of_three, of_two, triple_most, pair_most = (
        bounds.triples[slot],
        bounds.pairs[slot],
        bounds.triple_most[slot],
        bounds.pair_most[slot],
    )
    whole, behind = bounds.line_most[slot, last - 1] if after == 1 else 0.0, first + 3 * threes
    for k in range(first, behind, 3):
        whole += triple_most[k]
    if after == 2:
        whole += pair_most[behind]
    for start in range(span[0], span[1]):
        at, bound = starts[start] + place, whole
        for k in range(first, behind, 3):
            bound += of_three[k, steps[1, at + k]] - triple_most[k]
            # a bound that was not followed to its end is still a bound, as each run only lowers it
            if bound < lowest:
                break
        if bound >= lowest and after == 2:
            bound += of_two[behind, steps[0, at + behind]] - pair_most[behind]
        out[start] = bound


@inlined_kernel()
def survivors(out: IntArray, bounds: FloatArray, first: int, last: int, least: float) -> tuple[int, float, float]:
    """Fill in the sites whose bound is at least `least`.

    Returns their number, the weight of the other sites as a number of sites at `least`, and the largest bound of these.
    """
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
                    # insertion sort: ascending as in `survivors`, so that sums are in one order however sites were found
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
