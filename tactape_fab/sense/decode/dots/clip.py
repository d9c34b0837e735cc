"""A number within limits: `min` and `max` are compiled anew for each kernel that calls them, this once for floats."""

from __future__ import annotations

from tactape_fab.base.jit import inner_kernel


@inner_kernel()
def clip(value: float, low: float, high: float) -> float:
    """The value, or the limit that it is beyond; NaN as it is."""
    return low if low > value else (high if high < value else value)
