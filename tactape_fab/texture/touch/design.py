"""Design of touch codes: an unstructured matrix of symbols in which any two small patches differ in many bits.

A random matrix from this package's own integer generator is repaired conflict by conflict (`conflicts`) to increasing distances,
the rungs. Each rung has a limit of steps, not of time, so that equal inputs give equal results on every machine. The matrix is
that of the last rung reached. It has no shorter description, so the tape's manifest contains the symbols themselves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from tactape_fab.base.errors import CapacityError, Problem
from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import IntArray, SymbolArray
from tactape_fab.texture.touch.patches import patch_shapes
from tactape_fab.texture.windows import WordArray

if TYPE_CHECKING:
    from tactape_fab.texture.touch.words import Shapes

Bits = tuple[int, ...]

ALONE: tuple[Bits, ...] = (
    (0, 1, 2, 4, 6),
    (0, 1, 3, 5, 7),
    (0, 2, 4, 6, 8),
    (0, 2, 4, 7, 9),
    (1, 2, 4, 7, 9),
    (1, 2, 5, 7, 10),
    (1, 3, 5, 8, 10),
    (2, 3, 5, 8, 11),
)
"""Rungs of a tape alone: required distance in bits between its patches, by shape as in `patches.PATCHES`."""
BESIDE: tuple[tuple[Bits, Bits], ...] = (
    ((0, 1, 2, 4, 6), (0, 0, 1, 2, 4)),
    ((0, 2, 4, 6, 8), (0, 1, 2, 4, 6)),
    ((1, 2, 4, 7, 9), (0, 1, 3, 5, 7)),
    ((1, 3, 5, 8, 8), (0, 2, 4, 6, 8)),
    ((1, 3, 5, 8, 10), (0, 2, 4, 7, 9)),
)
"""Rungs beside other tapes: the same, and the required distance between a patch of the tape and one of theirs."""
ALONE_OF_EIGHT: tuple[Bits, ...] = (
    (0, 2, 4, 7),
    (1, 3, 6, 10),
    (2, 4, 7, 11),
    (2, 5, 8, 12),
    (3, 6, 9, 13),
    (4, 7, 11, 15),
    (4, 7, 11, 16),
)
"""Rungs for eight directions, without 5x5, whose bits exceed a word: it has at least the distance of the disc inside it."""
BESIDE_OF_EIGHT: tuple[tuple[Bits, Bits], ...] = (
    ((1, 3, 6, 10), (0, 2, 4, 7)),
    ((2, 5, 8, 12), (1, 3, 6, 10)),
    ((3, 6, 9, 13), (2, 4, 7, 11)),
    ((3, 6, 10, 14), (2, 5, 8, 12)),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rung:
    """Required distances in bits, by shape of patch.

    own: Between patches of the tape in any turn; if `quarter` is given, at 0 and 180 degrees only.
    across: Between a patch of the tape and one of another tape.
    quarter: Between patches of the tape at 90 and 270 degrees; None for `own`.
    effort: Factor of the limit of steps.
    """

    own: Bits
    across: Bits
    quarter: Bits | None = None
    effort: int = 1

    def of_turns(self) -> IntArray:
        """`own` and `quarter` by shape and turn, shape (k, 4)."""
        # turns in the order 0, 90, 180, 270 degrees
        odd = self.quarter or self.own
        return np.array([self.own, odd, self.own, odd], dtype=np.int64).T.copy()


Rungs = Mapping[tuple[int, bool, bool], tuple[Rung, ...]]
"""Rungs by number of directions, whether other tapes are beside it, and whether the parts show their quarter turn."""


def _rungs(alone: Sequence[Bits], beside: Sequence[tuple[Bits, Bits]]) -> tuple[tuple[Rung, ...], tuple[Rung, ...]]:
    none = (0,) * len(alone[0])
    return tuple(Rung(own=own, across=none) for own in alone), tuple(Rung(own=own, across=across) for own, across in beside)


def _by_kind(four: tuple[tuple[Rung, ...], ...], halves: tuple[tuple[Rung, ...], ...] | None = None) -> Rungs:
    eight = _rungs(ALONE_OF_EIGHT, BESIDE_OF_EIGHT)
    return {
        (directions, beside, half_turns): of[beside]
        for directions, half_turns, of in ((4, False, four), (4, True, halves or four), (8, False, eight), (8, True, eight))
        for beside in (False, True)
    }


_FOUR = _rungs(ALONE, BESIDE)
_NONE = (0, 0, 0, 0, 0)
RUNGS = _by_kind(_FOUR)
"""Rungs of `touch-1`."""
HIGHER_RUNGS = _by_kind(
    ((*_FOUR[0][:-1], Rung(own=(1, 3, 6, 9, 12), across=_NONE, effort=4)), _FOUR[1]),
    (
        (
            *_FOUR[0][:5],
            Rung(own=(1, 3, 6, 9, 12), across=_NONE, quarter=(1, 2, 4, 7, 9)),
            Rung(own=(2, 3, 6, 9, 12), across=_NONE, quarter=(1, 2, 5, 8, 10)),
            Rung(own=(2, 3, 6, 9, 12), across=_NONE, quarter=(1, 3, 5, 8, 11)),
        ),
        (
            *_FOUR[1],
            Rung(own=(1, 3, 6, 9, 12), across=(0, 2, 4, 7, 9), quarter=(1, 2, 5, 8, 10)),
        ),
    ),
)
"""Rungs of `touch-2`: compared with `touch-1` one bit less at nine dots, where nothing is located, and one more at 16, 21, 25.
Where parts show a quarter turn, no bit is given up, but patches a quarter turn apart need no more than in `touch-1`."""
_WORK, _WORK_BESIDE = 60_000_000, 400_000_000
"""Work limit of a rung, its steps times the patches compared per step: about ten seconds, or a minute.

