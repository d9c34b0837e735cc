"""Poses of a robot -> poses of the sensor in the tape's plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, degrees

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.sense.files.arm_poses import ArmPose, HandEyeFile, tilt_deg

MOST_TILT_DEG = 20.0
"""Largest tilt of a sensor: beyond, it would touch with its side, and the poses are of another frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotPose:
    """Pose of the sensor at a frame, in a frame of the robot's that lies flat on the tape: seen from above x right, y up.

    frame: Counted over all frames from 0.
    x_mm, y_mm: The sensor's image centre.
    theta_deg: Its turn, counter-clockwise seen from above.
    sigma_mm, sigma_deg: Standard deviations.
    """

    frame: int
    x_mm: float
    y_mm: float
    theta_deg: float
    sigma_mm: float
    sigma_deg: float


def in_plane(poses: Sequence[ArmPose], hand_eye: HandEyeFile | None) -> list[RobotPose]:
    """Poses of the sensor in the tape's plane.

    poses: Of the flange; of the sensor itself where there is no `hand_eye`, in a base whose z axis is up from the tape.
    hand_eye: Where the sensor is on the flange, and the tape in the base.
    Raises SpecError if the sensor does not look down on the tape at some pose.
    """
    # sensor on the tape: Y^-1 B X (`calibrate.hand_eye`)
    on_flange = np.eye(4) if hand_eye is None else hand_eye.sensor_to_flange
    to_tape = np.eye(4) if hand_eye is None else np.linalg.inv(hand_eye.tape_to_base)
    found = [(pose, to_tape @ pose.flange_to_base @ on_flange) for pose in poses]
    most, worst = max((tilt_deg(sensor), pose.frame) for pose, sensor in found)
    if most > MOST_TILT_DEG:
        message = f"poses: at frame {worst} the sensor's z axis is {most:.0f} deg from straight down, more than {MOST_TILT_DEG:g}"
        remedy = (
            "give --hand-eye, which says where the sensor is on the flange"
            if hand_eye is None
            else "give the --hand-eye file of this robot, sensor and tape"
        )
        raise SpecError(Problem("poses", f"{message}; {remedy}"))
    return [
        RobotPose(
            frame=pose.frame,
            x_mm=float(sensor[0, 3]),
            y_mm=float(sensor[1, 3]),
            theta_deg=degrees(atan2(sensor[1, 0], sensor[0, 0])),
            sigma_mm=pose.sigma_mm,
            sigma_deg=pose.sigma_deg,
        )
        for pose, sensor in found
    ]
