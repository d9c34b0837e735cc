"""The camera as a vector: it makes the profile's own camera, and its derivatives are those of differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tactape_fab.sense.calibrate import camera
from tests.unit.sense.calibrate.sensors import TRUE

VALUES = np.array([np.log(15.0), 0.03, -0.02, 0.05, 4.0, -7.0])
AT_MM = np.random.default_rng(0).uniform(-8.0, 8.0, (20, 2))


def test_parameters_and_profile_are_the_same_thing() -> None:
    made = camera.with_parameters(TRUE, VALUES)
    assert np.allclose(camera.parameters(made), VALUES)
    assert made.px_per_mm[0] == made.px_per_mm[1]
    oblong = replace(TRUE, px_per_mm=(15.0, 12.0))
    assert np.allclose(np.divide(*camera.with_parameters(oblong, VALUES).px_per_mm), 15.0 / 12.0)


def test_pixels_are_those_of_the_profile_from_what_the_image_centre_sees() -> None:
    made = camera.with_parameters(TRUE, VALUES)
    px, _, _ = camera.seen_by(TRUE, VALUES).to_px(AT_MM)
    assert np.allclose(px, made.camera.to_px(AT_MM + made.camera.from_px(made.centre_px)))
    middle, _, _ = camera.seen_by(TRUE, VALUES).to_px(np.zeros((1, 2)))
    assert np.allclose(middle, made.centre_px)


def test_derivatives_are_those_of_differences() -> None:
    _, by_point, by_parameter = camera.seen_by(TRUE, VALUES).to_px(AT_MM)
    step = 1e-5
    for k, d in enumerate(step * np.eye(2)):
        ends = [camera.seen_by(TRUE, VALUES).to_px(AT_MM + s * d)[0] for s in (1, -1)]
        assert np.allclose((ends[0] - ends[1]) / (2 * step), by_point[:, :, k], atol=1e-5)
    for k, d in enumerate(step * np.eye(camera.COUNT)):
        ends = [camera.seen_by(TRUE, VALUES + s * d).to_px(AT_MM)[0] for s in (1, -1)]
        assert np.allclose((ends[0] - ends[1]) / (2 * step), by_parameter[:, :, k], atol=1e-4)
