"""Tapes with holes: places where dots may lie on grid points without a part, which have no evidence there."""

from __future__ import annotations

import numpy as np

from tactape_fab.base.jit import inner_kernel
from tactape_fab.sense.decode.search.bounds import NEVER, bound_three, bound_two, slot_of
from tactape_fab.sense.decode.search.evidence import Floats, Tables, largest_of_line
from tactape_fab.sense.decode.search.groups import COLUMNS, FIRST_COLUMN, FIRST_ROW, LAST_COLUMN, LAST_ROW, ROWS, X, Y
from tactape_fab.sense.decode.search.plane_sites import ORIGIN, SECTOR, START, Sites
from tactape_fab.sense.decode.search.tally import (
    BEST,
    Buffers,
    ManyBuffers,
    Tally,
    count_at,
    count_bound,
    least_of,
    over_holes,
)
from tactape_fab.texture.frames import FloatArray, IntArray

_ROUNDING = 1e-6
# numba compiles a function anew for each literal it is called with, and so axes are `np.int64`


@inner_kernel()
def reach_holes(holed: IntArray, group: IntArray) -> bool:
    """Whether dots lie over columns and rows with holes at some place of a group."""
    found = True
    for axis in range(2):
        own = 4 * axis
        # the tape's lines that the dots reach from the group's first place to its last; `holed` counts lines with holes before
        # each
        low, high = group[own] + group[own + 2], group[own] + group[own + 1] - 1 + group[own + 3]
        found = found and holed[axis, high] > holed[axis, low]
    return bool(found)


@inner_kernel(no_rewrites=False)
def weigh_holed(
    tables: Tables,
    sites: Sites,
    of: tuple[IntArray, FloatArray],
    turn: int,
    span: tuple[int, int],
    of_all: float,
    terms: tuple[float, float],
    tally: Tally,
    buffers: Buffers,
    more: ManyBuffers | None,
) -> None:
    """The places of a group that `tally.weigh_site` leaves out, of sites with one layout: lines without holes bound them.

    A dot that does not count has ln E = 0, which is at most what it can say anywhere: that bounds it, whether it counts or not.
    ``of`` are the group's fields and limits, ``span`` the first site and the last + 1; `tally.drop` has ``of_all`` and ``terms``.
    """
    (group, limit), holed, out = of, sites.holed[sites.layout[span[0]]], buffers.lines[0, 0]
    length, least, dropped, count = len(out), least_of(of_all, terms, tally.sums), 0.0, 0
    for j in range(group[ROWS]):
        # a hole is under the dots only where both their columns and their rows reach lines that have one: this leaves some
        # places more than it must, none less
        if over_holes(holed, group, np.int64(1), j):
            buffers.rows[0, count], buffers.rows[1, count] = j, j % length
            count += 1
    if more is not None:
        for site in range(span[0], span[1]):
            more.of_rows[site] = NEVER
        for n in range(count):
            _bound_whole(more, tables, sites, (group, holed), turn, np.int64(1), buffers.rows[0, n], span)
            for site in range(span[0], span[1]):
                more.of_rows[site] = max(more.of_rows[site], more.bounds[site])
                more.of_each_row[n, site] = more.bounds[site]
    for i in range(group[COLUMNS]):
        if not over_holes(holed, group, np.int64(0), i):
            continue
        x, of_rows = group[X] + i, limit[1]
        if more is not None:
            _bound_whole(more, tables, sites, (group, holed), turn, np.int64(0), i, span)
        for site in range(span[0], span[1]):
            if more is not None:
                of_rows = more.of_rows[site]
                if more.bounds[site] + of_rows < least:
                    dropped += count
                    continue
            place = sites.table[site]
            rest, most = _add_whole(out, tables, (group, holed), turn, x, (sites.phases[0], place[START, 0] + x))
            if most + rest + of_rows < least:
                dropped += count
                continue
            # the x phase is that of the first row, as in `tally._count_sector`
            first = (place[ORIGIN, 1] + group[Y] + place[SECTOR, 0]) % length
            for n in range(count):
                y, phase = group[Y] + buffers.rows[0, n], first + buffers.rows[1, n]
                value = out[phase if phase < length else phase - length] + rest
                value += of_rows if more is None else more.of_each_row[n, site]
                if value >= least:
                    value = _evidence(tables, sites, (turn, site), (x, y), least)
                if value >= least:
                    count_at(tally, value, 1.0, terms, (turn, site, x, y, place[SECTOR, 0], place[SECTOR, 1]))
                    least = least_of(of_all, terms, tally.sums)
                else:
                    dropped += 1.0
    # some were dropped below a lesser bound: this is no less than all weigh
    if dropped > 0.0:
        count_bound(dropped * np.exp(least + terms[0] - tally.sums[BEST]), least + terms[1], tally.sums)


