"""Coordinate frames and symbols: the only y-flips and the only table of symbol directions in the package.

Texture frame (mm): origin at grid point (column 0, row 0), x right, y *down*, seen from above the components.
Board frame (mm): origin at the lower-left corner of the outline, x right, y *up*, seen from the same side.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.given_value import NO_ARRAY, unmasked

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
SymbolArray = npt.NDArray[np.uint8]
BoolArray = npt.NDArray[np.bool_]

LETTERS = "NWESnwes"
"""Letter of each symbol value.

The first four are ``x_bit + 2 * y_bit``: N = (0, 0), W = (1, 0), E = (0, 1), S = (1, 1); a tape of four directions has no others.
Each of the last four is 45 degrees clockwise of the capital letter: n = NE, w = NW, e = SE, s = SW.
"""

_HALF = float(np.sqrt(0.5))
DIRECTIONS_XY: FloatArray = np.array(
    [(0.0, -1.0), (-1.0, 0.0), (1.0, 0.0), (0.0, 1.0), (_HALF, -_HALF), (-_HALF, -_HALF), (_HALF, _HALF), (-_HALF, _HALF)]
)
"""Unit displacement of each symbol value in the texture frame, shape (8, 2): N is up, so -y (paper, Eq. 10)."""
DIRECTIONS_XY.setflags(write=False)

# with y down, (x, y) becomes (y, -x); the nearest direction is the largest product, exact but for rounding
TURNED: SymbolArray = np.argmax((DIRECTIONS_XY @ np.array([(0.0, -1.0), (1.0, 0.0)])) @ DIRECTIONS_XY.T, axis=1).astype(np.uint8)
"""New value of each symbol after a turn of the texture by 90 degrees counter-clockwise, seen from above: N to W to S to E."""
TURNED.setflags(write=False)

NM_PER_MM = 1_000_000

_NO_POINTS = Problem(
    "xy_mm", "xy_mm or texture_origin_mm is no point: give points of shape (..., 2), and tape.board.texture_origin_mm"
)

_LETTER_BYTES = np.frombuffer(LETTERS.encode(), dtype=np.uint8)
# other letters become 255, which is refused together with symbols of more directions than the tape has
_VALUE_OF_BYTE = np.full(256, 255, dtype=np.uint8)
_VALUE_OF_BYTE[_LETTER_BYTES] = np.arange(len(LETTERS), dtype=np.uint8)


def texture_to_board(xy_mm: npt.ArrayLike, texture_origin_mm: tuple[float, float]) -> FloatArray:
    """Map texture points to the board frame.

    Parameters
    ----------
    xy_mm : array_like, shape (..., 2)
        Points in the texture frame, mm.
    texture_origin_mm : (float, float)
        Board coordinates of grid point (0, 0), mm.

    Returns
    -------
    ndarray, shape (..., 2)
        The same points in the board frame, mm.

    Raises
    ------
    SpecError
        If `xy_mm` is not an array of points (x, y).
    """
    try:
        xy = np.asarray(unmasked(xy_mm), dtype=np.float64)
        _refuse_no_pairs(xy, texture_origin_mm)
        board = np.empty(xy.shape)
        # axis by axis: broadcasting over a last axis of length 2 takes numpy many times as long
        np.add(xy[..., 0], texture_origin_mm[0], out=board[..., 0])
        np.subtract(texture_origin_mm[1], xy[..., 1], out=board[..., 1])
    except (*NO_ARRAY, IndexError, KeyError):
        raise SpecError(_NO_POINTS) from None
    return board


def board_to_texture(xy_mm: npt.ArrayLike, texture_origin_mm: tuple[float, float]) -> FloatArray:
    """Map board points to the texture frame, the inverse of `texture_to_board`.

    Parameters
    ----------
    xy_mm : array_like, shape (..., 2)
        Points in the board frame, mm.
    texture_origin_mm : (float, float)
        Board coordinates of grid point (0, 0), mm.

    Returns
    -------
    ndarray, shape (..., 2)
        The same points in the texture frame, mm.

    Raises
    ------
    SpecError
        If `xy_mm` is not an array of points (x, y).
    """
    try:
        xy = np.asarray(unmasked(xy_mm), dtype=np.float64)
        _refuse_no_pairs(xy, texture_origin_mm)
        texture = np.empty(xy.shape)
        for axis in (0, 1):  # as above
            np.subtract(xy[..., axis], texture_origin_mm[axis], out=texture[..., axis])
    except (*NO_ARRAY, IndexError, KeyError):
        raise SpecError(_NO_POINTS) from None
    np.negative(texture[..., 1], out=texture[..., 1])
    return texture


def _refuse_no_pairs(xy_mm: FloatArray, origin_mm: Sequence[float]) -> None:
    """Refuse points that do not have two coordinates: `np.empty` would leave a z uninitialised. Raises ValueError."""
    if xy_mm.shape[-1] != 2 or len(origin_mm) != 2:
        raise ValueError


def board_to_picture(xy_mm: npt.ArrayLike, upper_left_mm: tuple[float, float], px_per_mm: float) -> FloatArray:
    """Map board points to pixels of a picture whose upper left corner is at `upper_left_mm` on the board.

    Returns (..., 2): Pixels: u right, v down, integers at pixel centres.
    """
    # the centre of pixel 0 is half a pixel inside the picture's edge
    return board_to_texture(xy_mm, upper_left_mm) * px_per_mm - 0.5


def to_nm(value_mm: npt.ArrayLike) -> IntArray:
    """Millimetres to whole nanometres, the resolution of every file that is written (FSLAX46)."""
    return np.rint(np.asarray(value_mm, dtype=np.float64) * NM_PER_MM).astype(np.int64)


def snap_mm(value_mm: npt.ArrayLike) -> FloatArray:
    """Round millimetres to the nearest nanometre."""
    return to_nm(value_mm) / NM_PER_MM


def pair_of(values: FloatArray) -> tuple[float, float]:
    """The first two numbers of an array, as Python's own."""
    return float(values[0]), float(values[1])


def symbols_to_rows(symbols: SymbolArray) -> list[str]:
    """Symbol values, shape (rows, columns), as one string per row: N/E/S/W, with eight directions n/e/s/w as well."""
    return [row.tobytes().decode("ascii") for row in _LETTER_BYTES[symbols]]


def rows_to_symbols(rows: Sequence[str], directions: int = 4) -> SymbolArray:
    """Symbol values, shape (rows, columns), of equally long strings of N/E/S/W, with eight directions n/e/s/w as well.

    Raises ValueError if the rows differ in length or hold another letter.
    """
    known = ", ".join("NESWnesw"[:directions])
    if not rows or len({len(row) for row in rows}) != 1:
        raise ValueError("symbol rows are empty or differ in length")
    try:
        letters = np.frombuffer("".join(rows).encode("ascii"), dtype=np.uint8)
    except UnicodeEncodeError as error:
        raise ValueError(f"symbol rows hold letters other than {known}") from error
    values = _VALUE_OF_BYTE[letters].reshape(len(rows), -1)
    if (values >= directions).any():
        raise ValueError(f"symbol rows hold letters other than {known}")
    return values
