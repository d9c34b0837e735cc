"""Tapes without a code plane: the dots compared with every place of their matrices of symbols, in all turns.

Nothing is known of a matrix but its symbols. So wrong symbols are counted first, at 64 places at once: each dot adds one bit
to the counts of all places where a part shows another symbol than the dot. So many wrong symbols leave a place too little
evidence, however well the other dots fit: it is dropped, and counted at that bound, as for codes with a plane. At the few
places that remain the evidence is added up dot by dot.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from math import comb
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from tactape_fab.base.jit import inlined_kernel, inner_kernel, kernel, long_kernel
from tactape_fab.sense.decode.search.bounds import NEVER
from tactape_fab.sense.decode.search.evidence import Tables
from tactape_fab.sense.decode.search.single_place import NO_PART
from tactape_fab.sense.decode.search.tally import (
    BEST,
    FAR_BELOW,
    FITS,
    LEFT_OUT,
    Tally,
    count_at,
    count_bound,
    is_uninformative,
    least_of,
)
from tactape_fab.texture.frames import FloatArray, IntArray, SymbolArray

Words = npt.NDArray[np.uint64]

LARGEST_CONTACT = 24
"""Cells; dots that reach farther are not one contact."""
_WORD = 64
_PLANES, _MOST_COUNTED = 5, 30
"""Binary digits of a count of wrong symbols, and the most dots that are counted: a limit of one more must be representable."""
_USUAL_LOSS = 30.0
"""Loss of evidence (ln) up to which a place usually still matters, from which the number of dots to count is chosen."""
_FEW_PLACES = 1e-5
"""Share of places left by chance from which on more dots are not worth counting."""
_FIRST_LEAST = (0.0, -6.0, -12.0, -1e29)
"""Thresholds of weighted evidence (ln), tried in turn, above which places are evaluated to find the best one: no answer is below
the first."""
_DEEPER = 2.0
"""The bound at which places are dropped and counted is set so much (ln) lower, so that they weigh even less."""
_NEGLIGIBLE_TO_NONE = -4.0
"""`tally.NEGLIGIBLE` where the best place has no evidence: there is no answer, whatever the others weigh."""
_EVIDENT = -1e29
_ROUNDING = 1e-6
_FEW_POINTS = 1 << 18
"""Size of `Matrices.shown` up to which a search keeps the interpreter's lock, some 25 tapes of 100 x 50 mm: it takes 0.5 ms, as a
rule, and up to 10 where nothing registered is touched."""
_ONE = np.uint64(1)


class Matrices(NamedTuple):
    """Tapes by their matrices, those of equal size together.

    wrong (n, symbols, words, high): Bit c % 64 of word c // 64 is set where column c of a row has a part that shows another
        symbol; `LARGEST_CONTACT` rows and columns without parts come before and after.
    shown (n, high x wide): From `single_place.shown_by`, but the number of symbols where there is no part, beyond the tape as
        well: as many rows and columns as in ``wrong``, row by row.
    sizes, size_of, classes: As in `plane_sites.Sites`.
    """

    wrong: Words
    shown: SymbolArray
    sizes: IntArray
    size_of: IntArray
    classes: IntArray


class Frame(NamedTuple):
    """Evidence of some dots, prepared before any tape is looked at; those first that lose most by another symbol.

    Attributes
    ----------
    cells : ndarray of int, shape (4, n, 2)
        `Tables.cells`.
    evidence : ndarray, shape (4, n, symbols + 1)
        ln E of each dot for each symbol, and 0 where there is no part.
    fits : ndarray of int, shape (4, n)
        The symbol that fits each dot best.
    floor : ndarray, shape (n + 1,)
        Least evidence (ln) that a place loses by so many wrong symbols of the dots that are counted.
    rest : ndarray, shape (4, n + 1)
        Most that all dots after so many can say.
    most : ndarray, shape (4, m + 1, m + 1)
        Most that the dots in columns below c and rows below r can say.
    least : ndarray of uint64, shape (4, sizes, planes, words, places down)
        Buffer: binary digits of the fewest wrong symbols that a place is dropped by.
    counts : ndarray of uint64, shape (planes + 1, places down)
        Buffer: binary digits of the wrong symbols at each place, and whether it remains.
    """

    cells: IntArray
    evidence: FloatArray
    fits: IntArray
    floor: FloatArray
    rest: FloatArray
    most: FloatArray
    least: Words
    counts: Words


def matrices_of(shown: Sequence[SymbolArray], sizes: list[tuple[int, int]], directions: int) -> Matrices:
    """Matrices from the symbols that tapes show (`single_place.shown_by`), ordered by size, and the sizes (columns, rows)."""
    pad = LARGEST_CONTACT
    wide, high = (max(size[axis] for size in sizes) for axis in range(2))
    # a word more, as 64 places from any column on are cut out of two words
    words = -(-(wide + pad) // _WORD) + 1
    # `directions` itself stands for no part: a symbol that is none, and an index of the entry with ln E = 0
    padded = np.full((len(shown), high + 2 * pad, words * _WORD), directions, dtype=np.uint8)
    for tape, symbols in enumerate(shown):
        padded[tape, pad : pad + symbols.shape[0], pad : pad + symbols.shape[1]] = np.where(
            symbols == NO_PART, directions, symbols
        )
    wrong = np.empty((len(shown), directions, words, high + 2 * pad), dtype=np.uint64)
    for symbol in range(directions):
        other = (padded != directions) & (padded != symbol)
        # bit c % 64 of word c // 64 on any machine: packed to bytes from the lowest bit on, and read as little-endian words
        wrong[:, symbol] = np.packbits(other, axis=2, bitorder="little").view("<u8").swapaxes(1, 2)
    size_of = np.array([sizes.index((symbols.shape[1], symbols.shape[0])) for symbols in shown])
    bounds = [0, *(np.flatnonzero(np.diff(size_of)) + 1).tolist(), len(shown)]
    return Matrices(
        wrong=wrong,
        shown=padded.reshape(len(shown), -1),
        sizes=np.array(sizes, dtype=np.int64),
        size_of=size_of.astype(np.int64),
        classes=np.array([(a, b, size_of[a], 1, 1, 0) for a, b in pairwise(bounds)], dtype=np.int64),
    )


def weigh_matrices(tables: Tables, matrices: Matrices, least: int, base: FloatArray, cue: FloatArray, tally: Tally) -> None:
    """Compare the dots with every place of every tape, and add the places to a tally, which is a new one.

    ``least`` is the fewest dots on a tape; ``base`` and ``cue`` are the fields of `groups.Weights`.
    """
    frame = _frame(tables, matrices)
    weigh = _weigh_few if matrices.shown.size <= _FEW_POINTS else _weigh_many
    weigh(frame, tables.dots, tables.size, matrices, least, np.maximum(base, NEVER), cue, tally)


def _frame(tables: Tables, matrices: Matrices) -> Frame:
    evidence, m = tables.evidence @ _signs(tables.evidence.shape[2] - 1), tables.dots.shape[1] - 1
    ranked = np.sort(evidence[0], axis=1)
    # a wrong symbol costs a dot at least what its best is ahead of its second
    lost = ranked[:, -1] - ranked[:, -2]
    order = np.argsort(-lost, kind="stable")
    # indexing leaves other layouts for one dot than for several, and each would be compiled for
    evidence, cells = np.ascontiguousarray(evidence[:, order]), np.ascontiguousarray(tables.cells[:, order])
    best = np.ascontiguousarray(evidence.max(axis=2))
    floor, most = np.empty(len(order) + 1), np.zeros((4, m + 1, m + 1))
    counted = _choose(lost[order], _by_chance(evidence.shape[2]), floor)
    _fill_most(cells, best, most)
    after = np.cumsum(best[:, ::-1], axis=1)[:, ::-1]
    high, words = int(matrices.sizes[:, 1].max()) + m, matrices.wrong.shape[2]
    return Frame(
        cells=cells,
        evidence=np.ascontiguousarray(np.concatenate([evidence, np.zeros((4, len(order), 1))], axis=2)),
        fits=np.ascontiguousarray(evidence.argmax(axis=2)),
        floor=floor[: counted + 1],
        rest=np.ascontiguousarray(np.concatenate([after, np.zeros((4, 1))], axis=1)),
        most=most,
        least=np.empty((4, len(matrices.sizes), _PLANES, words, high), dtype=np.uint64),
        counts=np.empty((_PLANES + 1, high), dtype=np.uint64),
    )


@cache
def _signs(bits: int) -> FloatArray:
    """Matrix from a dot's (mean, evidence of each bit) to its ln E for each symbol; shape (1 + bits, symbols)."""
    symbols = np.arange(1 << bits)
    return np.stack([np.ones(1 << bits), *(2.0 * (symbols >> bit & 1) - 1.0 for bit in range(bits))])


