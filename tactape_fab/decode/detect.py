"""Depth map -> dots: a band-pass, its local maxima, and their sub-pixel centres. Scale and background do not matter.

Pixel coordinates are those of SPEC's image frame: u right, v down, whole numbers at pixel centres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from tactape_fab.texture.frames import FloatArray

SMOOTHING_MM = 0.125
BACKGROUND_MM = 1.5625
NEIGHBOURHOOD_MM = 0.3125
STRONGEST = 8
LEAST_SHARE = 0.3
"""A dot is at least this high compared with the median of the strongest ones."""
MOST_DOTS = 400
COARSE_PX_PER_MM = 7.0
"""Finer images are averaged down to no less than this."""
USUAL_NOISE, LEAST_NOISE = 0.15, 0.03
"""Median weight of the bumps of noise: as it is in the default scene, and the least that is believed."""
NOISE_MIDDLE, NOISE_WIDTH, MOST_MIDDLE = 1.95, 0.17, 0.6

Image = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dots:
    """Dots of one frame.

    Attributes
    ----------
    xy_px : ndarray, shape (n, 2)
    weights : ndarray, shape (n,)
        Height of each over the median of the strongest, so that 1 is an ordinary good dot.
    trust : ndarray, shape (n,)
        How likely each is a part at all, from its height and that of the noise.
    """

    xy_px: FloatArray
    weights: FloatArray
    trust: FloatArray


def trusted(weights: FloatArray, noise: float = USUAL_NOISE) -> FloatArray:
    """How likely dots of some weights are parts, where bumps of the noise have the median weight `noise`.

    A logistic curve whose middle and width were fitted to simulated frames of the default scene, of twice its noise, and
    of an elastomer of 0.25 mm.
    """
    middle = min(NOISE_MIDDLE * noise, MOST_MIDDLE)
    trust: FloatArray = 1.0 / (1.0 + np.exp(-np.clip((weights - middle) / (NOISE_WIDTH * noise), -30.0, 30.0)))
    return trust


def band_pass(depth: Image, px_per_mm: float) -> Image:
    """What is as wide as a part: smoothed, less a mean over the pitch (paper, Eq. 1, with a smoother kernel)."""
    import cv2

    box = 2 * round(BACKGROUND_MM * px_per_mm / 2) + 1
    smooth: Any = cv2.GaussianBlur(depth, (0, 0), SMOOTHING_MM * px_per_mm)
    smooth -= cv2.blur(depth, (box, box))
    out: Image = smooth
    return out


def detect(depth: Image, px_per_mm: float) -> Dots:
    """Find the dots of a canonical depth map.

    Parameters
    ----------
    depth : ndarray of float32, shape (h, w)
        Finite, larger = pushed further in.
    px_per_mm : float
    """
    import cv2

    coarse = max(int(px_per_mm / COARSE_PX_PER_MM), 1)
    if coarse > 1:  # a part is still several pixels wide, and everything below costs its square less
        h, w = depth.shape
        whole = depth[: h - h % coarse, : w - w % coarse]
        depth = np.asarray(cv2.resize(whole, (w // coarse, h // coarse), interpolation=cv2.INTER_AREA))
        px_per_mm = px_per_mm / coarse
    high = band_pass(depth, px_per_mm)
    reach = max(round(NEIGHBOURHOOD_MM * px_per_mm), 1)
    highest = cv2.dilate(high, np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8))
    xy, height = _peaks(high, highest, reach)
    if len(height) == 0:
        return Dots(xy_px=np.empty((0, 2)), weights=np.empty(0), trust=np.empty(0))
    order = np.argsort(-height, kind="stable")[:MOST_DOTS]
    scale = float(np.median(height[order[:STRONGEST]]))
    kept = order[height[order] >= LEAST_SHARE * scale]
    weights = height[kept] / scale
    noise = max(float(np.median(height)) / scale, LEAST_NOISE)
    return Dots(xy_px=xy[kept] * coarse + (coarse - 1) / 2, weights=weights, trust=trusted(weights, noise))


@njit(cache=True, error_model="numpy")
def _peaks(high: Image, highest: Image, margin: int) -> tuple[FloatArray, FloatArray]:
    """Positive local maxima and the top of the quadric through 3 x 3 pixels round each."""
    h, w = high.shape
    xy = np.empty((4096, 2))
    height = np.empty(4096)
    n = 0
    for v in range(1, h - 1):
        for u in range(1, w - 1):
            c = high[v, u]
            if c <= 0.0 or c != highest[v, u] or n == 4096:
                continue
            gx = 0.5 * (high[v, u + 1] - high[v, u - 1])
            gy = 0.5 * (high[v + 1, u] - high[v - 1, u])
            hxx = high[v, u + 1] - 2.0 * c + high[v, u - 1]
            hyy = high[v + 1, u] - 2.0 * c + high[v - 1, u]
            hxy = 0.25 * (high[v + 1, u + 1] - high[v + 1, u - 1] - high[v - 1, u + 1] + high[v - 1, u - 1])
            det = hxx * hyy - hxy * hxy
            dx = dy = 0.0
            if det > 0.0:
                dx = (hxy * gy - hyy * gx) / det
                dy = (hxy * gx - hxx * gy) / det
            if abs(dx) > 1.0 or abs(dy) > 1.0:
                dx = dy = 0.0
            xy[n, 0] = u + dx
            xy[n, 1] = v + dy
            height[n] = c + 0.5 * (gx * dx + gy * dy)
            n += 1
    return xy[:n].copy(), height[:n].copy()
