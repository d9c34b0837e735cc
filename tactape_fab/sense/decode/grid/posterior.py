"""Inliers -> posterior of the pose: generalised least squares with priors on the camera and gel parameters."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, hypot, inf, log, sqrt
from typing import NamedTuple

import numpy as np

from tactape_fab.base.jit import inlined_kernel, inner_kernel, kernel
from tactape_fab.sense.decode.dots.clip import clip
from tactape_fab.sense.decode.grid.beliefs import (
    LEAST_APART_MM,
    MOST_APART_MM,
    PULL,
    PULL_END,
    PULL_FALL,
    PULL_MOST,
    PULL_REACH_MM,
    PULL_SIGMA,
    PUSH_MM,
    PUSH_REACH_MM,
    PUSH_SIGMA_MM,
    USUAL_ERRORS,
    USUAL_MM,
    Beliefs,
    rim_mm,
)
from tactape_fab.texture.frames import FloatArray

ONE_PLACE = 1e-9
"""Dots are in one place if their squared distances from their centroid are at most this share of those from the image centre."""
LEAST_STEPS, MOST_STEPS, SETTLED = 2, 10, 0.05
"""Least and largest number of Gauss-Newton steps; they end once a dot's variance changes by less than the share `SETTLED`."""
MOST_CORRELATED = 100
"""Largest number of dots if the gel's displacement correlates their errors; those of most weight are used."""


class _Terms(NamedTuple):
    """Arguments of `_settled` except its work buffer `shares`: dots, priors of the camera, and arrays that it fills in."""

    seen_mm: FloatArray
    target: FloatArray
    drawn: FloatArray
    weights: FloatArray
    rim_mm2: float
    variance: float
    sigmas: FloatArray
    corner_mm: FloatArray
    centre_mm: FloatArray
    state: FloatArray
    rates: FloatArray
    normal: FloatArray
    spread: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """Dots as a pose was fitted to them, in the image's axes: of what `displaced` asks whether they are displaced alike.

    seen_mm (n, 2): Dots from the image centre, over the profile's px/mm.
    rates (10, 2, n): Derivatives by the nine unknowns at the solution, and residuals last, mm.
    errors_mm2 (n,): Variance of each dot's error along an axis, by which the last step weighed them.
    smooth_mm2 (n, n): Covariance of errors along an axis besides; None if they are independent.
    covariance (9, 9): Of the unknowns.
    state (9,): The unknowns.
    turn (3, 3): From the image's axes to the texture's, of changes of (x, y, theta).
    """

    seen_mm: FloatArray
    rates: FloatArray
    errors_mm2: FloatArray
    smooth_mm2: FloatArray | None
    covariance: FloatArray
    state: FloatArray
    turn: FloatArray

    def changes(self, moves_mm: FloatArray) -> FloatArray:
        """Changes of x mm, y mm and theta rad where dots move on the gel, in the image's axes; (k, n, 2) to (k, 3).

        One step from the solution, with its weights. Moves are micrometres: that the camera's corrections stretch them by percent
        is left out.
        """
        if self.smooth_mm2 is None:
            weighed = self.rates[:9] / self.errors_mm2
        else:
            weighed = self.rates[:9] @ np.linalg.inv(self.smooth_mm2 + np.diag(self.errors_mm2))
        # where a dot moves, its residual, the target less the dot, falls by as much
        moved = moves_mm.transpose(0, 2, 1).reshape(len(moves_mm), -1) @ weighed.reshape(9, -1).T
        return np.asarray(-moved @ self.covariance[:, :3] @ self.turn.T)


