"""The k-th smallest of some values, and their median, without sorting them all."""

from __future__ import annotations

import numpy as np

from tactape_fab.base.jit import inner_kernel
from tactape_fab.sense.decode.dots.clip import clip
from tactape_fab.texture.frames import FloatArray


@inner_kernel()
def select(values: FloatArray, k: int) -> float:
    """The k-th smallest (from 0) of some values by quickselect, in place: none before it is larger, none behind it smaller."""
    low, high = 0, len(values) - 1
    while low < high:
        # of values in order the middle one halves them. Both inner loops stop at the pivot, and at NaN, with which every
        # comparison is false: under fastmath a compiler may assume that there is none, and they would run off the array
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        # only the part that holds k is divided again: O(n) on average
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return float(values[k])


@inner_kernel()
def median(values: FloatArray) -> float:
    """The median of some values, which are put into another order; NaN of none."""
    n = len(values)
    if n == 0:
        return np.nan
    upper = select(values, n // 2)
    if n % 2 == 1:
        return float(upper)
    lower = values[0]
    for i in range(1, n // 2):
        lower = clip(lower, values[i], np.inf)
    return float(0.5 * (lower + upper))
