"""Search for all pairs of windows within a Hamming distance, without comparing every pair.

If two windows differ in at most d symbols and their points are split into p parts, at least p - d parts agree fully. So for
each choice of p - d parts the windows are sorted by their symbols there, and only windows with equal symbols are compared
(multi-index hashing, Norouzi, Punjani and Fleet 2012). The search is exact for every p.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from math import comb

import numpy as np

from tactape_fab.texture.frames import BoolArray, IntArray
from tactape_fab.texture.windows import WORD_BITS, DistanceArray, WordArray, symbol_distance

_CHUNK = 1 << 19
"""Number of pairs compared at a time, which limits the memory."""
_SECONDS_PER_KEY, _SECONDS_PER_PAIR, _SECONDS_PER_SORT = 1e-7, 2.5e-8, 3e-4
_BITS_PER_SYMBOL = 1.7
"""Effective entropy of a symbol in bits: less than 2, as a code is not random. It affects only the speed."""
_MOST_SORTS = 300
_TABLE_BITS = 3
"""The table of hashes has eight times as many entries as there are windows."""
_MIX = (np.uint64(0x9E37_79B9_7F4A_7C15), np.uint64(0xC2B2_AE3D_27D4_EB4F), np.uint64(0x1656_67B1_9E37_79F9))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pairs:
    """Pairs of windows: the first differs in ``distance`` symbols from the second turned by ``turn`` counter-clockwise quarters.

    All arrays have equal length. Every pair is listed once: with turn 0 first < second, with turn 2 first <= second, with turn 1
    in either order (turn 3 is turn 1 with the windows exchanged). A window is paired with itself in turns 1 and 2.
    """

    first: IntArray
    second: IntArray
    turn: IntArray
    distance: DistanceArray

    def taken(self, which: IntArray | BoolArray) -> Pairs:
        """A selection of the pairs, by indices or mask."""
        return Pairs(first=self.first[which], second=self.second[which], turn=self.turn[which], distance=self.distance[which])


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """Plan of a search: points of each part, number of parts that must agree, distance up to which every pair is found."""

    parts: tuple[tuple[int, ...], ...]
    agreeing: int
    most: int


def plan_search(side: int, count: int, most: int) -> Search:
    """The search for all pairs up to a distance that is estimated to be the fastest.

    side: Side of the windows, in grid points.
    count: Number of windows.
    most: Largest distance of interest, in symbols.
    """
    cells = side * side
    # three turns of each window; an upright one is compared with those after it, n^2 / 2, and with all in two other turns, 2 n^2
    keys, pairs = 3.0 * count, 2.5 * count * count
    # without parts that have to agree every pair is compared, which is fastest for few windows
    best = Search(parts=(tuple(range(cells)),), agreeing=0, most=cells)
    least = pairs * _SECONDS_PER_PAIR + keys * _SECONDS_PER_KEY
    for parts in range(most + 1, cells + 1):
        agreeing = parts - most
        sorts = comb(parts, agreeing)
        if sorts > _MOST_SORTS:
            continue
        # expected number of pairs that agree by chance in the agreeing parts
        compared = pairs * 2.0 ** (-_BITS_PER_SYMBOL * cells * agreeing / parts)
        seconds = sorts * (_SECONDS_PER_SORT + keys * _SECONDS_PER_KEY + compared * _SECONDS_PER_PAIR)
        if seconds < least:
            least, best = seconds, Search(parts=_split_window(side, parts), agreeing=agreeing, most=most)
    return best


@cache
def _split_window(side: int, parts: int) -> tuple[tuple[int, ...], ...]:
    """Split the points of a window into parts along diagonals, as points of one row or column of a code are correlated."""
    diagonal = [r * side + (r + shift) % side for shift in range(side) for r in range(side)]
    return tuple(tuple(int(cell) for cell in part) for part in np.array_split(diagonal, parts))


def near_pairs(words: tuple[WordArray, ...], search: Search, queries: int | None = None, *, bits: int = 2) -> Iterator[Pairs]:
    """Every pair of windows at most ``search.most`` apart, in bounded portions.

    words each (turns, n): As in `Windows`, of one tape or of several concatenated: three turns, with `queries` all four.
    queries: Compare only the first `queries` windows with those after them, in every turn of these.
    bits: Bits of a symbol.
    """
    turns, count = words[0].shape
    flat = tuple(np.ascontiguousarray(w).reshape(turns * count) for w in words)
    masks = [_mask(part, len(words), bits) for part in search.parts]
    firsts = count if queries is None else queries
    for chosen in combinations(range(len(masks)), search.agreeing):
        order, ends = _runs(flat, [masks[i] for i in chosen], firsts)
        sorted_words = tuple(w[order] for w in flat)
        # only upright windows are the first of a pair: turning both by the same angle changes nothing
        starts = np.flatnonzero(order < firsts)
        others = [masks[i] for i in range(max(chosen, default=0)) if i not in chosen]
        for a, b in _within_runs(starts, ends[starts]):
            left, right = tuple(w[a] for w in sorted_words), tuple(w[b] for w in sorted_words)
            distance = symbol_distance(left, right, bits)
            near = np.flatnonzero(distance <= search.most)
            if len(near) == 0:
                continue
            # a pair that agrees in several choices of parts is reported for the first choice only
            for mask in others:
                agrees = np.ones(len(near), dtype=bool)
                for w_left, w_right, m in zip(left, right, mask, strict=True):
                    agrees &= ((w_left[near] ^ w_right[near]) & m) == 0
                near = near[~agrees]
            first = order[a[near]]
            turn, second = np.divmod(order[b[near]], count)
            # a half turn is its own inverse, so such a pair is found twice; upright pairs come in sorted order, first < second
            kept = (turn != 2) | (first <= second) if queries is None else second >= queries
            yield Pairs(first=first[kept], second=second[kept], turn=turn[kept], distance=distance[near][kept])


def _mask(cells: tuple[int, ...], words: int, bits: int) -> tuple[np.uint64, ...]:
    values = [0] * words
    for cell in cells:
        word, place = divmod(cell, WORD_BITS // bits)
        values[word] |= ((1 << bits) - 1) << (bits * place)
    return tuple(np.uint64(v) for v in values)


def _runs(words: tuple[WordArray, ...], masks: list[tuple[np.uint64, ...]], firsts: int) -> tuple[IntArray, IntArray]:
    """Order of the windows in which those equal under the masks are adjacent, and the end of each one's run.

    They are sorted by a hash with the window's number in its low bits. Windows whose hashes collide share a run as well, and are
    rejected by their distance. A table of the hashes' high bits leaves out most windows that agree with none of the first
    `firsts`, which are two thirds of those to sort.
    """
    n = len(words[0])
    # the low bits hold a window's number, so that sorting keys sorts windows of equal hash by turn, then by place
    bits = np.uint64(max(n - 1, 1).bit_length())
    low = (np.uint64(1) << bits) - np.uint64(1)
    key = np.zeros(n, dtype=np.uint64)
    for i, word in enumerate(words):
        mask = np.uint64(sum(int(m[i]) for m in masks))
        part = word & mask
        # a multiplication carries bits only upwards, so the shift first mixes the high bits into the low ones
        part ^= part >> np.uint64(29)
        part *= _MIX[i % len(_MIX)]
        key += part
    key ^= key >> np.uint64(32)
    key *= _MIX[-1]
    place = key >> (np.uint64(64 - _TABLE_BITS) - bits)
    # marks hashes of windows that can be first of a pair; a false hit (at most one in eight) costs a comparison, no pair is lost
    known = np.zeros(1 << (int(bits) + _TABLE_BITS), dtype=bool)
    known[place[:firsts]] = True
    kept = np.flatnonzero(known[place])
    # sorting plain words takes half the time of an argsort
    key = key[kept] & ~low | kept.astype(np.uint64)
    key.sort()
    order = (key & low).astype(np.int64)
    key >>= bits
    last = np.flatnonzero(key[1:] != key[:-1]) + 1
    bounds = np.append(last, len(key))
    # for each window the end of its run
    ends = np.repeat(bounds, np.diff(bounds, prepend=0))
    return order, ends


def _within_runs(starts: IntArray, ends: IntArray) -> Iterator[tuple[IntArray, IntArray]]:
    """Pairs of each start with every later window of its run, in portions."""
    lengths = ends - starts - 1
    starts, lengths = starts[lengths > 0], lengths[lengths > 0]
    total = np.cumsum(lengths)
    at = 0
    while at < len(starts):
        done = int(total[at - 1]) if at else 0
        # at least one start, even if its run alone exceeds a portion
        until = max(int(np.searchsorted(total, done + _CHUNK, side="right")), at + 1)
        some = lengths[at:until]
        before = np.cumsum(some) - some
        first = np.repeat(starts[at:until], some)
        yield first, first + 1 + (np.arange(int(some.sum())) - np.repeat(before, some))
        at = until
