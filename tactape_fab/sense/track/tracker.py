"""Tracker: frames of one sensor in order; each is located with a prior from the last fix, and compared with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import degrees

import numpy.typing as npt

from tactape_fab.base.errors import FrameError, Problem, SpecError, refuse
from tactape_fab.base.fields import shown
from tactape_fab.base.given_value import as_real
from tactape_fab.sense.decode.localizer import Localizer
from tactape_fab.sense.decode.result import Localization
from tactape_fab.sense.decode.search.prior import Prior
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.sense.track.change import change_between
from tactape_fab.sense.track.motion import (
    LINE_FIXES,
    Event,
    EventKind,
    Motion,
    Pose,
    Slip,
    mean_pose,
    pose_of,
    predicted,
    slip_of,
    velocity_of,
    within,
)
from tactape_fab.texture.frames import FloatArray, pair_of

TOUCHES, TRACE = 0.05, 0.5
"""p_tape below which a frame that is not located shows a registered tape, and below which a contact continues."""
ANCHOR_FIXES = 3
"""Number of fixes whose mean is the reference pose."""
STILL_FIXES = 3
"""Number of consecutive fixes without slip after which the next slip is a new event."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Answer of a tracker for one frame.

    Attributes
    ----------
    timestamp : float
    fix : Localization
        The localizer's own answer to this frame, also if the contact is lost; never replaced by a prediction.
    prediction : Prior or None
        Predicted region of the contact before the frame, given to the localizer as prior. None if there was
        no prediction.
    contact : bool
        Whether a registered tape is touched.
    lost : bool
        Whether a tape is touched and not located.
    events : tuple of Event
        In the order in which they happened.
    slip : Slip or None
        None if the frame is not located.
    velocity_mm_s : (float, float) or None
        Velocity of ``position_mm``, from the fixes of the last half second, four at most; None if the frame is not located, or
        no other fix of the contact is so recent.
    turn_deg_s : float or None
    """

    timestamp: float
    fix: Localization
    prediction: Prior | None
    contact: bool
    lost: bool
    events: tuple[Event, ...]
    slip: Slip | None
    velocity_mm_s: tuple[float, float] | None
    turn_deg_s: float | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _State:
    """State before a frame; ``line`` holds the last fixes, ``anchor`` those of the reference pose for slip."""

    timestamp: float | None = None
    contact: bool = False
    lost: bool = False
    touched: float = 0.0
    silent: int = 0
    still: int = 0
    slipping: bool = False
    line: tuple[Pose, ...] = ()
    velocity: FloatArray | None = None
    anchor: tuple[Pose, ...] = ()
    began: Pose | None = None


_NOTHING = _State()


class Tracker:
    """Tracker of the contact of one sensor.

    Each frame is located with the last fix as a `Prior`: half of the weight of all registered places goes to those near
    the prediction, the other half is spread over all places. Properties of a located fix:

    - `p_tape` stays a bound for any wrong prediction, because the prediction was made before the frame was read.
    - The answer leads over every single other place by the localizer's `kappa` without any prior.
    - `p_place` weighs places by the prior. It bounds the chance of a wrong place as long as the contact really is near the
      prediction at least every other time that there is one.

    Where the contact is not located, the region grows with the time since the last fix, until there is no prediction.

    Parameters
    ----------
    localizer : Localizer
        Localizer of registered tapes, with method "ml"; its sensor is the one whose frames are given.
    motion : Motion, optional
        Limits of the motion of contacts.

    Raises
    ------
    SpecError
        If the localizer cannot use a prior.
    """

    def __init__(self, localizer: Localizer, motion: Motion | None = None) -> None:
        problems = []
        located: object = localizer
        moving: object = motion
        if not isinstance(located, Localizer):
            message = f"localizer = {shown(located)} is no Localizer; give Tracker(Localizer(KIT))"
            problems.append(Problem("localizer", message))
        if not isinstance(moving, Motion | None):
            problems.append(Problem("motion", f"motion = {shown(moving)} is no Motion; give one, or leave it out"))
        refuse(problems)
        if not localizer.takes_prior:
            message = "this localizer takes no prior (method 'paper', or a code without tapes); register tapes with method 'ml'"
            raise SpecError(Problem("localizer", message))
        self.localizer = localizer
        self.motion = motion or Motion()
        self._state = _NOTHING

    def reset(self) -> None:
        """Reset the state, such as before frames of another recording."""
        self._state = _NOTHING

    def update(self, depth: npt.ArrayLike, timestamp: float) -> Track:
        """Locate the next frame.

        Parameters
        ----------
        depth : array_like, shape (h, w)
            As `Localizer.locate` takes it.
        timestamp : float
            Seconds, when the frame was captured; later than the one before.

        Returns
        -------
        Track

        Raises
        ------
        FrameError
            If it is not a depth map of this sensor, or its time is not after the previous one; the state is unchanged.
        """
        timestamp, prior = self._expected(timestamp)
        return self._follow(self.localizer.locate(depth, prior=prior, timestamp=timestamp), prior, timestamp)

    def update_dots(self, xy_px: npt.ArrayLike, weights: npt.ArrayLike | None = None, *, timestamp: float) -> Track:
        """Locate the next frame from dots that were detected elsewhere; raises the same as `update`.

        Parameters
        ----------
        xy_px : array_like, shape (n, 2)
            Centres (u, v) in the canonical image, px.
        weights : array_like, shape (n,), optional
            As `Localizer.locate_dots` takes them.
        timestamp : float
            Seconds, as for `update`.

        Returns
        -------
        Track
        """
        timestamp, prior = self._expected(timestamp)
        fix = self.localizer.locate_dots(xy_px, weights, prior=prior, timestamp=timestamp)
        return self._follow(fix, prior, timestamp)

    def _expected(self, given: float) -> tuple[float, Prior | None]:
        """A frame's time as Python's own number, and the prior at that time."""
        last = self._state.timestamp
        try:
            timestamp = as_real(given, "timestamp", "time", "seconds")
        except SpecError as error:
            raise FrameError(str(error)) from None
        if not abs(timestamp) < 1e300:
            raise FrameError(f"timestamp = {shown(given)} is no time; give seconds")
        if last is not None and timestamp <= last:
            raise FrameError(f"timestamp = {timestamp} s is not after {last} s; give frames in their order, or reset the tracker")
        return timestamp, predicted(self._state.line, self._state.velocity, timestamp, self.motion)

    def _follow(self, fix: Localization, prior: Prior | None, timestamp: float) -> Track:
        self._state, track = followed(self._state, fix, prior, timestamp, self.motion, self.localizer.sensor)
        return track


def followed(
    state: _State, fix: Localization, prior: Prior | None, timestamp: float, motion: Motion, sensor: SensorProfile
) -> tuple[_State, Track]:
    """State after a frame, and the answer for it."""
    pose, before = pose_of(fix, timestamp), state
    state, events = _contact(replace(state, timestamp=timestamp), fix, pose is not None, timestamp, motion)
    slip = None
    if pose is not None:
        if _jumped(before, pose, prior):
            events = (*events, "jump")
            state = replace(state, began=None, anchor=(), still=0, slipping=False)
        state, slip, slipped = _moved(state, pose, motion, sensor)
        if slipped:
            events = (*events, "slip")
    velocity = None if pose is None else state.velocity
    return state, Track(
        timestamp=timestamp,
        fix=fix,
        prediction=prior,
        contact=state.contact,
        lost=state.lost,
        events=tuple(Event(kind=kind, timestamp=before.touched if kind == "end" else timestamp) for kind in events),
        slip=slip,
        velocity_mm_s=None if velocity is None else pair_of(velocity),
        turn_deg_s=None if velocity is None else degrees(velocity[2]),
    )


def _contact(
    state: _State, fix: Localization, located: bool, timestamp: float, motion: Motion
) -> tuple[_State, tuple[EventKind, ...]]:
    """Whether a tape is touched, and located."""
    p_tape = 1.0 if fix.p_tape is None else fix.p_tape
    # two thresholds: a frame between them keeps a contact, and begins none, so that noise does not make it come and go
    if located or p_tape <= (TRACE if state.contact else TOUCHES):
        events: tuple[EventKind, ...] = () if state.contact else ("begin",)
        # located after lost, or lost after located; of a contact that was never located neither is said
        if located == state.lost and state.began is not None:
            events = (*events, "regained" if located else "lost")
        return replace(state, contact=True, lost=not located, touched=timestamp, silent=0), events
    if not state.contact:
        return state, ()
    # a frame or two without a sign may be a bad frame
    if state.silent + 1 < motion.patience:
        return replace(state, silent=state.silent + 1, lost=True), ("lost",) if state.began is not None and not state.lost else ()
    # a new contact inherits nothing from the last one: neither its velocity nor a slide at its end
    ended = replace(state, contact=False, lost=False, silent=0, still=0, slipping=False)
    return replace(ended, velocity=None, anchor=(), began=None), ("end",)


def _jumped(before: _State, pose: Pose, prior: Prior | None) -> bool:
    """Whether a pose is out of reach of any motion within the contact."""
    if before.began is None:
        return False
    last = before.line[-1]
    return (pose.tape, pose.which) != (last.tape, last.which) or (prior is not None and not within(pose, prior))


def _moved(state: _State, pose: Pose, motion: Motion, sensor: SensorProfile) -> tuple[_State, Slip, bool]:
    """State with one more fix, its slip, and whether that slip is new."""
    # after a jump or a new contact the old fixes do not tell the velocity
    line = (*(() if state.began is None else state.line), pose)[-LINE_FIXES:]
    began = state.began or pose
    anchor = state.anchor or (pose,)
    first = anchor[0].fix
    # dots in common are those of one frame: the first of the reference, though its pose is the mean of some
    change = None if first is None or pose.fix is None or pose is anchor[0] else change_between(first, pose.fix, sensor)
    slip = slip_of(pose, mean_pose(anchor), began, motion, change)
    if slip.detected:
        anchor, still = (pose,), 0
    else:
        # the first few fixes of a rest make the reference, which then stays: a running mean would follow a slow slide
        anchor, still = (anchor if not state.anchor else (*anchor, pose)[:ANCHOR_FIXES]), state.still + 1
    # a slide over many frames is one event, until the contact rests
    slipping = slip.detected or (state.slipping and still < STILL_FIXES)
    after = replace(state, line=line, velocity=velocity_of(line), began=began, anchor=anchor)
    return replace(after, still=still, slipping=slipping), slip, slip.detected and not state.slipping
