"""Many tapes of a size at once: bounds from the phases of neighbouring lines first, places only on the few that are left."""

from __future__ import annotations

from functools import cache

import numpy as np

from tactape_fab.base.jit import inlined_kernel, inner_kernel
from tactape_fab.sense.decode.search.bounds import (
    NEVER,
    WAYS,
    bound_lines,
    bound_starts,
    largest_of,
    no_bounds,
    slot_of,
    survivors,
    survivors_of_starts,
)
from tactape_fab.sense.decode.search.evidence import Floats, Tables, add_everywhere, fill_range
from tactape_fab.sense.decode.search.groups import COLUMNS, OVER, ROWS, Groups, Weights, likelier_turn
from tactape_fab.sense.decode.search.holes import weigh_holed
from tactape_fab.sense.decode.search.plane_sites import FIRST, LAST, MANY, OVERHANG, SIZE, START, Sites
from tactape_fab.sense.decode.search.tally import (
    BEST,
    LEAST_SHARE,
    Buffers,
    Candidate,
    ManyBuffers,
    Tally,
    count_bound,
    fill_group,
    new_tally,
    weigh_site,
)
from tactape_fab.texture.frames import FloatArray, IntArray

_FOUND = 0.5
"""A place fits if its weight (ln) exceeds this share of the largest possible evidence (ln)."""
_PROMISING = 0.7
"""Groups whose bound reaches this share of the largest possible evidence (ln) are searched for a first guess."""
_PLACES_A_SITE = 100
"""Cost of searching one site, in places of the plane that are bounded in the same time."""
_PLACES_AT_ONCE = 4
"""Consecutive places of the plane that are bounded in the time of a single one."""
_FEW_PHASES = 16
"""Up to so many phases the evidence at every place of the plane is kept: megabytes, and faster than bounds."""
_PLACES_BOUNDED = 0.5
"""Cost of bounding one place of the plane in one more way, over that of evaluating one place of a site."""
_PLACES_FILLED = 2
"""Cost of computing the evidence of one place of the plane for all phases, over that of evaluating one place of a site."""
_ANYTHING = 1e6
"""An offset that makes any bound pass, small enough that a sum with it keeps its digits."""


def many_buffers(tables: Tables, sites: Sites) -> ManyBuffers | None:
    """Buffers for some dots and sites; empty ones where no class has many or holes, None where no other sites have many."""
    if sites.kinds[3] == 0:
        return None
    length = len(sites.signs) // 3
    if sites.kinds[2] == 0 and len(sites.bare) == 1:  # `holes` bounds few sites as well
        return _no_buffers(length)
    rows = int(sites.sizes[:, 1].max()) if len(sites.bare) > 1 else 0
    return _buffers_for(tables.dots.shape[1] - 1, length, len(sites.table), sites.phases.shape[1], sites.differences, rows)


@cache
def _no_buffers(length: int) -> ManyBuffers:
    """Empty buffers; nothing writes to them, so all calls share them."""
    return _buffers_for(0, length, 0, 0, np.zeros(2, dtype=np.int64), 0)


def _buffers_for(dots: int, length: int, sites: int, lines: int, differences: IntArray, rows: int) -> ManyBuffers:
    starts, chosen = np.empty((4, 2, lines), dtype=np.float32), np.empty(sites, dtype=np.int64)
    evidence = np.empty((4, 2, lines if length <= _FEW_PHASES else 0, length), dtype=np.float32)
    return ManyBuffers(
        no_bounds(dots, length, differences),
        starts,
        evidence,
        np.zeros(4, dtype=np.bool_),
        np.zeros(4, dtype=np.int64),
        np.empty(sites),
        np.empty(sites),
        np.empty((rows, sites), dtype=np.float32),
        np.empty((2, sites)),
        np.empty((3, lines), dtype=np.float32),
        chosen,
        new_tally(),
        np.empty((2, dots), dtype=np.int64),
    )


