"""Packing of rectangles into sheets, one after the other, each into a maximal free rectangle.

MAXRECTS of J. Jylänki, "A Thousand Ways to Pack the Bin" (2010), section 4: all free rectangles not contained in another are
kept; a rectangle is placed in the lower left corner of one of them, and every free rectangle that it overlaps is split.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tactape_fab.texture.frames import IntArray

Rule = Callable[[IntArray, int, int], IntArray]
"""Function of free rectangles (k, 4) and of a width and height that fit in them; returns a cost of each, the least is best."""

_X0, _Y0, _X1, _Y1 = range(4)


def short_side_fit(free: IntArray, width: int, height: int) -> IntArray:
    """The shorter of the two remainders: MAXRECTS-BSSF."""
    return np.asarray(np.minimum(free[:, _X1] - free[:, _X0] - width, free[:, _Y1] - free[:, _Y0] - height))


def bottom_left(free: IntArray, _: int, height: int) -> IntArray:
    """Upper edge of the placed rectangle: MAXRECTS-BL."""
    return free[:, _Y0] + height


def fill_sheets(sides: IntArray, sheet: tuple[int, int], order: Sequence[int], rule: Rule) -> IntArray:
    """Put each rectangle into the first sheet with enough space, rotated by 90 degrees if that has a lower cost.

    sides (n, 2): Widths and heights; each fits a sheet in at least one orientation.
    order: Indices of the rectangles in the order of packing.
    rule: `short_side_fit` or `bottom_left`.
    Returns (n, 4): Sheet, x, y, and whether turned, of every rectangle.
    """
    sheets: list[IntArray] = []
    places = np.empty((len(sides), 4), dtype=np.int64)
    for i in order:
        width, height = (int(side) for side in sides[i])
        found = next(((at, put) for at, free in enumerate(sheets) if (put := _best(free, width, height, rule)) is not None), None)
        if found is None:
            sheets.append(np.array([(0, 0, *sheet)], dtype=np.int64))
            put = _best(sheets[-1], width, height, rule)
            assert put is not None, "a rectangle fits no sheet"
            found = len(sheets) - 1, put
        at, (x, y, turned) = found
        places[i] = at, x, y, turned
        taken = np.array([x, y, x + (height if turned else width), y + (width if turned else height)])
        sheets[at] = _without(sheets[at], taken)
    return places


def _best(free: IntArray, width: int, height: int, rule: Rule) -> tuple[int, int, bool] | None:
    """Lower left corner, and whether rotated; None if it does not fit."""
    best: tuple[int, int, int, bool] | None = None
    for w, h, turned in ((width, height, False), (height, width, True)):
        fitting = free[(free[:, _X1] - free[:, _X0] >= w) & (free[:, _Y1] - free[:, _Y0] >= h)]
        if len(fitting):
            rank = rule(fitting, w, h)
            first = int(rank.argmin())
            if best is None or rank[first] < best[0]:
                best = int(rank[first]), int(fitting[first, _X0]), int(fitting[first, _Y0]), turned
    return None if best is None else best[1:]


def _without(free: IntArray, taken: IntArray) -> IntArray:
    """Free rectangles after `taken` is occupied: each one that it overlaps is split into the up to four that remain."""
    # open intervals: rectangles that only touch do not overlap
    overlaps = (free[:, :2] < taken[2:]).all(axis=1) & (taken[:2] < free[:, 2:]).all(axis=1)
    pieces = [free[~overlaps]]
    # the four pieces extend across the whole free rectangle and overlap
    # at its corners: maximal rectangles are kept, not a partition
    for side, edge in ((_X1, taken[_X0]), (_X0, taken[_X1]), (_Y0, taken[_Y1]), (_Y1, taken[_Y0])):
        piece = free[overlaps]
        piece[:, side] = edge
        # pieces of no width or height are dropped
        pieces.append(piece[(piece[:, :2] < piece[:, 2:]).all(axis=1)])
    # equal rectangles contain each other: without np.unique both would be dropped
    rest = np.unique(np.concatenate(pieces), axis=0)
    low, high = rest[:, :2], rest[:, 2:]
    # rectangle i contains rectangle j, shape (k, k), summed over i
    holds = ((low[:, None] <= low) & (high[:, None] >= high)).all(axis=2).sum(axis=0)
    return np.asarray(rest[holds == 1])  # each contains itself