@cache
def _by_chance(symbols: int) -> FloatArray:
    """Probability [k, w] that at most w of k symbols are wrong if all symbols are equally likely (binomial)."""
    wrong, counts = 1.0 - 1.0 / symbols, range(_MOST_COUNTED + 1)
    of = [[comb(k, w) * wrong**w * (1.0 - wrong) ** (k - w) for w in counts] for k in counts]
    return np.cumsum(of, axis=1)


@kernel()
def _choose(lost: FloatArray, by_chance: FloatArray, floor: FloatArray) -> int:
    """Choose how many dots to count, and fill `Frame.floor`; ``lost`` is in falling order."""
    counted, least = 0, 2.0
    for k in range(1, min(len(lost), _MOST_COUNTED) + 1):
        # the most wrong symbols whose least loss, that of the w smallest, leaves a place in the search
        total, w = 0.0, 0
        while w < k and total + lost[k - 1 - w] <= _USUAL_LOSS:
            total += lost[k - 1 - w]
            w += 1
        if by_chance[k, w] < least:
            counted, least = k, by_chance[k, w]
        if least < _FEW_PLACES:
            break
    floor[0] = 0.0
    # w wrong symbols lose at least the w smallest losses together
    for w in range(counted):
        floor[w + 1] = floor[w] + lost[counted - 1 - w]
    return counted