@inlined_kernel()
def prepare(
    tables: Tables,
    sites: Sites,
    groups: Groups,
    weights: Weights,
    tally: Tally,
    buffers: Buffers,
    more: ManyBuffers,
    holed: IntArray | None,
) -> None:
    """Bounds of all starts in the plane, and a first guess where nothing that fits is known yet."""
    most_evidence = NEVER
    for g in range(len(groups.limits)):
        most_evidence = max(most_evidence, groups.limits[g, 0] + groups.limits[g, 1])
    for turn in range(4):
        more.known_turns[turn] = False
        more.ways[turn] = 0
        _bound_turn(tables, sites, turn, more)
    # a group is left out by what it weighs beside the best: without a good place first nothing would be
    if tally.sums[BEST] < weights.place[0, 0] + _FOUND * most_evidence:
        tally.sums[BEST] = max(
            tally.sums[BEST], _first_guess(tables, sites, groups, weights, buffers, more, holed, most_evidence)
        )


@inlined_kernel()
def choose(
    tables: Tables,
    sites: Sites,
    of: tuple[IntArray, FloatArray],
    turn: int,
    kind: tuple[int, int, int],
    least: float,
    of_all: float,
    terms: tuple[float, float],
    tally: Tally,
    buffers: Buffers,
    more: ManyBuffers,
) -> int:
    """Fill `ManyBuffers.chosen` with the sites whose own bounds leave them open, of a group that may matter as a whole; how many.

    ``kind`` is the class, its first site and last + 1, ``least`` the ln E that may matter, ``of_all`` ln of how many places the
    group has; `tally.Candidate` has ``terms``.
    """
    if of[0][OVER] == 0:
        rest = 0.0
        left, dropped, most = _open_inside(sites, of[0], turn, kind, least, more)
        places = of[0][COLUMNS] + of[0][ROWS]
        # more bounds only where looking at the sites left would take longer than making them
        while more.ways[turn] < WAYS and left * places > _PLACES_BOUNDED * len(more.everywhere[0]):
            _bound_turn(tables, sites, turn, more)
            left, dropped, most = _open_inside(sites, of[0], turn, kind, least, more)
        worth = left * places > _PLACES_FILLED * more.evidence.shape[2] > 0
        if worth and not more.known_turns[turn]:
            _fill_everywhere(tables, sites, turn, buffers, more)
            left, dropped, most = _open_inside(sites, of[0], turn, kind, least, more)
    else:
        axis, rest = _bound_over(tables, sites, of, turn, kind[0], least, more)
        left, dropped, most = survivors_of_starts(more.chosen, more.of_starts[axis], sites.starts, axis, kind, least - rest)
        if _PLACES_A_SITE * left > len(more.everywhere[0]):
            left, more_dropped, more_most = _bound_across(tables, sites, of[0], turn, axis, np.int64(left), least, more)
            dropped, most = dropped + more_dropped, max(most, more_most - rest)
    # `dropped` is in sites at `least`, and of_all counts the places of all sites of the class: one site has its share
    weight = dropped / float(kind[2] - kind[1]) * np.exp(least + of_all + terms[0] - tally.sums[BEST])
    count_bound(weight, most + rest + terms[1], tally.sums)
    return int(left)


@inlined_kernel()
def known_lines(more: ManyBuffers, turn: int, place: IntArray, group: IntArray) -> tuple[Floats, Floats]:
    """Bounds of what the x bits say at each column of a group with all dots on the tape, and the y bits at each row."""
    column, row = place[START, 0], place[START, 1]
    return more.starts[turn, 0, column : column + group[COLUMNS]], more.starts[turn, 1, row : row + group[ROWS]]


@inner_kernel(fastmath=True)
def _bound_turn(tables: Tables, sites: Sites, turn: int, more: ManyBuffers) -> None:
    """Bounds of what the x bits say where the dots' column 0 lies on each column of the plane, and the y bits of rows.

    Each call takes lines together in another way, and the least bound is kept.
    """
    way = more.ways[turn]
    more.ways[turn] += 1
    for axis in range(2):
        count, across = tables.size[turn, axis], tables.size[turn, 1 - axis]
        span, out = (np.int64(0), count), more.starts[turn, axis]
        slot = slot_of(more.known, tables.lines[turn, axis], turn, axis, (np.int64(0), across), count, span, way)
        if way == 0:
            bound_starts(out, more.known, slot, sites.steps[axis], span, way)
            continue
        other = more.everywhere[0]
        bound_starts(other, more.known, slot, sites.steps[axis], span, way)
        for start in range(len(out)):
            out[start] = min(out[start], other[start])


