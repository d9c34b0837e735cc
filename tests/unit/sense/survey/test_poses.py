"""Poses of a robot in the tape's plane."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tactape_fab import SpecError
from tactape_fab.sense import ArmPose
from tactape_fab.sense.calibrate.misfits import matrix_of, on_tape
from tactape_fab.sense.files.arm_poses import read_hand_eye
from tactape_fab.sense.survey.poses import in_plane

SEEN = np.array([(10.0, 5.0, 0.3), (20.0, 8.0, -2.9)])
"""x, y (texture frame) and theta."""


def test_a_sensor_s_own_poses_are_taken_as_they_are() -> None:
    poses = [ArmPose(frame=k, flange_to_base=m, sigma_mm=0.1) for k, m in enumerate(on_tape(SEEN, np.zeros(2)))]
    for pose, (x, y, theta) in zip(in_plane(poses, None), SEEN, strict=True):
        assert np.allclose((pose.x_mm, pose.y_mm, pose.theta_deg), (x, -y, np.degrees(theta)))
        assert (pose.sigma_mm, pose.sigma_deg) == (0.1, 0.05)


def test_the_pose_that_is_tilted_most_is_named() -> None:
    down = on_tape(SEEN[:1], np.zeros(2))[0]
    for tilts_deg, frame in (((5, 19.9, 3), None), ((5, 30, 25), 1)):
        turned = [matrix_of(np.array([0, 0, 0, np.radians(tilt), 0, 0])) @ down for tilt in tilts_deg]
        poses = [ArmPose(frame=k, flange_to_base=m) for k, m in enumerate(turned)]
        if frame is None:
            assert len(in_plane(poses, None)) == 3
        else:
            with pytest.raises(
                SpecError, match=f"at frame {frame} the sensor's z axis is 30 deg from straight down, more than 20"
            ):
                in_plane(poses, None)


def test_a_flange_s_poses_need_what_calibrate_found(tmp_path: Path) -> None:
    on_flange, in_base = matrix_of(np.array([5, -3, 80, 0.1, 3.0, 0.2])), matrix_of(np.array([400, 20, -7, 0.5, 1.2, -0.4]))
    path = tmp_path / "mine-hand-eye.json"
    said = {"sensor_to_flange": on_flange.tolist(), "tape_to_base": in_base.tolist()}
    path.write_text(json.dumps({"format": "tactape-hand-eye/1", "tape": "t", **said}))
    flange = in_base @ on_tape(SEEN, np.zeros(2)) @ np.linalg.inv(on_flange)
    poses = [ArmPose(frame=k, flange_to_base=m) for k, m in enumerate(flange)]
    found = in_plane(poses, read_hand_eye(path))
    assert np.allclose([(p.x_mm, p.y_mm, np.radians(p.theta_deg)) for p in found], SEEN * (1, -1, 1))
    with pytest.raises(SpecError, match=r"z axis is .* deg from straight down, more than 20; give --hand-eye, which says"):
        in_plane(poses, None)
