"""Stretch and bend of a whole tape: what its modes can follow, what is rigid and so is none, and how large it may be."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab import SpecError
from tactape_fab.sense.survey.bend import LEAST_BEND_MM, MOST_BEND_MM, Bend
from tactape_fab.texture.frames import FloatArray

PLACES_MM: FloatArray = np.random.default_rng(0).uniform((5.0, 3.0), (95.0, 47.0), (200, 2))
X, Y = PLACES_MM.T
NONE = np.zeros_like(X)


def test_all_of_degree_two_is_rigid_or_followed_and_modes_are_of_one_size() -> None:
    bend = Bend(PLACES_MM, held=True)
    assert bend.modes.shape == (9, 400)
    assert bend.modes @ bend.modes.T == pytest.approx(400 * np.eye(9), abs=1e-9)
    rigid = np.stack([np.r_[NONE + 1, NONE], np.r_[NONE, NONE + 1], np.r_[-Y, X]])
    assert bend.modes @ rigid.T == pytest.approx(np.zeros((9, 3)), abs=1e-6)
    for of in (X, Y, X**2, X * Y, Y**2):
        for flat in (np.r_[of, NONE], np.r_[NONE, of]):
            both = np.vstack([bend.modes, rigid]).T
            assert both @ np.linalg.lstsq(both, flat, rcond=None)[0] == pytest.approx(flat, abs=1e-6)


def test_without_a_robot_there_is_none() -> None:
    bend = Bend(PLACES_MM, held=False)
    assert bend.modes.shape == (0, 400) and bend.shift_mm.tolist() == np.zeros((200, 2)).tolist()
    bend.refuse_other_units()


def test_its_size_is_that_of_its_amplitudes_and_their_errors() -> None:
    bend = Bend(PLACES_MM, held=True)
    assert bend.sigma_mm == LEAST_BEND_MM
    bend.move(np.full(9, 0.02), np.full(9, 0.0009))
    bend.move(np.full(9, 0.02), np.full(9, 0.0009))
    assert bend.amplitude_mm == pytest.approx(0.04) and bend.sigma_mm == pytest.approx(0.05)  # of 0.04 and 0.03
    # each of 9 modes has a mean square of 0.04^2 over both axes: hypot of x and y is sqrt(2) times as much
    assert np.sqrt((bend.shift_mm**2).sum(axis=1).mean()) == pytest.approx(0.04 * 3 * np.sqrt(2.0))
    assert bend.shift_mm.T.ravel() == pytest.approx(0.04 * bend.modes.sum(axis=0))
    bend.move(np.full(9, -0.04), np.zeros(9))
    assert bend.sigma_mm == LEAST_BEND_MM


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_poses_of_another_scale_are_refused(factor: float) -> None:
    bend = Bend(PLACES_MM, held=True)
    amplitude_mm = np.zeros(9)
    amplitude_mm[4] = factor * MOST_BEND_MM / np.sqrt(2.0)
    bend.move(amplitude_mm, np.zeros(9))
    if factor < 1.0:
        bend.refuse_other_units()
    else:
        with pytest.raises(SpecError, match=r"stretched or bent by 0\.3 mm \(rms\), more than 0\.3 mm; give poses in mm"):
            bend.refuse_other_units()
