"""Patches of a grid of symbols as words of bits, and how many bits they differ in.

A patch is a word of two bits per symbol, three of eight directions, and two patches differ in as many bits as their words do. A
symbol is its Gray code here (`Directions.gray_codes`): of four directions one bit is a part that points a quarter turn
elsewhere, two one that points the other way; of eight one bit is a part that points 45 degrees elsewhere, or 135.
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
    """Shapes of patches: of each its side, its number of points, where they are, and where they go in its word when turned.

    ``cells`` has shape (k, most, 2), row and column; ``place`` (k, 4, side, side), -1 where the shape has no point; ``turned``
    (4, symbols) what each symbol becomes, Gray codes both; ``bits`` are those of a symbol.
    """

    side: IntArray
    points: IntArray
    cells: IntArray
    place: IntArray
    turned: IntArray
    bits: int


class Patches(NamedTuple):
    """Words of all patches.

    ``own`` has shape (k, 4, n), row-major, by shape and turn, of which the first ``own_count`` (k,) are there; ``given`` (k, m)
    and ``given_count`` (k,) are patches that stay as they are, in all turns.
    """

    own: WordArray
    own_count: IntArray
    given: WordArray
    given_count: IntArray


def shapes_of(masks: list[npt.NDArray[np.bool_]], directions: int = 4) -> Shapes:
    """Shapes from square masks that are alike in all four turns, with 32 points at most; of eight directions, with 21."""
    side, count = np.array([len(m) for m in masks]), np.array([int(m.sum()) for m in masks])
    cells = np.zeros((len(masks), int(count.max()), 2), dtype=np.int64)
    place = np.full((len(masks), TURNS, int(side.max()), int(side.max())), -1, dtype=np.int64)
    for k, mask in enumerate(masks):
        cells[k, : count[k]] = np.argwhere(mask)
        number = np.where(mask, np.cumsum(mask).reshape(mask.shape) - 1, -1)
        source = np.arange(mask.size).reshape(mask.shape)
        for turn in range(TURNS):
            # the turned patch has at each of its places what stood at (r, c): the point at (r, c) goes to the number of that
            # place
            r, c = np.divmod(np.rot90(source, turn).ravel(), len(mask))
            place[k, turn, r, c] = number.ravel()
    codes = DIRECTIONS[directions].gray_codes.astype(np.int64)
    turned = [np.arange(directions)]
    for _ in range(TURNS - 1):
        # Gray code to symbol, turned, and back to its Gray code
        turned.append(codes[TURNED[np.argsort(codes)]][turned[-1]])
    return Shapes(side, count, cells, place, np.stack(turned), DIRECTIONS[directions].bits)


def words_of(symbols: SymbolArray, shapes: Shapes) -> tuple[WordArray, IntArray]:
    """Words of all patches of a grid of Gray codes, as `Patches.own`, and how many of each shape."""
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
    """Number of bits that are set."""
    # the sums of `windows.bit_count`, of one word
    word = word - ((word >> np.uint64(1)) & _LOW)
    word = (word & _PAIRS) + ((word >> np.uint64(2)) & _PAIRS)
    word = (word + (word >> np.uint64(4))) & _NIBBLES
    return np.int64((word * _BYTES) >> np.uint64(56))  # type: ignore[return-value]


@long_kernel()
def nearest_of(own: WordArray, count: int, step: int, out: IntArray) -> None:
    """Fewest bits that two patches of a shape differ in, and how many pairs do, into `out` (2,); `own` as in `Patches`, (4, n).

    In all turns with a `step` of 1, and 0 and 180 degrees apart with one of 2. Fewer patches than two, and one that is alone,
    have 65 bits and no pair; a patch is compared with its own turns as well.
    """
    # more than a word has bits
    least, pairs = 65, 0
    for turn in range(0, TURNS, step):
        for patch in range(count):
            # k turned by three quarters against a patch is the patch turned by one against k, so that turns 1 and 3 over the
            # pairs k > patch are all ordered pairs a quarter apart; half a turn is the same both ways. A patch is compared with
            # its own turns in 1 and 2: its third is its first again
            word, first = own[0, patch], patch if turn in (1, 2) else patch + 1
            nearest = 65
            # the least of a row first, in a loop without a branch, which vectorises; the pairs only in the few rows that reach it
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
