"""Agreeing dots -> pose: a robust least-squares fit of position, turn and, where the frame asks for it, scale."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, hypot, inf

import numpy as np

from tactape_fab.base.jit import inlined_kernel, inner_kernel, kernel
from tactape_fab.sense.decode.dots.kth import select
from tactape_fab.sense.decode.rule import AGREE_SIGMAS, SCALE_SIGMAS
from tactape_fab.texture.frames import BoolArray, FloatArray

FIT_STEPS = 5
LEAST_SIGMA_MM = 0.004
LEAST_WEIGHT = 0.15
"""Lighter dots are more likely noise than parts: they take no part in the fit."""
ONE_PLACE = 1e-9
"""Share of their squared distances from the image centre that dots in one place have from their own middle."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pose:
    """Pose of the image centre on the texture, with its covariance.

    Attributes
    ----------
    position_mm : ndarray, shape (2,)
    theta_rad : float
    px_per_mm : float
    covariance : ndarray, shape (3, 3)
        Of (x mm, y mm, theta rad).
    agree : ndarray of bool, shape (n,)
        Dots that fit.
    sigma_mm : float
        Error of one dot along one axis.
    """

    position_mm: FloatArray
    theta_rad: float
    px_per_mm: float
    covariance: FloatArray
    agree: BoolArray
    sigma_mm: float


def fit_pose(
    offset_px: FloatArray,
    texture_mm: FloatArray,
    weights: FloatArray,
    px_per_mm: float,
    *,
    fixed_scale: bool,
    least_sigma_mm: float = LEAST_SIGMA_MM,
) -> Pose:
    """Fit a pose (SPEC section 1; paper, Eq. 12, for all dots instead of one).

    Parameters
    ----------
    offset_px : ndarray, shape (n, 2)
        Dots from the image centre p0.
    texture_mm : ndarray, shape (n, 2)
        Nominal places of the same dots on the texture.
    weights : ndarray, shape (n,)
    px_per_mm : float
        The sensor profile's scale.
    fixed_scale : bool
        Never change it.
    least_sigma_mm : float
        Least error of a dot along an axis.
    """
    n = len(weights)
    fit, sums, covariance, position = np.empty(7), np.empty((2, 4)), np.zeros((3, 3)), np.empty(2)
    agree, room = np.ones(n, dtype=np.bool_), np.empty((4, n))
    px, mm = np.ascontiguousarray(offset_px), np.ascontiguousarray(texture_mm)
    w = np.ascontiguousarray(weights)
    free = _fitted(px, mm, w, px_per_mm, fixed_scale, least_sigma_mm, fit, sums, position, agree, room)
    cosine, sine, sigma = float(fit[0]), float(fit[1]), float(fit[6])
    matrices = np.zeros((2, 4, 4))
    if not np.isfinite(sums[0]).all():
        covariance[:] = np.nan
    elif not _covariance(sums, sigma, free, matrices, covariance):  # all dots in one place
        normal, meat = matrices[:, : 3 + free, : 3 + free]
        inverse = np.linalg.pinv(normal)
        covariance = sigma**2 * (inverse @ meat @ inverse)[:3, :3]
    return Pose(
        position_mm=position,
        theta_rad=atan2(sine, cosine),
        px_per_mm=1.0 / length if (length := hypot(sine, cosine)) else inf,
        covariance=covariance,
        agree=agree,
        sigma_mm=sigma,
    )


@inner_kernel()
def _similarity(px: FloatArray, mm: FloatArray, weights: FloatArray, out: FloatArray) -> None:
    """(cos / R, sin / R, middle of the pixels, middle of the texture points) of the best similarity."""
    total = u = v = x = y = 0.0
    for i in range(len(weights)):
        w = weights[i]
        total += w
        u += w * px[i, 0]
        v += w * px[i, 1]
        x += w * mm[i, 0]
        y += w * mm[i, 1]
    u, v, x, y = u / total, v / total, x / total, y / total
    along = across = den = 0.0
    for i in range(len(weights)):
        w = weights[i]
        p, q = px[i, 0] - u, px[i, 1] - v
        s, t = mm[i, 0] - x, mm[i, 1] - y
        den += w * (p * p + q * q)
        along += w * (p * s + q * t)
        across += w * (q * s - p * t)
    out[0], out[1] = along / max(den, 1e-12), across / max(den, 1e-12)
    out[2], out[3], out[4], out[5] = u, v, x, y