@kernel()
def _fill_most(cells: IntArray, best: FloatArray, most: FloatArray) -> None:
    """Fill `Frame.most`, zero before."""
    m = most.shape[1]
    for turn in range(4):
        of = most[turn]
        for k in range(cells.shape[1]):
            of[cells[turn, k, 0] + 1, cells[turn, k, 1] + 1] += best[turn, k]
        for c in range(1, m):
            for r in range(1, m):
                of[c, r] += of[c - 1, r] + of[c, r - 1] - of[c - 1, r - 1]


def _weigh(
    frame: Frame, dots: IntArray, size: IntArray, matrices: Matrices, least: int, base: FloatArray, cue: FloatArray, tally: Tally
) -> None:
    """Find the best weight first, then count every place that may matter beside it, and all others at their bound."""
    tapes = len(matrices.shown)
    for k in range(len(_FIRST_LEAST)):
        if tally.sums[BEST] > _EVIDENT:
            break
        _fill_least(frame, dots, size, matrices.sizes, least, base, _FIRST_LEAST[k])
        for tape in range(tapes):
            for turn in range(4):
                _look(frame, size, matrices, (tape, turn), base[turn], cue[turn], _FIRST_LEAST[k], tally, np.bool_(False))
    widest = 0
    for of in range(len(matrices.sizes)):
        widest = max(widest, matrices.sizes[of, 0] + frame.most.shape[1] - 1)
    # no fewer than there are: turns, tapes, rows and columns of the largest
    places = np.log(4.0 * tapes * frame.counts.shape[1] * widest)
    for left in range(2 if tally.sums[BEST] < tally.sums[FITS] else 1, 0, -1):
        # as in `all_places`: nothing that fits is known, so first the best place alone
        bound = tally.sums[BEST] - _ROUNDING if left == 2 else least_of(places, (0.0, 0.0), tally.sums) - _DEEPER
        if left == 1 and tally.sums[BEST] <= 0.0:
            bound = max(bound, tally.sums[BEST] + _NEGLIGIBLE_TO_NONE - places)
        _fill_least(frame, dots, size, matrices.sizes, least, base, bound)
        for tape in range(tapes):
            for turn in range(4):
                _look(frame, size, matrices, (tape, turn), base[turn], cue[turn], bound, tally, np.bool_(True))
        likelihood = NEVER
        for turn in range(4):
            for over in range(2):
                if base[turn, over] > _EVIDENT:
                    likelihood = max(likelihood, bound - base[turn, over] + cue[turn])
        count_bound(np.exp(places + bound - tally.sums[BEST]), likelihood, tally.sums)
        if left == 2 and is_uninformative(tally):
            break


