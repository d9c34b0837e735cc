"""Patches of a grid of symbols, as small contacts show them, and their Hamming distances in bits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import BoolArray, SymbolArray
from tactape_fab.texture.windows import WORD_BITS, windows_of

if TYPE_CHECKING:
    from tactape_fab.texture.touch.words import Shapes


def _square(side: int) -> npt.NDArray[np.bool_]:
    return np.ones((side, side), dtype=bool)


def _disc(side: int) -> npt.NDArray[np.bool_]:
    """A square without its corners."""
    mask = _square(side)
    mask[np.ix_([0, -1], [0, -1])] = False
    return mask


PATCHES = {"3x3": _square(3), "disc-12": _disc(4), "4x4": _square(4), "disc-21": _disc(5), "5x5": _square(5)}
"""Shapes of patches, smallest first: squares, and discs named by their number of dots."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PatchDistance:
    """The nearest patches of one shape.

    shape: One of `PATCHES`.
    patches: Number of patches without an omitted part.
    bits: Least distance of two of them in any of four turns, in bits of `Directions.gray_codes`: with four directions one bit
        for a part a quarter turn off, two for the opposite direction. None without a pair.
    pairs: Number of pairs at that distance.
    half_turns: Bits and pairs of patches at 0 or 180 degrees only, for codes that have separate distances for parts which show
        their quarter turn.
    proven: Proven least distance in bits between patches at any two places of all sectors at a known turn, for codes with one.
    """

    shape: str
    patches: int
    bits: int | None
    pairs: int
    half_turns: tuple[int, int] | None = None
    proven: int | None = None

    def to_mapping(self) -> dict[str, Any]:
        halves = {} if self.half_turns is None else {"half_turns": dict(zip(("bits", "pairs"), self.half_turns, strict=True))}
        proven = {} if self.proven is None else {"all_sectors": {"bits": self.proven}}
        return {"shape": self.shape, "count": self.patches, "bits": self.bits, "pairs": self.pairs, **halves, **proven}


def in_one_word(directions: int) -> list[npt.NDArray[np.bool_]]:
    """Masks of those `PATCHES` whose bits fit in one word: all except 5x5 with eight directions."""
    return [mask for mask in PATCHES.values() if DIRECTIONS[directions].bits * mask.sum() <= WORD_BITS]


@cache
def patch_shapes(directions: int = 4) -> Shapes:
    """`Shapes` of the masks of `in_one_word`."""
    from tactape_fab.texture.touch.words import shapes_of  # imports numba, which other codes do not need

    return shapes_of(in_one_word(directions), directions)


def patch_distances(
    symbols: SymbolArray, placed: BoolArray, directions: int = 4, *, half_turns: bool = False
) -> tuple[PatchDistance, ...]:
    """Exact distances between the patches of a grid, by shape.

    symbols (rows, columns)
    placed (rows, columns): Mask of grid points with a part; patches with a point without a part do not count.
    half_turns: Whether to add the distances at 0 and 180 degrees only; for shapes that fit in one word.
    """
    from tactape_fab.texture.touch.words import nearest_of, nearest_of_long, words_of

    shapes = patch_shapes(directions)
    words, _ = words_of(DIRECTIONS[directions].gray_codes[symbols], shapes)
    found = []
    for (name, mask), own in zip(PATCHES.items(), words, strict=False):
        whole = np.zeros(0, dtype=bool)
        if min(symbols.shape) >= len(mask):
            windows = np.lib.stride_tricks.sliding_window_view(placed, mask.shape)
            # points outside the shape need no part
            whole = (windows | ~mask).all(axis=(2, 3)).ravel()
        kept, out = np.ascontiguousarray(own[:, : len(whole)][:, whole]), np.zeros(2, dtype=np.int64)
        nearest_of(kept, kept.shape[1], 1, out)
        bits, pairs = out.tolist()
        halves = None
        if half_turns and pairs:
            nearest_of(kept, kept.shape[1], 2, out)
            halves = (int(out[0]), int(out[1]))
        found.append(
            PatchDistance(shape=name, patches=kept.shape[1], bits=bits if pairs else None, pairs=pairs, half_turns=halves)
        )
    # 5x5 with eight directions has 75 bits in two words
    for name, mask in list(PATCHES.items())[len(shapes.side) :]:
        long, out = windows_of(symbols, placed, len(mask), turns=4, directions=directions), np.zeros(2, dtype=np.int64)
        nearest_of_long(long.words[0], long.words[1], long.count, out)
        bits, pairs = out.tolist()
        found.append(PatchDistance(shape=name, patches=long.count, bits=bits if pairs else None, pairs=pairs))
    return tuple(found)
