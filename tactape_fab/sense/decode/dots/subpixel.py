"""Sub-pixel maxima by interpolation, without the bias that depends on where in a pixel they lie.

The maximum of a quadric through 3 x 3 pixels is biased by up to 8 % of a pixel, 10 um, depending on its position in the pixel. If
rows of pixels and of dots are parallel and a pitch is a whole number of pixels, all dots share the bias, and so does the pose.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.dots.detect import coarseness
from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.rule import SMOOTHING_MM
from tactape_fab.texture.frames import FloatArray

REACH = 2
"""Pixels on each side that enter the interpolation."""
WIDTH_MM = 2.0 * SMOOTHING_MM
"""Standard deviation of the interpolating Gaussians. With 0.2 to 0.44 mm, and a gel's blur of 0.05 to 0.25 mm, the bias stays
below 0.7 um; it is least with this."""
STEPS = 64
"""Positions in a pixel, along an axis, for which interpolation weights are tabulated."""


def sharp_tops(high: Image, px_per_mm: float, seen_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Correction of the quadric's maxima, px of the canonical image (n, 2), and the interpolated heights (n,).

    high (h, w): The band-pass that dots were found in, `Dots.high`.
    px_per_mm: The scale that dots were detected with.
    seen_px (n, 2): Detected positions in the canonical image.
    """
    n, coarse = len(seen_px), coarseness(px_per_mm)
    shift_px, heights = np.empty((n, 2)), np.empty(n)
    _shift(high, seen_px, coarse, _weights(WIDTH_MM * px_per_mm / coarse), shift_px, heights)
    return shift_px, heights


@lru_cache(maxsize=8)
def _weights(width_px: float) -> Image:
    """Weights of the pixels round a position that give value, slope and curvature there; (STEPS + 1, 2 REACH + 1, 3).

    Interpolation by Gaussian radial basis functions, one on every pixel.
    """
    # the interpolant is sum_k c_k g(x - x_k), g a Gaussian, with K c = z at the pixels: so value, slope and curvature at a
    # place are r.K^-1 z, r = g, g', g'' there, and the weights K^-1 r do not depend on the frame
    at, pixels = np.linspace(-0.5, 0.5, STEPS + 1)[:, None], np.arange(-REACH, REACH + 1.0)
    known = np.exp(-0.5 * ((pixels[:, None] - pixels) / width_px) ** 2)
    off = (pixels - at) / width_px
    bell = np.exp(-0.5 * off**2)
    # g' = off g / width and g'' = (off^2 - 1) g / width^2, as off = (x_k - x) / width
    rows = np.stack([bell, off / width_px * bell, (off**2 - 1.0) / width_px**2 * bell], axis=1)
    table = np.linalg.solve(known, rows.transpose(0, 2, 1)).astype(np.float32)
    table.setflags(write=False)
    return table


@kernel(fastmath=True)
def _shift(high: Image, seen_px: FloatArray, coarse: int, weights: Image, out: FloatArray, heights: FloatArray) -> None:
    """Fill in heights, and corrections by a Newton step from the nearest tabulated position; 0 at the border and off maxima."""
    h, w, far = high.shape[0], high.shape[1], (coarse - 1) / 2
    for i in range(len(seen_px)):
        out[i, 0] = out[i, 1] = heights[i] = 0.0
        # from pixels of the image to blocks, whose middle is (coarse - 1) / 2 pixels on (`filters._centres`)
        x, y = (seen_px[i, 0] - far) / coarse, (seen_px[i, 1] - far) / coarse
        u, v = np.int64(np.floor(x + 0.5)), np.int64(np.floor(y + 0.5))
        if u < REACH or v < REACH or u >= w - REACH or v >= h - REACH:
            continue
        # the table's nearest entry is at most 1/128 px off, so that one step of Newton from it is enough
        a, b = np.int64((x - u + 0.5) * STEPS + 0.5), np.int64((y - v + 0.5) * STEPS + 0.5)
        height = gx = gy = hxx = hyy = hxy = np.float32(0.0)
        around, across, down = high[v - REACH : v + REACH + 1, u - REACH : u + REACH + 1], weights[a], weights[b]
        for j in range(2 * REACH + 1):
            # separable: along the rows first, then down the columns of the results
            value = slope = bend = np.float32(0.0)
            for k in range(2 * REACH + 1):
                value += across[k, 0] * around[j, k]
                slope += across[k, 1] * around[j, k]
                bend += across[k, 2] * around[j, k]
            height += down[j, 0] * value
            gx += down[j, 0] * slope
            gy += down[j, 1] * value
            hxx += down[j, 0] * bend
            hxy += down[j, 1] * slope
            hyy += down[j, 2] * value
        heights[i] = height
        det = hxx * hyy - hxy * hxy
        if det > 0.0 and hxx < 0.0:
            dx = u + a / STEPS - 0.5 + (hxy * gy - hyy * gx) / det - x
            dy = v + b / STEPS - 0.5 + (hxy * gx - hxx * gy) / det - y
            # farther off is another top, or none
            if abs(dx) < 0.5 and abs(dy) < 0.5:
                out[i, 0], out[i, 1] = coarse * dx, coarse * dy
