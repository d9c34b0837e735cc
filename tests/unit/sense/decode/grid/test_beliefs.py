"""Priors of a profile, and of parts that are longer than wide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense import load_sensor
from tactape_fab.sense.decode.grid.beliefs import PUSH_LEAN, beliefs_of
from tactape_fab.sense.decode.grid.posterior import _drawn
from tactape_fab.sense.geometry import Gel, Geometry
from tactape_fab.texture.part import TapePart

SENSOR = load_sensor("gelsight-mini")


def test_beliefs_are_the_profile_s() -> None:
    stated = replace(SENSOR, geometry=Geometry(sigma_px_per_mm=0.08, sigma_aspect=0.01, sigma_shear=0.02, sigma_k1=0.0))
    assert beliefs_of(stated, fixed_scale=False).sigmas == pytest.approx([0.005, 0.01, 0.02, 0.0])
    assert beliefs_of(stated, fixed_scale=True).sigmas[0] == 0.0
    assert beliefs_of(SENSOR, fixed_scale=False).sigmas[0] == SENSOR.scale_tolerance / 2
    gel = beliefs_of(replace(SENSOR, gel=Gel(displacement_um=120.0, correlation_mm=3.0)), fixed_scale=False)
    assert (gel.gel_mm, gel.correlation_mm) == (0.12, 3.0)


def test_long_parts_push_their_neighbours_farther_along_themselves() -> None:
    part = TapePart(name="r0201", shape="block", body_mm=(0.6, 0.3, 0.23), rotation_deg=45.0)
    lean = beliefs_of(SENSOR, fixed_scale=False, part=part).lean
    assert lean == pytest.approx((0.0, -PUSH_LEAN / 3.0))  # up on the board is towards smaller y of the texture
    pair, out, theta = np.array([[0.0, 0.0], [1.0, 0.0]]), np.empty((2, 2, 2)), np.radians(90.0)
    # at 90 degrees all directions are turned by a quarter, and twice those by a half
    _drawn(pair, pair, np.ones(2), np.cos(theta), np.sin(theta), 0.5, 0.0, -lean[0], -lean[1], np.empty((2, 2)), out)
    assert out[0, :, 1] == pytest.approx([-lean[1], 1.0])  # along v, and towards the length that is at 45 degrees in the image
    assert beliefs_of(SENSOR, fixed_scale=False, part=replace(part, shape="pin")).lean == (0.0, 0.0)


def test_parts_lean_along_their_own_direction() -> None:
    """At 30 degrees up from the board's +x: 60 degrees twice, and texture +y is down."""
    part = TapePart(name="r0201", shape="block", body_mm=(0.6, 0.3, 0.23), rotation_deg=30.0)
    lean = beliefs_of(SENSOR, fixed_scale=False, part=part).lean
    assert lean == pytest.approx((PUSH_LEAN / 3.0 * 0.5, -PUSH_LEAN / 3.0 * 0.75**0.5))


def test_the_distortion_s_centre_and_corner_are_on_the_gel() -> None:
    sensor = replace(SENSOR, px_per_mm=(16.0, 12.0), geometry=Geometry(center_px=(100.0, 80.0), sigma_px_per_mm=0.08))
    beliefs = beliefs_of(sensor, fixed_scale=False)
    assert beliefs.sigmas[0] == pytest.approx(0.08 / 16.0)
    middle_px = (np.array([SENSOR.width_px, SENSOR.height_px]) - 1.0) / 2.0
    assert beliefs.centre_mm == pytest.approx(((100.0, 80.0) - middle_px) / (16.0, 12.0))
    assert beliefs.corner_mm == pytest.approx(np.full(2, np.hypot(*middle_px)) / (16.0, 12.0), rel=0.01)