def posterior(
    seen_mm: FloatArray,
    texture_mm: FloatArray,
    weights: FloatArray,
    px_per_mm: float,
    fit: FloatArray,
    beliefs: Beliefs,
    *,
    smoothed: bool,
    by_edges: float,
    placed_mm2: FloatArray | None,
    unsure_mm: FloatArray | None,
) -> tuple[FloatArray, FloatArray, float, FloatArray, Fitted | None]:
    """Posterior mean and covariance of a pose.

    Unknowns are (x, y, theta), then ln of the scale, aspect, shear, k1, the push of neighbours and the pull of the rim, each over
    its prior standard deviation. A dot's own error has the variance sigma^2 / sqrt(weight), to which those by the rim and by the
    gel's displacement, a Gaussian process, are added; sigma^2 is unknown, with an inverse gamma prior.

    seen_mm (n, 2): Dots from the image centre, over the profile's px/mm.
    texture_mm (n, 2); weights (n,)
    px_per_mm: The profile's.
    fit (7,): The robust fit to start from: cos / R, sin / R, centroids of the pixels and of the texture points, a dot's error.
    smoothed: Whether positions are maxima of a smoothed image, which neighbours and the rim shift; otherwise a dot's own error
        has the variance sigma^2 / weight, and only the gel's displacement is added.
    by_edges: `Dots.by_edges`: middles between edges err less by the rim.
    placed_mm2 (n,): Known variance of each part's position, to be added.
    unsure_mm (n, 2): Common shift of the dots along the image's axes per unit of one unknown factor of mean 0 and variance 1; it
        replaces the rim's pull.
    Returns at (4,): x mm, y mm, theta rad, ln of the scale over the profile's; NaN where all dots are in one place.
    Returns covariance (3, 3): Of (x mm, y mm, theta rad); infinite where all dots are in one place.
    Returns sigma_mm: Standard deviation of a full dot along one axis.
    Returns camera (2, 3): Corrections of aspect, shear and k1, and their standard deviations; NaN if all dots are in one place.
    Returns fitted: None if all dots are in one place.
    """
    along, across, u, v, middle_x, middle_y, sigma = values = fit.tolist()
    # 1 / R: mm on the texture per px, by which the robust fit takes px to mm
    length = hypot(along, across)
    if not (len(seen_mm) and 0.0 < length < inf and abs(sum(values)) < inf):
        return np.full(4, np.nan), np.full((3, 3), inf), sigma, np.full((2, 3), np.nan), None
    # in the image's axes, turned by the robust fit's theta: x and y are turned back at the end
    c, s = along / length, across / length
    buffer, normal, spread = np.zeros((14, 2, len(seen_mm))), np.empty((10, 10)), np.empty((10, 10))
    rates, drawn, target, shares = buffer[:10], buffer[10:12], buffer[12], buffer[13]
    to_fill = drawn if smoothed else drawn[:0]
    # a texture direction psi is seen at theta + psi, so the double angle turns by 2 theta
    (a, b), c2, s2 = beliefs.lean, c * c - s * s, 2.0 * c * s
    lean_u, lean_v = a * c2 - b * s2, a * s2 + b * c2
    apart, squares = _drawn(seen_mm, texture_mm, weights, c, s, middle_x, middle_y, lean_u, lean_v, target, to_fill)
    if unsure_mm is not None:
        # in the column of the pull, whose mean is taken off again: this factor has the mean 0
        drawn[1] = unsure_mm.T / PULL_SIGMA
        target += PULL * drawn[1]
    # dots in one place do not observe the rotation, and the normal matrix would be singular
    if not (squares < inf and apart > ONE_PLACE * squares):
        return np.full(4, np.nan), np.full((3, 3), inf), sigma, np.full((2, 3), np.nan), None
    rim_mm2 = rim_mm(by_edges) ** 2
    # `_summed` takes sigma^2 / sqrt(weight): of squared weights that is sigma^2 / weight, the law of centres by least squares
    if not smoothed:
        weights, rim_mm2 = weights**2, 0.0
    # from x and y of the robust fit: the model is linear in them, but sums of large squares would lose digits
    scale_sigma = float(beliefs.sigmas[0])
    # all unknowns but x, y and theta are in their own standard deviations: a prior is then 1 on the diagonal, and one that is
    # known exactly (sigma 0) has rates of 0 and stays at 0
    scale = -log(length * px_per_mm) / scale_sigma if scale_sigma > 0.0 else 0.0
    # x, y, theta, scale, aspect, shear, k1, push, pull; the tenth entry belongs to the column of the residuals, and stays 0
    state = np.array([-length * u, -length * v, 0.0, scale, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    camera = (beliefs.sigmas, beliefs.corner_mm, beliefs.centre_mm)
    terms = _Terms(seen_mm, target, drawn, weights, rim_mm2, sigma**2, *camera, state, rates, normal, spread)
    smooth = None
    if beliefs.gel_mm > 0.0 or placed_mm2 is not None:
        own = np.zeros(len(seen_mm)) if placed_mm2 is None else placed_mm2
        smooth = errors_of(seen_mm, own, np.zeros((0, 0)), beliefs.gel_mm**2, beliefs.correlation_mm)
        variance, weighed = _settled_correlated(smooth, terms)
    else:
        variance, weighed = _settled(*terms, shares)
    x, y, theta, scale, *_ = state.tolist()
    # back from the image's axes to the texture's, by R(theta) = [[c, s], [-s, c]]
    at = np.array([c * x + s * y + middle_x, c * y - s * x + middle_y, atan2(across, along) + theta, scale * scale_sigma])
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    found = np.array([state[4:7], np.sqrt(normal.diagonal()[4:7])]) * beliefs.sigmas[1:]
    fitted = Fitted(
        seen_mm=seen_mm,
        rates=rates,
        errors_mm2=weighed / np.sqrt(weights) + rim_mm2 * (1.0 - weights) ** 1.75,
        smooth_mm2=smooth,
        covariance=normal[:9, :9],
        state=state[:9],
        turn=turn,
    )
    return at, turn @ normal[:3, :3] @ turn.T, sqrt(variance), found, fitted


def errors_of(
    seen_mm: FloatArray, errors_mm2: FloatArray, known_mm2: FloatArray, variance: float, correlation_mm: float
) -> FloatArray:
    """Covariance of errors along an axis: independent ones, known ones, and a smooth displacement of the gel; (n, n) mm^2.

    errors_mm2 (n,): Variances of the independent ones.
    known_mm2 (n, n): Or (0, 0) if there are none.
    variance: Of the displacement, mm^2, which is correlated as a Gaussian of the standard deviation `correlation_mm`.
    """
    out = np.empty((len(seen_mm), len(seen_mm)))
    _fill(seen_mm, errors_mm2, known_mm2, variance, correlation_mm, out)
    return out


@kernel()
def _fill(
    seen_mm: FloatArray, errors_mm2: FloatArray, known_mm2: FloatArray, variance: float, correlation_mm: float, out: FloatArray
) -> None:
    """`errors_of`, into an array."""
    for i in range(len(out)):
        for k in range(i + 1):
            x, y = seen_mm[i, 0] - seen_mm[k, 0], seen_mm[i, 1] - seen_mm[k, 1]
            total = variance * np.exp((x * x + y * y) / (-2.0 * correlation_mm * correlation_mm))
            if len(known_mm2) > 0:
                total += known_mm2[i, k]
            out[i, k] = out[k, i] = total
        out[i, i] += errors_mm2[i]


def _settled_correlated(smooth: FloatArray, of: _Terms) -> tuple[float, float]:
    """`_settled` for dots whose errors along an axis have the covariance `smooth` as well; shape (n, n)."""
    # both axes of a dot have the same covariance, and none with each other: one n x n inverse serves both
    own, variance = 1.0 / np.sqrt(of.weights), of.variance
    for taken in range(1, MOST_STEPS + 1):
        _linearised_alone(of.seen_mm, of.target, of.drawn, of.sigmas, of.corner_mm, of.centre_mm, of.state, of.rates)
        # V of the generalised least squares; dV / d variance = diag(own)
        inverse = np.linalg.inv(smooth + np.diag(variance * own + of.rim_mm2 * (1.0 - of.weights) ** 1.75))
        weighted = of.rates @ inverse
        flat = weighted.reshape(10, -1)
        np.matmul(flat, of.rates.reshape(10, -1).T, out=of.normal)
        # X^T V^-1 diag(own) V^-1 X, the derivative of the normal matrix by the variance with its sign changed
        np.matmul((weighted * own).reshape(10, -1), flat.T, out=of.spread)
        # tr(V^-1 dV) of one axis
        known = float(inverse.diagonal() @ own)
        before, variance = variance, _stepped_alone(of.normal, of.spread, of.state, variance, known)
        if taken >= LEAST_STEPS and abs(variance - before) <= SETTLED * before:
            break
    _linearised_alone(of.seen_mm, of.target, of.drawn, of.sigmas, of.corner_mm, of.centre_mm, of.state, of.rates)
    return variance, before


@kernel()
def _drawn(
    seen_mm: FloatArray,
    texture_mm: FloatArray,
    weights: FloatArray,
    c: float,
    s: float,
    middle_x: float,
    middle_y: float,
    lean_u: float,
    lean_v: float,
    target: FloatArray,
    out: FloatArray,
) -> tuple[float, float]:
    """Fill in texture points from their centroid in the image's axes, `target` (2, n), and push and pull of each dot (2, 2, n).

    Push and pull are those for factors of 1, and left out if `out` is empty. Returns the sums of the squared
    distances of the dots seen from their own centroid, and from the image centre.
    """
    u = v = squares = 0.0
    for i in range(len(weights)):
        x, y = texture_mm[i, 0] - middle_x, texture_mm[i, 1] - middle_y
        target[0, i], target[1, i] = c * x - s * y, s * x + c * y
        u += seen_mm[i, 0]
        v += seen_mm[i, 1]
        squares += seen_mm[i, 0] ** 2 + seen_mm[i, 1] ** 2
    # n^2 pairs: a contact has some dozens of dots
    for i in range(len(weights) if len(out) > 0 else 0):
        push_x = push_y = total = x = y = 0.0
        for k in range(len(weights)):
            dx, dy = target[0, i] - target[0, k], target[1, i] - target[1, k]
            square = dx * dx + dy * dy
            # the dot itself adds dx = dy = 0 to the sum and its weight to the total: `total` is never 0
            near = 1.0 + square / PULL_REACH_MM**2
            near = weights[k] / (near * near)
            total += near
            x += near * dx
            y += near * dy
            if LEAST_APART_MM**2 < square < MOST_APART_MM**2:
                # d exp(-d^2 / 2 reach^2) over its value at 1 mm, without the factor d, which is in (dx, dy)
                share = weights[k] * np.exp((1.0 - square) / (2.0 * PUSH_REACH_MM**2))
                # I + [[u, v], [v, -u]]: 1 + lean along the bodies' direction, 1 - lean across it
                push_x += share * (dx + lean_u * dx + lean_v * dy)
                push_y += share * (dy + lean_v * dx - lean_u * dy)
        # m up to a missing weight m of 0.15, then 0.43 (0.5 - m), which is 0.15 there and 0 at 0.5
        least = clip(PULL_FALL * clip(PULL_END - 1.0 + weights[i], 0.0, np.inf), 0.0, PULL_MOST)
        missing = clip(1.0 - weights[i], -np.inf, least) / clip(total, 1e-300, np.inf)
        out[0, 0, i], out[0, 1, i] = push_x, push_y
        out[1, 0, i], out[1, 1, i] = missing * x, missing * y
    return squares - (u * u + v * v) / len(weights), squares


@kernel()
def _settled(
    seen_mm: FloatArray,
    target: FloatArray,
    drawn: FloatArray,
    weights: FloatArray,
    rim_mm2: float,
    variance: float,
    sigmas: FloatArray,
    corner_mm: FloatArray,
    centre_mm: FloatArray,
    state: FloatArray,
    rates: FloatArray,
    normal: FloatArray,
    spread: FloatArray,
    shares: FloatArray,
) -> tuple[float, float]:
    """Take Gauss-Newton steps until a full dot's variance converges; `rates` are those at the solution then.

    `shares` is a work buffer. Returns the variance, and the one that the last step weighed the dots by.
    """
    left, before = MOST_STEPS, variance
    while True:
        _linearised(seen_mm, target, drawn, sigmas, corner_mm, centre_mm, state, rates)
        if left == 0:
            return variance, before
        known = _summed(rates, weights, rim_mm2, variance, shares, normal, spread)
        before = variance
        variance = _stepped(normal, spread, state, variance, known)
        left -= 1
        if left <= MOST_STEPS - LEAST_STEPS and abs(variance - before) <= SETTLED * before:
            left = 0


@inner_kernel()
def lens_of(k1: float, square: float) -> tuple[float, float]:
    """Factor L that undoes radial distortion at a seen r^2 / r_corner^2, L (1 + k1 r^2 L^2) = 1, and its derivative by k1."""
    # started from the value at L = 1; after the step L is off by less than 1e-5 for |k1| up to 0.05 at the corner, which moves
    # a dot there by 0.1 um, and by 1e-3 for 0.1
    lens = 1.0 / (1.0 + k1 * square)
    bent = square * lens * lens
    lens = (1.0 + 2.0 * k1 * bent * lens) / (1.0 + 3.0 * k1 * bent)  # a step of Newton
    bent = square * lens * lens
    return lens, -bent * lens / (1.0 + 3.0 * k1 * bent)


@inlined_kernel()
def _linearised(
    seen_mm: FloatArray,
    target: FloatArray,
    drawn: FloatArray,
    sigmas: FloatArray,
    corner_mm: FloatArray,
    centre_mm: FloatArray,
    state: FloatArray,
    rates: FloatArray,
) -> None:
    """Fill in the Jacobian of the dots' texture points by the nine unknowns, and the residuals of the target last; (10, 2, n).

    A dot seen at p by the profile's camera is at q on the gel, p = (1 + k1 r^2 / r_corner^2) A q, with A as in `Geometry`:
    two cameras in a row are one, up to products of their distortions. Derivatives neglect such products.
    """
    shrink, aspect = np.exp(-state[3] * sigmas[0]), 0.5 * state[4] * sigmas[1]
    shear, k1, c, s = state[5] * sigmas[2], state[6] * sigmas[3], np.cos(state[2]), np.sin(state[2])
    push, pull = PUSH_MM + PUSH_SIGMA_MM * state[7], PULL + PULL_SIGMA * state[8]
    at_centre = (centre_mm[0] / corner_mm[0]) ** 2 + (centre_mm[1] / corner_mm[1]) ** 2
    middle, middle_change = lens_of(k1, at_centre)
    lens_x, lens_y = shrink * centre_mm[0], shrink * centre_mm[1]
    for i in range(len(seen_mm)):
        a, b = shrink * seen_mm[i, 0] - lens_x, shrink * seen_mm[i, 1] - lens_y
        radius = ((seen_mm[i, 0] - centre_mm[0]) / corner_mm[0]) ** 2 + ((seen_mm[i, 1] - centre_mm[1]) / corner_mm[1]) ** 2
        lens, change = lens_of(k1, radius)
        v = (b * lens + lens_y * middle) / (1.0 - aspect)
        u = (a * lens + lens_x * middle - shear * v) / (1.0 + aspect)
        x, y = c * u + s * v, c * v - s * u
        rates[0, 0, i] = rates[1, 1, i] = 1.0
        rates[2, 0, i], rates[2, 1, i] = y, -x
        rates[3, 0, i], rates[3, 1, i] = -sigmas[0] * x, -sigmas[0] * y
        rates[4, 0, i], rates[4, 1, i] = -0.5 * sigmas[1] * x / (1.0 + aspect), 0.5 * sigmas[1] * y / (1.0 - aspect)
        rates[5, 0, i] = -sigmas[2] * y / (1.0 + aspect)
        rates[6, 0, i] = sigmas[3] * (a * change + lens_x * middle_change)
        rates[6, 1, i] = sigmas[3] * (b * change + lens_y * middle_change)
        for axis in range(2):
            rates[7, axis, i], rates[8, axis, i] = -PUSH_SIGMA_MM * drawn[0, axis, i], PULL_SIGMA * drawn[1, axis, i]
            at = x if axis == 0 else y
            rates[9, axis, i] = target[axis, i] - state[axis] - at + push * drawn[0, axis, i] - pull * drawn[1, axis, i]


@inlined_kernel()
def _summed(
    rates: FloatArray,
    weights: FloatArray,
    rim_mm2: float,
    variance: float,
    shares: FloatArray,
    normal: FloatArray,
    spread: FloatArray,
) -> float:
    """Fill in the normal matrix, weighted by 1 / variance (`normal`), and minus its derivative by `variance` (`spread`).

    The variance of a dot is that of a full one over sqrt(weight), plus the rim's. Returns the sum over the dots of
    d ln(variance of the dot) / d variance.
    """
    known = 0.0
    for i in range(len(weights)):
        own = 1.0 / np.sqrt(weights[i])
        shares[0, i] = 1.0 / (variance * own + rim_mm2 * (1.0 - weights[i]) ** 1.75)
        shares[1, i] = own * shares[0, i]
        known += shares[1, i]
    for j in range(10):
        for k in range(j + 1):
            total = change = 0.0
            for i in range(len(weights)):
                share = (rates[j, 0, i] * rates[k, 0, i] + rates[j, 1, i] * rates[k, 1, i]) * shares[0, i]
                total += share
                change += share * shares[1, i]
            normal[j, k] = normal[k, j] = total
            spread[j, k] = spread[k, j] = change
    return known


@inner_kernel()
def eliminate(matrix: FloatArray, k: int, rows: int) -> None:
    """Gauss-Jordan step k, in place: after `rows` steps the leading square is its inverse, and further columns are solved."""
    pivot = 1.0 / matrix[k, k]
    matrix[k, k] = 1.0
    for j in range(matrix.shape[1]):
        matrix[k, j] *= pivot
    for j in range(rows):
        if j != k:
            factor = matrix[j, k]
            matrix[j, k] = 0.0
            for i in range(matrix.shape[1]):
                matrix[j, i] -= factor * matrix[k, i]


@inlined_kernel()
def _stepped(normal: FloatArray, spread: FloatArray, state: FloatArray, variance: float, known: float) -> float:
    """Take a Gauss-Newton step: `normal` becomes the covariance (9, 9), and `state` is updated.

    Row and column 9 belong to the residuals. Returns the estimate of a full dot's variance after the step; `known` is from
    `_summed`.
    """
    for k in range(3, 9):  # the priors
        normal[k, k] += 1.0
        normal[k, 9] -= state[k]
    # no pivots are sought as the matrix is positive definite. Column 9 becomes the step
    for k in range(9):
        eliminate(normal, k, len(normal) - 1)  # no literal: numba would compile it for each
    trace, square = 0.0, spread[9, 9]
    for j in range(9):
        state[j] += normal[j, 9]
        square -= 2.0 * normal[j, 9] * spread[j, 9]
        for k in range(9):
            trace += normal[j, k] * spread[j, k]
            square += normal[j, 9] * normal[k, 9] * spread[j, k]
    # the variance at which its score vanishes (REML; Harville, JASA 72 (1977) 320): for dots of equal weights the sum of
    # squares over the degrees of freedom. The prior adds its errors, and 2 go off for the mean of an inverse gamma variable
    errors = USUAL_ERRORS + variance * (2.0 * known - trace)
    return float((USUAL_ERRORS * USUAL_MM**2 + variance * variance * clip(square, 0.0, np.inf)) / clip(errors - 2.0, 1.0, np.inf))


_linearised_alone, _stepped_alone = kernel()(_linearised.py_func), kernel()(_stepped.py_func)
"""Kernels callable from Python, compiled only if a profile gives the gel's displacement."""