@inner_kernel()
def _fill_everywhere(tables: Tables, sites: Sites, turn: int, buffers: Buffers, more: ManyBuffers) -> None:
    """Fill `ManyBuffers.evidence` for a turn, and `starts` with the largest of each entry."""
    for axis in range(2):
        count, across, evidence = tables.size[turn, axis], tables.size[turn, 1 - axis], buffers.evidence[axis]
        fill_range(evidence, tables.lines[turn, axis], (np.int64(0), across), count)
        add_everywhere(more.evidence[turn, axis], more.starts[turn, axis], evidence, count, sites.phases[axis])
    more.known_turns[turn] = True


@inner_kernel()
def _bound_inside(sites: Sites, group: IntArray, turn: int, kind: tuple[int, int, int], more: ManyBuffers) -> None:
    """Fill `ManyBuffers.bounds` with the most evidence of places with all dots on the tape, and `of_rows` with the y bits'.

    ``kind`` is the class, its first site and last + 1.
    """
    x, y, rank = more.of_starts[0], more.of_starts[1], sites.starts.rank
    for axis in range(2):
        span, count = sites.starts.spans[kind[0], axis], group[COLUMNS] if axis == 0 else group[ROWS]
        place, by_start = sites.starts.place[axis], more.starts[turn, axis]
        # two overlapping windows of a power of two cover any `count` places of a site
        largest, width = largest_of(by_start, count, more.everywhere)
        for k in range(span[0], span[1]):
            more.of_starts[axis, k] = max(largest[place[k]], largest[place[k] + count - width])
    for site in range(kind[1], kind[2]):
        more.of_rows[site] = y[rank[site, 1]]
        # columns and rows are bounded one by one, as if the best of each lay together
        more.bounds[site] = x[rank[site, 0]] + y[rank[site, 1]]


@inner_kernel()
def _open_inside(
    sites: Sites, group: IntArray, turn: int, kind: tuple[int, int, int], least: float, more: ManyBuffers
) -> tuple[int, float, float]:
    """Bound the sites of a class by `_bound_inside`, and list in `ManyBuffers.chosen` those that stay open; as `survivors`."""
    _bound_inside(sites, group, turn, kind, more)
    left, dropped, most = survivors(more.chosen, more.bounds, kind[1], kind[2], least)
    return left, dropped, most


@inner_kernel()
def _bound_over(
    tables: Tables, sites: Sites, of: tuple[IntArray, FloatArray], turn: int, kind: int, least: float, more: ManyBuffers
) -> tuple[int, float]:
    """Fill `ManyBuffers.of_starts` for an axis with bounds of a group over an edge, ``of`` its fields and limits.

    Returns the axis, and the bound of what the other says.
    """
    # there is one place along at least one axis: only that one's lines are bounded
    group, limit = of
    axis = 1 if group[COLUMNS] > 1 else 0
    own, other = 4 * axis, 4 * (1 - axis)  # fields of a group: columns, then rows
    # the other axis has at most its limit, so this one needs `least` minus that
    count, rest, way = tables.size[turn, axis], limit[1 - axis], np.int64(0)
    lines, span, starts = (group[own + 2], group[own + 3]), sites.starts.spans[kind, axis], sites.starts.place[axis]
    slot = slot_of(more.known, tables.lines[turn, axis], turn, axis, (group[other + 2], group[other + 3]), count, lines, way)
    out, everywhere = more.of_starts[axis], more.everywhere[0]
    if _PLACES_AT_ONCE * (span[1] - span[0]) < len(everywhere):
        bound_lines(out, more.known, slot, (sites.steps[axis], starts, group[own]), lines, (span[0], span[1]), least - rest)
    else:
        bound_starts(everywhere, more.known, slot, sites.steps[axis], lines, way)
        for k in range(span[0], span[1]):
            # `bound_starts` counts from the first line that is on the tape: lines[0] beyond the place of line 0, which may be
            # before the edge
            out[k] = everywhere[starts[k] + group[own] + lines[0]]
    return axis, float(rest)


