"""Dots -> orientation modulo 90 degrees, grid lines and symbols (paper, section III-A.2 to III-A.4)."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, pi, sin

import numpy as np

from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray, IntArray

TOLERANCE = 0.3
"""Largest misfit of a distance, as a fraction of delta; the paper gives none. At 0.5 every distance would fit."""
LEAST_FITTING = 0.7
"""Share of the dots that must fit a baseline; the paper says all, which one dot torn at the contact's rim would undo.
Too low for scattered dots to be refused here: they fail at the symbols."""
DUPLICATE = 0.5
"""Sorted coordinates nearer than this fraction of delta are one value."""


def turned(xy: FloatArray, theta_rad: float) -> FloatArray:
    """Image directions in a frame turned by `theta_rad`: the matrix of Eq. 12, row vectors; shape (..., 2)."""
    c, s = cos(theta_rad), sin(theta_rad)
    return np.asarray(xy @ np.array([(c, -s), (s, c)]), dtype=np.float64)


def spacing_misfit(distance_px: FloatArray, w_px: float, delta_px: float) -> FloatArray:
    """Misfit of distances from a baseline to the nearest ``m w + n delta`` (Eq. 4), px, same shape.

    Reading: n runs over -2 ... 2. The paper lists 0, 1, 2 for a distance without a sign; a baseline through dots that
    are displaced to one side has lines at ``m w - 2 delta`` on the other.
    """
    # Eq. 4 with m the nearest whole number: what is left is from -w / 2 to w / 2, and n delta with |n| <= 2 is within it for
    # delta = w / 6
    rest = distance_px - w_px * np.rint(distance_px / w_px)
    return np.abs(rest - delta_px * np.clip(np.rint(rest / delta_px), -2, 2))


def find_baseline(xy_px: FloatArray, anchor: int, w_px: float, delta_px: float) -> float | None:
    """Slope of the grid from the best baseline through one dot (Eq. 4 and 5), O(n) pairs.

    Readings: the single dot of the paper is the contact dot, which it calls the best one. Of the pairs whose line
    `LEAST_FITTING` of all dots fit, that with the least rms misfit is taken; the paper takes any. Dots nearer than w / 2
    are not taken as two parts.

    xy_px (n, 2)
    anchor: Index of the dot that every tried pair holds.
    Returns: Angle such that `turned` lays the grid along the axes, rad, in [-pi/4, pi/4]; None where no pair fits.
    """
    offset = xy_px - xy_px[anchor]
    length = np.hypot(offset[:, 0], offset[:, 1])
    other = offset[length > w_px / 2]
    if len(other) == 0:
        return None
    # (u, v) -> (-v, u) / length: the unit normal of the line through both dots
    normal = other[:, ::-1] * (-1.0, 1.0) / np.hypot(other[:, 0], other[:, 1])[:, None]
    misfit = spacing_misfit(np.abs(normal @ offset.T), w_px, delta_px)  # (pairs, n)
    fitting = (misfit <= TOLERANCE * delta_px).mean(axis=1) >= LEAST_FITTING
    if not fitting.any():
        return None
    best = int(np.where(fitting, (misfit**2).mean(axis=1), np.inf).argmin())
    # theta_slope modulo 90 degrees, the rest is theta_A (Eq. 5)
    slope = atan2(other[best, 1], other[best, 0])
    return slope - pi / 2 * round(slope / (pi / 2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Values:
    """One coordinate of all dots, sorted, duplicates as one: ``y'_(n)`` of Eq. 6 and ``M_n`` of Eq. 8.

    value (k,): Ascending, the mean of each group of duplicates, px.
    count (k,): Dots in each group.
    group (n,): Group of each dot, in the dots' order.
    """

    value: FloatArray
    count: IntArray
    group: IntArray


def distinct_values(coordinate_px: FloatArray, delta_px: float) -> Values:
    """Sort and remove duplicates (Eq. 6). Reading: duplicates are neighbours nearer than half a delta; their mean stays."""
    order = np.argsort(coordinate_px, kind="stable")
    ranked = coordinate_px[order]
    group = np.empty(len(order), dtype=np.int64)
    # a gap begins the next group: a chain of near values stays one, however long it gets
    group[order] = np.concatenate(([0], np.cumsum(np.diff(ranked) > DUPLICATE * delta_px)))
    count = np.bincount(group).astype(np.int64)
    return Values(value=np.bincount(group, weights=coordinate_px) / count, count=count, group=group)


def _is_delta(gap_px: FloatArray, delta_px: float) -> IntArray:
    """Places where a gap is one delta."""
    return np.flatnonzero(np.abs(gap_px - delta_px) <= TOLERANCE * delta_px)


def equidistant(values: Values, near_px: float, delta_px: float) -> int | None:
    """Case A (Eq. 6): index n of a value that has neighbours at -delta and +delta, hence a grid line.

    Reading: of several, the one nearest `near_px` (the contact dot), where dots are best and the symbols are read.
    """
    fits = _is_delta(np.diff(values.value), delta_px)
    # gap k is from value k to k + 1: of gaps k and k + 1 that are both a delta the value between is k + 1
    centre = np.intersect1d(fits, fits - 1, assume_unique=True) + 1
    return int(centre[np.abs(values.value[centre] - near_px).argmin()]) if len(centre) else None


def deduced(known: Values, n: int, other: Values, distance2: FloatArray) -> float:
    """Case BC (Eq. 7): the line across, from value `n` of the known axis and a nearby dot.

    B: a dot beside the known line, at ``n +- 1``, is displaced across it, so that its other coordinate is the line.
    C: a dot on the known line is displaced along it; the line is the nearest other value of the other axis.
    Reading: nearby is nearest the contact dot, `distance2` being the squared distance of each dot to it.
    """
    candidates = np.flatnonzero(np.abs(known.group - n) <= 1)
    dot = int(candidates[distance2[candidates].argmin()])
    own = other.value[other.group[dot]]
    if known.group[dot] != n or len(other.value) == 1:
        return float(own)
    rest = np.delete(other.value, other.group[dot])
    return float(rest[np.abs(rest - own).argmin()])


def most_probable(values: Values, delta_px: float) -> float | None:
    """Case D (Eq. 8): of two values one delta apart, the one more dots share; None where no two are.

    Reading: the paper draws by ``P = M_n / (M_n + M_n+-1)``; here the value of the greatest P is taken (of equals, the
    one with more dots, then the first), so that a frame has one answer.
    """
    lower = _is_delta(np.diff(values.value), delta_px)
    if len(lower) == 0:
        return None
    this = np.concatenate((lower, lower + 1))
    that = np.concatenate((lower + 1, lower))
    share = values.count[this] / (values.count[this] + values.count[that])
    # lexsort's last key counts first: by P, then by the count, then by the order of the values
    return float(values.value[this[np.lexsort((-values.count[this], -share))[0]]])


def find_grid(xy_px: FloatArray, contact: int, delta_px: float) -> tuple[float, float] | None:
    """A grid point of dots that lie along the axes (Eq. 6-8); None where no two values are one delta apart.

    xy_px (n, 2): Turned dots (x', y').
    contact: Index of the contact dot.
    """
    x, y = (distinct_values(xy_px[:, axis], delta_px) for axis in (0, 1))
    near_x, near_y = xy_px[contact]
    n_x, n_y = equidistant(x, near_x, delta_px), equidistant(y, near_y, delta_px)
    if n_x is not None and n_y is not None:
        return float(x.value[n_x]), float(y.value[n_y])
    distance2 = ((xy_px - xy_px[contact]) ** 2).sum(axis=1)
    if n_y is not None:
        return deduced(y, n_y, x, distance2), float(y.value[n_y])
    if n_x is not None:
        return float(x.value[n_x]), deduced(x, n_x, y, distance2)
    x_g, y_g = most_probable(x, delta_px), most_probable(y, delta_px)
    return None if x_g is None or y_g is None else (x_g, y_g)


def quadrant(offset_px: FloatArray) -> IntArray:
    """Symbol values of displacements from their grid points by 45-degree quadrants (Fig. 6c); (n, 2) -> (n,)."""
    return np.asarray((offset_px @ DIRECTIONS_XY[:4].T).argmax(axis=1), dtype=np.int64)


def read_symbols(
    xy_px: FloatArray, contact: int, grid_xy_px: tuple[float, float], w_px: float, delta_px: float, side: int
) -> IntArray:
    """Symbols around the contact dot (section III-A.4): each dot goes to its nearest grid point.

    Reading: of two dots at one grid point, the one whose displacement is nearest delta.

    xy_px (n, 2): Turned dots.
    contact: Index of the contact dot, whose grid point is the middle of the patch.
    grid_xy_px: Any grid point.
    side: Side of the patch, odd: 5 for the 4x4 codes.
    Returns (side, side): Symbol values in the turned frame, -1 without a dot.
    """
    cell = np.rint((xy_px - grid_xy_px) / w_px)
    offset = xy_px - grid_xy_px - cell * w_px
    place = cell - cell[contact] + side // 2
    misfit = np.abs(np.hypot(offset[:, 0], offset[:, 1]) - delta_px)
    inside = np.flatnonzero(((place >= 0) & (place < side)).all(axis=1))
    inside = inside[np.argsort(-misfit[inside], kind="stable")]  # the best is written last
    patch = np.full((side, side), -1, dtype=np.int64)
    column, row = place[inside].astype(np.int64).T
    patch[row, column] = quadrant(offset[inside])
    return patch
