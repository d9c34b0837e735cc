"""Figures of remarks, against all pairs."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.sense.calibrate.posedness import _spread


@pytest.mark.parametrize("turns_deg", [(0, 0, 0, 20), (170, -170, 175, -5), (89, -89, 90, 91), (45,)])
def test_the_spread_of_turns_is_the_largest_difference_of_two(turns_deg: tuple[float, ...]) -> None:
    apart = [abs((a - b + 90) % 180 - 90) for a in turns_deg for b in turns_deg]
    assert np.degrees(_spread(np.radians(turns_deg))) == pytest.approx(max(apart))
