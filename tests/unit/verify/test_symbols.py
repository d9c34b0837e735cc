"""Symbols rebuilt from part positions: every part that is missing, added, moved or another is counted and named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.base.errors import Check
from tactape_fab.texture.frames import DIRECTIONS_XY, LETTERS, FloatArray
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.symbols import check_symbols, symbols_of_positions
from tests.tapes import tape_at

COLUMNS, ROWS = 9, 7
WINDOWS = (COLUMNS - 3) * (ROWS - 3)


@pytest.fixture
def tape() -> Tape:
    """A tape of 9 x 7 points of which (2, 1) has no part."""
    return replace(tape_at(3, (COLUMNS, ROWS)), omitted=np.array([(2, 1)]))


def at(tape: Tape, column: int, row: int, symbol: int | None = None, reach: float = 1.0) -> FloatArray:
    """Place in the board frame of a part at a grid point; `reach` in displacements."""
    shown = tape.symbols[row, column] if symbol is None else symbol
    x0, y0 = tape.board.texture_origin_mm
    x, y = np.array([column, row]) * tape.pitch_mm + reach * tape.displacement_mm * DIRECTIONS_XY[shown]
    return np.array([[x0 + x, y0 - y]])


def number_of(tape: Tape, column: int, row: int) -> int:
    """Index of a placed part."""
    return int(np.flatnonzero((tape.cells() == (column, row)).all(axis=1))[0])


def checked(tape: Tape, xy_mm: FloatArray) -> tuple[Check, Check]:
    shown, windows = check_symbols(tape, xy_mm, "CPL")
    assert (shown.name, windows.name) == ("symbols from CPL", "windows from CPL")
    return shown, windows


def test_parts_at_their_places_show_the_tape(tape: Tape) -> None:
    symbols, found, strays = symbols_of_positions(tape, tape.part_xy_mm())
    assert np.array_equal(found, tape.placed) and strays == 0
    assert np.array_equal(symbols[tape.placed], tape.symbols[tape.placed])
    shown, windows = checked(tape, tape.part_xy_mm())
    assert shown.passed and shown.message == "62 of 62 symbols as in the manifest" and shown.figure == 62.0
    whole = WINDOWS - 6  # those with the omitted point: 3 columns by 2 rows
    column, row = tape.origin
    assert windows.passed and windows.figure == whole
    assert windows.message == f"all {whole} windows of 4x4 decode to sector 3, origin {column},{row}"


def test_a_missing_part_is_named(tape: Tape) -> None:
    shown, windows = checked(tape, np.delete(tape.part_xy_mm(), [number_of(tape, 5, 0), number_of(tape, 4, 3)], axis=0))
    assert not shown.passed and shown.message == "no part at 2 grid points, first at column 5, row 0"
    assert shown.figure == 60.0
    assert windows.passed and (windows.figure or 0.0) < WINDOWS - 6


def test_a_part_that_is_omitted_is_named(tape: Tape) -> None:
    shown, windows = checked(tape, np.concatenate([tape.part_xy_mm(), at(tape, 2, 1)]))
    assert not shown.passed and shown.message == "a part that the manifest omits at 1 grid points, first at column 2, row 1"
    assert shown.figure == 62.0 and windows.passed and windows.figure == WINDOWS


@pytest.mark.parametrize(
    ("reach", "far"), [(0.55, False), (0.9, False), (1.45, False), (0.45, True), (1.55, True), (2.5, True)], ids=str
)
def test_a_part_shows_a_symbol_within_half_a_displacement_of_its_place(tape: Tape, reach: float, far: bool) -> None:
    xy_mm = tape.part_xy_mm()
    xy_mm[number_of(tape, 4, 3)] = at(tape, 4, 3, reach=reach)
    symbols, found, strays = symbols_of_positions(tape, xy_mm)
    assert (strays, bool(found[3, 4])) == (int(far), not far)
    assert far or symbols[3, 4] == tape.symbols[3, 4]
    shown, _ = checked(tape, xy_mm)
    assert shown.passed is not far
    if far:
        assert shown.message == "no part at 1 grid points, first at column 4, row 3; 1 parts in no symbol's place"
        assert shown.figure == 61.0


@pytest.mark.parametrize("cell", [(-1, 2), (COLUMNS, 2), (2, -1), (2, ROWS), (COLUMNS, ROWS), (-1, -1)], ids=str)
def test_a_part_beside_the_grid_is_a_stray(tape: Tape, cell: tuple[int, int]) -> None:
    _, found, strays = symbols_of_positions(tape, np.concatenate([tape.part_xy_mm(), at(tape, *cell, symbol=2)]))
    assert strays == 1 and np.array_equal(found, tape.placed)


@pytest.mark.parametrize("cell", [(0, 0), (COLUMNS - 1, 0), (0, ROWS - 1), (COLUMNS - 1, ROWS - 1)], ids=str)
def test_the_corners_of_the_grid_are_read(tape: Tape, cell: tuple[int, int]) -> None:
    symbols, found, strays = symbols_of_positions(tape, at(tape, *cell, symbol=1))
    assert strays == 0 and found.sum() == 1 and found[cell[1], cell[0]] and symbols[cell[1], cell[0]] == 1


def test_two_and_three_parts_at_a_point_show_nothing(tape: Tape) -> None:
    more = np.concatenate([tape.part_xy_mm(), at(tape, 6, 5, 0), at(tape, 6, 5, 1), at(tape, 0, 0, 2)])
    _, found, strays = symbols_of_positions(tape, more)
    assert strays == 3 and not found[5, 6] and not found[0, 0]
    shown, _ = checked(tape, more)
    assert shown.message == "no part at 2 grid points, first at column 0, row 0; 3 parts in no symbol's place"


def test_another_symbol_is_named_with_both(tape: Tape) -> None:
    xy_mm, others = tape.part_xy_mm(), [(tape.symbols[r, c] + 1) % 4 for c, r in ((7, 2), (3, 6))]
    for (column, row), other in zip(((7, 2), (3, 6)), others, strict=True):
        xy_mm[number_of(tape, column, row)] = at(tape, column, row, int(other))
    shown, windows = checked(tape, xy_mm)
    assert not shown.passed and shown.figure == 60.0
    said = f"'{LETTERS[others[0]]}' instead of '{LETTERS[tape.symbols[2, 7]]}'"
    assert shown.message == f"2 symbols differ from the manifest's, first at column 7, row 2: {said}"
    assert not windows.passed and (windows.figure or 0.0) < WINDOWS - 6
    assert "windows decode elsewhere, first at column 4, row 0: " in windows.message


@pytest.mark.parametrize(
    ("sector", "shift"), [(4, (0, 0)), (3, (1, 0)), (3, (0, 1)), (3, (0, -1))], ids=["sector", "column", "row", "row before"]
)
def test_windows_of_another_place_say_which(tape: Tape, sector: int, shift: tuple[int, int]) -> None:
    column, row = tape.origin[0] + shift[0], tape.origin[1] + shift[1]
    other = tape_at(sector, (COLUMNS, ROWS), origin=(column, row))
    shown, windows = checked(tape, other.part_xy_mm())
    assert not shown.passed and not windows.passed
    assert windows.figure == 0.0
    assert windows.message == (
        f"{WINDOWS} of {WINDOWS} windows decode elsewhere, first at column 0, row 0: "
        f"sector {sector}, plane column {column}, row {row}"
    )


def test_fewer_parts_than_a_window_are_no_proof(tape: Tape) -> None:
    shown, windows = checked(tape, tape.part_xy_mm()[:10])
    assert not shown.passed and not windows.passed and windows.figure == 0.0
    assert windows.message == "no whole window is there"


@pytest.fixture
def designed(tape: Tape) -> Tape:
    """A tape whose code is a matrix: every symbol is looked up in the manifest's own."""
    symbols = np.random.default_rng(5).integers(0, 4, (ROWS, COLUMNS)).astype(np.uint8)
    return replace(tape, code="touch-1", origin=(0, 0), symbols=symbols, omitted=np.zeros((0, 2), dtype=np.int64))


