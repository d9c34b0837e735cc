"""A tracker against single frames: the same simulated sequences located both ways, those that try to mislead it among them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from tactape_fab import Localization, Localizer, Tape, Tracker
from tactape_fab.sense import Frame, Scene
from tactape_fab.sense.decode.settings import World
from tactape_fab.sense.simulation.draw import frame_at
from tactape_fab.texture.certify.certificate import SIDES, closest
from tactape_fab.texture.certify.pairs import across
from tactape_fab.texture.frames import FloatArray, IntArray
from tests.bench.localization_measure import WORLDS, error_of, is_right
from tests.bench.localization_rows import registered_tape, tape_of

RATE_HZ = 25.0
FRAMES = 40
SIZES_MM = (5.0, 6.0, 7.0, 8.0)
AWAY = 0.1
"""Contact, mm, of a frame that touches nothing."""
_MARGIN_MM = 6.0
_MOST_MM_S, _MOST_DEG_S = 60.0, 150.0
_FIRM_MM, _FIRM_FRAMES = 9.0, 4
_STRANGERS = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """Where a contact is, frame by frame.

    Attributes
    ----------
    poses : ndarray, shape (n, 3)
        x mm, y mm, theta deg.
    sizes_mm : ndarray, shape (n,)
        Diameter of the contact; `AWAY` where there is none.
    foreign : ndarray of bool, shape (n,)
        Where it is another sector's tape, which nobody registered.
    sector : int
        Of that.
    """

    poses: FloatArray
    sizes_mm: FloatArray
    foreign: Any
    sector: int


Draw = Callable[[np.random.Generator, float], Course]


def _place(rng: np.random.Generator) -> FloatArray:
    tape = registered_tape()
    high = np.array([tape.columns - 1, tape.rows - 1]) * tape.pitch_mm - _MARGIN_MM
    return np.array([*rng.uniform(_MARGIN_MM, high), rng.uniform(-180.0, 180.0)])


def _course(poses: FloatArray, size_mm: float, rng: np.random.Generator) -> Course:
    sector = int(rng.choice([s for s in range(256) if s != registered_tape().sector]))
    n = len(poses)
    return Course(poses=poses, sizes_mm=np.full(n, size_mm), foreign=np.zeros(n, dtype=bool), sector=sector)


def _moving(rng: np.random.Generator, size_mm: float, slides: bool, turns: bool) -> Course:
    """From one place to another, starting and ending at rest, the fastest speed drawn up to the most."""
    share = (1.0 - np.cos(np.linspace(0.0, np.pi, FRAMES))) / 2
    peak = np.pi / 2 * RATE_HZ / (FRAMES - 1)  # share of the way in a second, in the middle
    while True:
        start = _place(rng)
        way = rng.uniform(0.1, 1.0) * _MOST_MM_S / peak * slides
        angle, turn = rng.uniform(0.0, 2 * np.pi), rng.uniform(-1.0, 1.0) * _MOST_DEG_S / peak * turns
        end = start + np.array([way * np.cos(angle), way * np.sin(angle), turn])
        high = np.array([registered_tape().columns - 1, registered_tape().rows - 1]) * registered_tape().pitch_mm
        if (end[:2] > _MARGIN_MM).all() and (end[:2] < high - _MARGIN_MM).all():
            return _course(start + share[:, None] * (end - start), size_mm, rng)


def rest(rng: np.random.Generator, size_mm: float) -> Course:
    return _course(np.tile(_place(rng), (FRAMES, 1)), size_mm, rng)


def slide(rng: np.random.Generator, size_mm: float) -> Course:
    return _moving(rng, size_mm, slides=True, turns=False)


def turn(rng: np.random.Generator, size_mm: float) -> Course:
    return _moving(rng, size_mm, slides=False, turns=True)


def both(rng: np.random.Generator, size_mm: float) -> Course:
    return _moving(rng, size_mm, slides=True, turns=True)


def _lifted(course: Course, size_mm: float) -> Course:
    """Off the tape for 6 frames, from 3 in which the contact shrinks to 3 in which it grows."""
    sizes = course.sizes_mm.copy()
    middle = FRAMES // 2
    sizes[middle - 6 : middle - 3] = size_mm * np.array([0.8, 0.6, 0.4])
    sizes[middle - 3 : middle + 3] = AWAY
    sizes[middle + 3 : middle + 6] = size_mm * np.array([0.4, 0.6, 0.8])
    return replace(course, sizes_mm=sizes)


def lift(rng: np.random.Generator, size_mm: float) -> Course:
    """Lifted, and put down up to 5 mm and 10 degrees away."""
    start = _place(rng)
    back = start + np.array([*rng.uniform(-3.5, 3.5, 2), rng.uniform(-10.0, 10.0)])
    poses = np.concatenate([np.tile(start, (FRAMES // 2, 1)), np.tile(back, (FRAMES - FRAMES // 2, 1))])
    return _lifted(_course(poses, size_mm, rng), size_mm)


def firm_slide(rng: np.random.Generator, size_mm: float) -> Course:
    """A slide that begins with some frames of a firmer press."""
    course = slide(rng, size_mm)
    sizes = course.sizes_mm.copy()
    sizes[:_FIRM_FRAMES] = _FIRM_MM
    return replace(course, sizes_mm=sizes)


def jump(rng: np.random.Generator, size_mm: float) -> Course:
    """To any other place of the tape from one frame to the next, every tenth frame."""
    return _course(np.repeat([_place(rng) for _ in range(FRAMES // 10)], 10, axis=0), size_mm, rng)


def hop(rng: np.random.Generator, size_mm: float) -> Course:
    """By a whole number of pitches, up to 9 mm, every tenth frame: the grid stays where it was."""
    start, poses = _place(rng), []
    for _ in range(FRAMES // 10):
        step = rng.integers(-6, 7, 2) * registered_tape().pitch_mm
        poses += [start + np.array([*step, 0.0])] * 10
    return _course(np.array(poses), size_mm, rng)


def foreign(rng: np.random.Generator, size_mm: float) -> Course:
    """To the tape of another sector half-way, the place on it unchanged."""
    course = slide(rng, size_mm)
    return replace(course, foreign=np.arange(FRAMES) >= FRAMES // 2)


def lifted_jump(rng: np.random.Generator, size_mm: float) -> Course:
    """Lifted, and put down anywhere."""
    poses = np.repeat([_place(rng), _place(rng)], FRAMES // 2, axis=0)
    return _lifted(_course(poses, size_mm, rng), size_mm)


def lifted_foreign(rng: np.random.Generator, size_mm: float) -> Course:
    """Lifted, and put down on another sector's tape."""
    course = lifted_jump(rng, size_mm)
    return replace(course, foreign=np.arange(FRAMES) >= FRAMES // 2)


@cache
def look_alikes() -> list[tuple[FloatArray, FloatArray]]:
    """Poses (x mm, y mm, theta deg) of the registered tape, in pairs that show nearly the same symbols."""
    tape, pairs = registered_tape(), []
    for side in SIDES:
        found = closest(tape, side)
        for first, second, turned in zip(found.first_rc, found.second_rc, found.turn, strict=True):
            pairs.append((_middle(first, side, 0.0), _middle(second, side, -90.0 * turned)))
    return pairs


@cache
def strange_look_alikes() -> list[tuple[int, FloatArray, FloatArray]]:
    """Sectors whose tapes come nearest to the registered one in 5x5 windows, with the poses on both."""
    own, side, out = registered_tape(), 5, []
    sectors = [s for s in range(256) if s != own.sector]
    order = np.argsort(across([own, *map(tape_of, sectors)], side).matrix[0, 1:], kind="stable")
    for sector in (sectors[i] for i in order[:_STRANGERS]):
        found = across([own, tape_of(sector)], side)
        for first, second, turned in zip(found.first, found.second, found.turn, strict=True):
            a, b = _middle(first[1:], side, 0.0), _middle(second[1:], side, -90.0 * turned)
            out.append((sector, a, b) if first[0] == 0 else (sector, b, a))
    return out


def _middle(corner_rc: IntArray, side: int, theta_deg: float) -> FloatArray:
    """The pose in which a sensor looks at the middle of a window."""
    row, column = corner_rc.tolist()
    half, pitch_mm = (side - 1) / 2, registered_tape().pitch_mm
    return np.array([(column + half) * pitch_mm, (row + half) * pitch_mm, theta_deg])


def look_alike(rng: np.random.Generator, size_mm: float) -> Course:
    """To and fro between two places of the tape that look most alike, every tenth frame."""
    pair = look_alikes()[rng.integers(len(look_alikes()))]
    poses = np.repeat(pair * (FRAMES // 20), 10, axis=0) + np.array([0.0, 0.0, rng.uniform(-180.0, 180.0)])
    return _course(poses, size_mm, rng)


def strange_look_alike(rng: np.random.Generator, size_mm: float) -> Course:
    """Half-way onto another sector's tape, where it looks most like the place that was touched."""
    sector, own, there = strange_look_alikes()[rng.integers(len(strange_look_alikes()))]
    poses = np.repeat([own, there], FRAMES // 2, axis=0) + np.array([0.0, 0.0, rng.uniform(-180.0, 180.0)])
    return replace(_course(poses, size_mm, rng), sector=sector, foreign=np.arange(FRAMES) >= FRAMES // 2)


MOTIONS: dict[str, Draw] = {
    "at rest": rest,
    "slide": slide,
    "turn": turn,
    "slide and turn": both,
    "lift-off": lift,
    "slide after a firm press": firm_slide,
}
TRAPS: dict[str, Draw] = {
    "jump on the tape": jump,
    "hop by whole pitches": hop,
    "onto a tape not registered": foreign,
    "lift-off, then anywhere": lifted_jump,
    "lift-off, then a tape not registered": lifted_foreign,
    "to the place that looks most alike": look_alike,
    "onto a tape not registered, where it looks most alike": strange_look_alike,
}
COURSES = {**MOTIONS, **TRAPS}
STRANGE = (
    "onto a tape not registered",
    "lift-off, then a tape not registered",
    "onto a tape not registered, where it looks most alike",
)
"""Courses that a closed world rules out."""


@cache
def localizer(world: World = "open") -> Localizer:
    return Localizer([registered_tape()], world=world)


def frames_of(course: Course, seed: int) -> Iterator[tuple[Frame, Tape]]:
    """The frames of a course, and the tape that each touches."""
    stranger = tape_of(course.sector)
    for k, (pose, size_mm) in enumerate(zip(course.poses, course.sizes_mm, strict=True)):
        tape = stranger if course.foreign[k] else registered_tape()
        dome_mm = 0.0 if size_mm == AWAY else 0.3
        scene = Scene(contact_mm=(float(size_mm), float(size_mm)), dome_mm=dome_mm)
        yield frame_at(tape, k, pose, seed, scene=scene), tape


class _Tally:
    """Counts and errors of one way to locate; rates are of frames on the registered tape with the contact's whole size."""

    def __init__(self) -> None:
        self.right = self.false = 0
        self.errors: list[FloatArray] = []

    def add(self, fix: Localization, frame: Frame, counted: bool, own: bool) -> None:
        if not fix.located:
            return
        if own and is_right(fix, frame):
            self.right += counted
            self.errors.append(error_of(fix, frame))
        else:
            self.false += 1

    def to_mapping(self) -> dict[str, Any]:
        out: dict[str, Any] = {"right": self.right, "false": self.false}
        if self.errors:
            errors = np.array(self.errors)
            for name, values in (("mm", np.hypot(*errors[:, :2].T)), ("deg", np.degrees(np.abs(errors[:, 2])))):
                out |= {f"p50_{name}": float(np.percentile(values, 50)), f"p95_{name}": float(np.percentile(values, 95))}
        return out


class _Watched:
    """One world's localizer on its own, and under a tracker."""

    def __init__(self, world: World) -> None:
        self.localizer = localizer(world)
        self.single, self.tracked = _Tally(), _Tally()
        self.tracker = Tracker(self.localizer)
        self.events: dict[str, int] = {}

    def add(self, frame: Frame, timestamp: float, whole: bool, own: bool) -> None:
        self.single.add(self.localizer.locate(frame.depth), frame, whole, own)
        track = self.tracker.update(frame.depth, timestamp)
        self.tracked.add(track.fix, frame, whole, own)
        for event in track.events:
            self.events[event.kind] = self.events.get(event.kind, 0) + 1

    def to_mapping(self) -> dict[str, Any]:
        events = dict(sorted(self.events.items()))
        return {"single": self.single.to_mapping(), "tracked": self.tracked.to_mapping(), "events": events}


def measure(name: str, size_mm: float, courses: int, seed: int = 41) -> dict[str, Any]:
    """One row: so many courses of one kind, with contacts of one size; a tracker forgets all between two of them."""
    rng = np.random.default_rng([seed, list(COURSES).index(name), round(10 * size_mm)])
    watched = {world: _Watched(world) for world in WORLDS if world == "open" or name not in STRANGE}
    counted = frames = 0
    for k in range(courses):
        course = COURSES[name](rng, size_mm)
        for one in watched.values():
            one.tracker.reset()
        for i, (frame, tape) in enumerate(frames_of(course, seed + 1000 * k)):
            own = tape is registered_tape()
            whole = own and bool(course.sizes_mm[i] == size_mm)
            frames, counted = frames + 1, counted + whole
            for one in watched.values():
                one.add(frame, i / RATE_HZ, whole, own)
    out: dict[str, Any] = {"course": name, "size_mm": size_mm, "courses": courses, "frames": frames, "counted": counted}
    out.update((str(world), one.to_mapping()) for world, one in watched.items())
    return out


# Slip


def slips(shift_mm: float, turn_deg: float, size_mm: float, courses: int, seed: int = 43) -> dict[str, Any]:
    """Contacts at rest that are shifted and turned once, before the seventh of 12 frames.

    ``at_once`` counts the courses whose step is told by the first two frames after it, ``later`` by one of the others;
    ``false`` slips that are told before it.
    """
    rng = np.random.default_rng([seed, round(1e4 * shift_mm), round(1e3 * turn_deg)])
    found = {"at_once": 0, "later": 0, "false": 0}
    for k in range(courses):
        start, angle = _place(rng), rng.uniform(0.0, 2 * np.pi)
        step = np.array([shift_mm * np.cos(angle), shift_mm * np.sin(angle), turn_deg * rng.choice([-1.0, 1.0])])
        course = _course(np.concatenate([np.tile(start, (6, 1)), np.tile(start + step, (6, 1))]), size_mm, rng)
        tracker = Tracker(localizer())
        tracks = [tracker.update(frame.depth, i / RATE_HZ) for i, (frame, _) in enumerate(frames_of(course, seed + 1000 * k))]
        at = [i for i, track in enumerate(tracks) for event in track.events if event.kind == "slip"]
        found["false"] += sum(i < 6 for i in at)
        if after := [i for i in at if i >= 6]:
            found["at_once" if after[0] < 8 else "later"] += 1
    return {"shift_mm": shift_mm, "turn_deg": turn_deg, "size_mm": size_mm, "courses": courses, **found}
