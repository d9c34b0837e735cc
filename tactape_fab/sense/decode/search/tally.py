"""Running sums of a search: places of a group on one tape are added to a tally of the best place and of all others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tactape_fab.base.jit import inlined_kernel, inner_kernel
from tactape_fab.sense.decode.search.bounds import NEVER, Bounds
from tactape_fab.sense.decode.search.evidence import Floats, Tables, add_lines, add_lines_at, fill_range
from tactape_fab.sense.decode.search.groups import COLUMNS, ROWS, X, Y
from tactape_fab.sense.decode.search.plane_sites import ORIGIN, SECTOR, START
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

NEGLIGIBLE = -14.5
"""Default ln of the share of the answer's weight below which a group of places is counted at its bound."""
ROUNDING = 0.1
"""Margin (ln) for rounding of bounds in single precision."""
FAR_BELOW = 32.0
"""Single places so far (ln) below the answer are neglected."""


BEST, TOTAL, STRONGEST, NEXT_STRONGEST, LEFT_OUT, LEAST_SHARE, LIKELY, BOUNDED, FITS = range(9)
"""Fields of `Tally.sums`: ln of the best weight, and the weight of all places together as a multiple of it; ln L of the strongest
place, of the next, and its bound at all that were not looked at; ln of the share of the best weight that is negligible, and the
ln L from which on a place is looked at however little it weighs; the part of the weight of all that is of bounds; ln of the best
weight below which the weight of all may stay unknown, and `TOTAL` is infinite then."""


_NO_SUMS = np.array([-np.inf, 0.0, -np.inf, -np.inf, -np.inf, NEGLIGIBLE, np.inf, 0.0, -np.inf])
_NOWHERE = np.full(6, -1, dtype=np.int64)


class Tally(NamedTuple):
    """Running result of a search: the best place, and the weight of all.

    sums (9,): `BEST` ... `FITS`. An array: a call with a tuple that holds a record takes numba 15 us more.
    best_place, strongest_place (6,): Turn, site, column, row, u and v of the place of most weight, and of that of largest L.
    """

    sums: FloatArray
    best_place: IntArray
    strongest_place: IntArray


def new_tally(floor: float = -np.inf, negligible: float = NEGLIGIBLE, likely: float = np.inf, fits: float = -np.inf) -> Tally:
    """An empty tally with `floor` as its best weight (ln); places whose ln L may reach `likely` are always evaluated.

    fits: If ln of the best weight is below this, the total weight need not be known.
    """
    sums = _NO_SUMS.copy()
    sums[BEST], sums[LEAST_SHARE], sums[LIKELY], sums[FITS] = floor, negligible, likely, fits
    return Tally(sums, _NOWHERE.copy(), _NOWHERE.copy())


@inner_kernel()
def is_uninformative(tally: Tally) -> bool:
    """Whether no second search is needed after one for the best place alone, because that place does not fit.

    Otherwise the tally is reset except for the best weight, which stays as a floor: its place is found again.
    """
    if tally.sums[BEST] < tally.sums[FITS]:
        tally.sums[TOTAL], tally.sums[BOUNDED] = np.inf, 0.0
        return True
    tally.sums[TOTAL] = tally.sums[BOUNDED] = 0.0
    tally.sums[STRONGEST] = tally.sums[NEXT_STRONGEST] = tally.sums[LEFT_OUT] = -np.inf
    for k in range(6):
        tally.best_place[k] = tally.strongest_place[k] = -1
    return False


class Candidate(NamedTuple):
    """One group of places on one site, with its bounds and prior weights.

    known: Upper bounds of the x bits' evidence at each column of the group, which is then searched column by column; or empty.
    place (3, 2): The site's entry in `Sites.table`.
    at: Turn and site.
    group (9,): From `groups.groups_of`.
    limit: Upper bounds of the evidence of the x and of the y bits.
    of: ln of the number of places of the group on all sites.
    terms: ln of the prior weight of each place, and ln of the prior of its turn.
    holed (2, m + 1): `Sites.holed` of the site: places where the dots reach lines with holes on both axes are left out.
    """

    known: Floats
    place: IntArray
    at: tuple[int, int]
    group: IntArray
    limit: tuple[float, float]
    of: float
    terms: tuple[float, float]
    holed: IntArray


