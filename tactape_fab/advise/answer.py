"""The answer of `advise`: legal designs, the contacts that each locates, and their costs, with the recommended one first."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from tactape_fab.advise.designs import Design, film_designs, judged, rules_of, solid_designs, usual_design
from tactape_fab.advise.model import CODES, IMPRINT_SHARE, LOSS, Code, Seen, accuracy, least_contact_mm, signal_of
from tactape_fab.advise.question import Question
from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.pool import Workers, mapped
from tactape_fab.kit.estimate import estimate
from tactape_fab.kit.examine.tape import profiles_of
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.kit.spec.options import DEFAULT_FAB
from tactape_fab.sense.decode.rule import MOST_RANGE
from tactape_fab.texture.code import get_code
from tactape_fab.texture.tape import Tape

LOCATED = 0.9
"""Fraction of contacts that a design has to locate, by the prediction."""
MOST_LINES, MOST_REACHING = 8, 5
SIMULATED_LINES, FRAMES = 3, 60
_SEED = 3
_BLOCK = 30
"""Simulated contacts per task of a worker, whose preparation costs as much as about half of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulated:
    """Simulated contacts of the predicted size: their number, number located, and median errors (None if none was)."""

    contact_mm: float
    frames: int
    located: int
    error_um: float | None
    angle_deg: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A design, and its predicted performance.

    least_mm: Diameter of the smallest round contact of which 9 in 10 are located; None if none in the sensor's field is.
    error_um, angle_deg: Median errors of contacts of the requested size, or of `least_mm` if that is larger; None if none is
        located.
    parts: Number of parts of one tape.
    once, each: Estimated assembly cost per order and per tape; None without assembly.
    height_um, noise_um: Height of a dot, and rms of the noise around it, after the decoder's smoothing.
    """

    design: Design
    code: Code
    least_mm: float | None
    error_um: float | None
    angle_deg: float | None
    parts: int
    once: float | None
    each: float | None
    height_um: float
    noise_um: float
    command: str
    simulated: Simulated | None = None

    def reaches(self, contact_mm: float) -> bool:
        """Whether 9 in 10 round contacts of that diameter are located."""
        return self.least_mm is not None and self.least_mm <= contact_mm

    def to_mapping(self) -> dict[str, Any]:
        design, sim = self.design, self.simulated
        return {
            "pitch_mm": design.pitch_mm,
            "displacement_mm": design.displacement_mm,
            "part": design.part,
            "body_mm": list(design.body_mm),
            "code": self.code.name,
            "directions": design.directions,
            "coverlay": design.coverlay,
            "warnings": list(design.warnings),
            "least_contact_mm": self.least_mm,
            "error_um": None if self.error_um is None else round(self.error_um, 1),
            "angle_deg": None if self.angle_deg is None else round(self.angle_deg, 3),
            "parts": self.parts,
            "cost_once": self.once,
            "cost_each": self.each,
            "height_um": round(self.height_um, 1),
            "noise_um": round(self.noise_um, 1),
            "command": self.command,
            "simulated": None if sim is None else asdict(sim),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """Lines, of which the recommended one is first, and whether it reaches the requested contact."""

    question: Question
    lines: tuple[Line, ...]
    currency: str | None

    @property
    def reached(self) -> bool:
        return self.lines[0].reaches(self.question.contact_mm)

    def to_mapping(self) -> dict[str, Any]:
        asked = self.question
        return {
            "contact_mm": asked.contact_mm,
            "located_share": LOCATED,
            "reached": self.reached,
            "sensor": asked.sensor.name,
            "making": asked.making.name,
            "blur_mm": asked.blur_mm,
            "placement_mm": asked.placement_mm,
            "tapes": asked.tapes,
            "size_mm": list(asked.size_mm),
            "currency": self.currency,
            "lines": [line.to_mapping() for line in self.lines],
            "codes": contacts_by_code(self.lines[0], asked),
        }


def advise(question: Question) -> Advice:
    """Find the legal designs, and the contacts that each locates by the model.

    Raises SpecError if no design gives a tape of the requested size.
    """
    making = question.making
    if isinstance(making, FabProfile):
        found: Iterable[Design] = [replace(d, fab=question.profile) for d in (usual_design(making), *film_designs(making))]
    else:
        found = solid_designs(making)
    # measuring the rules on a tape of each design takes longest, so equal designs are measured once, in order of preference
    legal = {design: None for tried in dict.fromkeys(found) if (design := judged(tried)) is not None}
    # codes of eight directions do not have enough points for a large tape
    coded = [design for design in legal if codes_for(design, question, seen_of(design, question))]
    lines = _best([_line(design, question) for design in coded], question)
    kept: list[Line] = []
    refused: list[Problem] = []
    for line in lines:
        reaching = line.reaches(question.contact_mm)
        if len(kept) == MOST_LINES or (reaching and len(kept) == MOST_REACHING):
            continue
        try:
            kept += [_counted(line, question)] if kept else _first(line, question)
        except SpecError as error:
            refused = refused or list(error.problems)
    if not kept:
        raise SpecError(refused or [Problem("process", f"no design is legal for {making.name}; use another --fab or --process")])
    return Advice(
        question=question, lines=tuple(kept), currency=making.order.currency if isinstance(making, FabProfile) else None
    )


def seen_of(design: Design, question: Question, points: int | None = None) -> Seen:
    """The design as seen by the question's sensor; `points` is by default that of a field without margins."""
    width_mm, height_mm = question.size_mm
    return Seen(
        pitch_mm=design.pitch_mm,
        displacement_mm=design.displacement_mm,
        shape=design.shape,
        body_mm=design.body_mm,
        # an upper bound without margins, for which no tape has to be planned
        points=max(int(width_mm * height_mm / design.pitch_mm**2), 1) if points is None else points,
        tapes=question.tapes,
        sensor=question.sensor,
        blur_mm=question.blur_mm,
        placement_mm=question.placement_mm,
        directions=design.directions,
    )


