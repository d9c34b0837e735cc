"""Evidence of single places, dot by dot: the answer's, and those near a prior."""

from __future__ import annotations

import numpy as np

from tactape_fab.decode.evidence import Floats, Tables
from tactape_fab.decode.kernels import kernel
from tactape_fab.decode.sites import ORIGIN, SECTOR, START, Sites
from tactape_fab.texture.frames import FloatArray, IntArray


def evidence_at(tables: Tables, sites: Sites, turn: int, site: int, x: int, y: int) -> tuple[float, int]:
    """Ln E of the dots' corner on column x, row y of a site of one sector, and how many of them lie on it."""
    values, dots = _evidence(tables, sites, turn, site, np.array([[x, y]]))
    return float(values[0]), int(dots[0])


def places_near(
    tables: Tables, sites: Sites, turn: int, site: int, at: FloatArray, reach: float, least: int
) -> tuple[IntArray, FloatArray]:
    """Columns and rows (n, 2) and ln E (n,) of the places of a site within a reach (cells) of a point, with enough dots on it."""
    last = np.minimum(np.floor(at + reach), sites.sizes[sites.size_of[site]] - 1.0)
    first = np.minimum(np.maximum(np.ceil(at - reach), 1.0 - tables.size[turn]), last + 1.0)
    columns, rows = (np.arange(int(first[axis]), int(last[axis]) + 1) for axis in range(2))
    places = np.stack([np.tile(columns, len(rows)), np.repeat(rows, len(columns))], axis=1)
    places = places[((places - at) ** 2).sum(axis=1) <= reach * reach]
    values, dots = _evidence(tables, sites, turn, site, places)
    enough = dots >= least
    return places[enough], values[enough]


def compile_near() -> None:
    """Compile what holds dots against single places, for no dots and no places."""
    none, two = np.empty(0, dtype=np.int64), np.zeros((3, 2), dtype=np.int64)
    cells, holes, floats = two[:0], np.empty((0, 3), dtype=np.int64), np.empty(0)
    _add_evidence(cells, np.empty((0, 3)), floats.astype(np.float32), two, two, two[0], holes, 0, cells, floats, none)


def _evidence(tables: Tables, sites: Sites, turn: int, site: int, places: IntArray) -> tuple[FloatArray, IntArray]:
    """Ln E of the dots' corner on some columns and rows (n, 2) of a site, and how many dots lie on it."""
    values, dots = np.empty(len(places)), np.empty(len(places), dtype=np.int64)
    place, size, of = sites.table[site], sites.sizes[sites.size_of[site]], tables.evidence[turn]
    _add_evidence(tables.cells[turn], of, sites.signs, sites.phases, place, size, sites.holes, site, places, values, dots)
    return values, dots


@kernel()
def _add_evidence(
    cells: IntArray,
    evidence: FloatArray,
    signs: Floats,
    phases: IntArray,
    place: IntArray,
    size: IntArray,
    holes: IntArray,
    site: int,
    places: IntArray,
    values: FloatArray,
    dots: IntArray,
) -> None:
    length = len(signs) // 3
    for n in range(len(places)):
        total, count = 0.0, 0
        for i in range(len(cells)):
            column, row = places[n, 0] + cells[i, 0], places[n, 1] + cells[i, 1]
            on = 0 <= column < size[0] and 0 <= row < size[1]
            for k in range(len(holes)):
                on = on and not (holes[k, 0] == site and holes[k, 1] == column and holes[k, 2] == row)
            if on:
                p = phases[0, place[START, 0] + column] + place[ORIGIN, 1] + row + place[SECTOR, 0]
                r = phases[1, place[START, 1] + row] + place[ORIGIN, 0] + column + place[SECTOR, 1]
                total += evidence[i, 0] + evidence[i, 1] * signs[p % length] + evidence[i, 2] * signs[r % length]
                count += 1
        values[n], dots[n] = total, count
