"""Noise of simulated frames: white slopes, integrated, beside the older white and smooth noise of the depth."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.sense import Scene, SensorProfile, load_sensor
from tactape_fab.sense.simulation.gel import press
from tactape_fab.sense.simulation.noise import _amplitude, _fast_length, slope_noise_of
from tactape_fab.texture.frames import FloatArray

MINI = load_sensor("gelsight-mini")
FLAT = Scene(contact="pad", dome_mm=0.0, tilt_mm_per_mm=(0.0, 0.0))
SLOPE, COUNT = 0.032, 30


@lru_cache(maxsize=16)
def noise(sensor: SensorProfile = MINI, scene: Scene = FLAT, count: int = COUNT) -> FloatArray:
    """Frames of nothing, mm."""
    shape = (sensor.height_px, sensor.width_px)
    frames = [press(np.zeros(shape), sensor, scene, np.random.default_rng(k)) for k in range(count)]
    return np.stack(frames).astype(np.float64)


def bands(frames: FloatArray, edges: list[tuple[float, float]], px_per_mm: float) -> FloatArray:
    """Amplitude spectrum, averaged over rings of so many cycles/mm; Hann's window keeps strong low waves out of the others."""
    h, w = frames.shape[1:]
    window = np.outer(np.hanning(h), np.hanning(w))
    power = (np.abs(np.fft.fft2((frames - frames.mean(axis=(1, 2), keepdims=True)) * window)) ** 2).mean(axis=0)
    ring = np.hypot(np.fft.fftfreq(w), np.fft.fftfreq(h)[:, None]) * px_per_mm
    return np.sqrt([power[(ring >= low) & (ring < high)].mean() / (window**2).sum() for low, high in edges])


def test_slopes_are_white_and_as_strong_as_said() -> None:
    depth = noise()
    across, down = (np.diff(depth, axis=axis)[:, : 240 - 1, : 320 - 1] * 16.0 for axis in (2, 1))
    assert np.sqrt((across**2 + down**2).mean()) == pytest.approx(SLOPE, rel=0.01)
    assert across.std() == pytest.approx(down.std(), rel=0.02)
    power = (np.abs(np.fft.fft2(across)) ** 2 + np.abs(np.fft.fft2(down)) ** 2).mean(axis=0) / across[0].size
    ring = np.hypot(np.fft.fftfreq(319), np.fft.fftfreq(239)[:, None])
    for low, high in ((0.02, 0.1), (0.1, 0.2), (0.2, 0.3), (0.3, 0.4), (0.4, 0.5)):
        assert power[(ring >= low) & (ring < high)].mean() == pytest.approx(SLOPE**2, rel=0.03), (low, high)


def test_depth_falls_as_the_square_of_frequency() -> None:
    """S = (slope / R)^2 / (4 sin^2(k_u / 2) + 4 sin^2(k_v / 2)): up to 2 cycles/mm that is 1 / k^2 within 2 %."""
    edges = [(0.25, 0.5), (0.5, 0.75), (0.75, 1.0), (1.25, 1.5), (2.0, 2.25)]
    expected = [SLOPE / 16.0 / np.sqrt(_mean_square(low, high)) for low, high in edges]
    np.testing.assert_allclose(bands(noise(), edges, 16.0), expected, rtol=0.05)


def _mean_square(low: float, high: float) -> float:
    """One over the mean of 1 / k^2 over a ring, k in rad/px at 16 px/mm."""
    near, far = (2 * np.pi * edge / 16.0 for edge in (low, high))
    return float((far**2 - near**2) / 2 / np.log(far / near))


def test_the_older_noise_is_stronger_by_what_real_images_showed() -> None:
    """Amplitude over that of 172 patches of a GelSight Mini off contact: 7.2, 4.5, 1.1 and 1.7 in these bands, cycles/mm.

    Outside them the patches are no 1 / f^2: below 0.5 they have 2.4 times its amplitude (4.4 in place of 10.8), above 3
    less of it (3.7 in place of 2.9 at 4, 12 in place of 4.3 at 7).
    """
    measured = {(0.5, 0.75): 7.2, (0.75, 1.0): 4.5, (1.25, 1.5): 1.1, (2.0, 2.25): 1.7}
    ratio = bands(noise(scene=replace(FLAT, noise_model="smooth")), list(measured), 16.0) / bands(noise(), list(measured), 16.0)
    np.testing.assert_allclose(ratio, list(measured.values()), rtol=0.3)
    np.testing.assert_allclose(ratio[1:], list(measured.values())[1:], rtol=0.12)


