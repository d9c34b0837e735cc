"""Noise of a sensor's depth maps: white slopes, integrated as photometric stereo does, or white and smooth depth."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.sense.simulation.scene import SMOOTH_NOISE, Scene
from tactape_fab.sense.simulation.smoothing import FloatImage, gaussian_kernel, smooth
from tactape_fab.texture.frames import FloatArray

_PADDED = 1.2
"""Slope noise is drawn on a periodic field this much wider and higher than the image, so that opposite edges are not alike."""
_QUANTUM_MM = 2.0**-20
"""Slope noise is rounded to this, 1 nm, so that Fourier transforms that differ in their last bits give the same bytes."""


def add_noise(depth: FloatImage, profile: SensorProfile, scene: Scene, rng: np.random.Generator) -> None:
    """Add the noise of a sensor, or that of the scene in its place, to a canonical depth map in mm.

    Raises SpecError if the scene asks for slope noise and neither it nor the sensor says how much.
    """
    slope = slope_noise_of(profile, scene)
    if slope is None:
        _add_smooth_noise(depth, profile, scene, rng)
    elif slope * scene.noise > 0.0:
        drawn = _integrated(depth.shape, profile.px_per_mm, rng)
        depth += (np.rint(drawn * (slope * scene.noise / _QUANTUM_MM)) * _QUANTUM_MM)[: depth.shape[0], : depth.shape[1]]


def slope_noise_of(profile: SensorProfile, scene: Scene) -> float | None:
    """White noise of the slopes, rms a pixel; None where white and smooth noise of the depth is added instead.

    Raises SpecError as `add_noise`.
    """
    smooth_given = any(getattr(scene, name) is not None for name in SMOOTH_NOISE)
    if scene.noise_model == "smooth" or (scene.noise_model == "sensor" and smooth_given):
        return None
    slope = profile.slope_noise if scene.slope_noise is None else scene.slope_noise
    if slope is None and scene.noise_model == "slope":
        message = f"noise_model = slope, and sensor {profile.name} has no noise.slope; give slope_noise"
        raise SpecError(Problem("scene.noise_model", message))
    return slope


def _integrated(shape: tuple[int, ...], px_per_mm: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """Depth of white slope noise of 1 rms a pixel, periodic, larger than the image; mm."""
    height, width = (_fast_length(int(np.ceil(_PADDED * n))) for n in shape)
    # pairs of real numbers as complex ones, of variance 2
    drawn = rng.standard_normal((height, width // 2 + 1, 2)).view(np.complex128)[..., 0]
    return np.fft.irfft2(drawn * _amplitude(height, width, px_per_mm), (height, width))


@lru_cache(maxsize=4)
def _amplitude(height: int, width: int, px_per_mm: tuple[float, float]) -> FloatArray:
    """Factor on complex normal numbers of variance 2 that gives `irfft2` of them the spectrum S of integrated white slopes.

    Of slopes with noise of variance s^2 a pixel the nearest surface (least squares, as photometric stereo integrates) has
    S = s^2 / (4 R_u^2 sin^2(k_u / 2) + 4 R_v^2 sin^2(k_v / 2)), R in px/mm: it falls as 1 / f^2. Its slopes together, up to one
    pixel's difference times R along u and v, are white again with variance s^2. The mean is zero.
    """
    u = 2 * px_per_mm[0] * np.sin(np.pi * np.fft.rfftfreq(width))
    v = 2 * px_per_mm[1] * np.sin(np.pi * np.fft.fftfreq(height))
    square = u**2 + v[:, None] ** 2
    square[0, 0] = np.inf
    amplitude: FloatArray = np.sqrt(height * width / 2 / square)
    # irfft2 takes of these two columns the part that a real field can have: half of the variance
    amplitude[:, [0, -1]] *= np.sqrt(2.0)
    amplitude.setflags(write=False)
    return amplitude


def _fast_length(least: int) -> int:
    """The least even number from `least` on without a prime factor above 5: fast to transform."""
    length = least + least % 2
    while True:
        rest = length
        for factor in (2, 3, 5):
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return length
        length += 2


def _add_smooth_noise(depth: FloatImage, profile: SensorProfile, scene: Scene, rng: np.random.Generator) -> None:
    """White noise and smoothed noise, drawn beyond the image's edges so that its rms is the same everywhere."""
    white_um = profile.white_um if scene.white_um is None else scene.white_um
    correlated_um = profile.correlated_um if scene.correlated_um is None else scene.correlated_um
    blob_px = profile.correlated_px if scene.correlated_px is None else scene.correlated_px
    if white_um * scene.noise > 0.0:
        white = rng.standard_normal(depth.shape, dtype=np.float32)
        white *= np.float32(white_um * scene.noise / 1000)
        depth += white
    if correlated_um * scene.noise > 0.0:
        kernel = gaussian_kernel(blob_px)
        reach = len(kernel) // 2
        drawn = rng.standard_normal((depth.shape[0] + 2 * reach, depth.shape[1] + 2 * reach), dtype=np.float32)
        gain = correlated_um * scene.noise / 1000 / float((kernel.astype(np.float64) ** 2).sum())
        blobs = smooth(drawn, kernel, kernel * np.float32(gain), "constant")
        depth += blobs[reach:-reach, reach:-reach]
