"""All pairs of windows that differ in few symbols, without comparing every pair.

If two windows differ in at most d symbols and their points are split into p parts, at least p - d parts agree fully. So for
each choice of p - d parts the windows are sorted by their symbols there, and only windows with equal symbols are compared
(multi-index search, Norouzi, Punjani and Fleet 2012). Nothing is missed: the search is exact, whatever p.
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
"""Effective information of a symbol in bits: less than 2, because a code is not random. It affects only the speed."""
_MOST_SORTS = 300
_TABLE_BITS = 3
"""The table of hashes has eight times as many entries as there are windows."""
_MIX = (np.uint64(0x9E37_79B9_7F4A_7C15), np.uint64(0xC2B2_AE3D_27D4_EB4F), np.uint64(0x1656_67B1_9E37_79F9))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pairs:
    """Pairs of windows: the first is like the second turned by ``turn`` quarters counter-clockwise, except ``distance`` symbols.

    All arrays of equal length. Every pair comes once: with turn 0 first < second, with turn 2 first <= second; with turn 1
    any (which is turn 3 the other way round). A window and itself make a pair in turns 1 and 2.
    """

    first: IntArray
    second: IntArray
    turn: IntArray
    distance: DistanceArray

    def taken(self, which: IntArray | BoolArray) -> Pairs:
        """Some of the pairs, by their indices or a mask."""
        return Pairs(first=self.first[which], second=self.second[which], turn=self.turn[which], distance=self.distance[which])


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """Plan of a search: points of each part, number of parts that must agree, distance up to which the search is complete."""

    parts: tuple[tuple[int, ...], ...]
    agreeing: int
    most: int


def plan_search(side: int, count: int, most: int) -> Search:
    """The search that is estimated to be the fastest for all pairs up to a distance.

    side: Side of the windows, in grid points.
    count: Number of windows.
    most: Largest distance of interest, in symbols.
    """
    cells = side * side
    # three turns of each window; an upright one is compared with those after it, n^2 / 2, and with all in two other turns, 2 n^2
    keys, pairs = 3.0 * count, 2.5 * count * count
    # nothing has to agree: every pair is compared, which is the fastest for few windows
    best = Search(parts=(tuple(range(cells)),), agreeing=0, most=cells)
    least = pairs * _SECONDS_PER_PAIR + keys * _SECONDS_PER_KEY
    for parts in range(most + 1, cells + 1):
        agreeing = parts - most
        sorts = comb(parts, agreeing)
        if sorts > _MOST_SORTS:
            continue
        # so many pairs agree by chance in the points of the agreeing parts
        compared = pairs * 2.0 ** (-_BITS_PER_SYMBOL * cells * agreeing / parts)
        seconds = sorts * (_SECONDS_PER_SORT + keys * _SECONDS_PER_KEY + compared * _SECONDS_PER_PAIR)
        if seconds < least:
            least, best = seconds, Search(parts=_dealt(side, parts), agreeing=agreeing, most=most)
    return best


@cache
def _dealt(side: int, parts: int) -> tuple[tuple[int, ...], ...]:
    """Points of a window split into parts along diagonals: points of one row or column of a code are correlated."""
    diagonal = [r * side + (r + shift) % side for shift in range(side) for r in range(side)]
    return tuple(tuple(int(cell) for cell in part) for part in np.array_split(diagonal, parts))


def near_pairs(words: tuple[WordArray, ...], search: Search, queries: int | None = None, *, bits: int = 2) -> Iterator[Pairs]:
    """Every pair of windows at most ``search.most`` apart, in bounded portions.

    words each (turns, n): As `Windows` has them, of one tape or of several one after the other: three turns, with `queries` all
        four.
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
        # the windows of the first turn alone begin pairs: turning both by the same angle changes nothing
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
            # half a turn is the same both ways, so that such a pair is met twice; upright pairs come in the order of the sort,
            # first < second
            kept = (turn != 2) | (first <= second) if queries is None else second >= queries
            yield Pairs(first=first[kept], second=second[kept], turn=turn[kept], distance=distance[near][kept])


def _mask(cells: tuple[int, ...], words: int, bits: int) -> tuple[np.uint64, ...]:
    values = [0] * words
    for cell in cells:
        word, place = divmod(cell, WORD_BITS // bits)
        values[word] |= ((1 << bits) - 1) << (bits * place)
    return tuple(np.uint64(v) for v in values)


def _runs(words: tuple[WordArray, ...], masks: list[tuple[np.uint64, ...]], firsts: int) -> tuple[IntArray, IntArray]:
    """Windows sorted so that those which agree under the masks are adjacent, and the end of each one's run.

    Sorted by a hash with the window's own number in its low bits. Windows with a hash collision share a run, too; they are
    removed by their distance. Most of those that agree with none of the first `firsts` are left out: a table of the hashes'
    highest bits tells them, and there are two thirds fewer to sort.
    """
    n = len(words[0])
    # the low bits hold a window's number, so that sorting keys sorts windows of equal hash by turn, then by place
    bits = np.uint64(max(n - 1, 1).bit_length())
    low = (np.uint64(1) << bits) - np.uint64(1)
    key = np.zeros(n, dtype=np.uint64)
    for i, word in enumerate(words):
        mask = np.uint64(sum(int(m[i]) for m in masks))
        part = word & mask
        # a multiplication mixes only upwards; the shift brings the high bits down before it
        part ^= part >> np.uint64(29)
        part *= _MIX[i % len(_MIX)]
        key += part
    key ^= key >> np.uint64(32)
    key *= _MIX[-1]
    place = key >> (np.uint64(64 - _TABLE_BITS) - bits)
    # marks hashes of windows that begin pairs; a chance hit, of at most one in eight, costs a comparison and loses nothing
    known = np.zeros(1 << (int(bits) + _TABLE_BITS), dtype=bool)
    known[place[:firsts]] = True
    kept = np.flatnonzero(known[place])
    # a sort of plain words, which takes half the time of an argsort
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
    """Pairs of each start with all after it in its run, in portions."""
    lengths = ends - starts - 1
    starts, lengths = starts[lengths > 0], lengths[lengths > 0]
    total = np.cumsum(lengths)
    at = 0
    while at < len(starts):
        done = int(total[at - 1]) if at else 0
        # at least one start, though its run alone may be longer than a portion
        until = max(int(np.searchsorted(total, done + _CHUNK, side="right")), at + 1)
        some = lengths[at:until]
        before = np.cumsum(some) - some
        first = np.repeat(starts[at:until], some)
        yield first, first + 1 + (np.arange(int(some.sum())) - np.repeat(before, some))
        at = until