def test_it_is_as_strong_at_the_edges_and_opposite_edges_are_not_alike() -> None:
    depth = noise()
    flat = depth - depth.mean(axis=(1, 2), keepdims=True)
    left, beside, opposite = (flat[:, :, u].ravel() for u in (0, 1, -1))
    assert np.diff(flat, axis=1)[:, :, :2].std() == pytest.approx(np.diff(flat, axis=1).std(), rel=0.03)
    assert np.corrcoef(left, beside)[0, 1] > 0.7  # as opposite edges of a field that wraps would be
    assert np.corrcoef(left, opposite)[0, 1] < 0.2


def test_the_scene_s_factor_and_figure_scale_it() -> None:
    once = noise(count=2)
    for scene in (
        replace(FLAT, noise=2.0),
        replace(FLAT, slope_noise=2 * SLOPE),
        replace(FLAT, noise=4.0, slope_noise=SLOPE / 2),
    ):
        np.testing.assert_allclose(noise(scene=scene, count=2), 2 * once, atol=2e-6)  # each is rounded to a nanometre
    assert not noise(scene=replace(FLAT, noise=0.0), count=1).any()
    assert not noise(scene=replace(FLAT, slope_noise=0.0), count=1).any()


def test_each_axis_has_its_own_scale() -> None:
    """Slopes of equal noise along both axes, where a pixel is half as high as it is wide."""
    depth = noise(replace(MINI, px_per_mm=(16.0, 32.0)))
    across, down = np.diff(depth, axis=2)[:, :-1] * 16.0, np.diff(depth, axis=1)[:, :, :-1] * 32.0
    assert np.sqrt((across**2 + down**2).mean()) == pytest.approx(SLOPE, rel=0.01)


def test_noise_is_whole_nanometres_and_lengths_are_fast() -> None:
    """So that transforms that differ in their last bits give the same bytes."""
    steps = noise(count=1) * 2.0**20
    np.testing.assert_array_equal(steps, np.rint(steps))
    assert [_fast_length(n) for n in (288, 289, 384, 1, 7)] == [288, 300, 384, 2, 8]
    assert _amplitude(288, 384, (16.0, 16.0))[0, 0] == 0.0


def test_which_model_it_is() -> None:
    old = replace(MINI, slope_noise=None)
    cases: list[tuple[SensorProfile, dict[str, Any], float | None]] = [
        (MINI, {}, SLOPE),
        (old, {}, None),
        (MINI, {"noise_model": "smooth"}, None),
        (MINI, {"white_um": 3.0}, None),
        (MINI, {"correlated_px": 3.0}, None),
        (MINI, {"noise_model": "slope"}, SLOPE),
        (old, {"slope_noise": 0.1}, 0.1),
        (old, {"noise_model": "slope", "slope_noise": 0.1}, 0.1),
    ]
    for sensor, options, slope in cases:
        assert slope_noise_of(sensor, FLAT.changed(options)) == slope, options
    with pytest.raises(SpecError, match=r"sensor gelsight-mini has no noise\.slope; give slope_noise"):
        slope_noise_of(old, replace(FLAT, noise_model="slope"))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"noise_model": "pink"}, "none of: sensor, slope, smooth"),
        ({"noise_model": "slope", "white_um": 4.0}, "white_um is a figure of the noise model smooth"),
        ({"slope_noise": 0.03, "correlated_px": 4.0}, "correlated_px is a figure of the noise model smooth"),
        ({"noise_model": "smooth", "slope_noise": 0.03}, "slope_noise is a figure of the noise model slope"),
        ({"slope_noise": -0.03}, "slope_noise = -0.03 is below 0"),
    ],
)
def test_figures_of_another_model_are_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(SpecError, match=said):
        FLAT.changed(options)
