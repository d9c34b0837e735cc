"""Kernels of detection that visit every pixel: in single precision and row by row, so that compilers vectorise them.

All values of an image must be finite. The kernels are in one file: numba takes a function from its cache as long as the
function's own file is as old, whatever it calls.
"""

from __future__ import annotations

from functools import cache
from math import exp

import numpy as np
import numpy.typing as npt

from tactape_fab.base.jit import inner_kernel, kernel
from tactape_fab.texture.frames import FloatArray, IntArray

Image = npt.NDArray[np.float32]

LOWEST = np.float32(-3e38)
ROUNDING = np.float32(1e-6)
"""A maximum lower than this share of its pixel's value is a rounding error of single precision."""
RIDGE_ELONGATION, RIDGE_GOES_ON = 0.5, 0.5
"""A maximum on a ridge has a larger elongation than the first, and on both sides along the ridge at least the second, as a share
of its height."""
STEP_TROUGH = 0.65
"""A step edge, such as the board's, has beside its ridge a trough deeper than this share of the ridge's height. The trough round
a part is shallower, and noise seldom makes one."""


@cache
def gaussian_taps(sigma_px: float) -> Image:
    """Half of a normalised Gaussian kernel, centre tap first; as wide as OpenCV's for floating point."""
    # 4 sigma on each side, beyond which a Gaussian has 6e-5 of its weight; odd in all, so that there is a middle
    reach = (round(8.0 * sigma_px + 1.0) | 1) // 2
    side = [exp(-0.5 * (t / sigma_px) ** 2) for t in range(reach + 1)]
    total = side[0] + 2.0 * sum(side[1:])
    taps = np.array(side, dtype=np.float32) / np.float32(total)
    taps.setflags(write=False)
    return taps


