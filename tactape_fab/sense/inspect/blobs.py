"""Blob detection in a scan without a warp: centres of lands with their parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tactape_fab.base.libraries import library
from tactape_fab.sense.inspect.patches import Samples
from tactape_fab.sense.inspect.scan_files import Picture
from tactape_fab.texture.frames import FloatArray

COARSE_PX_PER_MM = 10.0
_FILM_WINDOW_MM = 2.5
"""Side of the median filter: parts and lands cover less than half of it, so that the median is film."""
_LEVEL = 24.0
"""Difference from the film, of 255, at which a pixel counts as part or land; larger differences are clipped to it."""
_LEAST_SHARE = 0.35


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Blobs:
    """Centres (u, v) in the full scan, px; shape (n, 2)."""

    px: FloatArray


def find_blobs(picture: Picture, px_per_mm: float, width_mm: float) -> Blobs:
    """Local maxima of the difference from the film around, smoothed to the size of a part.

    picture (h, w, 3)
    px_per_mm: Approximate scale of the scan.
    width_mm: Length of a part.
    """
    cv2 = library("cv2", "inspecting a scan")
    differs, shrink = film_difference(picture, px_per_mm, COARSE_PX_PER_MM)
    per_mm = px_per_mm * shrink
    mask = np.minimum(differs, _LEVEL) / _LEVEL
    # a part with its lands becomes one hill, whose top is its centre
    smooth = cv2.GaussianBlur(mask, (0, 0), 0.45 * width_mm * per_mm)
    reach = 2 * round(0.7 * width_mm * per_mm) + 1
    top = smooth >= cv2.dilate(smooth, np.ones((reach, reach), np.uint8))
    v, u = np.nonzero(top & (smooth > _LEAST_SHARE * np.percentile(smooth, 98)))
    inside = (u > 0) & (v > 0) & (u < smooth.shape[1] - 1) & (v < smooth.shape[0] - 1)
    u, v = u[inside], v[inside]
    px = np.stack(
        [
            u + _vertex(smooth[v, u - 1], smooth[v, u], smooth[v, u + 1]),
            v + _vertex(smooth[v - 1, u], smooth[v, u], smooth[v + 1, u]),
        ],
        axis=1,
    )
    # pixel centres of the smaller picture as those of the scan; its size is rounded, its scale is not
    return Blobs(px=(px + 0.5) / shrink - 0.5)


def film_difference(picture: Picture, px_per_mm: float, coarse_px_per_mm: float) -> tuple[Samples, float]:
    """Largest difference of any channel from the film around, in a reduced picture, and the factor of the reduction."""
    cv2 = library("cv2", "inspecting a scan")
    shrink = min(1.0, coarse_px_per_mm / px_per_mm)
    small = cv2.resize(picture, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    half = min(1.0, COARSE_PX_PER_MM / (px_per_mm * shrink))
    coarse = cv2.resize(small, None, fx=half, fy=half, interpolation=cv2.INTER_AREA)
    # an odd side, as medianBlur wants it; film changes slowly, so that a coarse picture has its colour
    side = 2 * round(_FILM_WINDOW_MM * px_per_mm * shrink * half / 2) + 1
    film = np.stack([cv2.medianBlur(np.ascontiguousarray(coarse[..., i]), side) for i in range(3)], axis=-1)
    if half < 1.0:
        film = cv2.resize(film, small.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    return cv2.absdiff(small, film).max(axis=-1).astype(np.float32), shrink


def _vertex(before: FloatArray, here: FloatArray, after: FloatArray) -> FloatArray:
    """Vertex of the parabola through three samples, between -0.5 and 0.5."""
    bend = np.minimum(before - 2 * here + after, -1e-9)
    return np.asarray(np.clip(0.5 * (before - after) / bend, -0.5, 0.5), dtype=np.float64)
