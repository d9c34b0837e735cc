"""Outliers among an arm's poses, found by leaving each out (Cook and Weisberg, Residuals and influence, 1982, ch. 2).

A pose of an arm that still moved, or of another frame, is not far off itself where it decides what the others leave open: tilted
by 6 deg too much among presses that tilt by 1 it has the sensor reach out as far as it says, and all others are off. So each pose
is held against what the others alone say. Two odd ones hide each other, so where no pose is odd by itself each pair is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares
from scipy.special import fdtrc

from tactape_fab.texture.frames import FloatArray, IntArray

CHANCE = 1e-3
"""Chance that any pose, or any pair of them, is taken for an odd one where all errors are normal."""
LEAST_MM, LEAST_RAD = 0.3, 0.01
"""An odd pose is off by either, on the tape: a gel that slid by less is no fault of a pose, and hardly moves an answer."""
SEEN = [0, 1, 5]
"""Indices of x, y and the turn about z, which a press shows: height and tilt of a sensor are assumed, and people tilt it."""
_CANDIDATES, _ROUNDS = 3, 4
_STEP = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class OddPose:
    """A pose with its error on the tape, as predicted by the other poses.

    index: Among the poses.
    """

    index: int
    off_mm: float
    off_rad: float


def odd_poses(
    left: Callable[[FloatArray], FloatArray], z: FloatArray, sigmas: FloatArray, least: FloatArray, prior: FloatArray, most: int
) -> tuple[OddPose, ...]:
    """The pose that the others contradict most, if chance does not explain it; else such a pair; else none.

    left: Function from the unknowns (u,) to the residuals of each pose, x, y, z (mm) and turns (rad), (m, 6).
    z (u,): The unknowns fitted to all poses.
    sigmas, least (6,): Initial and least standard deviation of each kind of residual.
    prior (u,): 1 / prior standard deviation of each unknown.
    most: How many may be odd.
    """
    rates, at = _rates(left, z), left(z)
    every = np.arange(len(at))
    for size in range(1, min(most, 2) + 1):
        groups = [list(group) for group in combinations(range(len(at)), size)]
        linear = [_held(at, rates, z, np.delete(every, k), k, sigmas, least, prior) for k in groups]
        best: tuple[float, tuple[OddPose, ...]] = CHANCE / len(groups), ()
        for n in sorted(range(len(groups)), key=lambda n: linear[n][0])[:_CANDIDATES]:
            k, others = groups[n], np.delete(every, groups[n])
            weight = 1.0 / linear[n][2]

            def rows(x: FloatArray, others: IntArray = others, weight: FloatArray = weight) -> FloatArray:
                return np.concatenate([(left(x)[others] * weight).ravel(), x * prior])

            # the unknowns by all poses are drawn by these: rates are those at the others' own solution
            own = least_squares(rows, z, max_nfev=20).x
            chance, off, _ = _held(left(own), _rates(left, own), own, others, k, sigmas, least, prior)
            off_mm, off_rad = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 5])
            if chance < best[0] and ((off_mm > LEAST_MM) | (off_rad > LEAST_RAD)).all():
                odd = zip(k, off_mm.tolist(), off_rad.tolist(), strict=True)
                best = chance, tuple(OddPose(index=i, off_mm=mm, off_rad=rad) for i, mm, rad in odd)
        if best[1]:
            return best[1]
    return ()


def _rates(left: Callable[[FloatArray], FloatArray], z: FloatArray) -> FloatArray:
    """Jacobian of the residuals by the unknowns; (m, 6, u)."""
    steps = _STEP * np.eye(len(z))
    return np.stack([(left(z + d) - left(z - d)) / (2.0 * _STEP) for d in steps], axis=2)


def _held(
    at: FloatArray,
    rates: FloatArray,
    z: FloatArray,
    others: IntArray,
    k: list[int],
    sigmas: FloatArray,
    least: FloatArray,
    prior: FloatArray,
) -> tuple[float, FloatArray, FloatArray]:
    """Poses k as predicted by others, to first order about z: p-value, deviations, and their standard deviations."""
    by, values = rates[others], at[others]
    for _ in range(_ROUNDS):
        scaled = (by / sigmas[:, None]).reshape(-1, len(z))
        covariance = np.linalg.pinv(scaled.T @ scaled + np.diag(prior**2), hermitian=True)
        step = -covariance @ (scaled.T @ (values / sigmas).ravel() + prior**2 * z)
        rest = values + by @ step
        # leverage of each row, as in `hand_eye`
        taken = ((scaled @ covariance) * scaled).sum(axis=1).reshape(-1, 6)
        freedom = np.maximum((1.0 - taken).sum(axis=0), 1e-3)
        used, sigmas = sigmas, np.maximum(np.sqrt((rest**2).sum(axis=0) / freedom), least)
    off = at[k] + rates[k] @ step
    of, seen = rates[k][:, SEEN].reshape(-1, len(z)), off[:, SEEN].ravel()
    spread = of @ covariance @ of.T + np.diag(np.tile(used[SEEN] ** 2, len(k)))
    # three normal errors a pose over an estimated size: Snedecor's F, with the fewest degrees of freedom of the three kinds
    ratio = float(seen @ np.linalg.solve(spread, seen)) / len(seen)
    return float(fdtrc(len(seen), freedom[SEEN].min(), ratio)), off, used
