"""Polygons of the board, beside those of shapely."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from shapely import affinity

from tactape_fab.texture.shapes import (
    CHORD_ERROR_MM,
    area_mm2,
    axis_angle_deg,
    board_outline,
    inset_mm,
    outlines_at,
    placed_outline,
    reach_mm,
    rotate,
    rounded_rectangle,
    signed_area_mm2,
)


def test_outlines_stand_at_their_places() -> None:
    xy_mm = np.random.default_rng(2).uniform(-9.0, 700.0, (1000, 2))
    outline_mm = rounded_rectangle((0.6, 0.3), 0.1)
    assert outlines_at(xy_mm, outline_mm).tobytes() == (xy_mm[:, None] + outline_mm).tobytes()
    assert outlines_at(xy_mm[:0], outline_mm).shape == (0, len(outline_mm), 2)


@pytest.mark.parametrize("radius_mm", [0.0, 0.0005, 0.3, 12.0])
def test_a_board_has_its_size_and_its_corners(radius_mm: float) -> None:
    """The box of its corners' centres, widened by the radius; the least inset is the distance from it."""
    outline_mm = board_outline((30.0, 24.0), radius_mm)
    found = shapely.Polygon(outline_mm)
    right = shapely.box(radius_mm, radius_mm, 30.0 - radius_mm, 24.0 - radius_mm).buffer(radius_mm, quad_segs=1000)
    assert shapely.hausdorff_distance(found, right) < 1.05 * CHORD_ERROR_MM
    assert found.is_valid and found.exterior.is_ccw
    assert np.hypot(*(outline_mm - np.roll(outline_mm, 1, axis=0)).T).min() > 1e-9
    areas_mm2 = (area_mm2(outline_mm), signed_area_mm2(outline_mm), -signed_area_mm2(outline_mm[::-1]))
    assert areas_mm2 == pytest.approx((found.area,) * 3)
    points = np.random.default_rng(1).uniform((-3.0, -3.0), (33.0, 27.0), (300, 2))
    away = shapely.distance(right.exterior, shapely.points(points)) * np.where(shapely.contains_xy(right, *points.T), 1, -1)
    assert inset_mm(points, (30.0, 24.0), radius_mm) == pytest.approx(away, abs=1e-4)


@pytest.mark.parametrize("angle_deg", [0.0, 45.0, 90.0, -30.0])
def test_a_land_is_turned_counter_clockwise_and_snapped(angle_deg: float) -> None:
    plain = rounded_rectangle((0.6, 0.4), 0.1)
    assert reach_mm(plain) == pytest.approx((0.3, 0.2)) and len(plain) == 36  # nine a corner
    turned = shapely.get_coordinates(affinity.rotate(shapely.MultiPoint(plain), angle_deg, origin=(0, 0)))
    assert rotate(plain, angle_deg) == pytest.approx(turned)
    placed = placed_outline((0.6, 0.4), 0.1, angle_deg)
    assert placed == pytest.approx(turned, abs=6e-7) and placed * 1e6 == pytest.approx(np.rint(placed * 1e6), abs=1e-6)


@pytest.mark.parametrize(("vector", "deg"), [((1, 0), 0), ((1, 1), 45), ((0, -2), 90), ((-1, 1), 135), ((-1, -1), 45)])
def test_a_line_has_a_direction_below_180_degrees(vector: tuple[float, float], deg: float) -> None:
    assert axis_angle_deg(vector) == pytest.approx(deg)
