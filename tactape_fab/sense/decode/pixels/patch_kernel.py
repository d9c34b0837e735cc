"""Least squares of the pixels around each dot: the compiled half of `patches`, and the tables that a body is drawn from."""

from __future__ import annotations

from functools import lru_cache
from math import erf, pi, sqrt
from typing import NamedTuple

import numpy as np

from tactape_fab.base.jit import inner_kernel, kernel
from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.grid.beliefs import LEAST_APART_MM
from tactape_fab.sense.decode.grid.posterior import eliminate
from tactape_fab.texture.frames import FloatArray, IntArray

STEPS = 64
"""Entries of a table in a pixel: a nearest entry is off by 1/128 px, 0.2 um of the steepest relief; noise makes 2 um of it."""
NEXT_MM = 1.15
"""A dot so near reaches into the patch: two that are 1 mm apart would draw each other's centres by 2.7 um, it is 0.5 um."""
FARTHEST_MM = 0.09
"""No dot moves farther at a time: a fifth of a part's width would take the fit to the next slope."""


class Body(NamedTuple):
    """A smoothed box, which is a product: a smoothed step up and down along its length, and one along its width.

    along, across (k, 4): Value, slope and curvature of either; the box's middle is the middle entry.
    per_px (2, 2): Pixels right and down to entries along the length and the width.
    near: Squared distances in entries between which another dot belongs to the relief.
    """

    along: Image
    across: Image
    per_px: Image
    near: tuple[float, float]


class PatchBuffers(NamedTuple):
    """Columns of the least squares of one dot.

    They are the relief, its slopes along the body's length and width, its derivative by half the blur's variance, and the frame.

    images (5, side^2): Of the columns.
    columns (5, m): Their differences.
    products (5, 5)
    """

    images: Image
    columns: Image
    products: FloatArray


def patch_buffers(basis: Image, side: int) -> PatchBuffers:
    """Buffers for patches of so many pixels, and backgrounds as `fit_patches` takes them."""
    columns = np.empty(basis.shape, dtype=np.float32)
    return PatchBuffers(images=np.empty((5, side**2), dtype=np.float32), columns=columns, products=np.empty((5, 5)))


def smoothed_body(
    body_mm: tuple[float, float, float], blur_mm: float, side: int, steps_per_mm: float, to_body: FloatArray
) -> Body:
    """A box smoothed by a round Gaussian, for patches of so many pixels.

    to_body (2, 2): Pixels right and down to mm along the body's length and width.
    """
    along, across = (_profile(whole_mm / 2.0, blur_mm, side * STEPS, steps_per_mm) for whole_mm in body_mm[:2])
    near = (LEAST_APART_MM * steps_per_mm) ** 2, (NEXT_MM * steps_per_mm) ** 2
    return Body(along=along, across=across, per_px=(to_body * steps_per_mm).astype(np.float32), near=near)


@lru_cache(maxsize=64)
def _profile(half_mm: float, blur_mm: float, reach: int, steps_per_mm: float) -> Image:
    """A smoothed step up and down, its slope and curvature, so many entries on both sides of the middle; (k, 4)."""
    at = np.arange(-reach, reach + 1) / steps_per_mm
    up, down = (at + half_mm) / blur_mm, (at - half_mm) / blur_mm
    # the integral of a Gaussian over the body: Phi(up) - Phi(down)
    value = [(erf(a / sqrt(2.0)) - erf(b / sqrt(2.0))) / 2.0 for a, b in zip(up.tolist(), down.tolist(), strict=True)]
    bell_up, bell_down = (np.exp(-(z**2) / 2.0) / (sqrt(2.0 * pi) * blur_mm) for z in (up, down))
    # derivatives by the place; of exp(-z^2 / 2) it is -z / blur times it
    slope, curvature = bell_up - bell_down, (down * bell_down - up * bell_up) / blur_mm
    table = np.array([value, slope, curvature, np.zeros(len(at))], dtype=np.float32).T.copy()  # an entry is in one cache line
    table.setflags(write=False)
    return table


@kernel(fastmath=True)
def fit_patches(
    image: Image,
    base: IntArray,
    off: Image,
    around: Image,
    body: Body,
    basis: Image,
    side: int,
    buffers: PatchBuffers,
    out: FloatArray,
) -> None:
    """Fill in the fields of `Patches`, one after the other (12, n).

    base, off (n, 2): The pixel next to each dot, and where the dot is from it.
    around (k, 2): All dots, those that are fitted among them.
    basis (5, m): In the order of `differences`: differences of backgrounds, orthonormal.
    """
    for n in range(len(base)):
        _draw(image, base[n], off[n], body, side, buffers.images)
        _add_neighbours(base[n], off[n], around, body, side, buffers.images)
        for k in range(5):
            differences(buffers.images[k], side, buffers.columns[k])
        _solve(basis, buffers.columns, buffers.products, out[:, n])


