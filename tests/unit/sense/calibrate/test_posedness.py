"""Frames as they are read, and figures of remarks, against all pairs."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.sense.calibrate.posedness import _spread, checked_frames


@pytest.mark.parametrize("turns_deg", [(0, 0, 0, 20), (170, -170, 175, -5), (89, -89, 90, 91), (45,)])
def test_the_spread_of_turns_is_the_largest_difference_of_two(turns_deg: tuple[float, ...]) -> None:
    apart = [abs((a - b + 90) % 180 - 90) for a in turns_deg for b in turns_deg]
    assert np.degrees(_spread(np.radians(turns_deg))) == pytest.approx(max(apart))


def test_masked_depth_is_a_hole() -> None:
    depth = np.arange(400.0).reshape(20, 20)
    hidden = depth % 7 == 0
    (image,), bad = checked_frames([np.ma.array(np.where(hidden, -9999.0, depth), mask=hidden)])
    np.testing.assert_array_equal(image, np.where(hidden, np.nan, depth))
    assert image.dtype == np.float32 and bad == []
