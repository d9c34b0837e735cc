"""Noise: both parts come back from synthetic patches within their standard errors, and are zero where they are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense.calibrate.noise import off_contact
from tactape_fab.sense.calibrate.valid import clear_of_blind, valid_pixels
from tests.unit.sense.calibrate.sensors import STOCK


@pytest.mark.parametrize(("slope", "white_um"), [(0.03, 0.0), (0.0, 4.0), (0.03, 1.5)])
def test_white_noise_of_slopes_and_of_depth_are_told_apart(slope: float, white_um: float) -> None:
    rng = np.random.default_rng(7)
    shape = (480, 640)
    u, v = (2 * 16.0 * np.sin(np.pi * np.fft.fftfreq(n)) for n in (640, 480))
    square = u**2 + v[:, None] ** 2
    square[0, 0] = np.inf
    drawn = np.fft.fft2(rng.standard_normal(shape)) / np.sqrt(square) * slope
    frame = np.real(np.fft.ifft2(drawn)) + rng.standard_normal(shape) * white_um / 1000.0
    sensor = replace(STOCK, width_px=640, height_px=480, px_per_mm=(16.0, 16.0))
    found = off_contact([frame.astype(np.float32)], [], [0], sensor)
    assert found is not None and found.patches == 300
    assert abs(found.slope - slope) < max(4 * found.sigma_slope, 0.002)
    assert abs(found.white_um - white_um) < max(4 * found.sigma_white_um, 0.3)
    assert found.sigma_slope < 0.01 and found.sigma_white_um < 1.0


def test_few_patches_say_nothing() -> None:
    assert off_contact([np.zeros((48, 48), dtype=np.float32)], [], [0], replace(STOCK, width_px=48, height_px=48)) is None


def test_blind_pixels_are_those_that_never_change() -> None:
    rng = np.random.default_rng(1)
    frames = [rng.standard_normal((60, 80)).astype(np.float32) for _ in range(4)]
    assert valid_pixels(frames, STOCK) is None
    for frame in frames:
        frame[:, :10], frame[30, 50] = 0.25, np.nan
    valid = valid_pixels(frames, STOCK)
    assert valid is not None and not valid[:, :10].any() and not valid[30, 50] and valid[:, 10:].sum() == 60 * 70 - 1
    assert valid_pixels(frames[:2], STOCK) is None  # two frames may agree by chance
    masked = replace(STOCK, width_px=80, height_px=60, mask=valid)
    assert valid_pixels(frames, masked) is None  # what the profile's own mask hides
    clear = clear_of_blind(valid, 8.0)
    assert clear is not None and not clear[:, :15].any() and clear[30, 50] and clear[:, 17:].all()
