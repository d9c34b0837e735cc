"""Agreeing dots -> pose: a robust least-squares fit of position, turn and, where the frame asks for it, scale."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, hypot, inf

import numpy as np
from numba import njit

from tactape_fab.texture.code import BoolArray
from tactape_fab.texture.frames import FloatArray

FIT_STEPS = 5
AGREE_SIGMAS = 3.5
LEAST_SIGMA_MM = 0.004
LEAST_WEIGHT = 0.15
"""Lighter dots are more likely noise than parts: they take no part in the fit."""
SCALE_SIGMAS = 2.5
"""The profile's scale is kept where the frame's own estimate lies within so many standard deviations of it."""
ONE_PLACE = 1e-9
"""Share of their squared distances from the image centre that dots in one place have from their own middle."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pose:
    """Where the image centre lies on the texture.

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


def fit_pose(offset_px: FloatArray, texture_mm: FloatArray, weights: FloatArray, px_per_mm: float, *, fixed_scale: bool) -> Pose:
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
    """
    position, cosine, sine, covariance, agree, sigma = _fitted(
        np.ascontiguousarray(offset_px), np.ascontiguousarray(texture_mm), np.ascontiguousarray(weights), px_per_mm, fixed_scale
    )
    return Pose(
        position_mm=position,
        theta_rad=atan2(sine, cosine),
        px_per_mm=1.0 / length if (length := hypot(sine, cosine)) else inf,
        covariance=covariance,
        agree=agree,
        sigma_mm=sigma,
    )


@njit(cache=True, error_model="numpy")
def _similarity(px: FloatArray, mm: FloatArray, weights: FloatArray) -> FloatArray:
    """(cos / R, sin / R, middle of the pixels, middle of the texture points) of the best similarity."""
    out = np.zeros(6)
    total = den = 0.0
    for i in range(len(weights)):
        w = weights[i]
        total += w
        out[2] += w * px[i, 0]
        out[3] += w * px[i, 1]
        out[4] += w * mm[i, 0]
        out[5] += w * mm[i, 1]
    out[2:] /= total
    for i in range(len(weights)):
        w = weights[i]
        p, q = px[i, 0] - out[2], px[i, 1] - out[3]
        x, y = mm[i, 0] - out[4], mm[i, 1] - out[5]
        den += w * (p * p + q * q)
        out[0] += w * (p * x + q * y)
        out[1] += w * (q * x - p * y)
    out[0] /= max(den, 1e-12)
    out[1] /= max(den, 1e-12)
    return out


@njit(cache=True, error_model="numpy")
def _residuals(px: FloatArray, mm: FloatArray, fit: FloatArray) -> FloatArray:
    """Texture points less where a similarity (1/R) [[cos, sin], [-sin, cos]] has them; shape (n, 2), mm."""
    out = np.empty_like(px)
    for i in range(len(px)):
        p, q = px[i, 0] - fit[2], px[i, 1] - fit[3]
        out[i, 0] = mm[i, 0] - fit[4] - (fit[0] * p + fit[1] * q)
        out[i, 1] = mm[i, 1] - fit[5] - (fit[0] * q - fit[1] * p)
    return out


