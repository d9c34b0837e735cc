"""POSES.csv and -hand-eye.json: read in any order of columns, refused in words."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactape_fab import SpecError
from tactape_fab.sense.files.arm_poses import read_arm_poses, read_hand_eye

HEADER = "frame,x_mm,y_mm,z_mm,qw,qx,qy,qz\n"


def test_poses_are_read_in_any_order_of_columns(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("qw,qx,qy,qz,frame,z_mm, y_mm,x_mm,sigma_mm\n0.5,0.5,0.5,0.5,3,30,20,10,0.5\n\n")
    (pose,) = read_arm_poses(path, "poses", 4)
    assert pose.frame == 3 and np.allclose(pose.flange_to_base[:3, 3], (10, 20, 30))
    assert np.allclose(pose.flange_to_base[:3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    assert (pose.sigma_mm, pose.sigma_deg) == (0.5, 0.05)


def test_rotations_are_those_of_scipy(tmp_path: Path) -> None:
    turns = Rotation.random(20, random_state=1)
    rows = [f"{k},1,2,3,{w},{x},{y},{z}\n" for k, (x, y, z, w) in enumerate(turns.as_quat().tolist())]
    (tmp_path / "poses.csv").write_text(HEADER + "".join(rows))
    poses = read_arm_poses(tmp_path / "poses.csv", "poses", 20)
    assert np.allclose([pose.flange_to_base[:3, :3] for pose in poses], turns.as_matrix(), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x,y\n1,2\n", "its first line must be frame,x_mm,y_mm,z_mm,qw,qx,qy,qz, and may go on with sigma_mm,sigma_deg"),
        ("", "its first line must be"),
        ("frame,x_mm,y_mm,theta_deg\n0,1,2,3\n", r"lies flat on the tape, turned by theta_deg, give z_mm = 0, qw = 0, qx = cos"),
        (HEADER, "has no row; give a row a frame, or leave out --hand-eye"),
        (HEADER + "0,1,2,3,1,0,0\n", "line 2: it does not have one value a column"),
        (HEADER + "0,1,2,3,1,0,0,0,9\n", "line 2: it does not have one value a column"),
        (HEADER + "0,1,nan,3,1,0,0,0\n", "line 2: y_mm = 'nan' is no number from -100000 to 100000"),
        (HEADER + "5,1,2,3,1,0,0,0\n", "line 2: frame = 5 is not a whole number from 0 to 4; count the frames from 0"),
        (HEADER + "0.5,1,2,3,1,0,0,0\n", "line 2: frame = 0.5 is not a whole number"),
        (HEADER + "0,1,2,3,1,1,0,0\n", "the quaternion's length is 1.41, not 1"),
        (HEADER + "0,1e9,2,3,1,0,0,0\n", "x_mm = '1e9' is no number from"),
        (HEADER + "0,1_0,2,3,1,0,0,0\n", "x_mm = '1_0' is no number from"),
        (HEADER + "\u0661,1,2,3,1,0,0,0\n", "frame = '\u0661' is no number from"),
        (HEADER + "0,1,2,3,1,0,0,0\n" * 2, "line 3: frame 0 is there twice"),
        ((HEADER + "0,1,2,3,1,0,0,0\n").replace("\n", "\r"), "is no CSV: .*; give one row a frame, lines ended by LF or CRLF"),
        (HEADER.strip() + ",sigma_mm\n0,1,2,3,1,0,0,0,0\n", "sigma_mm = '0' is no number from 0.0001 to 100"),
    ],
)
def test_bad_poses_are_refused_in_words(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SpecError, match=words):
        read_arm_poses(path, "hand_eye", 5)


def test_poses_that_are_not_there_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="cannot be opened: No such file"):
        read_arm_poses(tmp_path / "none.csv", "poses")


GOOD = {"format": "tactape-hand-eye/1", "tape": "t", "sensor_to_flange": np.eye(4).tolist(), "tape_to_base": np.eye(4).tolist()}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (json.dumps(GOOD).replace('{"format"', '{"tape": "u", "format"').encode(), "is no tactape-hand-eye/1"),
        (b"no json", "is no tactape-hand-eye/1; give the file that calibrate wrote"),
        ({**GOOD, "format": "tactape-hand-eye/9"}, "is no tactape-hand-eye/1"),
        ({k: v for k, v in GOOD.items() if k != "tape"}, "tape is missing"),
        ({**GOOD, "tape_to_base": np.eye(3).tolist()}, r"tape_to_base\[0\] = .* is not 4 numbers"),
        ({**GOOD, "tape_to_base": [[1e9] * 4] * 4}, "exceeds 100000"),
        ({**GOOD, "sensor_to_flange": (2.0 * np.eye(4)).tolist()}, "sensor_to_flange is no rotation and place"),
    ],
)
def test_bad_hand_eye_files_are_refused_in_words(tmp_path: Path, content: bytes | dict[str, object], words: str) -> None:
    path = tmp_path / "x-hand-eye.json"
    path.write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
    with pytest.raises(SpecError, match=words):
        read_hand_eye(path)
