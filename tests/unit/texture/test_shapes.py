"""Polygons of the board that are many at once."""

from __future__ import annotations

import numpy as np

from tactape_fab.texture.shapes import outlines_at, rounded_rectangle


def test_outlines_stand_at_their_places() -> None:
    xy_mm = np.random.default_rng(2).uniform(-9.0, 700.0, (1000, 2))
    outline_mm = rounded_rectangle((0.6, 0.3), 0.1)
    assert outlines_at(xy_mm, outline_mm).tobytes() == (xy_mm[:, None] + outline_mm).tobytes()
    assert outlines_at(xy_mm[:0], outline_mm).shape == (0, len(outline_mm), 2)
