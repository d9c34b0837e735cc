"""Poses of a robot at its frames, POSES.csv: one format for `calibrate --hand-eye` and `survey --poses`; and hand-eye answers.

A row is the pose of the flange, or of any frame fixed to it, in the robot's base: place in mm, unit quaternion qw, qx, qy, qz.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import degrees, isfinite
from pathlib import Path

import numpy as np

from tactape_fab.base.errors import Problem, SpecError, reason_of, refuse
from tactape_fab.base.fields import Fields, shown, shown_path
from tactape_fab.base.given_value import as_numbers
from tactape_fab.base.input_file import read_regular
from tactape_fab.base.json_text import parse_json
from tactape_fab.sense.geometry import from_quaternion, is_rotation
from tactape_fab.texture.frames import FloatArray

COLUMNS = ("frame", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
OPTIONAL = {"sigma_mm": 0.02, "sigma_deg": 0.05}
"""Columns that may be left out, and what is taken then: a good arm's repeatability."""
HAND_EYE_FORMAT = "tactape-hand-eye/1"
MOST_BYTES, MOST_ROWS, MOST_PROBLEMS = 16_000_000, 100_000, 20
FARTHEST_MM = 1e5
UNIT_TOLERANCE = 0.02
_PLANE = {"frame", "x_mm", "y_mm", "theta_deg"}
_RANGES = dict.fromkeys(COLUMNS[1:4], (-FARTHEST_MM, FARTHEST_MM)) | {"sigma_mm": (1e-4, 100.0), "sigma_deg": (1e-4, 180.0)}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmPose:
    """The robot's flange in its base, at a frame.

    Attributes
    ----------
    frame : int
        Index of the frame.
    flange_to_base : ndarray, shape (4, 4)
        mm.
    sigma_mm, sigma_deg : float
        Standard deviations along and about each axis. `calibrate_sensor` finds them itself, and takes `sigma_deg` for how much of
        the tilts is the arm's own error.

    Raises
    ------
    SpecError
        If the matrix is no rotation with a place, or another value is none of these.
    """

    frame: int
    flange_to_base: FloatArray
    sigma_mm: float = OPTIONAL["sigma_mm"]
    sigma_deg: float = OPTIONAL["sigma_deg"]

    def __post_init__(self) -> None:
        table = Fields({"frame": self.frame, "sigma_mm": self.sigma_mm, "sigma_deg": self.sigma_deg})
        table.integer("frame", low=0, high=10**9)
        table.number("sigma_mm", above=0.0)
        table.number("sigma_deg", above=0.0, unit="deg")
        remedy = "a 4 x 4 matrix of a rotation and, in its last column, a place in mm"
        matrix = as_numbers(self.flange_to_base, (4, 4), "flange_to_base", remedy)
        if not _is_pose(matrix):
            table.problem("flange_to_base", f"flange_to_base of frame {shown(self.frame)} is no pose; give {remedy}")
        refuse(table.problems)
        object.__setattr__(self, "flange_to_base", matrix)


def _is_pose(matrix: FloatArray) -> bool:
    """Whether a matrix (4, 4) is a rotation with a place."""
    return is_rotation(matrix[:3, :3], 1e-3) and bool(np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0)))


def read_arm_poses(path: str | Path, key: str, frames: int | None = None) -> list[ArmPose]:
    """Poses of a robot's flange in its base.

    path: CSV with the columns of `COLUMNS` in any order, and those of `OPTIONAL` if they are there.
    key: The option that names it, for messages.
    frames: How many frames there are.
    Raises SpecError with every row that cannot be read, twenty at most.
    """
    data = _bytes_of(path, key, "give a CSV file")
    rows = csv.reader(io.StringIO(data.decode("utf-8-sig", errors="replace")))
    problems: list[Problem] = []
    found: dict[int, ArmPose] = {}
    try:
        names = [name.strip() for name in next(rows, [])]
        if not set(COLUMNS) <= set(names) or not set(names) <= {*COLUMNS, *OPTIONAL} or len(set(names)) < len(names):
            raise SpecError(Problem(key, f"{key} = {shown_path(path)} {_other_columns(names)}"))
        for number, row in enumerate(rows, start=2):
            if not row:
                continue
            if len(found) >= MOST_ROWS:
                problems.append(Problem(key, f"{key} = {shown_path(path)} has more than {MOST_ROWS} rows; give one for a frame"))
            if len(found) >= MOST_ROWS or len(problems) >= MOST_PROBLEMS:
                break
            faults, pose = _pose(dict(zip(names, row, strict=False)), len(row) == len(names), frames)
            if pose is not None and pose.frame in found:
                faults = [f"frame {pose.frame} is there twice; leave one out"]
            elif pose is not None:
                found[pose.frame] = pose
            problems += [Problem(key, f"{key} = {shown_path(path)} line {number}: {fault}") for fault in faults]
    except csv.Error as error:
        message = f"{key} = {shown_path(path)} is no CSV: {error}; give one row a frame, lines ended by LF or CRLF"
        problems.append(Problem(key, message))
    if not found and not problems:
        option = key.replace("_", "-")
        problems.append(Problem(key, f"{key} = {shown_path(path)} has no row; give a row a frame, or leave out --{option}"))
    if problems:
        raise SpecError(problems[:MOST_PROBLEMS])
    return list(found.values())


