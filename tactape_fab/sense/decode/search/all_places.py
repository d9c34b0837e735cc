"""Comparison of the dots with every place of many tapes: the best one, the weight of all others, and the strongest of them.

Places are taken in groups, by which of the dots' columns and rows lie on the tape: all of them, or some where the contact
hangs over an edge. A group that cannot matter is counted at its bound; all others are evaluated place by place.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from tactape_fab.base.jit import inlined_kernel, kernel
from tactape_fab.sense.decode.search.evidence import Floats, Tables
from tactape_fab.sense.decode.search.groups import OVER, Groups, Holes, Weights, X, Y, hole_evidence
from tactape_fab.sense.decode.search.many_tapes import ManyRoom, many_room, weigh_many
from tactape_fab.sense.decode.search.plane_sites import FIRST, LAST, MANY, OVERHANG, SIZE, TAPES, Sites
from tactape_fab.sense.decode.search.tally import BEST, Candidate, Room, Tally, count_bound, least_of, weigh_site
from tactape_fab.texture.frames import FloatArray, IntArray


def weigh_sites(tables: Tables, sites: Sites, groups: Groups, weights: Weights, tally: Tally) -> None:
    """Compare the dots with every place of every site, and add the places to a tally."""
    holes = hole_evidence(tables, sites) if len(sites.holes) else _no_holes(len(sites.table))
    _weigh(tables, sites, *groups, *weights, tally, _room(sites), many_room(tables, sites), *holes)


@cache
def _no_holes(count: int) -> Holes:
    """Of so many sites; kernels do not write to it."""
    return Holes(np.full(count, -1), np.empty((4, 0), dtype=np.float32))


def _room(sites: Sites) -> Room:
    length, widest = len(sites.signs) // 3, int(sites.kinds[0])
    lines, most = np.empty((2, widest, length), dtype=np.float32), np.empty((2, widest))
    return Room(lines, most, np.empty((length, length), dtype=np.bool_))


@kernel()
def _weigh(
    tables: Tables,
    sites: Sites,
    fields: IntArray,
    spans: IntArray,
    limits: FloatArray,
    place: FloatArray,
    turn: FloatArray,
    tally: Tally,
    room: Room,
    many: ManyRoom,
    starts: IntArray,
    said: Floats,
) -> None:
    """The entry from Python: an array is handed over in 0.1 us, a tuple of them in 0.7 us and more."""
    groups, weights, holes = Groups(fields, spans, limits), Weights(place, turn), Holes(starts, said)
    if sites.kinds[2] == 1:
        weigh_many(tables, sites, groups, weights, tally, room, many)
    if sites.kinds[1] == 1:
        _weigh_few(tables, sites, groups, weights, tally, room, holes)


@inlined_kernel()
def _weigh_few(tables: Tables, sites: Sites, groups: Groups, weights: Weights, tally: Tally, room: Room, holes: Holes) -> None:
    """The classes of few sites, or of such with holes: one site after the other, places with all dots on a tape first."""
    pad, said = tables.dots.shape[1], holes.said
    for over in range(2):
        for k in range(len(sites.classes)):
            kind = sites.classes[k]
            first, last, size = kind[FIRST], kind[LAST], kind[SIZE]
            if kind[MANY] == 1 or over > kind[OVERHANG]:
                continue
            for turn in range(4):
                terms = (weights.place[turn, over], weights.turn[turn])
                for g in range(groups.spans[turn, size, 0], groups.spans[turn, size, 1]):
                    group, limit = groups.fields[g], groups.limits[g]
                    if group[OVER] != over:
                        continue
                    bound = limit[0] + limit[1]
                    # ln of the places of the group on all tapes: together they have to be negligible
                    of = limit[2] + np.log(float(kind[TAPES] * (last - first)))
                    if holes.starts[first] < 0 and bound < least_of(of, terms, tally.sums):
                        count_bound(np.exp(bound + of + terms[0] - tally.sums[BEST]), bound + terms[1], tally.sums)
                        continue
                    for site in range(first, last):
                        hole, stride = said[turn, :0], np.int64(0)
                        if holes.starts[site] >= 0:
                            stride = sites.sizes[size, 0] + 2 * pad
                            hole = said[turn, holes.starts[site] + (group[Y] + pad) * stride + group[X] + pad :]
                        candidate = Candidate(
                            said[turn, :0],
                            tables.lines[turn],
                            sites.table[site],
                            (turn, site),
                            group,
                            (limit[0], limit[1]),
                            of,
                            terms,
                            hole,
                            stride,
                        )
                        weigh_site(candidate, sites.phases, sites.barred, tally, room)
