"""Every place of many tapes held against the dots: the best one, what all others weigh together, and the strongest of them.

Places are taken in groups, by which of the dots' columns and rows lie on the tape: all of them, or some where the contact
hangs over an edge. A group that cannot matter is counted at its bound; all others are evaluated place by place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from tactape_fab.decode.bounds import (
    NEVER,
    Bounds,
    bound_between,
    bound_lines,
    bound_starts,
    most_of_sites,
    no_bounds,
    slot_of,
    survivors,
)
from tactape_fab.decode.evidence import Floats, Tables, add_lines
from tactape_fab.decode.groups import COLUMNS, OVER, ROWS, X, Y, hole_evidence
from tactape_fab.decode.sites import ORIGIN, SECTOR, START, Sites
from tactape_fab.texture.frames import FloatArray, IntArray

NEGLIGIBLE = -19.0
"""ln of the share of the answer's weight below which places are counted at their bound."""
FAR_BELOW = 32.0
"""Single places that far (ln) below the answer are left out."""
MANY = 6
"""From so many sites of a size a cheap bound for each is worth its tables."""


class Tally(NamedTuple):
    """What was found so far.

    Attributes
    ----------
    sums : ndarray, shape (5,)
        ln of the best weight, the weight of all together as a multiple of it, ln L of the strongest place and of the next,
        and the bound of ln L of all that were not looked at.
    best, strongest : ndarray of int, shape (6,)
        Turn, site, column, row, u and v of the place of most weight, and of that of largest L.
    """

    sums: FloatArray
    best: IntArray
    strongest: IntArray


def new_tally(floor: float = -np.inf) -> Tally:
    """A tally with nothing in it; weights are held against `floor` from the start."""
    sums = np.array([floor, 0.0, -np.inf, -np.inf, -np.inf])
    return Tally(sums, np.full(6, -1, dtype=np.int64), np.full(6, -1, dtype=np.int64))


class Room(NamedTuple):
    """Evidence of columns and of rows for every phase (2, k, L), and the largest of each (2, k); written over and over."""

    lines: Floats
    most: FloatArray


