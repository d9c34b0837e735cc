"""Dots -> soft symbols: grid and displacements are fitted together, then each dot gets a posterior over the symbols.

The paper takes the nearest grid point and a 45 degree quadrant instead (section III-A.4).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from tactape_fab.base.jit import inlined_kernel, kernel
from tactape_fab.sense.decode.dots.clip import clip
from tactape_fab.sense.decode.rule import (
    GOOD_WEIGHT,
    LEAST_SIGMA,
    LEAST_WEIGHT,
    MOST_SIGMA,
    OUTLIER_SHARE,
    RIM_ERROR,
    USUAL_COUNT,
    USUAL_SIGMA,
    WRONG_SHARE,
)
from tactape_fab.texture.frames import FloatArray

Ints = npt.NDArray[np.int64]
Grid = tuple[float, float, float, float]
"""(a, b, x, y): a grid point (k, l) lies at (x + a k - b l, y + b k + a l)."""

FIT_STEPS = 6
FEW_DOTS = 40.0
"""With fewer dots, displaced at random, the initial grid can be off by half a displacement: the fit tries `STARTS` as well."""
# half of the 16 choices of signs, a fractional factorial design: the sign of the fourth is the product of the others, so that
# of any three of the four all eight choices are there
STARTS = np.array([[a, p, x, a * p * x] for a in (-1.0, 1.0) for p in (-1.0, 1.0) for x in (-1.0, 1.0)]) * (
    0.03,
    0.04,
    0.06,
    0.06,
)
"""Offsets of the other starts: angle (rad), pitch (share) and both phases (pitches)."""
LARGEST_LN = 700.0
"""Exponents are clamped to this, below overflow; a dot so far from all its places fits none of them anyway."""
HALF = np.sqrt(0.5)
"""Component of a unit diagonal displacement along each axis."""
SMALL_SIGMA = 0.02
"""Up to this sigma (pitches), a fit whose likelihood is as expected is the right one."""


class Fit(NamedTuple):
    """A grid fitted to dots.

    grid (4,): (a, b, x, y): a grid point (k, l) lies at (x + a k - b l, y + b k + a l).
    nodes (n, 2): Grid point of each dot.
    squares (n, directions): Squared distances, in pitches squared, from the displaced places of the dot's grid point: along +a,
        +b, -a, -b; of eight directions with those between, from +a to +b and on.
    sigma: Standard deviation of a good dot along one axis, in pitches.
    value: Log likelihood.
    expected: Whether sigma is small and the log likelihood is not below what such a sigma gives.
    """

    grid: FloatArray
    nodes: Ints
    squares: FloatArray
    sigma: float
    value: float
    expected: bool


def fit_grid(
    xy: FloatArray,
    weights: FloatArray,
    trust: FloatArray,
    angle: float,
    pitch: float,
    phase_a: float,
    phase_b: float,
    shift: float,
    free_scale: bool,
    directions: int = 4,
) -> Fit:
    """Fit angle, pitch and origin of a grid whose every dot is displaced along one of four directions, or of eight.

    Expectation maximisation of a mixture of the directions and outliers.

    xy (n, 2): Dots from their centroid, px.
    weights (n,): Heights over that of a fully imprinted dot, at most 1.
    trust (n,)
    angle, pitch, phase_a, phase_b: From `lattice.find_lattices`.
    shift: Displacement as a share of the pitch.
    free_scale: Whether the pitch may change.
    directions {4, 8}
    """
    n = len(weights)
    nodes, squares, grid = np.empty((n, 2), dtype=np.int64), np.empty((n, directions)), np.empty(4)
    # `_fitted` keeps in the buffer where a dot would stand on the grid (two columns, pitches), and its weight in the fit
    turns, buffer = 2.0 * np.pi, np.empty((n, 3))
    start = (angle, pitch, phase_a / turns, phase_b / turns)
    sigma, value, expected = _best_fit(xy, weights, trust, start, shift, free_scale, STARTS, buffer, grid, nodes, squares)
    return Fit(grid, nodes, squares, sigma, value, expected)


@kernel()
def _best_fit(
    xy: FloatArray,
    weights: FloatArray,
    trust: FloatArray,
    start: Grid,
    shift: float,
    free_scale: bool,
    starts: FloatArray,
    buffer: FloatArray,
    out: FloatArray,
    nodes: Ints,
    squares: FloatArray,
) -> tuple[float, float, bool]:
    """Fill in the likeliest grid and `_nearest`; all starts are tried if dots are few and the first fit is not `_as_expected`.

    Returns sigma of a good dot, the log likelihood, and whether they are `_as_expected`.
    """
    dots = best_sigma = most = 0.0
    directions, expected = squares.shape[1], False
    for i in range(len(trust)):
        dots += trust[i]
    for m in range(-1, len(starts)):
        angle, pitch, phase_a, phase_b = start
        if m >= 0:
            angle, phase_a, phase_b = angle + starts[m, 0], phase_a + starts[m, 2], phase_b + starts[m, 3]
            if free_scale:
                pitch *= 1.0 + starts[m, 1]
        begun = _grid(angle, pitch, phase_a, phase_b)
        grid, sigma, value = _fitted(xy, weights, trust, begun, shift, directions, free_scale, buffer)
        # likelihoods of all starts are of the same dots and of as many unknowns: they compare as they are, without a penalty
        if m < 0 or value > most:
            out[0], out[1], out[2], out[3] = grid
            best_sigma, most = sigma, value
            expected = _as_expected(weights, trust, directions, sigma, value)
        # a fit as likely as its small errors allow leaves other starts little to gain; and of many dots the grid is plain
        if m < 0 and (expected or dots >= FEW_DOTS):
            break
    _nearest(xy, out, shift, nodes, squares)
    return best_sigma, most, expected


@inlined_kernel()
def _nearest(xy: FloatArray, grid: FloatArray, shift: float, nodes: Ints, squares: FloatArray) -> None:
    """Fill in the grid point of each dot and the squared distances from its displaced places, as `Fit.squares`."""
    for i in range(len(xy)):
        k, j = _on_grid((grid[0], grid[1], grid[2], grid[3]), xy[i, 0], xy[i, 1])
        # a displacement is less than half a pitch, so the nearest grid point is the dot's own (paper, section III-A.4)
        nodes[i, 0], nodes[i, 1] = round(k), round(j)
        e, f = k - nodes[i, 0], j - nodes[i, 1]
        step, aside = squares.shape[1] // 4, HALF * shift
        # four places: entries 0 to 3 are +a, +b, -a, -b; eight: these are 0, 2, 4, 6, and the diagonals stand between
        squares[i, 0] = (e - shift) ** 2 + f**2
        squares[i, step] = e**2 + (f - shift) ** 2
        squares[i, 2 * step] = (e + shift) ** 2 + f**2
        squares[i, 3 * step] = e**2 + (f + shift) ** 2
        if step == 2:
            squares[i, 1] = (e - aside) ** 2 + (f - aside) ** 2
            squares[i, 3] = (e + aside) ** 2 + (f - aside) ** 2
            squares[i, 5] = (e + aside) ** 2 + (f + aside) ** 2
            squares[i, 7] = (e - aside) ** 2 + (f + aside) ** 2


@inlined_kernel()
def _grid(angle: float, pitch: float, phase_a: float, phase_b: float) -> Grid:
    """(a, b, x, y) of a grid whose phases are in pitches."""
    # the phase of a sum of exp(2 pi i k.x) over dots of a grid is k times its origin, so the phases are x and y along its axes
    a, b = pitch * np.cos(angle), pitch * np.sin(angle)
    return a, b, phase_a * a - phase_b * b, phase_a * b + phase_b * a


@inlined_kernel()
def _on_grid(grid: Grid, u: float, v: float) -> tuple[float, float]:
    """A point in grid coordinates (k, l), in pitches."""
    a, b = grid[0], grid[1]
    du, dv = u - grid[2], v - grid[3]
    norm = a * a + b * b
    # the inverse of the similarity [[a, -b], [b, a]] is its transpose over a^2 + b^2
    return (a * du + b * dv) / norm, (a * dv - b * du) / norm


@inlined_kernel()
def squared_error(weight: float, sigma: float) -> float:
    """`rule.squared_errors` of one dot."""
    noise = sigma / clip(weight, LEAST_WEIGHT, 1.0)
    rim = RIM_ERROR * clip(1.0 - weight, 0.0, 1.0)
    return float(noise * noise + rim * rim)


@kernel()
def _fitted(
    xy: FloatArray,
    weights: FloatArray,
    trust: FloatArray,
    start: Grid,
    shift: float,
    directions: int,
    free_scale: bool,
    buffer: FloatArray,
) -> tuple[Grid, float, float]:
    """The grid fitted from one start, sigma of a good dot, and the log likelihood; `buffer` is a work buffer."""
    n = len(weights)
    # the widest error first: a start that is somewhat off still explains its dots
    grid, sigma, value = start, MOST_SIGMA, 0.0
    for step in range(FIT_STEPS):
        value, square, count = 0.0, USUAL_COUNT * USUAL_SIGMA**2, USUAL_COUNT
        for i in range(n):
            k, j = _on_grid(grid, xy[i, 0], xy[i, 1])
            node_k, node_j = round(k), round(j)
            e, f = k - node_k, j - node_j
            variance = squared_error(weights[i], sigma)
            # exp(-d / 2 variance) of the four places share all but exp(+-shift e / variance), exp(+-shift f / variance)
            east = np.exp(clip(shift * e / variance, -LARGEST_LN, LARGEST_LN))
            south = np.exp(clip(shift * f / variance, -LARGEST_LN, LARGEST_LN))
            west, north = 1.0 / east, 1.0 / south
            total = east + west + south + north
            to_east, to_south = east - west, south - north
            if directions == 8:
                diagonals, sideways, down = _between(e, f, HALF * shift / variance)
                total += diagonals
                to_east += HALF * sideways
                to_south += HALF * down
            common = e * e + f * f + shift * shift
            part = trust[i] * (1.0 - OUTLIER_SHARE)
            # E step: the density of `rule.posteriors`, and the probability that the dot stands at one of its places
            density = part * np.exp(-0.5 * common / variance) * total / (2.0 * directions * np.pi * variance)
            fits = density / (density + 1.0 - part)
            # displacement expected under the posteriors of the directions (s Delta of paper, Eq. 9, not decided yet)
            along, across = shift * to_east / total, shift * to_south / total
            buffer[i, 0], buffer[i, 1], buffer[i, 2] = node_k + along, node_j + across, fits / variance
            # the likelihood is that of the grid returned, which the last step leaves as it is, and of the sigma before it
            if step == FIT_STEPS - 1:
                value += np.log(density + 1.0 - part)
            # lower dots have the rim's error, whose size is known: sigma is of those without
            if weights[i] >= GOOD_WEIGHT:
                # expected squared distance from the place; it has two axes
                square += fits * (common - 2.0 * (along * e + across * f))
                count += 2.0 * fits
        # M step: sigma as `rule.sigma_of`, not from the start's distances; then the grid
        if step > 0:
            sigma = clip(np.sqrt(square / count), LEAST_SIGMA, MOST_SIGMA)
        if step < FIT_STEPS - 1:
            grid = _moved(xy, buffer, grid, free_scale)
    return grid, sigma, value


@inlined_kernel()
def _between(e: float, f: float, share: float) -> tuple[float, float, float]:
    """Terms of the four diagonal places: in the sum over all places, and in its first moments along +a and +b."""
    # the places (+-h, +-h) shift, h = sqrt(1/2), are as far from the grid point as those on the axes: exp(shift h (+-e +- f) /
    # variance) is all that tells them apart, and the common factor is the caller's
    down = np.exp(clip(share * (e + f), -LARGEST_LN, LARGEST_LN))
    up = np.exp(clip(share * (e - f), -LARGEST_LN, LARGEST_LN))
    against_down, against_up = 1.0 / down, 1.0 / up
    along, across = down - against_down, up - against_up
    return down + against_down + up + against_up, along + across, along - across


@inlined_kernel()
def _as_expected(weights: FloatArray, trust: FloatArray, directions: int, sigma: float, value: float) -> bool:
    """Whether sigma is small, and the log likelihood at most one standard deviation below its expected value."""
    # for a part, d^2 / 2 variance has mean 1 and standard deviation 1 (two normal axes): sqrt(n) for n dots.
    # A part stands at one place of density trust / directions; the other places are too far to matter while sigma is small.
    # An outlier has the density 1 - trust in its cell of area 1
    expected = 0.0
    for i in range(len(weights)):
        if trust[i] > 0.5:
            expected += np.log(trust[i] / (2.0 * directions * np.pi * squared_error(weights[i], sigma))) - 1.0
        else:
            expected += np.log(1.0 - trust[i])
    return sigma < SMALL_SIGMA and value > expected - np.sqrt(len(weights))


@inlined_kernel()
def _moved(xy: FloatArray, ideal: FloatArray, grid: Grid, free_scale: bool) -> Grid:
    """Weighted least-squares grid that maps the dots' expected grid coordinates to `xy`; keeps the pitch unless `free_scale`.

    ideal (n, 3): Expected k and l, and weight of each dot.
    """
    sw = su = sv = sx = sy = 0.0
    for i in range(len(xy)):
        w = ideal[i, 2]
        sw += w
        su += w * ideal[i, 0]
        sv += w * ideal[i, 1]
        sx += w * xy[i, 0]
        sy += w * xy[i, 1]
    # about the weighted means the origin drops out of the equations for a and b: it follows from them at the end
    mu, mv, mx, my = su / sw, sv / sw, sx / sw, sy / sw
    # normal equations of x = a u - b v, y = b u + a v about the weighted middles
    num_a = num_b = den = 0.0
    for i in range(len(xy)):
        u, v, w = ideal[i, 0] - mu, ideal[i, 1] - mv, ideal[i, 2]
        px, py = xy[i, 0] - mx, xy[i, 1] - my
        num_a += w * (u * px + v * py)
        num_b += w * (u * py - v * px)
        den += w * (u * u + v * v)
    # dots that all fit one grid point leave no spread
    den = clip(den, 1e-12, np.inf)
    a, b = num_a / den, num_b / den
    # with |(a, b)| held, least squares maximises a num_a + b num_b: the direction of the free solution, scaled to the old pitch
    if not free_scale:
        factor = np.sqrt((grid[0] ** 2 + grid[1] ** 2) / (a * a + b * b))
        a, b = factor * a, factor * b
    return a, b, mx - (a * mu - b * mv), my - (b * mu + a * mv)


def posteriors(nodes: Ints, squares: FloatArray, weights: FloatArray, trust: FloatArray, sigma: float) -> FloatArray:
    """Posterior of each dot's symbol before any tape is looked at; shape (n, directions), rows sum to 1.

    As `rule.posteriors`: Gaussian errors, wider for low dots, and uniform outliers. Of several dots at one grid point only the
    likeliest counts: E has the mean 1 only if each bit is a factor once.
    """
    q = np.empty(squares.shape)
    _fill_posteriors(nodes, squares, weights, trust, sigma, q)
    return q


@kernel()
def _fill_posteriors(
    nodes: Ints, squares: FloatArray, weights: FloatArray, trust: FloatArray, sigma: float, q: FloatArray
) -> None:
    """Fill in `posteriors`; a dot with a likelier one on its grid point is an outlier."""
    n, places = len(weights), squares.shape[1]
    for i in range(n):
        part = trust[i] * (1.0 - OUTLIER_SHARE)
        for k in range(n):
            if k != i and nodes[k, 0] == nodes[i, 0] and nodes[k, 1] == nodes[i, 1]:
                mine, other = trust[i] * weights[i], trust[k] * weights[k]
                if other > mine or (other == mine and k < i):
                    part = 0.0
        variance = squared_error(weights[i], sigma)
        total = 0.0
        for k in range(places):
            # no exponent is brought to 0 first: where all underflow the dot is an outlier, and the sum below is still 1 - part
            q[i, k] = np.exp(-0.5 * squares[i, k] / variance) / (2.0 * np.pi * variance) / places
            total += q[i, k]
        # an outlier lies anywhere in its cell of area 1
        for k in range(places):
            q[i, k] = (part * q[i, k] + (1.0 - part) / places) / (part * total + 1.0 - part)
            q[i, k] = (1.0 - WRONG_SHARE) * q[i, k] + WRONG_SHARE / places
