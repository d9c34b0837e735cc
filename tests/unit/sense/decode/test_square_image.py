"""The image with square pixels: of a sensor without a camera model, and of a bent one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense import load_sensor
from tactape_fab.sense.decode.square_image import square_image
from tactape_fab.sense.geometry import Geometry

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
