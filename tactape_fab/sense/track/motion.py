"""Motion model of a tracker: how far a contact may move between frames, and which motion counts as slip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import hypot, radians, sqrt
from typing import Literal

import numpy as np

from tactape_fab.base.errors import SpecError
from tactape_fab.base.fields import Fields
from tactape_fab.sense.decode.result import Localization
from tactape_fab.sense.decode.search.search import MOST_RADIUS_MM, Prior
from tactape_fab.texture.frames import FloatArray

EventKind = Literal["begin", "end", "lost", "regained", "jump", "slip"]
LINE_FIXES = 4
"""Number of fixes to which constant velocity is fitted."""
LINE_S = 0.5
"""Age, s, above which fixes are not used for the velocity."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Limits of a contact's motion on a tape, and of a change of pose.

    A place is searched first within ``radius_mm + speed_mm_s * gap`` of the constant-velocity prediction, and
    ``angle_deg + turn_deg_s * gap``, with the gap since the last fix; beyond ``reach_mm`` there is no prediction.

    Attributes
    ----------
    radius_mm, angle_deg : float
        Error of a prediction at gap 0.
    speed_mm_s, turn_deg_s : float
        Growth of it per second: about the largest speed on the tape.
    reach_mm : float
        Largest radius; a prior that would need more is dropped.
    slip_sigmas : float
        Least Mahalanobis distance of two poses that counts as a change: 6 occurs once in 10^7 for normal errors.
    floor_mm, floor_deg : float
        Standard deviation of the change between two frames of a contact at rest that no covariance contains.
    patience : int
        Number of frames without a sign of a tape after which a contact has ended.

    Raises
    ------
    SpecError
        If values are out of range, all of them together.
    """

    radius_mm: float = 1.5
    angle_deg: float = 6.0
    speed_mm_s: float = 50.0
    turn_deg_s: float = 200.0
    reach_mm: float = 20.0
    slip_sigmas: float = 6.0
    floor_mm: float = 0.01
    floor_deg: float = 0.05
    patience: int = 3

    def __post_init__(self) -> None:
        table = Fields({f.name: getattr(self, f.name) for f in fields(self)})
        table.number("radius_mm", above=0.0, high=MOST_RADIUS_MM)
        table.number("angle_deg", above=0.0, high=360.0, unit="deg")
        table.number("speed_mm_s", low=0.0, high=1e5, unit="mm/s")
        table.number("turn_deg_s", low=0.0, high=1e5, unit="deg/s")
        table.number("reach_mm", above=0.0, high=MOST_RADIUS_MM)
        table.number("slip_sigmas", low=1.0, high=1000.0, unit="")
        table.number("floor_mm", low=0.0, high=10.0)
        table.number("floor_deg", low=0.0, high=90.0, unit="deg")
        table.integer("patience", low=1, high=10_000)
        if table.problems:
            raise SpecError(table.problems)


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """A change of a contact's state.

    Attributes
    ----------
    kind : str
        "begin", "end": the contact begins, or has ended; "lost", "regained": the contact continues, but its place is no longer,
        or again, located; "jump": it is located out of reach of any motion; "slip": its pose has changed.
    timestamp : float
        Seconds, of the frame that showed it; of "end", of the last frame that showed the tape.
    """

    kind: EventKind
    timestamp: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Slip:
    """Change of pose within one contact, relative to its reference pose: that of the first fixes, or of the last slip.

    Attributes
    ----------
    detected : bool
        Whether it is more than the two fixes' errors explain.
    shift_mm : (float, float)
        Of ``position_mm``, texture frame.
    turn_deg : float
    sigmas : float
        Mahalanobis distance of the two poses.
    since : float
        Time of the reference pose, s.
    total_mm : (float, float)
    total_deg : float
        The same since the contact began.
    """

    detected: bool
    shift_mm: tuple[float, float]
    turn_deg: float
    sigmas: float
    since: float
    total_mm: tuple[float, float]
    total_deg: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pose:
    """A located fix as numbers: (x mm, y mm, theta rad), with its covariance."""

    timestamp: float
    tape: str
    at: FloatArray
    covariance: FloatArray


def pose_of(fix: Localization, timestamp: float) -> Pose | None:
    """The pose of a fix; None if it has none."""
    if not fix.located or fix.position_mm is None or fix.theta_deg is None or fix.tape is None or fix.covariance is None:
        return None
    at = np.array([*fix.position_mm, radians(fix.theta_deg)])
    return Pose(timestamp=timestamp, tape=fix.tape, at=at, covariance=fix.covariance)


def difference(new: FloatArray, old: FloatArray) -> FloatArray:
    """Difference of two poses, the angle wrapped to half a turn."""
    out: FloatArray = new - old
    out[2] = (out[2] + np.pi) % (2 * np.pi) - np.pi
    return out


def velocity_of(line: Sequence[Pose], motion: Motion) -> FloatArray:
    """Velocity (mm/s, mm/s, rad/s) fitted to the last fixes, limited to the motion's speed; zero for a single fix."""
    recent = [pose for pose in line if line[-1].timestamp - pose.timestamp <= LINE_S]
    if len(recent) < 2:
        return np.zeros(3)
    time = np.array([pose.timestamp for pose in recent])
    at = np.array([difference(pose.at, line[-1].at) for pose in recent])
    time -= time.mean()
    slope: FloatArray = time @ (at - at.mean(axis=0)) / (time @ time)
    speed = hypot(float(slope[0]), float(slope[1]))
    slope[:2] *= min(1.0, motion.speed_mm_s / speed) if speed > 0.0 else 1.0
    slope[2] = np.clip(slope[2], -radians(motion.turn_deg_s), radians(motion.turn_deg_s))
    return slope