def _bytes_of(path: str | Path, key: str, remedy: str) -> bytes:
    try:
        data = read_regular(Path(path), MOST_BYTES)
    except (OSError, ValueError) as error:
        raise SpecError(Problem(key, f"{key} = {shown_path(path)} cannot be opened: {reason_of(error)}; {remedy}")) from error
    if len(data) > MOST_BYTES:
        raise SpecError(Problem(key, f"{key} = {shown_path(path)} is larger than {MOST_BYTES} bytes; give a row a frame"))
    return data


def _other_columns(names: Sequence[str]) -> str:
    """The fault of the first line, and how poses in a plane are written in this format."""
    message = f"has the columns {shown(','.join(names))}; its first line must be {','.join(COLUMNS)}"
    if set(names) >= _PLANE:
        return (
            f"{message}: for a sensor that lies flat on the tape, turned by theta_deg, give z_mm = 0, qw = 0, "
            "qx = cos(theta / 2), qy = sin(theta / 2), qz = 0"
        )
    return f"{message}, and may go on with {','.join(OPTIONAL)}"


def _pose(row: Mapping[str, str], whole: bool, frames: int | None) -> tuple[list[str], ArmPose | None]:
    """The pose of a row, or its fault."""
    if not whole:
        return ["it does not have one value a column; correct it"], None
    values: dict[str, float] = dict(OPTIONAL)
    faults = []
    for name, text in row.items():
        try:
            # Python would take 1_0 for 10, and digits of other scripts
            values[name] = float(text) if text.isascii() and "_" not in text else float("nan")
        except ValueError:
            values[name] = float("nan")
        low, high = _RANGES.get(name, (-1e9, 1e9))
        if not (isfinite(values[name]) and low <= values[name] <= high):
            faults.append(f"{name} = {shown(text)} is no number from {low:g} to {high:g}; correct it")
    if faults:
        return faults, None
    frame, turn = values["frame"], np.array([values[name] for name in COLUMNS[4:]])
    length = float(np.linalg.norm(turn))
    last = "up" if frames is None else f"to {frames - 1}"
    if frame != int(frame) or frame < 0 or (frames is not None and frame >= frames):
        faults.append(f"frame = {frame:g} is not a whole number from 0 {last}; count the frames from 0")
    if abs(length - 1.0) > UNIT_TOLERANCE:
        faults.append(f"the quaternion's length is {length:.3g}, not 1; give qw,qx,qy,qz of a rotation")
    if faults:
        return faults, None
    matrix = np.eye(4)
    # qw comes last there
    matrix[:3, :3], matrix[:3, 3] = from_quaternion(np.roll(turn, -1)), [values[name] for name in COLUMNS[1:4]]
    return [], ArmPose(frame=int(frame), flange_to_base=matrix, sigma_mm=values["sigma_mm"], sigma_deg=values["sigma_deg"])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandEyeFile:
    """A file of `calibrate --hand-eye`: both transforms, (4, 4), mm, and the tape's name."""

    tape: str
    sensor_to_flange: FloatArray
    tape_to_base: FloatArray


def read_hand_eye(path: str | Path) -> HandEyeFile:
    """A file `…-hand-eye.json`.

    Raises SpecError if it cannot be read, is of another format, or a transform is no rotation with a place.
    """
    key = "hand_eye"
    data = _bytes_of(path, key, "give the -hand-eye.json that calibrate wrote")
    try:
        content = parse_json(data)
    except ValueError:
        content = None
    if not isinstance(content, dict) or content.get("format") != HAND_EYE_FORMAT:
        raise SpecError(Problem(key, f"{key} = {shown_path(path)} is no {HAND_EYE_FORMAT}; give the file that calibrate wrote"))
    table = Fields(content)
    tape = table.text("tape")
    on_flange, in_base = _transform(table, "sensor_to_flange"), _transform(table, "tape_to_base")
    if table.problems:
        raise SpecError([Problem(key, f"{key} = {shown_path(path)}: {p.message}") for p in table.problems])
    return HandEyeFile(tape=tape, sensor_to_flange=on_flange, tape_to_base=in_base)


def _transform(table: Fields, key: str) -> FloatArray:
    rows = table.rows(key, longest=4)
    numbers = Fields({f"{key}[{i}]": row for i, row in enumerate(rows)}, "", table.problems)
    matrix = np.array([numbers.numbers(f"{key}[{i}]", 4, low=-FARTHEST_MM, high=FARTHEST_MM, unit="") for i in range(4)])
    if np.isfinite(matrix).all() and not _is_pose(matrix):
        table.problem(key, f"{key} is no rotation and place; give the file as calibrate wrote it")
    return matrix


def tilt_deg(sensor: FloatArray) -> float:
    """How far a sensor's z axis is from straight down, for its pose (4, 4) in a frame whose z is up from the tape."""
    return degrees(float(np.arccos(np.clip(-sensor[2, 2], -1.0, 1.0))))
