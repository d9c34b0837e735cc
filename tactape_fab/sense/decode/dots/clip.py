"""Clamp a float, compiled once: numba compiles `min` and `max` anew for each kernel that calls them."""

from __future__ import annotations

from tactape_fab.base.jit import inner_kernel


@inner_kernel()
def clip(value: float, low: float, high: float) -> float:
    """The value clamped to [low, high]; NaN is returned as it is."""
    return low if low > value else (high if high < value else value)
