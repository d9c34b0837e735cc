"""A contact located in the plane of a code of sequences: all sectors, all places, all turns, no tape registered.

The x bits name column and x phase, the y bits row and y phase, and every pair of phases is some sector's: both axes are
searched on their own, and the best pair is the best place.
"""

from __future__ import annotations

from math import log

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.rule import MOST_RANGE
from tactape_fab.sense.decode.search.evidence import Floats, add_lines, fill_range, signs_of, tables_of
from tactape_fab.sense.decode.search.plane import CodePlane, PlanePlace
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.plane import PlaneCode


class SequencePlane(CodePlane):
    """The whole plane of a code of sequences, prepared for `search`.

    Raises SpecError when the plane is too large to be searched.
    """

    def __init__(self, code: PlaneCode, most_cells: int) -> None:
        if code.range > MOST_RANGE:
            message = f"code = '{code.name}' has {code.range} columns, too many to search without a tape; give its kit"
            raise SpecError(Problem("code", message))
        super().__init__(code)
        self.main = np.array(code.main.digits, dtype=np.int64)
        self._signs = signs_of(code)
        self.phases = np.asarray(code.phase_before(np.arange(code.range)), dtype=np.int64)
        self.most_cells = most_cells

    def search(self, nodes: IntArray, q: FloatArray) -> PlanePlace | None:
        length = len(self.main)
        tables = tables_of(nodes, q, self._signs, self.most_cells)
        if tables.size.max() > self.most_cells:
            return None
        found = []
        for turn in range(4):
            wide, high = (int(v) for v in tables.size[turn])
            # shape (places, L): ln E of the x bits alone, for each column and x phase of the dots' corner; y alike for rows
            x = _along(tables.lines[turn, 0], high, wide, self.phases, length)
            y = _along(tables.lines[turn, 1], wide, high, self.phases, length)
            found.append((tables.cells[turn], x, y))
        best = [float(x.max()) + float(y.max()) for _, x, y in found]
        turn = int(np.argmax(best))
        total, largest = 0.0, -np.inf
        for k, (_, x, y) in enumerate(found):
            # every pair of phases is a sector, so the sum of E over all pairs is a product of two sums. In single precision what
            # is below 6e-8 beside the answer's own 1 would be lost
            sums = [np.exp(axis - axis.max()).sum(dtype=np.float64) for axis in (x, y)]
            total += float(sums[0] * sums[1]) * np.exp(best[k] - best[turn])
            if k != turn:
                largest = max(largest, best[k])
        cells, x, y = found[turn]
        for axis in (x, y):  # the second best on either axis, the other one kept
            two = np.partition(axis.ravel(), -2)[-2:]
            largest = max(largest, best[turn] - float(two[1] - two[0]))
        column, p = divmod(int(x.argmax()), length)
        row, r = divmod(int(y.argmax()), length)
        # phases less column and row: u and v of the sector, u L + v (docs/codes.md)
        sector = (p - row) % length * length + (r - column) % length
        where = cells + np.array([column, row])
        return PlanePlace(
            score=best[turn],
            weight=-log(self.places),
            turn=turn,
            sector=sector,
            cells=where,
            x_bits=self.main[(where[:, 1] - row + p + self.phases[where[:, 0]]) % length],
            y_bits=self.main[(where[:, 0] - column + r + self.phases[where[:, 1]]) % length],
            others=max(total - 1.0, 0.0),
            lead=best[turn] - largest,
        )


def _along(lines: Floats, dots: int, count: int, phases: IntArray, length: int) -> Floats:
    """Evidence of all lines together for every start in the plane and every phase; shape (starts, L)."""
    out, evidence = (
        np.empty((len(phases) - count + 1, length), dtype=np.float32),
        np.zeros((count + 1, 2 * length), dtype=np.float32),
    )
    _add_along(lines, dots, count, phases, evidence, out)
    return out


@kernel()
def _add_along(lines: Floats, dots: int, count: int, phases: IntArray, evidence: Floats, out: Floats) -> None:
    fill_range(evidence, lines, (0, dots), count)
    for start in range(len(out)):
        add_lines(out[start], evidence, (0, count), phases, start, np.int64(0))
