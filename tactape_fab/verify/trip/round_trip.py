"""Round trip: depth maps of contacts with parts at the places of a written file are simulated, decoded and compared.

`quick_trip` decodes by the paper's method, which needs no compilation. `full_trips` uses `Localizer`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, inf, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from tactape_fab.base.errors import Check, Problem, SpecError, tried
from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.sense.sensors import SensorProfile, load_sensor
from tactape_fab.sense.simulation.dot_errors import dots_of
from tactape_fab.sense.simulation.draw import Frame, frame_at, iterate_frames
from tactape_fab.sense.simulation.drawn_poses import draw_poses
from tactape_fab.sense.simulation.gel import FloatImage
from tactape_fab.sense.simulation.parts import built_parts_of
from tactape_fab.sense.simulation.scene import Scene
from tactape_fab.texture.as_built_file import AS_BUILT_NAME
from tactape_fab.texture.code import get_code
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.trip.misplaced import explain
from tactape_fab.verify.trip.positions import Source
from tactape_fab.verify.trip.visible_parts import ERROR_FREE, in_place, parts_shown

if TYPE_CHECKING:
    from tactape_fab.sense.decode.result import Localization

Progress = Callable[[str, int, int], None]
Locate = Callable[[FloatImage], "Localization"]
OutcomeOfMiss = Callable[[int, FloatArray], int]

RIGHT, LIMITED, NOISY, BARELY, MISSED, LOST, WRONG = range(7)
"""Outcome of a contact. RIGHT: located at its place. WRONG: located elsewhere. Others are not located. LIMITED: error-free
symbols would not suffice. NOISY: symbols with the sensor's noise would not suffice. BARELY: these suffice only without a margin,
or if it is known which lower tops are parts. MISSED: they suffice, so the decoder missed it. LOST: the same, with parts misplaced
in the file.
"""

INSIDE, EDGE = 96, 48
"""Number of contacts of the full round trip, divided among the sources: entirely on the field, and across its edge."""
MANY_SECTORS, FEWER = 1000, 4
"""A code with more than `MANY_SECTORS`, with all of which each contact is compared, gets fewer contacts by the factor `FEWER`."""
QUICK = 6
MEASURED, SEEN_MM = 24, 0.02
"""Number of contacts with parts at measured places, and the scatter from which measured places must give better answers."""

_SEED = 0
_STEP = "round trip: contact"
_RIGHT_PITCHES, _RIGHT_DEG = 0.25, 10.0
_QUICK_TOLERATED = 0.34
"""Tolerated fraction of failures of the paper's method, which has no error bound and misses contacts, mostly on narrow tapes."""
_QUICK_PITCH_PX = 24.0
_QUICK_MARGIN = 2
"""Grid points beyond a window in the field of view of the quick round trip's sensor."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trip:
    """Contacts with the parts of one source, and their outcomes.

    poses (n, 3): x mm, y mm (texture frame), theta deg.
    outcome (n,): RIGHT, LIMITED, NOISY, BARELY, MISSED, LOST or WRONG.
    error_um (n,): Distance from the true position; NaN where nothing was located.
    reasons: Reasons why contacts were not located.
    tolerated: Fraction of the contacts that may be LOST or WRONG: 0 for a decoder that bounds its errors.
    """

    source: str
    poses: FloatArray
    outcome: IntArray
    error_um: FloatArray
    reasons: Counter[str]
    tolerated: float = 0.0

    def count(self, outcome: int) -> int:
        """Number of contacts of an outcome, such as `RIGHT`."""
        return int((self.outcome == outcome).sum())

    @property
    def failed(self) -> bool:
        """Whether more contacts were LOST, or more WRONG, than are tolerated."""
        most = self.tolerated * len(self.outcome)
        return self.count(WRONG) > most or self.count(LOST) > most


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contact:
    """Settings of contacts: the sensor, and the scene with the size of the contact."""

    sensor: SensorProfile
    scene: Scene


def read_contact(sensor: str = DEFAULT_SENSOR, size: object = None) -> Contact:
    """Build a contact from a user's values.

    Parameters
    ----------
    sensor : str
        Profile name or the path of its TOML file.
    size : (float, float) or "pad", optional
        Axes of an ellipse, mm, or the whole field; default 11 x 9 mm.

    Raises
    ------
    SpecError
        With every invalid value.
    """
    problems: list[Problem] = []
    options: dict[str, Any] = {} if size is None else {"contact": "pad"} if size == "pad" else {"contact_mm": size}
    profile, scene = tried(lambda: load_sensor(sensor), problems), tried(lambda: Scene(**options), problems)
    if profile is None or scene is None:
        raise SpecError(problems)
    return Contact(sensor=profile, scene=scene)


def quick_trip(tape: Tape, source: Source) -> Trip:
    """A few contacts, decoded by the paper's method with a sensor that sees a whole window at any angle.

    That method cannot read designed codes, whose windows have no decoding rule: these contacts are decoded with all their dots.
    """
    # 24 px per pitch for every tape, as the constants of the paper's method are in pixels
    px_per_mm = _QUICK_PITCH_PX / tape.pitch_mm
    # a square that contains a window with its margin at 45 deg, the worst case
    side_px = ceil(sqrt(2) * (get_code(tape.code).window + _QUICK_MARGIN) * _QUICK_PITCH_PX)
    sensor = SensorProfile(name="quick", title="", width_px=side_px, height_px=side_px, px_per_mm=(px_per_mm, px_per_mm))
    scene = Scene(contact="pad", noise=0.0, dome_mm=0.0)  # without a dome the board's edge leaves no imprint
    locate, locate_dots = _quick_methods(tape, sensor)

    def outcome_of_miss(_: int, pose: FloatArray) -> int:
        xy_px = dots_of(tape, pose.tolist(), scene, _SEED, ERROR_FREE, sensor=sensor).xy_px
        # the same pose with error-free dots at the manifest's places: if these cannot be located, the file is not at fault
        return LOST if locate_dots(xy_px).located else LIMITED

    poses = draw_poses(tape, QUICK, _SEED, sensor, scene)
    trip = replace(_trip(tape, source, poses, sensor, scene, locate, outcome_of_miss, lambda: None), tolerated=_QUICK_TOLERATED)
    if trip.failed and explain(tape, source.parts.xy_mm) is None:  # parts are in place: a limitation of the method
        return replace(trip, tolerated=1.0)
    return trip


def _quick_methods(tape: Tape, sensor: SensorProfile) -> tuple[Locate, Callable[[FloatArray], Localization]]:
    """Functions that locate a depth map, and dots, in a quick trip."""
    if get_code(tape.code).plane is None:
        from tactape_fab.sense.decode.localizer import Localizer

        localizer = Localizer([tape], sensor, world="closed")
        return localizer.locate, localizer.locate_dots
    from tactape_fab.sense.decode.paper import locate_paper, locate_paper_dots

    size, px_per_mm = (float(sensor.width_px), float(sensor.height_px)), sensor.px_per_mm[0]

    def locate(depth: FloatImage) -> Localization:
        return locate_paper(depth, [tape], px_per_mm=px_per_mm)[0]

    def locate_dots(xy_px: FloatArray) -> Localization:
        return locate_paper_dots(xy_px, [tape], size, px_per_mm=px_per_mm)[0]

    return locate, locate_dots


def full_trips(
    tape: Tape,
    sources: Sequence[Source],
    contact: Contact | None = None,
    progress: Progress = lambda *_: None,
    *,
    counts: tuple[int, int] = (INSIDE, EDGE),
) -> list[Trip]:
    """Contacts over the whole field and its edges, different for every source, decoded with all dots.

    tape: The manifest's tape.
    contact: Default: that of `read_contact`.
    progress: Called for every contact.
    counts: Contacts entirely on the field, and across its edge, for all sources together; fewer for a code with many sectors.
    """
    from tactape_fab.sense.decode.localizer import Localizer
    from tactape_fab.verify.trip.limit import MARGIN, as_seen, error_free, rule_of

    contact = contact or read_contact()
    sensor, scene = contact.sensor, contact.scene

    # the time per contact grows with the number of sectors
    fewer = FEWER if (plane := get_code(tape.code).plane) is not None and plane.sectors > MANY_SECTORS else 1
    each = [(max(n // fewer // len(sources), 1), edge) for n, edge in zip(counts, (False, True), strict=True)]
    # different poses for each source, so that together they cover the field more densely
    poses = [
        np.concatenate([draw_poses(tape, n, seed, sensor, scene, edge=edge) for n, edge in each]) for seed in range(len(sources))
    ]
    count, done = sum(map(len, poses)), 0
    progress(_STEP, done, count)  # before the Localizer, which compiles on its first use
    localizer = Localizer([tape], sensor)
    rule, stricter = rule_of(tape, sensor), rule_of(tape, sensor, MARGIN)

    def outcome_of_miss(source: Source, number: int, pose: FloatArray) -> int:
        # from the most favourable reader to the least: the first that fails gives the outcome
        if not error_free(rule, pose, scene).located:
            return LIMITED
        # the same noise as in the missed frame, with the parts of the tape instead of those of the file
        own = frame_at(tape, number, pose, _SEED, sensor, scene)
        if not as_seen(rule, pose, scene, own.depth, known_parts=True).located:
            return NOISY
        # with the margin, as the ideal reader's grid is fitted with known symbols (see `MARGIN`)
        if not as_seen(stricter, pose, scene, own.depth, known_parts=False).located:
            return BARELY
        return MISSED if in_place(tape, parts_shown(tape, pose, scene, sensor), source.parts) else LOST

    def step() -> None:
        nonlocal done
        done += 1
        progress(_STEP, done, count)

    return [
        _trip(tape, source, at, sensor, scene, localizer.locate, partial(outcome_of_miss, source), step)
        for source, at in zip(sources, poses, strict=True)
    ]


def check_measured(tape: Tape, contact: Contact | None = None) -> Check:
    """Check that contacts with parts at measured places are located at least as well with these places as with nominal ones.

    contact: Default: that of `read_contact`.
    """
    from tactape_fab.sense.decode.localizer import Localizer

    assert tape.as_built is not None
    contact = contact or read_contact()
    source = Source(name="as-built", parts=built_parts_of(tape))
    poses = draw_poses(tape, MEASURED, _SEED, contact.sensor, contact.scene)
    trips, p50_um, messages = [], [], []
    for places, known in (("the measured places", tape), ("the design's", replace(tape, as_built=None))):
        locate = Localizer([known], contact.sensor).locate
        trips.append(_trip(tape, source, poses, contact.sensor, contact.scene, locate, lambda *_: LIMITED, lambda: None))
        error_um = trips[-1].error_um[trips[-1].outcome == RIGHT]
        p50_um.append(float(np.median(error_um)) if len(error_um) else inf)
        wrong = f" and {trips[-1].count(WRONG)} elsewhere" if trips[-1].count(WRONG) else ""
        messages.append(f"by {places} {len(error_um)} right{wrong}, error p50 {p50_um[-1]:.1f} um")
    right, design = (trip.count(RIGHT) for trip in trips)
    good = not trips[0].count(WRONG)
    useful = right >= design and (tape.as_built.scatter_mm < SEEN_MM or p50_um[0] < p50_um[1])
    message = f"of {MEASURED} contacts of the measured parts {', '.join(messages)}"
    return Check(
        name=f"round trip from {source.name}",
        passed=good and useful,
        warning=good and not useful,
        message=message if useful else f"{message}: they bring nothing; measure again, or delete {AS_BUILT_NAME}",
        figure=float(right),
    )


def _trip(
    tape: Tape,
    source: Source,
    poses: FloatArray,
    sensor: SensorProfile,
    scene: Scene,
    locate: Locate,
    outcome_of_miss: OutcomeOfMiss,
    step: Callable[[], None],
) -> Trip:
    outcome, error_um = np.full(len(poses), LIMITED), np.full(len(poses), np.nan)
    reasons: Counter[str] = Counter()

    frames = iterate_frames(tape, len(poses), _SEED, sensor, scene, poses=poses, parts=source.parts)
    for k, frame in enumerate(frames):
        fix = locate(frame.depth)
        if fix.located and fix.position_mm is not None:
            error_um[k] = _off_mm(frame, fix.position_mm) * 1000.0
            outcome[k] = RIGHT if _is_right(tape, frame, fix) else WRONG
        else:
            reasons[fix.reason or "no answer"] += 1
            outcome[k] = outcome_of_miss(k, poses[k])
        step()
    return Trip(source=source.name, poses=poses, outcome=outcome, error_um=error_um, reasons=reasons)


def _off_mm(frame: Frame, position_mm: tuple[float, float]) -> float:
    return float(np.hypot(*(np.asarray(position_mm) - frame.position_mm)))


def _is_right(tape: Tape, frame: Frame, fix: Localization) -> bool:
    if not fix.located or fix.position_mm is None or fix.theta_deg is None:
        return False
    turn_deg = abs((fix.theta_deg - frame.theta_deg + 180.0) % 360.0 - 180.0)
    return _off_mm(frame, fix.position_mm) <= _RIGHT_PITCHES * tape.pitch_mm and turn_deg <= _RIGHT_DEG


def trip_checks(tape: Tape, sources: Sequence[Source], trips: Sequence[Trip]) -> list[Check]:
    """One line per source; if only some fail, the line names the file at fault."""
    return [_line(tape, source, trip, trips) for source, trip in zip(sources, trips, strict=True)]


def _line(tape: Tape, source: Source, trip: Trip, trips: Sequence[Trip]) -> Check:
    name, right, count = f"round trip from {source.name}", trip.count(RIGHT), len(trip.outcome)
    if trip.failed:
        message = "; ".join(_problems(tape, source, trip, trips))
        return Check(name=name, passed=False, message=message, figure=float(right))
    if right == 0:
        message = (
            f"none of {count} contacts is located by the quick method, which needs whole windows; verify without --quick"
            if trip.tolerated
            else f"none of {count} contacts shows enough to be located; see what a larger one does with --contact AxB"
        )
        return Check(name=name, passed=False, warning=True, message=message, figure=0.0)
    p50, p95, p99 = np.interp([0.5, 0.95, 0.99], np.linspace(0.0, 1.0, right), np.sort(trip.error_um[trip.outcome == RIGHT]))
    outcomes = (
        (LIMITED, "shows too little to be located"),
        (NOISY, "not located in the sensor's noise"),
        (BARELY, "not located, as it shows barely enough"),
        (MISSED, "missed by the decoder"),
        (LOST, "not located by the quick method"),
        (WRONG, "misplaced by the quick method, which has no bound"),
    )
    rest = "".join(f", {trip.count(outcome)} {what}" for outcome, what in outcomes if trip.count(outcome))
    message = f"{right} of {count} contacts located and right{rest}; error p50 {p50:.1f}, p95 {p95:.1f}, p99 {p99:.1f} um"
    return Check(name=name, passed=True, message=message, figure=float(right))


def _problems(tape: Tape, source: Source, trip: Trip, trips: Sequence[Trip]) -> Iterable[str]:
    count = len(trip.outcome)
    for outcome, what in ((WRONG, "decode to another place"), (LOST, "are not located though the tape says enough there")):
        if trip.count(outcome):
            x, y, theta = trip.poses[trip.outcome == outcome][0]
            far = f", {trip.error_um[trip.outcome == WRONG][0] / 1000:.3f} mm off" if outcome == WRONG else ""
            yield f"{trip.count(outcome)} of {count} contacts {what}, first at x {x:.2f}, y {y:.2f} mm, {theta:.0f} deg{far}"
    if trip.count(LOST):
        reason, times = trip.reasons.most_common(1)[0]
        yield f"the decoder says {times} times: {reason}"
    cause = explain(tape, source.parts.xy_mm)
    if cause is not None:
        # a file is called the wrong one only if another file of the kit is right
        yield f"the {source.name} is what is wrong: {cause}" if any(not t.failed for t in trips) else f"{source.name}: {cause}"
    fine = [t.source for t in trips if not t.failed]
    if fine:
        yield f"{' and '.join(fine)} decode{'s' * (len(fine) == 1)} right"
