"""Codes with a plane: encoding of a patch of the code plane, and decoding of the place of each window of a patch.

A code plane of sequences, with M the main sequence (length L, order n), d(k) the difference at plane index k and
(u, v) = divmod(sector, L):

    X[r, c] = M[(r + u + sum of d(k) for k < c) mod L]        Y[r, c] = M[(c + v + sum of d(k) for k < r) mod L]

The x bit of a symbol is X, the y bit is Y.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import ClassVar, Protocol

import numpy as np

from tactape_fab.base.errors import CapacityError, Problem, SpecError
from tactape_fab.base.fields import Fields
from tactape_fab.texture.directions import USUAL_DIRECTIONS
from tactape_fab.texture.frames import BoolArray, IntArray, SymbolArray, symbols_to_rows
from tactape_fab.texture.sequences import NumberSequence

MOST_POINTS = 500_000
"""Most grid points of a tape."""


class Plane(Protocol):
    """A two-dimensional position code: a tape shows a patch of its plane.

    window: Side of a window that determines its place, in grid points.
    range: Most columns, and most rows, of a tape.
    """

    @property
    def name(self) -> str: ...
    @property
    def window(self) -> int: ...
    @property
    def sectors(self) -> int: ...
    @property
    def range(self) -> int: ...

    def patch(self, sector: int, origin: tuple[int, int], shape: tuple[int, int]) -> SymbolArray:
        """Symbols of a patch that lies in the plane; see `encode`."""

    def locate(self, symbols: SymbolArray) -> WindowPlaces:
        """Place and sector of every window of a patch of at least one; see `locate_windows`."""


class TapesOfPlane(ABC):
    """Methods of all codes with a plane: a tape's symbols are the patch at its origin, so they need no digest."""

    directions: ClassVar[tuple[int, ...]] = (USUAL_DIRECTIONS,)
    """Two bits, x and y, say four."""

    @property
    @abstractmethod
    def plane(self) -> Plane:
        """The code itself."""

    @property
    def proven_by(self) -> str:
        return f"as code '{self.plane.name}' has them"

    def symbols(
        self,
        sector: int,
        origin: tuple[int, int],
        shape: tuple[int, int],
        avoid: Sequence[SymbolArray],
        directions: int,
        *,
        half_turns: bool = False,
    ) -> SymbolArray:
        """The patch of the plane at `origin`, see `encode`; `avoid` is not used, as `origin` was chosen for that."""
        return encode(self.plane, sector, origin, shape)

    def extended(self, symbols: SymbolArray, sector: int, origin: tuple[int, int], shape: tuple[int, int]) -> SymbolArray:
        return encode(self.plane, sector, origin, shape)

    def texture_key(self, sector: int, origin: tuple[int, int], symbols: SymbolArray) -> tuple[Hashable, ...]:
        return self.plane.name, sector, origin

    def digest_entry(self, symbols: SymbolArray) -> dict[str, str]:
        return {}

    def check_symbols(self, symbols: SymbolArray, sector: int, origin: tuple[int, int], table: Fields) -> None:
        """Refuse symbols that the code does not have at a place."""
        refuse_other_symbols(self.plane, symbols, sector, origin)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneCode(TapesOfPlane):
    """A `Plane` made of number sequences along its axes. `texture.code.Code` documents the common attributes.

    main: The binary main sequence M; its order is the window's side.
    secondary: Sequences of order ``main.order - 1`` and pairwise coprime lengths whose digits make up the differences.
    least_difference: The difference where all secondary digits are 0.
    origin_stride: Step of the default origins from one sector to the next, in grid points.
    """

    name: str
    main: NumberSequence
    secondary: tuple[NumberSequence, ...]
    least_difference: int
    origin_stride: int
    most_points: ClassVar[int] = MOST_POINTS
    half_turns: ClassVar[bool] = False
    proven: ClassVar[Mapping[str, int]] = {}
    another: ClassVar[str] = "--origin best"

    @property
    def plane(self) -> Plane:
        return self

    @property
    def sequences(self) -> PlaneCode:
        return self

    @property
    def window(self) -> int:
        """Side of the smallest window that determines its place, in grid points."""
        return self.main.order

    @property
    def sectors(self) -> int:
        return self.main.length**2

    @property
    def range(self) -> int:
        """Number of columns, and of rows, of the code plane."""
        return prod(s.length for s in self.secondary)

    def default_origin(self, sector: int) -> tuple[int, int]:
        """``(stride * s, stride * (17 * s mod sectors))``.

        The origins of any two sectors are at least one stride apart on both axes, and tapes of up to 166 x 166 points never
        overlap in the plane, so that sectors are not shifts of one another.
        """
        # 17 is coprime to 256 and to 3969, so that no two sectors share a row. Sectors with near columns have rows far apart: the
        # next sector is 17 strides of rows away, and with 256 sectors rows come near again only 15 sectors on
        return self.origin_stride * sector, self.origin_stride * (17 * sector % self.sectors)

    @cached_property
    def weights(self) -> tuple[int, ...]:
        """Weight of each secondary digit in the difference: a mixed-radix number, so a difference determines all digits."""
        return tuple(prod(s.base for s in self.secondary[:i]) for i in range(len(self.secondary)))

    @property
    def greatest_difference(self) -> int:
        """The difference where all secondary digits have their largest value."""
        return self.least_difference + sum(w * (s.base - 1) for w, s in zip(self.weights, self.secondary, strict=True))

    @cached_property
    def _crt_factors(self) -> tuple[int, ...]:
        """Chinese remainder theorem: place = sum(residue * factor) mod range."""
        return tuple(self.range // s.length * pow(self.range // s.length, -1, s.length) for s in self.secondary)

    def phase_before(self, index: IntArray) -> IntArray:
        """Sum of the differences before plane index `index`, modulo L; any shape."""
        total = self.least_difference * index
        for weight, sequence in zip(self.weights, self.secondary, strict=True):
            total = total + weight * sequence.sum_before(index)
        return total % self.main.length

    def patch(self, sector: int, origin: tuple[int, int], shape: tuple[int, int]) -> SymbolArray:
        rows, columns = shape
        length = self.main.length
        u, v = divmod(sector, length)
        column = origin[0] + np.arange(columns, dtype=np.int64)
        row = origin[1] + np.arange(rows, dtype=np.int64)
        bits = self.main.digits.astype(np.uint8)
        phases = np.arange(length)
        # X depends on the column only through its phase, which has L values: a table by row and phase, from which columns are
        # taken, costs rows x L instead of rows x columns
        x_of_phase = bits[(row[:, None] + u + phases) % length]  # (rows, L)
        y_of_phase = bits[(column + v + phases[:, None]) % length]  # (L, columns)
        x = x_of_phase.take(self.phase_before(column), axis=1)
        y = y_of_phase.take(self.phase_before(row), axis=0)
        y <<= 1
        symbols: SymbolArray = x | y
        return symbols

    def locate(self, symbols: SymbolArray) -> WindowPlaces:
        length = self.main.length
        values = symbols.astype(np.int64)
        column, column_phase, column_valid = _places_along_columns(self, values & 1)
        row_t, row_phase_t, row_valid_t = _places_along_columns(self, (values >> 1).T)
        row, row_phase = row_t.T, row_phase_t.T
        # the phase of a column at a row is row + u + the differences before it; this is solved for u, and likewise for v
        u = (column_phase - self.phase_before(column) - row) % length
        v = (row_phase - self.phase_before(row) - column) % length
        valid = column_valid & row_valid_t.T
        return WindowPlaces(
            valid=valid,
            column=np.where(valid, column, -1),
            row=np.where(valid, row, -1),
            sector=np.where(valid, u * length + v, -1),
        )


def encode(code: Plane, sector: int, origin: tuple[int, int], shape: tuple[int, int]) -> SymbolArray:
    """Symbols of a patch of the code plane.

    sector: 0 ... code.sectors - 1.
    origin: Column and row of the patch's first point in the code plane.
    shape: Rows and columns of the patch. Memory does not grow with the origin.
    Returns (rows, columns): Values ``x_bit + 2 * y_bit``.
    Raises CapacityError if the patch exceeds the code's range or the sector does not exist.
    """
    rows, columns = shape
    if not 0 <= sector < code.sectors:
        raise CapacityError(Problem("sector", f"sector = {sector} is outside 0 to {code.sectors - 1} of '{code.name}'"))
    for name, first, count in (("column", origin[0], columns), ("row", origin[1], rows)):
        if first < 0 or first + count > code.range:
            raise CapacityError(
                Problem(
                    "origin",
                    f"origin {name} {first} + {count} {name}s runs past {code.range}, the range of code "
                    f"'{code.name}'; give --origin COL,ROW nearer to 0,0 or make the tape smaller",
                )
            )
    return code.patch(sector, origin, shape)


def refuse_other_symbols(code: Plane, symbols: SymbolArray, sector: int, origin: tuple[int, int]) -> None:
    """Refuse symbols that differ from the code's at a place. Raises SpecError."""
    expected = encode(code, sector, origin, (len(symbols), len(symbols[0])))
    wrong = np.argwhere(symbols != expected)
    if len(wrong) == 0:
        return
    r, c = (int(i) for i in wrong[0])
    shown, of_code = (symbols_to_rows(rows[r : r + 1, c : c + 1])[0] for rows in (symbols, expected))
    message = (
        f"symbols differ from code '{code.name}', sector {sector}, origin [{origin[0]}, {origin[1]}] at {len(wrong)} grid "
        f"points, first at column {c}, row {r}: '{shown}' where the code has '{of_code}'; make the kit again"
    )
    raise SpecError(Problem("symbols", message))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WindowPlaces:
    """Decoded place of each window of a patch, all arrays of shape (rows - n + 1, columns - n + 1).

    valid: Whether the code contains the window in this rotation.
    column, row, sector: Place of the window's first point in the code plane, and its sector; -1 where not valid.
    """

    valid: BoolArray
    column: IntArray
    row: IntArray
    sector: IntArray


def _places_along_columns(code: PlaneCode, bits: IntArray) -> tuple[IntArray, IntArray, BoolArray]:
    """Plane column of each window, the phase of its first column, and validity, from the x bits of a patch."""
    n, length = code.window, code.main.length
    windows = np.lib.stride_tricks.sliding_window_view(bits, n, axis=0)  # (rows', columns, n)
    # the word of n bits down a column occurs once in M: its place is the phase
    phase = code.main.place_of_window[windows @ code.main.digit_weights]
    phase_valid = phase >= 0
    # the differences of neighbouring columns less the least one: mixed-radix numbers, with one digit per secondary sequence
    excess = (phase[:, 1:] - phase[:, :-1] - code.least_difference) % length
    valid = np.asarray(np.lib.stride_tricks.sliding_window_view(phase_valid, n, axis=1).all(axis=-1))
    # microdots-4x4 uses 15 differences of 16, anoto-6x6 54 of 63; any other is invalid
    steps_known = excess < prod(s.base for s in code.secondary)
    valid &= np.lib.stride_tricks.sliding_window_view(steps_known, n - 1, axis=1).all(axis=-1)
    place: IntArray = np.zeros(valid.shape, dtype=np.int64)
    for weight, sequence, factor in zip(code.weights, code.secondary, code._crt_factors, strict=True):
        digit = excess // weight % sequence.base
        # n columns have n - 1 differences, which is why secondary sequences have order n - 1
        words = np.lib.stride_tricks.sliding_window_view(digit, n - 1, axis=1) @ sequence.digit_weights
        residue = sequence.place_of_window[words]
        valid &= residue >= 0
        # invalid where a residue is -1, which the mask excludes
        place += residue * factor
    return place % code.range, phase[:, : valid.shape[1]], valid


def locate_windows(code: Plane, symbols: SymbolArray) -> WindowPlaces:
    """Decode the place and sector of every n x n window of a patch, in constant time each.

    symbols (rows, columns): Symbol values in the texture's own rotation; at least n x n.
    """
    n = code.window
    if min(symbols.shape) < n:
        empty = np.zeros((max(symbols.shape[0] - n + 1, 0), max(symbols.shape[1] - n + 1, 0)), dtype=np.int64)
        return WindowPlaces(valid=empty.astype(bool), column=empty, row=empty.copy(), sector=empty.copy())
    return code.locate(symbols)
