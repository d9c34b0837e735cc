"""Dots -> pose: a robust fit finds the inliers, and `posterior` fits the pose to them, with covariance."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite, remainder, tau

import numpy as np

from tactape_fab.base.jit import inlined_kernel, inner_kernel, kernel
from tactape_fab.sense.decode.dots.clip import clip
from tactape_fab.sense.decode.dots.kth import median
from tactape_fab.sense.decode.grid.beliefs import Beliefs
from tactape_fab.sense.decode.grid.posterior import MOST_CORRELATED, Fitted, posterior
from tactape_fab.sense.decode.rule import AGREE_SIGMAS
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

FIT_STEPS = 5
LEAST_SIGMA_MM = 0.004
FEW_DOTS = 7.0
"""The median of few distances is often too small: with n inliers the limit is widened by 1 + 7 / n before the pose is fitted.
Without that the covariance would be too small: NEES/3 is 2.0 with 9 dots, and 1.2 with the wider limit."""
LEAST_WEIGHT = 0.15
"""Lighter dots are more likely noise than parts: they take no part in the fit."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pose:
    """Pose of the image centre on the texture, with its covariance.

    position_mm (2,)
    covariance (3, 3): Of (x mm, y mm, theta rad); infinite where the dots leave the pose open.
    agree (n,): Inliers.
    sigma_mm: Standard deviation of one dot along one axis, without the gel's displacement.
    camera (2, 3): Corrections of the profile's aspect, shear and k1, fitted together with the pose; their standard deviations.
    fitted: Dots that it was fitted to, and how.
    """

    position_mm: FloatArray
    theta_rad: float
    px_per_mm: float
    covariance: FloatArray
    agree: BoolArray
    sigma_mm: float
    camera: FloatArray
    fitted: Fitted | None = None
    used: IntArray | None = None

    @property
    def finite(self) -> bool:
        """Whether pose and covariance are finite."""
        return all(map(isfinite, (*self.position_mm.tolist(), *self.covariance.ravel().tolist(), self.px_per_mm)))


def fit_pose(
    offset_px: FloatArray,
    texture_mm: FloatArray,
    weights: FloatArray,
    px_per_mm: float,
    beliefs: Beliefs,
    *,
    least_sigma_mm: float = LEAST_SIGMA_MM,
    smoothed: bool = True,
    by_edges: float = 0.0,
    placed_mm: FloatArray | None = None,
    unsure_px: FloatArray | None = None,
) -> Pose:
    """Fit a pose (docs/frames.md; paper, Eq. 12, for all dots instead of one).

    Dots that agree with a similarity are fitted by generalised least squares: texture = S + R(theta) q, q the dot's place on
    the gel by the camera, whose parameters have normal priors. The errors of dots have the covariance
    sigma^2 / sqrt(weight) + rim^2 on the diagonal, or sigma^2 / weight if not `smoothed`, plus that of the gel's displacement,
    a Gaussian process. The unknown sigma has an inverse gamma prior. The posterior of S and theta is then close to a t
    distribution, whose covariance is returned.

    offset_px (n, 2): Dots from the image centre p0, in square pixels of the profile's camera without distortion.
    texture_mm (n, 2): Nominal positions of the same dots on the texture.
    weights (n,)
    px_per_mm: The sensor profile's scale.
    least_sigma_mm: Lower limit of the robust fit's estimate of a dot's error along an axis.
    smoothed, by_edges: As for `posterior`.
    placed_mm (n,): Standard deviation of each part's measured position; None if unknown, and then part of a dot's own error.
    unsure_px (n, 2): As `unsure_mm` of `posterior`, in px.
    """
    n = len(weights)
    fit, keep, agree, buffer = np.empty(7), np.empty(n), np.empty(n, dtype=np.bool_), np.empty((3, n))
    # one memory layout: numba compiles a kernel anew for each
    px, mm = np.ascontiguousarray(offset_px), np.ascontiguousarray(texture_mm)
    w, fixed = np.ascontiguousarray(weights), beliefs.sigmas[0] == 0.0
    _agreeing(px, mm, w, px_per_mm, fixed, least_sigma_mm, fit, keep, agree, buffer)
    used = keep.nonzero()[0]
    # an n x n inverse in every step grows as n^3; sorting is stable, so that equal weights always leave the same dots
    if beliefs.gel_mm > 0.0 and len(used) > MOST_CORRELATED:
        used = used[np.argsort(-keep[used], kind="stable")[:MOST_CORRELATED]]
    seen_mm, kept = px.take(used, 0) / px_per_mm, keep.take(used)
    placed_mm2 = None if placed_mm is None else placed_mm.take(used) ** 2
    unsure_mm = None if unsure_px is None else unsure_px.take(used, 0) / px_per_mm
    at, covariance, sigma, seen_by, fitted = posterior(
        seen_mm,
        mm.take(used, 0),
        kept,
        px_per_mm,
        fit,
        beliefs,
        smoothed=smoothed,
        by_edges=by_edges,
        placed_mm2=placed_mm2,
        unsure_mm=unsure_mm,
    )
    theta, ln_scale = at[2:].tolist()
    return Pose(
        position_mm=at[:2],
        theta_rad=remainder(theta, tau),
        px_per_mm=px_per_mm * exp(ln_scale),
        covariance=covariance,
        agree=agree,
        sigma_mm=sigma,
        camera=seen_by,
        fitted=fitted,
        used=used,
    )


