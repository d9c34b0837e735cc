"""Residuals of a survey: their derivatives against differences, with oblong pixels."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.sense.survey.residuals import Rows, residuals
from tactape_fab.texture.frames import FloatArray
from tests.surveyed import SENSOR


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
