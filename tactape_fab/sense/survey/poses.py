"""Poses of the sensor by a robot, from a CSV file."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown, shown_path

COLUMNS = ("frame", "x_mm", "y_mm", "theta_deg")
OPTIONAL = {"sigma_mm": 0.02, "sigma_deg": 0.05}
"""Columns that may be left out, and what is taken then: a good arm's repeatability."""
MOST_BYTES, MOST_ROWS, MOST_PROBLEMS = 10_000_000, 100_000, 20
_RANGES = {
    "x_mm": (-1e5, 1e5),
    "y_mm": (-1e5, 1e5),
    "theta_deg": (-1e5, 1e5),
    "sigma_mm": (1e-4, 100.0),
    "sigma_deg": (1e-4, 180.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotPose:
    """Pose of the sensor at a frame, in a frame of the robot's that lies flat on the tape: seen from above x right, y up.

    Attributes
    ----------
    frame : int
        Counted over all frames from 0.
    x_mm, y_mm : float
        The sensor's image centre.
    theta_deg : float
        Its turn, counter-clockwise seen from above.
    sigma_mm, sigma_deg : float
        Standard deviations.
    """

    frame: int
    x_mm: float
    y_mm: float
    theta_deg: float
    sigma_mm: float
    sigma_deg: float


def read_poses(path: str | Path) -> list[RobotPose]:
    """Read a CSV with the columns frame, x_mm, y_mm, theta_deg, and sigma_mm, sigma_deg if they are there.

    Raises
    ------
    SpecError
        With every row that cannot be read, twenty at most.
    """
    try:
        with Path(path).open("rb") as stream:
            data = stream.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SpecError(Problem("poses", f"poses = {shown_path(path)} cannot be opened: {reason}; give a CSV file")) from error
    if len(data) > MOST_BYTES:
        raise SpecError(Problem("poses", f"poses = {shown_path(path)} is larger than {MOST_BYTES} bytes; give a row a frame"))
    rows = csv.reader(io.StringIO(data.decode("utf-8-sig", errors="replace")))
    problems: list[Problem] = []
    found: dict[int, RobotPose] = {}
    try:
        names = [name.strip() for name in next(rows, [])]
        if not set(COLUMNS) <= set(names) or not set(names) <= {*COLUMNS, *OPTIONAL} or len(set(names)) < len(names):
            message = (
                f"poses = {shown_path(path)} begins with {shown(','.join(names))}; its first line must be {','.join(COLUMNS)}"
            )
            raise SpecError(Problem("poses", f"{message}, and may go on with {','.join(OPTIONAL)}"))
        for number, row in enumerate(rows, start=2):
            if not row:
                continue
            if len(found) >= MOST_ROWS or len(problems) >= MOST_PROBLEMS:
                break
            pose = _pose(dict(zip(names, row, strict=False)), len(row) == len(names), number, problems)
            if pose is not None and pose.frame in found:
                problems.append(Problem("poses", f"poses line {number}: frame {pose.frame} is there twice; leave one out"))
            elif pose is not None:
                found[pose.frame] = pose
    except csv.Error as error:
        problems.append(Problem("poses", f"poses = {shown_path(path)} is no CSV: {error}"))
    if not found and not problems:
        problems.append(Problem("poses", f"poses = {shown_path(path)} has no row; give a row a frame, or leave out --poses"))
    if problems:
        raise SpecError(problems)
    return list(found.values())


def _pose(row: dict[str, str], whole: bool, line: int, problems: list[Problem]) -> RobotPose | None:
    """A row's pose; None, and the problem is kept, where it has none."""
    before = len(problems)
    values: dict[str, float] = dict(OPTIONAL)
    for name in (*COLUMNS, *OPTIONAL):
        if name not in row and name in OPTIONAL:
            continue
        try:
            values[name] = float(row[name])
        except (KeyError, ValueError):
            values[name] = float("nan")
        low, high = _RANGES.get(name, (0.0, 1e9))
        if not (isfinite(values[name]) and low <= values[name] <= high):
            said = shown(row.get(name, ""))
            problems.append(
                Problem("poses", f"poses line {line}: {name} = {said} is no number from {low:g} to {high:g}; correct it")
            )
    if not whole or values["frame"] != int(values["frame"] if isfinite(values["frame"]) else 0):
        problems.append(Problem("poses", f"poses line {line}: it is no whole frame number with one value a column; correct it"))
    if len(problems) > before:
        return None
    return RobotPose(frame=int(values.pop("frame")), **values)