def test_windows_of_a_matrix_are_those_of_the_manifest(designed: Tape) -> None:
    shown, windows = checked(designed, designed.part_xy_mm())
    assert shown.passed and windows.passed and windows.figure == WINDOWS
    assert windows.message == f"all {WINDOWS} windows of 4x4 as designed, {WINDOWS} of them at one place and turn alone"


def test_windows_of_a_matrix_that_differ_are_named(designed: Tape) -> None:
    xy_mm, other = designed.part_xy_mm(), int(designed.symbols[5, 7] + 1) % 4
    xy_mm[number_of(designed, 7, 5)] = at(designed, 7, 5, other)
    shown, windows = checked(designed, xy_mm)
    assert not shown.passed and not windows.passed
    assert windows.figure == WINDOWS - 4  # corners at columns 4, 5 and rows 2, 3
    assert windows.message == f"4 of {WINDOWS} windows are not the matrix's, first at column 4, row 2"


def test_a_window_that_stands_twice_is_not_alone(designed: Tape) -> None:
    symbols = designed.symbols.copy()
    symbols[3:7, 5:9] = symbols[0:4, 0:4]
    twice = replace(designed, symbols=symbols)
    _, windows = checked(twice, twice.part_xy_mm())
    assert windows.passed and f", {WINDOWS - 2} of them at one place" in windows.message


def test_fewer_parts_than_a_window_of_a_matrix_are_no_proof(designed: Tape) -> None:
    _, windows = checked(designed, designed.part_xy_mm()[:10])
    assert not windows.passed and windows.figure == 0.0 and windows.message == "no whole window is there"