@inner_kernel(fastmath=True)
def _draw(image: Image, base: IntArray, off: Image, body: Body, side: int, images: Image) -> None:
    """The columns of one dot: the nearest entry of each table at each pixel, and the frame."""
    # `zero` is the table's middle, and the half that makes of `int` the nearest entry
    last, half, zero = len(body.along) - 1, side // 2, np.float32(len(body.along) // 2 + 0.5)
    along, across, per_px, off_u, left = body.along, body.across, body.per_px, off[0], base[0] - half
    along_u, along_v, across_u, across_v = per_px[0, 0], per_px[0, 1], per_px[1, 0], per_px[1, 1]
    for j in range(side):
        v = np.float32(j - half) - off[1]
        row, drawn = image[base[1] + j - half, left : left + side], images[:, j * side : (j + 1) * side]
        down, right = along_v * v, across_v * v
        for i in range(side):
            u = np.float32(i - half) - off_u
            a = along[min(max(int((along_u * u + zero) + down), 0), last)]
            b = across[min(max(int((across_u * u + zero) + right), 0), last)]
            drawn[0, i] = a[0] * b[0]
            drawn[1, i] = a[1] * b[0]
            drawn[2, i] = a[0] * b[1]
            # a Gaussian spreads as heat does: the derivative by half its variance is the sum of the second ones by both axes
            drawn[3, i] = a[2] * b[0] + a[0] * b[2]
            drawn[4, i] = row[i]


@inner_kernel(fastmath=True)
def _add_neighbours(base: IntArray, off: Image, around: Image, body: Body, side: int, images: Image) -> None:
    """Add the dots next to it, which belong to the relief, and do not move with it."""
    last, half, zero = len(body.along) - 1, side // 2, np.float32(len(body.along) // 2 + 0.5)
    along, across, per_px, off_u = body.along, body.across, body.per_px, off[0]
    along_u, along_v, across_u, across_v = per_px[0, 0], per_px[0, 1], per_px[1, 0], per_px[1, 1]
    for k in range(len(around)):
        far_u, far_v = around[k, 0] - base[0] - off_u, around[k, 1] - base[1] - off[1]
        far_a, far_b = along_u * far_u + along_v * far_v, across_u * far_u + across_v * far_v
        if body.near[0] < far_a * far_a + far_b * far_b < body.near[1]:
            for j in range(side):
                v, drawn = np.float32(j - half) - off[1], images[:, j * side : (j + 1) * side]
                down, right = along_v * v + (zero - far_a), across_v * v + (zero - far_b)
                for i in range(side):
                    u = np.float32(i - half) - off_u
                    a = along[min(max(int(along_u * u + down), 0), last)]
                    b = across[min(max(int(across_u * u + right), 0), last)]
                    drawn[0, i] += a[0] * b[0]
                    drawn[3, i] += a[2] * b[0] + a[0] * b[2]


@inner_kernel(fastmath=True)
def _solve(basis: Image, columns: Image, products: FloatArray, out: FloatArray) -> None:
    """Height, place and blur of one dot from the differences of its columns, with what is left of them (12,)."""
    for k in range(5):
        of = _products(columns, columns[k])
        for m in range(5):
            products[k, m] = of[m]
    # normal equations after projecting out the backgrounds (Frisch and Waugh): products minus those along the basis
    for c in range(len(basis)):
        smooth = _products(columns, basis[c])
        for k in range(5):
            for m in range(5):
                products[k, m] -= smooth[k] * smooth[m]
    # height and place alone first: entry (0, 4) is then the height under the blur that all dots share
    for k in range(3):
        eliminate(products, k, 4)
    out[3] = products[0, 4]  # before the blur is fitted as well
    eliminate(products, 3, 4)
    # after the fourth: the inverse of the normal matrix in front, the coefficients in column 4, the right side still in row 4
    height, power, found = products[0, 4], max(products[4, 4], 1e-300), 0.0
    for k in range(4):
        found += products[k, 4] * products[4, k]
    some = min(height, 1e150) if height > 0.0 else 1e150  # what is no bump has no place
    # h T(x - d) = h T(x) - h d T'(x)
    for k in range(2):
        out[k] = min(max(-products[1 + k, 4] / some, -FARTHEST_MM), FARTHEST_MM)
        for m in range(2):
            out[4 + 2 * k + m] = products[1 + k, 1 + m] / (some * some)
    left = max(power - found, 0.0)
    out[2], out[8], out[9] = height, products[3, 4] / some, products[3, 3] / (some * some)
    out[10], out[11] = left, left / power


@kernel(fastmath=True)
def differences(image: Image, side: int, out: Image) -> None:
    """Differences between pixels and the next ones, row by row, 0 at the end of a row; then between them and those below."""
    # of slices: an index of i + 1 may be negative for all that numba knows, and such a loop takes four times as long
    side_by_side, below = out[: len(image) - 1], out[len(image) - 1 :]
    right, down = image[1:], image[side:]
    for i in range(len(right)):
        side_by_side[i] = right[i] - image[i]
    for i in range(side - 1, len(right), side):
        side_by_side[i] = 0.0
    for i in range(len(down)):
        below[i] = down[i] - image[i]


@inner_kernel(fastmath=True)
def _products(columns: Image, other: Image) -> tuple[float, float, float, float, float]:
    """Scalar products of five columns with another one: together they take half the time."""
    a = b = c = d = e = np.float32(0.0)
    for i in range(len(other)):
        a += columns[0, i] * other[i]
        b += columns[1, i] * other[i]
        c += columns[2, i] * other[i]
        d += columns[3, i] * other[i]
        e += columns[4, i] * other[i]
    return float(a), float(b), float(c), float(d), float(e)
