"""Depth map -> dots: a band-pass, its local maxima, and their sub-pixel centres. Scale and background do not matter.

Pixel coordinates are those of the image frame (docs/frames.md): u right, v down, whole numbers at pixel centres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tactape_fab.sense.decode.dots.filters import STEP_TROUGH, Image, averaged, banded, gaussian_taps, tops
from tactape_fab.sense.decode.rule import BACKGROUND_MM, LEAST_HEIGHT, LEAST_NOISE, SMOOTHING_MM, trusted
from tactape_fab.texture.frames import FloatArray, IntArray

NEIGHBOURHOOD_MM = 0.3125
STRONGEST = 8
MOST_DOTS = 400
RIDGE_ALONG_MM, RIDGE_ACROSS_MM = 0.375, 0.6
"""Distances from a local maximum at which heights are sampled to tell a ridge: along it, farther than a part reaches; across it,
where the trough beside a step edge is deepest."""
RIDGE_TROUGH, STEP_SHARE, STEP_TOPS = 0.4, 0.45, 2
"""A frame shows a step edge if at least `STEP_TOPS` maxima with a trough deeper than `STEP_TROUGH` reach `STEP_SHARE` of the
median height of the strongest. Then every maximum whose trough is at least `RIDGE_TROUGH` of its height is rejected as a ridge.
"""
COARSE_PX_PER_MM = 7.0
"""Finer images are averaged over blocks of whole pixels, but never to a coarser scale than this."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dots:
    """Dots of one frame.

    xy_px (n, 2)
    weights (n,): Height over the median height of the strongest dots: 1 is an ordinary good dot.
    trust (n,): Probability that the dot is a part, from its height and that of the noise.
    elongation (n, 2): Anisotropy of each top, (h_uu - h_vv, 2 h_uv) / (h_uu + h_vv) of its second derivatives per canonical image
        pixel: a top that is longest at an angle phi (from u towards v) has -a (cos 2 phi, sin 2 phi) with 0 <= a < 1, so (-a, 0)
        where it is long along u, (0, -a) along u = v. Zero where the quadric has no maximum; None if not measured.
    seen_px (n, 2): Detected position in the canonical image, before any correction; None if equal to `xy_px`.
    small: The image they were detected in: `averaged` over `coarseness` pixels.
    high: The band-passed `small`, whose local maxima they are.
    by_edges: How far `xy_px` are middles of bodies between their edges (`middles`), which pressure hardly moves, from 0 to 1.
    """

    xy_px: FloatArray
    weights: FloatArray
    trust: FloatArray
    elongation: FloatArray | None = None
    seen_px: FloatArray | None = None
    small: Image | None = None
    high: Image | None = None
    by_edges: float = 0.0


def band_pass(depth: Image, px_per_mm: float) -> Image:
    """Band-pass at the scale of a part: a Gaussian minus a box mean over about a pitch (paper, Eq. 1, with a smoother kernel)."""
    return banded(depth, gaussian_taps(SMOOTHING_MM * px_per_mm), round(BACKGROUND_MM * px_per_mm / 2))


def coarseness(px_per_mm: float) -> int:
    """Side of the blocks that are averaged before detection, px; a part is still several blocks wide."""
    return max(int(px_per_mm / COARSE_PX_PER_MM), 1)


def detect(depth: Image, px_per_mm: float) -> Dots:
    """Find the dots of a canonical depth map.

    depth (h, w): Finite, larger = pushed further in.
    """
    coarse = coarseness(px_per_mm)
    coarse_px_per_mm, small = px_per_mm / coarse, averaged(depth, coarse)
    xy, height, elongation, trough, deep, high = tops(
        small,
        coarse,
        gaussian_taps(SMOOTHING_MM * coarse_px_per_mm),
        round(BACKGROUND_MM * coarse_px_per_mm / 2),
        # less than the least distance of two parts: W - 2 Delta is 1 mm in the paper's design, d_A of its Eq. 14
        max(round(NEIGHBOURHOOD_MM * coarse_px_per_mm), 1),
        RIDGE_ALONG_MM * coarse_px_per_mm,
        RIDGE_ACROSS_MM * coarse_px_per_mm,
    )
    order = (-height).argsort(kind="stable")
    if deep >= STEP_TOPS:
        order = _off_ridges(order, height, trough)
    if len(order) == 0:
        return Dots(xy_px=np.empty((0, 2)), weights=np.empty(0), trust=np.empty(0), elongation=np.empty((0, 2)))
    falling = height.take(order)
    # the unit of height is a whole dot: the depth map's own scale may be anything
    scale = _middle(falling[:STRONGEST])
    # heights fall, so their negatives are in order
    n = min(int((-falling).searchsorted(-LEAST_HEIGHT * scale, side="right")), MOST_DOTS)
    kept, weights = order[:n], falling[:n] / scale
    # most tops are bumps of noise: their median stands for the height of the noise
    noise = max(_middle(falling) / scale, LEAST_NOISE)
    trust = trusted(weights, noise)
    xy, elongation = xy.take(kept, 0), elongation.take(kept, 0)
    return Dots(xy_px=xy, weights=weights, trust=trust, elongation=elongation, small=small, high=high)


def _off_ridges(order: IntArray, height: FloatArray, trough: FloatArray) -> IntArray:
    """Indices of the maxima, highest first, without those on ridges if enough ridge maxima are as high as dots."""
    high = height[trough > STEP_TROUGH] >= STEP_SHARE * _middle(height[order[:STRONGEST]])
    return order if np.count_nonzero(high) < STEP_TOPS else order[trough[order] < RIDGE_TROUGH]


def _middle(ordered: FloatArray) -> float:
    """Median of sorted values."""
    n = len(ordered)
    return float(ordered[(n - 1) // 2] + ordered[n // 2]) / 2
