"""Displacement directions of a tape's parts, and the values derived from their number."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sin

import numpy as np

from tactape_fab.texture.frames import DIRECTIONS_XY, LETTERS, FloatArray, IntArray, SymbolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Directions:
    """The symbols of tapes with `count` displacement directions: the first `count` values of `frames.LETTERS`.

    gray_codes (count,): Bits of each symbol value as one number; neighbouring directions differ in one bit.
    clockwise (count,): Symbol values in clockwise order from E.
    reads_within: Largest distance of a part from a symbol's nominal place, in displacements, at which it reads as that symbol:
        less than half the distance of neighbouring places.
    usual: Whether these are the paper's four, the default that manifests, commands and reports do not mention.
    """

    gray_codes: SymbolArray
    clockwise: IntArray
    reads_within: float
    usual: bool = False

    def __post_init__(self) -> None:
        self.gray_codes.setflags(write=False)
        self.clockwise.setflags(write=False)

    @property
    def count(self) -> int:
        return len(self.gray_codes)

    @property
    def letters(self) -> str:
        """Letter of each symbol value."""
        return LETTERS[: self.count]

    @property
    def xy(self) -> FloatArray:
        """Unit displacement of each symbol value in the texture frame, shape (count, 2)."""
        return DIRECTIONS_XY[: self.count]

    @property
    def bits(self) -> int:
        """Bits of a symbol."""
        # log2 of the count, which is a power of 2
        return self.count.bit_length() - 1

    @property
    def spacing(self) -> float:
        """Distance of neighbouring symbol places relative to that of four directions; both are chords of one circle."""
        # the chord of an angle 2 pi / n is 2 sin(pi / n)
        return sin(pi / self.count) / sin(pi / 4.0)

    @property
    def reach_diagonal(self) -> float:
        """Largest |x| + |y| of a part's displacement, in displacements."""
        return float(np.abs(self.xy).sum(axis=1).max())


DIRECTIONS = {
    # neighbouring places are sqrt(2) displacements apart: a part within 0.71 of its own is nearest to it
    4: Directions(gray_codes=np.arange(4, dtype=np.uint8), clockwise=np.array([2, 3, 1, 0]), reads_within=1.0 / 2.0, usual=True),
    8: Directions(
        # counter-clockwise from N: N, w, W, s, S, e, E, n are 000, 001, 011, 010, 110, 111, 101, 100
        gray_codes=np.array([0, 3, 5, 6, 4, 1, 7, 2], dtype=np.uint8),
        clockwise=np.array([2, 6, 3, 7, 1, 5, 0, 4]),
        # neighbouring places are 2 sin(22.5 deg) = 0.77 displacements apart, and half of that is 0.38
        reads_within=1.0 / 3.0,
    ),
}
"""Directions by their number. For four directions the Gray codes are the symbol values themselves, the x and the y bit."""
USUAL_DIRECTIONS = next(count for count, directions in DIRECTIONS.items() if directions.usual)
