"""A gel that sticks to the tape is dragged along: the dots err alike then, and their residuals show by how much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tactape_fab.base.jit import inner_kernel, kernel
from tactape_fab.sense.decode.grid.beliefs import RIM_MM, Beliefs
from tactape_fab.sense.decode.grid.pose import Pose
from tactape_fab.sense.decode.grid.posterior import MOST_CORRELATED, eliminate, errors_of
from tactape_fab.texture.frames import FloatArray

SEEN = 1.0
"""How far above its mean, in standard deviations, the score of a displacement has to be; by chance it is in one frame
of eight."""
LEAST_SHARE = 0.25
"""Least of either variance after a step over the one before it."""
LEAST_FREEDOM = 3.0
"""Fewest degrees of freedom that a displacement's variance is taken to be known with: a t distribution with two has
no variance."""


def displaced(pose: Pose, beliefs: Beliefs, weights: FloatArray) -> Pose:
    """The pose with the covariance that it has where the gel is displaced by more than the sensor's profile says.

    The displacement is a Gaussian process on the dots (`posterior`) with the profile's correlation length. Its variance is
    estimated from this frame, by the score of the restricted likelihood (Harville, JASA 72 (1977) 320) and one step of Fisher
    scoring from there. What of it moves all dots alike shows in no residual, but has the same variance: so the covariance grows,
    and the pose stays where independent errors put it. Frames whose residuals are as rough as by chance are left as they are.

    weights (n,): Of all dots, as detected: low ones err by the contact's rim, which is smooth as well.
    """
    fitted, used = pose.fitted, pose.used
    if fitted is None or used is None or not pose.finite:
        return pose
    missing, none = 1.0 - np.minimum(weights.take(used), 1.0), np.zeros((0, 0))
    errors_mm2 = np.maximum(fitted.errors_mm2, RIM_MM**2 * missing**1.75)
    known_mm2 = none if fitted.smooth_mm2 is None else fitted.smooth_mm2
    # every so many of many dots, as an n x n inverse grows as n^3: in the weights each stands for those left out
    step = -(-len(used) // MOST_CORRELATED)
    rates, seen_mm = fitted.rates[:, :, ::step].reshape(20, -1), fitted.seen_mm[::step].copy()
    alike = errors_of(seen_mm, np.zeros(len(seen_mm)), none, 1.0, beliefs.correlation_mm)
    errors = fitted.errors_mm2[::step] / step, errors_mm2[::step].copy(), known_mm2[::step, ::step].copy()
    n, more = len(seen_mm), np.zeros((9, 9))
    buffers = np.empty((58, n)), np.empty((3, n, n)), np.empty((3, 10, 9))
    if not _seen(rates, fitted.state, fitted.covariance, *errors, alike, *buffers, more):
        return pose
    return replace(
        pose,
        covariance=pose.covariance + fitted.turn @ more[:3, :3] @ fitted.turn.T,
        camera=np.array([pose.camera[0], np.sqrt(pose.camera[1] ** 2 + more.diagonal()[4:7] * beliefs.sigmas[1:] ** 2)]),
    )


# Sums over dots and axes are written out: numpy lets other threads run in products of some hundred elements, for which a frame
# would wait


@inner_kernel()
def _times(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Product of (m, n) and (n, n)."""
    for r in range(len(a)):
        for j in range(len(b)):
            out[r, j] = 0.0
        for i in range(len(b)):
            factor = a[r, i]
            for j in range(len(b)):
                out[r, j] += factor * b[i, j]


