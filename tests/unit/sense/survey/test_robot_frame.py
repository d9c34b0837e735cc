"""The frame of a robot that holds a survey: found from its poses, which are refused where they are of another."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab import SpecError
from tactape_fab.sense.survey.robot_frame import RobotFrame
from tests.surveyed import NOMINAL_MM, by_robot, drawn


@pytest.mark.parametrize(
    ("moved", "sigma", "says"),
    [
        ((0.6, 0.7, 0.09), (0.1, 0.1), None),
        ((0.7, 0.8, 0.0), (0.1, 0.1), r"1\.1 mm or 0 deg off"),
        ((0.7, 0.8, 0.0), (0.4, 0.1), None),
        ((0.0, 0.0, 0.11), (0.1, 0.1), r"mm or 6\.3 deg off"),
        ((0.0, 0.0, -0.11), (0.1, 3.0), None),
    ],
)
def test_poses_of_another_frame_are_refused(moved: tuple[float, ...], sigma: tuple[float, float], says: str | None) -> None:
    """By more than 1 mm or 0.1 rad, and three standard deviations; the frame is that of all poses, across 180 deg."""
    contacts, poses = drawn(np.random.default_rng(1), 0.0 * NOMINAL_MM, 5)
    frame = RobotFrame(by_robot(poses, np.array([300.0, -50.0, 3.1]), sigma), contacts, poses)
    assert frame.at == pytest.approx((300.0, -50.0, 3.1))
    if says is None:
        frame.refuse_others(poses + moved)
    else:
        with pytest.raises(SpecError, match=says):
            frame.refuse_others(poses + moved)
