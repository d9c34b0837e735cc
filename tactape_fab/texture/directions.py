"""How many directions the parts of a tape point in, and everything that follows from that number."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sin

import numpy as np

from tactape_fab.texture.frames import DIRECTIONS_XY, LETTERS, FloatArray, IntArray, SymbolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Directions:
    """The symbols of tapes whose parts point in so many directions: the first so many values of `frames.LETTERS`.

    Attributes
    ----------
    gray_codes : ndarray of uint8, shape (count,)
        Bits of each symbol value as one number, so that neighbouring directions differ in one bit.
    clockwise : ndarray of int64, shape (count,)
        Symbol values as they follow each other clockwise from E.
    reads_within : float
        A part shows a symbol where it stands nearer than that to the symbol's place, in displacements: less than half the
        distance of neighbouring places.
    usual : bool
        The paper's four, of which manifests, commands and reports say nothing.
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
        return self.count.bit_length() - 1

    @property
    def spacing(self) -> float:
        """Distance of neighbouring places as a share of that of four directions: chords of one circle."""
        return sin(pi / self.count) / sin(pi / 4.0)

    @property
    def reach_diagonal(self) -> float:
        """How far a part moves towards a diagonal, in displacements along an axis: the largest |x| + |y|."""
        return float(np.abs(self.xy).sum(axis=1).max())


DIRECTIONS = {
    4: Directions(gray_codes=np.arange(4, dtype=np.uint8), clockwise=np.array([2, 3, 1, 0]), reads_within=1.0 / 2.0, usual=True),
    8: Directions(
        # counter-clockwise from N: N, w, W, s, S, e, E, n are 000, 001, 011, 010, 110, 111, 101, 100
        gray_codes=np.array([0, 3, 5, 6, 4, 1, 7, 2], dtype=np.uint8),
        clockwise=np.array([2, 6, 3, 7, 1, 5, 0, 4]),
        reads_within=1.0 / 3.0,
    ),
}
"""By how many there are. Of four directions the Gray codes are the symbol values themselves, x and y bit."""
USUAL_DIRECTIONS = next(count for count, directions in DIRECTIONS.items() if directions.usual)
