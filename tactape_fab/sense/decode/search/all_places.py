"""Comparison of the dots with every place of many tapes: the best one, the weight of all others, and the strongest of them.

Places are taken in groups, by which of the dots' columns and rows lie on the tape: all of them, or some where the contact
hangs over an edge. A group that cannot matter is counted at its bound; all others are evaluated place by place.
"""

from __future__ import annotations

import numpy as np

from tactape_fab.base.jit import inlined_kernel, kernel, long_kernel
from tactape_fab.sense.decode.search.evidence import Tables
from tactape_fab.sense.decode.search.groups import OVER, Groups, Weights, likelier_turn
from tactape_fab.sense.decode.search.holes import reach_holes, weigh_holed
from tactape_fab.sense.decode.search.many_tapes import choose, known_lines, many_buffers, prepare
from tactape_fab.sense.decode.search.plane_sites import FIRST, LAST, MANY, OVERHANG, SIZE, TAPES, Sites
from tactape_fab.sense.decode.search.tally import (
    BEST,
    FITS,
    LEAST_SHARE,
    ROUNDING,
    Buffers,
    Candidate,
    ManyBuffers,
    Tally,
    count_bound,
    fill_group,
    is_uninformative,
    least_of,
    weigh_known,
    weigh_site,
)
from tactape_fab.texture.frames import FloatArray, IntArray

_FEW_SITES = 512
"""Sites up to which a search keeps the interpreter's lock; an open world has those of all sectors, 256 and some. It takes 0.5 ms,
as a rule, and up to 20 where a contact of 6 mm says little."""


def weigh_sites(tables: Tables, sites: Sites, groups: Groups, weights: Weights, tally: Tally) -> None:
    """Compare the dots with every place of every site, and add the places to a tally."""
    many, holed = many_buffers(tables, sites), sites.holed if sites.kinds[4] else None
    barred = None if many is None else sites.barred
    weigh = _weigh_few if len(sites.table) <= _FEW_SITES else _weigh_many
    weigh(tables, sites, *groups, *weights, tally, _buffers(tables, sites), many, barred, holed)


def _buffers(tables: Tables, sites: Sites) -> Buffers:
    length, widest = len(sites.signs) // 3, int(sites.kinds[0])
    lines, most = np.empty((2, widest, length), dtype=np.float32), np.empty((2, widest))
    evidence = np.zeros((2, tables.lines.shape[3] + 1, 2 * length), dtype=np.float32)
    return Buffers(
        lines, most, np.empty(widest), np.empty((2, widest), dtype=np.int64), evidence, np.empty((length, length), dtype=np.bool_)
    )


def _weigh(
    tables: Tables,
    sites: Sites,
    fields: IntArray,
    spans: IntArray,
    limits: FloatArray,
    place: FloatArray,
    turn_terms: FloatArray,
    tally: Tally,
    buffers: Buffers,
    many: ManyBuffers | None,
    barred: IntArray | None,
    holed: IntArray | None,
) -> None:
    """The kernel that Python calls, with arrays as arguments: passing an array takes 0.1 us, a tuple of them 0.7 us and more.

    If `many` and `barred` are None, numba leaves out the code for many sites and for sites of all sectors, half of what a search
    compiles. If `holed` is None, it leaves out the code for tapes with holes.
    """
    groups, weights, searches = Groups(fields, spans, limits), Weights(place, turn_terms), 1
    if many is not None and sites.kinds[2] == 1:
        prepare(tables, sites, groups, weights, tally, buffers, many, holed)
        searches = 2 if tally.sums[BEST] < tally.sums[FITS] else 1
    # nothing that fits is known: beside so poor a place none could be left out. First the best one alone, then, if it fits, all
    for left in range(searches, 0, -1):
        _weigh_groups(tables, sites, groups, weights, tally, buffers, many, barred, holed, left == 2)
        if left == 2 and is_uninformative(tally):
            break


_weigh_few, _weigh_many = kernel(no_rewrites=False)(_weigh), long_kernel(no_rewrites=False)(_weigh)


@inlined_kernel()
def _weigh_groups(
    tables: Tables,
    sites: Sites,
    groups: Groups,
    weights: Weights,
    tally: Tally,
    buffers: Buffers,
    many: ManyBuffers | None,
    barred: IntArray | None,
    holed: IntArray | None,
    alone: bool,
) -> None:
    """Add all groups to a tally; if `alone`, groups that cannot hold the best place are dropped, whatever they weigh together.

    First the classes of many sites, then those of few, each time places with all dots on a tape before others, and turns that the
    dots' shape speaks for before others: what comes once the best place is known is mostly left out.
    """
    share = tally.sums[LEAST_SHARE]
    if alone:
        tally.sums[LEAST_SHARE] = -ROUNDING
    # 0 and 1: classes of many sites, on the tape and over its edge; 2 and 3: of few
    for order in range(4):
        over = order % 2
        for k in range(len(sites.classes)):
            kind = sites.classes[k]
            first, last, size = kind[FIRST], kind[LAST], kind[SIZE]
            if kind[MANY] == order // 2 or over > kind[OVERHANG]:
                continue
            # ln of the places of a group on all tapes: together they have to be negligible
            tapes = np.log(float(kind[TAPES] * (last - first)))
            for turn_k in range(4):
                turn = likelier_turn(turn_k, weights.turn)
                terms = (weights.place[turn, over], weights.turn[turn])
                for g in range(groups.spans[turn, size, 0], groups.spans[turn, size, 1]):
                    group, limit = groups.fields[g], groups.limits[g]
                    if group[OVER] != over:
                        continue
                    bound, of = limit[0] + limit[1], 0.0 if alone else limit[2] + tapes
                    least = least_of(of, terms, tally.sums)
                    if bound < least:
                        count_bound(np.exp(bound + of + terms[0] - tally.sums[BEST]), bound + terms[1], tally.sums)
                        continue
                    left = last - first
                    if many is not None and order < 2:
                        left = choose(
                            tables, sites, (group, limit), turn, (k, first, last), least, of, terms, tally, buffers, many
                        )
                    if left > 0:
                        fill_group(tables, turn, group, buffers)
                    for c in range(left):
                        site, of_y, known, of_rows = first + c, limit[1], buffers.lines[0, 0, :0], buffers.lines[0, 0, :0]
                        if many is not None and order < 2:
                            site = many.chosen[c]
                            if over == 0:
                                (known, of_rows), of_y = known_lines(many, turn, sites.table[site], group), many.of_rows[site]
                        candidate = Candidate(
                            known,
                            sites.table[site],
                            (turn, site),
                            group,
                            (limit[0], of_y),
                            of,
                            terms,
                            sites.holed[sites.layout[site]],
                        )
                        if many is not None and len(known) > 0 and many.known_turns[turn]:
                            weigh_known(candidate, many.evidence[turn], of_rows, tally, buffers)
                        else:
                            weigh_site(candidate, sites.phases, barred, tally, buffers)
                    if holed is None:
                        continue
                    site = first
                    while sites.layout[first] > 0 and site < last:  # those of one layout follow one another
                        begin, layout = site, sites.layout[site]
                        while site < last and sites.layout[site] == layout:
                            site += 1
                        if reach_holes(holed[layout], group):
                            weigh_holed(tables, sites, (group, limit), turn, (begin, site), of, terms, tally, buffers, many)
    tally.sums[LEAST_SHARE] = share
