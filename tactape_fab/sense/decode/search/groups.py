"""Groups of places of a tape that have the same of the dots' columns and rows on it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from tactape_fab.base.jit import inner_kernel, kernel
from tactape_fab.sense.decode.search.evidence import Tables
from tactape_fab.sense.decode.search.plane_sites import OVERHANG
from tactape_fab.texture.frames import FloatArray, IntArray

X, COLUMNS, FIRST_COLUMN, LAST_COLUMN, Y, ROWS, FIRST_ROW, LAST_ROW, OVER = range(9)
"""Fields of a group: first place on each axis, how many, which of the dots' lines are on the tape; 1 where not all are."""


class Groups(NamedTuple):
    """Groups of places with enough dots on a tape.

    fields (n, 9): `X` ... `OVER` of each. The one with all dots on the tape, if there is one, comes first for each turn and size.
    spans (4, k, 2): First and last + 1 of each turn and size.
    limits (n, 3): Largest evidence of the x and of the y bits of the dots on the tape, and ln of the number of places.
    """

    fields: IntArray
    spans: IntArray
    limits: FloatArray


class Weights(NamedTuple):
    """Prior weights of places, before the dots' bits are looked at.

    place (4, 2): ln of the weight of one place, by turn, with all dots on the tape and with some over its edge.
    turn (4,): ln of the factor for each turn besides the bits, as by the shape of the dots; L is E times that factor.
    """

    place: FloatArray
    turn: FloatArray


def groups_of(tables: Tables, sizes: IntArray, least: int) -> Groups:
    """Groups of places with enough dots on a tape.

    sizes (k, 2): Columns and rows of tapes.
    least: Fewest dots on the tape.
    """
    m = tables.dots.shape[1]
    # 4 turns, and at most 2 m cuts along each axis
    spans, largest = np.empty((4, len(sizes), 2), dtype=np.int64), 16 * len(sizes) * (m + 1) ** 2
    groups, limits = np.empty((largest, 9), dtype=np.int64), np.empty((largest, 3))
    cuts = np.empty((2, 2 * m, 4), dtype=np.int64)
    n = _fill_groups(tables.size, tables.dots, tables.most, sizes, least, groups, spans, limits, cuts)
    return Groups(groups[:n], spans, limits[:n])


@kernel()
def _fill_groups(
    size: IntArray,
    dots: IntArray,
    most: FloatArray,
    sizes: IntArray,
    least: int,
    groups: IntArray,
    spans: IntArray,
    limits: FloatArray,
    cuts: IntArray,
) -> int:
    """Fill what `groups_of` returns; and return how many groups there are. `cuts` is a work buffer."""
    n = 0
    for turn in range(4):
        for k in range(len(sizes)):
            spans[turn, k, 0] = n
            wide_n, high_n = _cuts(cuts[0], sizes[k, 0], size[turn, 0]), _cuts(cuts[1], sizes[k, 1], size[turn, 1])
            for i in range(wide_n):
                for j in range(high_n):
                    c0, c1, r0, r1 = cuts[0, i, 2], cuts[0, i, 3], cuts[1, j, 2], cuts[1, j, 3]
                    if dots[turn, c1, r1] - dots[turn, c0, r1] - dots[turn, c1, r0] + dots[turn, c0, r0] < least:
                        continue
                    for field in range(4):
                        groups[n, field], groups[n, 4 + field] = cuts[0, i, field], cuts[1, j, field]
                    groups[n, OVER] = 0 if c1 - c0 == size[turn, 0] and r1 - r0 == size[turn, 1] else 1
                    for axis in range(2):
                        of = most[turn, axis]
                        limits[n, axis] = of[c1, r1] - of[c0, r1] - of[c1, r0] + of[c0, r0]
                    limits[n, 2] = np.log(float(groups[n, COLUMNS] * groups[n, ROWS]))
                    n += 1
            spans[turn, k, 1] = n
    return n


@inner_kernel()
def _cuts(out: IntArray, size: int, dots: int) -> int:
    """Fill in how `dots` lines can lie on a tape of `size` lines: first place, number of places, first line on it, last + 1."""
    n = 0
    # all lines on the tape: many places in one group. Over an edge each place cuts off other lines, and is a group of its own
    if size >= dots:
        out[0, 0], out[0, 1], out[0, 2], out[0, 3] = 0, size - dots + 1, 0, dots
        n = 1
    for place in range(1 - dots, size):
        if place < 0 or place > size - dots:
            out[n, 0], out[n, 1], out[n, 2], out[n, 3] = place, 1, max(0, -place), min(dots, size - place)
            n += 1
    return n


@inner_kernel()
def likelier_turn(k: int, turn: FloatArray) -> int:
    """The k-th quarter turn, likelier ones first: a turn and its half turn are as likely. ``turn`` as in `Weights`."""
    likely = 0 if turn[0] >= turn[1] else 1
    # 0, 2, 1, 3 if the even turns are likelier, else 1, 3, 0, 2
    return (2 * k + (k // 2 + likely) % 2) % 4


def count_places(groups: Iterable[Groups], classes: Iterable[IntArray]) -> FloatArray:
    """Places of all tapes of some families by turn: with all dots on the tape, and with some beyond its edge; shape (4, 2)."""
    counts = np.zeros((4, 2))
    for of, kinds in zip(groups, classes, strict=True):
        _add_places(of.fields, of.spans, kinds, counts)
    return counts


@kernel()
def _add_places(groups: IntArray, spans: IntArray, classes: IntArray, counts: FloatArray) -> None:
    for turn in range(4):
        for k in range(len(classes)):
            # sites times the tapes of each (`plane_sites.FIRST`, `LAST`, `TAPES`); all L^2 sectors of a site but the barred
            # ones
            tapes = (classes[k, 1] - classes[k, 0]) * classes[k, 3]
            for g in range(spans[turn, classes[k, 2], 0], spans[turn, classes[k, 2], 1]):
                if groups[g, OVER] > classes[k, OVERHANG]:  # only the first group has all dots on the tape
                    break
                counts[turn, groups[g, OVER]] += float(tapes * groups[g, COLUMNS] * groups[g, ROWS])
