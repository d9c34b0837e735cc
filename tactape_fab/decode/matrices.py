"""Tapes without a code plane: the dots held against every place of their matrices of symbols, in all turns.

Nothing is known of a matrix but its symbols, so each place is a sum over dots. The dots that say most are added up first, at
all places; what the others could say at most drops nearly all of these, and only the rest is added up to the end. What is
dropped is counted at its bound, as for codes with a plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import ceil
from typing import NamedTuple

import numpy as np

from tactape_fab.decode.counting import FAR_BELOW, Tally, count_at, count_bound, least_of
from tactape_fab.decode.evidence import Floats, Tables
from tactape_fab.decode.kernels import inlined_kernel, inner_kernel, kernel
from tactape_fab.decode.near import NO_PART
from tactape_fab.texture.frames import FloatArray, IntArray, SymbolArray

LARGEST_CONTACT = 24
"""Cells; dots that reach farther are no contact."""
_LEAST_FIRST, _SHARE_FIRST = 12, 0.34
"""So many dots, or this share of them, are added up at all places before any place is dropped."""
_MORE = 6
"""So many dots are added up at a time then."""
_ROUNDING = 1e-3
"""More than sums in single precision may be off by (ln)."""
_NEVER = np.float32(-1e30)
"""Weight (ln) of a place with too few dots on the tape."""
_EVIDENT = np.float32(-1e29)


class Matrices(NamedTuple):
    """Tapes by their matrices, those of equal size together.

    Attributes
    ----------
    bits : ndarray of float32, shape (n, 2, high, wide)
        The x and the y bits of each tape's symbols as -1 and 1, 0 where there is no part; `LARGEST_CONTACT` zeros on every side.
        Of eight directions (n, 3, high, wide).
    holes : ndarray of int, shape (k, 2)
        Column and row of grid points without a part, tape by tape.
    first_hole : ndarray of int, shape (n + 1,)
        Where those of each tape begin.
    sizes, size_of, classes : ndarray of int
        As in `sites.Sites`.
    sums, most : ndarray of float32
        Room to work in, written over and over by one call: (n, 4, places down, places across) what is added up so far at each
        place, and (n, 4, places down) the largest of each row with its weight.
    """

    bits: Floats
    holes: IntArray
    first_hole: IntArray
    sizes: IntArray
    size_of: IntArray
    classes: IntArray
    sums: Floats
    most: Floats


class Frame(NamedTuple):
    """What the places of all tapes of a size have in common for some dots.

    Attributes
    ----------
    order : ndarray of int, shape (dots,)
        The dots, those that say most first.
    first : int
        How many of them are added up first.
    rest : ndarray, shape (4, dots + 1)
        Most that all dots after so many of them can say, by turn.
    said : ndarray of float32, shape (4, sizes, places down, places across)
        What the first dots that lie on the tape say whatever its symbols.
    weight : ndarray of float32, of the same shape
        ln of the weight of each place.
    below : ndarray of float32, shape (m + 1, m + 1)
        Room: what the first dots say whatever the symbols, in columns below c and rows below r.
    """

    order: IntArray
    first: int
    rest: FloatArray
    said: Floats
    weight: Floats
    below: Floats


def matrices_of(shown: Sequence[SymbolArray], sizes: list[tuple[int, int]], bits_each: int = 2) -> Matrices:
    """Matrices from what tapes show (`near.shown_by`), ordered by size, and the sizes (columns, rows) that occur."""
    wide, high = (max(size[axis] for size in sizes) for axis in range(2))
    pad = LARGEST_CONTACT
    bits = np.zeros((len(shown), bits_each, high + 2 * pad, wide + 2 * pad), dtype=np.float32)
    for tape, symbols in enumerate(shown):
        rows, columns = symbols.shape
        planes = np.stack([2 * (symbols >> bit & 1) for bit in range(bits_each)]).astype(np.int64)
        values = np.where(symbols == NO_PART, 0, planes - 1)
        bits[tape, :, pad : pad + rows, pad : pad + columns] = values
    size_of = np.array([sizes.index((symbols.shape[1], symbols.shape[0])) for symbols in shown])
    bounds = [0, *(np.flatnonzero(np.diff(size_of)) + 1).tolist(), len(shown)]
    holes = [np.argwhere(symbols == NO_PART)[:, ::-1] for symbols in shown]
    places = (high + pad - 1, wide + pad - 1)
    return Matrices(
        bits=bits,
        holes=np.concatenate(holes).astype(np.int64),
        first_hole=np.cumsum([0, *map(len, holes)]).astype(np.int64),
        sizes=np.array(sizes, dtype=np.int64),
        size_of=size_of.astype(np.int64),
        classes=np.array([(a, b, size_of[a], 1, 1, 0) for a, b in pairwise(bounds)], dtype=np.int64),
        sums=np.empty((len(shown), 4, *places), dtype=np.float32),
        most=np.empty((len(shown), 4, places[0]), dtype=np.float32),
    )


def weigh_matrices(tables: Tables, matrices: Matrices, least: int, base: FloatArray, cue: FloatArray, tally: Tally) -> None:
    """Hold the dots against every place of every tape, and add what is found to a tally; parameters as `weigh.weigh_sites`.

    ``least`` is the fewest dots on a tape; the tally is a new one.
    """
    _weigh(tables, matrices, frame_of(tables, matrices), least, np.maximum(base, _NEVER), cue, tally)


def frame_of(tables: Tables, matrices: Matrices) -> Frame:
    """What the places have in common, its tables still to be filled in."""
    n, m = tables.evidence.shape[1], tables.dots.shape[1] - 1
    first = min(n, max(_LEAST_FIRST, ceil(_SHARE_FIRST * n)))
    order = np.argsort(-np.abs(tables.evidence[0, :, 1:]).sum(axis=1), kind="stable").astype(np.int64)
    most = (tables.evidence[..., 0] + np.abs(tables.evidence[..., 1:]).sum(axis=2))[:, order]
    after = np.concatenate([np.cumsum(most[:, ::-1], axis=1)[:, ::-1], np.zeros((4, 1))], axis=1)
    wide, high = (matrices.sizes.max(axis=0) + m - 1).tolist()
    shape = (4, len(matrices.sizes), high, wide)
    return Frame(
        order=order,
        first=first,
        rest=after,
        said=np.empty(shape, dtype=np.float32),
        weight=np.empty(shape, dtype=np.float32),
        below=np.empty((m + 1, m + 1), dtype=np.float32),
    )


@kernel()
def _weigh(tables: Tables, matrices: Matrices, frame: Frame, least: int, base: FloatArray, cue: FloatArray, tally: Tally) -> None:
    for turn in range(4):
        fill_below(tables, frame, turn)
        for size in range(len(matrices.sizes)):
            fill_frame(tables, frame, matrices.sizes[size], (turn, size), least, base[turn])
    for tape in range(len(matrices.bits)):
        for turn in range(4):
            _add_first(tables, matrices, frame, tape, turn)
        tally.sums[0] = max(tally.sums[0], _guess(tables, matrices, frame, tape) - _ROUNDING)
    places = np.log(4.0 * matrices.sums.shape[2] * matrices.sums.shape[3] * len(matrices.bits))
    for tape in range(len(matrices.bits)):
        for turn in range(4):
            _count_rows(tables, matrices, frame, tape, turn, base[turn], cue[turn], places, tally)


@inner_kernel()
def fill_below(tables: Tables, frame: Frame, turn: int) -> None:
    """Fill `Frame.below` for a turn."""
    below = frame.below
    for c in range(len(below)):
        for r in range(len(below)):
            below[c, r] = 0.0
    for k in range(frame.first):
        dot = frame.order[k]
        below[tables.cells[turn, dot, 0] + 1, tables.cells[turn, dot, 1] + 1] += tables.evidence[turn, dot, 0]
    for c in range(1, len(below)):
        for r in range(1, len(below)):
            below[c, r] += below[c - 1, r] + below[c, r - 1] - below[c - 1, r - 1]


@inner_kernel()
def fill_frame(tables: Tables, frame: Frame, size: IntArray, of: tuple[int, int], least: int, base: FloatArray) -> None:
    """Fill `Frame.said` and `Frame.weight` of a turn and size of tapes."""
    turn, dots, below = of[0], tables.dots[of[0]], frame.below
    wide, high = tables.size[turn, 0], tables.size[turn, 1]
    for j in range(size[1] + high - 1):
        said, weight = frame.said[turn, of[1], j], frame.weight[turn, of[1], j]
        y = j - high + 1
        r0, r1 = max(0, -y), min(high, size[1] - y)
        for i in range(size[0] + wide - 1):
            if wide <= i < size[0]:  # all columns of dots on the tape, as at the place before
                said[i], weight[i] = said[i - 1], weight[i - 1]
                continue
            x = i - wide + 1
            c0, c1 = max(0, -x), min(wide, size[0] - x)
            over = 0 if c1 - c0 == wide and r1 - r0 == high else 1
            enough = dots[c1, r1] - dots[c0, r1] - dots[c1, r0] + dots[c0, r0] >= least
            weight[i] = base[over] if enough else _NEVER
            said[i] = below[c1, r1] - below[c0, r1] - below[c1, r0] + below[c0, r0]


@inner_kernel(fastmath=True)
def _add_first(tables: Tables, matrices: Matrices, frame: Frame, tape: int, turn: int) -> None:
    """Fill `Matrices.sums` and `Matrices.most` of a tape and turn."""
    size, x_bits, y_bits = matrices.sizes[matrices.size_of[tape]], matrices.bits[tape, 0], matrices.bits[tape, 1]
    cells, evidence = tables.cells[turn], tables.evidence[turn]
    wide, high = size[0] + tables.size[turn, 0] - 1, size[1] + tables.size[turn, 1] - 1
    left, top = LARGEST_CONTACT - tables.size[turn, 0] + 1, LARGEST_CONTACT - tables.size[turn, 1] + 1
    for j in range(high):
        out, said = matrices.sums[tape, turn, j], frame.said[turn, matrices.size_of[tape], j]
        for i in range(wide):
            out[i] = said[i]
        for k in range(0, frame.first, 4):  # four at a time, so that the sums pass through memory less often
            r1, c1, ex1, ey1 = _dot(cells, evidence, frame, k)
            r2, c2, ex2, ey2 = _dot(cells, evidence, frame, k + 1)
            r3, c3, ex3, ey3 = _dot(cells, evidence, frame, k + 2)
            r4, c4, ex4, ey4 = _dot(cells, evidence, frame, k + 3)
            x1, y1 = x_bits[r1 + top + j, c1 + left :], y_bits[r1 + top + j, c1 + left :]
            x2, y2 = x_bits[r2 + top + j, c2 + left :], y_bits[r2 + top + j, c2 + left :]
            x3, y3 = x_bits[r3 + top + j, c3 + left :], y_bits[r3 + top + j, c3 + left :]
            x4, y4 = x_bits[r4 + top + j, c4 + left :], y_bits[r4 + top + j, c4 + left :]
            for i in range(wide):
                out[i] += ex1 * x1[i] + ey1 * y1[i] + ex2 * x2[i] + ey2 * y2[i]
                out[i] += ex3 * x3[i] + ey3 * y3[i] + ex4 * x4[i] + ey4 * y4[i]
    for k in range(matrices.first_hole[tape], matrices.first_hole[tape + 1]):
        for d in range(frame.first):
            dot = frame.order[d]
            i = matrices.holes[k, 0] - cells[dot, 0] + tables.size[turn, 0] - 1
            j = matrices.holes[k, 1] - cells[dot, 1] + tables.size[turn, 1] - 1
            matrices.sums[tape, turn, j, i] -= np.float32(evidence[dot, 0])
    for j in range(high):
        out, weight, most = matrices.sums[tape, turn, j], frame.weight[turn, matrices.size_of[tape], j], _NEVER
        for i in range(wide):
            most = max(most, out[i] + weight[i])
        matrices.most[tape, turn, j] = most


@inlined_kernel()
def _dot(cells: IntArray, evidence: FloatArray, frame: Frame, k: int) -> tuple[int, int, np.float32, np.float32]:
    """Row and column of a dot, and what its bits say; nothing beyond those that are added up first."""
    dot = frame.order[min(k, frame.first - 1)]
    share = 1.0 if k < frame.first else 0.0
    return cells[dot, 1], cells[dot, 0], np.float32(share * evidence[dot, 1]), np.float32(share * evidence[dot, 2])


@inner_kernel()
def _guess(tables: Tables, matrices: Matrices, frame: Frame, tape: int) -> float:
    """Ln E with its weight of the place of a tape where the first dots fit best."""
    best, turn, row, size = _EVIDENT, 0, -1, matrices.size_of[tape]
    for t in range(4):
        for j in range(matrices.sizes[size, 1] + tables.size[t, 1] - 1):
            if matrices.most[tape, t, j] > best:
                best, turn, row = matrices.most[tape, t, j], t, j
    if row < 0:
        return -np.inf
    out, weight, at = matrices.sums[tape, turn, row], frame.weight[turn, size, row], 0
    for i in range(matrices.sizes[size, 0] + tables.size[turn, 0] - 1):
        if out[i] + weight[i] > out[at] + weight[at]:
            at = i
    return float(_finished(tables, matrices, frame, tape, turn, at, row) + weight[at])


@inner_kernel()
def _finished(tables: Tables, matrices: Matrices, frame: Frame, tape: int, turn: int, i: int, j: int) -> float:
    """Ln E at a place, of all dots."""
    total = float(matrices.sums[tape, turn, j, i])
    left, top = LARGEST_CONTACT - tables.size[turn, 0] + 1 + i, LARGEST_CONTACT - tables.size[turn, 1] + 1 + j
    for k in range(frame.first, len(frame.order)):
        dot = frame.order[k]
        row, column = top + tables.cells[turn, dot, 1], left + tables.cells[turn, dot, 0]
        x, y = matrices.bits[tape, 0, row, column], matrices.bits[tape, 1, row, column]
        if x != 0.0:
            total += tables.evidence[turn, dot, 0]
            total += tables.evidence[turn, dot, 1] * x + tables.evidence[turn, dot, 2] * y
    return total


@inner_kernel(fastmath=True)
def _add_more(tables: Tables, matrices: Matrices, frame: Frame, at: tuple[int, int, int], first: int, last: int) -> float:
    """Add some more dots to the sums of a row, and the largest of them with its weight; ``at`` is tape, turn and row."""
    tape, turn, j = at
    size, x_bits, y_bits = matrices.size_of[tape], matrices.bits[tape, 0], matrices.bits[tape, 1]
    out, weight, wide = (
        matrices.sums[tape, turn, j],
        frame.weight[turn, size, j],
        matrices.sizes[size, 0] + tables.size[turn, 0] - 1,
    )
    left, top = LARGEST_CONTACT - tables.size[turn, 0] + 1, LARGEST_CONTACT - tables.size[turn, 1] + 1 + j
    for k in range(first, last):
        dot = frame.order[k]
        row, column = tables.cells[turn, dot, 1] + top, tables.cells[turn, dot, 0] + left
        x, y = x_bits[row, column:], y_bits[row, column:]
        said = np.float32(tables.evidence[turn, dot, 0])
        ex, ey = np.float32(tables.evidence[turn, dot, 1]), np.float32(tables.evidence[turn, dot, 2])
        for i in range(wide):
            out[i] += ex * x[i] + ey * y[i] + said * x[i] * x[i]  # a square is 1 where there is a part
    most = _NEVER
    for i in range(wide):
        most = max(most, out[i] + weight[i])
    return float(most)


@inner_kernel()
def _count_rows(
    tables: Tables,
    matrices: Matrices,
    frame: Frame,
    tape: int,
    turn: int,
    base: FloatArray,
    cue: float,
    places: float,
    tally: Tally,
) -> None:
    """Count the places of a tape in one turn, a row that cannot matter at its bound; ``places`` is ln of how many there are."""
    sums, size, dots = tally.sums, matrices.size_of[tape], len(frame.order)
    wide = matrices.sizes[size, 0] + tables.size[turn, 0] - 1
    lightest = base[1] if base[0] < _EVIDENT or _EVIDENT < base[1] < base[0] else base[0]
    for j in range(matrices.sizes[size, 1] + tables.size[turn, 1] - 1):
        most, k = float(matrices.most[tape, turn, j]), frame.first
        if most < _EVIDENT:
            continue
        bound = most + frame.rest[turn, k]
        while k < dots and bound >= least_of(places, (0.0, 0.0), sums):
            last = min(k + _MORE, dots)
            bound = _add_more(tables, matrices, frame, (tape, turn, j), k, last) + frame.rest[turn, last]
            k = last
        if bound < least_of(places, (0.0, 0.0), sums):
            count_bound(float(wide) * np.exp(bound - sums[0]), bound - lightest + cue, sums)
            continue
        out, weight = matrices.sums[tape, turn, j], frame.weight[turn, size, j]
        for i in range(wide):
            if weight[i] < _EVIDENT:
                continue
            if out[i] + weight[i] < sums[0] - FAR_BELOW:
                sums[4] = max(sums[4], float(out[i]) + cue)
                continue
            at = (turn, tape, i - tables.size[turn, 0] + 1, j - tables.size[turn, 1] + 1, -1, -1)
            count_at(tally, float(out[i]), 1.0, (float(weight[i]), cue), at)
