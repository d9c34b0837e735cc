"""Places counted: a group of them on one tape, place by place, into a tally of the best and of all the others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tactape_fab.base.jit import inlined_kernel, inner_kernel
from tactape_fab.sense.decode.search.bounds import NEVER
from tactape_fab.sense.decode.search.evidence import Floats, add_lines
from tactape_fab.sense.decode.search.groups import COLUMNS, ROWS, X, Y
from tactape_fab.sense.decode.search.plane_sites import ORIGIN, SECTOR, START
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

NEGLIGIBLE = -14.5
"""ln of the share of the answer's weight below which a group of places is counted at its bound, if not said otherwise."""
FAR_BELOW = 32.0
"""Single places that far (ln) below the answer are left out."""


class Tally(NamedTuple):
    """What was found so far.

    Attributes
    ----------
    sums : ndarray, shape (8,)
        ln of the best weight, the weight of all together as a multiple of it, ln L of the strongest place and of the next,
        the bound of ln L of all that were not looked at, what is negligible, the ln L from which on a place is looked at
        however little it weighs, and the share of the weight that is of bounds.
    best, strongest : ndarray of int, shape (6,)
        Turn, site, column, row, u and v of the place of most weight, and of that of largest L.
    """

    sums: FloatArray
    best: IntArray
    strongest: IntArray


def new_tally(floor: float = -np.inf, negligible: float = NEGLIGIBLE, likely: float = np.inf) -> Tally:
    """A tally with nothing in it; weights are held against `floor` from the start, and places as `likely` are looked at."""
    sums = np.array([floor, 0.0, -np.inf, -np.inf, -np.inf, negligible, likely, 0.0])
    return Tally(sums, np.full(6, -1, dtype=np.int64), np.full(6, -1, dtype=np.int64))


class Room(NamedTuple):
    """Room to work in, written over and over: kernels make no arrays.

    Attributes
    ----------
    lines : ndarray of float32, shape (2, k, L)
        Evidence of columns and of rows for every phase.
    most : ndarray, shape (2, k)
        The largest of each.
    allowed : ndarray of bool, shape (L, L)
        Sectors that are not barred.
    """

    lines: Floats
    most: FloatArray
    allowed: BoolArray


@inner_kernel()
def least_of(of: float, terms: tuple[float, float], sums: FloatArray) -> float:
    """The least ln E that may matter in a group of places; `drop` has the parameters."""
    return float(min(sums[0] + sums[5] - of - terms[0], sums[6] - terms[1]))


@inner_kernel()
def drop(bound: float, places: float, of: float, terms: tuple[float, float], sums: FloatArray) -> bool:
    """Whether some places cannot matter; they are counted then as if each were as good as their bound.

    Parameters
    ----------
    bound : float
        ln E that none of them exceeds.
    places, of : float
        How many there are, and ln of how many in their group on all sites: all of these together may be negligible.
    terms : tuple of float
        ln of the weight of each, and ln of what speaks for its turn besides the bits.
    """
    if bound >= least_of(of, terms, sums):
        return False
    count_bound(places * np.exp(bound + terms[0] - sums[0]), bound + terms[1], sums)
    return True


@inner_kernel()
def count_bound(weight: float, likelihood: float, sums: FloatArray) -> None:
    """Add places that are not looked at, at a bound of their weight and of their ln L."""
    sums[1] += weight
    sums[7] += weight
    sums[4] = max(sums[4], likelihood)


@inner_kernel()
def weigh_site(
    known: Floats,
    lines: Floats,
    phases: IntArray,
    place: IntArray,
    barred: IntArray,
    at: tuple[int, int],
    group: IntArray,
    limit: tuple[float, float],
    of: float,
    terms: tuple[float, float],
    tally: Tally,
    room: Room,
    hole: Floats,
    stride: int,
) -> None:
    """One group of places on one site: the axis with fewer places first, the other only if that may matter.

    Parameters
    ----------
    known : ndarray
        Bounds of what the x bits say at each column of the group, which are looked at one by one then; or empty.
    place : ndarray of int, shape (3, 2)
        The site's entry in `Sites.table`; `at` is turn and site.
    limit : tuple of float
        Bounds of what the x and the y bits say.
    of : float
        ln of the number of places of the group on all sites.
    hole, stride : ndarray, int
        `groups.hole_evidence` from the group's first place on, and its width; 0 without holes.
    """
    length = room.lines.shape[2]
    every = place[SECTOR, 0] < 0
    places = float(group[COLUMNS] * group[ROWS] * (length * length if every else 1))
    axis, bound = (0 if group[COLUMNS] <= group[ROWS] or len(known) > 0 else 1), limit[0] + limit[1]
    for _ in range(2):
        own, other = 4 * axis, 4 * (1 - axis)  # fields of a group: columns, then rows
        most = NEVER
        for k in range(group[own + 1]):
            room.most[axis, k] = NEVER
            if axis == 0 and len(known) > 0 and drop(known[k] + limit[1], places / group[COLUMNS], of, terms, tally.sums):
                continue
            value = add_lines(
                room.lines[axis, k],
                lines[axis],
                group[other + 2],
                group[other + 3],
                group[own + 2],
                group[own + 3],
                phases[axis],
                place[START, axis] + group[own] + k,
                length,
            )
            room.most[axis, k] = value
            most = max(most, value)
        bound += most - limit[axis]
        if most == NEVER or (stride == 0 and drop(bound, places, of, terms, tally.sums)):
            return
        axis = 1 - axis
    row, column = place[ORIGIN, 1] + group[Y], place[ORIGIN, 0] + group[X]
    where = (at[0], at[1], group[X], group[Y])
    if every:
        _count_every_sector(where, group[COLUMNS], group[ROWS], row, column, barred, of, terms, tally, room)
    else:
        phase = (row + place[SECTOR, 0], column + place[SECTOR, 1])
        _count_sector(where, group[COLUMNS], group[ROWS], phase, place[SECTOR], terms, tally, room, hole, stride)