@inner_kernel()
def _squares(px: FloatArray, mm: FloatArray, fit: FloatArray, out: FloatArray) -> None:
    """Squared distances (mm) of texture points from where a similarity (1/R) [[cos, sin], [-sin, cos]] has them."""
    for i in range(len(px)):
        p, q = px[i, 0] - fit[2], px[i, 1] - fit[3]
        x = mm[i, 0] - fit[4] - (fit[0] * p + fit[1] * q)
        y = mm[i, 1] - fit[5] - (fit[0] * q - fit[1] * p)
        out[i] = x * x + y * y


@inlined_kernel()
def _median_distance(squares: FloatArray, weights: FloatArray, ordered: FloatArray) -> float:
    """Median distance of the dots with a weight, from squared distances; `ordered` is a work buffer."""
    n = 0
    for i in range(len(squares)):
        if weights[i] > 0.0:
            ordered[n] = np.sqrt(squares[i])
            n += 1
    if n == 0:
        return np.nan
    upper = select(ordered[:n], n // 2)
    if n % 2 == 1:
        return float(upper)
    lower = ordered[0]
    for i in range(1, n // 2):
        lower = max(lower, ordered[i])
    return float(0.5 * (lower + upper))


@inlined_kernel()
def _base_weights(weights: FloatArray, out: FloatArray) -> None:
    """Weights at most 1, zero for dots that may be noise; those of all dots where that leaves too few."""
    count = 0
    for i in range(len(weights)):
        out[i] = min(weights[i], 1.0) if weights[i] > LEAST_WEIGHT else 0.0
        count += 1 if out[i] > 0.0 else 0
    if count < 4:
        for i in range(len(weights)):
            out[i] = min(max(weights[i], LEAST_WEIGHT), 1.0)


@kernel()
def _fitted(
    px: FloatArray,
    mm: FloatArray,
    weights: FloatArray,
    px_per_mm: float,
    fixed_scale: bool,
    least_sigma_mm: float,
    fit: FloatArray,
    sums: FloatArray,
    position: FloatArray,
    agree: BoolArray,
    room: FloatArray,
) -> bool:
    """Fill `fit` (of `_similarity`, then a dot's error), the covariance's sums, the place and who agrees; whether R is free.

    `room` is a work buffer.
    """
    n = len(weights)
    base, keep, squares, ordered = room[0], room[1], room[2], room[3]
    _base_weights(weights, base)
    sigma, count = 1.0, 0.0
    for i in range(n):
        keep[i] = base[i]
    for _ in range(FIT_STEPS):
        _similarity(px, mm, keep, fit)
        if fixed_scale:
            length = np.hypot(fit[0], fit[1]) * px_per_mm
            fit[0], fit[1] = fit[0] / length, fit[1] / length
        _squares(px, mm, fit, squares)
        # the median distance of two normal axes is 1.177 sigma (Rayleigh)
        sigma, count = max(_median_distance(squares, base, ordered) / 1.177, least_sigma_mm), 0.0
        for i in range(n):
            distance = np.sqrt(squares[i])
            # weights of Geman and McClure: an outlier's influence falls to 0
            keep[i] = base[i] / (1.0 + (distance / (2.5 * sigma)) ** 2) ** 2
            agree[i] = base[i] > 0.0 and distance <= AGREE_SIGMAS * sigma * max(1.0, 0.6 / base[i])
            count += 1.0 if agree[i] else 0.0
    if count >= 4.0:
        for i in range(n):
            keep[i] = base[i] if agree[i] else 0.0
        _similarity(px, mm, keep, fit)
        _squares(px, mm, fit, squares)
        square = kept = 0.0
        for i in range(n):
            square += keep[i] * squares[i]
            kept += keep[i]
        # 2 n coordinates less the 4 parameters of a similarity
        sigma = max(np.sqrt(square / (kept / count) / max(2.0 * count - 4.0, 1.0)), least_sigma_mm)
    free = _scaled(px, keep, px_per_mm, fixed_scale, sigma, count, fit)
    fit[6] = sigma
    # S: the texture point of the image centre, where p is 0 (paper, Eq. 12)
    position[0] = fit[4] - (fit[0] * fit[2] + fit[1] * fit[3])
    position[1] = fit[5] - (fit[0] * fit[3] - fit[1] * fit[2])
    _sum_up(px, keep, fit, sums)
    return bool(free)


@inlined_kernel()
def _scaled(
    px: FloatArray, weights: FloatArray, px_per_mm: float, fixed_scale: bool, sigma: float, count: float, fit: FloatArray
) -> bool:
    """Whether the fit keeps its own scale; otherwise it is given the profile's."""
    spread = total = 0.0
    for i in range(len(weights)):
        spread += weights[i] * ((px[i, 0] - fit[2]) ** 2 + (px[i, 1] - fit[3]) ** 2)
        total += weights[i]
    scale = 1.0 / np.hypot(fit[0], fit[1])
    # error of R by propagation, as that of theta: sigma in px, over the root of the sum of squared distances, times R
    scale_sigma = sigma * scale * scale / np.sqrt(max(spread / (total / max(count, 1.0)), 1e-9))
    if not fixed_scale and abs(scale - px_per_mm) > SCALE_SIGMAS * scale_sigma:
        return True
    fit[0], fit[1] = fit[0] * (scale / px_per_mm), fit[1] * (scale / px_per_mm)
    return False


@inlined_kernel()
def _sum_up(px: FloatArray, weights: FloatArray, fit: FloatArray, sums: FloatArray) -> None:
    """Sums of w, w u, w v and w (u^2 + v^2) over the dots, of their weights and of the squares of those; shape (2, 4)."""
    for power in range(2):
        total = along = across = square = 0.0
        for i in range(len(weights)):
            u = fit[0] * px[i, 0] + fit[1] * px[i, 1]
            v = fit[0] * px[i, 1] - fit[1] * px[i, 0]
            w = weights[i] if power == 0 else weights[i] * weights[i]
            total += w
            along += w * u
            across += w * v
            square += w * (u * u + v * v)
        sums[power, 0], sums[power, 1], sums[power, 2], sums[power, 3] = total, along, across, square


@kernel()
def _covariance(sums: FloatArray, sigma: float, free: bool, matrices: FloatArray, out: FloatArray) -> bool:
    """Fill the covariance of (x, y, theta) for dots of equal error weighted as they were, the scale estimated or given.

    The errors of docs/trust.md, in place of those of one pair of dots (paper, Eqs. 17 and 18). The weights are not the inverse
    variances, so it is sigma^2 inverse meat inverse. Where all dots are in one place there is none: `matrices`, zero before, are
    the two normal ones then.
    """
    total, u, v, square = sums[0, 0], sums[0, 1], sums[0, 2], sums[0, 3]
    inverse, meat, size = matrices[0], matrices[1], 4 if free else 3
    _normal(meat, sums[1, 0], sums[1, 1], sums[1, 2], sums[1, 3], free)
    about_middle = square - (u * u + v * v) / max(total, 1e-300)
    if not about_middle > ONE_PLACE * square:
        _normal(inverse, total, u, v, square, free)
        return False
    # the inverse of `_normal`, written out
    both = total * about_middle
    _normal(inverse, square / both, -u / both, -v / both, 1.0 / about_middle, free)
    if not free:
        inverse[0, 0] = 1.0 / total + v * v / (total * both)
        inverse[1, 1] = 1.0 / total + u * u / (total * both)
        inverse[0, 1] = inverse[1, 0] = -u * v / (total * both)
    for a in range(3):
        for b in range(3):
            for k in range(size):
                for j in range(size):
                    out[a, b] += sigma * sigma * inverse[a, k] * meat[k, j] * inverse[j, b]
    return True


@inner_kernel()
def _normal(out: FloatArray, total: float, u: float, v: float, square: float, free: bool) -> None:
    """Normal matrix from the sums of w, w u, w v and w (u^2 + v^2).

    texture = S + A q, with A q = (u, v), has the derivatives 1, (v, -u) and (u, v) by S, theta and ln(1 / R).
    """
    out[0, 0] = out[1, 1] = total
    out[0, 2] = out[2, 0] = v
    out[1, 2] = out[2, 1] = -u
    out[2, 2] = square
    if free:
        out[0, 3] = out[3, 0] = u
        out[1, 3] = out[3, 1] = v
        out[3, 3] = square
