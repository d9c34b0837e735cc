"""A gel that sticks to the tape is dragged along: the dots err alike then, and their residuals show by how much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tactape_fab.base.jit import inlined_kernel, inner_kernel, kernel
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
    buffers = np.empty((60, n)), np.empty((3, n, n)), np.empty((3, 10, 10))
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
def _times(a: FloatArray, b: FloatArray, diagonal: bool, out: FloatArray) -> None:
    """Product of (m, n) and (n, n), of which all but the diagonal is 0 if `diagonal`."""
    for r in range(len(a)):
        for j in range(len(b)):
            out[r, j] = a[r, j] * b[j, j] if diagonal else 0.0
        for i in range(0 if diagonal else len(b)):
            factor = a[r, i]
            for j in range(len(b)):
                out[r, j] += factor * b[i, j]


@inner_kernel()
def _products(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Sums over dots and axes: rows (10 x 2, n) with rows (10 x 2, n) give (10, 10), of rows for which that is symmetric."""
    for j in range(10):
        for k in range(j + 1):
            total = 0.0
            for axis in range(2):
                for i in range(a.shape[1]):
                    total += a[2 * j + axis, i] * b[2 * k + axis, i]
            out[j, k] = out[k, j] = total


@inlined_kernel()
def _invert(
    errors_mm2: FloatArray,
    known_mm2: FloatArray,
    alike: FloatArray,
    factor: float,
    variance: float,
    independent: bool,
    out: FloatArray,
    column: FloatArray,
) -> None:
    """Inverse of factor * diag(errors) + known + variance * alike, the errors' covariance along an axis; (n, n).

    independent: Whether only the first of the three is there.
    column (n,): Work buffer.
    """
    n = len(errors_mm2)
    for i in range(n):
        for j in range(i + 1):
            out[i, j] = variance * alike[i, j]
            if len(known_mm2) > 0:
                out[i, j] += known_mm2[i, j]
        out[i, i] += factor * errors_mm2[i]
        if independent:
            out[i, i] = -1.0 / out[i, i]
    # sweeps of a symmetric matrix (Goodnight, The American Statistician 33 (1979) 149): on and below the diagonal alone, half of
    # what `eliminate` does; they leave minus the inverse
    for k in range(0 if independent else n):
        pivot = 1.0 / out[k, k]
        for i in range(n):
            column[i] = out[i, k] if i > k else out[k, i]
        column[k] = 0.0
        for i in range(n):
            share = pivot * column[i]
            for j in range(i + 1):
                out[i, j] -= share * column[j]
        for i in range(n):
            if i > k:
                out[i, k] = pivot * column[i]
            else:
                out[k, i] = pivot * column[i]
        out[k, k] = -pivot
    for i in range(n):
        for j in range(i + 1):
            out[i, j] = out[j, i] = -out[i, j]


@inlined_kernel()
def _score(now: FloatArray, state: FloatArray, first: FloatArray, inverse: FloatArray, part: FloatArray) -> float:
    """Fit the dots anew, and the derivative of the restricted log likelihood by the factor of errors of covariance `part`.

    The fit is one step from the solution, where the model is linear enough. The derivative is (r^T P K P r - tr P K) / 2, with
    P = V^-1 - V^-1 X C X^T V^-1, r the residuals and K the covariance `part`.

    now (10, 10): X^T V^-1 X with the residuals last. It becomes C, and its last column the step.
    state (9,): The unknowns: all but the pose have a prior of 0 and are in its standard deviations.
    first (10, 10): X^T V^-1 K V^-1 X with the residuals last.
    inverse, part (n, n): V^-1 and K, of one axis.
    """
    for k in range(3, 9):
        now[k, k] += 1.0
        now[k, 9] -= state[k]
    for k in range(9):
        eliminate(now, k, len(now) - 1)  # no literal: numba would compile it for each
    total = first[9, 9]
    for j in range(9):
        total -= 2.0 * now[j, 9] * first[j, 9]
        for k in range(9):
            total += (now[j, 9] * now[k, 9] + now[j, k]) * first[j, k]
    for i in range(len(part)):
        for j in range(len(part)):
            total -= 2.0 * inverse[i, j] * part[i, j]
    return float(0.5 * total)