@njit(cache=True, error_model="numpy")
def weigh_sites(
    tables: Tables,
    sites: Sites,
    groups: IntArray,
    spans: IntArray,
    limits: FloatArray,
    base: FloatArray,
    cue: FloatArray,
    tally: Tally,
) -> None:
    """Hold the dots against every place of every site, and add what is found to a tally.

    Parameters
    ----------
    groups, spans, limits : ndarray
        From `groups.groups_of`.
    base : ndarray, shape (4, 2)
        ln of the weight of one place, by turn, with all dots on the tape and with some over its edge.
    cue : ndarray, shape (4,)
        ln of what speaks for each turn besides the bits; L = E times it.
    """
    length, count, classes, sums = len(sites.signs) // 3, len(sites.table), sites.classes, tally.sums
    hole_starts, said = hole_evidence(tables, sites)
    whole, pad = len(sites.holes) == 0, tables.dots.shape[1]
    room = Room(np.empty((2, sites.sizes.max(), length), dtype=np.float32), np.empty((2, sites.sizes.max())))
    bounds, chosen, known = np.empty(count), np.arange(count), no_bounds(pad - 1, length)
    columns = _column_bounds(tables, sites, known, count >= MANY)
    if count >= MANY and sums[0] < base.max() + 0.5 * limits[:, :2].sum(axis=1).max():  # nothing good is known yet
        sums[0] = max(sums[0], first_guess(tables, sites, groups, spans, limits, known, columns, base, room))
    for over, k, turn in np.ndindex(2, len(classes), 4):
        first, last, size, overhang = classes[k, 0], classes[k, 1], classes[k, 2], classes[k, 4]
        bounded, terms, added = whole and last - first >= MANY, (float(base[turn, over]), float(cue[turn])), base[turn, over]
        added += np.log(float(classes[k, 3] * (last - first)))
        for g in range(spans[turn, size, 0], spans[turn, size, 1] if over <= overhang else 0):
            if groups[g, OVER] != over:
                continue
            bound = limits[g, 0] + limits[g, 1]
            if whole and bound + limits[g, 2] + added < sums[0] + NEGLIGIBLE:
                sums[1] += np.exp(bound + limits[g, 2] + added - sums[0])
                sums[4] = max(sums[4], bound + cue[turn])
                continue
            many, places = last - first, float(classes[k, 3] * groups[g, COLUMNS] * groups[g, ROWS])
            if bounded:
                axis = 1 if over == 1 and groups[g, COLUMNS] > 1 else 0
                rest = limits[g, 1 - axis]
                least = sums[0] + NEGLIGIBLE - limits[g, 2] - added - rest
                if over == 0:
                    most_of_sites(bounds, columns[turn], sites.table, 0, groups[g, COLUMNS], first, last)
                else:
                    _bound_group(bounds, known, tables, sites, groups[g], turn, axis, (first, last), least)
                many, dropped, most = survivors(chosen, bounds, first, last, least)
                sums[1] += dropped / (last - first) * np.exp(NEGLIGIBLE)
                sums[4] = max(sums[4], most + rest + cue[turn])
            for c in range(many):
                site = chosen[c] if bounded else first + c
                hole, stride = said[turn, :0], 0
                if hole_starts[site] >= 0:
                    stride = sites.sizes[size, 0] + 2 * pad
                    hole = said[turn, hole_starts[site] + (groups[g, Y] + pad) * stride + groups[g, X] + pad :]
                start, y_limit = sites.table[site, START, 0], limits[g, 1]
                if bounded and over == 0:
                    wide, high = tables.size[turn]
                    slot = slot_of(known, tables.lines[turn, 1], turn, 1, 0, wide, high)
                    row = sites.table[site, START, 1]
                    y_limit = bound_between(known.pairs[slot], high, sites.steps[1], row, row + groups[g, ROWS])
                    if drop(bounds[site] + y_limit, places, terms, sums):
                        continue
                of_columns = columns[turn, start : start + groups[g, COLUMNS]] if bounded and over == 0 else columns[0, :0]
                weigh_site(
                    of_columns,
                    tables.lines[turn],
                    sites.phases,
                    sites.table[site],
                    sites.barred,
                    (turn, site),
                    groups[g],
                    (limits[g, 0], y_limit),
                    terms,
                    tally,
                    room,
                    hole,
                    stride,
                )


@njit(cache=True, error_model="numpy")
def _column_bounds(tables: Tables, sites: Sites, known: Bounds, wanted: bool) -> Floats:
    """Bound of what the x bits say where the dots' column 0 lies on each column of the plane; shape (4, columns), or (4, 0)."""
    out = np.empty((4, sites.phases.shape[1] if wanted else 0), dtype=np.float32)
    for turn in range(4 if wanted else 0):
        wide, high = tables.size[turn]
        slot = slot_of(known, tables.lines[turn, 0], turn, 0, 0, high, wide)
        bound_starts(out[turn], known.pairs[slot], sites.steps[0], wide)
    return out


@njit(cache=True, error_model="numpy")
def _bound_group(
    out: FloatArray,
    known: Bounds,
    tables: Tables,
    sites: Sites,
    group: IntArray,
    turn: int,
    axis: int,
    span: tuple[int, int],
    least: float,
) -> None:
    """Most that the bits of one axis can say on each of some sites for a group with one place along it."""
    own, other = 4 * axis, 4 * (1 - axis)  # fields of a group: columns, then rows
    count = tables.size[turn, axis]
    slot = slot_of(known, tables.lines[turn, axis], turn, axis, group[other + 2], group[other + 3], count)
    lines = (group[own + 2], group[own + 3], count)
    bound_lines(out, known, slot, sites.steps[axis], sites.table, axis, group[own], lines, span, least)


@njit(cache=True, error_model="numpy")
def drop(bound: float, places: float, terms: tuple[float, float], sums: FloatArray) -> bool:
    """Whether some places cannot matter; they are counted at their bound then."""
    if bound + terms[0] + np.log(places) >= sums[0] + NEGLIGIBLE:
        return False
    count_bound(bound, places, terms, sums)
    return True


