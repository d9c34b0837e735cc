"""Separable smoothing of float32 images: the same bytes on every machine, by multiplications and additions that round once.

Sums run in the order of OpenCV's ``sepFilter2D`` with fused multiply-add: along a row tap by tap from the left, along a
column from the middle outwards, two taps that are equal at a time. Products of two float32 are exact in float64, so that
rounding their sum to float32 is what a fused operation does.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from tactape_fab.base.jit import kernel

FloatImage = npt.NDArray[np.float32]


def smooth(image: FloatImage, across: FloatImage, down: FloatImage, beyond: Literal["edge", "constant"]) -> FloatImage:
    """Correlate an image with a kernel along its rows and another down its columns.

    Parameters
    ----------
    image : ndarray of float32, shape (h, w)
    across, down : ndarray of float32
        Symmetric kernels of odd length.
    beyond : {"edge", "constant"}
        What lies beyond the border: its nearest pixel, or zeros.

    Returns
    -------
    ndarray of float32, shape (h, w)
    """
    reach_u, reach_v = len(across) // 2, len(down) // 2
    padded = np.pad(image, ((reach_v, reach_v), (reach_u, reach_u)), mode=beyond)
    rows = np.empty((padded.shape[0], image.shape[1]), dtype=np.float32)
    _along_rows(padded, across, rows)
    smoothed = np.empty(image.shape, dtype=np.float32)
    _down_columns(rows, down, smoothed)
    return smoothed


@kernel()
def _along_rows(image: FloatImage, taps: FloatImage, out: FloatImage) -> None:
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            out[v, u] = image[v, u] * taps[0]
        for i in range(1, len(taps)):
            tap = np.float64(taps[i])
            for u in range(out.shape[1]):
                out[v, u] = np.float64(image[v, u + i]) * tap + np.float64(out[v, u])


@kernel()
def _down_columns(image: FloatImage, taps: FloatImage, out: FloatImage) -> None:
    reach = len(taps) // 2
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            out[v, u] = image[v + reach, u] * taps[reach]
        for i in range(1, reach + 1):
            tap = np.float64(taps[reach + i])
            for u in range(out.shape[1]):
                pair = image[v + reach + i, u] + image[v + reach - i, u]
                out[v, u] = np.float64(pair) * tap + np.float64(out[v, u])