class Buffers(NamedTuple):
    """Work buffers, overwritten for each candidate: kernels allocate no arrays.

    lines (2, k, L): Evidence of columns and of rows for every phase, or for those from the group's first row and column on.
    most (2, k): The largest of each.
    shares (k,): exp of the largest of each row, over the largest of all.
    rows (2, k): Rows of a group that are over holes, and the same modulo L.
    evidence (2, m + 1, 2 L): Of a group's dots along its columns and rows, from `fill_group`; the last row is zero.
    allowed (L, L): Sectors that are not barred.
    """

    lines: Floats
    most: FloatArray
    shares: FloatArray
    rows: IntArray
    evidence: Floats
    allowed: BoolArray


class ManyBuffers(NamedTuple):
    """Work buffers for many sites.

    starts (4, 2, columns or rows of the plane): From `_bound_turn`, or the largest of each entry of `evidence`.
    evidence (4, 2, columns or rows of the plane, L): Of all dots with their column or row 0 there, for every phase; of the turns
        in `known_turns` alone, from `_fill_everywhere`. Empty where L is large.
    known_turns (4,): Whether `evidence` is of a turn.
    ways (4,): In how many ways `starts` is bounded, by turn.
    bounds, of_rows (n,): From `_bound_inside`.
    of_each_row (rows, n): Of `holes`; empty where no tape has any.
    of_starts (2, n): From `_bound_over`, by `Sites.starts`.
    everywhere (3, columns or rows of the plane): Work buffers of bounds.
    chosen (n,): From `survivors`.
    guess: Of `_first_guess`.
    whole (2, m): Of `holes`.
    """

    known: Bounds
    starts: Floats
    evidence: Floats
    known_turns: BoolArray
    ways: IntArray
    bounds: FloatArray
    of_rows: FloatArray
    of_each_row: Floats
    of_starts: FloatArray
    everywhere: Floats
    chosen: IntArray
    guess: Tally
    whole: IntArray


@inner_kernel()
def least_of(of: float, terms: tuple[float, float], sums: FloatArray) -> float:
    """The least ln E that may matter in a group of places; `drop` has the parameters."""
    # a group is left out if all its places at the bound weigh less than the share, and no single one is as likely as `LIKELY`
    return float(min(sums[BEST] + sums[LEAST_SHARE] - of - terms[0], sums[LIKELY] - terms[1]))


@inner_kernel()
def drop(bound: float, places: float, of: float, terms: tuple[float, float], sums: FloatArray) -> bool:
    """Whether some places cannot matter; if so, they are counted as if each had the evidence of the bound.

    bound: ln E that none of them exceeds.
    places, of: How many there are, and ln of how many in their group on all sites: all of these together may be negligible.
    terms: ln of the prior weight of each, and ln of the prior of its turn.
    """
    if bound >= least_of(of, terms, sums):
        return False
    count_bound(places * np.exp(bound + terms[0] - sums[BEST]), bound + terms[1], sums)
    return True


@inner_kernel()
def count_bound(weight: float, likelihood: float, sums: FloatArray) -> None:
    """Add places that are not evaluated, by bounds of their weight and of their ln L."""
    sums[TOTAL] += weight
    sums[BOUNDED] += weight
    sums[LEFT_OUT] = max(sums[LEFT_OUT], likelihood)


@inner_kernel()
def fill_group(tables: Tables, turn: int, group: IntArray, buffers: Buffers) -> None:
    """Fill `Buffers.evidence` for a group, which `weigh_site` needs."""
    for axis in range(2):
        other = 4 * (1 - axis)
        fill_range(
            buffers.evidence[axis], tables.lines[turn, axis], (group[other + 2], group[other + 3]), tables.size[turn, axis]
        )


