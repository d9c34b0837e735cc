"""Many tapes of a size at once: bounds from the phases of neighbouring lines first, places only on the few that are left."""

from __future__ import annotations

import numpy as np

from tactape_fab.decode.bounds import (
    NEVER,
    Bounds,
    bound_between,
    bound_lines,
    bound_starts,
    most_of_sites,
    slot_of,
    survivors,
)
from tactape_fab.decode.counting import Room, Tally, drop, weigh_site
from tactape_fab.decode.evidence import Floats, Tables
from tactape_fab.decode.groups import COLUMNS, OVER, ROWS
from tactape_fab.decode.kernels import inner_kernel, kernel
from tactape_fab.decode.sites import FIRST, LAST, MANY, OVERHANG, SIZE, START, TAPES, Sites
from tactape_fab.texture.frames import FloatArray, IntArray

_FOUND = 0.5
"""A weight above this share of all evidence there is comes from a place that fits."""
_PROMISING = 0.7
"""Groups that may show this share of all evidence are looked at for a first guess."""
_ANYTHING = 1e6
"""A bound that drops nothing, and yet leaves a sum its digits."""


@kernel()
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
    known: Bounds,
) -> None:
    """The classes of many sites, places with all dots on a tape first."""
    sums, most_said = tally.sums, NEVER
    for g in range(len(limits)):
        most_said = max(most_said, limits[g, 0] + limits[g, 1])
    columns = _column_bounds(tables, sites, known)
    bounds, chosen = np.empty(len(sites.table)), np.empty(len(sites.table), dtype=np.int64)
    if sums[0] < base[0, 0] + _FOUND * most_said:  # nothing that fits is known yet
        sums[0] = max(sums[0], _first_guess(tables, sites, groups, spans, limits, known, columns, base, room, most_said))
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
                    if bound + of + terms[0] < sums[0] + sums[5]:
                        sums[1] += np.exp(bound + of + terms[0] - sums[0])
                        sums[4] = max(sums[4], bound + terms[1])
                        continue
                    axis = 1 if over == 1 and groups[g, COLUMNS] > 1 else 0
                    rest = limits[g, 1 - axis]
                    least = sums[0] + sums[5] - of - terms[0] - rest
                    _bound_group(bounds, known, tables, sites, groups[g], turn, axis, (first, last), least, columns[turn])
                    left, dropped, most = survivors(chosen, bounds, first, last, least)
                    sums[1] += dropped / count * np.exp(sums[5])
                    sums[4] = max(sums[4], most + rest + terms[1])
                    for c in range(left):
                        site = chosen[c]
                        limit = (limits[g, 0], limits[g, 1])
                        start, width = sites.table[site, START, 0], 0
                        if over == 0:
                            width = groups[g, COLUMNS]
                            limit = (limits[g, 0], _row_bound(known, tables, sites, site, turn, groups[g, ROWS]))
                            if drop(bounds[site] + limit[1], kind[TAPES] * float(width * groups[g, ROWS]), of, terms, sums):
                                continue
                        weigh_site(
                            columns[turn, start : start + width],
                            tables.lines[turn],
                            sites.phases,
                            sites.table[site],
                            sites.barred,
                            (turn, site),
                            groups[g],
                            limit,
                            of,
                            terms,
                            tally,
                            room,
                            columns[turn, :0],
                            width - width,
                        )


@inner_kernel()
def _column_bounds(tables: Tables, sites: Sites, known: Bounds) -> Floats:
    """Bound of what the x bits say where the dots' column 0 lies on each column of the plane; shape (4, columns)."""
    out = np.empty((4, sites.phases.shape[1]), dtype=np.float32)
    for turn in range(4):
        wide, high = tables.size[turn, 0], tables.size[turn, 1]
        axis = turn - turn
        slot = slot_of(known, tables.lines[turn, axis], turn, axis, axis, high, wide)
        bound_starts(out[turn], known.pairs[slot], sites.steps[axis], wide)
    return out


@inner_kernel()
def _row_bound(known: Bounds, tables: Tables, sites: Sites, site: int, turn: int, rows: int) -> float:
    """Bound of what the y bits say with all dots on a site."""
    wide, high = tables.size[turn, 0], tables.size[turn, 1]
    axis = turn - turn + 1
    slot = slot_of(known, tables.lines[turn, axis], turn, axis, axis - axis, wide, high)
    row = sites.table[site, START, axis]
    return bound_between(known.pairs[slot], high, sites.steps[axis], row, row + rows)


@inner_kernel()
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
    columns: Floats,
) -> None:
    """Most that the bits of one axis can say for a group of places on each of some sites."""
    if group[OVER] == 0:
        most_of_sites(out, columns, sites.table, axis, group[COLUMNS], span[0], span[1])
        return
    own, other = 4 * axis, 4 * (1 - axis)  # fields of a group: columns, then rows
    count = tables.size[turn, axis]
    slot = slot_of(known, tables.lines[turn, axis], turn, axis, group[other + 2], group[other + 3], count)
    lines = (group[own + 2], group[own + 3], count)
    bound_lines(out, known, slot, sites.steps[axis], sites.table, axis, group[own], lines, span, least)


@inner_kernel()
def _first_guess(
    tables: Tables,
    sites: Sites,
    groups: IntArray,
    spans: IntArray,
    limits: FloatArray,
    known: Bounds,
    columns: Floats,
    base: FloatArray,
    room: Room,
    most_said: float,
) -> float:
    """Weight (ln) of some good place: of each turn the best on the tape that may fit best, dots beyond an edge if need be."""
    guess = Tally(np.empty(6), np.empty(6, dtype=np.int64), np.empty(6, dtype=np.int64))
    guess.best[0] = -1
    for k in range(6):  # nothing is negligible here
        guess.sums[k] = NEVER
    bounds, likely = np.empty(len(sites.table)), 0 if base[0, 0] >= base[1, 0] else 1
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
                    axis = 1 if over == 1 and groups[g, COLUMNS] > 1 else 0
                    span = (kind[FIRST], kind[LAST])
                    _bound_group(bounds, known, tables, sites, groups[g], turn, axis, span, NEVER, columns[turn])
                    site, most = kind[FIRST], NEVER
                    for other in range(kind[FIRST], kind[LAST]):
                        if over == 0 and bounds[other] + limits[g, 1] > most:
                            bounds[other] += _row_bound(known, tables, sites, other, turn, groups[g, ROWS])
                            if bounds[other] > most:
                                site, most = other, bounds[other]
                        elif over == 1 and bounds[other] > most:
                            site, most = other, bounds[other]
                    weigh_site(
                        columns[turn, :0],
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
                        columns[turn, :0],
                        site - site,
                    )
    return float(guess.sums[0])
