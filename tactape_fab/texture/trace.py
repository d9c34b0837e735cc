"""Trace codes: the two bits of a place are linear functions of a power of a primitive element of GF(2^m).

With a a root of the primitive polynomial P, z(e) = a^e as a polynomial in a, and e = column + C (row + R sector):

    x(e) = coefficient of a^0 in z(e)        y(e) = x(e + G), G a constant

Every linear function of GF(2^m) is a trace Tr(d z), and the two here are Tr(d z) and Tr(a^G d z): hence the name. A window at
another place is the same window with z multiplied by a constant, so all windows of one shape are nonzero codewords of a linear
code of dimension m: the minimum distance between any two, of one tape or of two, is the code's minimum weight. Sectors are parts
of one plane, so that this holds for all tapes together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from tactape_fab.texture.frames import IntArray, SymbolArray
from tactape_fab.texture.plane import Plane, TapesOfPlane, WindowPlaces
from tactape_fab.texture.windows import bit_count, windows_of


@dataclass(frozen=True, kw_only=True, eq=False)
class TraceCode(TapesOfPlane):
    """A code plane in which patches at any two places differ, at a known turn, in a proven number of bits.

    `texture.code.Code` documents the common attributes.

    degree: m.
    polynomial: P without its leading term: bit t is the coefficient of x^t.
    columns_apart: C: difference of the exponents of a place and the one a row below; at least `range`.
    y_exponent: G.
    range: Columns, and rows, of a sector, R.
    window: Least number of columns, and of rows, of a tape; a window of this side determines its place.
    proven: See `texture.code.Code`; counted over the whole field.
    """

    name: str
    degree: int
    polynomial: int
    columns_apart: int
    y_exponent: int
    range: int
    sectors: int
    proven: Mapping[str, int]
    window: int = 4
    another: ClassVar[str] = "another --sector"
    sequences: ClassVar[None] = None
    half_turns: ClassVar[bool] = True

    @property
    def plane(self) -> Plane:
        return self

    @property
    def most_points(self) -> int:
        return self.range**2

    @property
    def order(self) -> int:
        """Number of nonzero elements, which is the period of the exponents."""
        return (1 << self.degree) - 1

    def default_origin(self, sector: int) -> tuple[int, int]:
        """(0, 0): no two sectors share a place, and the proven distance holds for any two places."""
        return 0, 0

    def patch(self, sector: int, origin: tuple[int, int], shape: tuple[int, int]) -> SymbolArray:
        rows, columns = shape
        # one product per row is enough: the bits along a row are fixed linear functions of the row's first element
        first = self.power(origin[0] + self.columns_apart * (origin[1] + self.range * sector))
        down = self.products(self._rows_on[:rows], np.array(first))
        x, y = (_parity(down[:, None] & along).astype(np.uint8) for along in self._line_functions[:columns].T)
        return np.asarray(x | y << 1)

    def locate(self, symbols: SymbolArray) -> WindowPlaces:
        # a word has the bits in the order of `_window_functions`: row by row, x before y
        words = windows_of(symbols, np.ones(symbols.shape, dtype=bool), self.window, turns=1).words[0][0].astype(np.int64)
        elements = _linear(words, self._solution)
        # any m bits of the window give an element; if the other bits do not match it, a symbol is wrong. The zero word gives
        # element 0, which is not a power of a
        known = (elements > 0) & (_linear(elements, self._window_functions) == words)
        # 0 has no logarithm, so invalid elements are replaced by 1
        row, column = np.divmod(self.logarithms(np.where(known, elements, 1)), self.columns_apart)
        sector, row = np.divmod(row, self.range)
        shape = (symbols.shape[0] - self.window + 1, symbols.shape[1] - self.window + 1)
        # exponents between two rows (C > R) and beyond the last sector belong to no place
        known &= (column < self.range) & (sector < self.sectors)
        column, row, sector = (np.where(known, of, -1).reshape(shape) for of in (column, row, sector))
        return WindowPlaces(valid=known.reshape(shape), column=column, row=row, sector=sector)

    def functions_of(self, shape: tuple[int, int]) -> IntArray:
        """Linear functions that give the bits of a patch from the element z of its first place; shape (rows, columns, 2), x, y.

        A bit is the parity of ``z & function``.
        """
        rows, columns = shape
        # a linear function is determined by its values at the basis a^0 ... a^(m-1): bit t of a place's function is the place's
        # bit if the first element is a^t
        down = self._geometric(1, self.power(self.columns_apart), rows)
        places = self.products(down[:, None], self._geometric(1, 2, columns))
        elements = self.products(places[..., None], 1 << np.arange(self.degree))
        bits = np.stack([elements & 1, _parity(elements & self._y_function)], axis=2)
        return np.asarray((bits << np.arange(self.degree)).sum(axis=3))

    def place_of(self, element: int) -> tuple[int, tuple[int, int]] | None:
        """Sector and (column, row) of an element; None if no sector contains it."""
        row, column = divmod(int(self.logarithms(np.array([element]))[0]), self.columns_apart)
        sector, row = divmod(row, self.range)
        return (sector, (column, row)) if column < self.range and sector < self.sectors else None

    def products(self, a: IntArray, b: IntArray) -> IntArray:
        """Products of field elements, element by element with broadcasting."""
        total = np.zeros(np.broadcast_shapes(a.shape, b.shape), dtype=np.int64)
        # polynomial multiplication over GF(2): add (XOR) a x^k for each term x^k of b, reducing modulo P at each shift, so that a
        # stays below x^m
        for bit in range(self.degree):
            total ^= a * (b >> bit & 1)
            a = a << 1 ^ (a >> self.degree - 1) * (self.polynomial | 1 << self.degree)
        return total

    def product(self, a: int, b: int) -> int:
        """Product of two elements."""
        total = 0
        while b:
            total ^= a * (b & 1)
            a = a << 1 ^ (a >> self.degree - 1) * (self.polynomial | 1 << self.degree)
            b >>= 1
        return total

    def power(self, exponent: int) -> int:
        """The primitive element to the power of `exponent`."""
        total, square, left = 1, 2, exponent % self.order
        while left:
            total = self.product(total, square) if left & 1 else total
            square, left = self.product(square, square), left >> 1
        return total

    def logarithms(self, elements: IntArray) -> IntArray:
        """Exponents e of nonzero elements a^e, by the order's prime powers (Pohlig and Hellman, 1978); shape (n,)."""
        # z^(2^k) for every k, from which any power is a product
        squares = [elements]
        for _ in range(self.degree - 1):
            squares.append(_linear(squares[-1], self._square_function))
        exponent = np.zeros(elements.shape, dtype=np.int64)
        for factor in self.factors:
            # with N the order and p a factor, z^(N/p) = (a^(N/p))^e is in the subgroup of p elements, where its logarithm
            # is e mod p: of degree 22 a table of at most 683 entries instead of 4 million
            cofactor = self.order // factor
            raised = np.ones_like(elements)
            for bit, square in enumerate(squares):
                raised = self.products(raised, square) if cofactor >> bit & 1 else raised
            # element k is a^(k N/p); sorted, so that a binary search gives k
            group = self._geometric(1, self.power(cofactor), factor)
            order = group.argsort()
            residue = order[np.searchsorted(group[order], raised)]
            # the term is the residue modulo p and 0 modulo the other factors: N/p has an inverse modulo p, as they are coprime;
            # each term is below N p
            exponent += residue * (cofactor * pow(cofactor, -1, factor))  # Chinese remainder theorem
        return exponent % self.order

    def _geometric(self, first: int, ratio: int, count: int) -> IntArray:
        """Geometric series first, first ratio, first ratio^2 ... in the field; shape (count,)."""
        terms = [first]
        for _ in range(count - 1):
            terms.append(self.product(terms[-1], ratio))
        return np.array(terms, dtype=np.int64)

    @cached_property
    def _y_function(self) -> int:
        """Linear function of the y bit: the y bit of z is the parity of ``z & _y_function``; bit t is the y bit of a^t."""
        # y(z) is the x bit of a^G z, and 2 is the element a itself
        of_powers = self._geometric(self.power(self.y_exponent), 2, self.degree) & 1
        return int((of_powers << np.arange(self.degree)).sum())

    @cached_property
    def factors(self) -> list[int]:
        """Prime powers whose product is the order."""
        # 2^m - 1 is odd
        factors, left = [], self.order
        for number in range(3, self.order + 1):
            power = 1
            while left % number == 0:
                power, left = power * number, left // number
            factors += [power] * (power > 1)
            if left == 1:
                break
        return factors

    @cached_property
    def _square_function(self) -> IntArray:
        """Linear functions of squaring: bit t of z^2 is the parity of ``z & _square_function[t]``; shape (m,)."""
        # (sum of z_t a^t)^2 = sum of z_t a^2t: mixed terms occur twice, and cancel
        columns = [self.power(2 * bit) for bit in range(self.degree)]
        return np.array([sum((column >> t & 1) << bit for bit, column in enumerate(columns)) for t in range(self.degree)])

    @cached_property
    def _rows_on(self) -> IntArray:
        """Factors from the element of a place to those of the places below it, by rows down; shape (R,)."""
        return self._geometric(1, self.power(self.columns_apart), self.range)

    @cached_property
    def _line_functions(self) -> IntArray:
        """Linear functions of the bits along a row, from the element of its first place; shape (R, 2)."""
        return np.asarray(self.functions_of((1, self.range))[0])

    @cached_property
    def _window_functions(self) -> IntArray:
        """Linear functions of the bits of a window, in the order of its word."""
        return self.functions_of((self.window, self.window)).ravel()

    @cached_property
    def _solution(self) -> IntArray:
        """Masks of a window's word: bit t of its element is the parity of ``word & _solution[t]``; shape (m,)."""
        # Gauss-Jordan elimination; an equation has a function of the element, and a mask of the word's bits that sum to it
        rows = [(int(function), 1 << bit) for bit, function in enumerate(self._window_functions)]
        for t in range(self.degree):
            # there is a pivot for every t, since a window determines its place (rank m)
            pivot = next(k for k in range(t, len(rows)) if rows[k][0] >> t & 1)
            rows[t], rows[pivot] = rows[pivot], rows[t]
            of, by = rows[t]
            rows = [(f ^ of, w ^ by) if k != t and f >> t & 1 else (f, w) for k, (f, w) in enumerate(rows)]
        # the other 2 n^2 - m equations are parity checks, in place of which `locate` encodes the element again
        return np.array([by for _, by in rows[: self.degree]])


def _linear(words: IntArray, functions: IntArray) -> IntArray:
    """Apply linear functions to words: bit t of the result is the parity of ``word & functions[t]``; shape (n,)."""
    total = np.zeros(words.shape, dtype=np.int64)
    for bit, function in enumerate(functions.tolist()):
        total |= _parity(words & function) << bit
    return total


def _parity(words: IntArray) -> IntArray:
    """1 for each word of at most 64 bits that has an odd number of ones, else 0."""
    return bit_count(words.astype(np.uint64)).astype(np.int64) & 1