_weigh_few, _weigh_many = kernel()(_weigh), long_kernel()(_weigh)


@inner_kernel()
def _fill_least(
    frame: Frame, dots: IntArray, size: IntArray, sizes: IntArray, least: int, base: FloatArray, bound: float
) -> None:
    """Fill `Frame.least`: places with so many wrong symbols stay below a bound of their weighted evidence (ln)."""
    for turn in range(4):
        wide, high = size[turn, 0], size[turn, 1]
        for of in range(len(sizes)):
            columns, rows, digits = sizes[of, 0], sizes[of, 1], frame.least[turn, of]
            for j in range(rows + high - 1):
                if high <= j < rows:  # all rows of dots on the tape, as at the place before
                    for plane in range(_PLANES):
                        for word in range(digits.shape[1]):
                            digits[plane, word, j] = digits[plane, word, j - 1]
                    continue
                for plane in range(_PLANES):
                    for word in range(digits.shape[1]):
                        digits[plane, word, j] = 0
                count, y = 0, j - high + 1
                r0, r1 = max(0, -y), min(high, rows - y)
                for i in range(columns + wide - 1):
                    if not wide <= i < columns:
                        x = i - wide + 1
                        span = (max(0, -x), min(wide, columns - x), r0, r1)
                        over = 0 if span[1] - span[0] == wide and r1 - r0 == high else 1
                        enough = _within(dots[turn], span) >= least
                        count = _fewest(frame, _within(frame.most[turn], span) + base[turn, over] - bound) if enough else 0
                    for plane in range(_PLANES):
                        digits[plane, i // _WORD, j] |= np.uint64((count >> plane) & 1) << np.uint64(i % _WORD)


@inlined_kernel()
def _within(below: FloatArray, span: tuple[int, int, int, int]) -> float:
    """Sum over columns c0 to c1 - 1 and rows r0 to r1 - 1, from sums of all below."""
    c0, c1, r0, r1 = span
    return below[c1, r1] - below[c0, r1] - below[c1, r0] + below[c0, r0]  # type: ignore[no-any-return]


@inner_kernel()
def _fewest(frame: Frame, spare: float) -> int:
    """The fewest wrong symbols by which a place loses more than it may (ln)."""
    count = 0
    while count < len(frame.floor) and frame.floor[count] <= spare + _ROUNDING:
        count += 1
    return count


@inner_kernel()
def _look(
    frame: Frame,
    size: IntArray,
    matrices: Matrices,
    at: tuple[int, int],
    base: FloatArray,
    cue: float,
    bound: float,
    tally: Tally,
    counted: bool | np.bool_,
) -> None:
    """Add up the evidence at the places of a tape and turn that may reach a bound; count them, or keep the best's weight only.

    ``counted`` is a numpy boolean: Python's True and False would be two types, and the kernel compiled for each.
    """
    (tape, turn), nowhere = at, int(np.int64(-1))
    of = matrices.size_of[tape]
    wide, high, columns, rows = size[turn, 0], size[turn, 1], matrices.sizes[of, 0], matrices.sizes[of, 1]
    across, down, stride = columns + wide - 1, rows + high - 1, matrices.wrong.shape[2] * _WORD
    for word in range((across + _WORD - 1) // _WORD):
        _count_wrong(frame, matrices.wrong[tape], turn, word, (wide, high), down)
        _compare(frame.counts, frame.least[turn, of], word, down)
        for j in range(down):
            left = frame.counts[_PLANES, j]
            while left != 0:
                # two's complement: -x is ~x + 1
                lowest = left & (~left + _ONE)  # the lowest bit that is set
                left ^= lowest
                x, y = word * _WORD + _index(lowest) - wide + 1, j - high + 1
                over = 0 if 0 <= x <= columns - wide and 0 <= y <= rows - high else 1
                start = (LARGEST_CONTACT + y) * stride + LARGEST_CONTACT + x
                value = _add_up(frame, matrices.shown[tape], turn, start, stride, bound - base[over])
                if value == NEVER:
                    continue
                score = value + base[over]
                if not counted:
                    tally.sums[BEST] = max(tally.sums[BEST], score)
                elif score < tally.sums[BEST] - FAR_BELOW:
                    tally.sums[LEFT_OUT] = max(tally.sums[LEFT_OUT], value + cue)
                else:
                    count_at(tally, value, 1.0, (base[over], cue), (turn, tape, x, y, nowhere, nowhere))


@inner_kernel()
def _count_wrong(frame: Frame, wrong: Words, turn: int, word: int, size: tuple[int, int], down: int) -> None:
    """Count the wrong symbols at 64 places of every row, in binary digits: two dots at a time, by an adder, then the carry."""
    one, two, four, eight, most = frame.counts[0], frame.counts[1], frame.counts[2], frame.counts[3], frame.counts[4]
    for j in range(down):
        one[j] = two[j] = four[j] = eight[j] = most[j] = 0
    counted, left, top = len(frame.floor) - 1, LARGEST_CONTACT - size[0] + 1, LARGEST_CONTACT - size[1] + 1
    for k in range(0, counted, 2):
        # of an odd number the last dot has no partner: `both` blanks it
        last = min(k + 1, counted - 1)
        c1, r1, c2, r2 = frame.cells[turn, k, 0], frame.cells[turn, k, 1], frame.cells[turn, last, 0], frame.cells[turn, last, 1]
        low1, high1 = wrong[frame.fits[turn, k], word, top + r1 :], wrong[frame.fits[turn, k], word + 1, top + r1 :]
        low2, high2 = wrong[frame.fits[turn, last], word, top + r2 :], wrong[frame.fits[turn, last], word + 1, top + r2 :]
        # a shift by 64 would be undefined: `left` + c is 1 or more, so that no shift up is
        down1, down2 = np.uint64(left + c1), np.uint64(left + c2)  # 1 to LARGEST_CONTACT
        up1, up2 = np.uint64(_WORD - left - c1), np.uint64(_WORD - left - c2)
        both = ~np.uint64(0) if k + 1 < counted else np.uint64(0)
        for j in range(down):
            a = (low1[j] >> down1) | (high1[j] << up1)
            b = ((low2[j] >> down2) | (high2[j] << up2)) & both
            # a full adder of a, b and the ones; the carry ripples through the other digits
            half = a ^ b
            carry = (a & b) | (half & one[j])
            one[j] ^= half
            more = two[j] & carry
            two[j] ^= carry
            carry = four[j] & more
            four[j] ^= more
            more = eight[j] & carry
            eight[j] ^= carry
            most[j] ^= more


@inner_kernel()
def _compare(counts: Words, least: Words, word: int, down: int) -> None:
    """Which places have fewer wrong symbols than they are dropped by, digit by digit."""
    remain = counts[_PLANES]
    for j in range(down):
        remain[j] = 0
    for plane in range(_PLANES):
        count, limit = counts[plane], least[plane, word]
        for j in range(down):
            # from the lowest digit up: a higher one overrules, equal ones leave it as it was
            remain[j] = (~count[j] & limit[j]) | (~(count[j] ^ limit[j]) & remain[j])


@inlined_kernel()
def _index(bit: np.uint64) -> int:
    """Number of the one bit that is set."""
    index = 0
    for step in (32, 16, 8, 4, 2, 1):
        if bit >> np.uint64(step) != 0:
            bit >>= np.uint64(step)
            index += step
    return index


@inner_kernel()
def _add_up(frame: Frame, shown: SymbolArray, turn: int, start: int, stride: int, least: float) -> float:
    """Ln E at a place, whose first column and row of dots are at ``start``; `NEVER` once it cannot reach what matters."""
    total, cells, evidence, rest = 0.0, frame.cells[turn], frame.evidence[turn], frame.rest[turn]
    for k in range(cells.shape[0]):
        total += evidence[k, shown[start + cells[k, 1] * stride + cells[k, 0]]]
        if total + rest[k + 1] < least - _ROUNDING:
            return NEVER
    return total
