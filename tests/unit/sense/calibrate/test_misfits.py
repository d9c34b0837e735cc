"""Turns from which the sensor's place on the flange is searched for."""

from __future__ import annotations

from math import pi, radians

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactape_fab.sense.calibrate.misfits import turned_starts


@pytest.mark.parametrize("flip", [0.0, pi])
def test_a_search_begins_near_any_turn_of_a_sensor_about_the_flange_s_axis(flip: float) -> None:
    starts = turned_starts()
    assert not starts[:, :3, 3].any()
    for turn in np.linspace(-pi, pi, 73):
        sensor = Rotation.from_rotvec([0.0, 0.0, turn]) * Rotation.from_rotvec([flip, 0.0, 0.0])
        assert (Rotation.from_matrix(starts[:, :3, :3]) * sensor.inv()).magnitude().min() < radians(30.001)
