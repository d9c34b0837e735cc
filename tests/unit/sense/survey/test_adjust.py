"""Adjustment of a survey: its rows against differences, with oblong pixels, and drawn contacts with their true places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense import load_sensor
from tactape_fab.sense.survey.adjust import Prior, _residuals, _Rows, adjust
from tactape_fab.sense.survey.contacts import Contact
from tactape_fab.texture.frames import FloatArray

SENSOR = replace(load_sensor("gelsight-mini"), px_per_mm=(16.0, 8.0))


def test_derivatives_are_those_of_the_residuals() -> None:
    """Of dots that are seen where they are modelled."""
    rng = np.random.default_rng(1)
    part, contact = np.arange(12), np.repeat([0, 1, 2], 4)
    seen_px, (pushed, pulled) = rng.uniform(0.0, 230.0, (12, 2)), rng.normal(size=(2, 12, 2))
    rows = _Rows(part=part, seen_px=seen_px, own=np.ones(12), rim_mm2=np.zeros(12), pushed=pushed, pulled=pulled, contact=contact)
    common, poses = np.array([0.0, 0.0, 0.0, 0.0, 0.03, 0.1]), np.array([(1.0, 2.0, 0.3), (-4.0, 0.5, 3.1), (0.0, 0.0, -1.6)])
    places_mm = _residuals(rows, SENSOR, common, poses, np.zeros((12, 2)))[0]

    def left(common: FloatArray, turn: float) -> FloatArray:
        return _residuals(rows, SENSOR, common, np.add(poses, (0.0, 0.0, turn)), places_mm)[0]

    step = 1e-6
    none, by_turn, by_common = _residuals(rows, SENSOR, common, poses, places_mm)
    assert none == pytest.approx(np.zeros((12, 2)), abs=1e-12)
    by = [(left(common + d, 0.0) - left(common - d, 0.0)) / (2 * step) for d in step * np.eye(6)]
    assert by_common == pytest.approx(np.stack(by, axis=2), abs=1e-6)
    assert by_turn == pytest.approx((left(common, step) - left(common, -step)) / (2 * step), abs=1e-6)


@pytest.mark.parametrize("count", [40, 200])
def test_many_contacts_of_a_small_tape_do_not_stretch_it(count: int) -> None:
    """Dots err by 6 um along each axis, and nothing else does: places are off as far as is said, however often touched."""
    dot_mm, scatter_mm, squares, scales = 0.006, 0.05, [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        nominal_mm = 1.5 * np.array([(c, r) for r in range(9) for c in range(14)])
        shift_mm = rng.normal(0.0, scatter_mm, nominal_mm.shape)
        contacts = []
        for k in range(count):
            position_mm, theta = rng.uniform((2.0, 2.0), (18.0, 10.0)), rng.uniform(-np.pi, np.pi)
            part = np.flatnonzero(np.hypot(*(nominal_mm - position_mm).T) < 4.5)
            c, s = np.cos(theta), np.sin(theta)
            # q = R(theta)^T (T - S), seen on the gel with an error
            gel_mm = (nominal_mm[part] + shift_mm[part] - position_mm) @ np.array([[c, s], [-s, c]])
            gel_mm += rng.normal(0.0, dot_mm, gel_mm.shape)
            none = np.zeros_like(gel_mm)
            contacts.append(
                Contact(
                    frame=k,
                    part=part,
                    seen_px=SENSOR.camera.to_px(gel_mm + SENSOR.camera.from_px(SENSOR.centre_px)),
                    own=np.ones(len(part)),
                    rim_mm2=np.zeros(len(part)),
                    pushed=none,
                    pulled=none,
                    start=np.array([*(position_mm + rng.normal(0.0, 0.02, 2)), theta + rng.normal(0.0, 0.003)]),
                    expected=np.zeros(0, dtype=np.int64),
                )
            )
        prior = Prior(shift_mm=np.zeros_like(nominal_mm), sigma_mm=np.full(len(nominal_mm), np.nan))
        found = adjust(contacts, nominal_mm, SENSOR, prior)
        off = (found.shift_mm - shift_mm[found.part]) / found.sigma_mm[:, None]
        squares.append(float((off**2).mean()))
        scales.append(float(found.common[0] / found.common_sigma[0]))
    assert np.mean(squares) < 2.0
    assert np.abs(scales).max() < 3.0