@inner_kernel()
def ordinary_value(image: Image, values: Image) -> float:
    """Median of nine pixels, a robust estimate of the image's level; `values` is a work buffer."""
    h, w = image.shape
    # insertion sort of nine values: numpy's median would allocate, which a kernel may not
    for k in range(9):
        value = image[(1 + k // 3) * h // 4, (1 + k % 3) * w // 4]
        place = k
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
    return float(values[4])


def averaged(depth: Image, factor: int) -> Image:
    """Means over blocks of factor x factor pixels, minus `ordinary_value`, so that single precision keeps more digits."""
    out = np.empty((depth.shape[0] // factor, depth.shape[1] // factor), dtype=np.float32)
    if out.size:
        _average(depth, factor, np.empty(max(depth.shape[1], 9), dtype=np.float32), out)
    return out


@kernel(fastmath=True)
def _average(depth: Image, factor: int, line: Image, out: Image) -> None:
    """Fill what `averaged` returns; `line` is a work buffer."""
    (h, w), wide = out.shape, depth.shape[1]
    # single precision has 24 bits: beside an offset of 1e4 it holds steps of 1e-3 alone
    zero = ordinary_value(depth, line)
    share = np.float32(1.0 / (factor * factor))
    for v in range(h):
        for u in range(wide):
            line[u] = depth[v * factor, u] - zero
        for t in range(1, factor):
            for u in range(wide):
                line[u] += depth[v * factor + t, u] - zero
        # the usual factors by constant strides, which compilers vectorise
        if factor == 1:
            for u in range(w):
                out[v, u] = line[u]
        elif factor == 2:
            for u in range(w):
                out[v, u] = share * (line[2 * u] + line[2 * u + 1])
        elif factor == 4:
            for u in range(w):
                out[v, u] = share * ((line[4 * u] + line[4 * u + 1]) + (line[4 * u + 2] + line[4 * u + 3]))
        else:
            for u in range(w):
                total = line[u * factor]
                for t in range(1, factor):
                    total += line[u * factor + t]
                out[v, u] = share * total


@inner_kernel()
def _inside(index: int, n: int) -> int:
    """Index reflected into 0 ... n - 1 about the outermost pixels (OpenCV's BORDER_REFLECT_101)."""
    if n == 1:
        return 0
    # several times, as a filter may be wider than the image
    while index < 0 or index >= n:
        index = -index if index < 0 else 2 * n - 2 - index
    return index


def banded(depth: Image, taps: Image, half_box: int) -> Image:
    """An image smoothed by a symmetric kernel, minus its mean over a box of 2 half_box + 1 pixels a side."""
    out = np.empty(depth.shape, dtype=np.float32)
    if out.size:
        pad, wide = max(len(taps) - 1, half_box), depth.shape[1]
        smooth, box = np.empty((2, wide + 2 * pad), dtype=np.float32)
        before, after = np.empty((2, pad), dtype=np.int64)
        _band(depth, taps, half_box, smooth, box, before, after, np.empty(wide), out)
    return out


@kernel(fastmath=True)
def _band(
    depth: Image,
    taps: Image,
    half_box: int,
    smooth: Image,
    box: Image,
    before: IntArray,
    after: IntArray,
    sums: FloatArray,
    out: Image,
) -> None:
    """Fill what `banded` returns; the arrays between are work buffers."""
    # a row with its mirrored ends is `smooth` (after the Gaussian down the columns) and `box` (sums down the columns, over the
    # square's area); `before` and `after` say which pixels the ends mirror
    (h, w), reach, pad = depth.shape, len(taps) - 1, len(before)
    for t in range(pad):
        before[t], after[t] = _inside(t - pad, w), _inside(w + t, w)
    share = 1.0 / (2.0 * half_box + 1.0) ** 2
    # running sums down the columns: a step costs the same for any box; in double precision rounding does not add up
    for u in range(w):
        sums[u] = 0.0
    for t in range(-half_box, half_box + 1):
        for u in range(w):
            sums[u] += depth[_inside(t, h), u]
    smooth_row, box_row = smooth[pad : pad + w], box[pad : pad + w]
    for v in range(h):
        for u in range(w):
            smooth_row[u] = taps[0] * depth[v, u]
        # the Gaussian is separable: down the columns here, along the row below
        for t in range(1, reach + 1):
            over, under, k = _inside(v - t, h), _inside(v + t, h), taps[t]
            for u in range(w):
                smooth_row[u] += k * (depth[over, u] + depth[under, u])
        leaving, entering = _inside(v - half_box, h), _inside(v + 1 + half_box, h)
        for u in range(w):
            box_row[u] = share * sums[u]
            sums[u] += depth[entering, u] - depth[leaving, u]
        for t in range(pad):
            smooth[t], box[t] = smooth_row[before[t]], box_row[before[t]]
            smooth[pad + w + t], box[pad + w + t] = smooth_row[after[t]], box_row[after[t]]
        row = out[v]
        for u in range(w):
            row[u] = taps[0] * smooth_row[u] - box_row[u]
        for t in range(1, reach + 1):
            left, right, k = smooth[pad - t :], smooth[pad + t :], taps[t]
            for u in range(w):
                row[u] += k * (left[u] + right[u])
        # along the row the box is summed term by term, which vectorises; a running sum is a chain of dependent additions
        for t in range(1, half_box + 1):
            left, right = box[pad - t :], box[pad + t :]
            for u in range(w):
                row[u] -= left[u] + right[u]


@inner_kernel()
def _is_near(found: IntArray, v: int, u: int, reach: int) -> bool:
    """Whether one of the pixels found so far lies within `reach` rows and columns of (v, u)."""
    for i in range(len(found) - 1, -1, -1):  # in row order: earlier ones are farther up
        if found[i, 0] < v - reach:
            return False
        if abs(found[i, 1] - u) <= reach:
            return True
    return False


def local_tops(image: Image, ground: Image, reach: int) -> IntArray:
    """Non-maximum suppression: positive pixels (v, u) off the border, the largest within `reach` rows and columns; in row order.

    Of equal pixels so near each other the first is kept. The image is a difference of means of `ground`: maxima within the
    rounding of that, as on level ground, are left out.
    """
    # no two within the reach: at most one in each square of reach + 1, so that noise in the first rows takes no place of a part's
    (h, w), side = image.shape, reach + 1
    found = np.empty((-(-h // side) * -(-w // side), 2), dtype=np.int64)
    eights = np.empty((w + 7) // 8, dtype=np.uint64)
    rows = np.empty(image.shape, dtype=np.float32), np.empty(w + 2 * reach, dtype=np.float32), np.empty(w, dtype=np.float32)
    return found[: _find_tops(image, ground, reach, *rows, eights, eights.view(np.uint8), found)]


@kernel(fastmath=True)
def _find_tops(
    image: Image,
    ground: Image,
    reach: int,
    wide: Image,
    line: Image,
    highest: Image,
    eights: npt.NDArray[np.uint64],
    is_top: npt.NDArray[np.uint8],
    found: IntArray,
) -> int:
    """Fill `found` with what `local_tops` returns, and return their number.

    `wide` and `highest` are work buffers; `is_top` (flags) and `eights` (words of eight flags) are views of one more.
    """
    h, w = image.shape
    for u in range(len(line)):
        line[u] = LOWEST
    middle = line[reach : reach + w]
    for v in range(h):
        row = wide[v]
        for u in range(w):
            middle[u] = row[u] = image[v, u]
        for t in range(1, reach + 1):
            left, right = line[reach - t :], line[reach + t :]
            for u in range(w):
                row[u] = max(row[u], left[u], right[u])
    n = 0
    for u in range(len(is_top)):
        is_top[u] = 0
    for v in range(1, h - 1):
        for u in range(w):
            # the maximum over a square is separable: along rows above, down the columns here
            highest[u] = wide[v, u]
        for t in range(1, reach + 1):
            # beyond the border the outermost row counts again, which alters no maximum
            over, under = v - t if v > t else 0, v + t if v + t < h else h - 1
            for u in range(w):
                highest[u] = max(highest[u], wide[over, u], wide[under, u])
        for u in range(1, w - 1):
            # flags without a branch, so that the loop becomes vectors; equal pixels both pass, and `_is_near` keeps the first
            is_top[u] = (image[v, u] >= highest[u]) & (image[v, u] > ROUNDING * abs(ground[v, u]))
        for k in range(len(eights)):  # tops are few: eight flags are tested as one word
            if eights[k] == 0:
                continue
            for u in range(8 * k, 8 * k + 8):
                if is_top[u] and n < len(found) and not _is_near(found[:n], v, u, reach):
                    found[n, 0], found[n, 1] = v, u
                    n += 1
    return n


def tops(
    small: Image, coarse: int, taps: Image, half_box: int, reach: int, along: float, across: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, int, Image]:
    """Positive local maxima of the band-pass, refined by the quadric through the 3 x 3 pixels round each.

    small: Means over coarse x coarse pixels of the image.
    along, across: Distances at which `_trough` samples, in pixels of `small`.
    Returns: Positions in pixels of the image (n, 2), heights (n,), elongations as in `Dots` (n, 2), depths from `_trough` (n,),
        the number of those deeper than `STEP_TROUGH`, and the band-passed `small`.
    """
    high = banded(small, taps, half_box)
    pixels = local_tops(high, small, reach)
    n = len(pixels)
    xy, height, elongation, trough = np.empty((n, 2)), np.empty(n), np.empty((n, 2)), np.empty(n)
    deep = _centres(high, pixels, coarse, along, across, xy, height, elongation, trough)
    return xy, height, elongation, trough, deep, high


@kernel()
def _centres(
    high: Image,
    pixels: IntArray,
    coarse: int,
    along: float,
    across: float,
    xy: FloatArray,
    height: FloatArray,
    elongation: FloatArray,
    trough: FloatArray,
) -> int:
    """Fill in position, height, elongation and trough of each local maximum; returns the number of deep troughs."""
    deep = 0
    for i in range(len(pixels)):
        v, u = pixels[i, 0], pixels[i, 1]
        c = high[v, u]
        # central differences: the quadric c + g.d + d.H.d / 2, exact for gx, gy, hxx, hyy, and for hxy by the four corners
        gx = 0.5 * (high[v, u + 1] - high[v, u - 1])
        gy = 0.5 * (high[v + 1, u] - high[v - 1, u])
        hxx = high[v, u + 1] - 2.0 * c + high[v, u - 1]
        hyy = high[v + 1, u] - 2.0 * c + high[v - 1, u]
        hxy = 0.25 * (high[v + 1, u + 1] - high[v + 1, u - 1] - high[v - 1, u + 1] + high[v - 1, u - 1])
        det = hxx * hyy - hxy * hxy
        dx = dy = elongation[i, 0] = elongation[i, 1] = trough[i] = 0.0
        # Newton's step to the top of the quadric, -H^-1 g; none on a saddle
        if det > 0.0:
            dx = (hxy * gy - hyy * gx) / det
            dy = (hxy * gx - hxx * gy) / det
            # 2 phi of the axes of H has cos and sin as (hxx - hyy, 2 hxy); over the trace, which is negative on a top, the sign
            # is that of `Dots`
            elongation[i, 0] = (hxx - hyy) / (hxx + hyy)
            elongation[i, 1] = 2.0 * hxy / (hxx + hyy)
        # beyond the 3 x 3 pixels the quadric is not valid
        if abs(dx) > 1.0 or abs(dy) > 1.0:
            dx = dy = 0.0
        # the middle of a block of pixels, as pixel centres are whole numbers
        xy[i, 0] = (u + dx) * coarse + (coarse - 1) / 2
        xy[i, 1] = (v + dy) * coarse + (coarse - 1) / 2
        # at d = -H^-1 g the quadric is c + g.d / 2
        height[i] = c + 0.5 * (gx * dx + gy * dy)
        # the eigenvalues of the second derivatives are their mean and, more or less than it, half of this
        apart = np.sqrt((hxx - hyy) * (hxx - hyy) + 4.0 * hxy * hxy)
        # |lambda1 - lambda2| over |lambda1 + lambda2|: 1 for a perfect ridge, 1/2 where one curvature is three times the other
        if apart > RIDGE_ELONGATION * abs(hxx + hyy):
            # cos of twice the angle of the least curvature, which is along the ridge; half-angle formulas
            twice = (hxx - hyy) / apart
            du, dv = np.sqrt(0.5 + 0.5 * twice), np.sqrt(0.5 - 0.5 * twice)
            trough[i] = _trough(high, v, u, du, dv if hxy > 0.0 else -dv, along, across)
            deep += trough[i] > STEP_TROUGH
    return deep


@inner_kernel()
def _trough(high: Image, v: int, u: int, du: float, dv: float, along: float, across: float) -> float:
    """Depth of the deeper trough beside a ridge along (du, dv), over the ridge's height; 0 if the ridge ends on either side."""
    h, w = high.shape
    deepest, far = 0.0, along
    for k in range(4):  # ahead, behind, and on either side
        # `far` is along, -along, across, -across, as the direction turns by 90 degrees after the second
        # floor, as truncation would round negative positions into the image: samples beyond any border are skipped
        row, column = np.int64(np.floor(v + far * dv + 0.5)), np.int64(np.floor(u + far * du + 0.5))
        far = -far
        if k == 1:
            far, du, dv = across, -dv, du
        if row < 0 or row >= h or column < 0 or column >= w:
            continue
        share = high[row, column] / high[v, u]
        # a part ends within `along` of its top, a step does not
        if k < 2 and share < RIDGE_GOES_ON:
            return 0.0
        if share < -deepest:
            deepest = -share
    return deepest
