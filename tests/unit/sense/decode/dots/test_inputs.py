"""The span of a frame's depths is numpy's, whatever they are."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.sense.decode.dots.inputs import span

EXTREME = (0.0, -0.0, 1.0, -1.0, 1e-45, -1e-45, 3.4e38, -3.4e38, np.inf, -np.inf, np.nan, -np.nan)


@pytest.mark.parametrize("sign", [None, 1.0, -1.0])
@pytest.mark.parametrize("order", ["C", "F"])
def test_span_is_that_of_numpy(sign: float | None, order: str) -> None:
    rng = np.random.default_rng(5)
    for k in range(500):
        image = rng.choice(EXTREME, (2, 3)) if k % 2 else rng.normal(rng.normal(0.0, 3.0), 1.0, (5, 4))
        image = np.array(image if sign is None else np.copysign(image, sign), dtype=np.float32, order=order)  # type: ignore[call-overload]
        with np.errstate(invalid="ignore"):
            assert np.array_equal(span(image), [image.min(), image.max()], equal_nan=True), image
