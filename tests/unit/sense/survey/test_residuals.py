"""Residuals of a survey: their derivatives against differences, with oblong pixels and a lens off the centre."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense.survey.residuals import Rows, common_prior, residuals
from tactape_fab.texture.frames import FloatArray
from tests.surveyed import SENSOR as CENTRED

SENSOR = replace(CENTRED, geometry=replace(CENTRED.geometry, center_px=(140.0, 90.0)))


def test_derivatives_are_those_of_theresiduals() -> None:
    """Of dots that are seen where they are modelled."""
    rng = np.random.default_rng(1)
    part, contact = np.arange(12), np.repeat([0, 1, 2], 4)
    seen_px, (pushed, pulled) = rng.uniform(0.0, 230.0, (12, 2)), rng.normal(size=(2, 12, 2))
    rows = Rows(part=part, seen_px=seen_px, own=np.ones(12), rim_mm2=np.zeros(12), pushed=pushed, pulled=pulled, contact=contact)
    common, poses = np.array([0.0, 0.0, 0.0, 0.0, 0.03, 0.1]), np.array([(1.0, 2.0, 0.3), (-4.0, 0.5, 3.1), (0.0, 0.0, -1.6)])
    places_mm = residuals(rows, SENSOR, common, poses, np.zeros((12, 2)))[0]

    def left(common: FloatArray, turn: float) -> FloatArray:
        return residuals(rows, SENSOR, common, np.add(poses, (0.0, 0.0, turn)), places_mm)[0]

    step = 1e-6
    none, by_turn, by_common = residuals(rows, SENSOR, common, poses, places_mm)
    assert none == pytest.approx(np.zeros((12, 2)), abs=1e-12)
    by = [(left(common + d, 0.0) - left(common - d, 0.0)) / (2 * step) for d in step * np.eye(6)]
    assert by_common == pytest.approx(np.stack(by, axis=2), abs=1e-6)
    assert by_turn == pytest.approx((left(common, step) - left(common, -step)) / (2 * step), abs=1e-6)


def test_the_prior_is_that_of_a_camera_as_its_profile_has_it() -> None:
    """Neighbours and the rim move dots in any image; half of a profile's tolerance is one standard deviation."""
    mean, sigmas = common_prior(replace(CENTRED, scale_tolerance=0.04))
    assert mean.tolist() == [0.0, 0.0, 0.0, 0.0, 0.012, 0.2]
    assert sigmas[0] == 0.02 and (sigmas > 0.0).all()
