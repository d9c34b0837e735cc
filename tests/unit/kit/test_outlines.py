"""Outlines of a part about its centre, against shapes that shapely draws from the numbers of the part's and the fab's files."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from shapely import affinity

from tactape_fab.kit.outlines import copper_outline, element_outline, part_outlines, spur_tips
from tactape_fab.kit.profiles import load_fab, load_part

PART, FAB = load_part("r0201"), load_fab("generic-fpc")
TURNED_DEG = 45.0
WIDER_MM = 2 * FAB.coverlay_expansion_mm


def turned(shape: shapely.Geometry) -> shapely.Geometry:
    return affinity.rotate(shape, TURNED_DEG, origin=(0, 0))


def rectangle(length_mm: float, width_mm: float, radius_mm: float = 0.0) -> shapely.Polygon:
    half_x, half_y = length_mm / 2 - radius_mm, width_mm / 2 - radius_mm
    inner = shapely.box(-half_x, -half_y, half_x, half_y)
    return turned(inner.buffer(radius_mm, quad_segs=64) if radius_mm else inner)


def apart_mm(shape: shapely.Geometry, points: np.ndarray) -> float:
    return float(shape.hausdorff_distance(shapely.Polygon(points)))


def test_outlines_are_those_of_the_part_s_file_turned() -> None:
    found = part_outlines(PART, FAB, TURNED_DEG)
    expected = {
        "body": rectangle(0.60, 0.30),
        "largest_body": rectangle(0.63, 0.33),
        "courtyard": rectangle(1.40, 0.70),
        "pad": rectangle(0.46, 0.40, 0.10),
        "paste": rectangle(0.318, 0.36, 0.0795),
        "opening": rectangle(1.10 + WIDER_MM, 0.40 + WIDER_MM),
    }
    assert {name: apart_mm(shape, getattr(found, name)) < 0.003 for name, shape in expected.items()} == dict.fromkeys(
        expected, True
    )
    assert found.opening_size_mm == pytest.approx((1.10 + WIDER_MM, 0.40 + WIDER_MM))
    # land 1 is on the side of -x before the part is turned
    for centres, offset_mm in ((found.pad_xy, 0.32), (found.paste_xy, 0.345)):
        assert shapely.get_coordinates(turned(shapely.MultiPoint([(-offset_mm, 0), (offset_mm, 0)]))) == pytest.approx(
            centres, abs=1e-6
        )


@pytest.mark.parametrize("anchored", [False, True])
def test_copper_lies_within_its_outline_and_touches_it(anchored: bool) -> None:
    found = part_outlines(PART, FAB, TURNED_DEG)
    copper = [affinity.translate(shapely.Polygon(found.pad), x, y) for x, y in found.pad_xy]
    if anchored:  # a spur as wide as a web ends 0.15 mm beyond the opening, in half a circle of 0.05 mm
        end_mm = found.opening_size_mm[0] / 2 + 0.15
        copper.append(turned(shapely.LineString([(0.05 - end_mm, 0), (end_mm - 0.05, 0)]).buffer(0.05, quad_segs=64)))
        assert spur_tips(found.opening_size_mm, FAB, 0.0) == pytest.approx(np.array([[0.05 - end_mm, 0], [end_mm - 0.05, 0]]))
    hull = shapely.MultiPoint(copper_outline(found, FAB, TURNED_DEG, anchored=anchored)).convex_hull
    assert hull.buffer(1e-5).covers(shapely.union_all(copper))
    assert hull.hausdorff_distance(shapely.union_all(copper).convex_hull) < 0.001


def test_feet_of_elements_are_blocks_or_circles() -> None:
    assert apart_mm(rectangle(0.60, 0.30), element_outline("block", (0.60, 0.30, 0.23), TURNED_DEG)) < 1e-6
    for shape in ("dome", "cone"):
        foot = element_outline(shape, (0.60, 0.60, 0.23), TURNED_DEG)
        assert np.hypot(*foot.T) == pytest.approx(np.full(len(foot), 0.30), abs=1e-6)
        assert shapely.Polygon(foot).exterior.is_ccw
        assert shapely.Point(0, 0).distance(shapely.Polygon(foot).exterior) > 0.30 - 1e-4
