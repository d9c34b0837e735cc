"""Many tapes of a size at once: bounds from the phases of neighbouring lines first, places only on the few that are left."""

from __future__ import annotations

from functools import cache

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
from tactape_fab.sense.decode.search.groups import COLUMNS, OVER, ROWS, Groups, Weights
from tactape_fab.sense.decode.search.holes import weigh_holed
from tactape_fab.sense.decode.search.plane_sites import FIRST, LAST, MANY, OVERHANG, SIZE, START, Sites
from tactape_fab.sense.decode.search.tally import (
    BEST,
    LEAST_SHARE,
    Candidate,
    ManyRoom,
    Room,
    Tally,
    count_bound,
    new_tally,
    weigh_site,
)
from tactape_fab.texture.frames import FloatArray, IntArray

_FOUND = 0.5
"""A weight above this share of all evidence there is comes from a place that fits."""
_PROMISING = 0.7
"""Groups that may show this share of all evidence are looked at for a first guess."""
_ANYTHING = 1e6
"""A bound that drops nothing, and yet leaves a sum its digits."""


def many_room(tables: Tables, sites: Sites) -> ManyRoom | None:
    """Buffers for some dots and sites; empty ones where no class has many or holes, None where no other sites have many."""
    if sites.kinds[3] == 0:
        return None
    length = len(sites.signs) // 3
    if sites.kinds[2] == 0 and len(sites.bare) == 1:  # `holes` bounds few sites as well
        return _no_room(length)
    return _room_for(tables.dots.shape[1] - 1, length, len(sites.table), sites.phases.shape[1])


@cache
def _no_room(length: int) -> ManyRoom:
    """Empty buffers; nothing writes to them, so all calls share them."""
    return _room_for(0, length, 0, 0)


def _room_for(dots: int, length: int, sites: int, lines: int) -> ManyRoom:
    starts, chosen = np.empty((4, 2, lines), dtype=np.float32), np.empty(sites, dtype=np.int64)
    return ManyRoom(
        no_bounds(dots, length), starts, np.empty(sites), np.empty(sites), chosen, new_tally(), np.empty(dots, dtype=np.int64)
    )


@inlined_kernel()
def prepare(tables: Tables, sites: Sites, groups: Groups, weights: Weights, tally: Tally, room: Room, more: ManyRoom) -> None:
    """Bounds of all starts in the plane, and a first guess where nothing that fits is known yet."""
    most_said = NEVER
    for g in range(len(groups.limits)):
        most_said = max(most_said, groups.limits[g, 0] + groups.limits[g, 1])
    _bounds_of_starts(more.starts, tables, sites, more.known)
    if tally.sums[BEST] < weights.place[0, 0] + _FOUND * most_said:
        tally.sums[BEST] = max(tally.sums[BEST], _first_guess(tables, sites, groups, weights, room, more, most_said))


@inlined_kernel()
def choose(
    tables: Tables,
    sites: Sites,
    of: tuple[IntArray, FloatArray],
    turn: int,
    span: tuple[int, int],
    least: float,
    of_all: float,
    terms: tuple[float, float],
    tally: Tally,
    more: ManyRoom,
) -> int:
    """Fill `ManyRoom.chosen` with the sites whose own bounds leave them open, of a group that may matter as a whole; how many.

    ``least`` is the ln E that may matter, ``of_all`` ln of how many places the group has; `tally.Candidate` has ``terms``.
    """
    rest = _bound_sites(tables, sites, of, turn, span, least, more)
    left, dropped, most = survivors(more.chosen, more.bounds, span[0], span[1], least - rest)
    weight = dropped / float(span[1] - span[0]) * np.exp(least + of_all + terms[0] - tally.sums[BEST])
    count_bound(weight, most + rest + terms[1], tally.sums)
    return int(left)


@inlined_kernel()
def known_columns(more: ManyRoom, turn: int, place: IntArray, group: IntArray) -> Floats:
    """Bounds of what the x bits say at each column of a group with all dots on the tape."""
    start = place[START, 0]
    return more.starts[turn, 0, start : start + group[COLUMNS]]


