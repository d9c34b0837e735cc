"""Agreeing dots -> posterior of the pose: generalised least squares with camera and gel as unknowns that have priors."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, hypot, inf, log, sqrt

import numpy as np

from tactape_fab.base.jit import inner_kernel, kernel
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import FloatArray

ONE_PLACE = 1e-9
"""Share of their squared distances from the image centre that dots in one place have from their own middle."""
RIM_MM = 0.09
"""Error of a dot by the contact's rim, for a missing weight of 1: with the power 7/8 of it, 5 um at 0.04, 27 at 0.25 and 57 at
0.6, as measured."""
USUAL_MM, USUAL_ERRORS = 0.006, 1.0
"""Error of a whole dot believed before the frame is seen, and how many errors this belief counts as. With sensors of different
noise, and tapes of different placement, dots err by 5 to 100 um: so it is worth little."""
PUSH_MM, PUSH_SIGMA_MM, PUSH_REACH_MM = 0.012, 0.01, 0.43
"""How far the top of a dot lies off its part, away from a neighbour that is 1 mm off, by what the filter leaves of that one's
flank; how sure that is; and how it falls with the distance d, as d exp(-d^2 / 2 reach^2). 10 to 25 um for gels that blur by
0.05 to 0.25 mm. Neighbours push each other alike: without it the scatter of dots says more error than the pose has."""
LEAST_APART_MM, MOST_APART_MM = 0.3, 2.5
"""Dots nearer than this do not push each other, they are one part seen twice; nor do those farther apart."""
PULL, PULL_SIGMA, PULL_REACH_MM = 0.2, 0.12, 2.0
"""How far a dot at the rim lies inwards, per unit of missing weight and of its distance from the middle of the dots within about
the reach, and how sure that is: `rim.settled` takes a small loss of height for noise. It puts back more where more is missing:
so the pull grows up to a missing weight of 0.15, and from there it falls to nothing at 0.5."""
PULL_MOST, PULL_END, PULL_FALL = 0.15, 0.5, 0.43
LEAST_STEPS, MOST_STEPS, SETTLED = 2, 10, 0.05
"""Steps of Gauss and Newton, until the variance of a dot changes by a smaller share."""
MOST_CORRELATED = 100
"""Dots, those of most weight, that are used where the gel's displacement correlates their errors."""
PRIOR: FloatArray = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
"""Precision of the unknowns before the frame is seen: x, y, theta, then each of the others over its standard deviation."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Beliefs:
    """What is known of a sensor's camera and gel before the dots are seen.

    The camera is the profile's; the parameters below are what it may be off by.

    Attributes
    ----------
    sigmas : ndarray, shape (4,)
        Standard deviations of ln of the scale, aspect, shear and k1; 0 where it is exact.
    corner_mm : ndarray, shape (2,)
        r_corner of the radial distortion over the px/mm along u and v.
    centre_mm : ndarray, shape (2,)
        Centre of the distortion, from the image centre.
    gel_mm, correlation_mm : float
        Root mean square of the gel's smooth displacement along each axis, and the Gaussian's standard deviation.
    """

    sigmas: FloatArray
    corner_mm: FloatArray
    centre_mm: FloatArray
    gel_mm: float = 0.0
    correlation_mm: float = 1.0


def beliefs_of(sensor: SensorProfile, *, fixed_scale: bool) -> Beliefs:
    """The beliefs of a sensor's profile.

    Parameters
    ----------
    sensor : SensorProfile
    fixed_scale : bool
        Whether the scale is exact whatever the profile says.
    """
    geometry, scale, camera = sensor.geometry, np.array(sensor.px_per_mm), sensor.camera
    known = geometry.sigma_px_per_mm
    relative = 0.0 if fixed_scale else sensor.scale_tolerance / 2 if known is None else known / sensor.px_per_mm[0]
    return Beliefs(
        sigmas=np.array([relative, geometry.sigma_aspect, geometry.sigma_shear, geometry.sigma_k1]),
        corner_mm=camera.corner_px / scale,
        centre_mm=-camera.from_px(sensor.centre_px),
        gel_mm=sensor.gel.displacement_um / 1000,
        correlation_mm=sensor.gel.correlation_mm,
    )


def posterior(
    seen_mm: FloatArray,
    texture_mm: FloatArray,
    weights: FloatArray,
    px_per_mm: float,
    fit: FloatArray,
    beliefs: Beliefs,
    *,
    smoothed: bool = True,
) -> tuple[FloatArray, FloatArray, float]:
    """Mean and covariance of a pose.

    Unknowns are (x, y, theta), then over their standard deviations ln of the scale, aspect, shear, k1, the push of neighbours and
    the pull of the rim. A dot's own error has the variance sigma^2 / sqrt(weight), to which that by the rim and the gel's
    displacement, a Gaussian process, are added; sigma^2 is unknown, with an inverse gamma prior.

    Parameters
    ----------
    seen_mm : ndarray, shape (n, 2)
        Dots from the image centre, over the profile's px/mm.
    texture_mm : ndarray, shape (n, 2)
    weights : ndarray, shape (n,)
    px_per_mm : float
        The profile's.
    fit : ndarray, shape (7,)
        The robust fit to start from: cos / R, sin / R, middle of the pixels and of the texture points, error of a dot.
    beliefs : Beliefs
    smoothed : bool
        Whether places are tops of a smoothed image, which neighbours and the rim draw; otherwise a dot's own error has the
        variance sigma^2 / weight, and nothing is added but the gel's displacement.

    Returns
    -------
    at : ndarray, shape (4,)
        x mm, y mm, theta rad, ln of the scale over the profile's; NaN where all dots are in one place.
    covariance : ndarray, shape (3, 3)
        Of (x mm, y mm, theta rad); infinite where all dots are in one place.
    sigma_mm : float
        Error of a whole dot along one axis.
    """
    n, length = len(seen_mm), hypot(fit[0], fit[1])
    middle = seen_mm.sum(axis=0)
    squares = float(np.vdot(seen_mm, seen_mm))
    apart = squares - float(middle @ middle) / max(n, 1)
    if not (0.0 < length < inf and abs(float(fit.sum())) < inf and squares < inf and apart > ONE_PLACE * squares):
        return np.full(4, np.nan), np.full((3, 3), inf), float(fit[6])
    # in the image's axes, turned by the robust fit's theta: x and y are turned back at the end
    turn = np.array([[fit[0], fit[1]], [-fit[1], fit[0]]]) / length
    target = np.ascontiguousarray(((texture_mm - fit[4:6]) @ turn).T)
    drawn, rates, off = np.empty((2, 2, n)), np.zeros((9, 2, n)), np.empty((2, n))
    _drawn(target, weights, drawn)
    rim_mm2 = RIM_MM**2
    if not smoothed:
        drawn[:], weights, rim_mm2 = 0.0, weights**2, 0.0
    # variances: what that of a whole dot is multiplied by, and what the rim adds
    own, rim = np.empty((2, n)), rim_mm2 * (1.0 - weights) ** 1.75
    own[:] = 1.0 / np.sqrt(weights)
    smooth = _displacement(seen_mm, beliefs) if beliefs.gel_mm > 0.0 else None
    state, variance, covariance = np.zeros(9), float(fit[6]) ** 2, PRIOR
    if beliefs.sigmas[0] > 0.0:
        state[3] = -log(length * px_per_mm) / beliefs.sigmas[0]
    flat, flat_own = rates.reshape(9, -1), own.ravel()
    for taken in range(1, MOST_STEPS + 1):
        _linearised(seen_mm, target, drawn, state, beliefs.sigmas, beliefs.corner_mm, beliefs.centre_mm, rates, off)
        inverse = _inverse(variance * own[0] + rim, smooth)
        weighted = (rates * inverse if smooth is None else rates @ inverse).reshape(9, -1)
        covariance = np.asarray(np.linalg.inv(weighted @ flat.T + PRIOR), dtype=np.float64)
        step = covariance @ (weighted @ off.ravel() - PRIOR @ state)
        state = state + step
        # the variance at which its score vanishes (REML; Harville, JASA 72 (1977) 320): for dots of equal weights the sum of
        # squares over the degrees of freedom. The prior adds its errors, and 2 go off for the mean of an inverse gamma variable
        left = (step @ flat).reshape(2, -1)
        np.subtract(off, left, out=left)
        left = left * inverse if smooth is None else left @ inverse
        known = 2.0 * float((inverse if smooth is None else inverse.diagonal()) @ own[0])
        used = float(np.vdot(covariance, (weighted * flat_own) @ weighted.T))
        square = variance**2 * float(np.vdot(left * own, left))
        errors = variance * (known - used)
        before, variance = variance, (USUAL_ERRORS * USUAL_MM**2 + square) / max(USUAL_ERRORS + errors - 2.0, 1.0)
        if taken >= LEAST_STEPS and abs(variance - before) <= SETTLED * before:
            break
    x, y = (turn @ state[:2] + fit[4:6]).tolist()
    out = covariance[:3, :3].copy()
    out[:2] = turn @ out[:2]
    out[:, :2] = out[:, :2] @ turn.T
    at = np.array([x, y, atan2(fit[1], fit[0]) + state[2], state[3] * beliefs.sigmas[0]])
    return at, out, sqrt(variance)


def _inverse(variance: FloatArray, smooth: FloatArray | None) -> FloatArray:
    """Inverse of the covariance of dots along an axis; shape (n,) where they are independent, (n, n) else."""
    if smooth is None:
        return np.asarray(1.0 / variance)
    return np.asarray(np.linalg.inv(smooth + np.diag(variance)))


def _displacement(seen_mm: FloatArray, beliefs: Beliefs) -> FloatArray:
    """Covariance of the gel's displacement along an axis at the dots; shape (n, n), mm^2."""
    apart = seen_mm[:, None] - seen_mm
    squares = np.einsum("ijk,ijk->ij", apart, apart)
    out: FloatArray = beliefs.gel_mm**2 * np.exp(squares / (-2.0 * beliefs.correlation_mm**2))
    return out


