"""Bodies on the pixel grid: exact area coverage of quadrilaterals, and heights of domes, in one pass over all of them.

Coordinates are image pixels: (u, v), integers at pixel centres.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tactape_fab.texture.frames import FloatArray, IntArray

MOST_SAMPLES = 2_000_000
"""Most samples drawn at a time."""
DOME_SAMPLES = 4
"""Samples per pixel and axis of a dome, whose height is continuous."""


def add_quads(image: FloatArray, corners_px: FloatArray, height: float) -> None:
    """Add `height` times the exact fraction of each pixel's area that a quadrilateral covers.

    image (h, w): Changed in place.
    corners_px (n, 4, 2): Corners of convex quadrilaterals, in either orientation; they may lie partly or fully outside.
    """
    for which, first, size in _windows(corners_px.min(axis=1), corners_px.max(axis=1), image.shape, 1):
        # from the window's outer corner: borders of pixels are whole numbers
        corners = corners_px[which] + 0.5 - first[:, None]
        borders = np.arange(size[0] + 1.0), np.arange(size[1] + 1.0)
        area = sum(_area_under(corners[:, i], corners[:, (i + 1) % 4], *borders) for i in range(4))
        # the area in a pixel from those in the four quadrants at its corners; negative for one orientation of the corners
        cells = np.abs(np.diff(np.diff(np.asarray(area), axis=1), axis=2))
        _scatter(image, cells * height, first)


def add_domes(
    image: FloatArray,
    centre_px: FloatArray,
    px_per_mm: tuple[float, float],
    foot_mm: FloatArray,
    top_mm: FloatArray,
    height: FloatArray,
    cap_height_mm: float | None,
) -> None:
    """Add the mean height of domes over each pixel, sampled.

    image (h, w): Changed in place.
    centre_px (n, 2)
    foot_mm, top_mm (n,): Radii of the foot and, of a truncated cone, of its flat top.
    height (n,): Height of the middle, in the image's unit.
    cap_height_mm: Height of a spherical cap, which with the foot gives the sphere; None for truncated cones.
    """
    scale = np.asarray(px_per_mm)
    reach = foot_mm[:, None] * scale
    for which, first, size in _windows(centre_px - reach, centre_px + reach, image.shape, DOME_SAMPLES**2):
        from_centre = first - centre_px[which]
        u_mm, v_mm = (
            ((np.arange(size[k] * DOME_SAMPLES) + 0.5) / DOME_SAMPLES - 0.5 + from_centre[:, k : k + 1]) / scale[k]
            for k in range(2)
        )
        square = u_mm[:, :, None] ** 2 + v_mm[:, None, :] ** 2
        relative = _dome(square, foot_mm[which, None, None], top_mm[which, None, None], cap_height_mm)
        cells = relative.reshape(-1, size[0], DOME_SAMPLES, size[1], DOME_SAMPLES).mean(axis=(2, 4))
        _scatter(image, cells * height[which, None, None], first)


def _dome(square_mm2: FloatArray, foot_mm: FloatArray, top_mm: FloatArray, cap_height_mm: float | None) -> FloatArray:
    """Height of a dome over that of its centre, from the square of the distance to its axis."""
    if cap_height_mm is None:
        return np.clip((foot_mm - np.sqrt(square_mm2)) / (foot_mm - top_mm), 0.0, 1.0)
    radius = (foot_mm**2 + cap_height_mm**2) / (2 * cap_height_mm)
    rise = np.sqrt(np.maximum(radius**2 - square_mm2, 0.0)) - (radius - cap_height_mm)
    return np.maximum(rise, 0.0) / cap_height_mm


def _windows(
    low_px: FloatArray, high_px: FloatArray, shape: tuple[int, ...], samples: int
) -> Iterator[tuple[IntArray, IntArray, tuple[int, int]]]:
    """Bodies with their windows in the image, in batches of bounded size; those outside the image are left out.

    Yields which (n,).
    Yields first (n, 2): First pixel (u, v) of each window.
    Yields size: Width and height for all of them; a window may exceed the image to the right and below.
    """
    last_px = np.array([shape[1] - 1, shape[0] - 1])
    # pixel k covers k - 0.5 to k + 0.5
    first = np.maximum(np.floor(low_px + 0.5), 0.0)
    last = np.minimum(np.floor(high_px + 0.5), last_px)
    seen = np.flatnonzero((first <= last).all(axis=1))
    if not len(seen):
        return
    # one window size for all, so that numpy handles them together; the excess is zero
    size = (last[seen] - first[seen]).max(axis=0).astype(np.int64) + 1
    lot = max(1, MOST_SAMPLES // int(size.prod() * samples))
    for start in range(0, len(seen), lot):
        which = seen[start : start + lot]
        yield which, first[which].astype(np.int64), (int(size[0]), int(size[1]))


def _scatter(image: FloatArray, cells: FloatArray, first: IntArray) -> None:
    """Add windows indexed (body, u, v) to the image, clipped to it."""
    u = (first[:, :1] + np.arange(cells.shape[1]))[:, :, None]
    v = (first[:, 1:] + np.arange(cells.shape[2]))[:, None, :]
    inside = (u < image.shape[1]) & (v < image.shape[0])
    index = (v * image.shape[1] + u)[inside]
    # bodies may cover the same pixel: indexing would add only one of them
    image += np.bincount(index, weights=cells[inside], minlength=image.size).reshape(image.shape)


def _area_under(a: FloatArray, b: FloatArray, u_border: FloatArray, v_border: FloatArray) -> FloatArray:
    """An edge's contribution to the polygon's area in u <= u_border[i], v <= v_border[j]; shape (n, i, j), signed by direction.

    It is the integral of max(v_border[j] - v(u), 0) along the edge; over all edges of a polygon the sum is the area, as
    in Green's theorem. The integrand is linear between its zero and its ends, so the result is exact.
    """
    forward = (a[:, 0] <= b[:, 0])[:, None]
    left, right = np.where(forward, a, b), np.where(forward, b, a)
    width = right[:, 0] - left[:, 0]
    slope = (right[:, 1] - left[:, 1]) / np.where(width > 0.0, width, 1.0)
    # how far along u the edge has come at each border; a vertical edge has no width, and no area under it
    run = np.clip(u_border - left[:, :1], 0.0, width[:, None])
    at_left = (v_border - left[:, 1:])[:, None, :]
    at_end = at_left - (slope[:, None] * run)[:, :, None]
    high, low = np.maximum(at_left, at_end), np.minimum(at_left, at_end)
    # max(., 0) of a line from `high` to `low` < 0: a triangle of height `high` over the share high / (high - low) of the way
    rise = np.maximum(high, 0.0)
    crossing = rise * rise / (2 * np.where(high > low, high - low, 1.0))
    mean = np.where(low >= 0.0, (high + low) / 2, crossing)
    return np.where(forward, 1.0, -1.0)[:, :, None] * run[:, :, None] * mean
