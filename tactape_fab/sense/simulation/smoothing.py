"""Separable smoothing of float32 images: the same bytes on every machine, by multiplications and additions that round once.

Sums run in the order of OpenCV's ``sepFilter2D`` with fused multiply-add: along a row tap by tap from the left, along a
column from the middle outwards, two taps that are equal at a time. Products of two float32 are exact in float64, so that
rounding their sum to float32 is what a fused operation does, but for ties: on every machine the same.
"""

from __future__ import annotations

import sys
from typing import Literal

import numpy as np
import numpy.typing as npt

FloatImage = npt.NDArray[np.float32]
KERNEL_REACH = 3.5
"""Half the width of a Gaussian kernel, in standard deviations."""
_BLOCK = 128
"""Rows at a time: the buffers of so many rows stay in a processor's cache, and fewer would be more calls of numpy."""


def gaussian_kernel(sigma_px: float) -> FloatImage:
    """A normalised Gaussian of odd length."""
    at = np.arange(-int(np.ceil(KERNEL_REACH * sigma_px)), int(np.ceil(KERNEL_REACH * sigma_px)) + 1)
    weight = np.exp(-0.5 * (at / sigma_px) ** 2)
    return np.asarray((weight / weight.sum()).astype(np.float32))


def smooth(image: FloatImage, across: FloatImage, down: FloatImage, beyond: Literal["edge", "constant"]) -> FloatImage:
    """Correlate an image with a kernel along its rows and another down its columns.

    image (h, w)
    across, down: Symmetric kernels of odd length.
    beyond {"edge", "constant"}: Values beyond the border: the nearest pixel, or zeros.
    Returns (h, w).
    """
    reach_u, reach_v = len(across) // 2, len(down) // 2
    along_rows, down_columns = _along_rows, _down_columns
    if "numba" in sys.modules:  # the same bits four times as fast, but loading a compiler takes longer than a few images
        from tactape_fab.base.jit import COMPILED

        if COMPILED:
            from tactape_fab.sense.simulation.compiled_smoothing import along_rows, down_columns
    padded = np.pad(image, ((reach_v, reach_v), (reach_u, reach_u)), mode=beyond)
    rows = np.empty((padded.shape[0], image.shape[1]), dtype=np.float32)
    for first in range(0, len(rows), _BLOCK):
        along_rows(padded[first : first + _BLOCK], across, rows[first : first + _BLOCK])
    smoothed = np.empty(image.shape, dtype=np.float32)
    for first in range(0, len(smoothed), _BLOCK):
        down_columns(rows[first : first + _BLOCK + 2 * reach_v], down, smoothed[first : first + _BLOCK])
    return smoothed


def _along_rows(image: FloatImage, taps: FloatImage, out: FloatImage) -> None:
    width = out.shape[1]
    np.multiply(image[:, :width], taps[0], out=out)
    exact = np.empty(out.shape)
    for i in range(1, len(taps)):
        _add_product(image[:, i : i + width], taps[i], exact, out)


def _down_columns(image: FloatImage, taps: FloatImage, out: FloatImage) -> None:
    reach, height = len(taps) // 2, out.shape[0]
    np.multiply(image[reach : reach + height], taps[reach], out=out)
    exact, pair = np.empty(out.shape), np.empty_like(out)
    for i in range(1, reach + 1):
        np.add(image[reach + i : reach + i + height], image[reach - i : reach - i + height], out=pair)
        _add_product(pair, taps[reach + i], exact, out)


def _add_product(image: FloatImage, tap: np.float32, exact: npt.NDArray[np.float64], out: FloatImage) -> None:
    """Add a multiple of an image to `out` with one rounding, as a fused multiply-add does; `exact` is a buffer."""
    np.multiply(image, np.float64(tap), out=exact, dtype=np.float64)
    # the product is exact in float64, the sum rounds once there and once to float32: as a fused operation, but where the first
    # rounding makes a tie, once in some 2^29
    exact += out
    out[...] = exact
