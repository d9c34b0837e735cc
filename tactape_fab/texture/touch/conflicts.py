"""Conflicts between the patches of a grid of symbols, and their repair, symbol by symbol; in integers, so equal on all machines.

A conflict is a pair of patches that differ in fewer bits than required: two patches of the grid, one of them in any of four
turns, or one of the grid and one of the given patches. Changing a symbol affects the patches that contain it; each of them is
compared with all others once, for all symbols that may replace it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tactape_fab.base.jit import inner_kernel, long_kernel
from tactape_fab.texture.frames import IntArray, SymbolArray
from tactape_fab.texture.touch.words import TURNS, Patches, Shapes, count_ones
from tactape_fab.texture.windows import WordArray

MOST_SYMBOLS = 8
_GIVEN = 4
"""In place of a conflict's turn if the other patch is a given one."""
_BLOCK = 256
_UPHILL = 4
"""A change that adds w to the total weight of conflicts is accepted with probability 2^-(4 w), to leave local minima."""

_GOLDEN, _MIX_1, _MIX_2 = (
    np.uint64(0x9E37_79B9_7F4A_7C15),
    np.uint64(0xBF58_476D_1CE4_E5B9),
    np.uint64(0x94D0_49BB_1331_11EB),
)


class Buffers(NamedTuple):
    """Buffers: conflicts (shape, patch, turn, other patch), new conflicts of a change, patches found, weights by symbol."""

    conflicts: IntArray
    coming: IntArray
    found: IntArray
    weight: IntArray


def new_buffers() -> Buffers:
    """Buffers for a search."""
    conflicts, coming = np.empty((1 << 18, 4), dtype=np.int64), np.empty((1 << 16, 5), dtype=np.int64)
    return Buffers(conflicts, coming, np.empty(1 << 16, dtype=np.int64), np.empty(MOST_SYMBOLS, dtype=np.int64))


@inner_kernel()
def next_number(state: WordArray) -> np.uint64:
    """The next 64 bits of splitmix64 (Steele, Lea and Flood 2014); advances `state` (1,)."""
    state[0] += _GOLDEN
    word = state[0]
    word = (word ^ (word >> np.uint64(30))) * _MIX_1
    word = (word ^ (word >> np.uint64(27))) * _MIX_2
    return np.uint64(word ^ (word >> np.uint64(31)))


@inner_kernel()
def _below(state: WordArray, count: int | np.int64) -> int:
    """A random integer from 0 to `count` - 1."""
    # the upper 32 bits as a fraction, times count: the bias is at most count / 2^32, and it takes exactly one random number
    return np.int64(((next_number(state) >> np.uint64(32)) * np.uint64(count)) >> np.uint64(32))  # type: ignore[return-value]


@long_kernel()
def fill(symbols: SymbolArray, directions: int, state: WordArray) -> None:
    """Fill a grid with random symbols of that many directions."""
    for r in range(symbols.shape[0]):
        for c in range(symbols.shape[1]):
            symbols[r, c] = _below(state, directions)


@inner_kernel()
def _find(
    word: np.uint64, mask: np.uint64, words: WordArray, first: int | np.int64, last: int, least: int, found: IntArray
) -> int:
    """List in `found` which words from `first` to `last` - 1 differ from `word` in fewer than `least` bits of `mask`; count."""
    count = 0
    for start in range(first, last, _BLOCK):
        end = min(start + _BLOCK, last)
        # first the minimum of a block, a loop without a branch, which is vectorised; only the few blocks with a hit are searched
        # again
        nearest = 64
        for k in range(start, end):
            nearest = min(nearest, count_ones((words[k] ^ word) & mask))
        if nearest < least:
            for k in range(start, end):
                if count_ones((words[k] ^ word) & mask) < least and count < len(found):
                    found[count] = k
                    count += 1
    return count


