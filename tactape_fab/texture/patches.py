"""Patches of a grid of symbols, as small contacts show them, and how many bits any two of them differ in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tactape_fab.texture.code import BoolArray
from tactape_fab.texture.frames import SymbolArray

if TYPE_CHECKING:
    from tactape_fab.texture.touch_search import Shapes


def _square(side: int) -> npt.NDArray[np.bool_]:
    return np.ones((side, side), dtype=bool)


def _disc(side: int) -> npt.NDArray[np.bool_]:
    """A square without its corners."""
    mask = _square(side)
    mask[np.ix_([0, -1], [0, -1])] = False
    return mask


PATCHES = {"3x3": _square(3), "disc-12": _disc(4), "4x4": _square(4), "disc-21": _disc(5), "5x5": _square(5)}
"""Shapes of patches, smallest first: squares, and discs of so many dots."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PatchDistance:
    """The nearest patches of one shape.

    Attributes
    ----------
    shape : str
        Of `PATCHES`.
    patches : int
        How many there are without a hole.
    bits : int or None
        Fewest bits in which two of them differ, in any of four turns: one bit where a part points a quarter turn elsewhere,
        two where it points the other way. None where there is no pair.
    pairs : int
        Pairs at that distance.
    """

    shape: str
    patches: int
    bits: int | None
    pairs: int

    def to_mapping(self) -> dict[str, Any]:
        return {"shape": self.shape, "count": self.patches, "bits": self.bits, "pairs": self.pairs}


@cache
def patch_shapes() -> Shapes:
    """`PATCHES` for a search."""
    from tactape_fab.texture.touch_search import shapes_of  # loads the compiler, which tapes of other codes do without

    return shapes_of(list(PATCHES.values()))


def patch_distances(symbols: SymbolArray, placed: BoolArray) -> tuple[PatchDistance, ...]:
    """How far the patches of a grid are apart, by shape; exact.

    Parameters
    ----------
    symbols : ndarray of uint8, shape (rows, columns)
    placed : ndarray of bool, shape (rows, columns)
        Patches that hold a grid point without a part do not count.
    """
    from tactape_fab.texture.touch_search import nearest_of, words_of

    words, _ = words_of(symbols, patch_shapes())
    found = []
    for (name, mask), own in zip(PATCHES.items(), words, strict=True):
        whole = np.zeros(0, dtype=bool)
        if min(symbols.shape) >= len(mask):
            windows = np.lib.stride_tricks.sliding_window_view(placed, mask.shape)
            whole = (windows | ~mask).all(axis=(2, 3)).ravel()
        kept, out = np.ascontiguousarray(own[:, : len(whole)][:, whole]), np.zeros(2, dtype=np.int64)
        nearest_of(kept, kept.shape[1], out)
        bits, pairs = out.tolist()
        found.append(PatchDistance(shape=name, patches=kept.shape[1], bits=bits if pairs else None, pairs=pairs))
    return tuple(found)
