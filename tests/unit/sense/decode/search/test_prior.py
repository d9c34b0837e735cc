"""A prior is refused where it says nothing."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab import Prior, SpecError


@pytest.mark.parametrize(
    ("key", "value"),
    [("position_mm", (np.nan, 3.0)), ("position_mm", (1.0,)), ("theta_deg", np.nan), ("radius_mm", -1.0), ("angle_deg", np.nan)],
)
def test_a_prior_that_says_nothing_is_refused(key: str, value: object) -> None:
    good = {"position_mm": (1.0, 2.0), "theta_deg": 0.0}
    with pytest.raises(SpecError, match=key):
        Prior(**{**good, key: value})  # type: ignore[arg-type]