@long_kernel()
def conflicts_of(patches: Patches, least: IntArray, least_given: IntArray, buffers: Buffers) -> int:
    """List all conflicts in `buffers`, and return their number; -1 if they do not fit into the buffer.

    least (k, 4): Required distance in bits between two patches of the grid, by shape and turn.
    least_given (k,): Required distance in bits between a patch of the grid and a given one, by shape.
    """
    count = 0
    for shape in range(len(least)):
        for patch in range(patches.own_count[shape]):
            word = patches.own[shape, 0, patch]
            for turn in range(TURNS + 1):
                if turn == _GIVEN:
                    words, first, last = patches.given[shape], 0, patches.given_count[shape]
                else:  # a patch against itself in turn 3 is the same pair as in turn 1
                    words, last = patches.own[shape, turn], patches.own_count[shape]
                    first = patch if turn in (1, 2) else patch + 1
                bits = least_given[shape] if turn == _GIVEN else least[shape, turn]
                hits = _find(word, ~np.uint64(0), words, first, last, bits, buffers.found) if bits > 0 else 0
                # a full buffer may have left some out, so it counts as too many
                if hits == len(buffers.found) or count + hits > len(buffers.conflicts):
                    return -1
                for k in range(hits):
                    entry = buffers.conflicts[count]
                    entry[0], entry[1], entry[2], entry[3] = shape, patch, turn, buffers.found[k]
                    count += 1
    return count


@long_kernel()
def repair(
    symbols: SymbolArray,
    shapes: Shapes,
    patches: Patches,
    least: IntArray,
    least_given: IntArray,
    count: int,
    steps: int,
    state: WordArray,
    buffers: Buffers,
) -> int:
    """Change symbols in place, at most `steps` steps, until there is no conflict.

    Each step draws a conflict and one of its points, and tries the other symbol of least weight there: a conflict that lacks b
    bits weighs 4^(b - 1).

    count: Conflicts that are listed in `buffers`, by `conflicts_of` or by a call before.
    Returns: How many are listed now: 0 when there is no conflict left, -1 if they do not fit into the buffer.
    """
    for _ in range(steps):
        # the list also has conflicts that later changes repaired: removing each at once would need a search of the list
        count, chosen = _next_conflict(patches, least, least_given, count, state, buffers)
        if count == 0:
            return count
        shape, patch = buffers.conflicts[chosen, 0], buffers.conflicts[chosen, 1]
        # either patch of the pair may be changed, but given patches stay
        if buffers.conflicts[chosen, 2] != _GIVEN and _below(state, np.int64(2)) == 1:
            patch = buffers.conflicts[chosen, 3]
        cell, wide = shapes.cells[shape, _below(state, shapes.points[shape])], symbols.shape[1] - shapes.side[shape] + 1
        row, column = patch // wide + cell[0], patch % wide + cell[1]
        coming = _weigh(symbols, shapes, patches, least, least_given, row, column, buffers)
        if coming < 0 or count + coming > len(buffers.conflicts):
            return -1
        now = int(symbols[row, column])
        new = _lightest(buffers.weight[: 1 << shapes.bits], now, state)
        # weights count all conflicts of the patches that contain the point, so their difference is that of the whole grid
        steep = _UPHILL * (buffers.weight[new] - buffers.weight[now])
        # the highest k bits of a random word are all zero with probability 2^-k; less than 2^-60 counts as never
        if steep > 0 and (steep > 60 or (next_number(state) >> np.uint64(64 - steep)) != np.uint64(0)):
            continue
        _set_symbol(symbols, shapes, patches, row, column, new)
        # new conflicts of the symbols that were not chosen are dropped
        for k in range(coming):
            if buffers.coming[k, 0] == new:
                for field in range(4):
                    buffers.conflicts[count, field] = buffers.coming[k, 1 + field]
                count += 1
    return count


