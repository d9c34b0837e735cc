"""The printed tag, fitted to the pixels of a picture: its pose, with blur, ink that has run, and the light that is best for each.

Poses are rotation matrices (3, 3) and translations (3,), mm, of the tag in the camera's frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, hypot, sqrt

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import FrameError
from tactape_fab.base.libraries import library
from tactape_fab.sense.objects.tag_view import rays_of
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tag import CODE_CELLS, SIDE_CELLS, tag_cells

_PX_PER_CELL = 16
_PAD_CELLS = 2
_RING_SHARE = 0.5
"""Fraction of the light ring that is used: beyond it may be film, or the label."""
_BLUR_PX = 0.7
_MOST_STEPS, _LONGEST_STEP = 40, 100.0
"""Steps, and the longest: a tenth of a radian, a hundredth of the distance. With a fifth of it and half as many steps 5 of 20
tags of 1.2 to 2.5 px per cell were still 0.3 to 0.6 cells off."""
_LEAST_PIXELS, _MOST_PIXELS = 60, 1_000_000
_MOST_COLUMNS = 30_000
"""OpenCV's remap counts columns in 16 bits."""
_ENOUGH = 0.02
"""Iteration ends when the pose moves by less than this fraction of a milliradian and of 1e-4 of the distance."""
_MOST_BLEED = 0.3
"""Largest growth or shrinkage of light areas, in cells."""

GrayImage = npt.NDArray[np.uint8]
_F32 = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """Pixels of the tag: their rays (n, 3) and grey levels (n,); pixels per cell; standard deviation of their smoothing.

    ``light`` (n, 3) is 1 and each pixel's place, -1 to 1: brightness and contrast of uneven light, to first order.
    """

    rays: FloatArray
    levels: FloatArray
    light: FloatArray
    px_per_cell: float
    smoothed_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A picture, its camera, and the tag that is looked for in it."""

    picture: GrayImage
    matrix: FloatArray
    lens: FloatArray | None
    tag_id: int
    cell_mm: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """A pose; correlation of the picture with the tag there; the picture's blur; by how many cells light areas have grown."""

    rotation: FloatArray
    translation_mm: FloatArray
    fit: float
    blur_px: float
    grown_cells: float


def pixels(view: View, rotation: FloatArray, translation_mm: FloatArray, smoothing_cells: float) -> Seen:
    """The pixels within the middle of the tag's light ring."""
    cv2 = library("cv2", "fitting a tag to a picture")

    half = (CODE_CELLS / 2 + _RING_SHARE) * view.cell_mm
    square = np.array([(-half, -half, 0.0), (half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0)])
    corners, _ = cv2.projectPoints(square, cv2.Rodrigues(rotation)[0], translation_mm, view.matrix, view.lens)
    outline = np.reshape(corners, (-1, 2))
    height, width = view.picture.shape
    low, high = np.floor(outline.min(axis=0)), np.ceil(outline.max(axis=0)) + 1
    if not (np.isfinite(outline).all() and (low >= 0).all() and (high <= (width, height)).all() and translation_mm[2] > 0.0):
        raise FrameError(f"the tag is not wholly inside the picture of {width} x {height} px; give one that shows it all")
    (u0, v0), (u1, v1) = low.astype(int), high.astype(int)
    inside = np.zeros((v1 - v0, u1 - u0), dtype=np.uint8)
    # corners in sixteenths of a pixel (shift = 4)
    cv2.fillConvexPoly(inside, np.rint((outline - (u0, v0)) * 16).astype(np.int32), 1, cv2.LINE_8, 4)
    v, u = np.nonzero(inside)
    if not _LEAST_PIXELS <= len(u) <= _MOST_PIXELS:
        message = (
            f"the tag covers {len(u)} px, not {_LEAST_PIXELS} to {_MOST_PIXELS}; take the picture nearer, or from farther away"
        )
        raise FrameError(message)
    px_per_cell = sqrt(len(u)) / (2 * half / view.cell_mm)
    # a small tag's picture is blurred enough by itself
    smoothed_px = max(smoothing_cells * px_per_cell - _BLUR_PX / 2, 0.0)
    # a Gaussian of four deviations, so that its own border does not come in
    margin = ceil(4 * smoothed_px)
    left, top = max(u0 - margin, 0), max(v0 - margin, 0)
    shown = view.picture[top : v1 + margin, left : u1 + margin].astype(np.float32)
    if smoothed_px > 0.0:
        shown = np.asarray(cv2.GaussianBlur(shown, (0, 0), smoothed_px), dtype=np.float32)
        # pixels half a deviation apart have all that is left
        thin = max(int(smoothed_px / 2), 1)
        u, v = u[(u % thin == 0) & (v % thin == 0)], v[(u % thin == 0) & (v % thin == 0)]
    return Seen(
        rays=rays_of(np.stack([u + u0, v + v0], axis=1).astype(np.float64), view.matrix, view.lens),
        levels=shown[v + v0 - top, u + u0 - left].astype(np.float64),
        light=np.column_stack([np.ones(len(u)), 2 * u / max(u1 - u0 - 1, 1) - 1, 2 * v / max(v1 - v0 - 1, 1) - 1]),
        px_per_cell=px_per_cell,
        smoothed_px=smoothed_px,
    )


