"""Many tapes of a size at once: bounds from the phases of neighbouring lines first, places only on the few that are left."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tactape_fab.base.jit import inlined_kernel, inner_kernel
from tactape_fab.sense.decode.search.bounds import (
    NEVER,
    Bounds,
    bound_lines,
    bound_starts,
    most_of_sites,
    no_bounds,
    slot_of,
    survivors,
)
from tactape_fab.sense.decode.search.evidence import Floats, Tables
from tactape_fab.sense.decode.search.groups import COLUMNS, OVER, ROWS
from tactape_fab.sense.decode.search.plane_sites import FIRST, LAST, MANY, OVERHANG, SIZE, START, TAPES, Sites
from tactape_fab.sense.decode.search.tally import Room, Tally, count_bound, least_of, new_tally, weigh_site
from tactape_fab.texture.frames import FloatArray, IntArray

_FOUND = 0.5
"""A weight above this share of all evidence there is comes from a place that fits."""
_PROMISING = 0.7
"""Groups that may show this share of all evidence are looked at for a first guess."""
_ANYTHING = 1e6
"""A bound that drops nothing, and yet leaves a sum its digits."""


class ManyRoom(NamedTuple):
    """Room to work in, for many sites.

    Attributes
    ----------
    known : Bounds
    starts : ndarray of float32, shape (4, 2, columns or rows of the plane)
        From `_bounds_of_starts`.
    bounds, of_rows : ndarray, shape (n,)
        From `_bound_sites`.
    chosen : ndarray of int, shape (n,)
        From `survivors`.
    guess : Tally
        Of `_first_guess`.
    """

    known: Bounds
    starts: Floats
    bounds: FloatArray
    of_rows: FloatArray
    chosen: IntArray
    guess: Tally


def many_room(tables: Tables, sites: Sites) -> ManyRoom:
    """Room for some dots and sites, no bounds known; none to speak of where no sites are many."""
    count, lines, most = len(sites.table), sites.phases.shape[1], tables.dots.shape[1] - 1
    if sites.kinds[2] == 0:
        count = lines = most = 0
    known, starts = no_bounds(most, len(sites.signs) // 3), np.empty((4, 2, lines), dtype=np.float32)
    return ManyRoom(known, starts, np.empty(count), np.empty(count), np.empty(count, dtype=np.int64), new_tally())


@inlined_kernel()
def weigh_many(
    tables: Tables,
    sites: Sites,
    groups: IntArray,
    spans: IntArray,
    limits: FloatArray,
    base: FloatArray,
    cue: FloatArray,
    tally: Tally,
    room: Room,
    more: ManyRoom,
) -> None:
    """The classes of many sites, places with all dots on a tape first."""
    sums, most_said = tally.sums, NEVER
    known, starts, bounds, of_rows, chosen = more.known, more.starts, more.bounds, more.of_rows, more.chosen
    for g in range(len(limits)):
        most_said = max(most_said, limits[g, 0] + limits[g, 1])
    _bounds_of_starts(starts, tables, sites, known)
    if sums[0] < base[0, 0] + _FOUND * most_said:  # nothing that fits is known yet
        sums[0] = max(sums[0], _first_guess(tables, sites, groups, spans, limits, base, room, more, most_said))
    for over in range(2):
        for k in range(len(sites.classes)):
            kind = sites.classes[k]
            first, last, size, count = kind[FIRST], kind[LAST], kind[SIZE], float(kind[LAST] - kind[FIRST])
            if kind[MANY] == 0 or over > kind[OVERHANG]:
                continue
            for turn in range(4):
                terms, tapes = (base[turn, over], cue[turn]), np.log(kind[TAPES] * count)
                for g in range(spans[turn, size, 0], spans[turn, size, 1]):
                    if groups[g, OVER] != over:
                        continue
                    bound, of = limits[g, 0] + limits[g, 1], limits[g, 2] + tapes
                    least = least_of(of, terms, sums)
                    if bound < least:
                        count_bound(np.exp(bound + of + terms[0] - sums[0]), bound + terms[1], sums)
                        continue
                    span, group = (first, last), groups[g]
                    rest = _bound_sites(bounds, of_rows, known, tables, sites, group, limits[g], turn, span, least, starts)
                    left, dropped, most = survivors(chosen, bounds, first, last, least - rest)
                    count_bound(dropped / count * np.exp(least + of + terms[0] - sums[0]), most + rest + terms[1], sums)
                    for c in range(left):
                        site = chosen[c]
                        start, width, limit = sites.table[site, START, 0], 0, (limits[g, 0], limits[g, 1])
                        if over == 0:
                            width, limit = groups[g, COLUMNS], (limits[g, 0], of_rows[site])
                        weigh_site(
                            starts[turn, 0, start : start + width],
                            tables.lines[turn],
                            sites.phases,
                            sites.table[site],
                            sites.barred,
                            (turn, site),
                            group,
                            limit,
                            of,
                            terms,
                            tally,
                            room,
                            starts[turn, 0, :0],
                            width - width,
                        )


@inlined_kernel()
def _bounds_of_starts(out: Floats, tables: Tables, sites: Sites, known: Bounds) -> None:
    """Bounds of what the x bits say where the dots' column 0 lies on each column of the plane, and the y bits of rows."""
    for turn in range(4):
        for axis in range(2):
            count, across = tables.size[turn, axis], tables.size[turn, 1 - axis]
            slot = slot_of(known, tables.lines[turn, axis], turn, axis, axis - axis, across, count)
            bound_starts(out[turn, axis], known.pairs[slot], sites.steps[axis], count)


