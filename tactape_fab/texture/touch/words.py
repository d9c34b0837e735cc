"""Patches of a grid of symbols as machine words, and their Hamming distances in bits.

A word has two bits per symbol, or three with eight directions: the symbol's Gray code (`Directions.gray_codes`). With four
directions a part a quarter turn off differs in one bit, one that points the opposite way in two; with eight directions a part 45
or 135 degrees off differs in one bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from tactape_fab.base.jit import inner_kernel, long_kernel
from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import TURNED, IntArray, SymbolArray
from tactape_fab.texture.windows import WORD_BITS, WordArray

TURNS = 4
_LOW = np.uint64(0x5555_5555_5555_5555)
_PAIRS = np.uint64(0x3333_3333_3333_3333)
_NIBBLES = np.uint64(0x0F0F_0F0F_0F0F_0F0F)
_BYTES = np.uint64(0x0101_0101_0101_0101)


class Shapes(NamedTuple):
    """Shapes of patches: side, number of points, their cells, and their places in the word of a turned patch.

    ``cells`` (k, most, 2) has row and column; ``place`` (k, 4, side, side) is -1 where the shape has no point; ``turned`` (4,
    symbols) maps the Gray code of a symbol to that after a turn; ``bits`` is the number of bits per symbol.
    """

    side: IntArray
    points: IntArray
    cells: IntArray
    place: IntArray
    turned: IntArray
    bits: int


class Patches(NamedTuple):
    """Words of all patches.

    ``own`` (k, 4, n) has the grid's patches by shape and turn, row-major, of which the first ``own_count`` (k,) are valid;
    ``given`` (k, m) and ``given_count`` (k,) have patches that must not change, in all turns.
    """

    own: WordArray
    own_count: IntArray
    given: WordArray
    given_count: IntArray


def shapes_of(masks: list[npt.NDArray[np.bool_]], directions: int = 4) -> Shapes:
    """Shapes from square masks with fourfold symmetry and at most 32 points, or 21 with eight directions."""
    side, count = np.array([len(m) for m in masks]), np.array([int(m.sum()) for m in masks])
    cells = np.zeros((len(masks), int(count.max()), 2), dtype=np.int64)
    place = np.full((len(masks), TURNS, int(side.max()), int(side.max())), -1, dtype=np.int64)
    for k, mask in enumerate(masks):
        cells[k, : count[k]] = np.argwhere(mask)
        number = np.where(mask, np.cumsum(mask).reshape(mask.shape) - 1, -1)
        source = np.arange(mask.size).reshape(mask.shape)
        for turn in range(TURNS):
            # each place of the turned patch takes the symbol from (r, c), so the point at (r, c) gets the number of that place
            r, c = np.divmod(np.rot90(source, turn).ravel(), len(mask))
            place[k, turn, r, c] = number.ravel()
    codes = DIRECTIONS[directions].gray_codes.astype(np.int64)
    turned = [np.arange(directions)]
    for _ in range(TURNS - 1):
        # from Gray code to symbol, turned, and back to Gray code
        turned.append(codes[TURNED[np.argsort(codes)]][turned[-1]])
    return Shapes(side, count, cells, place, np.stack(turned), DIRECTIONS[directions].bits)


def words_of(symbols: SymbolArray, shapes: Shapes) -> tuple[WordArray, IntArray]:
    """Words of all patches of a grid of Gray codes as in `Patches.own`, and their number by shape."""
    across = np.maximum(np.array(symbols.shape)[:, None] - shapes.side + 1, 0)
    count = across.prod(axis=0)
    words = np.zeros((len(count), TURNS, int(count.max())), dtype=np.uint64)
    for k, of in enumerate(words):
        high, wide = across[:, k].tolist()
        for r, c in shapes.cells[k, : shapes.points[k]].tolist():
            for turn in range(TURNS):
                shown = shapes.turned[turn][symbols[r : r + high, c : c + wide]].astype(np.uint64)
                of[turn, : count[k]] |= (shown << np.uint64(shapes.bits * shapes.place[k, turn, r, c])).ravel()
    return words, count.astype(np.int64)


@inner_kernel()
def count_ones(word: np.uint64) -> int:
    """Number of set bits of a word."""
    # as in `windows.bit_count`
    word = word - ((word >> np.uint64(1)) & _LOW)
    word = (word & _PAIRS) + ((word >> np.uint64(2)) & _PAIRS)
    word = (word + (word >> np.uint64(4))) & _NIBBLES
    return np.int64((word * _BYTES) >> np.uint64(56))  # type: ignore[return-value]


@long_kernel()
def nearest_of(own: WordArray, count: int, step: int, out: IntArray) -> None:
    """Write into `out` (2,) the least distance of two patches of a shape, in bits, and the number of pairs at that distance.

    own (4, n): Words of the patches as in `Patches`, of which the first `count` are valid.
    step: 1 compares all turns, 2 only 0 and 180 degrees. A patch is compared with its own turns as well. Without a pair the
    distance is 65.
    """
    # more than the bits of a word
    least, pairs = 65, 0
    for turn in range(0, TURNS, step):
        for patch in range(count):
            # a pair in turn 3 is the exchanged pair in turn 1, so that turns 1 and 3 over k > patch are all ordered pairs a
            # quarter turn apart; a half turn is its own inverse. A patch is compared with itself in turns 1 and 2, as 3 repeats 1
            word, first = own[0, patch], patch if turn in (1, 2) else patch + 1
            nearest = 65
            # first the minimum of a row, in a loop without a branch, which is vectorised; pairs are counted in few rows
            for k in range(first, count):
                nearest = min(nearest, count_ones(own[turn, k] ^ word))
            if nearest < least:
                least, pairs = nearest, 0
            if nearest == least:
                for k in range(first, count):
                    if count_ones(own[turn, k] ^ word) == least:
                        pairs += 1
    out[0], out[1] = least, pairs


@long_kernel()
def nearest_of_long(own: WordArray, more: WordArray, count: int, out: IntArray) -> None:
    """`nearest_of` for patches whose bits fill two words each: the second words are in `more`, of the same shape."""
    least, pairs = 2 * WORD_BITS + 1, 0
    for turn in range(TURNS):
        for patch in range(count):
            first = patch if turn in (1, 2) else patch + 1
            for k in range(first, count):
                apart = count_ones(own[turn, k] ^ own[0, patch]) + count_ones(more[turn, k] ^ more[0, patch])
                if apart < least:
                    least, pairs = apart, 0
                if apart == least:
                    pairs += 1
    out[0], out[1] = least, pairs
