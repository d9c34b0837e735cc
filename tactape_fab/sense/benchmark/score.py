"""Scores of a method's answers: located, wrong, errors, whether covariance and p_false are true, time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot, radians
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base.errors import Problem, SpecError, reason_of
from tactape_fab.base.fields import Fields, shown_path
from tactape_fab.base.input_file import read_regular
from tactape_fab.base.json_text import parse_json
from tactape_fab.sense.benchmark.answers import FARTHEST_MM, MOST_SECTOR, Answer
from tactape_fab.sense.benchmark.conditions import CONDITIONS, PITCH_MM
from tactape_fab.sense.benchmark.write import TRUTH_FORMAT
from tactape_fab.texture.frames import FloatArray

RIGHT_MM, RIGHT_DEG = PITCH_MM / 2, 10.0
"""A located answer is right on the right tape, and nearer than this: in the right cell, and turned the right way."""
STEPS = (0.0, 1e-4, 1e-2, 0.1, 0.5, 1.0)
"""Bounds of the classes of p_false."""
_MOST_BYTES = 1 << 28


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """The truth of one frame; nothing to locate where the tape is None, nothing that may be located unless it is registered."""

    condition: str
    tape: str | None
    sector: int | None
    registered: bool
    position_mm: tuple[float, float] | None
    theta_deg: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """Scores of some frames; None where there is nothing to measure.

    frames, right, wrong: Frames; those that are located in the right cell of the right tape; those that are located anywhere
        else.
    p50_um, p95_um, p50_deg, p95_deg: Percentiles of the distance from the true place, and of the angle's error; of right answers.
    nees: Mean of e' C^-1 e / 3 of right answers with a covariance; 1 where that is true.
    stated: Sum of p_false of located answers, so the number of wrong ones that the method said to expect at most.
    p50_ms, p95_ms: Time of a frame as the method says it.
    """

    frames: int
    right: int
    wrong: int
    p50_um: float | None
    p95_um: float | None
    p50_deg: float | None
    p95_deg: float | None
    nees: float | None
    stated: float | None
    p50_ms: float | None
    p95_ms: float | None


def read_truth(path: str | Path) -> list[Truth]:
    """The truth of a data set, in the order of its frames. Raises SpecError."""
    path = Path(path)
    try:
        first, *lines = read_regular(path, _MOST_BYTES).splitlines()
        if parse_json(first).get("format") != TRUTH_FORMAT:
            raise ValueError(f"it does not begin with format {TRUTH_FORMAT}")
        return [_truth(k, parse_json(line)) for k, line in enumerate(lines)]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        message = f"{shown_path(path)} is no truth of a benchmark: {reason_of(error)}; give --truth FILE, or write it again"
        raise SpecError(Problem("truth", message)) from error


def _truth(k: int, row: Mapping[str, Any]) -> Truth:
    """The truth of frame k in a row; ValueError if it is invalid."""
    table = Fields({key: value for key, value in row.items() if value is not None})
    table.integer("frame", low=k, high=k)
    condition, registered = table.text("condition"), table.flag("registered")
    tape = sector = position = theta_deg = None
    if registered or "tape" in table.values:
        tape, sector = table.text("tape"), table.integer("sector", low=0, high=MOST_SECTOR)
        position = table.numbers("position_mm", 2, low=-FARTHEST_MM, high=FARTHEST_MM)
        theta_deg = table.number("theta_deg", low=-360.0, high=360.0, unit="deg")
    if table.problems:
        raise ValueError("; ".join(problem.message for problem in table.problems))
    place = {"position_mm": position, "theta_deg": theta_deg}
    return Truth(condition=condition, tape=tape, sector=sector, registered=registered, **place)  # type: ignore[arg-type]


def score(answers: Mapping[int, Answer], truth: Sequence[Truth]) -> dict[str, Row]:
    """Scores by condition, those of all frames under "all"."""
    frames: dict[str, list[int]] = {}
    for k, one in enumerate(truth):
        frames.setdefault(one.condition, []).append(k)
    ordered = [name for name in CONDITIONS if name in frames] + [name for name in frames if name not in CONDITIONS]
    rows = {name: _row(frames[name], answers, truth) for name in ordered}
    return {**rows, "all": _row(range(len(truth)), answers, truth)}


def error_of(answer: Answer, truth: Truth) -> FloatArray | None:
    """Answer minus truth, (x mm, y mm, theta rad); None if the answer is on another tape, or has no position."""
    if not truth.registered or answer.position_mm is None or answer.theta_deg is None:
        return None
    if answer.tape != truth.tape and not (answer.tape is None and answer.sector == truth.sector):
        return None
    assert truth.position_mm is not None and truth.theta_deg is not None
    # wrapped to half a turn
    turn = (answer.theta_deg - truth.theta_deg + 180.0) % 360.0 - 180.0
    return np.array([*(np.asarray(answer.position_mm) - truth.position_mm), radians(turn)])


def is_right(error: FloatArray | None) -> bool:
    """Whether an error is within `RIGHT_MM` and `RIGHT_DEG`, so that the place is the right one."""
    return error is not None and hypot(error[0], error[1]) < RIGHT_MM and abs(error[2]) < radians(RIGHT_DEG)


def _row(frames: Iterable[int], answers: Mapping[int, Answer], truth: Sequence[Truth]) -> Row:
    frames, nothing = list(frames), Answer()
    located = [(answers[k], error_of(answers[k], truth[k])) for k in frames if answers.get(k, nothing).located]
    right = [(answer, error) for answer, error in located if error is not None and is_right(error)]
    errors = np.array([error for _, error in right]).reshape(-1, 3)
    # normalised squared error: chi-squared of three degrees of freedom, whose mean is 3, where the covariance is true
    squares = [error @ np.linalg.solve(a.covariance, error) / 3 for a, error in right if a.covariance is not None]
    # a bound on a probability may be above 1, a frame is wrong once
    stated = [min(answer.p_false, 1.0) for answer, _ in located if answer.p_false is not None]
    times = [answers[k].elapsed_ms for k in frames if k in answers and answers[k].elapsed_ms is not None]
    um, deg = 1000.0 * np.hypot(errors[:, 0], errors[:, 1]), np.degrees(np.abs(errors[:, 2]))
    return Row(
        frames=len(frames),
        right=len(right),
        wrong=len(located) - len(right),
        p50_um=_percentile(um, 50),
        p95_um=_percentile(um, 95),
        p50_deg=_percentile(deg, 50),
        p95_deg=_percentile(deg, 95),
        nees=float(np.mean(squares)) if squares else None,
        stated=float(sum(stated)) if stated else None,
        p50_ms=_percentile(times, 50),
        p95_ms=_percentile(times, 95),
    )


def _percentile(values: Any, percent: float) -> float | None:
    return float(np.percentile(values, percent)) if len(values) else None


def calibration(answers: Mapping[int, Answer], truth: Sequence[Truth]) -> list[tuple[float, float, int, float, int]]:
    """Classes of p_false: bounds, places in it (of frames located or not), the sum of their p_false, and how many are wrong."""
    pairs = [(a.p_false, is_right(error_of(a, truth[k]))) for k, a in answers.items() if a.p_false is not None and a.position_mm]
    found = []
    for low, high in pairwise(STEPS):
        inside = [(p, right) for p, right in pairs if low <= p < high or (high == STEPS[-1] and p >= high)]
        found.append((low, high, len(inside), float(sum(min(p, 1.0) for p, _ in inside)), sum(not right for _, right in inside)))
    return found


HEADER = (
    "| | located | wrong | µm p50 | p95 | ° p50 | p95 | NEES/3 | wrong as stated | ms p50 | p95 |",
    "|---|---|---|---|---|---|---|---|---|---|---|",
)


def line(name: str, row: Row) -> str:
    """A row of the table, as Markdown."""
    shown = [
        *(_shown(v, "{:.1f}") for v in (row.p50_um, row.p95_um)),
        *(_shown(v, "{:.3f}") for v in (row.p50_deg, row.p95_deg)),
        _shown(row.nees, "{:.2f}"),
        _shown(row.stated, "{:.1e}"),
        *(_shown(v, "{:.2f}") for v in (row.p50_ms, row.p95_ms)),
    ]
    return f"| {name} | {row.right} of {row.frames} | {row.wrong} | {' | '.join(shown)} |"


def calibration_lines(answers: Mapping[int, Answer], truth: Sequence[Truth]) -> list[str]:
    """The table of `calibration`, as Markdown; nothing where the method states no p_false."""
    rows = calibration(answers, truth)
    if not any(count for _, _, count, _, _ in rows):
        return []
    lines = ["| p_false | places | wrong at most, as stated | wrong |", "|---|---|---|---|"]
    return lines + [f"| {low:g} to {high:g} | {count} | {stated:.3g} | {wrong} |" for low, high, count, stated, wrong in rows]


def _shown(value: float | None, how: str) -> str:
    return "" if value is None else how.format(value)
