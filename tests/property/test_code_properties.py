"""What holds of the codes at any place of the plane: every window says where it is, neighbours of a wrong symbol still do,
and nothing beyond the range is ever shown.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactape_fab import default_origin
from tactape_fab.base.errors import CapacityError
from tactape_fab.texture.code import CODE_NAMES, get_plane
from tactape_fab.texture.frames import SymbolArray
from tactape_fab.texture.plane import Plane, encode, locate_windows

CODES = st.sampled_from(CODE_NAMES).map(get_plane)
VALUES_TURNED_CCW = np.array([1, 3, 0, 2], dtype=np.uint8)
"""N -> W, W -> S, E -> N, S -> E."""


@st.composite
def places(draw: st.DrawFn, most: int = 24) -> tuple[Plane, int, tuple[int, int], tuple[int, int]]:
    """A code, one of its sectors, and a patch of at least one window anywhere in the plane, its far end included."""
    code = draw(CODES)
    shape = draw(st.integers(code.window, most)), draw(st.integers(code.window, most))
    column = draw(st.integers(0, code.range - shape[1]))
    row = draw(st.integers(0, code.range - shape[0]))
    if draw(st.booleans()):
        column = code.range - shape[1]
    return code, draw(st.integers(0, code.sectors - 1)), (column, row), shape


def assert_located(
    code: Plane, symbols: SymbolArray, sector: int, origin: tuple[int, int], where: npt.NDArray[np.bool_] | None = None
) -> None:
    found = locate_windows(code, symbols)
    rows, columns = np.indices(found.valid.shape)
    right = found.valid & (found.sector == sector) & (found.column == origin[0] + columns) & (found.row == origin[1] + rows)
    assert right[where if where is not None else ...].all()


@settings(deadline=None, derandomize=True, max_examples=300)
@given(place=places())
def test_every_window_says_its_sector_column_and_row(
    place: tuple[Plane, int, tuple[int, int], tuple[int, int]],
) -> None:
    code, sector, origin, shape = place
    symbols = encode(code, sector, origin, shape)
    assert symbols.shape == shape
    assert_located(code, symbols, sector, origin)


@settings(deadline=None, derandomize=True, max_examples=100)
@given(place=places(), data=st.data())
def test_a_patch_is_a_piece_of_any_larger_patch(
    place: tuple[Plane, int, tuple[int, int], tuple[int, int]], data: st.DataObject
) -> None:
    code, sector, (column, row), (rows, columns) = place
    whole = encode(code, sector, (column, row), (rows, columns))
    down, right = data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, columns - 1))
    piece = encode(code, sector, (column + right, row + down), (rows - down, columns - right))
    assert np.array_equal(whole[down:, right:], piece)


@settings(deadline=None, derandomize=True, max_examples=200)
@given(place=places(), data=st.data())
def test_wrong_symbols_harm_only_the_windows_that_hold_them(
    place: tuple[Plane, int, tuple[int, int], tuple[int, int]], data: st.DataObject
) -> None:
    code, sector, origin, (rows, columns) = place
    symbols = encode(code, sector, origin, (rows, columns))
    cells = data.draw(st.lists(st.tuples(st.integers(0, rows - 1), st.integers(0, columns - 1)), min_size=1, max_size=4))
    touched = np.zeros(symbols.shape, dtype=bool)
    for row, column in cells:
        symbols[row, column] = data.draw(st.integers(0, 3))
        touched[row, column] = True
    n = code.window
    clean = np.asarray(np.lib.stride_tricks.sliding_window_view(~touched, (n, n)).all(axis=(2, 3)))
    assert_located(code, symbols, sector, origin, clean)


@settings(deadline=None, derandomize=True, max_examples=150)
@given(place=places(most=12), turns=st.integers(1, 3))
def test_turned_textures_never_crash_and_never_leave_the_plane(
    place: tuple[Plane, int, tuple[int, int], tuple[int, int]], turns: int
) -> None:
    code, sector, origin, shape = place
    symbols = encode(code, sector, origin, shape)
    for _ in range(turns):
        symbols = VALUES_TURNED_CCW[np.rot90(symbols)]
    found = locate_windows(code, symbols)
    for values, most in ((found.column, code.range), (found.row, code.range), (found.sector, code.sectors)):
        assert (values[~found.valid] == -1).all()
        assert ((values[found.valid] >= 0) & (values[found.valid] < most)).all()


@settings(deadline=None, derandomize=True, max_examples=150)
@given(code=CODES, seed=st.integers(0, 2**32 - 1), rows=st.integers(0, 14), columns=st.integers(0, 14))
def test_a_window_that_reads_validly_is_what_the_code_has_there(code: Plane, seed: int, rows: int, columns: int) -> None:
    """Any symbols at all: what is called valid is, encoded again, the very window that was read."""
    symbols = np.random.default_rng(seed).integers(0, 4, size=(rows, columns)).astype(np.uint8)
    found = locate_windows(code, symbols)
    n = code.window
    assert found.valid.shape == (max(rows - n + 1, 0), max(columns - n + 1, 0))
    for r, c in np.argwhere(found.valid)[:20].tolist():
        place = int(found.column[r, c]), int(found.row[r, c])
        if max(place) + n <= code.range:
            again = encode(code, int(found.sector[r, c]), place, (n, n))
            assert np.array_equal(again, symbols[r : r + n, c : c + n])


@settings(deadline=None, derandomize=True, max_examples=200)
@given(
    code=CODES,
    axis=st.integers(0, 1),
    count=st.integers(1, 60),
    beyond=st.integers(1, 10**12),
    before=st.booleans(),
    sector=st.integers(0, 255),
)
def test_nothing_beyond_the_range_is_shown(code: Plane, axis: int, count: int, beyond: int, before: bool, sector: int) -> None:
    start = -beyond if before else code.range - count + beyond
    origin = (start, 0) if axis == 0 else (0, start)
    with pytest.raises(CapacityError) as caught:
        encode(code, sector, origin, (count, count))
    assert caught.value.problems[0].key == "origin"
    assert str(code.range) in str(caught.value)


@settings(deadline=None, derandomize=True, max_examples=100)
@given(code=CODES, sector=st.one_of(st.integers(max_value=-1), st.integers(min_value=3969)))
def test_no_other_sectors_exist(code: Plane, sector: int) -> None:
    with pytest.raises(CapacityError):
        encode(code, sector, (0, 0), (code.window, code.window))


@settings(deadline=None, derandomize=True, max_examples=100)
@given(code=CODES, data=st.data())
def test_tapes_at_default_origins_are_no_shifts_of_one_another(code: Plane, data: st.DataObject) -> None:
    """Two tapes of different sectors, laid over each other at any shift, agree in hardly more than chance says (1 in 4)."""
    a, b = data.draw(st.lists(st.integers(0, code.sectors - 1), min_size=2, max_size=2, unique=True))
    down, right = data.draw(st.integers(0, 30)), data.draw(st.integers(0, 30))
    one = encode(code, a, default_origin(code.name, a), (60, 60))[down:, right:]
    other = encode(code, b, default_origin(code.name, b), (60, 60))[: 60 - down, : 60 - right]
    assert float((one == other).mean()) < 0.6
