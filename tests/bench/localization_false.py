"""Textures that must never be located: what is touched, as dots or as depth maps, and how often it is located all the same.

Frame k of a subject is the same in every world, and whatever part of a count it is drawn in.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import islice
from time import perf_counter
from typing import Literal
from zlib import crc32

import numpy as np

from tactape_fab import Localization, Localizer, Tape
from tactape_fab.sense import Parts, Scene, load_sensor, simulate
from tactape_fab.sense.decode.settings import World
from tactape_fab.sense.simulation.dot_errors import Dots
from tactape_fab.sense.simulation.parts import parts_of
from tactape_fab.texture.frames import FloatArray
from tests.bench.dot_records import Edge, contact_poses, recorded
from tests.bench.false_tally import Tally
from tests.bench.impostors import SURFACES, other_surface, plain_grid, random_bumps, random_symbols
from tests.bench.localization_measure import localizer_of
from tests.bench.localization_rows import FELT, SECTOR, SEED, STRIPS, registered_tape, tape_of
from tests.bench.recorded import DotFrames, draw_dots
from tests.bench.touched import touched_parts

PART = 1000
"""Frames that are drawn together, the contacts taking turns."""

SCENES: Mapping[str, tuple[Scene, Edge]] = {
    "11x9 mm": (Scene(), "none"),
    "8x8 mm": (Scene(contact_mm=(8.0, 8.0)), "none"),
    "6x6 mm": (Scene(contact_mm=(6.0, 6.0)), "none"),
    "strip 6 mm": (STRIPS[6.0], "none"),
    "strip 4.5 mm": (STRIPS[4.5], "none"),
    "strip 3 mm": (STRIPS[3.0], "none"),
    "edge, 2-3 lines": (Scene(), "out"),
    "edge, bumps": (Scene(contact_mm=(7.5, 8.5), bumps=3), "any"),
}
"""Contacts, and whether they hang over the tape's edge: farther out, those with two or three columns or rows of dots."""
BESIDE_BUMPS = "edge, bumps"
"""Dots beside the tape, where a rival has no part either."""

