"""Square windows of a grid of symbols as machine words, in all four turns, and their Hamming distances in symbols."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import TURNED, BoolArray, IntArray, SymbolArray

WordArray = npt.NDArray[np.uint64]
DistanceArray = npt.NDArray[np.unsignedinteger[Any]]

WORD_BITS = 64
_LOW_BITS = {2: np.uint64(0x5555_5555_5555_5555), 3: np.uint64(0x1249_2492_4924_9249)}
"""Mask of the lowest bit of every symbol of a word, by the number of bits of a symbol."""
_PAIRS, _FOURS, _EIGHTS, _BYTES = (
    np.uint64(mask) for mask in (0x5555_5555_5555_5555, 0x3333_3333_3333_3333, 0x0F0F_0F0F_0F0F_0F0F, 0x0101_0101_0101_0101)
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Windows:
    """All whole windows of one size: those with a part at every grid point.

    side: Grid points along a side.
    corner_rc (n, 2): Row and column of each window's upper left grid point, row-major.
    words each (turns, n): Gray codes of the symbols, row-major: two bits per symbol and 32 symbols per word; with eight
        directions three bits and 21 symbols. ``[k]`` is the window, its points and its symbols, turned by k times 90 degrees
        counter-clockwise, seen from above.
    bits: Bits per symbol.
    """

    side: int
    corner_rc: IntArray
    words: tuple[WordArray, ...]
    bits: int = 2

    @property
    def count(self) -> int:
        return len(self.corner_rc)


def windows_of(symbols: SymbolArray, placed: BoolArray, side: int, *, turns: int = 3, directions: int = 4) -> Windows:
    """Cut every whole window out of a grid.

    symbols (rows, columns): Values as in `tactape_fab.texture.frames`.
    placed (rows, columns): Whether a grid point carries a part.
    turns: Number of quarter turns, including 0. Three suffice to compare windows with each other: turning both by the same angle
        changes nothing, so three quarter turns of one are a quarter turn of the other.
    directions: Number of directions of the symbols, or the larger number of those of windows that these are compared with.
    """
    high, wide = symbols.shape[0] - side + 1, symbols.shape[1] - side + 1
    bits = DIRECTIONS[directions].bits
    word_count = -(-side * side // (WORD_BITS // bits))
    if high < 1 or wide < 1:
        empty = np.zeros((turns, 0), dtype=np.uint64)
        return Windows(side=side, corner_rc=np.zeros((0, 2), dtype=np.int64), words=(empty,) * word_count, bits=bits)
    whole = np.lib.stride_tricks.sliding_window_view(placed, (side, side)).all(axis=(2, 3))
    words = np.zeros((word_count, turns, high, wide), dtype=np.uint64)
    cells = np.arange(side * side).reshape(side, side)
    turned, codes = symbols, DIRECTIONS[directions].gray_codes.astype(np.uint64)
    # a turn moves a part to another point of the window (`rot90`) and changes its symbol (`TURNED`)
    for k in range(turns):
        for target, source in enumerate(np.rot90(cells, k).ravel().tolist()):
            word, place = divmod(target, WORD_BITS // bits)
            r, c = divmod(source, side)
            words[word, k] |= codes[turned[r : r + high, c : c + wide]] << np.uint64(bits * place)
        turned = TURNED[turned]
    return Windows(side=side, corner_rc=np.argwhere(whole), words=tuple(w[:, whole] for w in words), bits=bits)


def symbol_distance(a: tuple[WordArray, ...], b: tuple[WordArray, ...], bits: int = 2) -> DistanceArray:
    """Hamming distance of windows in symbols of `bits` bits, element by element."""
    # 16 x 16 differing symbols are 256, which does not fit in a byte
    most = len(a) * (WORD_BITS // bits)
    total = np.zeros(np.broadcast(a[0], b[0]).shape, dtype=np.uint8 if most <= 255 else np.uint16)
    for word_a, word_b in zip(a, b, strict=True):
        differing = word_a ^ word_b
        # a symbol counts once, however many of its bits differ: they are ORed into its lowest bit
        differing |= differing >> np.uint64(1) if bits == 2 else (differing >> np.uint64(1)) | (differing >> np.uint64(2))
        differing &= _LOW_BITS[bits]
        total += bit_count(differing)
    return total


def bit_count(words: WordArray) -> npt.NDArray[np.uint8]:
    """Number of set bits of each word: by `bitwise_count`, which numpy has from 2.0 on, or summed in groups of 2, 4 and 8."""
    if hasattr(np, "bitwise_count"):
        return np.asarray(np.bitwise_count(words), dtype=np.uint8)
    words = np.asarray(words, dtype=np.uint64)
    # for two bits ab, (2a + b) - a is their sum; the sums are then added in groups of 4 and 8
    pairs = words - ((words >> np.uint64(1)) & _PAIRS)
    fours = (pairs & _FOURS) + ((pairs >> np.uint64(2)) & _FOURS)
    eights = (fours + (fours >> np.uint64(4))) & _EIGHTS
    # the product sums all eight bytes in the highest one; sums are at most 64, so there is no carry
    counts: npt.NDArray[np.uint8] = ((eights * _BYTES) >> np.uint64(56)).astype(np.uint8)
    return counts
