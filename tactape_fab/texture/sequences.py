"""Number sequences: de Bruijn sequences are constructed, Anoto's are data.

A sequence of order n over k digits contains every cyclic window of n digits at most once, so a window determines its place.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tactape_fab.texture.frames import IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class NumberSequence:
    """A cyclic sequence of digits whose windows of length `order` are all different.

    digits (length,): Read-only; values 0 ... base - 1.
    base: Number of different digits, k.
    order: Window length n.
    """

    digits: IntArray
    base: int
    order: int

    def __post_init__(self) -> None:
        self.digits.setflags(write=False)

    @property
    def length(self) -> int:
        return len(self.digits)

    def window_values(self) -> IntArray:
        """Value of each cyclic window as a number in base `base`, first digit most significant; shape (length,)."""
        places = np.arange(self.length)[:, None] + np.arange(self.order)
        return np.asarray(self.digits[places % self.length] @ self.digit_weights, dtype=np.int64)

    @property
    def digit_weights(self) -> IntArray:
        """Place values of a window's digits, shape (order,)."""
        return self.base ** np.arange(self.order - 1, -1, -1, dtype=np.int64)

    @cached_property
    def place_of_window(self) -> IntArray:
        """Place of each window value, -1 if it does not occur; shape (base ** order,)."""
        table = np.full(self.base**self.order, -1, dtype=np.int64)
        table[self.window_values()] = np.arange(self.length)
        table.setflags(write=False)
        return table

    @cached_property
    def _prefix_sums(self) -> IntArray:
        return np.concatenate(([0], np.cumsum(self.digits)))

    def sum_before(self, index: IntArray) -> IntArray:
        """Sum of the digits at places 0 ... index - 1 of the periodic sequence, for each index >= 0; the shape of `index`."""
        # whole periods and a remainder, as a cumulative sum would be as long as the index, which reaches 410,815,348
        turns, place = np.divmod(index, self.length)
        return np.asarray(turns * self._prefix_sums[-1] + self._prefix_sums[place], dtype=np.int64)


def de_bruijn(base: int, order: int) -> NumberSequence:
    """The lexicographically least de Bruijn sequence B(base, order).

    Built by joining, in order, the Lyndon words whose length divides `order` (Fredricksen, Kessler and Maiorana);
    the words come from Duval's successor rule.
    """
    digits: list[int] = []
    word = [-1]
    while word:
        word[-1] += 1
        # the sequence consists of the Lyndon words whose length divides n
        if order % len(word) == 0:
            digits += word
        # Duval's successor: the word repeated to n digits, its last digits k - 1 dropped, and the last of the rest raised by one
        period = len(word)
        while len(word) < order:
            word.append(word[-period])
        while word and word[-1] == base - 1:
            word.pop()
    return NumberSequence(digits=np.array(digits, dtype=np.int64), base=base, order=order)


def _from_text(text: str, base: int, order: int) -> NumberSequence:
    return NumberSequence(digits=np.array([int(d) for d in text], dtype=np.int64), base=base, order=order)


# Main sequence and A1 ... A3: Anoto AB, US patent 7,999,798. The A4 printed there is not a quasi de Bruijn sequence;
# A4 here is as corrected by py-microdots (C. Heindl, 2023, MIT). Only the numbers were taken.
_ANOTO_MAIN = "000000100111110100100001110111001010100010110110011010111100011"
_ANOTO_A1 = (
    "0000010000201001010020001100012001020020201101011020120101202100111011110210102110012101120002102021"
    "1100212011120200112100022010220012202022101212102121102212120220222011221101222212002211212210222220"
    "212221112112012212201211112220021122"
)
_ANOTO_A2 = (
    "0000010000201001010110001111001101002000120101210002111011102100121210102011020010212000220011202002"
    "0201200221100210112102022100222101220021221111120012212011121120121112202201122221212201222020211221"
    "022021021102222010221222112120222"
)
_ANOTO_A3 = "0000010011000111100101011011101"
_ANOTO_A4 = (
    "0000222202221022200221202211022100220002122021210212002112021110211002100020220202102020020100200001"
    "2220122101220012120121101210012000112201121011200111201111222212221122111212212121121111101110011000"
    "10220102101020010120201201011020110101001"
)


def anoto_main() -> NumberSequence:
    """Anoto's main number sequence: 63 bits of order 6."""
    return _from_text(_ANOTO_MAIN, 2, 6)


def anoto_secondary() -> tuple[NumberSequence, ...]:
    """Anoto's secondary sequences A1, A2, A3, A4: lengths 236, 233, 31, 241, order 5."""
    return (
        _from_text(_ANOTO_A1, 3, 5),
        _from_text(_ANOTO_A2, 3, 5),
        _from_text(_ANOTO_A3, 2, 5),
        _from_text(_ANOTO_A4, 3, 5),
    )