@inner_kernel(no_rewrites=False)
def weigh_site(candidate: Candidate, phases: IntArray, barred: IntArray | None, tally: Tally, buffers: Buffers) -> None:
    """Count one group of places on one site: the axis with fewer places first, the other only if it may matter.

    For a single sector only the phases that occur in the group are evaluated: column c shows the x phases r + u of the group's
    rows r, and row r the y phases c + v of its columns (docs/codes.md).
    Without `barred` no site holds all sectors.
    """
    known, place, group, limit, terms = candidate.known, candidate.place, candidate.group, candidate.limit, candidate.terms
    length = buffers.lines.shape[2]
    every = place[SECTOR, 0] < 0
    places = float(group[COLUMNS] * group[ROWS] * (length * length if every else 1))
    axis, bound = (0 if group[COLUMNS] <= group[ROWS] or len(known) > 0 else 1), limit[0] + limit[1]
    for _ in range(2):
        own, other, most = 4 * axis, 4 * (1 - axis), NEVER  # fields of a group: columns, then rows
        phase, count = np.int64(0), length
        if not every:
            # phase of a column at the group's first row: X[r, c] = M[r + u + ...] (docs/codes.md); one further on for each row,
            # all L at most
            phase, count = (place[ORIGIN, 1 - axis] + group[other] + place[SECTOR, axis]) % length, min(length, group[other + 1])
        known_here = axis == 0 and len(known) > 0
        if count == 1 and not known_here:
            most = add_lines_at(
                buffers.lines[axis],
                buffers.most[axis],
                buffers.evidence[axis],
                (group[own + 2], group[own + 3]),
                phases[axis],
                place[START, axis] + group[own],
                phase,
                group[own + 1],
            )
        for k in range(0 if count > 1 or known_here else group[own + 1], group[own + 1]):
            buffers.most[axis, k] = NEVER
            each = places / group[COLUMNS]
            if known_here and drop(known[k] + limit[1], each, candidate.of, terms, tally.sums):
                continue
            value = add_lines(
                buffers.lines[axis, k, :count],
                buffers.evidence[axis],
                (group[own + 2], group[own + 3]),
                phases[axis],
                place[START, axis] + group[own] + k,
                phase,
            )
            buffers.most[axis, k] = value
            most = max(most, value)
        # replace the general limit of this axis by its largest evidence here
        bound += most - limit[axis]
        if most == NEVER or drop(bound, places, candidate.of, terms, tally.sums):
            return
        axis = 1 - axis
    if barred is not None and every:
        _count_every_sector(candidate, barred, tally, buffers)
    else:
        _count_sector(candidate, tally, (buffers.lines[0], buffers.lines[1]), buffers.most, (np.int64(0), np.int64(0)))


@inner_kernel()
def weigh_known(candidate: Candidate, evidence: Floats, of_rows: Floats, tally: Tally, buffers: Buffers) -> None:
    """Count one group of places on one site from precomputed evidence, entries of `ManyBuffers.evidence`.

    of_rows: The largest of it at each row of the group.
    """
    known, place, group, limit, terms = candidate.known, candidate.place, candidate.group, candidate.limit, candidate.terms
    length, open_columns = buffers.lines.shape[2], 0
    for k in range(group[COLUMNS]):
        buffers.most[0, k] = NEVER
        if not drop(known[k] + limit[1], float(group[ROWS]), candidate.of, terms, tally.sums):
            buffers.most[0, k] = known[k]
            open_columns += 1
    if open_columns == 0:
        return
    for k in range(group[ROWS]):
        buffers.most[1, k] = of_rows[k]
    lines = evidence[0, place[START, 0] + group[X] :], evidence[1, place[START, 1] + group[Y] :]
    row, column = place[ORIGIN, 1] + group[Y] + place[SECTOR, 0], place[ORIGIN, 0] + group[X] + place[SECTOR, 1]
    _count_sector(candidate, tally, lines, buffers.most, (row % length, column % length))


@inner_kernel()
def over_holes(holed: IntArray, group: IntArray, axis: int, place: int) -> bool:
    """Whether some of a group's dots' columns (rows) at one of its places are columns (rows) of the tape that have holes."""
    own = 4 * axis
    at = group[own] + place
    return bool(holed[axis, at + group[own + 3]] > holed[axis, at + group[own + 2]])


