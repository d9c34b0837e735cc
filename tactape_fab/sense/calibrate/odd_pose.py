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
_BLOCK = 256
"""Groups that are held against all others at a time: pairs are as many as half of the squared number of poses."""


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
        groups = np.array(list(combinations(range(len(at)), size)))
        linear, _, used = _held(at, rates, z, groups, sigmas, least, prior)
        best: tuple[float, tuple[OddPose, ...]] = CHANCE / len(groups), ()
        for n in np.argsort(linear, kind="stable")[:_CANDIDATES].tolist():
            k, others = groups[n], np.delete(every, groups[n])
            weight = 1.0 / used[n]

            def rows(x: FloatArray, others: IntArray = others, weight: FloatArray = weight) -> FloatArray:
                return np.concatenate([(left(x)[others] * weight).ravel(), x * prior])

            # the unknowns by all poses are drawn by these: rates are those at the others' own solution
            own = least_squares(rows, z, max_nfev=20).x
            (chance,), (off,), _ = _held(left(own), _rates(left, own), own, k[None], sigmas, least, prior)
            off_mm, off_rad = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 5])
            if chance < best[0] and ((off_mm > LEAST_MM) | (off_rad > LEAST_RAD)).all():
                odd = zip(k.tolist(), off_mm.tolist(), off_rad.tolist(), strict=True)
                best = float(chance), tuple(OddPose(index=i, off_mm=mm, off_rad=rad) for i, mm, rad in odd)
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
    groups: IntArray,
    sigmas: FloatArray,
    least: FloatArray,
    prior: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Groups of poses as predicted by all others, to first order about z.

    groups (g, k): Indices of their poses.
    Returns p-values (g,), deviations (g, k, 6), and the standard deviations of each kind of residual (g, 6).
    """
    # sums over all poses for each kind, of which each group's own are taken off
    products = np.einsum("mki,mkj->mkij", rates, rates), at[..., None] * rates, at**2
    sums = [of_each.sum(axis=0) for of_each in products]
    blocks = [groups[start : start + _BLOCK] for start in range(0, len(groups), _BLOCK)]
    found = []
    for block in blocks:
        normal, right, square = (of_all - of_each[block].sum(axis=1) for of_all, of_each in zip(sums, products, strict=True))
        found.append(_predicted(at, rates, z, block, (normal, right, square), sigmas, least, prior))
    chance, off, used = (np.concatenate(part) for part in zip(*found, strict=True))
    return chance, off, used


def _predicted(
    at: FloatArray,
    rates: FloatArray,
    z: FloatArray,
    groups: IntArray,
    others: tuple[FloatArray, FloatArray, FloatArray],
    sigmas: FloatArray,
    least: FloatArray,
    prior: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """As `_held`, of some groups.

    others: Sums over all poses but those of the group, for each kind of residual: of the products of its derivatives
        (g, 6, u, u), of these and the residual (g, 6, u), and of its square (g, 6).
    """
    normal, right, square = others
    sigmas = np.broadcast_to(sigmas, square.shape)
    for _ in range(_ROUNDS):
        weight = 1.0 / sigmas**2
        covariance = np.linalg.pinv(np.einsum("gk,gkij->gij", weight, normal) + np.diag(prior**2), hermitian=True)
        step = -np.einsum("gij,gj->gi", covariance, np.einsum("gk,gki->gi", weight, right) + prior**2 * z)
        # sum of (residual + derivatives . step)^2
        rest = square + 2.0 * np.einsum("gki,gi->gk", right, step)
        rest += np.einsum("gi,gkij,gj->gk", step, normal, step, optimize=True)
        # what the unknowns take of each kind, the sum of its rows' leverages, as in `hand_eye`
        taken = weight * np.einsum("gkij,gij->gk", normal, covariance)
        freedom = np.maximum(len(at) - groups.shape[1] - taken, 1e-3)
        used, sigmas = sigmas, np.maximum(np.sqrt(np.maximum(rest, 0.0) / freedom), least)
    off = at[groups] + np.einsum("gmki,gi->gmk", rates[groups], step)
    of, seen = rates[groups][:, :, SEEN].reshape(len(groups), -1, len(z)), off[:, :, SEEN].reshape(len(groups), -1)
    size = seen.shape[1]
    spread = of @ covariance @ np.swapaxes(of, 1, 2) + np.eye(size) * np.tile(used[:, SEEN] ** 2, groups.shape[1])[:, None]
    # three normal errors a pose over an estimated size: Snedecor's F, with the fewest degrees of freedom of the three kinds
    ratio = np.einsum("gi,gi->g", seen, np.linalg.solve(spread, seen[..., None])[..., 0]) / size
    return np.asarray(fdtrc(size, freedom[:, SEEN].min(axis=1), ratio)), off, used