@inner_kernel(fastmath=True)
def _bound_whole(
    more: ManyBuffers,
    tables: Tables,
    sites: Sites,
    of: tuple[IntArray, IntArray],
    turn: int,
    axis: int,
    place: int,
    span: tuple[int, int],
) -> None:
    """Fill `ManyBuffers.bounds` at a group's place along an axis: runs of lines without holes, and the most of the others."""
    (group, holed), own, other, most, rest, count = of, 4 * axis, 4 * (1 - axis), tables.most[turn, axis], 0.0, 0
    dots, start = (group[other + 2], group[other + 3]), group[own] + place
    known, k, last = more.known, group[own + 2], group[own + 3]
    slot = slot_of(known, tables.lines[turn, axis], turn, axis, dots, tables.size[turn, axis], (k, k), np.int64(0))
    while k < last:
        run = 0
        # the next line is whole if the count of holed ones does not rise over it
        while run < 3 and k + run < last and holed[axis, start + k + run + 1] == holed[axis, start + k]:
            run += 1
        if run == 0:
            rest += _line_within(most, axis, k, dots)
        elif run == 1:
            rest += known.line_most[slot, k]
        else:
            if run == 3:
                bound_three(known, slot, tables.lines[turn, axis], dots, k)
            else:
                bound_two(known, slot, tables.lines[turn, axis], dots, k)
            more.whole[0, count], more.whole[1, count] = k, run
            count += 1
        k += max(run, 1)
    for site in range(span[0], span[1]):
        more.bounds[site] = rest
    for n in range(count):
        k = more.whole[0, n]
        by_step = known.triples[slot, k] if more.whole[1, n] == 3 else known.pairs[slot, k]
        steps = sites.steps[axis, 1 if more.whole[1, n] == 3 else 0, start + k :]
        for site in range(span[0], span[1]):
            more.bounds[site] += by_step[steps[sites.table[site, START, axis]]]


@inner_kernel()
def _line_within(most: FloatArray, axis: int, line: int, dots: tuple[int, int]) -> float:
    """The most that a range of the dots in a column or row can say, from an entry of `Tables.most`."""
    low, high = dots
    if axis == 1:
        return float(most[high, line + 1] - most[low, line + 1] - most[high, line] + most[low, line])
    return float(most[line + 1, high] - most[line, high] - most[line + 1, low] + most[line, low])


@inner_kernel(fastmath=True)
def _add_whole(
    out: Floats, tables: Tables, of: tuple[IntArray, IntArray], turn: int, column: int, where: tuple[IntArray, int]
) -> tuple[float, float]:
    """Fill in the evidence of the dots' columns over no hole for every phase; return the others' largest, and the largest entry.

    ``column`` is where the dots' first column lies on the tape, before its edge as well; ``where`` the plane's phases, and its
    place among them.
    """
    (group, holed), (phases, start), lines, rest = of, where, tables.lines[turn, 0], 0.0
    low, high, length = group[FIRST_ROW], group[LAST_ROW], len(out)
    for p in range(length):
        out[p] = 0.0
    for k in range(group[FIRST_COLUMN], group[LAST_COLUMN]):
        if holed[0, column + k + 1] > holed[0, column + k]:
            rest += _line_within(tables.most[turn, 0], np.int64(0), k, (low, high))
            continue
        shift = phases[start + k]
        above = lines[high, k, shift : shift + length]
        for p in range(length):
            out[p] += above[p]
        # sums of all rows below: the dots from row `low` on are the difference; below row 0 there are none
        if low > 0:
            below = lines[low, k, shift : shift + length]
            for p in range(length):
                out[p] -= below[p]
    return float(rest), float(largest_of_line(out))


@inner_kernel()
def _evidence(tables: Tables, sites: Sites, of: tuple[int, int], at: tuple[int, int], least: float) -> float:
    """Ln E of the dots on a tape's parts, the dots' corner at a column and row; or a bound of it that is below ``least``."""
    (turn, site), place, bare, m = of, sites.table[of[1]], sites.bare[sites.layout[of[1]]], tables.dots.shape[1] - 1
    cells, evidence, bound = tables.cells[turn], tables.evidence[turn], tables.most[turn, 0, m, m] + tables.most[turn, 1, m, m]
    columns, rows = sites.sizes[sites.size_of[site], 0], sites.sizes[sites.size_of[site], 1]
    length = len(sites.signs) // 3
    for i in range(len(cells)):
        column, row, ln_e = at[0] + cells[i, 0], at[1] + cells[i, 1], 0.0
        if 0 <= column < columns and 0 <= row < rows and not bare[row, column]:
            # X[r, c] and Y[r, c] of docs/codes.md: a line's phase, the place along it, and u or v of the sector
            x_phase = sites.phases[0, place[START, 0] + column] + place[ORIGIN, 1] + row + place[SECTOR, 0]
            y_phase = sites.phases[1, place[START, 1] + row] + place[ORIGIN, 0] + column + place[SECTOR, 1]
            ln_e = (
                evidence[i, 0] + evidence[i, 1] * sites.signs[x_phase % length] + evidence[i, 2] * sites.signs[y_phase % length]
            )
        # starts at what all dots can say and is lowered dot by dot, so that it bounds the sum wherever it stops. A dot off all
        # parts has ln E = 0, its factor in E is 1
        bound += ln_e - (evidence[i, 0] + abs(evidence[i, 1]) + abs(evidence[i, 2]))
        if bound < least - _ROUNDING:
            break
    return float(bound)
