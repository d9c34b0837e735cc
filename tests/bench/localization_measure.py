"""Measuring one row of the localization benchmark: rates, errors, times, and the information limit beside them."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import asdict, dataclass, replace
from functools import cache
from math import pi
from typing import Any, Protocol

import numpy as np

from tactape_fab import Localization, Localizer, Prior, Tape
from tactape_fab.sense import Frame
from tactape_fab.sense.decode.accept import accept_place
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.grid.fit import fit_grid, posteriors
from tactape_fab.sense.decode.paper import locate_paper
from tactape_fab.sense.decode.rank import Reading
from tactape_fab.sense.decode.result import status_of
from tactape_fab.sense.decode.rule import MOST_TURN_SHARE, trusted
from tactape_fab.sense.decode.search.hypotheses import Registry
from tactape_fab.sense.decode.search.search import search
from tactape_fab.sense.decode.settings import World
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray
from tests.bench.localization_rows import COUNT, FELT, Row, frames_of, registered_tape, tapes_of

WORLDS: tuple[World, World] = ("open", "closed")
DOUBT = 1e-3
"""A row fails when its figure would be so unlikely were the target just met."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """What one method showed on a row. Errors are of frames located and right; None where there are none."""

    frames: int
    right: int
    wrong: int
    limit: int | None = None
    position_um: float | None = None
    theta_deg: float | None = None
    nees: float | None = None
    p50_ms: float = 0.0
    p95_ms: float = 0.0
    p99_ms: float = 0.0
    lost: dict[str, int] | None = None

    @property
    def rate(self) -> float:
        return self.right / self.frames

    @property
    def limit_rate(self) -> float:
        return (self.limit or 0) / self.frames

    def to_mapping(self) -> dict[str, Any]:
        """Plain values, the rates included."""
        return {**asdict(self), "rate": self.rate, "limit_rate": None if self.limit is None else self.limit_rate}


def measure(row: Row, count: int | None = None) -> dict[str, Figures]:
    """Figures of a row by method: "open", "closed" and "paper"; of the benchmark's number of frames unless said."""
    tapes = tapes_of(row)
    localizers = {world: localizer_of(row.tapes, world, row.max_p_tape) for world in WORLDS}
    rng = np.random.default_rng(row.seed)
    gathered: dict[str, _Gathered] = {name: _Gathered() for name in (*WORLDS, "paper")}
    for frame in frames_of(row, max(COUNT // row.fewer, 20) if count is None else count):
        prior = prior_of(frame, rng) if row.prior else None
        for world, localizer in localizers.items():
            limit = ideal(localizer, frame, registered_tape(), prior)
            gathered[world].add(localizer.locate(frame.depth, prior=prior), frame, limit=is_right(limit, frame))
        fix, trace = locate_paper(frame.depth, tapes, px_per_mm=row.paper_scale)
        gathered["paper"].add(fix, frame, lost=trace.lost_at)
    return {name: found.figures() for name, found in gathered.items()}


@cache
def localizer_of(tapes: int, world: World, max_p_tape: float | None = None) -> Localizer:
    """A Localizer of the benchmark's registry; made once."""
    return Localizer(tapes_of(Row(name="", tapes=tapes)), world=world, max_p_tape=max_p_tape)


def measure_code(row: Row) -> Figures:
    """Figures of a row where nothing is registered, and only the code is known."""
    tape = registered_tape()
    localizer = Localizer.from_code(tape.code, tape.pitch_mm, tape.displacement_mm)
    gathered = _Gathered()
    for frame in frames_of(row, max(COUNT // row.fewer, 20)):
        fix = localizer.locate(frame.depth)
        if fix.plane_mm is not None:
            x, y = np.asarray(fix.plane_mm) - np.asarray(tape.origin) * tape.pitch_mm
            fix = replace(fix, position_mm=(float(x), float(y)))
        gathered.add(fix, frame)
    return gathered.figures()


def prior_of(frame: Frame, rng: np.random.Generator) -> Prior:
    """A prior of 2 mm and 10 degrees that is off by up to as much."""
    x, y = frame.position_mm + rng.uniform(-1.4, 1.4, 2)
    return Prior(position_mm=(float(x), float(y)), theta_deg=frame.theta_deg + float(rng.uniform(-9.0, 9.0)))


class _Gathered:
    def __init__(self) -> None:
        self.errors: list[FloatArray] = []
        self.nees: list[float] = []
        self.elapsed_ms: list[float] = []
        self.frames = self.wrong = self.limit = 0
        self.lost: Counter[str] = Counter()
        self.has_limit = False

    def add(self, fix: Localization, frame: Frame, *, limit: bool | None = None, lost: str | None = None) -> None:
        self.frames += 1
        self.elapsed_ms.append(fix.elapsed_ms)
        if limit is not None:
            self.has_limit, self.limit = True, self.limit + limit
        if not fix.located:
            self.lost[lost or blurred(fix.reason or "")] += 1
        elif not is_right(fix, frame):
            self.wrong += 1
        else:
            error = error_of(fix, frame)
            self.errors.append(error)
            if fix.covariance is not None:
                self.nees.append(float(error @ np.linalg.solve(fix.covariance, error)) / 3)

    def figures(self) -> Figures:
        p50, p95, p99 = np.percentile(self.elapsed_ms, [50, 95, 99])
        rms = np.sqrt(np.mean(np.square(self.errors), axis=0)) if self.errors else None
        return Figures(
            frames=self.frames,
            right=len(self.errors),
            wrong=self.wrong,
            limit=self.limit if self.has_limit else None,
            position_um=None if rms is None else float(np.hypot(*rms[:2]) / np.sqrt(2) * 1000),
            theta_deg=None if rms is None else float(np.degrees(rms[2])),
            nees=float(np.mean(self.nees)) if self.nees else None,
            p50_ms=float(p50),
            p95_ms=float(p95),
            p99_ms=float(p99),
            lost=dict(self.lost.most_common()),
        )


def blurred(reason: str) -> str:
    """The first words of a reason without its figures, to be counted."""
    return re.sub(r"\b\d+\b", "n", reason.partition(":")[0])


class Truth(Protocol):
    """The true pose of a contact."""

    @property
    def position_mm(self) -> FloatArray: ...
    @property
    def theta_deg(self) -> float: ...


def error_of(fix: Localization, frame: Truth) -> FloatArray:
    """(x mm, y mm, theta rad) of a fix less the truth."""
    assert fix.position_mm is not None and fix.theta_deg is not None
    turn = (fix.theta_deg - frame.theta_deg + 180.0) % 360.0 - 180.0
    return np.array([*(np.asarray(fix.position_mm) - frame.position_mm), np.radians(turn)])


def is_right(fix: Localization, frame: Truth, tape: Tape | None = None) -> bool:
    """Located in the right cell of the right tape, at the right angle."""
    tape = tape or registered_tape()
    if not fix.located or fix.sector != tape.sector or fix.position_mm is None:
        return False
    error = error_of(fix, frame)
    return bool(np.hypot(*error[:2]) < tape.pitch_mm / 2 and abs(error[2]) < np.radians(10.0))


def ideal(localizer: Localizer, frame: Frame, tape: Tape, prior: Prior | None = None) -> Localization:
    """What the trust rule says of the dots that are really there, each at its nominal place: symbols without error.

    The grid and the bodies' direction are given too, so that nothing but the rule and the code is left.
    """
    cells = tape.cells()[frame.dots_part[frame.dots_imprint > FELT]]
    empty = Localization(status=status_of(len(cells)), located=False, n_dots=len(cells))
    if len(cells) < 6:
        return replace(empty, reason="too few dots")
    px_per_mm, angle = float(localizer.sensor.px_per_mm[0]), float(np.radians(frame.theta_deg))
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, s], [-s, c]]) * px_per_mm  # rows of texture points times this: image points
    nominal = cells * tape.pitch_mm + tape.displacement_mm * DIRECTIONS_XY[tape.symbols[cells[:, 1], cells[:, 0]]]
    centre, ones = localizer.sensor.centre_px, np.ones(len(cells))
    xy = (nominal - frame.position_mm) @ turn + centre
    middle = xy.mean(axis=0)
    x, y = (cells[0] * tape.pitch_mm - frame.position_mm) @ turn + centre - middle
    pitch_px = tape.pitch_mm * px_per_mm
    phases = 2 * pi * np.array([c * x + s * y, c * y - s * x]) / pitch_px
    dots = Dots(xy_px=xy, weights=ones, trust=trusted(ones))
    shift = tape.displacement_mm / tape.pitch_mm
    grid, nodes, squares, sigma, *_ = fit_grid(xy - middle, ones, dots.trust, angle, pitch_px, phases[0], phases[1], shift, False)
    q = posteriors(nodes, squares, ones, dots.trust, sigma)
    world, bodies = localizer._world, np.array([MOST_TURN_SHARE, 1.0 - MOST_TURN_SHARE] * 2) / 2
    assert isinstance(world, Registry)
    place = search(world.tapes, world.families, nodes, q, bodies, grid, centre - middle, prior)
    if place is None:
        return replace(empty, reason="no place")
    return accept_place(dots, Reading(place=place, grid_weight=0.0), localizer._view, world, localizer._limits)[0]


# Chance


def too_few(successes: int, trials: int, rate: float) -> bool:
    """Whether so few successes are out of the question at this rate."""
    from scipy.stats import binom

    return bool(binom.cdf(successes, trials, rate) < DOUBT)


def too_many(successes: int, trials: int, rate: float) -> bool:
    """Whether so many successes are out of the question at this rate."""
    from scipy.stats import binom

    return bool(binom.sf(successes - 1, trials, rate) < DOUBT)