@kernel()
def _drawn(at_mm: FloatArray, weights: FloatArray, out: FloatArray) -> None:
    """Fill in the sum of all pushes on each dot over that of a neighbour at 1 mm, and its pull over that of a unit; (2, 2, n)."""
    for i in range(len(weights)):
        push_x = push_y = total = x = y = 0.0
        for k in range(len(weights)):
            dx, dy = at_mm[0, i] - at_mm[0, k], at_mm[1, i] - at_mm[1, k]
            square = dx * dx + dy * dy
            near = weights[k] / (1.0 + square / PULL_REACH_MM**2) ** 2
            total += near
            x += near * dx
            y += near * dy
            if LEAST_APART_MM**2 < square < MOST_APART_MM**2:
                share = weights[k] * np.exp((1.0 - square) / (2.0 * PUSH_REACH_MM**2))
                push_x += share * dx
                push_y += share * dy
        missing = min(1.0 - weights[i], PULL_MOST, PULL_FALL * max(PULL_END - 1.0 + weights[i], 0.0)) / max(total, 1e-300)
        out[0, 0, i], out[0, 1, i] = push_x, push_y
        out[1, 0, i], out[1, 1, i] = missing * x, missing * y


@inner_kernel()
def _lens(k1: float, square: float) -> tuple[float, float]:
    """By what a distortion is undone at r^2 / r_corner^2 as seen, L with L (1 + k1 r^2 L^2) = 1, and its derivative by k1."""
    lens = 1.0 / (1.0 + k1 * square)
    lens = (1.0 + 2.0 * k1 * square * lens**3) / (1.0 + 3.0 * k1 * square * lens**2)  # a step of Newton
    return lens, -square * lens**3 / (1.0 + 3.0 * k1 * square * lens**2)


