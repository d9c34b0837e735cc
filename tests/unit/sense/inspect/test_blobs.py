"""Spots of a scan against the places where they were drawn."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.sense.inspect.blobs import find_blobs


@pytest.mark.parametrize("width_px", [2213, 2218])
def test_spots_lie_where_they_were_drawn_across_the_whole_scan(width_px: int) -> None:
    """At these widths the smaller picture's size is rounded by nearly half a pixel, up and down."""
    px_per_mm, picture = 12.7, np.full((200, width_px, 3), (30, 120, 200), np.uint8)
    u, v = np.meshgrid(np.arange(50, width_px - 40, 30), np.arange(45, 160, 30))
    for x, y in zip(u.ravel(), v.ravel(), strict=True):
        picture[y - 2 : y + 3, x - 4 : x + 5] = 20
    found = find_blobs(picture, px_per_mm, 0.6).px
    right = found[found[:, 0] > 0.8 * width_px]
    assert len(found) >= u.size
    # columns are 30 px apart, the first at 50
    off_px = (right[:, 0] - 50.0 + 15.0) % 30.0 - 15.0
    assert abs(off_px.mean()) < 0.25
