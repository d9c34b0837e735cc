"""The camera model: its formula by hand, its inverse, and how a profile's tables become it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.base.templates import templates_folder
from tactape_fab.sense import load_sensor
from tactape_fab.sense.geometry import Gel, Geometry, camera
from tactape_fab.sense.sensors import as_sensor

GENERIC = (templates_folder() / "sensors" / "generic.toml").read_text(encoding="utf-8")
SIZE_PX = (320, 240)


def with_tables(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(GENERIC + text, encoding="utf-8")
    return path


def test_each_parameter_moves_a_point_as_its_formula_says() -> None:
    plain = camera((16.0, 15.0), SIZE_PX, Geometry())
    np.testing.assert_allclose(plain.to_px([[0, 0], [2, 1]]), [[159.5, 119.5], [191.5, 134.5]])
    np.testing.assert_allclose(camera((16.0, 15.0), SIZE_PX, Geometry(aspect=0.02)).to_px([2, 1]), [159.5 + 32.32, 119.5 + 14.85])
    np.testing.assert_allclose(camera((16.0, 16.0), SIZE_PX, Geometry(shear=0.05)).to_px([2, 1]), [159.5 + 32.8, 135.5])
    corner = np.array([159.5, 119.5]) / 16.0
    np.testing.assert_allclose(camera((16.0, 16.0), SIZE_PX, Geometry(k1=0.03)).to_px(corner), np.array([159.5, 119.5]) * 2.03)
    np.testing.assert_allclose(camera((16.0, 16.0), SIZE_PX, Geometry(center_px=(100.0, 90.0))).to_px([1, 1]), [116.0, 106.0])


@pytest.mark.parametrize("k1", [-0.1, -0.05, 0.0, 0.03, 0.2])
def test_from_px_undoes_to_px(k1: float) -> None:
    model = camera((16.0, 15.5), SIZE_PX, Geometry(aspect=0.05, shear=-0.03, k1=k1))
    px = np.random.default_rng(1).uniform((0, 0), SIZE_PX, (40, 25, 2))
    assert np.abs(model.to_px(model.from_px(px)) - px).max() < 1e-6


def test_tables_that_are_left_out_are_those_of_a_sensor_that_nobody_calibrated() -> None:
    sensor = load_sensor("generic")
    assert (sensor.geometry, sensor.gel) == (Geometry(), Gel())


def test_tables_are_read(tmp_path: Path) -> None:
    path = with_tables(
        tmp_path,
        "\n[geometry]\naspect = 0.01\nshear = -0.002\nk1 = 0.03\ncenter_px = [150.0, 121.5]\nsigma_px_per_mm = 0.02\n"
        "sigma_k1 = 0.001\n"
        "\n[gel]\nthickness_mm = 4.0\nmodulus_kpa = 275\ndisplacement_um = 20\n",
    )
    sensor = load_sensor(path)
    assert sensor.geometry == Geometry(
        aspect=0.01, shear=-0.002, k1=0.03, center_px=(150.0, 121.5), sigma_px_per_mm=0.02, sigma_k1=0.001
    )
    assert sensor.gel == Gel(thickness_mm=4.0, modulus_kpa=275.0, displacement_um=20.0)
    np.testing.assert_allclose(sensor.camera.to_px([0, 0]), [150.0, 121.5])


def test_everything_wrong_in_them_is_said_at_once(tmp_path: Path) -> None:
    text = '\n[geometry]\naspect = 1.03\nk2 = 0.1\ncenter_px = [1]\nsigma_k1 = -1\n[gel]\nthickness_mm = "4"\n'
    with pytest.raises(SpecError) as refusal:
        load_sensor(with_tables(tmp_path, text))
    said = str(refusal.value)
    assert "aspect = 1.03 exceeds 0.2; give the difference from 1: 0.03 for 3 %" in said
    for words in ("k2", "center_px", "sigma_k1 = -1 is below 0", "thickness_mm = '4' is not a number in mm"):
        assert words in said


def test_a_barrel_that_shows_nothing_at_a_corner_is_refused(tmp_path: Path) -> None:
    """Beyond it the way back through the lens does not end: corners would have places at random."""
    load_sensor(with_tables(tmp_path, "\n[geometry]\nk1 = -0.12\n"))
    for geometry, least in (("k1 = -0.13", "-0.120"), ("k1 = -0.06\ncenter_px = [0.0, 0.0]", "-0.030")):
        with pytest.raises(SpecError, match=rf"geometry\.k1 = -0\.\d+ is below {least}.*an image\.mask of the pixels within"):
            load_sensor(with_tables(tmp_path, f"\n[geometry]\n{geometry}\n"))


def test_a_mask_without_corners_takes_a_stronger_barrel() -> None:
    """Where the lens is exact on all pixels that count, it may be worse beyond them."""
    sensor = replace(load_sensor("gelsight-mini"), geometry=Geometry(k1=-0.18))
    with pytest.raises(SpecError, match=r"image\.mask of the pixels within 0\.82"):
        as_sensor(sensor)
    v, u = np.indices((sensor.height_px, sensor.width_px))
    apart = np.hypot(u - sensor.centre_px[0], v - sensor.centre_px[1])
    mask = apart < 0.81 * sensor.camera.corner_px
    model = as_sensor(replace(sensor, mask=mask)).camera
    at = np.argwhere(mask)[:, ::-1][::50].astype(float)
    np.testing.assert_allclose(model.to_px(model.from_px(at)), at, atol=1e-8)
