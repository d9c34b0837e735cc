"""Noise: both parts come back from synthetic patches within their standard errors, and are zero where they are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense.calibrate.noise import (
    CLEAR_MM,
    LEAST_SLOPE,
    MOST_SLOPE,
    MOST_WHITE_UM,
    Noise,
    _clear,
    between_dots,
    off_contact,
)
from tactape_fab.sense.calibrate.valid import clear_of_blind, valid_pixels
from tactape_fab.texture.frames import FloatArray
from tests.unit.sense.calibrate.sensors import STOCK


def drawn(rng: np.random.Generator, shape: tuple[int, int], slope: float, white_um: float) -> FloatArray:
    """Depth whose neighbouring pixels differ by white noise of a slope, at 16 px/mm, and white noise of its own."""
    v, u = (2 * 16.0 * np.sin(np.pi * np.fft.fftfreq(n)) for n in shape)
    square = u**2 + v[:, None] ** 2
    square[0, 0] = np.inf
    spectrum = np.fft.fft2(rng.standard_normal(shape)) / np.sqrt(square) * slope
    return np.asarray(np.real(np.fft.ifft2(spectrum)) + rng.standard_normal(shape) * white_um / 1000.0)


@pytest.mark.parametrize(("slope", "white_um"), [(0.03, 0.0), (0.0, 4.0), (0.03, 1.5)])
def test_white_noise_of_slopes_and_of_depth_are_told_apart(slope: float, white_um: float) -> None:
    frame = drawn(np.random.default_rng(7), (480, 640), slope, white_um)
    sensor = replace(STOCK, width_px=640, height_px=480, px_per_mm=(16.0, 16.0))
    found = off_contact([frame.astype(np.float32)], [], [0], sensor)
    assert found is not None and found.patches == 300
    assert abs(found.slope - slope) < max(4 * found.sigma_slope, 0.002)
    assert abs(found.white_um - white_um) < max(4 * found.sigma_white_um, 0.3)
    assert found.sigma_slope < 0.01 and found.sigma_white_um < 1.0


def test_noise_is_as_exact_as_is_said() -> None:
    """Of 20 frames with both parts."""
    rng, sensor = np.random.default_rng(3), replace(STOCK, width_px=128, height_px=64, px_per_mm=(16.0, 16.0))
    found = [off_contact([drawn(rng, (64, 128), 0.03, 1.5).astype(np.float32)], [], [0], sensor) for _ in range(20)]
    for name, sigma in (("slope", "sigma_slope"), ("white_um", "sigma_white_um")):
        of_all, said = (np.array([getattr(one, key) for one in found]) for key in (name, sigma))
        assert of_all.std() == pytest.approx(np.sqrt((said**2).mean()), rel=0.35)


@pytest.mark.parametrize(
    ("slope", "white_um", "of_mm"),
    [(0, 0, True), (1, 1, True), (1.01, 0, False), (0, 1.01, False), (0.99 * LEAST_SLOPE, 0, False), (LEAST_SLOPE, 0, True)],
)
def test_noise_beyond_any_depth_in_mm_is_of_another_unit(slope: float, white_um: float, of_mm: bool) -> None:
    values = {"sigma_slope": 0.0, "sigma_white_um": 0.0, "patches": 0}
    assert Noise(slope=slope * MOST_SLOPE, white_um=white_um * MOST_WHITE_UM, **values).of_mm is of_mm  # type: ignore[arg-type]


def test_noise_between_dots_is_that_of_the_slopes() -> None:
    """A root mean square of 0.002 mm a pixel at 16 x 9 px/mm is a slope of 0.024, to 5 % with 200 degrees of freedom."""
    found = between_dots(0.002**2, 200.0, replace(STOCK, px_per_mm=(16.0, 9.0)))
    assert (found.slope, found.sigma_slope) == pytest.approx((0.024, 0.024 / 20.0)) and found.sigma_white_um == np.inf
    assert between_dots(0.002**2, 200.0, replace(STOCK, px_per_mm=(16.0, 9.0), depth_unit_mm=0.5)).slope == pytest.approx(0.012)
    assert between_dots(-1e-9, 0.0, STOCK).slope == 0.0


def test_pixels_near_a_dot_or_masked_are_not_clear() -> None:
    """Dots may be a pixel outside: they count at the rim."""
    mask = np.ones((200, 240), dtype=bool)
    mask[:, 235:] = False
    sensor = replace(STOCK, width_px=240, height_px=200, px_per_mm=(10.0, 8.0), mask=mask)
    reach, expected = round(10.0 * CLEAR_MM), mask.copy()
    for u, v in ((120, 60), (0, 199), (60, 0)):
        expected[max(v - reach, 0) : v + reach + 1, max(u - reach, 0) : u + reach + 1] = False
    dots_px = np.array([(120.4, 59.6), (-0.8, 199.9), (60.0, -0.8)])
    assert (_clear((200, 240), dots_px, sensor) == expected).all()
    assert (_clear((200, 240), dots_px[:0], sensor) == mask).all()
    assert _clear((200, 240), dots_px[:0], replace(sensor, mask=None)).all()


def test_few_patches_say_nothing() -> None:
    """And one with a pixel that carries no depth is none."""
    mask = np.ones((96, 96), dtype=bool)
    mask[40, 50] = False
    found = off_contact([np.zeros((96, 96), dtype=np.float32)], [], [0], replace(STOCK, width_px=96, height_px=96, mask=mask))
    assert found is not None and found.patches == 8
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
