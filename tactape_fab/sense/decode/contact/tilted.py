"""The pose of a tilted contact: what the tilt does to the places of dots, and how sure that leaves the pose."""

from __future__ import annotations

from dataclasses import replace
from math import remainder, sqrt, tau

import numpy as np

from tactape_fab.sense.decode.contact.surface import LEAST_SLOPE
from tactape_fab.sense.decode.grid.pose import Pose, fit_pose
from tactape_fab.sense.decode.rank import View
from tactape_fab.texture.frames import FloatArray

WHOLLY = 0.03
"""Slope, 1.7 degrees, from which a contact counts as tilted in full."""
RIM_SHARE = 0.5
"""Share of what `rim.settled` moves dots by that is believed under a tilt. There the pressure falls all across the contact and
not at its rim alone: dots amid it are low as well, and are moved too far. With all of it positions are off by 9 and 42 um at 2
and 5 degrees (0.5 and 2 N), without it by -15 and -57, with half of it by -4 and -13: seed 5 of the elastic simulator."""
STRAIN, OWN = 2.0, 1.2
"""Standard deviation of a linear displacement of the dots about their middle, over that which independent errors of the dots make
of it; and the variance of these over that in a flat contact. All dots are drawn to where the pressure is: `long_parts` takes off
what parts that are longer than wide are drawn along themselves, the rest is here. Seed 5 of the elastic simulator."""
CHANGE = 0.6
"""Standard deviation of the rim's correction, over the half of it that is left out."""
PIXELS = 0.45
"""Share of such a displacement that is left to centres that are fitted to pixels."""
_STEP = 1e-3


def tilted_pose(
    pose: Pose,
    slope: FloatArray,
    offset_px: FloatArray,
    seen_px: FloatArray,
    texture_mm: FloatArray,
    weights: FloatArray,
    view: View,
) -> tuple[Pose, FloatArray, FloatArray]:
    """The pose with the tilt's bias taken off and its uncertainty in the covariance; the places of dots that it is fitted to, and
    what of the covariance a strain of the contact adds.

    A tilted tape is seen foreshortened along its slope, by the cosine of its tilt. The rim's correction of the dots is believed
    by half; a share of the pose's change by that half is a standard deviation. A strain of the contact looks as the camera's
    scale, aspect and shear do, but about the contact's middle: it moves the image's centre, which is far from it under a tilt.

    Parameters
    ----------
    pose : Pose
        Fitted to `offset_px`.
    slope : ndarray, shape (2,)
        Rise of the tape towards the sensor along image u and v.
    offset_px, seen_px : ndarray, shape (n, 2)
        Dots from the image centre, square pixels: with those at the rim put back, and as detected.
    texture_mm, weights, view
        As for `fit_pose`.
    """
    square = float(slope @ slope)
    share = min(max((sqrt(square) - LEAST_SLOPE) / (WHOLLY - LEAST_SLOPE), 0.0), 1.0)
    moved = offset_px + (1.0 - RIM_SHARE) * share * (seen_px - offset_px)
    moved = moved + ((sqrt(1.0 + square) - 1.0) / square) * (moved @ slope)[:, None] * slope
    found = fit_pose(moved, texture_mm, weights, view.px_per_mm, view.beliefs)
    if not (np.isfinite(found.position_mm).all() and np.isfinite(found.covariance).all() and np.isfinite(found.px_per_mm)):
        return pose, offset_px, np.zeros((3, 3))
    change = np.array([*(found.position_mm - pose.position_mm), remainder(found.theta_rad - pose.theta_rad, tau)])
    strain = _by_strain(found, moved, texture_mm, weights, view)
    covariance = OWN * found.covariance + CHANGE**2 * np.outer(change, change) + strain
    return replace(found, covariance=covariance, agree=pose.agree), moved, strain


def _by_strain(pose: Pose, offset_px: FloatArray, texture_mm: FloatArray, weights: FloatArray, view: View) -> FloatArray:
    """Covariance of a pose by a strain of the contact that nobody knows; shape (3, 3)."""
    from_middle = offset_px - offset_px[pose.agree].mean(axis=0)
    reach, directions = np.linalg.eigh(from_middle[pose.agree].T @ from_middle[pose.agree])
    sigmas = STRAIN * pose.sigma_mm * view.px_per_mm / np.sqrt(np.maximum(reach, 1e-300))
    out = np.zeros((3, 3))
    for sigma, direction in zip(sigmas.tolist(), directions.T, strict=True):
        for along in np.eye(2):
            moved = offset_px + _STEP * (from_middle @ direction)[:, None] * along
            strained = fit_pose(moved, texture_mm, weights, view.px_per_mm, view.beliefs)
            rate = np.array([*(strained.position_mm - pose.position_mm), remainder(strained.theta_rad - pose.theta_rad, tau)])
            rate *= sigma / _STEP
            if np.isfinite(rate).all():
                out += np.outer(rate, rate)
    return out
