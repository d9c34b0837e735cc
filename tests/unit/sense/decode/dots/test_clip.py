"""A number within limits: as `min` and `max` have it, NaN as it is."""

from __future__ import annotations

from math import inf, isnan, nan

import pytest

from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.dots import clip as module


@kernel()
def _clipped(value: float, low: float, high: float) -> float:
    return float(module.clip(value, low, high))


@pytest.mark.parametrize("clip", [module.clip.py_func, _clipped])
def test_a_value_beyond_a_limit_is_the_limit(clip) -> None:  # type: ignore[no-untyped-def]
    for low, high in ((-1.0, 2.0), (0.0, 0.0), (-inf, 1.0), (1.0, inf)):
        for value in (-inf, -1.5, -1.0, 0.0, 0.5, 2.0, 3.0, inf):
            assert clip(value, low, high) == min(max(value, low), high)
        assert isnan(clip(nan, low, high))