@inner_kernel()
def _count_sector(
    candidate: Candidate, tally: Tally, lines: tuple[Floats, Floats], most: FloatArray, first: tuple[int, int]
) -> None:
    """Count the places of a group on a site of one sector.

    lines: Evidence of the group's columns, and of its rows, by phase.
    most (2, k): The largest of each; NEVER for columns that were counted already.
    first: Index of the first row's phase in the evidence of columns, and of the first column's phase in that of rows.
    """
    place, group, terms = candidate.place, candidate.group, candidate.terms
    (of_columns, of_rows), y_phase, y_best = lines, first[1], NEVER
    length = of_columns.shape[1]
    for j in range(group[ROWS]):
        y_best = max(y_best, most[1, j])
    for i in range(group[COLUMNS]):
        here, y_phase = y_phase, y_phase + 1 if y_phase + 1 < length else 0
        best = most[0, i] + y_best
        if best + terms[0] < tally.sums[BEST] - FAR_BELOW and best + terms[1] < tally.sums[NEXT_STRONGEST]:
            continue
        if most[0, i] == NEVER:
            continue
        x_phase = first[0]
        near = over_holes(candidate.holed, group, np.int64(0), i)
        for j in range(group[ROWS]):
            value = float(of_columns[i, x_phase]) + float(of_rows[j, here])
            x_phase = x_phase + 1 if x_phase + 1 < length else 0
            if near and over_holes(candidate.holed, group, np.int64(1), j):
                continue
            if value + terms[0] > tally.sums[BEST] - FAR_BELOW or value + terms[1] > tally.sums[NEXT_STRONGEST]:
                at = (candidate.at[0], candidate.at[1], group[X] + i, group[Y] + j, place[SECTOR, 0], place[SECTOR, 1])
                count_at(tally, np.float64(value), 1.0, terms, at)  # single precision would be another function to compile


@inner_kernel()
def count_at(
    tally: Tally, value: float, weight: float, terms: tuple[float, float], at: tuple[int, int, int, int, int, int]
) -> None:
    """Add a place, or several whose total weight is so many times that of the best of them."""
    score, likelihood = value + terms[0], value + terms[1]
    # weights are multiples of the best, so that none overflows: a new best rescales them
    # with a floor from elsewhere `BEST` has a value and no place: the same place again may come out lower by rounding
    if score > tally.sums[BEST] or (tally.best_place[0] < 0 and score > tally.sums[BEST] - 1e-6):
        tally.sums[TOTAL] *= np.exp(tally.sums[BEST] - score)
        tally.sums[BOUNDED] *= np.exp(tally.sums[BEST] - score)
        tally.sums[BEST] = score
        for k in range(6):
            tally.best_place[k] = at[k]
    tally.sums[TOTAL] += weight * np.exp(score - tally.sums[BEST])
    # the strongest by L need not be the best by weight: turns and places over an edge weigh differently
    if likelihood > tally.sums[STRONGEST]:
        tally.sums[NEXT_STRONGEST] = tally.sums[STRONGEST]
        tally.sums[STRONGEST] = likelihood
        for k in range(6):
            tally.strongest_place[k] = at[k]
    elif likelihood > tally.sums[NEXT_STRONGEST]:
        tally.sums[NEXT_STRONGEST] = likelihood


@inner_kernel()
def _first_of(barred: IntArray, site: int) -> int:
    """The first row of a site, or of one after it; numba's own search makes an array of the site, which no kernel can."""
    low, high = 0, len(barred)
    while low < high:
        middle = (low + high) >> 1
        if barred[middle, 0] < site:
            low = middle + 1
        else:
            high = middle
    return low


