"""Motion model of a tracker: how far a contact may move between frames, and which motion counts as slip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import hypot, radians, sqrt
from typing import Literal

import numpy as np

from tactape_fab.base.errors import refuse
from tactape_fab.base.fields import Fields
from tactape_fab.sense.decode.result import Localization, tape_named
from tactape_fab.sense.decode.search.prior import MOST_RADIUS_MM, Prior
from tactape_fab.sense.track.change import Change
from tactape_fab.texture.frames import FloatArray, pair_of

EventKind = Literal["begin", "end", "lost", "regained", "jump", "slip"]
Cause = Literal["slip", "shear"]
LINE_FIXES = 4
"""Number of fixes to which constant velocity is fitted."""
LINE_S = 0.5
"""Age, s, above which fixes are not used for the velocity."""
_LEAST_SPREAD_S2 = 1e-18
"""Sum of squared times from their mean, s^2, below which fixes count as simultaneous and give no velocity."""


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
    floor_strain : float
        The same of a change of scale, aspect or shear of what is seen.
    shear_mm : float or None
        Largest shift of the tape that a gel which sticks to it can follow by its shear: about its thickness times coefficient of
        friction times mean pressure over shear modulus. None: unknown, and `Slip.cause` is never "slip".
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
    floor_strain: float = 0.002
    shear_mm: float | None = None
    patience: int = 3

    def __post_init__(self) -> None:
        table = Fields({f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) is not None})
        table.number("radius_mm", above=0.0, high=MOST_RADIUS_MM)
        table.number("angle_deg", above=0.0, high=360.0, unit="deg")
        table.number("speed_mm_s", low=0.0, high=1e5, unit="mm/s")
        table.number("turn_deg_s", low=0.0, high=1e5, unit="deg/s")
        table.number("reach_mm", above=0.0, high=MOST_RADIUS_MM)
        table.number("slip_sigmas", low=1.0, high=1000.0, unit="")
        table.number("floor_mm", low=0.0, high=10.0)
        table.number("floor_deg", low=0.0, high=90.0, unit="deg")
        table.number("floor_strain", low=0.0, high=1.0, unit="")
        if self.shear_mm is not None:
            table.number("shear_mm", above=0.0, high=100.0)
        table.integer("patience", low=1, high=10_000)
        refuse(table.problems)


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

    It is taken from the dots that the frames have in common, so that errors which they share (the camera, places of parts) go out
    of it; from the two poses where `dots` is 0.

    Attributes
    ----------
    detected : bool
        Whether it is more than the frames' errors explain.
    shift_mm : (float, float)
        Of ``position_mm``, texture frame.
    turn_deg : float
    sigmas : float
        Mahalanobis distance of the two poses.
    cause : {"slip", "shear"} or None
        "slip": the tape has moved farther than the gel can follow by its shear (`Motion.shear_mm`), so it slid. "shear": scale,
        aspect or shear of what is seen has changed, which a rigid tape that slides does not do: the gel carries the image along
        and is deformed, so it sticks at least in part. None: nothing has changed, or frames without markers do not tell which it
        is; a gel that is sheared evenly looks as a tape that slides.
    strain, strain_sigma : (float, float) or None
        Change of aspect and shear of what is seen, in the terms of `Localization.strain`, and standard deviations; None where
        `dots` is 0. The camera's own aspect and shear are in both frames and cancel.
    dots : int
        Dots that the frames have in common.
    since : float
        Time of the reference pose, s.
    total_mm : (float, float)
    total_deg : float
        The same since the contact began, the angle from -180 to 180: whole turns are not counted.
    """

    detected: bool
    shift_mm: tuple[float, float]
    turn_deg: float
    sigmas: float
    since: float
    total_mm: tuple[float, float]
    total_deg: float
    cause: Cause | None = None
    strain: tuple[float, float] | None = None
    strain_sigma: tuple[float, float] | None = None
    dots: int = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pose:
    """A located fix as numbers: (x mm, y mm, theta rad), with its covariance; and the fix.

    which: Sector and origin of the tape: another tape may have the same name.
    """

    timestamp: float
    tape: str
    at: FloatArray
    covariance: FloatArray
    fix: Localization | None = None
    which: tuple[int | None, tuple[int, int] | None] = (None, None)


def pose_of(fix: Localization, timestamp: float) -> Pose | None:
    """The pose of a fix; None if it has none."""
    if not fix.located or fix.position_mm is None or fix.theta_deg is None or fix.tape is None or fix.covariance is None:
        return None
    at = np.array([*fix.position_mm, radians(fix.theta_deg)])
    covariance = fix.covariance.copy()  # the fix is the caller's, who may change its array, as to other units
    return Pose(timestamp=timestamp, tape=fix.tape, at=at, covariance=covariance, fix=fix, which=tape_named(fix)[1:])