@njit(cache=True, error_model="numpy")
def count_bound(bound: float, places: float, terms: tuple[float, float], sums: FloatArray) -> None:
    """Count some places as if each were as good as their bound."""
    sums[1] += places * np.exp(bound + terms[0] - sums[0])
    sums[4] = max(sums[4], bound + terms[1])


@njit(cache=True, error_model="numpy")
def first_guess(
    tables: Tables,
    sites: Sites,
    groups: IntArray,
    spans: IntArray,
    limits: FloatArray,
    known: Bounds,
    columns: Floats,
    base: FloatArray,
    room: Room,
) -> float:
    """Weight (ln) of some good place: of each turn the best on the tape that may fit best, dots beyond an edge if need be."""
    guess = Tally(np.array([-np.inf, 0.0, -np.inf, -np.inf, -np.inf]), np.full(6, -1), np.full(6, -1))
    of_columns, of_rows, free = np.empty(len(sites.table)), np.empty(len(sites.table)), (1e6, 1e6)
    rows, most_known = np.empty(sites.phases.shape[1], dtype=np.float32), limits[:, :2].sum(axis=1).max()
    for over in range(2):
        if guess.sums[0] > 0.5 * most_known:  # found
            break
        for turn in range(4):
            wide, high = tables.size[turn]
            slot = slot_of(known, tables.lines[turn, 1], turn, 1, 0, wide, high)
            if over == 0:
                bound_starts(rows, known.pairs[slot], sites.steps[1], high)
            for k in range(len(sites.classes)):
                first, last = sites.classes[k, 0], sites.classes[k, 1]
                for g in range(spans[turn, sites.classes[k, 2], 0], spans[turn, sites.classes[k, 2], 1]):
                    bound = limits[g, 0] + limits[g, 1]
                    if groups[g, OVER] != over or bound < 0.7 * most_known or bound + base[turn, over] < guess.sums[0]:
                        continue
                    if over == 0:
                        most_of_sites(of_columns, columns[turn], sites.table, 0, groups[g, COLUMNS], first, last)
                        most_of_sites(of_rows, rows, sites.table, 1, groups[g, ROWS], first, last)
                        of_columns[first:last] += of_rows[first:last]
                    else:
                        axis = 1 if groups[g, COLUMNS] > 1 else 0
                        _bound_group(of_columns, known, tables, sites, groups[g], turn, axis, (first, last), NEVER)
                    site = first + np.argmax(of_columns[first:last])
                    weigh_site(
                        columns[0, :0],
                        tables.lines[turn],
                        sites.phases,
                        sites.table[site],
                        sites.barred,
                        (turn, site),
                        groups[g],
                        free,
                        (base[turn, over], 0.0),
                        guess,
                        room,
                        columns[0, :0],
                        0,
                    )
    return float(guess.sums[0])


