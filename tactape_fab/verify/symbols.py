"""Checks of the symbols that part positions show: compared with the manifest, and decoded window by window."""

from __future__ import annotations

import numpy as np

from tactape_fab.base.errors import Check
from tactape_fab.texture.code import get_code
from tactape_fab.texture.frames import LETTERS, BoolArray, FloatArray, SymbolArray, board_to_texture
from tactape_fab.texture.plane import locate_windows
from tactape_fab.texture.tape import Tape
from tactape_fab.texture.windows import windows_of


def symbols_of_positions(tape: Tape, xy_mm: FloatArray) -> tuple[SymbolArray, BoolArray, int]:
    """Symbols that part positions show on the tape's grid.

    tape: Gives the grid: texture origin, pitch, displacement, directions, columns and rows; its symbols are not used.
    xy_mm (n, 2): Part centres in the board frame, in any order.
    Returns symbols (rows, columns).
    Returns found (rows, columns): Whether exactly one part shows a symbol.
    Returns strays: Number of parts that are not at a grid point, not at a symbol's place, or at a point already taken.
    """
    texture_mm = board_to_texture(xy_mm, tape.board.texture_origin_mm)
    cell = np.rint(texture_mm / tape.pitch_mm).astype(np.int64)
    moved = texture_mm - cell * tape.pitch_mm
    # distance from each symbol's place around the grid point; with four the nearest is that of the quadrant (paper, Sec. III-A.4)
    distance = np.linalg.norm(moved[:, None] - tape.displacement_mm * tape.points_in.xy, axis=2)
    most_mm = tape.displacement_mm * tape.points_in.reads_within
    # a part half way between two places shows no symbol
    on_grid = ((cell >= 0) & (cell < (tape.columns, tape.rows))).all(axis=1) & (distance.min(axis=1) < most_mm)
    symbols = np.zeros((tape.rows, tape.columns), dtype=np.uint8)
    count = np.zeros((tape.rows, tape.columns), dtype=np.int64)
    column, row = cell[on_grid].T
    symbols[row, column] = distance[on_grid].argmin(axis=1)
    np.add.at(count, (row, column), 1)
    # of two parts at one grid point `symbols` has that of the last; the point is not found, and one of them is a stray
    return symbols, count == 1, int((~on_grid).sum() + np.maximum(count - 1, 0).sum())


def check_symbols(tape: Tape, xy_mm: FloatArray, source: str) -> list[Check]:
    """Compare the symbols shown by part positions with the manifest's, and decode every whole window of them."""
    symbols, found, strays = symbols_of_positions(tape, xy_mm)
    placed = tape.placed
    problems: list[str] = []
    for what, wrong in (("no part", placed & ~found), ("a part that the manifest omits", found & ~placed)):
        if wrong.any():
            r, c = np.argwhere(wrong)[0]
            problems.append(f"{what} at {int(wrong.sum())} grid points, first at column {c}, row {r}")
    if strays:
        problems.append(f"{strays} parts in no symbol's place")
    differ = placed & found & (symbols != tape.symbols)
    if differ.any():
        r, c = np.argwhere(differ)[0]
        problems.append(
            f"{int(differ.sum())} symbols differ from the manifest's, first at column {c}, row {r}: "
            f"'{LETTERS[symbols[r, c]]}' instead of '{LETTERS[tape.symbols[r, c]]}'"
        )
    total = int(placed.sum())
    equal = total - int(differ.sum() + (placed & ~found).sum())
    message = "; ".join(problems) if problems else f"{equal} of {total} symbols as in the manifest"
    return [
        Check(name=f"symbols from {source}", passed=not problems, message=message, figure=float(equal)),
        _check_windows(tape, symbols, found, source),
    ]


def _check_windows(tape: Tape, symbols: SymbolArray, found: BoolArray, source: str) -> Check:
    code = get_code(tape.code).plane
    if code is None:
        return _check_matrix_windows(tape, symbols, found, source)
    places = locate_windows(code, symbols)
    whole = np.lib.stride_tricks.sliding_window_view(found, (code.window, code.window)).all(axis=(2, 3))
    rows, columns = places.valid.shape
    # every window implies the tape's origin: its place on the plane less its corner
    right = (
        places.valid
        & (places.sector == tape.sector)
        & (places.column == tape.origin[0] + np.arange(columns))
        & (places.row == (tape.origin[1] + np.arange(rows))[:, None])
    )
    wrong = np.argwhere(whole & ~right)
    count = int(whole.sum())
    name = f"windows from {source}"
    if len(wrong) or count == 0:
        r, c = wrong[0] if len(wrong) else (0, 0)
        reading = (
            f"sector {places.sector[r, c]}, plane column {places.column[r, c]}, row {places.row[r, c]}"
            if places.valid[r, c]
            else "nothing that the code contains"
        )
        message = (
            f"{len(wrong)} of {count} windows decode elsewhere, first at column {c}, row {r}: {reading}"
            if count
            else "no whole window is there"
        )
        return Check(name=name, passed=False, message=message, figure=float(count - len(wrong)))
    n = code.window
    windows = f"all {count} windows of {n}x{n} decode" if count > 1 else f"the only window of {n}x{n} decodes"
    message = f"{windows} to sector {tape.sector}, origin {tape.origin[0]},{tape.origin[1]}"
    return Check(name=name, passed=True, message=message, figure=float(count))


def _check_matrix_windows(tape: Tape, symbols: SymbolArray, found: BoolArray, source: str) -> Check:
    """Look up every whole window in the manifest's matrix, in all quarter turns, as a designed code has no decoding rule."""
    side, name = get_code(tape.code).window, f"windows from {source}"
    seen = windows_of(symbols, found, side, turns=1, directions=tape.directions)
    # all windows of the matrix, even with omitted cells, so that the index of a window follows from its corner
    known = windows_of(tape.symbols, np.ones_like(tape.placed), side, turns=4, directions=tape.directions)
    columns = tape.columns - side + 1
    # a window fits in one word: 4 x 4 symbols of 3 bits are 48 of 64
    own = known.words[0][0, seen.corner_rc[:, 0] * columns + seen.corner_rc[:, 1]]
    wrong = np.flatnonzero(seen.words[0][0] != own)
    if len(wrong) or seen.count == 0:
        r, c = seen.corner_rc[wrong[0]].tolist() if len(wrong) else (0, 0)
        message = f"{len(wrong)} of {seen.count} windows are not the matrix's, first at column {c}, row {r}"
        message = message if seen.count else "no whole window is there"
        return Check(name=name, passed=False, message=message, figure=float(seen.count - len(wrong)))
    words, count = np.unique(known.words[0], return_counts=True)
    alone = int((count[np.searchsorted(words, seen.words[0][0])] == 1).sum())
    message = f"all {seen.count} windows of {side}x{side} as designed, {alone} of them at one place and turn alone"
    return Check(name=name, passed=True, message=message, figure=float(seen.count))
