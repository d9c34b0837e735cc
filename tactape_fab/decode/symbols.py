"""Dots on their grid -> soft symbols: a robust fit of grid and displacements together, and what each dot says of its symbol."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from tactape_fab.texture.frames import FloatArray

Ints = npt.NDArray[np.int64]

FIT_STEPS = 4
LEAST_SIGMA, MOST_SIGMA = 0.012, 0.06
"""Bounds of a good dot's error as a share of the pitch: 18 to 90 um at 1.5 mm."""
OUTLIER_SHARE = 0.01
"""Share of good dots whose position says nothing of a symbol all the same."""
GOOD_WEIGHT, RIM_ERROR = 0.8, 0.15
"""Dots below the first weight stand at the contact's rim, where its slope moves them: error in pitches per unit of weight."""


@njit(cache=True, error_model="numpy")
def _similarity(xy: FloatArray, ideal: FloatArray, weights: FloatArray) -> tuple[float, float, float, float]:
    """(a, b, x, y) that carry ideal grid coordinates (k, j) to (x + a k - b j, y + b k + a j), by weighted least squares."""
    sw = su = sv = sx = sy = 0.0
    for i in range(len(weights)):
        w = weights[i]
        sw += w
        su += w * ideal[i, 0]
        sv += w * ideal[i, 1]
        sx += w * xy[i, 0]
        sy += w * xy[i, 1]
    mu, mv, mx, my = su / sw, sv / sw, sx / sw, sy / sw
    num_a = num_b = den = 0.0
    for i in range(len(weights)):
        u, v = ideal[i, 0] - mu, ideal[i, 1] - mv
        px, py = xy[i, 0] - mx, xy[i, 1] - my
        num_a += weights[i] * (u * px + v * py)
        num_b += weights[i] * (u * py - v * px)
        den += weights[i] * (u * u + v * v)
    a, b = num_a / max(den, 1e-12), num_b / max(den, 1e-12)
    return a, b, mx - (a * mu - b * mv), my - (b * mu + a * mv)


@njit(cache=True, error_model="numpy")
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
) -> tuple[FloatArray, Ints, FloatArray, float]:
    """Fit angle, pitch and place of a grid whose every dot is displaced along one of four directions.

    Parameters
    ----------
    xy : ndarray, shape (n, 2)
        Dots about their middle, px.
    angle, pitch, phase_a, phase_b : float
        From `lattice.find_lattices`.
    shift : float
        Displacement as a share of the pitch.
    free_scale : bool
        Whether the pitch may change.

    Returns
    -------
    grid : ndarray, shape (4,)
        (a, b, x, y): a grid point (k, l) lies at (x + a k - b l, y + b k + a l).
    nodes : ndarray of int, shape (n, 2)
        Grid point of each dot.
    squares : ndarray, shape (n, 4)
        Squared distances from the four places of the dot's grid point (+a axis, +b axis, -a, -b), in pitches squared.
    sigma : float
        Robust error of a dot along one axis, in pitches.
    """
    n = len(weights)
    a, b = pitch * np.cos(angle), pitch * np.sin(angle)
    pa, pb = phase_a / (2 * np.pi), phase_b / (2 * np.pi)
    x = pa * a - pb * b
    y = pa * b + pb * a
    nodes = np.empty((n, 2), dtype=np.int64)
    squares = np.empty((n, 4))
    best = np.empty(n)
    ideal = np.empty((n, 2))
    sigma = MOST_SIGMA
    for step in range(FIT_STEPS):
        norm = a * a + b * b
        for i in range(n):
            dx, dy = xy[i, 0] - x, xy[i, 1] - y
            k = (a * dx + b * dy) / norm
            j = (a * dy - b * dx) / norm
            nodes[i, 0], nodes[i, 1] = round(k), round(j)
            ek, el = k - nodes[i, 0], j - nodes[i, 1]
            squares[i, 0] = (ek - shift) ** 2 + el**2
            squares[i, 1] = ek**2 + (el - shift) ** 2
            squares[i, 2] = (ek + shift) ** 2 + el**2
            squares[i, 3] = ek**2 + (el + shift) ** 2
            s = np.argmin(squares[i])
            best[i] = squares[i, s]
            ideal[i, 0] = nodes[i, 0] + (shift if s == 0 else -shift if s == 2 else 0.0)
            ideal[i, 1] = nodes[i, 1] + (shift if s == 1 else -shift if s == 3 else 0.0)
        good = best[(trust > 0.5) & (weights > GOOD_WEIGHT)]
        if len(good) >= 4:  # the median of a Rayleigh variable is 1.177 sigma
            sigma = min(max(np.sqrt(np.median(good)) / 1.177, LEAST_SIGMA), MOST_SIGMA)
        if step == FIT_STEPS - 1:
            break
        for i in range(n):
            rim = RIM_ERROR * max(GOOD_WEIGHT - weights[i], 0.0)
            square = sigma * sigma + rim * rim
            best[i] = trust[i] * sigma * sigma / square / (1.0 + best[i] / (4.0 * square)) ** 2
        a, b, x, y = _similarity(xy, ideal, best)
        if not free_scale:
            length = np.sqrt(a * a + b * b)
            turned_a, turned_b = a * pitch / length, b * pitch / length
            total = best.sum()
            mu, mv = (best * ideal[:, 0]).sum() / total, (best * ideal[:, 1]).sum() / total
            x += (a - turned_a) * mu - (b - turned_b) * mv
            y += (b - turned_b) * mu + (a - turned_a) * mv
            a, b = turned_a, turned_b
    grid = np.array([a, b, x, y])
    return grid, nodes, squares, sigma


@njit(cache=True, error_model="numpy")
def posteriors(squares: FloatArray, weights: FloatArray, trust: FloatArray, sigma: float) -> FloatArray:
    """What each dot says of its symbol before any tape is looked at; shape (n, 4), rows sum to 1.

    Gaussian error, wider for dots at the rim, and outliers whose place says nothing.
    """
    n = len(weights)
    q = np.empty((n, 4))
    for i in range(n):
        rim = RIM_ERROR * max(GOOD_WEIGHT - weights[i], 0.0)
        square = sigma * sigma + rim * rim
        total = 0.0
        for k in range(4):
            q[i, k] = np.exp(-0.5 * squares[i, k] / square) / (2.0 * np.pi * square) / 4.0
            total += q[i, k]
        # an outlier lies anywhere in its cell of area 1
        part = trust[i] * (1.0 - OUTLIER_SHARE)
        for k in range(4):
            q[i, k] = (part * q[i, k] + (1.0 - part) / 4.0) / (part * total + 1.0 - part)
    return q