@njit(cache=True, error_model="numpy")
def _fitted(
    px: FloatArray, mm: FloatArray, weights: FloatArray, px_per_mm: float, fixed_scale: bool
) -> tuple[FloatArray, float, float, FloatArray, BoolArray, float]:
    n = len(weights)
    base = np.where(weights > LEAST_WEIGHT, np.minimum(weights, 1.0), 0.0)
    if (base > 0.0).sum() < 4:
        base = np.minimum(np.maximum(weights, LEAST_WEIGHT), 1.0)
    used = base > 0.0
    keep = base.copy()
    agree = np.ones(n, dtype=np.bool_)
    sigma = 1.0
    fit = _similarity(px, mm, keep)
    for _ in range(FIT_STEPS):
        fit = _similarity(px, mm, keep)
        if fixed_scale:
            fit[:2] /= np.hypot(fit[0], fit[1]) * px_per_mm
        residual = _residuals(px, mm, fit)
        distance = np.sqrt(residual[:, 0] ** 2 + residual[:, 1] ** 2)
        sigma = max(np.median(distance[used]) / 1.177, LEAST_SIGMA_MM)
        for i in range(n):
            keep[i] = base[i] / (1.0 + (distance[i] / (2.5 * sigma)) ** 2) ** 2
            agree[i] = used[i] and distance[i] <= AGREE_SIGMAS * sigma * max(1.0, 0.6 / base[i])
    count = agree.sum()
    if count >= 4:
        for i in range(n):
            keep[i] = base[i] if agree[i] else 0.0
        fit = _similarity(px, mm, keep)
        residual = _residuals(px, mm, fit)
        square = 0.0
        for i in range(n):
            square += keep[i] * (residual[i, 0] ** 2 + residual[i, 1] ** 2)
        sigma = max(np.sqrt(square / (keep.sum() / count) / max(2.0 * count - 4.0, 1.0)), LEAST_SIGMA_MM)
    spread = 0.0
    for i in range(n):
        spread += keep[i] * ((px[i, 0] - fit[2]) ** 2 + (px[i, 1] - fit[3]) ** 2)
    scale = 1.0 / np.hypot(fit[0], fit[1])
    scale_sigma = sigma * scale * scale / np.sqrt(max(spread / (keep.sum() / max(count, 1)), 1e-9))
    free = not fixed_scale and abs(scale - px_per_mm) > SCALE_SIGMAS * scale_sigma
    if not free:
        fit[:2] *= scale / px_per_mm
    position = np.array([fit[4] - (fit[0] * fit[2] + fit[1] * fit[3]), fit[5] - (fit[0] * fit[3] - fit[1] * fit[2])])
    return position, fit[0], fit[1], _covariance(px, keep, fit, sigma, free), agree, sigma


@njit(cache=True, error_model="numpy")
def _covariance(px: FloatArray, weights: FloatArray, fit: FloatArray, sigma: float, free: bool) -> FloatArray:
    """Covariance of (x, y, theta) for dots of equal error weighted as they were, the scale estimated or given."""
    sums, squares = np.zeros(4), np.zeros(4)
    for i in range(len(weights)):
        u = fit[0] * px[i, 0] + fit[1] * px[i, 1]
        v = fit[0] * px[i, 1] - fit[1] * px[i, 0]
        w = weights[i]
        for out, share in ((sums, w), (squares, w * w)):
            out[0] += share
            out[1] += share * u
            out[2] += share * v
            out[3] += share * (u * u + v * v)
    if not np.isfinite(sums).all():
        return np.full((3, 3), np.nan)
    inverse, meat = _inverse_normal(sums, free), _normal(squares, free)
    full = np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            for k in range(len(meat)):
                for j in range(len(meat)):
                    full[a, b] += sigma * sigma * inverse[a, k] * meat[k, j] * inverse[j, b]
    return full


@njit(cache=True, error_model="numpy")
def _normal(sums: FloatArray, free: bool) -> FloatArray:
    """Normal matrix from the sums of w, w u, w v and w (u^2 + v^2).

    texture = S + A q, with A q = (u, v), has the derivatives 1, (v, -u) and (u, v) by S, theta and ln(1 / R).
    """
    size = 4 if free else 3
    out = np.zeros((size, size))
    total, u, v, square = sums
    out[0, 0] = out[1, 1] = total
    out[0, 2] = out[2, 0] = v
    out[1, 2] = out[2, 1] = -u
    out[2, 2] = square
    if free:
        out[0, 3] = out[3, 0] = u
        out[1, 3] = out[3, 1] = v
        out[3, 3] = square
    return out


@njit(cache=True, error_model="numpy")
def _inverse_normal(sums: FloatArray, free: bool) -> FloatArray:
    """Inverse of the normal matrix, by its blocks; the pseudo-inverse where all dots are in one place."""
    total, u, v, square = sums
    about_middle = square - (u * u + v * v) / max(total, 1e-300)
    if not about_middle > ONE_PLACE * square:
        return np.asarray(np.linalg.pinv(_normal(sums, free)), dtype=np.float64)
    both = total * about_middle
    out = _normal(np.array([square / both, -u / both, -v / both, 1.0 / about_middle]), free)
    if not free:
        out[0, 0] = 1.0 / total + v * v / (total * both)
        out[1, 1] = 1.0 / total + u * u / (total * both)
        out[0, 1] = out[1, 0] = -u * v / (total * both)
    return out