@lru_cache(maxsize=2)
def _printed(tag_id: int) -> _F32:
    """Signed distance of each point of the tag into the light area, in cells; the film beyond the ring counts as dark."""
    cv2 = library("cv2", "fitting a tag to a picture")

    light = np.kron(np.pad(tag_cells(tag_id), _PAD_CELLS), np.ones((_PX_PER_CELL, _PX_PER_CELL), dtype=bool)).astype(np.uint8)
    inside, outside = (cv2.distanceTransform(area, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for area in (light, 1 - light))
    # distances are to the next pixel of the other kind, whose border lies half a pixel nearer
    return np.asarray(np.where(light, inside - 0.5, 0.5 - outside) / _PX_PER_CELL, dtype=np.float32)


@lru_cache(maxsize=4)
def _blurred(tag_id: int, ln_blur_cells: float, grown_cells: float) -> _F32:
    """The printed tag as a camera blurs it; seven in eight poses that a step looks at share one."""
    cv2 = library("cv2", "fitting a tag to a picture")

    # a pixel at distance d of a straight edge is covered by d + 0.5, from 0 to 1
    light = np.clip((_printed(tag_id) + np.float32(grown_cells)) * _PX_PER_CELL + 0.5, 0.0, 1.0)
    return np.asarray(cv2.GaussianBlur(light, (0, 0), float(np.exp(ln_blur_cells)) * _PX_PER_CELL), dtype=np.float32)


def residual(seen: Seen, view: View, rotation: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals of the grey levels at a pose, in the best light; and the contrast, with its slopes (3,).

    ``values`` are a small turn (3), the translation (3), ln of the blur in cells, and by how many cells light areas have grown
    (ink that has run).
    """
    cv2 = library("cv2", "fitting a tag to a picture")

    hit = hits(seen, np.asarray(cv2.Rodrigues(values[:3])[0]) @ rotation, values[3:6])
    # mm from the tag's centre to pixels of the printed picture, integers at pixel centres
    at = ((hit / view.cell_mm + SIDE_CELLS / 2 + _PAD_CELLS) * _PX_PER_CELL - 0.5).astype(np.float32)
    blurred = _blurred(view.tag_id, float(values[6]), float(values[7]))
    lots = np.array_split(at, len(at) // _MOST_COLUMNS + 1)
    seen_there = [np.ravel(cv2.remap(blurred, lot[None, :, 0], lot[None, :, 1], cv2.INTER_LINEAR)) for lot in lots]
    shape = np.concatenate(seen_there).astype(np.float64)
    # brightness, contrast and their slopes are linear: for each pose the best ones are put in at once (variable projection)
    design = np.hstack([seen.light, seen.light * shape[:, None]])
    best = least_squares(design, seen.levels)
    return seen.levels - design @ best, best[3:]


def least_squares(design: FloatArray, levels: FloatArray) -> FloatArray:
    # by the normal equations, whose columns are of one size: a tenth of the time of an SVD of all pixels
    return np.asarray(np.linalg.lstsq(design.T @ design, design.T @ levels, rcond=1e-12)[0])


def _first(seen: Seen, translation_mm: FloatArray) -> FloatArray:
    """Initial values for `_residual`."""
    return np.array([0.0, 0.0, 0.0, *translation_mm, np.log(hypot(_BLUR_PX, seen.smoothed_px) / seen.px_per_cell), 0.0])


def fit_at(seen: Seen, view: View, rotation: FloatArray, translation_mm: FloatArray) -> float:
    """Correlation of the picture with the printed tag at a given pose."""
    return correlation(seen, *residual(seen, view, rotation, _first(seen, translation_mm)))


def correlation(seen: Seen, off: FloatArray, contrast: FloatArray) -> float:
    """Correlation of grey levels with the tag, apart from what a slope of brightness explains; 0 where light areas are darker."""
    flat = seen.levels - seen.light @ least_squares(seen.light, seen.levels)
    whole = float(flat @ flat)
    if not (whole > 0.0 and (seen.light @ contrast).min() > 0.0):
        return 0.0
    return sqrt(max(1.0 - float(off @ off) / whole, 0.0))


def hits(seen: Seen, rotation: FloatArray, translation_mm: FloatArray) -> FloatArray:
    """Intersections of the pixels' rays with the tag's plane, mm from its centre (n, 2)."""
    # rays in the tag's frame: X = R^T (s ray - t), which meets z = 0 at s = -start_z / ahead_z
    ahead, start = seen.rays @ rotation, -rotation.T @ translation_mm
    return np.asarray(start[:2] - (start[2] / ahead[:, 2])[:, None] * ahead[:, :2])


def fitted(seen: Seen, view: View, rotation: FloatArray, translation_mm: FloatArray) -> Fitted:
    """The pose by Levenberg-Marquardt from one start."""
    cv2 = library("cv2", "fitting a tag to a picture")

    # steps of differences, and the unit of `step`: mrad, 1e-4 of the distance, ln of the blur, cells
    scale = np.array([1e-3] * 3 + [1e-4 * float(translation_mm[2])] * 3 + [0.05, 0.02])
    values = _first(seen, translation_mm)
    low, high = np.log(hypot(0.2, seen.smoothed_px) / seen.px_per_cell), np.log(2.0)
    (off, contrast), damping = residual(seen, view, rotation, values), 1e-3
    for _ in range(_MOST_STEPS):
        steps = np.diag(scale)
        slopes = np.stack(
            [(residual(seen, view, rotation, values + s)[0] - residual(seen, view, rotation, values - s)[0]) / 2 for s in steps],
            axis=1,
        )
        normal = slopes.T @ slopes
        # Marquardt's damping is relative to each unknown's own curvature
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-12 * np.eye(8), slopes.T @ off)
        moved = values + np.clip(step, -_LONGEST_STEP, _LONGEST_STEP) * scale
        moved[6], moved[7] = np.clip(moved[6], low, high), np.clip(moved[7], -_MOST_BLEED, _MOST_BLEED)
        new, new_contrast = residual(seen, view, rotation, moved)
        if not float(new @ new) < float(off @ off):
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        values, off, contrast, damping = moved, new, new_contrast, max(damping / 5.0, 1e-9)
        if np.abs(step[:6]).max() < _ENOUGH:
            break
    return Fitted(
        rotation=np.asarray(cv2.Rodrigues(values[:3])[0]) @ rotation,
        translation_mm=values[3:6].copy(),
        fit=correlation(seen, off, contrast),
        blur_px=sqrt(max((float(np.exp(values[6])) * seen.px_per_cell) ** 2 - seen.smoothed_px**2, 0.0)),
        grown_cells=float(values[7]),
    )
