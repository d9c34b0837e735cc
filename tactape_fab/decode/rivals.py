"""Tapes of the family that nobody registered: how well all their places fit, without looking at each.

Along a column of the code plane the x bits are the main sequence from some phase, along a row the y bits are; so a contact's
evidence is a table per column and phase plus one per row and phase, and all sectors share both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from tactape_fab.texture.code import Code, default_origin
from tactape_fab.texture.frames import FloatArray, IntArray

Floats = npt.NDArray[np.float32]
MOST_SECTORS = 256
_NEGLIGIBLE = 25.0
"""Rivals are counted at their bound where that lies so far (ln) below the answer."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Family:
    """All sectors of a code at their default origins, and at the origins of registered tapes.

    Attributes
    ----------
    main : ndarray of int, shape (L,)
    phases : ndarray of int
        Sum of the differences before each plane index from 0, modulo L.
    origins : ndarray of int, shape (sectors, 2)
    registered : ndarray of bool, shape (sectors,)
        Sectors whose default tape is registered: no rivals.
    columns, rows : int
        Size of an unregistered tape.
    common : ndarray of int, shape (k, 5)
        Column, row, columns, rows and sector of registered tapes: every other sector may stand at their place too.
    """

    main: IntArray
    phases: IntArray
    origins: IntArray
    registered: npt.NDArray[np.bool_]
    columns: int
    rows: int
    common: IntArray

    @property
    def places(self) -> float:
        """Number of rival places, quarter turns included."""
        sectors = len(self.main) ** 2
        default = float((~self.registered).sum()) * self.columns * self.rows
        return 4.0 * (default + float((sectors - 1) * (self.common[:, 2] * self.common[:, 3]).sum()))


def build_family(code: Code, tapes: list[tuple[int, tuple[int, int], int, int]], pad: int) -> Family:
    """The family of some registered tapes: (sector, origin, columns, rows) each.

    Of a code with thousands of sectors only those at the registered tapes' origins are looked at: its others are spread
    over a plane too large to search, and look like chance, which p_tape bounds.
    """
    sectors = code.sectors if code.sectors <= MOST_SECTORS else 0
    origins = np.array([default_origin(code.name, s) for s in range(sectors)], dtype=np.int64).reshape(-1, 2)
    at_default = {sector for sector, origin, _, _ in tapes if sector < sectors and origin == tuple(origins[sector])}
    columns, rows = max([62, *(t[2] for t in tapes)]), max([32, *(t[3] for t in tapes)])
    common = np.array([(o[0], o[1], c, r, s) for s, o, c, r in tapes], dtype=np.int64).reshape(-1, 5)
    reach = max(int(origins.max(initial=0)), int((common[:, :2] + common[:, 2:4]).max())) + max(columns, rows) + pad
    return Family(
        main=np.array(code.main.digits, dtype=np.int64),
        phases=np.asarray(code.phase_before(np.arange(reach)), dtype=np.int64),
        origins=origins,
        registered=np.isin(np.arange(sectors), sorted(at_default)),
        columns=columns,
        rows=rows,
        common=common,
    )


@njit(cache=True, fastmath=True, error_model="numpy")
def line_tables(cells: IntArray, evidence: FloatArray, axis: int, main: IntArray) -> Floats:
    """Evidence of the dots of each column (axis 0) or row (axis 1) for every phase, written twice over; shape (lines, 2 L)."""
    length = len(main)
    lines = 0
    for i in range(len(cells)):
        lines = max(lines, cells[i, axis] + 1)
    table = np.zeros((lines, 2 * length), dtype=np.float32)
    for i in range(len(cells)):
        along = cells[i, 1 - axis]
        mean = np.float32(0.5 * evidence[i, 0])
        half = np.float32(evidence[i, 1 + axis])
        for p in range(2 * length):
            table[cells[i, axis], p] += mean + (half if main[(along + p) % length] == 1 else -half)
    return table


@njit(cache=True, fastmath=True, error_model="numpy")
def along(table: Floats, phases: IntArray, first: int, count: int, length: int) -> Floats:
    """Evidence of all lines together for every start `first` ... and phase; shape (count, L)."""
    out = np.zeros((count, length), dtype=np.float32)
    for c in range(count):
        for k in range(len(table)):
            shift = phases[first + c + k]
            source, line = table[k, shift : shift + length], out[c]
            for p in range(length):
                line[p] += source[p]
    return out


