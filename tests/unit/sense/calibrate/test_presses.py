"""Presses: dots of located frames, at the parts that they name."""

from __future__ import annotations

import numpy as np

from tactape_fab.sense import simulate
from tactape_fab.sense.calibrate.presses import located
from tests.measured import measured
from tests.unit.sense.calibrate.sensors import TAPE, TRUE, off_mm, presses


def test_dots_of_a_press_are_at_the_parts_that_they_name() -> None:
    made = presses()
    found, answers = located(made.frames[:3], [TAPE], TRUE)
    assert [press.frame for press in found] == [0, 1, 2] and all(fix.located for fix in answers)
    for press, pose in zip(found, made.poses, strict=False):
        assert press.tape == TAPE.name and 0.15 < press.weights.min() <= press.weights.max() <= 1.0
        assert np.median(np.hypot(*off_mm(press, pose).T)) < 0.03


def test_parts_that_were_measured_are_where_they_stand() -> None:
    tape, parts = measured(TAPE, 0.05, seed=2)
    pose = np.array([40.0, 24.0, 30.0])
    frame = simulate(tape, pose[:2].tolist(), pose[2], sensor=TRUE, parts=parts, seed=1)
    built, design = (np.median(np.hypot(*off_mm(located([frame], [one], TRUE)[0][0], pose).T)) for one in (tape, TAPE))
    assert built < 0.02 and design > 0.04
