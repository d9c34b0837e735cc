"""Explanation why measured parts decode elsewhere: shifted, mirrored, turned, or parts of another sector or code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tactape_fab.texture.code import CODE_NAMES, get_code
from tactape_fab.texture.directions import USUAL_DIRECTIONS
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray, SymbolArray, board_to_texture, pair_of
from tactape_fab.texture.plane import WindowPlaces, locate_windows
from tactape_fab.texture.tape import Tape
from tactape_fab.texture.windows import windows_of

_LEAST_AGREEMENT = 0.5
"""Fraction of the whole windows that must give the same place."""
_LEAST_ORDER = 0.5
"""Least agreement of parts with a grid: 1 for parts exactly on its points, 0 for random ones."""
_LEAST_OF_OWN = 2.0 / 3.0
"""The same as a fraction of the agreement of the tape's own parts, (1 + cos(2 pi Δ/W)) / 2, which is below 0.5 from W/4 on."""
_MOST_CELLS = 4_000_000
_TOLERANCE_MM = 0.001
_MIRROR = np.array([[-1.0, 0.0], [0.0, 1.0]])
_QUARTER = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""Rotation matrix of a quarter turn counter-clockwise as seen on the tape, for y down; rows of points are multiplied by its
transpose."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Named:
    """The place in a code that most windows give, their fraction, and the offset from the manifest's grid, mm."""

    share: float
    code: str
    mirrored: bool
    quarters: int
    sector: int
    origin: tuple[int, int]
    offset_mm: tuple[float, float]


def explain(tape: Tape, xy_mm: FloatArray) -> str | None:
    """Describe how measured parts differ from a tape's.

    tape: The manifest's tape.
    xy_mm (n, 2): Measured centres, board frame.
    Returns: None if they are at the tape's places.
    """
    if len(xy_mm) == 0:
        return "it has no parts"
    texture_mm = board_to_texture(xy_mm, tape.board.texture_origin_mm)
    if _in_place(tape, texture_mm):
        return None
    own_mm = board_to_texture(tape.part_xy_mm(), tape.board.texture_origin_mm)
    if _order(texture_mm, tape.pitch_mm) < min(_LEAST_ORDER, _LEAST_OF_OWN * _order(own_mm, tape.pitch_mm)):
        return f"its parts stand on no grid of pitch {tape.pitch_mm:g} mm"
    named = _best(tape, texture_mm)
    if named is None:
        return f"its parts name no one place of '{tape.code}' or another code"
    return _in_words(tape, named)


def _in_place(tape: Tape, texture_mm: FloatArray) -> bool:
    """Whether every part is at a grid point of the tape, with any displacement."""
    cell = np.rint(texture_mm / tape.pitch_mm)
    if (cell < 0).any() or (cell >= (tape.columns, tape.rows)).any():
        return False
    cell = cell.astype(np.int64)  # after the check, as a file may have coordinates beyond an integer's range
    places_mm = cell * tape.pitch_mm + tape.displacement_mm * DIRECTIONS_XY[tape.symbols[cell[:, 1], cell[:, 0]]]
    return bool(np.abs(texture_mm - places_mm).max() <= _TOLERANCE_MM)


def _order(texture_mm: FloatArray, pitch_mm: float) -> float:
    """Agreement of parts with a grid of this pitch, the smaller one of both axes."""
    # mean resultant length of the phases along each axis: for exact parts, half of them displaced along it,
    # (1 + cos(2 pi Delta / W)) / 2, which is 0.75 at Delta = W / 6
    return float(np.abs(np.exp(2j * np.pi * texture_mm / pitch_mm).mean(axis=0)).min())


def _best(tape: Tape, texture_mm: FloatArray) -> _Named | None:
    found = [
        _named(tape, texture_mm, code, mirrored, quarters)
        for code in (tape.code, *(name for name in CODE_NAMES if name != tape.code))
        for mirrored in (False, True)
        for quarters in range(4)
    ]
    best = max((named for named in found if named is not None), key=lambda named: named.share, default=None)
    return best if best is not None and best.share >= _LEAST_AGREEMENT else None


