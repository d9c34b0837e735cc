"""Parallax of a photograph: a camera sees bodies, which are higher than the film, farther out than their lands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tactape_fab.sense.inspect.bodies import Bodies
from tactape_fab.sense.inspect.warp import Warp
from tactape_fab.texture.frames import BoolArray, FloatArray

BEND_MM = 0.025
"""Least bend of a warp for which an image counts as a photograph: a scanner's residual is a few micrometres."""
_ROUNDS = 5


def bend_mm(warp: Warp, sites_mm: FloatArray) -> float:
    """Largest distance of a warp, at some places, from the nearest warp of a scanner.

    A scanner's warp is affine with a shift of each line: its carriage moves unevenly along one axis of the image.
    """
    px = warp.smooth(sites_mm)
    line = (px - px.mean(axis=0)) / np.ptp(px, axis=0)
    off = []
    for along in line.T:
        a = np.column_stack([sites_mm, np.ones(len(sites_mm)), along**2, along**3])
        left = px - a @ np.linalg.lstsq(a, px, rcond=None)[0]
        off.append(float(np.hypot(*left.T).max()))
    return min(off) / warp.px_per_mm


def without_parallax(bodies: Bodies, sites_mm: FloatArray, good: BoolArray) -> tuple[Bodies, float]:
    """Bodies without the shift that grows from one point, and its growth, mm a mm.

    A top at the height h under a camera at H is seen at h / (H - h) times its distance from the camera's foot farther out; the
    foot is not known. So the mean of all shifts and their growth in all directions alike are taken out: what the placement
    has of both is not observable.

    sites_mm (n, 2)
    good (n,): Parts that count.
    """
    at, shift = sites_mm[good], bodies.shift_mm[good]
    weight = np.ones(len(at))
    for _ in range(_ROUNDS):
        middle, mean = (np.average(values, axis=0, weights=weight) for values in (at, shift))
        arm = at - middle
        square = float(weight @ (arm**2).sum(axis=1))
        # least squares of shift - mean = growth arm, both axes together
        growth = float(weight @ (arm * (shift - mean)).sum(axis=1)) / square
        left = shift - mean - growth * arm
        scatter = max(1.4826 * float(np.median(np.abs(left))), 1e-6)
        weight = 1.0 / (1.0 + ((left / (3.0 * scatter)) ** 2).sum(axis=1))
    arm = sites_mm - middle
    # variance of the mean and of the growth times the arm, along one axis: arm^2 of both axes is halved
    own = scatter**2 * (1.0 / len(at) + (arm**2).sum(axis=1) / (2.0 * square))
    moved = bodies.shift_mm - mean - growth * arm
    return replace(bodies, shift_mm=moved, sigma_mm=np.sqrt(bodies.sigma_mm**2 + own)), growth