@inner_kernel()
def _next_conflict(
    patches: Patches, least: IntArray, least_given: IntArray, count: int, state: WordArray, buffers: Buffers
) -> tuple[int, int]:
    """Draw a conflict from the list, dropping entries that were repaired meanwhile: number of entries left, and its index."""
    while count > 0:
        chosen = _below(state, count)
        shape, patch, turn, other = buffers.conflicts[chosen]
        if turn == _GIVEN:
            bits, word = least_given[shape], patches.given[shape, other]
        else:
            bits, word = least[shape, turn], patches.own[shape, turn, other]
        if count_ones(patches.own[shape, 0, patch] ^ word) < bits:
            return count, chosen
        # the last entry replaces the dropped one: order does not matter, as entries are drawn at random
        count -= 1
        for field in range(4):
            buffers.conflicts[chosen, field] = buffers.conflicts[count, field]
    return 0, 0


@inner_kernel()
def _lightest(weight: IntArray, now: int, state: WordArray) -> int:
    """The symbol of least weight other than the present one; ties are broken at random."""
    best, alike = -1, 0
    for value in range(len(weight)):
        if value == now:
            continue
        if best < 0 or weight[value] < weight[best]:
            best, alike = value, 1
        elif weight[value] == weight[best]:
            alike += 1
            # the k-th of equal symbols replaces the kept one with probability 1 / k, so that all are equally likely
            if _below(state, alike) == 0:
                best = value
    return best


@inner_kernel()
def _weigh(
    symbols: SymbolArray,
    shapes: Shapes,
    patches: Patches,
    least: IntArray,
    least_given: IntArray,
    row: int,
    column: int,
    buffers: Buffers,
) -> int:
    """Put the weight of the conflicts that each symbol would have at a point into `buffers`; number of new ones, -1 if full."""
    now, count, ones = int(symbols[row, column]), 1 << shapes.bits, np.uint64((1 << shapes.bits) - 1)
    coming = int(np.int64(0))  # a literal would be another type to compile for
    for value in range(count):
        buffers.weight[value] = 0
    for shape in range(len(least)):
        side = shapes.side[shape]
        wide, high = symbols.shape[1] - side + 1, symbols.shape[0] - side + 1
        # the patches that contain the point have it as their point j, for each j; quarter turns never require more than turn 0
        for j in range(shapes.points[shape] if least[shape, 0] > 0 or least_given[shape] > 0 else 0):
            r, c = row - shapes.cells[shape, j, 0], column - shapes.cells[shape, j, 1]
            if r < 0 or c < 0 or r >= high or c >= wide:
                continue
            # in turn 0 a word has point j at place j; with its bits masked out one search serves all symbols, since a symbol can
            # only add to the distance
            patch, shift = r * wide + c, np.uint64(shapes.bits * j)
            word, mask = patches.own[shape, 0, patch], ~(ones << shift)
            for turn in range(TURNS + 1):
                if turn == _GIVEN:
                    words, last, bits = patches.given[shape], patches.given_count[shape], least_given[shape]
                else:
                    words, last, bits = patches.own[shape, turn], patches.own_count[shape], least[shape, turn]
                hits = _find(word, mask, words, np.int64(0), last, bits, buffers.found) if bits > 0 else 0
                if hits == len(buffers.found):
                    return -1
                for k in range(hits):
                    other = buffers.found[k]
                    # where the point lies in the other patch
                    r, c = row - other // wide, column - other % wide
                    if turn != _GIVEN and 0 <= r < side and 0 <= c < side and shapes.place[shape, 0, r, c] >= 0:
                        continue  # both contain the point: left to `_weigh_both`
                    rest = (words[other] ^ word) & mask
                    # the other word's bits at this point: XOR with a symbol gives the bits in which that would differ
                    here = (words[other] >> shift) & ones
                    for value in range(count):
                        apart = (rest, here ^ np.uint64(value), here ^ np.uint64(now))
                        coming = _add(buffers, coming, value, apart, bits, (shape, patch, turn, other))
            if least[shape, 0] > 0:
                coming = _weigh_both(
                    symbols, shapes, patches, least[shape], (row, column, now), (shape, j, patch), coming, buffers
                )
            if coming < 0:
                return -1
    return coming


