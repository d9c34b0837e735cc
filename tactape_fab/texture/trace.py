"""Trace codes: the bits of a place are two linear functions of a power of a primitive element of GF(2^m).

With a a root of the primitive polynomial P, z(e) = a^e as a polynomial in a, and e = column + C (row + R sector):

    x(e) = coefficient of a^0 in z(e)        y(e) = x(e + G), G a constant

Every linear function of GF(2^m) is a trace Tr(d z), and the two here are Tr(d z) and Tr(a^G d z): hence the name. A window at
another place is the same window with z multiplied by a constant, so all windows of one shape form a linear code of dimension
m without its zero word: the least distance between any two, of one tape or of two, is the least weight of one. Sectors are
pieces of one plane, so that this holds for all tapes together.
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
    """A code plane in which patches of any place differ by a proven number of bits, the turn being known.

    `texture.code.Code` says what every code has.

    degree: m.
    polynomial: P without its highest term: bit t is the coefficient of x^t.
    columns_apart: C: the exponent of the place one row further on, less that of its own; at least `range`.
    y_exponent: G.
    range: Columns and rows of a sector, R.
    window: Columns and rows that a tape has at least; such a window determines its place.
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
        """Number of nonzero elements: exponents repeat after so many."""
        return (1 << self.degree) - 1

    def default_origin(self, sector: int) -> tuple[int, int]:
        """(0, 0): no two sectors share a place, and any two places differ alike."""
        return 0, 0

    def patch(self, sector: int, origin: tuple[int, int], shape: tuple[int, int]) -> SymbolArray:
        rows, columns = shape
        # one product a row is enough: the bits along a row are the same linear functions of the row's first element, wherever it
        # lies
        first = self.power(origin[0] + self.columns_apart * (origin[1] + self.range * sector))
        down = self.products(self._rows_on[:rows], np.array(first))
        x, y = (_parity(down[:, None] & along).astype(np.uint8) for along in self._line_functions[:columns].T)
        return np.asarray(x | y << 1)

    def locate(self, symbols: SymbolArray) -> WindowPlaces:
        # a word has the bits in the order of `_window_functions`: row by row, x before y
        words = windows_of(symbols, np.ones(symbols.shape, dtype=bool), self.window, turns=1).words[0][0].astype(np.int64)
        elements = _linear(words, self._solution)
        # m of the window's bits give an element, whatever they are; the rest must be its bits too, or a symbol is wrong. The word
        # of zeros gives element 0, which is no power of a
        known = (elements > 0) & (_linear(elements, self._window_functions) == words)
        # 0 has no logarithm, so that 1 stands in for what is not known
        row, column = np.divmod(self.logarithms(np.where(known, elements, 1)), self.columns_apart)
        sector, row = np.divmod(row, self.range)
        shape = (symbols.shape[0] - self.window + 1, symbols.shape[1] - self.window + 1)
        # exponents between two rows (C > R), and past the last sector, belong to no place
        known &= (column < self.range) & (sector < self.sectors)
        column, row, sector = (np.where(known, of, -1).reshape(shape) for of in (column, row, sector))
        return WindowPlaces(valid=known.reshape(shape), column=column, row=row, sector=sector)

    def functions_of(self, shape: tuple[int, int]) -> IntArray:
        """Functions of the bits of a patch by the element z of its first place; shape (rows, columns, 2), x before y.

        A bit is the parity of z and its function.
        """
        rows, columns = shape
        # a linear function is known by its values at the basis a^0 ... a^(m-1): bit t of a place's function is the place's bit
        # where the first element is a^t
        down = self._geometric(1, self.power(self.columns_apart), rows)
        places = self.products(down[:, None], self._geometric(1, 2, columns))
        elements = self.products(places[..., None], 1 << np.arange(self.degree))
        bits = np.stack([elements & 1, _parity(elements & self._y_function)], axis=2)
        return np.asarray((bits << np.arange(self.degree)).sum(axis=3))

    def place_of(self, element: int) -> tuple[int, tuple[int, int]] | None:
        """Sector and (column, row) of an element; None if it is of no sector."""
        row, column = divmod(int(self.logarithms(np.array([element]))[0]), self.columns_apart)
        sector, row = divmod(row, self.range)
        return (sector, (column, row)) if column < self.range and sector < self.sectors else None

    def products(self, a: IntArray, b: IntArray) -> IntArray:
        """Products of elements, broadcast."""
        total = np.zeros(np.broadcast_shapes(a.shape, b.shape), dtype=np.int64)
        # schoolbook product of polynomials over GF(2): a x^k for each term x^k of b, addition being XOR; where the top
        # coefficient leaves the word, P is subtracted, so that a stays below x^m
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
        """The primitive element to a power."""
        total, square, left = 1, 2, exponent % self.order
        while left:
            total = self.product(total, square) if left & 1 else total
            square, left = self.product(square, square), left >> 1
        return total

    def logarithms(self, elements: IntArray) -> IntArray:
        """Exponents e of nonzero elements a^e, by the order's prime factors (Pohlig and Hellman, 1978); shape (n,)."""
        # z^(2^k) for every k, from which any power is a product
        squares = [elements]
        for _ in range(self.degree - 1):
            squares.append(_linear(squares[-1], self._square_function))
        exponent = np.zeros(elements.shape, dtype=np.int64)
        for prime in self.primes:
            # with N the order and p a prime of it, z^(N/p) = (a^(N/p))^e lies in the subgroup of p elements, and its place there
            # is e mod p: a table of at most 683 entries in place of one of 4 million
            cofactor = self.order // prime
            raised = np.ones_like(elements)
            for bit, square in enumerate(squares):
                raised = self.products(raised, square) if cofactor >> bit & 1 else raised
            # element k is a^(k N/p); sorted, so that a search gives k
            group = self._geometric(1, self.power(cofactor), prime)
            order = group.argsort()
            residue = order[np.searchsorted(group[order], raised)]
            # the term is the residue modulo p and 0 modulo the other primes, since N/p has an inverse modulo p where p occurs in
            # N once; each stays below N p < 2^32
            exponent += residue * (cofactor * pow(cofactor, -1, prime))  # Chinese remainder theorem
        return exponent % self.order

    def _geometric(self, first: int, ratio: int, count: int) -> IntArray:
        """first, first ratio, first ratio^2 ...; shape (count,)."""
        terms = [first]
        for _ in range(count - 1):
            terms.append(self.product(terms[-1], ratio))
        return np.array(terms, dtype=np.int64)

    @cached_property
    def _y_function(self) -> int:
        """The parity of z and this is the y bit of z: bit t is the y bit of a^t."""
        # y(z) is the x bit of a^G z, and 2 is the element a itself
        of_powers = self._geometric(self.power(self.y_exponent), 2, self.degree) & 1
        return int((of_powers << np.arange(self.degree)).sum())

    @cached_property
    def primes(self) -> list[int]:
        """Prime factors of the order, each of which occurs once."""
        # 2^m - 1 is odd
        factors, left = [], self.order
        for number in range(3, self.order):
            if left % number == 0:
                factors.append(number)
                left //= number
            if left == 1:
                break
        return factors

    @cached_property
    def _square_function(self) -> IntArray:
        """Row t: the parity of z and this is bit t of z^2; squaring is linear. Shape (m,)."""
        # (sum of z_t a^t)^2 = sum of z_t a^2t: the mixed terms come twice, and cancel
        columns = [self.power(2 * bit) for bit in range(self.degree)]
        return np.array([sum((column >> t & 1) << bit for bit, column in enumerate(columns)) for t in range(self.degree)])

    @cached_property
    def _rows_on(self) -> IntArray:
        """Factors from a place to those in the rows below it; shape (R,)."""
        return self._geometric(1, self.power(self.columns_apart), self.range)

    @cached_property
    def _line_functions(self) -> IntArray:
        """Functions of the bits along a row by the element of its first place; shape (R, 2)."""
        return np.asarray(self.functions_of((1, self.range))[0])

    @cached_property
    def _window_functions(self) -> IntArray:
        """Functions of the bits of a window, as in its word."""
        return self.functions_of((self.window, self.window)).ravel()

    @cached_property
    def _solution(self) -> IntArray:
        """Row t: the parity of a window's word and this is bit t of its element. Gauss-Jordan elimination; shape (m,)."""
        # each equation: a function of the element, and which of the word's bits add up to it
        rows = [(int(function), 1 << bit) for bit, function in enumerate(self._window_functions)]
        for t in range(self.degree):
            # there is one for every t, since a window determines its place (rank m)
            pivot = next(k for k in range(t, len(rows)) if rows[k][0] >> t & 1)
            rows[t], rows[pivot] = rows[pivot], rows[t]
            of, by = rows[t]
            rows = [(f ^ of, w ^ by) if k != t and f >> t & 1 else (f, w) for k, (f, w) in enumerate(rows)]
        # the equations left over, 2 n^2 - m of them, are the parity checks; `locate` encodes again instead
        return np.array([by for _, by in rows[: self.degree]])


def _linear(words: IntArray, functions: IntArray) -> IntArray:
    """Words whose bit t is the parity of the word given and ``functions[t]``; shape (n,)."""
    total = np.zeros(words.shape, dtype=np.int64)
    for bit, function in enumerate(functions.tolist()):
        total |= _parity(words & function) << bit
    return total


def _parity(words: IntArray) -> IntArray:
    """1 where a word of at most 64 bits has an odd number of ones."""
    return bit_count(words.astype(np.uint64)).astype(np.int64) & 1
