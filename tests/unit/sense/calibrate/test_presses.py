"""Presses: dots of located frames, at the parts that they name."""

from __future__ import annotations

import numpy as np

from tactape_fab.sense import simulate
from tactape_fab.sense.calibrate.presses import Press, located
from tactape_fab.texture.frames import FloatArray
from tests.measured import measured
from tests.unit.sense.calibrate.sensors import TAPE, TRUE, presses


def test_dots_of_a_press_are_at_the_parts_that_they_name() -> None:
    made = presses()
    found, answers = located(made.frames[:3], [TAPE], TRUE)
    assert [press.frame for press in found] == [0, 1, 2] and all(fix.located for fix in answers)
    for press, pose in zip(found, made.poses, strict=False):
        assert press.tape == TAPE.name and 0.15 < press.weights.min() <= press.weights.max() <= 1.0
        assert np.median(off_mm(press, pose)) < 0.03


def off_mm(press: Press, pose: FloatArray) -> FloatArray:
    """How far dots are seen from where a pose has their parts, on the gel."""
    theta = np.radians(pose[2])
    turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    on_gel = TRUE.camera.from_px(press.seen_px) - TRUE.camera.from_px(TRUE.centre_px) + press.rim_mm
    away: FloatArray = np.hypot(*(on_gel - (press.texture_mm - pose[:2]) @ turn.T).T)
    return away


def test_parts_that_were_measured_are_where_they_stand() -> None:
    tape, parts = measured(TAPE, 0.05, seed=2)
    pose = np.array([40.0, 24.0, 30.0])
    frame = simulate(tape, pose[:2].tolist(), pose[2], sensor=TRUE, parts=parts, seed=1)
    built, design = (np.median(off_mm(located([frame], [one], TRUE)[0][0], pose)) for one in (tape, TAPE))
    assert built < 0.02 and design > 0.04