@njit(cache=True, error_model="numpy")
def weigh_site(
    known: Floats,
    lines: Floats,
    phases: IntArray,
    place: IntArray,
    barred: IntArray,
    at: tuple[int, int],
    group: IntArray,
    limit: tuple[float, float],
    terms: tuple[float, float],
    tally: Tally,
    room: Room,
    hole: Floats,
    stride: int,
) -> None:
    """One group of places on one site: the axis with fewer places first, the other only if that may matter.

    Columns whose bounds are known are looked at one by one.
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
            if axis == 0 and len(known) > 0 and drop(known[k] + limit[1], places / group[COLUMNS], terms, tally.sums):
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
        if most == NEVER or (stride == 0 and drop(bound, places, terms, tally.sums)):
            return
        axis = 1 - axis
    row, column = place[ORIGIN, 1] + group[Y], place[ORIGIN, 0] + group[X]
    where = (at[0], at[1], group[X], group[Y])
    if every:
        _count_every_sector(where, group[COLUMNS], group[ROWS], row, column, barred[barred[:, 0] == at[1]], terms, tally, room)
    else:
        phase = (row + place[SECTOR, 0], column + place[SECTOR, 1])
        _count_sector(where, group[COLUMNS], group[ROWS], phase, place[SECTOR], terms, tally, room, hole, stride)


@njit(cache=True, error_model="numpy")
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
    length = room.lines.shape[2]
    sums, y_best = tally.sums, room.most[1, :rows].max()
    for i in range(columns):
        if room.most[0, i] == NEVER or (
            stride == 0
            and room.most[0, i] + y_best + terms[0] < sums[0] - FAR_BELOW
            and room.most[0, i] + y_best + terms[1] < sums[3]
        ):
            continue
        y_phase, x_phase = (phase[1] + i) % length, phase[0] % length
        for j in range(rows):
            value = float(room.lines[0, i, x_phase]) + float(room.lines[1, j, y_phase])
            x_phase = x_phase + 1 if x_phase + 1 < length else 0
            if stride > 0:
                value -= hole[j * stride + i]
            if value + terms[0] > sums[0] - FAR_BELOW or value + terms[1] > sums[3]:
                count_places_at(tally, value, 1.0, terms, (at[0], at[1], at[2] + i, at[3] + j, sector[0], sector[1]))


@njit(cache=True, error_model="numpy")
def count_places_at(
    tally: Tally, value: float, weight: float, terms: tuple[float, float], at: tuple[int, int, int, int, int, int]
) -> None:
    """Add a place, or several that together weigh so many times the best of them."""
    sums = tally.sums
    score, likelihood = value + terms[0], value + terms[1]
    if score > sums[0] or (tally.best[0] < 0 and score > sums[0] - 1e-6):
        sums[1] *= np.exp(sums[0] - score)
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


@njit(cache=True, error_model="numpy")
def _count_every_sector(
    at: tuple[int, int, int, int],
    columns: int,
    rows: int,
    row: int,
    column: int,
    barred: IntArray,
    terms: tuple[float, float],
    tally: Tally,
    room: Room,
) -> None:
    """Places of a group where any sector may lie but the barred ones: every pair of phases is one sector."""
    length = room.lines.shape[2]
    x_sum, y_sum = np.full(columns, -1.0), np.full(rows, -1.0)
    for i in range(columns):
        if room.most[0, i] == NEVER:
            continue
        for j in range(rows):
            most = room.most[0, i] + room.most[1, j]
            if drop(most, float(length * length), terms, tally.sums):
                continue
            if x_sum[i] < 0.0:
                x_sum[i] = np.exp(room.lines[0, i] - room.most[0, i]).sum()
            if y_sum[j] < 0.0:
                y_sum[j] = np.exp(room.lines[1, j] - room.most[1, j]).sum()
            total, out = x_sum[i] * y_sum[j], 0.0
            u, v = (np.argmax(room.lines[0, i]) - row - j) % length, (np.argmax(room.lines[1, j]) - column - i) % length
            among = False
            for k in range(len(barred)):
                p, r = (row + j + barred[k, 1]) % length, (column + i + barred[k, 2]) % length
                out += np.exp(room.lines[0, i, p] + room.lines[1, j, r] - most)
                among = among or (barred[k, 1] == u and barred[k, 2] == v)
            total -= out
            if among or out > total:
                most, total, u, v = _without(room.lines[0, i], room.lines[1, j], row + j, column + i, barred)
            if total > 0.0:
                count_places_at(tally, most, total, terms, (at[0], at[1], at[2] + i, at[3] + j, u, v))


@njit(cache=True, error_model="numpy")
def _without(x: Floats, y: Floats, row: int, column: int, barred: IntArray) -> tuple[float, float, int, int]:
    """The best of the sectors that are not barred, the weight of all of them as a multiple of it, and which it is."""
    length = len(x)
    allowed = np.ones((length, length), dtype=np.bool_)
    for k in range(len(barred)):
        allowed[(row + barred[k, 1]) % length, (column + barred[k, 2]) % length] = False
    most, total, u, v = -np.inf, 0.0, 0, 0
    for again in range(2):
        for p in range(length):
            for r in range(length):
                value = float(x[p]) + float(y[r])
                if allowed[p, r] and again == 0 and value > most:
                    most, u, v = value, (p - row) % length, (r - column) % length
                elif allowed[p, r] and again == 1:
                    total += np.exp(value - most)
    return most, total, u, v