@kernel()
def _linearised(
    seen_mm: FloatArray,
    target: FloatArray,
    drawn: FloatArray,
    state: FloatArray,
    sigmas: FloatArray,
    corner_mm: FloatArray,
    centre_mm: FloatArray,
    rates: FloatArray,
    off: FloatArray,
) -> None:
    """Fill in the derivatives of the dots' texture points by the unknowns (9, 2, n), and what is left of the target (2, n).

    A dot seen at p by the profile's camera is at q on it, p = (1 + k1 r^2 / r_corner^2) A q, with the matrix A of `Geometry`:
    two cameras in a row are one, but for products of their distortions. Derivatives neglect such products.
    """
    shrink, aspect = np.exp(-state[3] * sigmas[0]), 0.5 * state[4] * sigmas[1]
    shear, k1, c, s = state[5] * sigmas[2], state[6] * sigmas[3], np.cos(state[2]), np.sin(state[2])
    push, pull = PUSH_MM + PUSH_SIGMA_MM * state[7], PULL + PULL_SIGMA * state[8]
    at_centre = (centre_mm[0] / corner_mm[0]) ** 2 + (centre_mm[1] / corner_mm[1]) ** 2
    middle, middle_change = _lens(k1, at_centre)
    lens_x, lens_y = shrink * centre_mm[0], shrink * centre_mm[1]
    for i in range(len(seen_mm)):
        a, b = shrink * seen_mm[i, 0] - lens_x, shrink * seen_mm[i, 1] - lens_y
        radius = ((seen_mm[i, 0] - centre_mm[0]) / corner_mm[0]) ** 2 + ((seen_mm[i, 1] - centre_mm[1]) / corner_mm[1]) ** 2
        lens, change = _lens(k1, radius)
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
            off[axis, i] = target[axis, i] - state[axis] - at + push * drawn[0, axis, i] - pull * drawn[1, axis, i]
