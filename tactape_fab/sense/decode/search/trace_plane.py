"""A contact located in the plane of a trace code alone: all sectors, all places, all turns, no tape registered.

Each bit of a contact is a linear function of the element z of one of its places (`texture.trace`), so ln E for every z of the
field is one sum of +-evidence over the dots' functions: a Walsh-Hadamard transform of all of them together.
"""

from __future__ import annotations

from math import log

import numpy as np

from tactape_fab.base.jit import inner_kernel, long_kernel
from tactape_fab.sense.decode.search.evidence import Floats, tables_of
from tactape_fab.sense.decode.search.plane import CodePlane, PlanePlace
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.trace import TraceCode
from tactape_fab.texture.windows import bit_count

_BLOCK = 1 << 13
"""Entries that are transformed by themselves first: 32 KB, which the fastest cache holds."""
_NEGLIGIBLE = 30.0
"""Entries so far below the largest (ln) add less than 1e-6 to a sum over any field."""
_NO_SIGNS = np.empty(0, dtype=np.float32)


class TracePlane(CodePlane):
    """A trace code's whole plane, prepared for `search`."""

    def __init__(self, code: TraceCode, most_cells: int) -> None:
        super().__init__(code)
        self._trace = code
        self.most_cells = most_cells
        self._functions = code.functions_of((most_cells, most_cells))

    def search(self, nodes: IntArray, q: FloatArray) -> PlanePlace | None:
        tables = tables_of(nodes, q, _NO_SIGNS, self.most_cells)
        if tables.size.max() > self.most_cells:
            return None
        spectrum = np.empty(self._trace.order + 1, dtype=np.float32)
        found = np.empty((4, 4))  # of each turn: the best ln E, its element, the next best, and the sum of all E by the best
        for turn in range(4):
            column, row = tables.cells[turn].T
            mean, x, y = tables.evidence[turn].T
            spectrum[:] = 0.0
            for bit, evidence in enumerate((x, y)):
                # a bit is b = parity(f & z), and says e (2 b - 1) = -e (-1)^parity(f & z): entry f of the transform's input
                # gets -e. Several bits may have one function, so `subtract.at` and no indexed subtraction
                np.subtract.at(spectrum, self._functions[row, column, bit], evidence)
            transform(spectrum)
            spectrum[0] = -np.inf  # no place has the element 0
            summarise(spectrum, found[turn])
            # the part of ln E that does not depend on bits; the sum of all E is relative to the best, where it cancels
            found[turn, [0, 2]] += mean.sum()
        turn = int(found[:, 0].argmax())
        best, element = found[turn, 0], int(found[turn, 1])
        # elements that are in no sector are counted among the others, which only makes `others` too large; if one is the best,
        # there is no answer
        place = self._trace.place_of(element)
        if place is None:
            return None
        sector, first = place
        where = tables.cells[turn] + first
        if where.max() >= self.code.range:
            return None
        column, row = tables.cells[turn].T
        bits = bit_count(np.asarray(self._functions[row, column] & element, dtype=np.uint64)) & 1
        return PlanePlace(
            score=best,
            weight=-log(self.places),
            turn=turn,
            sector=sector,
            cells=where,
            x_bits=bits[:, 0].astype(np.int64),
            y_bits=bits[:, 1].astype(np.int64),
            others=max(float((found[:, 3] * np.exp(found[:, 0] - best)).sum()) - 1.0, 0.0),
            lead=best - max(found[turn, 2], *np.delete(found[:, 0], turn)),
        )


@long_kernel(fastmath=True)
def transform(values: Floats) -> None:
    """Walsh-Hadamard transform in place: entry z becomes the sum of entries f, less those where f & z has odd parity."""
    # levels up to the block's size stay within a block: one pass through memory does all of them
    block = min(_BLOCK, len(values))
    for start in range(0, len(values), block):
        _levels(values[start : start + block], 1)
    _levels(values, block)


@inner_kernel(fastmath=True)
def _levels(values: Floats, half: int) -> None:
    while half < len(values):
        for start in range(0, len(values), 2 * half):
            low, high = values[start : start + half], values[start + half : start + 2 * half]
            for k in range(half):
                a, b = low[k], high[k]
                low[k], high[k] = a + b, a - b
        half *= 2


@long_kernel()
def summarise(values: Floats, found: FloatArray) -> None:
    """Largest entry, its place, the next largest, and the sum of exp of all by the largest's, written in place."""
    best, at, second = -np.inf, 0, -np.inf
    for z in range(len(values)):
        if values[z] > second:
            if values[z] > best:
                second, best, at = best, values[z], z
            else:
                second = values[z]
    total = 0.0
    for z in range(len(values)):
        if values[z] > best - _NEGLIGIBLE:
            total += np.exp(values[z] - best)
    found[0], found[1], found[2], found[3] = best, at, second, total
