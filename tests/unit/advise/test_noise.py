"""Noise after the decoder's smoothing against noise that is drawn and smoothed by FFT."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.advise.noise import noise_of
from tactape_fab.sense.decode.rule import SMOOTHING_MM
from tactape_fab.sense.sensors import load_sensor

SCALE = 16.0
SENSOR = replace(load_sensor("gelsight-mini"), px_per_mm=(SCALE, SCALE), slope_noise=None)


@pytest.mark.parametrize(("white_um", "blobs_um"), [(5.0, 0.0), (0.0, 3.0), (4.0, 10.0), (20.0, 2.0)])
def test_rms_slope_and_length_are_those_of_smoothed_noise(white_um: float, blobs_um: float) -> None:
    rng, side = np.random.default_rng(3), 768
    f = np.fft.fftfreq(side)
    square, across = f**2 + f[:, None] ** 2, np.broadcast_to(f[:, None], (side, side))

    def smooth_by(px: float) -> np.ndarray:
        return np.exp(-2.0 * (np.pi * px) ** 2 * square)

    blobs = np.fft.ifft2(np.fft.fft2(rng.standard_normal((side, side))) * smooth_by(6.0)).real
    drawn = white_um * rng.standard_normal((side, side)) + blobs_um * blobs / blobs.std()
    left = np.fft.fft2(drawn) * smooth_by(SMOOTHING_MM * SCALE)
    rms_um, slope_um_mm = np.fft.ifft2(left).real.std(), np.fft.ifft2(left * 2j * np.pi * across * SCALE).real.std()
    found = noise_of(replace(SENSOR, white_um=white_um, correlated_um=blobs_um, correlated_px=6.0))
    assert found == pytest.approx((rms_um, rms_um / slope_um_mm, slope_um_mm), rel=0.04)


def test_no_noise_has_no_slope() -> None:
    noise_um, alike_mm, slope_um_mm = noise_of(replace(SENSOR, white_um=0.0, correlated_um=0.0))
    assert (noise_um, slope_um_mm) == (0.0, 0.0)
    assert alike_mm > 0.0