MIRRORED = "own tape mirrored"
IMPOSTORS: Mapping[str, Callable[[Tape, int], Parts]] = {
    "plain grid": lambda tape, seed: plain_grid(tape),
    "random symbols": random_symbols,
    "random bumps": random_bumps,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """Frames of one subject for one localizer.

    Attributes
    ----------
    kind : str
        Line of the report.
    subject : str
        "sector N", `MIRRORED`, a name of `IMPOSTORS` or of `SURFACES`.
    common : bool
        Whether touched and registered tape have origin 0, 0, or their sectors' default origins.
    contact : str or None
        One of `SCENES`; None: all in turn.
    part, frames : int
        The first `frames` of the part's frames.
    """

    kind: str
    subject: str
    level: Literal["dots", "depth maps"]
    world: World = "open"
    common: bool = False
    contact: str | None = None
    part: int = 0
    frames: int = PART

    @property
    def origin(self) -> tuple[int, int] | None:
        return (0, 0) if self.common else None

    @property
    def contacts(self) -> tuple[str, ...]:
        if self.contact is not None:
            return (self.contact,)
        return tuple(SCENES)[:6] if self.subject in SURFACES else tuple(SCENES)

    def seeds(self, contact: str) -> np.random.SeedSequence:
        """Of the part's frames of a contact."""
        named = f"{self.subject}, {self.level}, {self.origin}, {contact}"
        return np.random.SeedSequence([SEED, crc32(named.encode()), self.part])


def count(job: Job) -> Tally:
    """Locate a job's frames."""
    localizer = _localizer(job.world, job.common)
    if job.level == "dots":  # once, before the clock runs
        for scene, edge in map(SCENES.__getitem__, job.contacts):
            recorded(scene, edge)
    tally = Tally()
    frames = _frames(job)
    for k in range(job.frames):
        start = perf_counter()
        contact, frame = next(frames)
        made = perf_counter()
        fix = _located(localizer, frame)
        tally.add(f"{job.subject}, {contact}, part {job.part}, frame {k}", contact, fix)
        tally.made_s += made - start
        tally.located_s += perf_counter() - made
    return tally


def replay(job: Job, k: int) -> Localization:
    """The answer for one frame of a job."""
    frame: Dots | FloatArray
    if job.level == "dots":  # of this contact alone: those of the others are drawn by themselves
        n, which = divmod(k, len(job.contacts))
        frame = draw_part(job, job.contacts[which])[n]
    else:
        _, frame = next(islice(depth_frames(job), k, None))
    return _located(_localizer(job.world, job.common), frame)


def _frames(job: Job) -> Iterator[tuple[str, Dots | FloatArray]]:
    yield from dots_frames(job) if job.level == "dots" else depth_frames(job)


def _located(localizer: Localizer, frame: Dots | FloatArray) -> Localization:
    return localizer.locate_dots(frame.xy_px, frame.weights) if isinstance(frame, Dots) else localizer.locate(frame)


@cache
def _localizer(world: World, common: bool) -> Localizer:
    return Localizer([tape_of(SECTOR, (0, 0))], world=world) if common else localizer_of(1, world)


def _tape(job: Job) -> Tape:
    sector = int(job.subject.removeprefix("sector ")) if job.subject.startswith("sector ") else SECTOR
    return registered_tape() if sector == SECTOR and not job.common else tape_of(sector, job.origin)


def dots_frames(job: Job) -> Iterator[tuple[str, Dots]]:
    """A part's frames as dots, with the contact of each."""
    drawn = [draw_part(job, contact) for contact in job.contacts]
    for k in range(PART):
        yield job.contacts[k % len(drawn)], drawn[k % len(drawn)][k // len(drawn)]


def draw_part(job: Job, contact: str) -> DotFrames:
    """All frames of one contact in a job's part."""
    tape, (scene, edge) = _tape(job), SCENES[contact]
    rng = np.random.default_rng(job.seeds(contact))
    poses = _poses(tape, job, contact, rng)
    records = recorded(scene, edge)
    return draw_dots(tape, poses, records, rng, parts=_parts(tape, job, rng), mirrored=job.subject == MIRRORED)


def depth_frames(job: Job) -> Iterator[tuple[str, FloatArray]]:
    """A part's frames as depth maps, with the contact of each."""
    tape = _tape(job)
    drawn = []
    for contact in job.contacts:
        rng = np.random.default_rng(job.seeds(contact))
        drawn.append((contact, _poses(tape, job, contact, rng), _parts(tape, job, rng), rng.integers(2**62, size=PART)))
    for k in range(PART):
        contact, poses, parts, seeds = drawn[k % len(drawn)]
        scene = SCENES[contact][0].changed({"mirrored_tape": job.subject == MIRRORED})
        (x, y, theta_deg), seed = poses[k // len(drawn)].tolist(), int(seeds[k // len(drawn)])
        if job.subject in SURFACES:
            yield contact, other_surface(job.subject, scene=scene, seed=seed)  # type: ignore[arg-type, misc]
        else:
            yield contact, simulate(tape, (x, y), theta_deg, scene=scene, seed=seed, parts=parts)  # type: ignore[misc]


def _parts(tape: Tape, job: Job, rng: np.random.Generator) -> Parts | None:
    make = IMPOSTORS.get(job.subject)
    return None if make is None else make(tape, int(rng.integers(2**62)))


def _poses(tape: Tape, job: Job, contact: str, rng: np.random.Generator) -> FloatArray:
    wanted = -(-PART // len(job.contacts))
    scene, edge = SCENES[contact]
    if edge != "out":
        return contact_poses(tape, wanted, int(rng.integers(2**62)), scene, edge)
    found: list[FloatArray] = []
    while sum(map(len, found)) < wanted:
        poses = contact_poses(tape, 2 * wanted, int(rng.integers(2**62)), scene, edge)
        lines = fewest_lines(tape, poses, scene)
        found.append(poses[(lines >= 2) & (lines <= 3)])
    return np.concatenate(found)[:wanted]


def fewest_lines(tape: Tape, poses: FloatArray, scene: Scene) -> FloatArray:
    """How many columns or rows, whichever are fewer, of a tape's grid each pose feels."""
    sensor, rng = load_sensor("gelsight-mini"), np.random.default_rng(0)
    touched = touched_parts(tape, poses, sensor, scene, parts_of(tape), rng)
    felt = touched.imprint >= FELT
    cells, most = tape.cells()[touched.part[felt]], max(tape.columns, tape.rows)
    lines = np.zeros((2, len(poses), most), dtype=bool)
    for axis in (0, 1):
        lines[axis, touched.pose[felt], cells[:, axis]] = True
    return np.asarray(lines.sum(axis=2).min(axis=0))