def _line(design: Design, question: Question) -> Line:
    """Prediction for a design; before `_counted`, parts are those of a field without margins, and costs are missing."""
    seen = seen_of(design, question)
    codes = codes_for(design, question, seen)
    code, least_mm = _code_for(seen, question.contact_mm, question.field_mm, codes)
    errors = None if least_mm is None else accuracy(seen, max(question.contact_mm, least_mm))
    signal = signal_of(seen)
    return Line(
        design=design,
        code=code,
        least_mm=least_mm,
        error_um=None if errors is None else 1000.0 * errors[0],
        angle_deg=None if errors is None else errors[1],
        parts=seen.points,
        once=None,
        each=None,
        height_um=signal.height_um,
        noise_um=signal.noise_um,
        command=design.command(question.size_mm, code.name, DEFAULT_FAB, CODES[0].name),
    )


def codes_for(design: Design, question: Question, seen: Seen) -> list[Code]:
    """The codes that have the design's number of directions, and enough points and columns for a field without margins."""
    longest = max(question.size_mm) / design.pitch_mm
    return [
        code
        for code in CODES
        if seen.directions in (of := get_code(code.name)).directions
        and (code is CODES[0] or (seen.points <= of.most_points and longest <= of.range))
    ]


def contacts_by_code(line: Line, question: Question) -> list[dict[str, Any]]:
    """For each code that a line's tape could have: the smallest contact located with the manifest, and with the code only."""
    seen, field_mm = seen_of(line.design, question, line.parts), question.field_mm
    found = []
    for code in codes_for(line.design, question, seen):
        plane = get_code(code.name).plane
        known, alone = least_contact_mm(seen, code, LOSS, LOCATED, field_mm), None
        if plane is not None and plane.range <= MOST_RANGE:
            alone = least_contact_mm(seen, code, LOSS, LOCATED, field_mm, plane)
        found.append({"code": code.name, "least_contact_mm": known, "without_manifest_mm": alone})
    return found


def _code_for(seen: Seen, contact_mm: float, field_mm: float, codes: Sequence[Code]) -> tuple[Code, float | None]:
    """The first code with which the design locates the contact, else that which locates the smallest; and its least contact."""
    best, least_mm = codes[0], None
    for code in codes:
        # the evidence of dots is equal for all codes, so a code whose places are no less similar locates no smaller contact
        if code.axis > best.axis or (code is not best and code.axis == best.axis):
            continue
        found_mm = least_contact_mm(seen, code, LOSS, LOCATED, field_mm)
        if found_mm is not None and (least_mm is None or found_mm < least_mm):
            best, least_mm = code, found_mm
        if least_mm is not None and least_mm <= contact_mm:
            break
    return best, least_mm


def _best(lines: Sequence[Line], question: Question) -> list[Line]:
    """Pareto-optimal lines by contact, warnings, directions, parts, and the fab's preference of coverlay. Those that reach the
    contact come first, ordered by fewest warnings, four directions, and fewest parts; then those that are nearest to it.
    """
    making, contact_mm = question.making, question.contact_mm
    modes = list(making.coverlay_modes) if isinstance(making, FabProfile) else []

    def figures(line: Line) -> tuple[float, ...]:
        coverlay = [mode == line.design.coverlay for mode in modes]
        preferred = coverlay.index(True) if any(coverlay) else 0
        return (line.least_mm or np.inf, len(line.design.warnings), line.design.directions, line.parts, preferred)

    def dominated(line: Line) -> bool:
        mine = figures(line)
        # Pareto: no worse in any figure, and different in at least one
        return any(figures(o) != mine and all(a <= b for a, b in zip(figures(o), mine, strict=True)) for o in lines)

    def order(line: Line) -> tuple[float, ...]:
        least_mm, warnings, directions, parts, _ = figures(line)
        return (0.0, warnings, directions, parts) if line.reaches(contact_mm) else (1.0, least_mm, warnings)

    return sorted((line for line in lines if line.least_mm is not None and not dominated(line)), key=order) or sorted(
        lines, key=lambda line: line.noise_um / max(line.height_um, 1e-9)
    )


