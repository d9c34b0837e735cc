"""Frames and symbols by their literal values: the y-flip between texture and board, directions, bits, rounding to 1 nm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.texture.frames import (
    DIRECTIONS_XY,
    LETTERS,
    TURNED,
    board_to_picture,
    board_to_texture,
    rows_to_symbols,
    snap_mm,
    symbols_to_rows,
    texture_to_board,
    to_nm,
)

ORIGIN_MM = (6.9, 48.25)


@pytest.mark.parametrize(
    ("texture_mm", "board_mm"),
    [
        ((0.0, 0.0), (6.9, 48.25)),
        ((1.5, 0.0), (8.4, 48.25)),
        ((0.0, 1.5), (6.9, 46.75)),
        ((20.0, 12.0), (26.9, 36.25)),
        ((91.5, 46.5), (98.4, 1.75)),
        ((-6.9, 48.25), (0.0, 0.0)),
    ],
)
def test_texture_and_board(texture_mm: tuple[float, float], board_mm: tuple[float, float]) -> None:
    assert texture_to_board(texture_mm, ORIGIN_MM) == pytest.approx(board_mm, abs=1e-12)
    assert board_to_texture(board_mm, ORIGIN_MM) == pytest.approx(texture_mm, abs=1e-12)


def test_a_masked_point_is_mapped_to_none() -> None:
    points = np.ma.array([(1.0, 2.0), (3.0, 4.0)], mask=[(True, True), (False, False)])
    for mapped in (texture_to_board, board_to_texture):
        found, whole = mapped(points, (6.9, 48.25)), mapped(points.data, (6.9, 48.25))
        assert np.isnan(found[0]).all() and found[1].tolist() == whole[1].tolist()


def test_frames_map_arrays_of_any_shape() -> None:
    points = np.arange(24, dtype=np.float64).reshape(3, 4, 2)
    board = texture_to_board(points, ORIGIN_MM)
    assert board.shape == points.shape
    assert np.allclose(board[..., 0], points[..., 0] + 6.9)
    assert np.allclose(board[..., 1], 48.25 - points[..., 1])
    assert np.allclose(board_to_texture(board, ORIGIN_MM), points)


@pytest.mark.parametrize(("letter", "direction"), [("N", (0, -1)), ("S", (0, 1)), ("W", (-1, 0)), ("E", (1, 0))])
def test_directions_in_the_texture_frame(letter: str, direction: tuple[int, int]) -> None:
    assert tuple(DIRECTIONS_XY[LETTERS.index(letter)]) == direction


@pytest.mark.parametrize(("letter", "bits"), [("N", (0, 0)), ("W", (1, 0)), ("E", (0, 1)), ("S", (1, 1))])
def test_bits_of_letters(letter: str, bits: tuple[int, int]) -> None:
    value = bits[0] + 2 * bits[1]
    assert LETTERS[value] == letter
    assert rows_to_symbols([letter]).tolist() == [[value]]
    assert symbols_to_rows(np.array([[value]], dtype=np.uint8)) == [letter]


def test_north_is_up_on_the_board() -> None:
    at = texture_to_board(DIRECTIONS_XY * 0.25, ORIGIN_MM)
    assert at[LETTERS.index("N")] == pytest.approx((6.9, 48.5))
    assert at[LETTERS.index("E")] == pytest.approx((7.15, 48.25))


def test_directions_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        DIRECTIONS_XY[0, 0] = 2.0


def test_symbol_rows_round_trip() -> None:
    rows = ["NESW", "EEEE", "SNWE"]
    assert symbols_to_rows(rows_to_symbols(rows)) == rows
    assert rows_to_symbols(rows).dtype == np.uint8


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], "empty or differ in length"),
        (["NE", "N"], "empty or differ in length"),
        (["NX"], "other than N, E, S, W"),
        (["Nn"], "other than N, E, S, W"),
        (["N\u00cb"], "other than N, E, S, W"),
        (["N\ud800"], "other than N, E, S, W"),
    ],
)
def test_symbol_rows_refuse_other_text(rows: list[str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        rows_to_symbols(rows)


@pytest.mark.parametrize(
    ("value_mm", "value_nm"),
    [(0.0, 0), (1.0, 1_000_000), (0.1 + 0.2, 300_000), (48.25, 48_250_000), (1.0000004, 1_000_000), (1.0000006, 1_000_001)],
)
def test_to_nm_rounds_to_the_nearest_nanometre(value_mm: float, value_nm: int) -> None:
    assert int(to_nm(value_mm)) == value_nm
    assert int(to_nm(-value_mm)) == -value_nm
    assert float(snap_mm(value_mm)) == value_nm / 1_000_000


def test_snapping_twice_changes_nothing_over_ten_metres() -> None:
    values = np.random.default_rng(3).uniform(-10_000.0, 10_000.0, 1000)
    once = snap_mm(values)
    assert np.abs(once - values).max() <= 0.5e-6 + 1e-9
    assert np.array_equal(snap_mm(once), once)


def test_a_quarter_turn_counter_clockwise_takes_north_to_west() -> None:
    assert [LETTERS[value] for value in TURNED] == list("WSNEwsne")
    for array in (TURNED, DIRECTIONS_XY):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_points_of_a_picture_are_pixel_centres() -> None:
    found = board_to_picture([(1.0, 9.0), (1.05, 8.95), (3.0, 8.0)], (1.0, 9.0), 10.0)
    np.testing.assert_allclose(found, [(-0.5, -0.5), (0.0, 0.0), (19.5, 9.5)], atol=1e-9)


def test_both_frames_are_mapped_to_the_last_bit_as_by_one_formula() -> None:
    random = np.random.default_rng(3)
    for xy_mm in (random.normal(size=(500, 3, 2)), random.choice([0.0, -0.0, 6.9, -6.9, 48.25, -48.25], (500, 2))):
        for origin_mm in (ORIGIN_MM, (0.0, -0.0), (-0.0, 0.0)):
            board = xy_mm * (1.0, -1.0) + np.asarray(origin_mm)
            texture = (xy_mm - np.asarray(origin_mm)) * (1.0, -1.0)
            assert texture_to_board(xy_mm, origin_mm).tobytes() == board.tobytes()
            assert board_to_texture(xy_mm, origin_mm).tobytes() == texture.tobytes()


@pytest.mark.parametrize("convert", [board_to_texture, texture_to_board])
@pytest.mark.parametrize(
    ("points", "origin_mm"), [((4, 3), (1.0, 2.0)), ((4, 1), (1.0, 2.0)), ((4, 2), (1.0, 2.0, 3.0)), ((2,), ())]
)
def test_points_and_origin_have_two_coordinates(convert: Any, points: tuple[int, ...], origin_mm: tuple[float, ...]) -> None:
    """A height would be neither turned nor left out, but be any number."""
    with pytest.raises(SpecError):
        convert(np.zeros(points), origin_mm)