@inlined_kernel()
def _count_every_sector(candidate: Candidate, barred: IntArray, tally: Tally, buffers: Buffers) -> None:
    """Count the places of a group on a site of all sectors but the barred ones: every pair of phases is one sector."""
    at, group, of, terms = candidate.at, candidate.group, candidate.of, candidate.terms
    row, column = candidate.place[ORIGIN, 1] + group[Y], candidate.place[ORIGIN, 0] + group[X]
    length, x_most, y_most, y_shares, shares, left_out = buffers.lines.shape[2], NEVER, NEVER, 0.0, 0.0, NEVER
    for i in range(group[COLUMNS]):
        x_most = max(x_most, buffers.most[0, i])
    for j in range(group[ROWS]):
        y_most = max(y_most, buffers.most[1, j])
    # places that are left out are counted at exp(most of a column + most of a row), which is a product of what both have
    for j in range(group[ROWS]):
        buffers.shares[j] = np.exp(buffers.most[1, j] - y_most)
        y_shares += buffers.shares[j]
    for i in range(group[COLUMNS]):
        if buffers.most[0, i] == NEVER:
            continue
        share = np.exp(buffers.most[0, i] - x_most)
        if buffers.most[0, i] + y_most < least_of(of, terms, tally.sums):
            shares, left_out = shares + share * y_shares, max(left_out, buffers.most[0, i] + y_most)
            continue
        for j in range(group[ROWS]):
            most = buffers.most[0, i] + buffers.most[1, j]
            if most < least_of(of, terms, tally.sums):
                shares, left_out = shares + share * buffers.shares[j], max(left_out, most)
                continue
            x_sum, p_best = _sum_and_best(buffers.lines[0, i], buffers.most[0, i])
            y_sum, r_best = _sum_and_best(buffers.lines[1, j], buffers.most[1, j])
            # x phase = row + u and y phase = column + v, modulo L: a pair of phases names the sector
            u, v = (p_best - row - j) % length, (r_best - column - i) % length
            total, out, among = x_sum * y_sum, 0.0, False  # the sum over all pairs of phases is a product
            # they ascend by site; of thousands of tapes few are barred at one
            own = barred[_first_of(barred, at[1]) : _first_of(barred, at[1] + 1)]
            for k in range(len(own)):
                p, r = (row + j + own[k, 1]) % length, (column + i + own[k, 2]) % length
                out += np.exp(float(buffers.lines[0, i, p]) + float(buffers.lines[1, j, r]) - most)
                among = among or (own[k, 1] == u and own[k, 2] == v)
            total -= out
            if among or out > total:  # the difference has lost its digits, or the best one is barred
                most, total, u, v = _without(buffers, (i, j), row + j, column + i, own)
            if total > 0.0:
                count_at(tally, most, total, terms, (at[0], at[1], group[X] + i, group[Y] + j, u, v))
    if shares > 0.0:
        # each pair of a column and a row that was left out stands for L^2 sectors, all at its bound
        weight = length * length * shares * np.exp(x_most + y_most + terms[0] - tally.sums[BEST])
        count_bound(weight, left_out + terms[1], tally.sums)


@inner_kernel()
def _sum_and_best(line: Floats, most: float) -> tuple[float, int]:
    """Sum of exp(evidence - most) over all phases, and the phase of the largest."""
    total, best = 0.0, 0
    for p in range(len(line)):
        total += np.exp(float(line[p]) - most)
        if line[p] > line[best]:
            best = p
    return total, best


@inlined_kernel()
def _without(buffers: Buffers, at: tuple[int, int], row: int, column: int, barred: IntArray) -> tuple[float, float, int, int]:
    """The best of the sectors that are not barred, the weight of all of them as a multiple of it, and which it is."""
    x, y, allowed = buffers.lines[0, at[0]], buffers.lines[1, at[1]], buffers.allowed
    length = len(x)
    for p in range(length):
        for r in range(length):
            allowed[p, r] = True
    for k in range(len(barred)):
        allowed[(row + barred[k, 1]) % length, (column + barred[k, 2]) % length] = False
    most, total = NEVER, 0.0
    u = v = 0
    for p in range(length):
        for r in range(length):
            value = float(x[p]) + float(y[r])
            if allowed[p, r] and value > most:
                most, u, v = value, (p - row) % length, (r - column) % length
    for p in range(length):
        for r in range(length):
            if allowed[p, r]:
                total += np.exp(float(x[p]) + float(y[r]) - most)
    return most, total, u, v
