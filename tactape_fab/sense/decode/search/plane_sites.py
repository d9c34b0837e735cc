"""Tapes of one code as places in its plane."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from tactape_fab.sense.decode.search.evidence import Floats, signs_of
from tactape_fab.texture.frames import BoolArray, IntArray
from tactape_fab.texture.plane import PlaneCode

START, ORIGIN, SECTOR = range(3)
FIRST, LAST, SIZE, TAPES, OVERHANG, MANY = range(6)
_WORTH_BOUNDS = 6
"""Least number of sites of a class for which bounds are computed."""

Steps = npt.NDArray[np.uint16]
_NONE_BARE = np.zeros((1, 1, 1), dtype=np.bool_)


class Starts(NamedTuple):
    """Where sites start in the plane's phases, for columns and rows: a start is that of all sites of a class there.

    place (2, n): `START` of each group of sites that are of one class and start at one column (row); zeros after the last.
    spans (k, 2, 2): First and last + 1 of these groups, of each class.
    rank (n, 2): The group of each site, for columns and rows.
    members (2, n): Sites, those of a group in ascending order.
    begin (2, n + 1): Where each group's members begin.
    """

    place: IntArray
    spans: IntArray
    rank: IntArray
    members: IntArray
    begin: IntArray


class Sites(NamedTuple):
    """Tapes of one code as places in its plane, those of equal size together.

    signs (3 L,)
    phases (2, m): Phases of the columns, and of the rows, of the plane where there is a site; zeros after the last.
    steps (2, 2, m): Of columns and rows: phase differences modulo L, from each to the next; and index L step + next step of both
        steps in `Bounds.triples`. Small unsigned integers, which are the fastest indices.
    differences (2,): Least and greatest step of the code.
    table (n, 3, 2): Of each site, for columns and rows: where its grid point (0, 0) is in `phases` (`START`); its place in the
        plane modulo L (`ORIGIN`); and u and v of its sector (`SECTOR`), -1 where all sectors may lie there.
    barred (k, 3): Site, ascending, u and v of sectors that may not lie where all others may.
    layout (n,): Which grid points of each site have no part, as one of the next two's entries; 0 where all have one.
    bare (k, rows, columns): The grid points without a part.
    holed (k, 2, m + 1): Of the first columns, and of the first rows, how many have such a point.
    sizes (j, 2): Columns and rows that occur in the family.
    size_of (n,): Which of them each site has.
    classes (k, 6): Sites that are alike: first, last + 1, size, tapes a site, 1 where dots may hang over the tapes' edges, and 1
        where there are so many that bounds are worth their making (`FIRST` ... `MANY`).
    kinds (5,): Most columns or rows; whether there are classes of few and of many sites; and whether there are, here or beside
        these, of many, and grid points without a part.
    starts: The same starts as in `table`, each once.
    """

    signs: Floats
    phases: IntArray
    steps: Steps
    differences: IntArray
    table: IntArray
    barred: IntArray
    layout: IntArray
    bare: BoolArray
    holed: IntArray
    sizes: IntArray
    size_of: IntArray
    classes: IntArray
    kinds: IntArray
    starts: Starts


def sites_of(
    code: PlaneCode,
    sizes: list[tuple[int, int]],
    *,
    origins: IntArray,
    size_of: IntArray,
    sectors: IntArray,
    barred: IntArray | None = None,
    placed: Iterable[BoolArray] | None = None,
    overhang: bool = True,
    beside_many: bool = True,
    beside_holes: bool = False,
) -> Sites:
    """Sites from the plane origins (n, 2) of their tapes, which of some sizes each has, and u and v of their sectors (n, 2).

    `barred` as in `Sites`; `placed` says which grid points have a part, of all sites, or None where all have; `overhang` says
    whether dots may hang over the tapes' edges, `beside_many` and `beside_holes` whether the same dots are also compared with
    many sites elsewhere, and with tapes of which some grid points have no part.
    """
    length, table = code.main.length, np.array(sizes, dtype=np.int64)
    pairs = [_phases(code, origins[:, axis], table[size_of, axis]) for axis in range(2)]
    phases = np.zeros((2, max(len(found) for found, _ in pairs)), dtype=np.int64)
    for axis, (found, _) in enumerate(pairs):
        phases[axis, : len(found)] = found
    # the difference at the end of a piece of the plane leads into the next piece: no tape reaches over it
    everyone, step = sectors[:, 0] < 0, np.diff(phases, append=0) % length
    layout, bare = (np.zeros(len(size_of), dtype=np.int64), _NONE_BARE) if placed is None else _layouts(placed, table.max(axis=0))
    holed = np.zeros((len(bare), 2, max(table.max(), *bare.shape[1:]) + 1), dtype=np.int64)
    for axis in range(2):
        lines = bare.any(axis=1 + axis)
        holed[:, axis, 1:] = np.cumsum(np.pad(lines, ((0, 0), (0, holed.shape[2] - 1 - lines.shape[1]))), axis=1)
    shut = np.bincount(np.empty(0, dtype=np.int64) if barred is None else barred[:, 0], minlength=len(size_of))
    # a class is a run of sites that are alike in all that its loops ask: tapes come sorted so that runs are long
    alike = np.stack([np.asarray(size_of), everyone, layout > 0, shut])
    bounds = [0, *(np.flatnonzero((np.diff(alike.astype(np.int64)) != 0).any(axis=0)) + 1).tolist(), len(size_of)]
    classes = [
        (
            first,
            last,
            size_of[first],
            length * length - shut[first] if everyone[first] else 1,
            overhang or everyone[first],
            last - first >= _WORTH_BOUNDS,
        )
        for first, last in pairwise(bounds)
    ]
    many = [found[MANY] for found in classes]
    starts = np.column_stack([start for _, start in pairs])
    return Sites(
        signs=signs_of(code),
        phases=phases,
        # step L + next step is the row of a table of all pairs of steps: L = 63 makes 3,968 at most, well within 16 bits
        steps=np.stack([step, step * length + np.roll(step, -1, axis=1)], axis=1).astype(np.uint16),
        differences=np.array([code.least_difference, min(code.greatest_difference, length - 1)], dtype=np.int64),
        table=np.stack([starts, origins % length, sectors], axis=1).astype(np.int64),
        barred=np.empty((0, 3), dtype=np.int64) if barred is None else barred,
        layout=layout,
        bare=bare,
        holed=holed,
        sizes=table,
        size_of=np.asarray(size_of, dtype=np.int64),
        classes=np.array(classes, dtype=np.int64),
        kinds=np.array(
            [table.max(), not all(many), any(many), any(many) or beside_many, len(bare) > 1 or beside_holes], dtype=np.int64
        ),
        starts=_starts(starts, bounds),
    )


def _starts(starts: IntArray, bounds: list[int]) -> Starts:
    """`Starts` of sites (n, 2) whose classes lie between some bounds."""
    n = len(starts)
    place, rank, members = np.zeros((2, n), dtype=np.int64), np.empty((n, 2), dtype=np.int64), np.empty((2, n), dtype=np.int64)
    begin, spans = np.full((2, n + 1), n, dtype=np.int64), np.empty((len(bounds) - 1, 2, 2), dtype=np.int64)
    of_class = np.repeat(np.arange(len(bounds) - 1), np.diff(bounds))
    for axis in range(2):
        # lexsort's last key counts first: by class, then by start, and it is stable, so sites stay in ascending order
        members[axis] = np.lexsort([starts[:, axis], of_class])
        own = np.stack([of_class, starts[:, axis]])[:, members[axis]]
        first = np.flatnonzero(np.concatenate([[True], (np.diff(own) != 0).any(axis=0)]))
        place[axis, : len(first)], begin[axis, : len(first)] = own[1, first], first
        rank[members[axis], axis] = np.searchsorted(first, np.arange(n), side="right") - 1
        spans[:, axis] = np.stack([np.searchsorted(first, bounds[:-1]), np.searchsorted(first, bounds[1:])], axis=1)
    return Starts(place, spans, rank, members, begin)


def _layouts(placed: Iterable[BoolArray], size: IntArray) -> tuple[IntArray, BoolArray]:
    """`Sites.layout` and `Sites.bare`, for tapes of at most so many columns and rows."""
    found: dict[tuple[tuple[int, ...], bytes], int] = {}
    bare, layout = [np.zeros(size[::-1], dtype=np.bool_)], []
    for there in placed:
        if there.all():
            layout.append(0)
            continue
        key = (there.shape, there.tobytes())
        layout.append(found.setdefault(key, len(bare)))
        if layout[-1] == len(bare):
            bare.append(np.pad(~there, [(0, int(size[1 - axis]) - there.shape[axis]) for axis in range(2)]))
    return np.array(layout, dtype=np.int64), np.array(bare)


def _phases(code: PlaneCode, firsts: IntArray, counts: IntArray) -> tuple[IntArray, IntArray]:
    """Phases of all plane indices in the union of some intervals, and the index of each interval's start among them."""
    order = np.argsort(firsts, kind="stable")
    # the union of intervals: sorted by their beginnings, a piece ends where the next one begins beyond all ends so far
    low, high = firsts[order], np.maximum.accumulate((firsts + counts)[order])
    opens = np.concatenate([[True], low[1:] > high[:-1]])
    piece = np.cumsum(opens) - 1
    piece_low, piece_high = low[opens], high[np.concatenate([opens[1:], [True]])]
    before = np.concatenate([[0], np.cumsum(piece_high - piece_low)])
    index = np.concatenate([np.arange(a, b) for a, b in zip(piece_low, piece_high, strict=True)])
    start = np.empty(len(firsts), dtype=np.int64)
    start[order] = before[piece] + low - piece_low[piece]
    return np.asarray(code.phase_before(index), dtype=np.int64), start