@inlined_kernel()
def _bounds_of_starts(out: Floats, tables: Tables, sites: Sites, known: Bounds) -> None:
    """Bounds of what the x bits say where the dots' column 0 lies on each column of the plane, and the y bits of rows."""
    for turn in range(4):
        for axis in range(2):
            count, across = tables.size[turn, axis], tables.size[turn, 1 - axis]
            slot = slot_of(known, tables.lines[turn, axis], turn, axis, (np.int64(0), across), count)
            bound_starts(out[turn, axis], known.pairs[slot], sites.steps[axis], count)


@inner_kernel()
def _bound_sites(
    tables: Tables,
    sites: Sites,
    of: tuple[IntArray, FloatArray],
    turn: int,
    span: tuple[int, int],
    least: float,
    more: ManyRoom,
) -> float:
    """Fill the largest evidence that a group of places can have on each of some sites; the bound of an axis left out is returned.

    With all dots on the tape it is the most of both axes, and `ManyRoom.of_rows` has that of the y bits. ``of`` are the group's
    fields and limits, ``span`` the first site and the last + 1.
    """
    (group, limit), out, of_rows, starts = of, more.bounds, more.of_rows, more.starts
    if group[OVER] == 0:
        for axis in range(2):
            to, count = (out, group[COLUMNS]) if axis == 0 else (of_rows, group[ROWS])
            most_of_sites(to, starts[turn, axis], sites.table, axis, count, span)
        for site in range(span[0], span[1]):
            out[site] += of_rows[site]
        return 0.0
    # over an edge there is one place along at least one axis: only that one's lines are bounded
    axis = 1 if group[COLUMNS] > 1 else 0
    own, other = 4 * axis, 4 * (1 - axis)  # fields of a group: columns, then rows
    count, rest = tables.size[turn, axis], limit[1 - axis]
    slot = slot_of(more.known, tables.lines[turn, axis], turn, axis, (group[other + 2], group[other + 3]), count)
    lines = (group[own + 2], group[own + 3], count)
    bound_lines(out, more.known, slot, (sites.steps[axis], sites.table, axis, group[own]), lines, span, least - rest)
    return float(rest)


@inlined_kernel()
def _first_guess(
    tables: Tables, sites: Sites, groups: Groups, weights: Weights, room: Room, more: ManyRoom, most_said: float
) -> float:
    """Weight (ln) of some good place: of each turn the best on the tape that may fit best, dots beyond an edge if need be."""
    base, bounds, nothing, guess = weights.place, more.bounds, more.starts[0, 0, :0], more.guess
    guess.best_place[0] = -1
    for k in range(LEAST_SHARE + 1):  # nothing is negligible here
        guess.sums[k] = NEVER
    likely = 0 if base[0, 0] >= base[1, 0] else 1
    for over in range(2):
        for turn_k in range(4):
            turn = (2 * turn_k + (turn_k // 2 + likely) % 2) % 4  # the likelier two come first
            if guess.sums[BEST] > base[likely, 0] + _FOUND * most_said:
                break
            for k in range(len(sites.classes)):
                kind = sites.classes[k]
                if kind[MANY] == 0 or over > kind[OVERHANG]:
                    continue
                for g in range(groups.spans[turn, kind[SIZE], 0], groups.spans[turn, kind[SIZE], 1]):
                    group, limit = groups.fields[g], groups.limits[g]
                    bound = limit[0] + limit[1]
                    if group[OVER] != over or bound < _PROMISING * most_said or bound + base[turn, over] < guess.sums[BEST]:
                        continue
                    _bound_sites(tables, sites, (group, limit), turn, (kind[FIRST], kind[LAST]), NEVER, more)
                    site = kind[FIRST]
                    for other in range(kind[FIRST], kind[LAST]):
                        site = other if bounds[other] > bounds[site] else site
                    candidate = Candidate(
                        nothing,
                        tables.lines[turn],
                        sites.table[site],
                        (turn, site),
                        group,
                        (_ANYTHING, _ANYTHING),
                        0.0,
                        (base[turn, over], 0.0),
                        sites.holed[sites.layout[site]],
                    )
                    weigh_site(candidate, sites.phases, sites.barred, guess, room)
                    if sites.layout[site] > 0:
                        weigh_holed(
                            tables, sites, (group, limit), turn, (site, site + 1), 0.0, (base[turn, over], 0.0), guess, room, more
                        )
    return float(guess.sums[BEST])
