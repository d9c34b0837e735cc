"""Dots -> the grid they stand on: angle, pitch and phase from all dots at once, without knowing any symbol.

Dots are displaced by a sixth of the pitch or so along one axis; the first harmonic of the grid survives that, so the power
of the dots at the grid's wave vector shows angle and pitch, and its phase the grid itself.
"""

from __future__ import annotations

from math import pi

import numpy as np
from numba import njit

from tactape_fab.texture.frames import FloatArray

ANGLES = 36
"""Directions looked at over a quarter turn: 2.5 degrees, well inside the width of a peak (pitch over contact)."""
SCANNED = 28
"""Dots, the strongest ones, with which directions are looked at; refined with all."""
REFINEMENTS = 3
_SCALE_STEP = 0.07


@njit(cache=True, fastmath=True, error_model="numpy")
def _power(xy: FloatArray, weights: FloatArray, angle: float, wave: float) -> float:
    """Power of the dots at the two wave vectors of a square grid."""
    c, s = np.cos(angle) * wave, np.sin(angle) * wave
    ar = ai = br = bi = 0.0
    for i in range(len(weights)):
        a = c * xy[i, 0] + s * xy[i, 1]
        b = c * xy[i, 1] - s * xy[i, 0]
        w = weights[i]
        ar += w * np.cos(a)
        ai += w * np.sin(a)
        br += w * np.cos(b)
        bi += w * np.sin(b)
    return ar * ar + ai * ai + br * br + bi * bi


@njit(cache=True, error_model="numpy")
def _vertex(left: float, middle: float, right: float) -> float:
    """Place of the top of a parabola through three equally spaced values, from the middle, within half a step."""
    bend = left - 2.0 * middle + right
    if bend >= 0.0:
        return 0.0
    return min(max(0.5 * (left - right) / bend, -0.5), 0.5)


@njit(cache=True, error_model="numpy")
def find_lattices(xy: FloatArray, weights: FloatArray, pitch_px: float, tolerance: float, most: int) -> FloatArray:
    """The best grids for some dots.

    Parameters
    ----------
    xy : ndarray, shape (n, 2)
        About the middle of the dots, px.
    weights : ndarray, shape (n,)
    pitch_px : float
        Expected pitch.
    tolerance : float
        How far the pitch may be off, as a share.
    most : int
        Grids asked for.

    Returns
    -------
    ndarray, shape (k, 5)
        Angle of the first axis in [0, pi/2), pitch px, phases of both axes (rad), share of the power that a perfect
        grid would have; best first.
    """
    total = weights.sum()
    steps = int(np.ceil(tolerance / _SCALE_STEP))
    scales = 2 * steps + 1
    power = np.empty((scales, ANGLES))
    strong = np.argsort(-weights)[:SCANNED]
    few, few_weights = xy[strong], weights[strong]
    for k in range(scales):
        wave = 2.0 * pi / (pitch_px * (1.0 + tolerance * (k - steps) / max(steps, 1)))
        for j in range(ANGLES):
            power[k, j] = _power(few, few_weights, j * (pi / 2) / ANGLES, wave)
    best = np.empty(ANGLES)
    which = np.empty(ANGLES, dtype=np.int64)
    for j in range(ANGLES):
        which[j] = np.argmax(power[:, j])
        best[j] = power[which[j], j]
    found = np.empty((most, 5))
    n = 0
    taken = np.zeros(ANGLES, dtype=np.bool_)
    for _ in range(most):
        top = -1
        for j in range(ANGLES):
            if taken[j] or best[j] < best[(j + 1) % ANGLES] or best[j] < best[j - 1]:
                continue
            if top < 0 or best[j] > best[top]:
                top = j
        if top < 0:
            break
        taken[top] = True
        angle = top * (pi / 2) / ANGLES
        pitch = pitch_px * (1.0 + tolerance * (which[top] - steps) / max(steps, 1))
        step_angle, step_pitch = (pi / 2) / ANGLES, pitch_px * _SCALE_STEP
        for _ in range(REFINEMENTS):
            middle = _power(xy, weights, angle, 2 * pi / pitch)
            angle += step_angle * _vertex(
                _power(xy, weights, angle - step_angle, 2 * pi / pitch),
                middle,
                _power(xy, weights, angle + step_angle, 2 * pi / pitch),
            )
            if tolerance > 0.0:
                pitch += step_pitch * _vertex(
                    _power(xy, weights, angle, 2 * pi / (pitch - step_pitch)),
                    _power(xy, weights, angle, 2 * pi / pitch),
                    _power(xy, weights, angle, 2 * pi / (pitch + step_pitch)),
                )
            step_angle *= 0.4
            step_pitch *= 0.4
        pitch = min(max(pitch, pitch_px * (1 - tolerance)), pitch_px * (1 + tolerance))
        wave = 2 * pi / pitch
        c, s = np.cos(angle) * wave, np.sin(angle) * wave
        ar = ai = br = bi = 0.0
        for i in range(len(weights)):
            a = c * xy[i, 0] + s * xy[i, 1]
            b = c * xy[i, 1] - s * xy[i, 0]
            ar += weights[i] * np.cos(a)
            ai += weights[i] * np.sin(a)
            br += weights[i] * np.cos(b)
            bi += weights[i] * np.sin(b)
        found[n, 0], found[n, 1] = angle, pitch
        found[n, 2], found[n, 3] = np.arctan2(ai, ar), np.arctan2(bi, br)
        found[n, 4] = (ar * ar + ai * ai + br * br + bi * bi) / (2.0 * total * total)
        n += 1
    return found[:n]