The second is for rungs beside other tapes, except the last one, which many tapes do not reach.
"""
_LEAST_STEPS = 1000
_PIECE = 1_000_000
"""Work of a call of the kernel: a sixth of a second."""
MOST_TOUCH_POINTS = 20_000


def design(
    sector: int,
    shape: tuple[int, int],
    avoid: Sequence[SymbolArray] = (),
    directions: int = 4,
    *,
    rungs: Rungs = RUNGS,
    half_turns: bool = False,
) -> SymbolArray:
    """The matrix of a tape, shape (rows, columns), read-only; the last results are cached.

    sector: Seed of the design.
    shape: Rows and columns.
    avoid: Symbols of existing tapes with the same number of directions, from whose patches those of this tape must differ.
    half_turns: Whether the tape's parts show their quarter turn.
    Raises CapacityError if the tape has more grid points than the largest design.
    """
    if shape[0] * shape[1] > MOST_TOUCH_POINTS:
        message = (
            f"size_mm gives {shape[1]} x {shape[0]} grid points, more than the {MOST_TOUCH_POINTS} that are ever "
            "designed for; use a smaller --size or --code microdots-4x4"
        )
        raise CapacityError(Problem("size_mm", message))
    asked = rungs[directions, bool(avoid), half_turns]
    return _designed(sector, shape, tuple((a.shape, a.tobytes()) for a in avoid), directions, asked)


@lru_cache(maxsize=8)
def _designed(
    sector: int,
    shape: tuple[int, int],
    avoid: tuple[tuple[tuple[int, ...], bytes], ...],
    directions: int,
    rungs: tuple[Rung, ...],
) -> SymbolArray:
    from tactape_fab.texture.touch.conflicts import conflicts_of, fill, new_buffers, repair  # imports numba
    from tactape_fab.texture.touch.words import Patches, words_of  # imports numba

    # from here on symbols are Gray codes, whose bits give the distances; they are converted back at the end
    codes, shapes = DIRECTIONS[directions].gray_codes, patch_shapes(directions)
    others = [codes[np.frombuffer(data, dtype=np.uint8).reshape(of)] for of, data in avoid]
    # every sector and shape has its own state, as no side has 2^20 points
    state = np.array([sector << 40 | shape[0] << 20 | shape[1]], dtype=np.uint64)
    symbols, buffers = np.empty(shape, dtype=np.uint8), new_buffers()
    fill(symbols, directions, state)
    given = _given(others, shapes)
    work = shape[0] * shape[1] + sum(len(o.ravel()) for o in others)
    piece = max(1, _PIECE // work)
    reached = symbols.copy()
    for number, rung in enumerate(rungs, start=1):
        # a step compares a few patches with all, so that its time grows with the points of all tapes
        steps = max(_LEAST_STEPS, rung.effort * (_WORK_BESIDE if others and number < len(rungs) else _WORK) // work)
        patches, bits = Patches(*words_of(symbols, shapes), *given), (rung.of_turns(), np.array(rung.across))
        count, left = conflicts_of(patches, *bits, buffers), steps
        # a piece at a time: Python hears of Ctrl-C and SIGTERM between calls of a kernel only
        while count > 0 and left > 0:
            count = repair(symbols, shapes, patches, *bits, count, min(left, piece), state, buffers)
            left -= piece
        # a failed repair leaves the grid between two rungs, so the copy of the last rung is used
        if count != 0:
            break
        reached = symbols.copy()
    # argsort of a permutation is its inverse
    reached = np.argsort(codes).astype(np.uint8)[reached]
    reached.setflags(write=False)
    return reached


def _given(others: Sequence[SymbolArray], shapes: Shapes) -> tuple[WordArray, np.ndarray]:
    """Words of all patches of other tapes (Gray codes) in all turns, and their number by shape."""
    from tactape_fab.texture.touch.words import words_of

    found = [words_of(symbols, shapes) for symbols in others]
    # these have all four turns, as the tape's own patches are compared with them in turn 0 only
    count = sum((4 * n for _, n in found), np.zeros(len(shapes.side), dtype=np.int64))
    words = np.zeros((len(count), max(int(count.max()), 1)), dtype=np.uint64)
    for k in range(len(count)):
        parts = [own[k, :, : n[k]].ravel() for own, n in found]
        words[k, : count[k]] = np.concatenate(parts) if parts else words[k, :0]
    return words, np.asarray(count, dtype=np.int64)
