"""The image with square pixels: of a sensor without a camera model, and of a bent one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense import load_sensor
from tactape_fab.sense.decode.dots.elongation import square_pixels
from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.dots.frame_dots import frame_dots
from tactape_fab.sense.decode.grid.long_parts import drawn_px
from tactape_fab.sense.decode.square_image import square_image
from tactape_fab.sense.geometry import Geometry
from tests.tapes import tape_at

PLACES = np.random.default_rng(1).uniform(0.0, 300.0, (40, 2))


@pytest.mark.parametrize("px_per_mm", [(16.0, 16.0), (16.0, 12.3)])
def test_without_a_camera_dots_are_decoded_as_they_are(px_per_mm: tuple[float, float]) -> None:
    sensor = replace(load_sensor("gelsight-mini"), px_per_mm=px_per_mm, geometry=Geometry(sigma_aspect=0.01))
    assert (square_image(sensor).places(PLACES) == PLACES * (1.0, px_per_mm[0] / px_per_mm[1])).all()


@pytest.mark.parametrize("geometry", [Geometry(shear=0.02), Geometry(k1=-0.05), Geometry(aspect=0.01)])
def test_distances_on_the_gel_are_kept_where_the_camera_is_bent(geometry: Geometry) -> None:
    sensor = replace(load_sensor("gelsight-mini"), geometry=geometry)
    square = square_image(sensor)
    on_gel_mm = np.random.default_rng(2).uniform(-4.0, 4.0, (40, 2))
    found_mm = (square.places(sensor.camera.to_px(on_gel_mm)) - square.centre_px) / square.px_per_mm
    middle_mm = (square.places(sensor.centre_px[None]) - square.centre_px) / square.px_per_mm
    assert middle_mm == pytest.approx(np.zeros((1, 2)), abs=1e-9)
    assert found_mm - found_mm[0] == pytest.approx(on_gel_mm - on_gel_mm[0], abs=1e-6)


@pytest.mark.parametrize(
    "geometry", [Geometry(), Geometry(shear=0.08), Geometry(k1=0.1), Geometry(aspect=-0.08, center_px=(150, 99))]
)
def test_an_image_shows_its_dots_where_they_are_decoded(geometry: Geometry) -> None:
    sensor = replace(load_sensor("gelsight-mini"), px_per_mm=(16.0, 12.8), geometry=geometry)
    square = square_image(sensor)
    seen_px = np.array([(150.0, 90.0), (230.0, 70.0), (60.0, 170.0), (260.0, 200.0)])
    v, u = np.mgrid[: sensor.height_px, : sensor.width_px]
    hills = [np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / 50.0).astype(np.float32) for at in seen_px]
    found = [square.image(hill) for hill in hills]
    tops = np.array([np.unravel_index(hill.argmax(), hill.shape)[::-1] for hill in found])
    # the paper's method takes places from the middle of the image that it is given
    h, w = found[0].shape
    off_px = square.places(seen_px) - square.centre_px
    assert tops - (np.array([w, h]) - 1) / 2 == pytest.approx(off_px, abs=1.0)


def test_an_almost_perfect_camera_changes_no_pixel() -> None:
    sensor = replace(load_sensor("gelsight-mini"), geometry=Geometry(k1=1e-12))
    depth = np.random.default_rng(3).random(sensor.frame_shape).astype(np.float32)
    assert square_image(sensor).image(depth) == pytest.approx(depth, abs=1e-3)
    oblong = replace(sensor, px_per_mm=(16.0, 12.8))
    # 240 rows from the first one's middle to the last one's
    assert square_image(oblong).image(depth).shape == (round(239 * 1.25) + 1, 320)


AT_PX = np.array([(60 + 24 * k, 50 + 19.2 * j) for k in range(8) for j in range(7)])


def hills() -> Image:
    """Dots at those places in an image of 240 x 320 px."""
    v, u = np.mgrid[:240, :320]
    each = [np.exp(-((u - x) ** 2) / 18.0 - (v - y) ** 2 / 12.0) for x, y in AT_PX]
    return np.asarray(np.sum(each, axis=0), dtype=np.float32)


@pytest.mark.parametrize(
    ("px_per_mm", "geometry"), [((16.0, 16.0), Geometry()), ((16.0, 12.8), Geometry()), ((16.0, 16.0), Geometry(k1=0.05))]
)
def test_dots_keep_where_they_are_seen(px_per_mm: tuple[float, float], geometry: Geometry) -> None:
    sensor = replace(load_sensor("gelsight-mini"), px_per_mm=px_per_mm, geometry=geometry)
    seen, found = frame_dots(hills(), sensor), square_image(sensor).dots(hills())
    assert len(seen.xy_px) >= 40 and seen.elongation is not None and found.elongation is not None
    assert found.xy_px == pytest.approx(square_image(sensor).places(seen.xy_px))
    if px_per_mm == (16.0, 16.0) and geometry == Geometry():
        assert found.seen_px is None and np.array_equal(found.elongation, seen.elongation, equal_nan=True)
    else:
        assert found.seen_px is not None and np.array_equal(found.seen_px, seen.xy_px)
        wanted = square_pixels(seen.elongation, px_per_mm[0] / px_per_mm[1])
        assert wanted is not None and np.array_equal(found.elongation, wanted, equal_nan=True)


def test_corrections_are_in_square_pixels_less_what_long_parts_draw() -> None:
    sensor = replace(load_sensor("gelsight-mini"), px_per_mm=(16.0, 12.8))
    square, part, high = square_image(sensor), tape_at(7, (4, 4)).part, frame_dots(hills(), sensor).high
    assert high is not None
    seen = np.add(AT_PX, (0.4, -0.3))
    offset, texture = square.places(seen) - square.centre_px, (square.places(seen) - square.centre_px) / 16.0
    shift, heights, covariance = square.shifts(None, high, seen, offset, texture)
    assert covariance is None and np.ptp(heights) < 0.01 < heights.min()
    assert np.median(shift, axis=0) == pytest.approx((-0.4, 0.3 * 1.25), abs=0.02)
    drawn = drawn_px(part, heights, offset, texture, 16.0)
    assert drawn is not None
    less, again, _ = square.shifts(part, high, seen, offset, texture)
    assert np.array_equal(again, heights) and np.array_equal(less, shift - drawn.shift_px)
    assert not np.array_equal(less, shift)
    # parts that are as wide as long draw nothing
    even = replace(part, body_mm=(0.4, 0.4, 0.23))
    assert np.array_equal(square.shifts(even, high, seen, offset, texture)[0], shift)
