"""Evidence of single places, dot by dot: the answer's, and those near a prior."""

from __future__ import annotations

import numpy as np
from numba import njit

from tactape_fab.decode.evidence import Tables
from tactape_fab.decode.sites import ORIGIN, SECTOR, START, Sites
from tactape_fab.texture.frames import FloatArray


@njit(cache=True, error_model="numpy")
def evidence_at(tables: Tables, sites: Sites, turn: int, site: int, x: int, y: int) -> tuple[float, int]:
    """Ln E of the dots' corner on column x, row y of a site of one sector, and how many of them lie on it."""
    length, (columns, rows) = len(sites.signs) // 3, sites.sizes[sites.size_of[site]]
    place = sites.table[site]
    total, dots = 0.0, 0
    for i in range(tables.cells.shape[1]):
        column, row = x + tables.cells[turn, i, 0], y + tables.cells[turn, i, 1]
        on = 0 <= column < columns and 0 <= row < rows
        for k in range(len(sites.holes)):
            on = on and not (sites.holes[k, 0] == site and sites.holes[k, 1] == column and sites.holes[k, 2] == row)
        if on:
            mean, x_said, y_said = tables.evidence[turn, i]
            p = sites.phases[0, place[START, 0] + column] + place[ORIGIN, 1] + row + place[SECTOR, 0]
            r = sites.phases[1, place[START, 1] + row] + place[ORIGIN, 0] + column + place[SECTOR, 1]
            total += mean + x_said * sites.signs[p % length] + y_said * sites.signs[r % length]
            dots += 1
    return total, dots


@njit(cache=True, error_model="numpy")
def places_near(
    tables: Tables, sites: Sites, turn: int, site: int, at: FloatArray, reach: float, least: int
) -> list[tuple[int, int, float]]:
    """Columns, rows and ln E of the places of a site within a reach (cells) of a point, with enough dots on it."""
    found = [(0, 0, 0.0)]  # typed for the compiler
    found.pop()
    columns, rows = sites.sizes[sites.size_of[site]]
    first, last = np.maximum(np.ceil(at - reach), 1.0 - tables.size[turn]), np.floor(at + reach)
    for row in range(int(first[1]), int(min(last[1], rows - 1.0)) + 1):
        for column in range(int(first[0]), int(min(last[0], columns - 1.0)) + 1):
            if (column - at[0]) ** 2 + (row - at[1]) ** 2 <= reach * reach:
                value, dots = evidence_at(tables, sites, turn, site, column, row)
                if dots >= least:
                    found.append((column, row, value))
    return found
