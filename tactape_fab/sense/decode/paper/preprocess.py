"""Depth map -> dots and contact dot, and the scale from the dots (paper, section III-A.1 and III-B.1)."""

from __future__ import annotations

from math import hypot

import numpy as np

from tactape_fab.base.libraries import library
from tactape_fab.texture.frames import FloatArray

REFERENCE_PX_PER_MM = 16.0
"""Scale of the paper's GelSight Mini, px/mm (320 px over 20 mm): first assumption for a frame of unknown scale."""
MEAN_FILTER_MM = 25 / REFERENCE_PX_PER_MM
"""Side of the mean filter of Eq. 1. The paper gives none; a filter of about one W takes away what is wider than a part."""
STRONGEST_SHARE = 0.995
"""The gain K of Eq. 1 brings this quantile of the pattern to 1: no two sensors agree on the unit of depth."""
THRESHOLD = 0.45
"""Level of the binarisation on that scale; the paper gives none."""
LEAST_AREA = 0.2
"""Contours smaller than this fraction of a part's body are noise, not dots; the paper has no such test and no figure."""
_LEAST_DISTANCE_PX = 1e-6


def high_pass(depth: FloatArray, filter_px: int) -> FloatArray:
    """Remove the background of a depth map and stretch the contrast (Eq. 1).

    depth (h, w): Larger is deeper into the elastomer, any unit. NaN and infinite values are replaced by the mean of the rest.
    filter_px: Side of the mean filter, px; at most the frame's shorter side is used.
    Returns (h, w): ``(depth - meanFilter(depth)) * K``. Reading: the paper does not say what K is; here it brings the quantile
        `STRONGEST_SHARE` to 1, and a flat frame is 0 everywhere.
    """
    cv2 = library("cv2", 'method "paper"')

    known = np.isfinite(depth)
    if not known.any():
        return np.zeros(depth.shape, dtype=np.float32)
    level = np.clip(depth, -1e30, 1e30)
    mean = level.mean(where=known)
    level = np.where(known, level - mean, 0.0)
    # heights over their span, so that any unit stays within single precision
    span = np.abs(level).max()
    # what is left is the rounding of the mean: the frame is flat
    if span <= 1e-12 * abs(mean):
        return np.zeros(depth.shape, dtype=np.float32)
    level = (level / span).astype(np.float32)
    side = max(1, min(filter_px, *depth.shape))
    pattern = level - cv2.blur(level, (side, side), borderType=cv2.BORDER_REPLICATE)
    place = int(STRONGEST_SHARE * (pattern.size - 1))
    peak = float(np.partition(pattern, place, axis=None)[place])
    return pattern / peak if peak > 0 else np.zeros_like(pattern)


def detect_dots(depth: FloatArray, px_per_mm: float, body_mm2: float) -> FloatArray:
    """Dots of a depth map: high-pass, binarise, contours, centres by moments (Eq. 1 and the text below it).

    depth (h, w)
    body_mm2: Area of one part seen from above, mm2.
    Returns (n, 2): Centres (u, v), px, in the contours' order. Reading: outer contours only, and the moments are those of the
        polygon, as OpenCV computes them from a contour.
    """
    cv2 = library("cv2", 'method "paper"')

    if depth.ndim != 2 or depth.size == 0:
        return np.zeros((0, 2))
    pattern = high_pass(depth, round(MEAN_FILTER_MM * px_per_mm) | 1)
    contours, _ = cv2.findContours((pattern > THRESHOLD).view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    moments = [cv2.moments(contour) for contour in contours]
    # half a pixel at least: contours of single pixels and lines have the area 0, and no centre
    least_px2 = max(LEAST_AREA * body_mm2 * px_per_mm**2, 0.5)
    centres = [(m["m10"] / m["m00"], m["m01"] / m["m00"]) for m in moments if m["m00"] >= least_px2]
    return np.array(centres, dtype=np.float64).reshape(-1, 2)


def contact_centre(xy_px: FloatArray) -> FloatArray:
    """Centre of contact, the mean of the dots (Eq. 2); px, shape (2,)."""
    return np.asarray(xy_px.mean(axis=0), dtype=np.float64)


def contact_dot(xy_px: FloatArray) -> int:
    """Index of the dot nearest the centre of contact (Eq. 3); the first of equals."""
    return int(((xy_px - contact_centre(xy_px)) ** 2).sum(axis=1).argmin())


def estimate_scale(xy_px: FloatArray, pitch_mm: float, displacement_mm: float) -> float | None:
    """Scale of a frame from the distances between nearest dots (Eq. 14-16).

    ``d_B`` is the mean nearest-neighbour distance, taken again over those within two standard deviations (Eq. 15), and
    stands for ``sqrt(delta^2 + (w - delta)^2)`` (Eq. 14). Reading: Eq. 16 gives w for Delta = W / 6 only; here
    ``R = d_B / hypot(Delta, W - Delta)``, which is Eq. 16 and 13 at that ratio and holds at any other. The two-sigma rule
    is applied once, as written. It removes few of the shortest distances d_A: on a boundless grid, where every fourth or
    fifth dot has a neighbour at d_A, the estimate is 3 % too small; on a contact of 11 x 9 mm it is -1 +- 3 %.

    xy_px (n, 2)
    pitch_mm, displacement_mm: W and Delta.
    Returns: R, px/mm; None with fewer than two dots, or all in one place.
    """
    if len(xy_px) < 2:
        return None
    offset = xy_px[:, None] - xy_px
    distance = np.hypot(offset[..., 0], offset[..., 1])
    np.fill_diagonal(distance, np.inf)
    nearest = distance.min(axis=1)
    mean, sigma = nearest.mean(), nearest.std()
    if mean < _LEAST_DISTANCE_PX:
        return None
    # Eq. 15; of equal distances sigma is rounding, and none of them may fall outside by it
    d_b = float(nearest[np.abs(nearest - mean) <= 2 * sigma + 1e-9 * mean].mean())
    return d_b / hypot(displacement_mm, pitch_mm - displacement_mm)
