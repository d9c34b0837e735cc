"""Noise of a sensor: its white part and that of its slopes, from patches that touch nothing, or from between the dots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.optimize import minimize

from tactape_fab.sense.calibrate.presses import Frame, Press
from tactape_fab.sense.decode.dots.inputs import canonical_frame
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import BoolArray, FloatArray

SIDE_PX = 32
CLEAR_MM = 2.0
"""Distance of a patch from every dot: beyond the contact's rim."""
LOWEST = 4
"""Least frequency that is used, cycles per patch: below, the window leaks remains of the contact's shape."""
LEAST_PATCHES = 4
LEAST_SLOPE, MOST_SLOPE, MOST_WHITE_UM = 2e-4, 1.0, 1000.0
"""Bounds of the noise of depths in millimetres: sensors' slopes have some hundredths. Beyond them is that of another unit: in
metres a GelSight Mini has 3e-5."""
_SPREAD = (35.0 / 18.0) ** 2
"""Factor by which a Hann window reduces the number of independent ordinates of a periodogram."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Noise of the depth and its standard errors.

    slope: White noise of the slopes, rms a pixel; in the frame's unit a mm where depth is not calibrated.
    white_um: White noise of the depth, micrometres, or thousandths of the frame's unit where depth is not calibrated.
    patches: Patches off contact; 0 where it is from between the dots.
    """

    slope: float
    white_um: float
    sigma_slope: float
    sigma_white_um: float
    patches: int

    @property
    def of_mm(self) -> bool:
        """Whether it may be that of depths in millimetres, as a profile has it."""
        return (self.slope == 0.0 or LEAST_SLOPE <= self.slope <= MOST_SLOPE) and self.white_um <= MOST_WHITE_UM


def off_contact(frames: Sequence[Frame], presses: Sequence[Press], empty: Sequence[int], sensor: SensorProfile) -> Noise | None:
    """Noise from patches of frames that touch nothing there.

    empty: Frames without a contact.
    Returns: None where there are fewer than four patches.
    """
    unit = sensor.depth_unit_mm or 1.0
    # a mean of periodograms is as good as all of them: the likelihood depends on them through their mean alone
    power, count = np.zeros((SIDE_PX, SIDE_PX)), 0
    touched = [(press.frame, press.seen_px) for press in presses] + [(k, np.zeros((0, 2))) for k in empty]
    for index, dots_px in touched:
        image = canonical_frame(frames[index], sensor)
        clear = _clear(image.shape, dots_px, sensor)
        for v in range(0, image.shape[0] - SIDE_PX + 1, SIDE_PX):
            for u in range(0, image.shape[1] - SIDE_PX + 1, SIDE_PX):
                if clear[v : v + SIDE_PX, u : u + SIDE_PX].all():
                    power += _periodogram(image[v : v + SIDE_PX, u : u + SIDE_PX].astype(np.float64) * unit)
                    count += 1
    return _split(power / count, count, sensor) if count >= LEAST_PATCHES else None


def between_dots(left: float, freedom: float, sensor: SensorProfile) -> Noise:
    """Noise of the slopes from the residuals of a fit of the dots' relief, which do not tell white noise of the depth apart.

    left: Squared residual differences of neighbouring pixels, over those expected for slopes of variance 1.
    freedom: Degrees of freedom of all of them.
    """
    scale = sqrt(sensor.px_per_mm[0] * sensor.px_per_mm[1])
    # differences of neighbouring pixels are slopes over R
    slope = sqrt(max(left, 0.0)) * scale * (sensor.depth_unit_mm or 1.0)
    return Noise(slope=slope, white_um=0.0, sigma_slope=slope / sqrt(2.0 * max(freedom, 1.0)), sigma_white_um=np.inf, patches=0)


