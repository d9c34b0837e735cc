"""Noise of a sensor's depth maps around a dot, after the decoder's filter."""

from __future__ import annotations

from functools import lru_cache
from math import hypot, pi, sqrt

import numpy as np

from tactape_fab.sense.decode.rule import BACKGROUND_MM, SMOOTHING_MM
from tactape_fab.sense.sensors import SensorProfile

_STEP, _HIGHEST = 0.02, 5.0
"""Step and end of the sum over frequencies, cycles/mm; at the end the decoder's smoothing leaves exp(-7) of the power."""


def noise_of(sensor: SensorProfile) -> tuple[float, float, float]:
    """Rms (um), correlation length (mm) and rms slope along one axis (um/mm) of the filtered noise.

    A noise whose autocorrelation is a Gaussian of standard deviation L has slopes of rms / L: L is the correlation length.
    """
    scale = sqrt(sensor.px_per_mm[0] * sensor.px_per_mm[1])
    if sensor.slope_noise is not None:
        noise_um, slope_um_mm = (1000.0 * sensor.slope_noise / scale * of_one for of_one in _of_white_slopes())
        return noise_um, _of_white_slopes()[0] / _of_white_slopes()[1], slope_um_mm
    # a Gaussian filter of standard deviation s reduces the rms of white noise by 1 / (2 sqrt(pi) s), and its autocorrelation has
    # the standard deviation sqrt(2) s; blobs are white noise already smoothed by b, so b^2 + s^2 replaces s^2. The background
    # that the filter subtracts is neglected
    smooth_px, blob_px = SMOOTHING_MM * scale, sensor.correlated_px
    white_um = sensor.white_um / (2.0 * sqrt(pi) * smooth_px)
    blob2_px2 = blob_px**2 + smooth_px**2
    blobs_um = sensor.correlated_um * blob_px / sqrt(blob2_px2)
    slope_um_mm = scale * hypot(white_um / (sqrt(2.0) * smooth_px), blobs_um / sqrt(2.0 * blob2_px2))
    noise_um = hypot(white_um, blobs_um)
    # the correlation length follows from rms and slope of both together; without noise it is arbitrary
    return noise_um, noise_um / slope_um_mm if slope_um_mm > 0.0 else sqrt(2.0) * SMOOTHING_MM, slope_um_mm


@lru_cache(maxsize=1)
def _of_white_slopes() -> tuple[float, float]:
    """Rms of filtered depth (mm), and of its slope along one axis, per unit of slope noise times pixel size, s / R.

    Depth whose slopes have white noise s in each pixel has the spectrum (s / R)^2 / (2 pi f)^2 (`sense.simulation.noise`).
    It is infinite at f = 0, so the result depends on the background that the filter subtracts, a mean over a square.
    """
    # midpoints of intervals, so that f = 0, where the spectrum is infinite, is between two of them
    f = (np.arange(int(2 * _HIGHEST / _STEP)) + 0.5) * _STEP - _HIGHEST
    square = (2.0 * pi * f) ** 2 + (2.0 * pi * f[:, None]) ** 2
    # spectrum of a mean over a square along one axis; `left` is the power after the Gaussian less the mean
    mean = np.sinc(BACKGROUND_MM * f)
    left = (np.exp(-square * SMOOTHING_MM**2 / 2.0) - mean * mean[:, None]) ** 2
    # the slope along one axis has (2 pi f_x)^2 times the power; averaged over both axes that is half of `square`, which cancels
    return sqrt(float((left / square).sum()) * _STEP**2), sqrt(float(left.sum()) / 2.0 * _STEP**2)