@inner_kernel()
def _weigh_both(
    symbols: SymbolArray,
    shapes: Shapes,
    patches: Patches,
    least: IntArray,
    point: tuple[int, int, int],
    of: tuple[int, int, int],
    coming: int,
    buffers: Buffers,
) -> int:
    """`_weigh` for a patch and the later ones that contain the point as well: both words change with the symbol.

    ``point`` is row, column and present symbol; ``of`` is the patch's shape, the point's number in it, and the patch's number.
    """
    shape, patch, shift, no_bits = of[0], of[2], np.uint64(shapes.bits * of[1]), np.uint64(0)
    ones = np.uint64((1 << shapes.bits) - 1)
    word, mask, side = patches.own[shape, 0, patch], ~(ones << shift), shapes.side[shape]
    wide, high = symbols.shape[1] - side + 1, symbols.shape[0] - side + 1
    for i in range(shapes.points[shape]):
        down, right = shapes.cells[shape, i]
        r, c = point[0] - down, point[1] - right
        other = r * wide + c
        # the earlier of the two patches counts the pair, so that it counts once
        if r < 0 or c < 0 or r >= high or c >= wide or other < patch:
            continue
        for turn in range(TURNS):
            # as in `conflicts_of`: a patch has no conflict with itself in turn 0, and its turn 3 is the pair of turn 1
            if least[turn] == 0 or (other == patch and turn in (0, 3)):
                continue
            # the turned word has the point at another place, and its symbol turned
            there = np.uint64(shapes.bits * shapes.place[shape, turn, down, right])
            apart_now = word ^ patches.own[shape, turn, other]
            one, two = word & mask, patches.own[shape, turn, other] & ~(ones << there)
            for value in range(1 << shapes.bits):
                apart = (one | (np.uint64(value) << shift)) ^ (two | (np.uint64(shapes.turned[turn, value]) << there))
                coming = _add(buffers, coming, value, (no_bits, apart, apart_now), least[turn], (shape, patch, turn, other))
    return coming


@inner_kernel()
def _add(
    buffers: Buffers,
    coming: int,
    value: int,
    apart: tuple[np.uint64, np.uint64, np.uint64],
    least: int,
    pair: tuple[int, int, int, int],
) -> int:
    """Add a pair's weight to that of a symbol, and list it if it is not a conflict at present; number listed, -1 if full.

    ``apart`` has the bits that differ with any symbol, those that differ in addition with this symbol, and with the present one.
    """
    rest = count_ones(apart[0])
    lacking = least - rest - count_ones(apart[1])
    if lacking <= 0 or coming < 0:
        return coming
    # 4^(lacking - 1): a pair that lacks 16 bits, the most of any rung, weighs 4^15, far below 2^63
    buffers.weight[value] += np.int64(1) << (2 * (lacking - 1))
    # it is a conflict with the present symbol as well, and so already listed
    if rest + count_ones(apart[2]) < least:
        return coming
    if coming == len(buffers.coming):
        return -1
    entry = buffers.coming[coming]
    entry[0] = value
    entry[1], entry[2], entry[3], entry[4] = pair
    return coming + 1


@inner_kernel()
def _set_symbol(symbols: SymbolArray, shapes: Shapes, patches: Patches, row: int, column: int, value: int) -> None:
    """Set a symbol in the grid and in all words that contain it."""
    ones = np.uint64((1 << shapes.bits) - 1)
    symbols[row, column] = value
    for shape in range(len(shapes.side)):
        wide, high = symbols.shape[1] - shapes.side[shape] + 1, symbols.shape[0] - shapes.side[shape] + 1
        for j in range(shapes.points[shape]):
            down, right = shapes.cells[shape, j]
            r, c = row - down, column - right
            if r < 0 or c < 0 or r >= high or c >= wide:
                continue
            for turn in range(TURNS):
                shift = np.uint64(shapes.bits * shapes.place[shape, turn, down, right])
                word = patches.own[shape, turn, r * wide + c] & ~(ones << shift)
                patches.own[shape, turn, r * wide + c] = word | (np.uint64(shapes.turned[turn, value]) << shift)
