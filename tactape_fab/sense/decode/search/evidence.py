"""Soft symbols -> evidence per line and phase, for every column and row of the dots, wherever in a code plane they lie.

Evidence is ln E with E = product of 2 q(b) over the x and y bits of the dots: against any texture whose bits are fair coins
to the code. Along a column of the code plane the x bits are the main sequence from some phase, along a row the y bits are;
so the evidence of a contact at any place of any sector is one entry of a table for each of its columns and rows.

A symbol of eight directions has three bits (`Directions.gray_codes`): E is the product over all three. Of a symbol that is
drawn from all eight alike the bits are fair coins that know nothing of each other, so the mean of E is 1 then, whatever q is.
docs/trust.md derives the bound from it; docs/codes.md has the bits of the plane.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from tactape_fab.base.jit import inlined_kernel, inner_kernel, kernel
from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.plane import PlaneCode

Floats = npt.NDArray[np.float32]


_CODES_AROUND: IntArray = DIRECTIONS[8].gray_codes[DIRECTIONS[8].clockwise].astype(np.int64)


class Tables(NamedTuple):
    """Evidence of the dots of one grid in the four quarter turns.

    Columns and rows count from the dots' own corner. Tables of the dots in rows below r (columns below c) are kept for all
    r (c), so that dots which hang over a tape's edge can be left out.

    cells (4, n, 2): Column and row of each dot.
    evidence (4, n, 3): From `turned`; of eight directions (4, n, 4), from `turned_of_eight`.
    corner (4, 2): The dots' corner in columns and rows of the grid after the turn.
    size (4, 2): Columns and rows of the dots.
    lines (4, 2, m + 1, m, 2 L): [turn, 0, rows below, column, phase] evidence of the x bits of a column; [turn, 1, columns below,
        row, phase] of the y bits of a row. Phases twice over.
    dots (4, m + 1, m + 1): Dots in columns below c and rows below r.
    most (4, 2, m + 1, m + 1): Largest evidence of the x bits and of the y bits of those dots; a third bit counts with the y bit.
    """

    cells: IntArray
    evidence: FloatArray
    corner: IntArray
    size: IntArray
    lines: Floats
    dots: IntArray
    most: FloatArray


def signs_of(code: PlaneCode) -> Floats:
    """Bits of the main sequence as -1 and 1, three times over."""
    return np.tile(2.0 * np.array(code.main.digits, dtype=np.float32) - 1.0, 3).astype(np.float32)


@cache
def columns_by_symbol(directions: int) -> IntArray:
    """Column of `q` (grid's axes) that holds each symbol value of the texture, for each quarter turn; shape (4, directions)."""
    columns, around = np.empty((4, directions), dtype=np.int64), np.arange(directions)
    for turn in range(4):
        # the texture's E is the grid's direction number `turn` in quarters (`turned`), the others follow clockwise in
        # both
        columns[turn, DIRECTIONS[directions].clockwise] = (around + turn * directions // 4) % directions
    return columns


@kernel()
def turned(nodes: IntArray, q: FloatArray, turn: int, cells: IntArray, evidence: FloatArray) -> None:
    """Columns and rows of dots, and (mean, x, y) evidence of each, for a quarter turn of the grid's axes, written in place.

    For turn t the texture's x axis is the grid's first axis turned t times by 90 degrees (from u towards v). A dot's ln E is
    mean + x (x bit) + y (y bit), bits as -1 and 1. The directions E, S, W, N have the bits (0, 1), (1, 1), (1, 0), (0, 0).
    """
    for i in range(len(q)):
        k, j = nodes[i, 0], nodes[i, 1]
        if turn == 0:
            cells[i, 0], cells[i, 1] = k, j
        elif turn == 1:
            cells[i, 0], cells[i, 1] = j, -k
        elif turn == 2:
            cells[i, 0], cells[i, 1] = -k, -j
        else:
            cells[i, 0], cells[i, 1] = -j, k
        # after `turn` quarter turns the texture's x axis is the grid's direction number `turn`: letters follow from there,
        # clockwise
        e, s, w, m = q[i, turn % 4], q[i, (turn + 1) % 4], q[i, (turn + 2) % 4], q[i, (turn + 3) % 4]
        # ln 2 q(b) for b = 1, 0: a bit's evidence is their mean, and half their difference with the bit's sign
        x1, x0 = np.log(2.0 * (w + s)), np.log(2.0 * (e + m))
        # `WRONG_SHARE` keeps every q above 0, so that no logarithm is infinite
        y1, y0 = np.log(2.0 * (e + s)), np.log(2.0 * (m + w))
        evidence[i, 0] = 0.5 * (x0 + x1 + y0 + y1)
        evidence[i, 1] = 0.5 * (x1 - x0)
        evidence[i, 2] = 0.5 * (y1 - y0)


@kernel()
def turned_of_eight(q: FloatArray, turn: int, codes: IntArray, evidence: FloatArray) -> None:
    """(mean, x, y, z) evidence of each dot of eight directions, for a quarter turn of the grid's axes, written in place.

    ``codes`` are the bits of E, SE, S, SW, W, NW, N, NE, as they follow each other from the texture's x axis to its y axis.
    """
    for i in range(len(q)):
        evidence[i, 0] = 0.0
        for bit in range(3):
            one = zero = 0.0
            for place in range(8):
                if codes[place] >> bit & 1 == 1:
                    one += q[i, (place + 2 * turn) % 8]
                else:
                    zero += q[i, (place + 2 * turn) % 8]
            ln_one, ln_zero = np.log(2.0 * one), np.log(2.0 * zero)
            evidence[i, 0] += 0.5 * (ln_one + ln_zero)
            evidence[i, 1 + bit] = 0.5 * (ln_one - ln_zero)


def tables_of(nodes: IntArray, q: FloatArray, signs: Floats, most: int) -> Tables:
    """Tables of soft symbols.

    nodes (n, 2): From `fit.fit_grid`.
    q (n, directions): From `fit.posteriors`.
    signs (3 L,): From `signs_of`; empty for tapes without a code plane, and then there are no `lines`.
    most: Largest contact, in cells; for a larger one all tables but `size` are empty.
    """
    n, length = len(q), len(signs) // 3
    cells, evidence = np.empty((4, n, 2), dtype=np.int64), np.empty((4, n, 3 if q.shape[1] == 4 else 4))
    corner, size = np.empty((4, 2), dtype=np.int64), np.empty((4, 2), dtype=np.int64)
    codes = None if q.shape[1] == 4 else _CODES_AROUND
    m = _fill_cells(nodes, q, codes, cells, evidence, corner, size)
    # memory of the tables grows with m^2: dots that reach farther are no contact, and get no tables
    if m > most:
        m = 0
    # phases twice over, so that L of them from any phase on are one piece of memory without a modulo. Single precision: ln E of
    # up to some hundred is right to 1e-4, and a vector holds twice as many
    lines = np.zeros((4, 2, m + 1, m, 2 * length), dtype=np.float32)
    dots, most_evidence = np.zeros((4, m + 1, m + 1), dtype=np.int64), np.zeros((4, 2, m + 1, m + 1))
    if length > 0:
        _fill_lines(cells, evidence, signs, lines)
    _fill_below(cells, evidence, dots, most_evidence)
    return Tables(cells, evidence, corner, size, lines, dots, most_evidence)


@kernel(no_rewrites=False)
def _fill_cells(
    nodes: IntArray,
    q: FloatArray,
    codes: IntArray | None,
    cells: IntArray,
    evidence: FloatArray,
    corner: IntArray,
    size: IntArray,
) -> int:
    """Fill those fields of `Tables` and return the largest size. With four directions `codes` is None."""
    most = 0
    for turn in range(4):
        turned(nodes, q, turn, cells[turn], evidence[turn])
        if codes is not None:
            turned_of_eight(q, turn, codes, evidence[turn])
        for axis in range(2):
            low = high = cells[turn, 0, axis]
            for i in range(len(q)):
                low, high = min(low, cells[turn, i, axis]), max(high, cells[turn, i, axis])
            for i in range(len(q)):
                cells[turn, i, axis] -= low
            corner[turn, axis], size[turn, axis] = low, high - low + 1
            most = max(most, high - low + 1)
    return most


@kernel(fastmath=True)
def _fill_lines(cells: IntArray, evidence: FloatArray, signs: Floats, lines: Floats) -> None:
    """Fill `Tables.lines`, zero before."""
    m, twice, length = lines.shape[3], lines.shape[4], lines.shape[4] // 2
    for turn in range(4):
        for axis in range(2):
            for i in range(cells.shape[1] if m > 0 else 0):
                line, along = cells[turn, i, axis], cells[turn, i, 1 - axis]
                # half the mean on each axis: the entries of a column and a row then add up to ln E
                mean, half = np.float32(0.5 * evidence[turn, i, 0]), np.float32(evidence[turn, i, 1 + axis])
                # entry p: the line's phase is p at the dots' corner, so this dot shows bit p + along of the main sequence
                out, bits = lines[turn, axis, along + 1, line], signs[along % length :]
                for p in range(twice):
                    out[p] += mean + half * bits[p]
            # sums of all below: any range of dots along a line is the difference of two of them
            for k in range(1, m):
                for line in range(m):
                    out, below = lines[turn, axis, k + 1, line], lines[turn, axis, k, line]
                    for p in range(twice):
                        out[p] += below[p]


@kernel()
def _fill_below(cells: IntArray, evidence: FloatArray, dots: IntArray, most: FloatArray) -> None:
    """Fill `Tables.dots` and `Tables.most`, zero before: counts per cell, then in all cells before, both ways."""
    m = dots.shape[1]
    for turn in range(4):
        for i in range(cells.shape[1] if m > 1 else 0):
            c, r = cells[turn, i, 0] + 1, cells[turn, i, 1] + 1
            dots[turn, c, r] += 1
            for axis in range(2):
                # mean + |half difference| is the larger of what both bits say; the mean is halved over the axes as in
                # `_fill_lines`
                most[turn, axis, c, r] += 0.5 * evidence[turn, i, 0] + abs(evidence[turn, i, 1 + axis])
            if evidence.shape[2] == 4:
                most[turn, 1, c, r] += abs(evidence[turn, i, 3])
        # a summed-area table: four entries give any rectangle
        for c in range(1, m):
            for r in range(1, m):
                dots[turn, c, r] += dots[turn, c - 1, r] + dots[turn, c, r - 1] - dots[turn, c - 1, r - 1]
                for axis in range(2):
                    of = most[turn, axis]
                    of[c, r] += of[c - 1, r] + of[c, r - 1] - of[c - 1, r - 1]


@inner_kernel(fastmath=True)
def fill_range(out: Floats, lines: Floats, dots: tuple[int, int], count: int) -> None:
    """Evidence of a range of the dots (first, last + 1) along each of some lines, for every phase twice over.

    out (m + 1, 2 L): Overwritten, but for its last row.
    lines (m + 1, m, 2 L): One turn and axis of `Tables.lines`.
    """
    low, high = dots
    for k in range(count):
        for p in range(lines.shape[2]):
            out[k, p] = lines[high, k, p] - lines[low, k, p]


@inlined_kernel()
def _shifted(phase: int, by: int, cycle: int) -> int:
    """(phase + by) modulo the cycle, for `by` below a cycle."""
    later = phase + by
    return later if later < cycle else later - cycle


@inner_kernel(fastmath=True)
def add_everywhere(out: Floats, most: Floats, evidence: Floats, count: int, phases: IntArray) -> None:
    """Evidence of all lines together for every start in the plane and every phase, and the largest of each start.

    out (n, L), most (n,): Overwritten, but for starts so near the end that a line would lie beyond it.
    count: Number of lines; `add_lines` has the other parameters.
    """
    starts, length = len(out) - count + 1, out.shape[1]
    for k in range(count):  # a line at all starts, then the next: a third less time than all lines at each start
        line = evidence[k]
        for start in range(starts):
            here, shift = out[start], phases[start + k]
            value = line[shift : shift + length]
            if k == 0:
                for p in range(length):
                    here[p] = value[p]
            else:
                for p in range(length):
                    here[p] += value[p]
    for start in range(starts):
        here, largest = out[start], out[start, 0]
        for p in range(1, length):
            largest = max(largest, here[p])
        most[start] = largest


@inner_kernel(fastmath=True)
def add_lines_at(
    out: Floats, most: FloatArray, evidence: Floats, span: tuple[int, int], phases: IntArray, start: int, phase: int, places: int
) -> float:
    """Evidence of some lines together at one phase for each of some places that follow one another, and the largest of it.

    out (k, n), most (k,): Entry 0 of each place's row is overwritten, and its `most`.
    places: How many there are, the first at `start`; `add_lines` has the other parameters.
    """
    (first, last), cycle, largest = span, evidence.shape[1] // 2, np.float32(-np.inf)
    for j in range(places):
        total = np.float32(0.0)
        for k in range(first, last):
            total += evidence[k, _shifted(phases[start + j + k], phase, cycle)]
        out[j, 0] = most[j] = total
        largest = max(largest, total)
    return float(largest)


@inner_kernel(fastmath=True)
def add_lines(out: Floats, evidence: Floats, span: tuple[int, int], phases: IntArray, start: int, phase: int) -> float:
    """Evidence of some lines together for some phases that follow one another, and the largest of it.

    out (n,): Overwritten; n is at most L.
    evidence (m + 1, 2 L): From `fill_range`, the last row zero.
    span: The first line and the last + 1.
    phases: Phase of each line of the plane.
    start: Where the dots' line 0 lies in `phases`.
    phase: The first of those in `out`.
    """
    first, last = span
    length, cycle, nothing = len(out), evidence.shape[1] // 2, len(evidence) - 1
    for k in range(first, last, 4):  # four at a time, so that sums pass through memory a quarter as often; zeros behind the last
        # behind the last line the row of zeros is added: one loop for any number of lines
        k1, k2, k3 = (
            (k + 1 if k + 1 < last else nothing),
            (k + 2 if k + 2 < last else nothing),
            (k + 3 if k + 3 < last else nothing),
        )
        shift = _shifted(phases[start + k], phase, cycle)
        shift1, shift2, shift3 = (
            _shifted(phases[start + k1], phase, cycle) if k1 < last else 0,
            _shifted(phases[start + k2], phase, cycle) if k2 < last else 0,
            _shifted(phases[start + k3], phase, cycle) if k3 < last else 0,
        )
        one, two = evidence[k, shift : shift + length], evidence[k1, shift1 : shift1 + length]
        three, four = evidence[k2, shift2 : shift2 + length], evidence[k3, shift3 : shift3 + length]
        if k == first:
            for p in range(length):
                out[p] = one[p] + two[p] + three[p] + four[p]
        else:
            for p in range(length):
                out[p] = out[p] + one[p] + two[p] + three[p] + four[p]
    return float(largest_of_line(out))


@inner_kernel(fastmath=True)
def largest_of_line(out: Floats) -> float:
    """Largest evidence of a line over all phases."""
    length = len(out)
    a = b = c = d = e = f = g = h = out[0]  # eight at a time: one after the other each would wait for the one before
    for p in range(0, length - 7, 8):
        a, b, c, d = max(a, out[p]), max(b, out[p + 1]), max(c, out[p + 2]), max(d, out[p + 3])
        e, f, g, h = max(e, out[p + 4]), max(f, out[p + 5]), max(g, out[p + 6]), max(h, out[p + 7])
    for p in range(length - length % 8, length):
        a = max(a, out[p])
    return float(max(a, b, c, d, e, f, g, h))
