"""Dots -> the grid they stand on: angle, pitch and phase from all dots at once, without knowing any symbol.

Dots are displaced by about a sixth of the pitch along one axis. The first harmonic of the grid survives that, so the power
spectrum of the dots has a peak at the grid's wave vector, which gives angle and pitch, and its phase gives the origin. All dots
contribute; the paper looks for one baseline and one grid point (Eqs. 4 to 8).
`rule.LEAST_GRID_POWER` derives how much power remains.
"""

from __future__ import annotations

from math import factorial, pi

import numpy as np

from tactape_fab.base.jit import inlined_kernel, inner_kernel, kernel
from tactape_fab.sense.decode.dots.clip import clip
from tactape_fab.sense.decode.dots.kth import select
from tactape_fab.texture.frames import FloatArray, IntArray

ANGLES = 36
"""Angles scanned over a quarter turn: steps of 2.5 degrees, well below the width of a peak (pitch over contact size)."""
SCANNED = 28
"""Angles are scanned with so many of the strongest dots, and refined with all."""
REFINEMENTS = 3
_SCALE_STEP = 0.07
_COS = tuple((-1.0) ** k / factorial(2 * k) for k in range(9))
_SIN = tuple((-1.0) ** k / factorial(2 * k + 1) for k in range(8))


@inner_kernel(fastmath=True)
def _cos_sin(turns: float) -> tuple[float, float]:
    """Cosine and sine of an angle in turns, off by some 1e-11 at most; unlike those of libm, loops over it become vectors."""
    # Taylor series of half the angle, at most pi / 2, in Horner's form; then the formulas of the double angle
    half = pi * (turns - np.rint(turns))
    z = half * half
    c = _COS[8]
    c = c * z + _COS[7]
    c = c * z + _COS[6]
    c = c * z + _COS[5]
    c = c * z + _COS[4]
    c = c * z + _COS[3]
    c = c * z + _COS[2]
    c = c * z + _COS[1]
    c = c * z + _COS[0]
    s = _SIN[7]
    s = s * z + _SIN[6]
    s = s * z + _SIN[5]
    s = s * z + _SIN[4]
    s = s * z + _SIN[3]
    s = s * z + _SIN[2]
    s = s * z + _SIN[1]
    s = (s * z + _SIN[0]) * half
    return c * c - s * s, 2.0 * c * s


@inner_kernel(fastmath=True)
def _sums(xy: FloatArray, weights: FloatArray, angle: float, pitch: float) -> tuple[float, float, float, float]:
    """Weighted Fourier sums of the dots at both wave vectors of a square grid: real and imaginary part of each."""
    # wave vectors k = (cu, cv) and k' = (-cv, cu), in turns per px
    cu, cv = np.cos(angle) / pitch, np.sin(angle) / pitch
    ar = ai = br = bi = 0.0
    for i in range(len(weights)):
        c, s = _cos_sin(cu * xy[i, 0] + cv * xy[i, 1])
        ar += weights[i] * c
        ai += weights[i] * s
        c, s = _cos_sin(cu * xy[i, 1] - cv * xy[i, 0])
        br += weights[i] * c
        bi += weights[i] * s
    return ar, ai, br, bi


@kernel(fastmath=True)
def scan_power(xy: FloatArray, weights: FloatArray, pitch: float, buffer: FloatArray, power: FloatArray) -> None:
    """Fill in the summed power at both wave vectors of a square grid for ANGLES angles over a quarter turn.

    The second wave vector of an angle is the first one of the angle a quarter turn on. `buffer` is (4, 2 ANGLES).
    """
    cu, cv, real, imaginary = buffer[0], buffer[1], buffer[2], buffer[3]
    for j in range(2 * ANGLES):
        cu[j], cv[j] = np.cos(j * (pi / 2) / ANGLES) / pitch, np.sin(j * (pi / 2) / ANGLES) / pitch
        real[j] = imaginary[j] = 0.0
    for i in range(len(weights)):
        x, y, w = xy[i, 0], xy[i, 1], weights[i]
        for j in range(2 * ANGLES):
            # all angles of one dot follow one another in memory: this loop becomes vectors, one over the dots would not
            c, s = _cos_sin(cu[j] * x + cv[j] * y)
            real[j] += w * c
            imaginary[j] += w * s
    for j in range(ANGLES):
        k = j + ANGLES
        power[j] = real[j] * real[j] + imaginary[j] * imaginary[j] + (real[k] * real[k] + imaginary[k] * imaginary[k])


@inner_kernel()
def _climb(xy: FloatArray, weights: FloatArray, angle: float, pitch: float, step_angle: float, step_pitch: float) -> float:
    """Maximum of the parabola through the powers one step before, here and one step on; in steps from here, at most a half."""
    slope = bend = 0.0
    for k in range(-1, 2):
        ar, ai, br, bi = _sums(xy, weights, angle + k * step_angle, pitch + k * step_pitch)
        power = ar * ar + ai * ai + br * br + bi * bi
        # with p-, p0, p+ the top lies (p- - p+) / 2 (p- - 2 p0 + p+) steps on
        slope -= k * power
        bend += power if k != 0 else -2.0 * power
    # no step where the powers bend upwards: the parabola has no top
    return clip(0.5 * slope / bend, -0.5, 0.5) if bend < 0.0 else 0.0


