"""Tapes without a code plane whose symbols have three bits: as `matrices`, with a third plane of signs to be added up.

Written out beside it, as the sums over two planes are what nearly every search of a touch tape spends its time on.
"""

from __future__ import annotations

import numpy as np

from tactape_fab.decode.counting import FAR_BELOW, Tally, count_at, count_bound, least_of
from tactape_fab.decode.evidence import Tables
from tactape_fab.decode.kernels import inner_kernel, kernel
from tactape_fab.decode.matrices import LARGEST_CONTACT, Frame, Matrices, fill_below, fill_frame, frame_of
from tactape_fab.texture.frames import FloatArray

_MORE = 6
"""So many dots are added up at a time after the first."""
_ROUNDING = 1e-3
"""More than sums in single precision may be off by (ln)."""
_NEVER = np.float32(-1e30)
"""Weight (ln) of a place with too few dots on the tape."""
_EVIDENT = np.float32(-1e29)


def weigh_eight(tables: Tables, matrices: Matrices, least: int, base: FloatArray, cue: FloatArray, tally: Tally) -> None:
    """Hold the dots against every place of every tape, and add what is found to a tally; as `matrices.weigh_matrices`."""
    _weigh(tables, matrices, frame_of(tables, matrices), least, np.maximum(base, _NEVER), cue, tally)


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
            _count_rows(tables, matrices, frame, (tape, turn), base[turn], cue[turn], places, tally)


@inner_kernel(fastmath=True)
def _add_first(tables: Tables, matrices: Matrices, frame: Frame, tape: int, turn: int) -> None:
    """Fill `Matrices.sums` and `Matrices.most` of a tape and turn."""
    size, bits = matrices.sizes[matrices.size_of[tape]], matrices.bits[tape]
    cells, evidence = tables.cells[turn], tables.evidence[turn]
    wide, high = size[0] + tables.size[turn, 0] - 1, size[1] + tables.size[turn, 1] - 1
    left, top = LARGEST_CONTACT - tables.size[turn, 0] + 1, LARGEST_CONTACT - tables.size[turn, 1] + 1
    for j in range(high):
        out, said = matrices.sums[tape, turn, j], frame.said[turn, matrices.size_of[tape], j]
        for i in range(wide):
            out[i] = said[i]
        for k in range(0, frame.first, 2):  # two at a time, so that the sums pass through memory less often
            one, two = frame.order[k], frame.order[min(k + 1, frame.first - 1)]
            share = 1.0 if k + 1 < frame.first else 0.0
            r1, c1, r2, c2 = cells[one, 1] + top + j, cells[one, 0] + left, cells[two, 1] + top + j, cells[two, 0] + left
            x1, y1, z1 = bits[0, r1, c1:], bits[1, r1, c1:], bits[2, r1, c1:]
            x2, y2, z2 = bits[0, r2, c2:], bits[1, r2, c2:], bits[2, r2, c2:]
            ex1, ey1, ez1 = np.float32(evidence[one, 1]), np.float32(evidence[one, 2]), np.float32(evidence[one, 3])
            ex2, ey2 = np.float32(share * evidence[two, 1]), np.float32(share * evidence[two, 2])
            ez2 = np.float32(share * evidence[two, 3])
            for i in range(wide):
                out[i] += ex1 * x1[i] + ey1 * y1[i] + ez1 * z1[i] + ex2 * x2[i] + ey2 * y2[i] + ez2 * z2[i]
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
    total, bits, evidence = float(out[at]), matrices.bits[tape], tables.evidence[turn]
    left, top = LARGEST_CONTACT - tables.size[turn, 0] + 1 + at, LARGEST_CONTACT - tables.size[turn, 1] + 1 + row
    for k in range(frame.first, len(frame.order)):
        dot = frame.order[k]
        r, c = top + tables.cells[turn, dot, 1], left + tables.cells[turn, dot, 0]
        if bits[0, r, c] != 0.0:
            total += evidence[dot, 0] + evidence[dot, 1] * bits[0, r, c]
            total += evidence[dot, 2] * bits[1, r, c] + evidence[dot, 3] * bits[2, r, c]
    return float(total + weight[at])


@inner_kernel(fastmath=True)
def _add_more(tables: Tables, matrices: Matrices, frame: Frame, at: tuple[int, int, int], first: int, last: int) -> float:
    """Add some more dots to the sums of a row, and the largest of them with its weight; ``at`` is tape, turn and row."""
    tape, turn, j = at
    size, bits, evidence = matrices.size_of[tape], matrices.bits[tape], tables.evidence[turn]
    out, weight = matrices.sums[tape, turn, j], frame.weight[turn, size, j]
    wide = matrices.sizes[size, 0] + tables.size[turn, 0] - 1
    left, top = LARGEST_CONTACT - tables.size[turn, 0] + 1, LARGEST_CONTACT - tables.size[turn, 1] + 1 + j
    for k in range(first, last):
        dot = frame.order[k]
        row, column = tables.cells[turn, dot, 1] + top, tables.cells[turn, dot, 0] + left
        x, y, z = bits[0, row, column:], bits[1, row, column:], bits[2, row, column:]
        said, ex = np.float32(evidence[dot, 0]), np.float32(evidence[dot, 1])
        ey, ez = np.float32(evidence[dot, 2]), np.float32(evidence[dot, 3])
        for i in range(wide):
            out[i] += ex * x[i] + ey * y[i] + ez * z[i] + said * x[i] * x[i]  # a square is 1 where there is a part
    most = _NEVER
    for i in range(wide):
        most = max(most, out[i] + weight[i])
    return float(most)


@inner_kernel()
def _count_rows(
    tables: Tables,
    matrices: Matrices,
    frame: Frame,
    of: tuple[int, int],
    base: FloatArray,
    cue: float,
    places: float,
    tally: Tally,
) -> None:
    """Count the places of a tape in one turn, a row that cannot matter at its bound; ``places`` is ln of how many there are."""
    tape, turn = of
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