def predicted(line: Sequence[Pose], velocity: FloatArray, timestamp: float, motion: Motion) -> Prior | None:
    """Predicted region of the contact at some time; None if the last fix is too old."""
    if not line:
        return None
    last = line[-1]
    gap = timestamp - last.timestamp
    radius_mm = motion.radius_mm + motion.speed_mm_s * gap
    if radius_mm > motion.reach_mm:
        return None
    x, y, theta = (last.at + velocity * gap).tolist()
    return Prior(
        position_mm=(x, y),
        theta_deg=(float(np.degrees(theta)) + 180.0) % 360.0 - 180.0,
        radius_mm=radius_mm,
        angle_deg=min(motion.angle_deg + motion.turn_deg_s * gap, 360.0),
        tape=last.tape,
    )


def within(pose: Pose, prior: Prior) -> bool:
    """Whether a pose lies in its predicted region."""
    off = difference(pose.at, np.array([*prior.position_mm, radians(prior.theta_deg)]))
    near = hypot(float(off[0]), float(off[1])) <= prior.radius_mm and abs(off[2]) <= radians(prior.angle_deg)
    return near and prior.tape in (None, pose.tape)


def mean_pose(poses: Sequence[Pose]) -> Pose:
    """The mean of some poses of a contact at rest, with the time of the first."""
    first = poses[0]
    at = first.at + np.mean([difference(pose.at, first.at) for pose in poses], axis=0)
    covariance: FloatArray = np.sum([pose.covariance for pose in poses], axis=0) / len(poses) ** 2
    return Pose(timestamp=first.timestamp, tape=first.tape, at=at, covariance=covariance)


def slip_of(pose: Pose, anchor: Pose, began: Pose, motion: Motion) -> Slip:
    """Change of a pose relative to its reference pose."""
    shift, total = difference(pose.at, anchor.at), difference(pose.at, began.at)
    floor = np.diag([motion.floor_mm**2, motion.floor_mm**2, radians(motion.floor_deg) ** 2])
    spread = pose.covariance + anchor.covariance + floor + 1e-18 * np.eye(3)
    sigmas = sqrt(max(float(shift @ np.linalg.solve(spread, shift)), 0.0))
    return Slip(
        detected=sigmas > motion.slip_sigmas,
        shift_mm=(float(shift[0]), float(shift[1])),
        turn_deg=float(np.degrees(shift[2])),
        sigmas=sigmas,
        since=anchor.timestamp,
        total_mm=(float(total[0]), float(total[1])),
        total_deg=float(np.degrees(total[2])),
    )