def _clear(shape: tuple[int, ...], dots_px: FloatArray, sensor: SensorProfile) -> BoolArray:
    """Pixels of a canonical image that are far from every dot and carry depth."""
    near = np.zeros(shape, dtype=bool)
    if len(dots_px):
        u, v = np.rint(dots_px).astype(np.int64).T
        near[np.clip(v, 0, shape[0] - 1), np.clip(u, 0, shape[1] - 1)] = True
        # so many dilations by 3x3 are a square of that reach
        reach = round(CLEAR_MM * max(sensor.px_per_mm))
        near = binary_dilation(near, np.ones((3, 3), dtype=bool), iterations=reach)
    return np.asarray(~near if sensor.mask is None else ~near & sensor.mask)


def _periodogram(patch: FloatArray) -> FloatArray:
    """Power spectrum of a patch less its background of second order, in Hann's window; variance a pixel and frequency."""
    side = np.linspace(-1.0, 1.0, SIDE_PX)
    v, u = np.meshgrid(side, side, indexing="ij")
    smooth = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1).reshape(-1, 6)
    left = patch.ravel() - smooth @ np.linalg.lstsq(smooth, patch.ravel(), rcond=None)[0]
    # without a window, the steep spectrum of depth leaks from low frequencies into all others
    window = np.hanning(SIDE_PX)[:, None] * np.hanning(SIDE_PX)
    return np.asarray(np.abs(np.fft.fft2(left.reshape(patch.shape) * window)) ** 2 / (window**2).sum())


def _split(power: FloatArray, count: int, sensor: SensorProfile) -> Noise:
    """White noise and that of the slopes from a mean periodogram, by Whittle's likelihood (Arkiv Mat. 2 (1953) 423)."""
    cycles = np.fft.fftfreq(SIDE_PX)
    # slopes are differences of neighbouring pixels times R: the power of depth is that of slopes over 4 R^2 sin^2(pi f), both
    # axes added
    along, down = 2.0 * sensor.px_per_mm[0] * np.sin(np.pi * cycles), 2.0 * sensor.px_per_mm[1] * np.sin(np.pi * cycles)
    u, v = np.meshgrid(cycles * SIDE_PX, cycles * SIDE_PX)
    used = np.hypot(u, v) >= LOWEST
    shape = 1.0 / (along**2 + down[:, None] ** 2)[used]
    seen = power[used]
    # the search is in units of the data's own size, to be independent of the frame's unit
    unit = float(seen.mean())
    if not unit > 0.0:
        return Noise(slope=0.0, white_um=0.0, sigma_slope=0.0, sigma_white_um=0.0, patches=count)
    basis = np.stack([np.ones_like(shape), shape / shape.mean()])

    def cost(z: FloatArray) -> tuple[float, FloatArray]:
        model = np.maximum(z @ basis, 1e-9)
        ratio = seen / unit / model
        # ordinates are exponential about the model S: - ln L = sum of I / S + ln S, and its slope by a coefficient is that of S
        # times (1 - I / S) / S
        return float((ratio + np.log(model)).mean()), basis @ ((1.0 - ratio) / model) / len(model)

    found = minimize(cost, np.array([0.5, 0.5]), jac=True, bounds=[(0.0, None)] * 2, method="L-BFGS-B").x
    model = np.maximum(found @ basis, 1e-9)
    # half of the ordinates of a real image are the other half again
    # an exponential's ln mean has the information 1: the sum of dS dS^T / S^2 over independent ordinates
    information = (basis / model) @ (basis / model).T * count / 2.0 / _SPREAD
    spread = np.sqrt(np.diag(np.linalg.inv(information))) * unit
    white, slope = found[0] * unit, found[1] * unit / shape.mean()
    sigma_white, sigma_slope = spread[0], spread[1] / shape.mean()
    return Noise(
        slope=sqrt(slope),
        white_um=1000.0 * sqrt(white),
        sigma_slope=_of_root(slope, sigma_slope),
        sigma_white_um=1000.0 * _of_root(white, sigma_white),
        patches=count,
    )


def _of_root(value: float, sigma: float) -> float:
    """Standard error of sqrt(value), for `sigma` that of the value: sigma / (2 sqrt(value)), at most sqrt(sigma)."""
    return float(min(sigma / (2.0 * sqrt(value)), sqrt(sigma))) if value > 0.0 else sqrt(sigma)