@inner_kernel()
def _products(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Sums over dots and axes: rows (9 x 2, n) with rows (9 x 2, n) give (9, 9)."""
    for j in range(9):
        for k in range(9):
            total = 0.0
            for axis in range(2):
                for i in range(a.shape[1]):
                    total += a[2 * j + axis, i] * b[2 * k + axis, i]
            out[j, k] = total


@inner_kernel()
def _sum(a: FloatArray, b: FloatArray) -> float:
    """Of the products of the entries of two matrices."""
    total = 0.0
    for i in range(len(a)):
        for j in range(a.shape[1]):
            total += a[i, j] * b[i, j]
    return total


@inner_kernel()
def _invert(
    errors_mm2: FloatArray, known_mm2: FloatArray, alike: FloatArray, factor: float, variance: float, out: FloatArray
) -> None:
    """Inverse of factor * diag(errors) + known + variance * alike, the errors' covariance along an axis; (n, n)."""
    n, independent = len(errors_mm2), variance == 0.0 and len(known_mm2) == 0
    for i in range(n):
        for j in range(n):
            out[i, j] = variance * alike[i, j]
            if len(known_mm2) > 0:
                out[i, j] += known_mm2[i, j]
        out[i, i] += factor * errors_mm2[i]
        if independent:
            out[i, i] = 1.0 / out[i, i]
    for k in range(0 if independent else n):
        eliminate(out, k, n)


@inner_kernel()
def _refit(
    rates: FloatArray,
    state: FloatArray,
    inverse: FloatArray,
    weighted: FloatArray,
    rest: FloatArray,
    left: FloatArray,
    normal: FloatArray,
) -> None:
    """Fit the dots anew with other errors, from the solution, where the model is linear enough.

    rates (10 x 2, n): Derivatives by the nine unknowns, and residuals.
    inverse (n, n): V^-1, of the errors' covariance V along an axis.
    weighted (9 x 2, n): X^T V^-1, filled in.
    rest, left (2, n): Residuals, and these times V^-1, filled in.
    normal (10, 9): Covariance of the unknowns, filled in; its last row is a work buffer.
    """
    n = len(inverse)
    _times(rates[:18], inverse, weighted)
    _products(weighted, rates, normal)
    for k in range(3, 9):  # the priors: all but the pose are in standard deviations
        normal[k, k] += 1.0
    for k in range(9):
        eliminate(normal, k, 9)
    towards = normal[9]
    for axis in range(2):
        for i in range(n):
            rest[axis, i] = rates[18 + axis, i]
    for k in range(9):
        towards[k] = -state[k] if k >= 3 else 0.0
        for axis in range(2):
            for i in range(n):
                towards[k] += weighted[2 * k + axis, i] * rates[18 + axis, i]
    for k in range(9):
        change = 0.0
        for m in range(9):
            change += normal[k, m] * towards[m]
        for axis in range(2):
            for i in range(n):
                rest[axis, i] -= change * rates[2 * k + axis, i]
    _times(rest, inverse, left)


@inner_kernel()
def _score(
    inverse: FloatArray,
    weighted: FloatArray,
    left: FloatArray,
    covariance: FloatArray,
    alike: FloatArray,
    by: FloatArray,
    first: FloatArray,
) -> float:
    """Derivative of the restricted log likelihood by the factor of errors of covariance `alike` (n, n).

    It is (r^T P K P r - tr P K) / 2, with P = V^-1 - V^-1 X C X^T V^-1; arguments as `_refit` fills them in. `by` (9 x 2, n) and
    `first` (9, 9) are filled in for `_information`.
    """
    _times(weighted, alike, by)
    _products(by, weighted, first)
    square = 0.0
    for axis in range(2):
        for i in range(len(inverse)):
            for j in range(len(inverse)):
                square += left[axis, i] * alike[i, j] * left[axis, j]
    return float(0.5 * (square - 2.0 * _sum(inverse, alike) + _sum(first, covariance)))


@inner_kernel()
def _information(
    inverse: FloatArray,
    covariance: FloatArray,
    alike: FloatArray,
    by: FloatArray,
    first: FloatArray,
    second: FloatArray,
    whole: FloatArray,
    both: FloatArray,
) -> float:
    """Information of the score, tr P K P K / 2; `second` (9 x 2, n), `whole` (n, n) and `both` (9, 9) are work buffers."""
    _times(alike, inverse, whole)
    total = 0.0
    for i in range(len(whole)):
        for j in range(len(whole)):
            total += whole[i, j] * whole[j, i]
    _times(by, inverse, second)
    _products(second, by, both)
    total -= _sum(both, covariance)
    for j in range(9):
        for k in range(9):
            both[j, k] = 0.0
            for m in range(9):
                both[j, k] += covariance[j, m] * first[m, k]
    for j in range(9):
        for k in range(9):
            total += 0.5 * both[j, k] * both[k, j]
    return float(total)


@kernel()
def _seen(
    rates: FloatArray,
    state: FloatArray,
    covariance: FloatArray,
    weighed_mm2: FloatArray,
    errors_mm2: FloatArray,
    known_mm2: FloatArray,
    alike: FloatArray,
    buffer: FloatArray,
    squares: FloatArray,
    small: FloatArray,
    more: FloatArray,
) -> bool:
    """Whether a displacement shows; `more` (9, 9) is then by how much it enlarges the unknowns' covariance.

    weighed_mm2, errors_mm2 (n,): Variances of the dots' own errors as they were fitted with, and as they are at least. They
        are estimated anew, by one factor.
    known_mm2 (n, n): Covariance of errors besides; (0, 0) if there are none.
    alike (n, n): Covariance of a displacement of variance 1.
    buffer (58, n), squares (3, n, n), small (3, 10, 9): Work buffers.
    """
    weighted, by, second, rest, left = buffer[:18], buffer[18:36], buffer[36:54], buffer[54:56], buffer[56:58]
    inverse, whole, own = squares[0], squares[1], squares[2]
    now, first, both = small[0], small[1, :9], small[2, :9]
    _invert(errors_mm2, known_mm2, alike, 1.0, 0.0, inverse)
    _refit(rates, state, inverse, weighted, rest, left, now)
    score = _score(inverse, weighted, left, now, alike, by, first)
    if score <= 0.0:  # most frames end here
        return False
    information = _information(inverse, now, alike, by, first, second, whole, both)
    above = score / np.sqrt(information)
    if not above > SEEN:
        return False
    variance = score / information
    for i in range(len(own)):
        for j in range(len(own)):
            own[i, j] = errors_mm2[i] if i == j else 0.0
    _invert(errors_mm2, known_mm2, alike, 1.0, variance, inverse)
    _refit(rates, state, inverse, weighted, rest, left, now)
    score = _score(inverse, weighted, left, now, own, by, first)
    factor = max(1.0 + score / _information(inverse, now, own, by, first, second, whole, both), LEAST_SHARE)
    _invert(errors_mm2, known_mm2, alike, factor, variance, inverse)
    _refit(rates, state, inverse, weighted, rest, left, now)
    score = _score(inverse, weighted, left, now, alike, by, first)
    information = _information(inverse, now, alike, by, first, second, whole, both)
    variance = max(variance + score / information, LEAST_SHARE * variance)
    freedom = max(2.0 * variance**2 * information, LEAST_FREEDOM)
    # as that of a t distribution; from 0 at the limit, so that the covariance does not jump there
    variance *= (1.0 - (SEEN / above) ** 2) * freedom / (freedom - 2.0)
    # covariance of the estimate A y, A = C X^T W, by errors V of y: A V A^T
    _invert(weighed_mm2, known_mm2, alike, 1.0, 0.0, inverse)
    _times(rates[:18], inverse, weighted)
    _times(weighted, alike, by)
    _products(by, weighted, first)
    for j in range(9):
        for k in range(9):
            for m in range(9):
                for p in range(9):
                    more[j, k] += variance * covariance[j, m] * first[m, p] * covariance[p, k]
    return True