def _named(tape: Tape, texture_mm: FloatArray, name: str, mirrored: bool, quarters: int) -> _Named | None:
    """The place that the windows give after a reflection and quarter turns of the tape are undone."""
    # a rotation of the whole tape also rotates the symbols, so it is undone before these are read
    upright = texture_mm @ np.linalg.matrix_power(_QUARTER, -quarters).T
    if mirrored:
        upright = upright @ _MIRROR
    # circular mean of the places modulo the pitch; displacements cancel as far as symbols are balanced
    phase_mm = np.angle(np.exp(2j * np.pi * upright / tape.pitch_mm).mean(axis=0)) / (2 * np.pi) * tape.pitch_mm
    cell = np.rint((upright - phase_mm) / tape.pitch_mm)
    moved = upright - phase_mm - cell * tape.pitch_mm
    # cells relative to the first occupied one, whose place on the tape the windows give
    first = cell.min(axis=0)
    columns, rows = map(int, (cell.max(axis=0) - first + 1).tolist())
    if columns * rows > _MOST_CELLS:
        return None
    column, row = (cell - first).astype(np.int64).T
    # other codes have four directions
    directions = tape.directions if name == tape.code else USUAL_DIRECTIONS
    shown = np.linalg.norm(moved[:, None] - tape.displacement_mm * DIRECTIONS_XY[:directions], axis=2).argmin(axis=1)
    symbols, there = np.zeros((rows, columns), dtype=np.uint8), np.zeros((rows, columns), dtype=bool)
    symbols[row, column] = shown
    there[row, column] = True
    code = get_code(name)
    window = code.window
    if min(columns, rows) < window:
        return None
    places = _places_in_matrix(tape, symbols) if code.plane is None else locate_windows(code.plane, symbols)
    # cells without a part have symbol 0, and would be decoded as such
    whole = np.lib.stride_tricks.sliding_window_view(there, (window, window)).all(axis=(2, 3))
    r, c = np.nonzero(places.valid & whole)
    if len(r) == 0:
        return None
    # a window's place less its corner is the patch's origin, for which the most frequent one is taken
    shifts = np.stack([places.sector[r, c], places.column[r, c] - c, places.row[r, c] - r], axis=1)
    kinds, times = np.unique(shifts, axis=0, return_counts=True)
    sector, origin_column, origin_row = kinds[times.argmax()].tolist()
    plane = np.array([origin_column, origin_row]) - tape.origin
    rest_mm = np.median(moved - tape.displacement_mm * DIRECTIONS_XY[shown], axis=0)  # unbalanced symbols bias the phase
    # the window is at phase + (first + c) W, and by the manifest at (plane + c) W
    offset = phase_mm + rest_mm + (first - plane) * tape.pitch_mm
    return _Named(
        share=float(times.max() / whole.sum()),
        code=name,
        mirrored=mirrored,
        quarters=quarters,
        sector=sector,
        origin=(origin_column - int(first[0]), origin_row - int(first[1])),
        offset_mm=pair_of(offset),
    )


def _places_in_matrix(tape: Tape, symbols: SymbolArray) -> WindowPlaces:
    """Places of the windows in the tape's own matrix, for a designed code, which has no other places."""
    side = get_code(tape.code).window
    known = windows_of(tape.symbols, np.ones_like(tape.placed), side, turns=1, directions=tape.directions)
    seen = windows_of(symbols, np.ones(symbols.shape, dtype=bool), side, turns=1, directions=tape.directions)
    # a window fits in one word: 4 x 4 symbols of 3 bits are 48 of 64; sorted for a binary search
    order = known.words[0][0].argsort(kind="stable")
    words = known.words[0][0][order]
    at = np.minimum(np.searchsorted(words, seen.words[0][0]), len(words) - 1)
    shape = (symbols.shape[0] - side + 1, symbols.shape[1] - side + 1)
    row, column = (known.corner_rc[order[at], axis].reshape(shape) for axis in range(2))
    valid = (words[at] == seen.words[0][0]).reshape(shape)
    return WindowPlaces(valid=valid, column=column, row=row, sector=np.full(shape, tape.sector, dtype=np.int64))


def _in_words(tape: Tape, named: _Named) -> str | None:
    words = []
    if (named.code, named.sector) != (tape.code, tape.sector):
        of = f" of '{named.code}'" if named.code != tape.code else ""
        words.append(f"its parts are those of sector {named.sector}{of}, not {tape.sector}")
    if named.mirrored:
        words.append(
            f"it is mirrored {('left to right', 'about a diagonal', 'top to bottom', 'about a diagonal')[named.quarters]}"
        )
    elif named.quarters:
        words.append(f"it is turned by {(0, 90, 180, -90)[named.quarters]} deg")
    if words:
        return "; ".join(words)
    # board y points up, texture y down
    x, y = round(named.offset_mm[0], 4) + 0.0, round(-named.offset_mm[1], 4) + 0.0
    if max(abs(x), abs(y)) <= _TOLERANCE_MM:
        return None
    # an offset larger than the board is another place of the code, not a shift of the tape
    if max(abs(x), abs(y)) > max(tape.board.size_mm):
        origins = "{},{}, not {},{}".format(*named.origin, *tape.origin)
        return f"its parts are those of sector {named.sector} at origin {origins}"
    return f"it is shifted by ({x:+.3f}, {y:+.3f}) mm on the board{_shares(tape, x, y)}"


def _shares(tape: Tape, x_mm: float, y_mm: float) -> str:
    """The offset as text in pitches, if it is a multiple of half a pitch."""
    halves = 2 * np.array([x_mm, y_mm]) / tape.pitch_mm
    if np.abs(halves - np.rint(halves)).max() > 0.01:
        return ""
    words = [
        f"{'half a pitch' if abs(h) == 1 else '1 pitch' if abs(h) == 2 else f'{abs(h) / 2:g} pitches'} along {axis}"
        for h, axis in zip(np.rint(halves).tolist(), "xy", strict=True)
        if h
    ]
    return f", {' and '.join(words)}"