def _first(line: Line, question: Question) -> list[Line]:
    """The line as the recommended one, if the tape that its command makes is legal; else empty."""
    broken = rules_of(line.design, question.size_mm)
    return [] if broken is not None and any(f.blocks for f in broken) else [_counted(line, question)]


def _counted(line: Line, question: Question) -> Line:
    """The line with the number of parts of a tape of the requested size, and their cost."""
    spec, making = line.design.spec(question.size_mm), question.making
    parts = profiles_of(spec).plan(spec).part_count
    if not isinstance(making, FabProfile):
        return replace(line, parts=parts)
    costs = estimate(parts, making)
    return replace(line, parts=parts, once=costs.once, each=costs.each)


def tape_of(line: Line, question: Question, sector: int) -> Tape:
    """The tape made by the line's command with this sector, and with the sector's origin, name and tag."""
    spec = line.design.spec(question.size_mm, sector=sector, code=line.code.name, directions=line.design.directions)
    return profiles_of(spec).plan(spec)


def checked(advice: Advice, progress: Callable[[str, int, int], None] = lambda *_: None, workers: Workers = 1) -> Advice:
    """The advice, with its first lines tested by simulated contacts of the size predicted for each."""
    lines = list(advice.lines)
    asked = [k for k, line in enumerate(lines[:SIMULATED_LINES]) if line.least_mm is not None]
    for done, k in enumerate(asked):
        shown = partial(progress, f"line {done + 1} of {len(asked)}: contact")
        lines[k] = replace(lines[k], simulated=simulated(lines[k], advice.question, FRAMES, progress=shown, workers=workers))
    return replace(advice, lines=tuple(lines))


def simulated(
    line: Line,
    question: Question,
    frames: int,
    progress: Callable[[int, int], None] = lambda *_: None,
    workers: Workers = 1,
) -> Simulated:
    """Locate simulated depth maps of contacts of the predicted size on a tape of the line, among the requested number of tapes.

    ``progress`` is called with the number of contacts done so far, 0 at first, and the total.
    """
    progress(0, frames)
    # spread over the sectors that every code has; 37 is coprime to 256, so they are all different
    tapes = [tape_of(line, question, (7 + 37 * k) % 256) for k in range(min(question.tapes, 256))]
    blocks = [range(first, min(first + _BLOCK, frames)) for first in range(0, frames, _BLOCK)]
    errors: list[tuple[float, float] | None] = []
    for of_block in mapped(partial(_located, tapes, line, question, frames), blocks, workers):
        errors += of_block
        progress(len(errors), frames)
    found = [error for error in errors if error is not None]
    error_mm, angle_deg = np.median(found, axis=0).tolist() if found else (None, None)
    assert line.least_mm is not None
    return Simulated(
        contact_mm=line.least_mm,
        frames=frames,
        located=len(found),
        error_um=None if error_mm is None else round(1000.0 * error_mm, 1),
        angle_deg=None if angle_deg is None else round(angle_deg, 3),
    )


def _located(
    tapes: Sequence[Tape], line: Line, question: Question, frames: int, block: Sequence[int]
) -> list[tuple[float, float] | None]:
    """Errors (mm, degrees) of a block of contacts with the first tape; None for those that are refused.

    The random numbers of a contact depend only on its index.
    """
    from tactape_fab.sense.decode.localizer import Localizer
    from tactape_fab.sense.simulation.draw import frame_at
    from tactape_fab.sense.simulation.drawn_poses import draw_poses
    from tactape_fab.sense.simulation.scene import Scene

    assert line.least_mm is not None
    scene = Scene(
        contact_mm=(line.least_mm, line.least_mm),
        texture_mm=IMPRINT_SHARE * line.design.body_mm[2],
        elastomer_mm=question.blur_mm,
        placement_mm=question.placement_mm,
    )
    poses = draw_poses(tapes[0], frames, _SEED, question.sensor, scene)
    localizer = Localizer(tapes, sensor=question.sensor)
    found: list[tuple[float, float] | None] = []
    for k in block:
        truth = frame_at(tapes[0], k, poses[k], _SEED, question.sensor, scene)
        fix = localizer.locate(truth.depth)
        if fix.position_mm is None or fix.theta_deg is None:
            found.append(None)
        else:
            off_mm = float(np.hypot(*np.subtract(fix.position_mm, truth.position_mm)))
            # the angle wrapped to half a turn
            found.append((off_mm, abs((fix.theta_deg - truth.theta_deg + 180.0) % 360.0 - 180.0)))
    return found