@inner_kernel()
def _similarity(px: FloatArray, mm: FloatArray, weights: FloatArray, out: FloatArray) -> None:
    """Fill in the weighted least-squares similarity: (cos / R, sin / R, centroids of the pixels and of the texture points)."""
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
        # least squares of (s, t) = [[a, b], [-b, a]] (p, q): a and b are the sums of scalar and of cross products over that of
        # squares
        den += w * (p * p + q * q)
        along += w * (p * s + q * t)
        across += w * (q * s - p * t)
    den = clip(den, 1e-12, np.inf)
    out[0], out[1] = along / den, across / den
    out[2], out[3], out[4], out[5] = u, v, x, y


@inner_kernel()
def _squares(px: FloatArray, mm: FloatArray, fit: FloatArray, out: FloatArray) -> None:
    """Fill in squared residuals, mm^2: distances of texture points from pixels mapped by (1/R) [[cos, sin], [-sin, cos]]."""
    for i in range(len(px)):
        p, q = px[i, 0] - fit[2], px[i, 1] - fit[3]
        x = mm[i, 0] - fit[4] - (fit[0] * p + fit[1] * q)
        y = mm[i, 1] - fit[5] - (fit[0] * q - fit[1] * p)
        out[i] = x * x + y * y


@inlined_kernel()
def _median_distance(squares: FloatArray, weights: FloatArray, ordered: FloatArray) -> float:
    """Median distance of the dots with a weight above 0, from squared distances; `ordered` is a work buffer."""
    n = 0
    for i in range(len(squares)):
        if weights[i] > 0.0:
            ordered[n] = np.sqrt(squares[i])
            n += 1
    return float(median(ordered[:n]))


@inlined_kernel()
def _base_weights(weights: FloatArray, out: FloatArray) -> None:
    """Fill in weights of at most 1, with 0 for dots that may be noise; all dots keep theirs if too few would be left."""
    count = 0
    for i in range(len(weights)):
        out[i] = clip(weights[i], 0.0, 1.0) if weights[i] > LEAST_WEIGHT else 0.0
        count += 1 if out[i] > 0.0 else 0
    if count < 4:
        for i in range(len(weights)):
            out[i] = clip(weights[i], LEAST_WEIGHT, 1.0)


@kernel()
def _agreeing(
    px: FloatArray,
    mm: FloatArray,
    weights: FloatArray,
    px_per_mm: float,
    fixed_scale: bool,
    least_sigma_mm: float,
    fit: FloatArray,
    keep: FloatArray,
    agree: BoolArray,
    buffer: FloatArray,
) -> None:
    """Fill in `fit` (from `_similarity`, then a dot's error), the weights for the pose's fit (`keep`), and the inliers (`agree`).

    `buffer` is a work buffer.
    """
    n = len(weights)
    base, squares, ordered = buffer[0], buffer[1], buffer[2]
    _base_weights(weights, base)
    sigma, count = 1.0, 0.0
    for i in range(n):
        keep[i] = base[i]
    for _ in range(FIT_STEPS):
        _similarity(px, mm, keep, fit)
        # for a fixed length of (cos, sin) / R the best direction is that of the free solution
        if fixed_scale:
            length = np.hypot(fit[0], fit[1]) * px_per_mm
            fit[0], fit[1] = fit[0] / length, fit[1] / length
        _squares(px, mm, fit, squares)
        # the median distance of two normal axes is 1.177 sigma (Rayleigh)
        sigma, count = clip(_median_distance(squares, base, ordered) / 1.177, least_sigma_mm, np.inf), 0.0
        for i in range(n):
            distance = np.sqrt(squares[i])
            # weights of Geman and McClure: an outlier's influence falls to 0
            keep[i] = base[i] / (1.0 + (distance / (2.5 * sigma)) ** 2) ** 2
            # low dots err more, by about 1 / height: their limit is wider, from 0.6 of a whole height down
            agree[i] = base[i] > 0.0 and distance <= AGREE_SIGMAS * sigma * clip(0.6 / base[i], 1.0, np.inf)
            count += 1.0 if agree[i] else 0.0
    # `posterior` takes a weight for the dot's own variance, which the robust one is not: dots that are fitted have their own. Two
    # dots fit any similarity, and three are hardly more: fewer than four keep the robust weights
    if count >= 4.0:
        reach = AGREE_SIGMAS * sigma * (1.0 + FEW_DOTS / count)
        for i in range(n):
            keep[i] = base[i] if np.sqrt(squares[i]) <= reach * clip(0.6 / base[i], 1.0, np.inf) else 0.0
    fit[6] = sigma