@inlined_kernel()
def _count_sector(
    at: tuple[int, int, int, int],
    columns: int,
    rows: int,
    phase: tuple[int, int],
    sector: IntArray,
    terms: tuple[float, float],
    tally: Tally,
    room: Room,
    hole: Floats,
    stride: int,
) -> None:
    """Places of a group where one sector lies."""
    length, sums, y_best = room.lines.shape[2], tally.sums, NEVER
    for j in range(rows):
        y_best = max(y_best, room.most[1, j])
    for i in range(columns):
        best = room.most[0, i] + y_best
        if stride == 0 and best + terms[0] < sums[0] - FAR_BELOW and best + terms[1] < sums[3]:
            continue
        if room.most[0, i] == NEVER:
            continue
        y_phase, x_phase = (phase[1] + i) % length, phase[0] % length
        for j in range(rows):
            value = float(room.lines[0, i, x_phase]) + float(room.lines[1, j, y_phase])
            x_phase = x_phase + 1 if x_phase + 1 < length else 0
            if stride > 0:
                value -= float(hole[j * stride + i])
            if value + terms[0] > sums[0] - FAR_BELOW or value + terms[1] > sums[3]:
                place = (at[0], at[1], at[2] + i, at[3] + j, sector[0], sector[1])
                count_at(tally, np.float64(value), 1.0, terms, place)  # single precision would be another function to compile


@inner_kernel()
def count_at(
    tally: Tally, value: float, weight: float, terms: tuple[float, float], at: tuple[int, int, int, int, int, int]
) -> None:
    """Add a place, or several that together weigh so many times the best of them."""
    sums = tally.sums
    score, likelihood = value + terms[0], value + terms[1]
    if score > sums[0] or (tally.best[0] < 0 and score > sums[0] - 1e-6):
        sums[1] *= np.exp(sums[0] - score)
        sums[7] *= np.exp(sums[0] - score)
        sums[0] = score
        for k in range(6):
            tally.best[k] = at[k]
    sums[1] += weight * np.exp(score - sums[0])
    if likelihood > sums[2]:
        sums[3] = sums[2]
        sums[2] = likelihood
        for k in range(6):
            tally.strongest[k] = at[k]
    elif likelihood > sums[3]:
        sums[3] = likelihood


@inlined_kernel()
def _count_every_sector(
    at: tuple[int, int, int, int],
    columns: int,
    rows: int,
    row: int,
    column: int,
    barred: IntArray,
    of: float,
    terms: tuple[float, float],
    tally: Tally,
    room: Room,
) -> None:
    """Places of a group where any sector may lie but the barred ones: every pair of phases is one sector."""
    length = room.lines.shape[2]
    for i in range(columns):
        if room.most[0, i] == NEVER:
            continue
        for j in range(rows):
            most = room.most[0, i] + room.most[1, j]
            if drop(most, float(length * length), of, terms, tally.sums):
                continue
            x_sum, p_best = _sum_and_best(room.lines[0, i], room.most[0, i])
            y_sum, r_best = _sum_and_best(room.lines[1, j], room.most[1, j])
            u, v = (p_best - row - j) % length, (r_best - column - i) % length
            total, out, among = x_sum * y_sum, 0.0, False
            for k in range(len(barred)):
                if barred[k, 0] == at[1]:
                    p, r = (row + j + barred[k, 1]) % length, (column + i + barred[k, 2]) % length
                    out += np.exp(float(room.lines[0, i, p]) + float(room.lines[1, j, r]) - most)
                    among = among or (barred[k, 1] == u and barred[k, 2] == v)
            total -= out
            if among or out > total:
                most, total, u, v = _without(room, (i, j), row + j, column + i, barred, at[1])
            if total > 0.0:
                count_at(tally, most, total, terms, (at[0], at[1], at[2] + i, at[3] + j, u, v))


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
def _without(
    room: Room, at: tuple[int, int], row: int, column: int, barred: IntArray, site: int
) -> tuple[float, float, int, int]:
    """The best of the sectors that are not barred, the weight of all of them as a multiple of it, and which it is."""
    x, y, allowed = room.lines[0, at[0]], room.lines[1, at[1]], room.allowed
    length = len(x)
    for p in range(length):
        for r in range(length):
            allowed[p, r] = True
    for k in range(len(barred)):
        if barred[k, 0] == site:
            allowed[(row + barred[k, 1]) % length, (column + barred[k, 2]) % length] = False
    most, total, u, v = NEVER, 0.0, row - row, row - row
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
