"""Rows of a survey's adjustment against differences, with oblong pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense import load_sensor
from tactape_fab.sense.survey.adjust import _on_gel, _residuals, _Rows
from tactape_fab.texture.frames import FloatArray

SENSOR = replace(load_sensor("gelsight-mini"), px_per_mm=(16.0, 8.0))


def test_derivatives_are_those_of_the_residuals() -> None:
    rng = np.random.default_rng(1)
    part, contact = np.arange(12), np.repeat([0, 1, 2], 4)
    seen_px, (pushed, pulled, places_mm) = rng.uniform(0.0, 230.0, (12, 2)), rng.normal(size=(3, 12, 2))
    rows = _Rows(part=part, seen_px=seen_px, own=np.ones(12), rim_mm2=np.zeros(12), pushed=pushed, pulled=pulled, contact=contact)
    common, poses = np.array([0.0, 0.0, 0.0, 0.0, 0.03, 0.1]), np.array([(1.0, 2.0, 0.3), (-4.0, 0.5, 3.1), (0.0, 0.0, -1.6)])

    def left(common: FloatArray, turn: float) -> FloatArray:
        gel, rates = _on_gel(rows, SENSOR, common)
        return _residuals(rows, gel, rates, np.add(poses, (0.0, 0.0, turn)), places_mm)[0]

    step = 1e-6
    _, by_turn, by_common = _residuals(rows, *_on_gel(rows, SENSOR, common), poses, places_mm)
    by = [(left(common + d, 0.0) - left(common - d, 0.0)) / (2 * step) for d in step * np.eye(6)]
    assert by_common == pytest.approx(np.stack(by, axis=2), abs=1e-6)
    assert by_turn == pytest.approx((left(common, step) - left(common, -step)) / (2 * step), abs=1e-6)