@inner_kernel()
def _bound_sites(
    out: FloatArray,
    of_rows: FloatArray,
    known: Bounds,
    tables: Tables,
    sites: Sites,
    group: IntArray,
    limit: FloatArray,
    turn: int,
    span: tuple[int, int],
    least: float,
    starts: Floats,
) -> float:
    """Most that the bits can say for a group of places on each of some sites; what is to be added for those of the other axis.

    With all dots on the tape it is the most of both axes, and `of_rows` has that of the y bits.
    """
    if group[OVER] == 0:
        for axis in range(2):
            to, count = (out, group[COLUMNS]) if axis == 0 else (of_rows, group[ROWS])
            most_of_sites(to, starts[turn, axis], sites.table, axis, count, span[0], span[1])
        for site in range(span[0], span[1]):
            out[site] += of_rows[site]
        return 0.0
    axis = 1 if group[COLUMNS] > 1 else 0
    own, other = 4 * axis, 4 * (1 - axis)  # fields of a group: columns, then rows
    count, rest = tables.size[turn, axis], limit[1 - axis]
    slot = slot_of(known, tables.lines[turn, axis], turn, axis, group[other + 2], group[other + 3], count)
    lines = (group[own + 2], group[own + 3], count)
    bound_lines(out, known, slot, sites.steps[axis], sites.table, axis, group[own], lines, span, least - rest)
    return float(rest)


@inlined_kernel()
def _first_guess(
    tables: Tables,
    sites: Sites,
    groups: IntArray,
    spans: IntArray,
    limits: FloatArray,
    base: FloatArray,
    room: Room,
    more: ManyRoom,
    most_said: float,
) -> float:
    """Weight (ln) of some good place: of each turn the best on the tape that may fit best, dots beyond an edge if need be."""
    known, starts, bounds, of_rows, guess = more.known, more.starts, more.bounds, more.of_rows, more.guess
    guess.best[0] = -1
    for k in range(6):  # nothing is negligible here
        guess.sums[k] = NEVER
    likely = 0 if base[0, 0] >= base[1, 0] else 1
    for over in range(2):
        for turn_k in range(4):
            turn = (2 * turn_k + (turn_k // 2 + likely) % 2) % 4  # the likelier two come first
            if guess.sums[0] > base[likely, 0] + _FOUND * most_said:
                break
            for k in range(len(sites.classes)):
                kind = sites.classes[k]
                if kind[MANY] == 0 or over > kind[OVERHANG]:
                    continue
                for g in range(spans[turn, kind[SIZE], 0], spans[turn, kind[SIZE], 1]):
                    bound = limits[g, 0] + limits[g, 1]
                    if groups[g, OVER] != over or bound < _PROMISING * most_said or bound + base[turn, over] < guess.sums[0]:
                        continue
                    span, site = (kind[FIRST], kind[LAST]), kind[FIRST]
                    _bound_sites(bounds, of_rows, known, tables, sites, groups[g], limits[g], turn, span, NEVER, starts)
                    for other in range(kind[FIRST], kind[LAST]):
                        site = other if bounds[other] > bounds[site] else site
                    weigh_site(
                        starts[turn, 0, :0],
                        tables.lines[turn],
                        sites.phases,
                        sites.table[site],
                        sites.barred,
                        (turn, site),
                        groups[g],
                        (_ANYTHING, _ANYTHING),
                        0.0,
                        (base[turn, over], 0.0),
                        guess,
                        room,
                        starts[turn, 0, :0],
                        site - site,
                    )
    return float(guess.sums[0])
