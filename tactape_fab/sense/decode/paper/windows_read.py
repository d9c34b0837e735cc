"""Symbols -> places in the code plane: windows, rotations, votes and bounds (paper, section III-A.4, Eq. 9 and 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tactape_fab.texture.frames import DIRECTIONS_XY, IntArray
from tactape_fab.texture.plane import Plane, encode, locate_windows
from tactape_fab.texture.tape import Tape

_TURNED_SYMBOL: IntArray = np.array([1, 3, 0, 2], dtype=np.int64)
"""Symbol after a quarter turn counter-clockwise: N -> W, W -> S, E -> N, S -> E."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A place decoded from windows of a frame.

    quarter_turns: theta_A in quarters of a turn, 0 ... 3.
    index: Column and row of the contact dot in the code plane.
    symbol: The contact dot's symbol in the texture frame; -1 without one.
    windows: Number of windows that decode to this place.
    """

    quarter_turns: int
    sector: int
    index: tuple[int, int]
    symbol: int
    windows: int


def quarter_turned(symbols: IntArray, turns: int) -> IntArray:
    """A patch turned counter-clockwise: places turn, and so do directions; -1 stays -1."""
    patch = np.rot90(symbols, turns)
    for _ in range(turns % 4):
        # an index of -1 reads the last symbol, which the condition then leaves out
        patch = np.where(patch >= 0, _TURNED_SYMBOL[patch], -1)
    return patch


def read_windows(code: Plane, symbols: IntArray) -> tuple[Reading, ...]:
    """Decode every window of a patch in all four rotations.

    symbols (side, side): Symbols around the contact dot, -1 where missing; a window with a missing symbol is not tried.
    Returns: One per different place, most windows first; those of equal number in the order in which they are tried: rotation by
        rotation, windows row-major in the patch as it was read.
    """
    n, middle = code.window, len(symbols) // 2
    found: dict[tuple[int, int, int, int], int] = {}
    contact: list[int] = []
    for turns in range(4):
        patch = quarter_turned(symbols, turns)
        contact.append(int(patch[middle, middle]))
        # missing symbols are read as N, the symbol 0, and windows with one are left out by `whole`
        places = locate_windows(code, np.maximum(patch, 0).astype(np.uint8))
        whole = (np.lib.stride_tricks.sliding_window_view(patch, (n, n)) >= 0).all(axis=(2, 3))
        first = np.indices(places.valid.shape)
        # from a window's first column and row to the contact dot's, which is in the middle of the patch
        column, row = places.column + middle - first[1], places.row + middle - first[0]
        # the code plane ends where its sequences start again
        valid = places.valid & whole & (column >= 0) & (row >= 0) & (column < code.range) & (row < code.range)
        as_read = [np.rot90(a, -turns).ravel().tolist() for a in (valid, places.sector, column, row)]
        for good, sector, i, j in zip(*as_read, strict=True):
            if good:
                key = (turns, sector, i, j)
                found[key] = found.get(key, 0) + 1
    readings = [
        Reading(quarter_turns=turns, sector=sector, index=(i, j), symbol=contact[turns], windows=windows)
        for (turns, sector, i, j), windows in found.items()
    ]
    return tuple(sorted(readings, key=lambda reading: -reading.windows))


def on_tape(reading: Reading, code: Plane, tapes: Sequence[Tape]) -> Tape | None:
    """The first registered tape on which a reading's place lies (same code and sector, inside its grid)."""
    for tape in tapes:
        column, row = reading.index[0] - tape.origin[0], reading.index[1] - tape.origin[1]
        same = tape.code == code.name and tape.sector == reading.sector
        if same and 0 <= column < tape.columns and 0 <= row < tape.rows:
            return tape
    return None


def majority(readings: Sequence[Reading]) -> Reading | None:
    """The reading with the most windows; None without readings and on a tie."""
    if not readings or (len(readings) > 1 and readings[1].windows == readings[0].windows):
        return None
    return readings[0]


def choose(code: Plane, readings: Sequence[Reading], tapes: Sequence[Tape]) -> tuple[Reading | None, Literal["decode", "bounds"]]:
    """Choose the rotation and the place (section III-A.4), or give the step that fails.

    The paper rotates the window "in all four directions and selects the one that yields a valid decoding", and tries four
    windows. With these codes all four rotations of an error-free window nearly always decode, so the sentence needs a reading.
    This is the kindest: among the places that lie on a registered tape, the one that most of the windows agree on, all rotations
    counted; a tie is no answer.
    """
    inside = [reading for reading in readings if on_tape(reading, code, tapes) is not None]
    return majority(inside), "decode" if inside or not readings else "bounds"


def contact_position_mm(
    reading: Reading, origin: tuple[int, int], pitch_mm: float, displacement_mm: float
) -> tuple[float, float]:
    """C, the nominal place of the contact dot from grid point (0, 0), mm (Eq. 9 and 10).

    Reading: i and j count from the tape's first column and row, `origin` in the code plane, which the paper puts at 0, 0.
    """
    factor = DIRECTIONS_XY[reading.symbol] if reading.symbol >= 0 else (0.0, 0.0)
    x, y = ((reading.index[axis] - origin[axis]) * pitch_mm + float(factor[axis]) * displacement_mm for axis in (0, 1))
    return x, y


def agreeing(code: Plane, reading: Reading, symbols: IntArray) -> int:
    """Number of symbols of a patch that agree with the code at a reading's place."""
    side = len(symbols)
    patch = quarter_turned(symbols, reading.quarter_turns)
    start = [at - side // 2 for at in reading.index]
    # a patch may reach over the plane's edge: only what is in the plane is compared
    low = [max(at, 0) for at in start]
    high = [min(at + side, code.range) for at in start]
    expected = encode(code, reading.sector, (low[0], low[1]), (high[1] - low[1], high[0] - low[0]))
    seen = patch[low[1] - start[1] : high[1] - start[1], low[0] - start[0] : high[0] - start[0]]
    return int((expected == seen).sum())