@inlined_kernel()
def _information(now: FloatArray, first: FloatArray, second: FloatArray, whole: FloatArray) -> float:
    """Information of the score, tr P K P K / 2.

    now, first (10, 10): As `_score` leaves them.
    second (10, 10): X^T V^-1 K V^-1 K V^-1 X.
    whole (n, n): K V^-1 of one axis.
    """
    total = 0.0
    for i in range(len(whole)):
        for j in range(len(whole)):
            total += whole[i, j] * whole[j, i]
    for j in range(9):
        for k in range(9):
            total -= now[j, k] * second[j, k]
    # C X^T V^-1 K V^-1 X takes the place of what is no longer read
    for j in range(9):
        for k in range(9):
            second[j, k] = 0.0
            for m in range(9):
                second[j, k] += now[j, m] * first[m, k]
    for j in range(9):
        for k in range(9):
            total += 0.5 * second[j, k] * second[k, j]
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
    rows: FloatArray,
    squares: FloatArray,
    small: FloatArray,
    more: FloatArray,
) -> bool:
    """Whether a displacement shows; `more` (9, 9) is then by how much it enlarges the unknowns' covariance.

    rates (10 x 2, n): Derivatives X by the nine unknowns at the solution, and residuals.
    covariance (9, 9): Of the unknowns, of which `state` (9,) are the values, as they were fitted.
    weighed_mm2, errors_mm2 (n,): Variances of the dots' own errors as they were fitted with, and as they are at least. They
        are estimated anew, by one factor.
    known_mm2 (n, n): Covariance of errors besides; (0, 0) if there are none.
    alike (n, n): Covariance of a displacement of variance 1.
    rows (60, n), squares (3, n, n), small (3, 10, 10): Work buffers.
    """
    weighted, by, again = rows[:20], rows[20:40], rows[40:]
    inverse, whole, own = squares[0], squares[1], squares[2]
    now, first, second = small[0], small[1], small[2]
    errors, factor, gel_mm2, above, variance = errors_mm2, 1.0, 0.0, 0.0, 0.0
    # the displacement's variance, the factor of the dots' own, the former again, and what it does to the pose as it was fitted:
    # in a loop, as all that is called is compiled into this kernel once per place
    for step in range(4):
        part, independent = own if step == 1 else alike, gel_mm2 == 0.0 and len(known_mm2) == 0
        _invert(errors, known_mm2, alike, factor, gel_mm2, independent, inverse, rows[0])
        _times(rates, inverse, independent, weighted)
        _times(weighted, part, step == 1, by)
        _products(by, weighted, first)
        if step == 3:
            break
        _products(weighted, rates, now)
        score = _score(now, state, first, inverse, part)
        if step == 0 and score <= 0.0:  # most frames end here
            return False
        if step == 1:  # of a product that is only asked for its trace and its square's, the factors may change places
            _times(inverse, part, step == 1, whole)  # no literal: numba would compile it once more
        else:
            _times(part, inverse, independent, whole)
        _times(by, inverse, independent, again)
        _products(again, by, second)
        information = _information(now, first, second, whole)
        if step == 0:
            above, variance = score / np.sqrt(information), score / information
            if not above > SEEN:
                return False
            for i in range(len(own)):
                for j in range(len(own)):
                    own[i, j] = errors_mm2[i] if i == j else 0.0
            gel_mm2 = variance
        elif step == 1:
            factor = max(1.0 + score / information, LEAST_SHARE)
        else:
            variance = max(variance + score / information, LEAST_SHARE * variance)
            freedom = max(2.0 * variance**2 * information, LEAST_FREEDOM)
            # as that of a t distribution; from 0 at the limit, so that the covariance does not jump there
            variance *= (1.0 - (SEEN / above) ** 2) * freedom / (freedom - 2.0)
            errors, factor, gel_mm2 = weighed_mm2, 1.0, 0.0
    # covariance of the estimate A y, A = C X^T W, by errors V of y: A V A^T
    for j in range(9):
        for k in range(9):
            for m in range(9):
                for p in range(9):
                    more[j, k] += variance * covariance[j, m] * first[m, p] * covariance[p, k]
    return True
