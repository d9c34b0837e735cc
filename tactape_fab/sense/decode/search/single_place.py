"""Evidence of single places, dot by dot: the answer's, and those near a prior."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.rule import GOOD_TRUST
from tactape_fab.sense.decode.search.evidence import Tables
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray, SymbolArray
from tactape_fab.texture.tape import Tape

NO_PART = 8
"""Symbol of a grid point without a part."""


@lru_cache(maxsize=256)
def shown_by(tape: Tape) -> SymbolArray:
    """Symbols of a tape's parts, as `Directions.gray_codes`, `NO_PART` where there is none; shape (rows, columns).

    Those of the latest tapes are cached; for all registered tapes they would take 2 kB each.
    """
    return np.where(tape.placed, tape.points_in.gray_codes[tape.symbols], NO_PART).astype(np.uint8)


def evidence_at(tables: Tables, shown: SymbolArray, turn: int, x: int, y: int) -> tuple[float, int]:
    """Ln E of the dots' corner on column x, row y of a tape, and how many of them lie on it; `shown` from `shown_by`."""
    values, dots = _evidence(tables, shown, turn, np.array([[x, y]]))
    return float(values[0]), int(dots[0])


def places_near(
    tables: Tables, shown: SymbolArray, turn: int, at: FloatArray, reach: float, least: int
) -> tuple[IntArray, FloatArray]:
    """Columns and rows (n, 2) and ln E (n,) of the places on a tape within a reach (cells) of a point, with enough dots on it."""
    last = np.minimum(np.floor(at + reach), np.array(shown.shape[::-1]) - 1.0)
    # down to where one line of dots is on the tape; empty, not reversed, where the region lies beyond it
    first = np.minimum(np.maximum(np.ceil(at - reach), 1.0 - tables.size[turn]), last + 1.0)
    columns, rows = (np.arange(int(first[axis]), int(last[axis]) + 1) for axis in range(2))
    places = np.stack([np.tile(columns, len(rows)), np.repeat(rows, len(columns))], axis=1)
    places = places[((places - at) ** 2).sum(axis=1) <= reach * reach]
    values, dots = _evidence(tables, shown, turn, places)
    enough = dots >= least
    return places[enough], values[enough]


def _evidence(tables: Tables, shown: SymbolArray, turn: int, places: IntArray) -> tuple[FloatArray, IntArray]:
    """Ln E of the dots' corner on some columns and rows (n, 2) of a tape, and how many dots lie on it."""
    values, dots = np.empty(len(places)), np.empty(len(places), dtype=np.int64)
    _add_evidence(tables.cells[turn], tables.evidence[turn], shown, places, values, dots)
    return values, dots


@kernel()
def _add_evidence(
    cells: IntArray, evidence: FloatArray, shown: SymbolArray, places: IntArray, values: FloatArray, dots: IntArray
) -> None:
    rows, columns = shown.shape
    for n in range(len(places)):
        total, count = 0.0, 0
        for i in range(len(cells)):
            column, row = places[n, 0] + cells[i, 0], places[n, 1] + cells[i, 1]
            if 0 <= column < columns and 0 <= row < rows:  # a dot off the tape has the factor 1 in E
                symbol = int(shown[row, column])
                if symbol != NO_PART:
                    x, y = 2.0 * (symbol % 2) - 1.0, 2.0 * (symbol // 2 % 2) - 1.0
                    total += evidence[i, 0] + evidence[i, 1] * x + evidence[i, 2] * y
                    if evidence.shape[1] == 4:
                        total += evidence[i, 3] * (2.0 * (symbol // 4) - 1.0)
                    count += 1
        values[n], dots[n] = total, count


@kernel()
def parts_under(
    cells: IntArray,
    shown: SymbolArray,
    xy_px: FloatArray,
    weights: FloatArray,
    trust: FloatArray,
    pitch_mm: float,
    around_mm: FloatArray,
    centre_px: FloatArray,
    inside: BoolArray,
    kept: IntArray,
    nominal_mm: FloatArray,
    offset_px: FloatArray,
    together: FloatArray,
) -> tuple[int, int]:
    """Fill in which dots are at a part of a tape, and their cells, nominal positions, offsets from the centre, and weights.

    A dot that is not trusted weighs less. Trust does not count as a height: noise does not displace a high dot more because its
    trust is low. Returns the number of dots at a part, and of the trusted ones among them.

    ``around_mm`` are the displacements by symbol, in the order of `shown_by`.
    """
    k, good = 0, 0
    for i in range(len(cells)):
        column, row = cells[i, 0], cells[i, 1]
        inside[i] = 0 <= column < shown.shape[1] and 0 <= row < shown.shape[0] and shown[row, column] != NO_PART
        if inside[i]:
            symbol = shown[row, column]
            for axis in range(2):
                kept[k, axis] = cells[i, axis]
                nominal_mm[k, axis] = cells[i, axis] * pitch_mm + around_mm[symbol, axis]
                offset_px[k, axis] = xy_px[i, axis] - centre_px[axis]
            together[k] = weights[i] * min(trust[i] / GOOD_TRUST, 1.0)
            good += trust[i] > GOOD_TRUST
            k += 1
    return k, good