@njit(cache=True, fastmath=True, error_model="numpy")
def _most(tables: Floats) -> Floats:
    """Largest of each row."""
    out = np.empty(len(tables), dtype=np.float32)
    for c in range(len(tables)):
        line = tables[c]
        most = line[0]
        for p in range(1, len(line)):
            most = max(most, line[p])
        out[c] = most
    return out


@njit(cache=True, fastmath=True, error_model="numpy")
def rival_weight(
    cells: IntArray,
    evidence: FloatArray,
    main: IntArray,
    phases: IntArray,
    origins: IntArray,
    registered: npt.NDArray[np.bool_],
    columns: int,
    rows: int,
    common: IntArray,
    best: float,
) -> tuple[float, float, int]:
    """Sum of L / exp(best) over the family's unregistered places for one quarter turn, the largest ln L, and its sector.

    The mean evidence of a dot is shared by its two bits. Places whose bound lies far below `best` are counted at the bound.
    """
    length = len(main)
    x_table, y_table = line_tables(cells, evidence, 0, main), line_tables(cells, evidence, 1, main)
    reach = len(phases) - max(len(x_table), len(y_table))
    x_all = along(x_table, phases, 0, reach, length)
    x_most, y_limit = _most(x_all), _most(y_table).sum()
    total, largest, sector = 0.0, -np.inf, -1
    wide, high = max(columns - len(x_table) + 1, 1), max(rows - len(y_table) + 1, 1)
    for s in range(len(origins)):
        if registered[s]:
            continue
        c0, r0 = origins[s, 0], origins[s, 1]
        x_best = x_most[c0 : c0 + wide].max()
        if x_best + y_limit < best - _NEGLIGIBLE:
            total += wide * high * np.exp(x_best + y_limit - best)
            continue
        y_here = along(y_table, phases, r0, high, length)
        y_best = y_here.max()
        if x_best + y_best < best - _NEGLIGIBLE:
            total += wide * high * np.exp(x_best + y_best - best)
            continue
        u, v = s // length, s % length
        for r in range(high):
            for c in range(c0, c0 + wide):
                value = x_all[c, (r0 + r + u) % length] + y_here[r, (c + v) % length]
                if value > best - _NEGLIGIBLE:
                    total += np.exp(value - best)
                    if value > largest:
                        largest, sector = value, s
    for t in range(len(common)):
        c0, r0 = common[t, 0], common[t, 1]
        wide_t, high_t = max(common[t, 2] - len(x_table) + 1, 1), max(common[t, 3] - len(y_table) + 1, 1)
        own_u, own_v = common[t, 4] // length, common[t, 4] % length
        y_here = along(y_table, phases, r0, high_t, length)
        y_most = _most(y_here)
        bound = x_most[c0 : c0 + wide_t].max() + y_most.max()
        if bound < best - _NEGLIGIBLE:
            total += wide_t * high_t * length * length * np.exp(bound - best)
            continue
        for r in range(high_t):
            for c in range(c0, c0 + wide_t):
                if x_most[c] + y_most[r] < best - _NEGLIGIBLE:
                    total += length * length * np.exp(x_most[c] + y_most[r] - best)
                    continue
                for u in range(length):
                    x = x_all[c, (r0 + r + u) % length]
                    for v in range(length):
                        if u == own_u and v == own_v:
                            continue
                        value = x + y_here[r, (c + v) % length]
                        if value > best - _NEGLIGIBLE:
                            total += np.exp(value - best)
                            if value > largest:
                                largest, sector = value, u * length + v
    return total, largest, sector


def strongest_rival(
    families: Mapping[str, Family], turns: Sequence[tuple[IntArray, FloatArray]], dots: npt.NDArray[np.bool_], best: float
) -> tuple[float, float, str]:
    """Sum of L / exp(best) over the unregistered places of all families for some of the dots, the largest ln L, and whose.

    Parameters
    ----------
    turns : sequence of (cells, evidence)
        Of the four quarter turns.
    dots : ndarray of bool
        Dots that count.
    """
    total, largest, name = 0.0, -np.inf, ""
    for code, family in families.items():
        for cells, evidence in turns:
            share, most, sector = rival_weight(
                cells[dots] - cells[dots].min(axis=0),
                evidence[dots],
                family.main,
                family.phases,
                family.origins,
                family.registered,
                family.columns,
                family.rows,
                family.common,
                best,
            )
            total += share
            if most > largest:
                largest, name = most, f"sector {sector} of {code}"
    return total, largest, name