def difference(new: FloatArray, old: FloatArray) -> FloatArray:
    """Difference of two poses, the angle wrapped to half a turn."""
    out: FloatArray = new - old
    # x and y have no period
    out[2] = (out[2] + np.pi) % (2 * np.pi) - np.pi
    return out


def velocity_of(line: Sequence[Pose]) -> FloatArray | None:
    """Velocity (mm/s, mm/s, rad/s) fitted to the last fixes; None where fewer than two are recent, or all are of one time."""
    recent = [pose for pose in line if line[-1].timestamp - pose.timestamp <= LINE_S]
    if len(recent) < 2:
        return None
    time = np.array([pose.timestamp for pose in recent])
    # from the last fix, so that a turn past 180 degrees does not break the line
    at = np.array([difference(pose.at, line[-1].at) for pose in recent])
    time -= time.mean()
    spread = float(time @ time)
    if spread < _LEAST_SPREAD_S2:
        return None
    # least squares: sum (t - mean) (x - mean) / sum (t - mean)^2
    slope: FloatArray = time @ (at - at.mean(axis=0)) / spread
    return slope


def predicted(line: Sequence[Pose], velocity: FloatArray | None, timestamp: float, motion: Motion) -> Prior | None:
    """Predicted region of the contact at some time; None if the last fix is too old."""
    if not line:
        return None
    last = line[-1]
    gap = timestamp - last.timestamp
    radius_mm = motion.radius_mm + motion.speed_mm_s * gap
    if radius_mm > motion.reach_mm:
        return None
    rate = np.zeros(3) if velocity is None else velocity.copy()
    speed = hypot(float(rate[0]), float(rate[1]))
    # two fixes a moment apart give any speed: their errors over a short time
    rate[:2] *= min(1.0, motion.speed_mm_s / speed) if speed > 0.0 else 1.0
    rate[2] = np.clip(rate[2], -radians(motion.turn_deg_s), radians(motion.turn_deg_s))
    x, y, theta = (last.at + rate * gap).tolist()
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
    # angles are averaged as differences from the first: -179 and 179 degrees are 2 apart
    at = first.at + np.mean([difference(pose.at, first.at) for pose in poses], axis=0)
    covariance: FloatArray = np.sum([pose.covariance for pose in poses], axis=0) / len(poses) ** 2
    return Pose(timestamp=first.timestamp, tape=first.tape, at=at, covariance=covariance)


def slip_of(pose: Pose, anchor: Pose, began: Pose, motion: Motion, change: Change | None = None) -> Slip:
    """Change of a pose relative to its reference pose, from the dots in common, or else from the two poses."""
    shift, total = difference(pose.at, anchor.at), difference(pose.at, began.at)
    spread = pose.covariance + anchor.covariance
    if change is not None:
        shift, spread = change.shift, change.covariance
    # the more dots, the smaller the covariances, and the sooner unmodelled errors would look like a slip of a contact at rest
    floor = np.diag([motion.floor_mm**2, motion.floor_mm**2, radians(motion.floor_deg) ** 2])
    sigmas = _distance(shift, spread + floor)
    detected = sigmas > motion.slip_sigmas
    strain = strain_sigma = None
    if change is not None:
        strain_covariance = change.strain_covariance + motion.floor_strain**2 * np.eye(3)
        strain, strain_sigma = pair_of(change.strain[1:]), pair_of(np.sqrt(strain_covariance.diagonal()[1:]))
    cause: Cause | None = None
    if detected and motion.shear_mm is not None and hypot(float(shift[0]), float(shift[1])) > motion.shear_mm:
        cause = "slip"
    # three components as for a pose: ln of the scale, aspect and shear
    elif change is not None and _distance(change.strain, strain_covariance) > motion.slip_sigmas:
        cause = "shear"
    return Slip(
        detected=detected,
        shift_mm=pair_of(shift),
        turn_deg=float(np.degrees(shift[2])),
        sigmas=sigmas,
        cause=cause,
        strain=strain,
        strain_sigma=strain_sigma,
        dots=0 if change is None else change.dots,
        since=anchor.timestamp,
        total_mm=pair_of(total),
        total_deg=float(np.degrees(total[2])),
    )


def _distance(off: FloatArray, covariance: FloatArray) -> float:
    """Mahalanobis distance."""
    # with all floors at 0 a covariance may be singular; 1e-18 is 1e-9 mm squared
    return sqrt(max(float(off @ np.linalg.solve(covariance + 1e-18 * np.eye(3), off)), 0.0))
