"""Every place of many tapes held against the dots: the best one, what all others weigh together, and the strongest of them.

Places are taken in groups, by which of the dots' columns and rows lie on the tape: all of them, or some where the contact
hangs over an edge. A group that cannot matter is counted at its bound; all others are evaluated place by place.
"""

from __future__ import annotations

import numpy as np
from numba import typeof

from tactape_fab.base.jit import inlined_kernel, kernel
from tactape_fab.sense.decode.search.evidence import Floats, Tables
from tactape_fab.sense.decode.search.groups import OVER, X, Y, hole_evidence
from tactape_fab.sense.decode.search.many_tapes import ManyRoom, many_room, weigh_many
from tactape_fab.sense.decode.search.plane_sites import FIRST, LAST, MANY, OVERHANG, SIZE, TAPES, Sites
from tactape_fab.sense.decode.search.tally import Room, Tally, count_bound, least_of, new_tally, weigh_site
from tactape_fab.texture.frames import FloatArray, IntArray

_NOTHING = np.empty((4, 0), dtype=np.float32)


def weigh_sites(
    tables: Tables,
    sites: Sites,
    groups: tuple[IntArray, IntArray, FloatArray],
    base: FloatArray,
    cue: FloatArray,
    tally: Tally,
) -> None:
    """Hold the dots against every place of every site, and add what is found to a tally.

    Parameters
    ----------
    groups : tuple of ndarray
        From `groups.groups_of`.
    base : ndarray, shape (4, 2)
        ln of the weight of one place, by turn, with all dots on the tape and with some over its edge.
    cue : ndarray, shape (4,)
        ln of what speaks for each turn besides the bits; L = E times it.
    """
    starts, said = hole_evidence(tables, sites) if len(sites.holes) else (np.full(len(sites.table), -1), _NOTHING)
    _weigh(tables, sites, *groups, base, cue, tally, _room(sites), many_room(tables, sites), starts, said)


def compile_weighing(tables: Tables, sites: Sites, groups: tuple[IntArray, IntArray, FloatArray]) -> None:
    """Compile what `weigh_sites` calls, for arguments of these types; their values do not matter."""
    room = (_room(sites), many_room(tables, sites), np.empty(0, dtype=np.int64), _NOTHING)
    given = (tables, sites, *groups, np.empty((4, 2)), np.empty(4), new_tally(), *room)
    _weigh.compile(tuple(typeof(value) for value in given))  # type: ignore[no-untyped-call]


def _room(sites: Sites) -> Room:
    length, widest = len(sites.signs) // 3, int(sites.kinds[0])
    lines, most = np.empty((2, widest, length), dtype=np.float32), np.empty((2, widest))
    return Room(lines, most, np.empty((length, length), dtype=np.bool_))


@kernel()
def _weigh(
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
    hole_starts: IntArray,
    said: Floats,
) -> None:
    if sites.kinds[2] == 1:
        weigh_many(tables, sites, groups, spans, limits, base, cue, tally, room, more)
    if sites.kinds[1] == 1:
        _weigh_few(tables, sites, groups, spans, limits, base, cue, tally, room, hole_starts, said)


@inlined_kernel()
def _weigh_few(
    tables: Tables,
    sites: Sites,
    groups: IntArray,
    spans: IntArray,
    limits: FloatArray,
    base: FloatArray,
    cue: FloatArray,
    tally: Tally,
    room: Room,
    hole_starts: IntArray,
    said: Floats,
) -> None:
    """The classes of few sites, or of such with holes: one site after the other, places with all dots on a tape first."""
    pad, sums = tables.dots.shape[1], tally.sums
    for over in range(2):
        for k in range(len(sites.classes)):
            kind = sites.classes[k]
            first, last, size = kind[FIRST], kind[LAST], kind[SIZE]
            if kind[MANY] == 1 or over > kind[OVERHANG]:
                continue
            for turn in range(4):
                terms = (base[turn, over], cue[turn])
                for g in range(spans[turn, size, 0], spans[turn, size, 1]):
                    if groups[g, OVER] != over:
                        continue
                    bound = limits[g, 0] + limits[g, 1]
                    of = limits[g, 2] + np.log(float(kind[TAPES] * (last - first)))
                    if hole_starts[first] < 0 and bound < least_of(of, terms, sums):
                        count_bound(np.exp(bound + of + terms[0] - sums[0]), bound + terms[1], sums)
                        continue
                    for site in range(first, last):
                        hole, stride = said[turn, :0], pad - pad
                        if hole_starts[site] >= 0:
                            stride = sites.sizes[size, 0] + 2 * pad
                            hole = said[turn, hole_starts[site] + (groups[g, Y] + pad) * stride + groups[g, X] + pad :]
                        weigh_site(
                            said[turn, :0],
                            tables.lines[turn],
                            sites.phases,
                            sites.table[site],
                            sites.barred,
                            (turn, site),
                            groups[g],
                            (limits[g, 0], limits[g, 1]),
                            of,
                            terms,
                            tally,
                            room,
                            hole,
                            stride,
                        )
