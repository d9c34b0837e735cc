"""A tape's place on a panel, turned or not: p_panel = offset + R p_board."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.kit.panel.geometry import Place


@pytest.mark.parametrize(
    ("turned", "offset_mm", "extent_mm", "low_mm", "corner_mm"),
    [
        (False, (10.0, 7.0), (60.0, 40.0), (10.0, 7.0), (70.0, 47.0)),
        (True, (50.0, 7.0), (40.0, 60.0), (10.0, 7.0), (10.0, 67.0)),
    ],
)
def test_a_place_is_a_rotation_and_a_shift(
    turned: bool,
    offset_mm: tuple[float, float],
    extent_mm: tuple[float, float],
    low_mm: tuple[float, float],
    corner_mm: tuple[float, float],
) -> None:
    place = Place(size_mm=(60.0, 40.0), radius_mm=1.0, offset_mm=offset_mm, turned=turned)
    assert (place.rotation_deg, place.extent_mm, place.low_mm) == (90.0 * turned, extent_mm, low_mm)
    assert place.on_panel_mm(np.array([0.0, 0.0])) == offset_mm
    assert place.on_panel_mm(np.array([60.0, 40.0])) == corner_mm
    assert place.outline_mm.min(axis=0) == pytest.approx(low_mm)
    assert place.outline_mm.max(axis=0) == pytest.approx(np.add(low_mm, extent_mm))