@inner_kernel(fastmath=True)
def _bound_across(
    tables: Tables, sites: Sites, group: IntArray, turn: int, axis: int, count: int, least: float, more: ManyBuffers
) -> tuple[int, float, float]:
    """Leave out of `ManyBuffers.chosen`, after `_bound_over`, whose lines across do not fit; returns what `survivors` does."""
    across, own, other = 1 - axis, 4 * axis, 4 * (1 - axis)
    lines, dots, size = (group[other + 2], group[other + 3]), (group[own + 2], group[own + 3]), tables.size[turn, across]
    slot = slot_of(more.known, tables.lines[turn, across], turn, across, dots, size, lines, np.int64(0))
    everywhere, of_starts = more.everywhere[0], more.of_starts[axis]
    bound_starts(everywhere, more.known, slot, sites.steps[across], lines, np.int64(0))
    largest, width = largest_of(everywhere, group[other + 1], more.everywhere[1:])
    left, dropped, most = 0, 0.0, NEVER
    for c in range(count):
        site = more.chosen[c]
        first = sites.table[site, START, across] + group[other] + group[other + 2]
        best = max(largest[first], largest[first + group[other + 1] - width])
        bound = best + of_starts[sites.starts.rank[site, axis]]
        if bound >= least:
            more.chosen[left] = site
            left += 1
        else:
            most = max(most, bound)
            dropped += np.exp(bound - least)
    return left, dropped, most


@inlined_kernel()
def _first_guess(
    tables: Tables,
    sites: Sites,
    groups: Groups,
    weights: Weights,
    buffers: Buffers,
    more: ManyBuffers,
    holed: IntArray | None,
    most_evidence: float,
) -> float:
    """Weight (ln) of some good place: of each turn the best on the tape that may fit best, dots beyond an edge if need be."""
    base, bounds, nothing, guess = weights.place, more.bounds, more.starts[0, 0, :0], more.guess
    # only the weight is taken over, as a floor: places are counted by the search itself, so a poor guess costs time alone
    guess.best_place[0] = -1
    for k in range(LEAST_SHARE + 1):  # nothing is negligible here
        guess.sums[k] = NEVER
    likely = likelier_turn(np.int64(0), weights.turn)
    for over in range(2):
        for turn_k in range(4):
            turn = likelier_turn(turn_k, weights.turn)
            if guess.sums[BEST] > base[likely, 0] + _FOUND * most_evidence:
                break
            for k in range(len(sites.classes)):
                kind = sites.classes[k]
                if kind[MANY] == 0 or over > kind[OVERHANG]:
                    continue
                for g in range(groups.spans[turn, kind[SIZE], 0], groups.spans[turn, kind[SIZE], 1]):
                    group, limit = groups.fields[g], groups.limits[g]
                    bound = limit[0] + limit[1]
                    if group[OVER] != over or bound < _PROMISING * most_evidence or bound + base[turn, over] < guess.sums[BEST]:
                        continue
                    if over == 0:
                        _bound_inside(sites, group, turn, (k, kind[FIRST], kind[LAST]), more)
                    else:
                        axis, _ = _bound_over(tables, sites, (group, limit), turn, k, NEVER, more)
                        for other in range(kind[FIRST], kind[LAST]):
                            bounds[other] = more.of_starts[axis, sites.starts.rank[other, axis]]
                    site = kind[FIRST]
                    for other in range(kind[FIRST], kind[LAST]):
                        site = other if bounds[other] > bounds[site] else site
                    candidate = Candidate(
                        nothing,
                        sites.table[site],
                        (turn, site),
                        group,
                        (_ANYTHING, _ANYTHING),
                        0.0,
                        (base[turn, over], 0.0),
                        sites.holed[sites.layout[site]],
                    )
                    fill_group(tables, turn, group, buffers)
                    weigh_site(candidate, sites.phases, sites.barred, guess, buffers)
                    if holed is not None and sites.layout[site] > 0:
                        weigh_holed(
                            tables,
                            sites,
                            (group, limit),
                            turn,
                            (site, site + 1),
                            0.0,
                            (base[turn, over], 0.0),
                            guess,
                            buffers,
                            more,
                        )
    return float(guess.sums[BEST])