@inlined_kernel()
def _choose(xy: FloatArray, weights: FloatArray, ordered: FloatArray, few: FloatArray, few_weights: FloatArray) -> None:
    """Fill in positions and weights of the strongest dots, as many as fit into `few`; `ordered` is a work buffer."""
    n, least = len(weights), 0.0
    count = equal = len(few)
    if count < n:
        for i in range(n):
            ordered[i] = weights[i]
        least = select(ordered, n - count)
        for i in range(n - count, n):
            equal -= 1 if ordered[i] > least else 0
    k = 0
    for i in range(n):
        if count == n or weights[i] >= least:
            if count < n and weights[i] == least:
                if equal == 0:
                    continue
                equal -= 1
            few[k, 0], few[k, 1], few_weights[k] = xy[i, 0], xy[i, 1], weights[i]
            k += 1


def find_lattices(xy: FloatArray, weights: FloatArray, pitch_px: float, tolerance: float, most: int) -> FloatArray:
    """The most likely grids for some dots, by their power.

    xy (n, 2): Dots from their centroid, px.
    weights (n,)
    pitch_px: Expected pitch.
    tolerance: Largest relative error of the pitch.
    most: Largest number of grids.
    Returns (k, 5): Angle of the first axis (rad), pitch (px), phases of both axes (rad), power over that of a perfect grid; best
        first. Angles are from 0 to pi/2 and may lie slightly outside: they are not wrapped.
    """
    n, found = len(weights), np.empty((most, 5))
    few, few_weights, ordered = np.empty((min(n, SCANNED), 2)), np.empty(min(n, SCANNED)), np.empty(n)
    waves, powers, marks = np.empty((4, 2 * ANGLES)), np.empty((2, ANGLES)), np.empty((2, ANGLES), dtype=np.int64)
    return found[: _fill_lattices(xy, weights, pitch_px, tolerance, few, few_weights, ordered, waves, powers, marks, found)]


@kernel()
def _fill_lattices(
    xy: FloatArray,
    weights: FloatArray,
    pitch_px: float,
    tolerance: float,
    few: FloatArray,
    few_weights: FloatArray,
    ordered: FloatArray,
    waves: FloatArray,
    powers: FloatArray,
    marks: IntArray,
    found: FloatArray,
) -> int:
    """Fill in what `find_lattices` returns, and return their number. The arrays from `few` to `marks` are work buffers."""
    # a peak over the pitch is as wide as pitch over contact, 0.14 for 11 mm of W = 1.5 mm: no scale is farther than 0.035 from
    # one tried
    steps = np.int64(np.ceil(tolerance / _SCALE_STEP))
    parts = steps if steps > 0 else 1
    _choose(xy, weights, ordered, few, few_weights)
    power, best, which, taken = powers[0], powers[1], marks[0], marks[1]
    for k in range(2 * steps + 1):
        scan_power(few, few_weights, pitch_px * (1.0 + tolerance * (k - steps) / parts), waves, power)
        for j in range(ANGLES):
            # `best`, `which` and `taken`: for each angle the largest power, the index of its scale, and whether its peak was
            # returned
            if k == 0 or power[j] > best[j]:
                best[j], which[j], taken[j] = power[j], k, 0
    total = 0.0
    for i in range(len(weights)):
        total += weights[i]
    n = 0
    for _ in range(len(found)):
        top = -1
        for j in range(ANGLES):
            # a peak over a circle: a grid turned by 90 degrees is the same grid
            if taken[j] == 1 or best[j] < best[(j + 1) % ANGLES] or best[j] < best[(j - 1) % ANGLES]:
                continue
            if top < 0 or best[j] > best[top]:
                top = j
        if top < 0:
            break
        taken[top] = 1
        angle = top * (pi / 2) / ANGLES
        pitch = pitch_px * (1.0 + tolerance * (which[top] - steps) / parts)
        # steps shrink to 0.16, and move by half of each at most: 0.78 of the first step in all, more than the 0.5 from one
        # angle to the middle between two
        step_angle, step_pitch = (pi / 2) / ANGLES, pitch_px * _SCALE_STEP
        for _ in range(REFINEMENTS):
            angle += step_angle * _climb(xy, weights, angle, pitch, step_angle, 0.0)
            if tolerance > 0.0:
                pitch += step_pitch * _climb(xy, weights, angle, pitch, 0.0, step_pitch)
            step_angle *= 0.4
            step_pitch *= 0.4
        pitch = clip(pitch, pitch_px * (1 - tolerance), pitch_px * (1 + tolerance))
        ar, ai, br, bi = _sums(xy, weights, angle, pitch)
        found[n, 0], found[n, 1] = angle, pitch
        # displacements along +a and -a cancel in the phase if they are equally many; `fit.fit_grid` corrects the remainder
        found[n, 2], found[n, 3] = np.arctan2(ai, ar), np.arctan2(bi, br)
        # a perfect grid has total^2 at each of both wave vectors
        found[n, 4] = (ar * ar + ai * ai + br * br + bi * bi) / (2.0 * total * total)
        n += 1
    return n
