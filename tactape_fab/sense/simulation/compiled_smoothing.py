"""The two stages of `smoothing.smooth` compiled, for a process that has loaded the compiler anyway; the bits are the same."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tactape_fab.base.jit import kernel

FloatImage = npt.NDArray[np.float32]


@kernel()
def along_rows(image: FloatImage, taps: FloatImage, out: FloatImage) -> None:
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            out[v, u] = image[v, u] * taps[0]
        for i in range(1, len(taps)):
            tap = np.float64(taps[i])
            for u in range(out.shape[1]):
                out[v, u] = np.float64(image[v, u + i]) * tap + np.float64(out[v, u])


@kernel()
def down_columns(image: FloatImage, taps: FloatImage, out: FloatImage) -> None:
    reach = len(taps) // 2
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            out[v, u] = image[v + reach, u] * taps[reach]
        for i in range(1, reach + 1):
            tap = np.float64(taps[reach + i])
            for u in range(out.shape[1]):
                pair = image[v + reach + i, u] + image[v + reach - i, u]
                out[v, u] = np.float64(pair) * tap + np.float64(out[v, u])
