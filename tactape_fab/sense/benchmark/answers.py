"""Answers of any method as lines of JSON: `decode --json` prints such lines, and other programs can."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base.errors import Problem, SpecError, reason_of, refuse
from tactape_fab.base.fields import Fields, shown, shown_path
from tactape_fab.base.input_file import begins_with, open_regular
from tactape_fab.base.json_text import parse_json
from tactape_fab.sense.sensors import MOST_FRAMES
from tactape_fab.texture.frames import FloatArray

FORMAT = "tactape-answers/1"
MOST_LINE_BYTES = 1 << 20
_MOST_PROBLEMS = 10
FARTHEST_MM, MOST_SECTOR = 1e7, 10**9


def is_answers(path: Path) -> bool:
    """Whether a file begins as one of answers does. Raises OSError."""
    return begins_with(path, json.dumps({"format": FORMAT})[:-1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """A method's answer for one frame; what it does not say is None.

    position_mm: Texture point under the image centre, texture frame.
    covariance (3, 3): Of (x mm, y mm, theta rad).
    p_false: The chance that it is wrong, as the method says it.
    """

    located: bool = False
    tape: str | None = None
    sector: int | None = None
    position_mm: tuple[float, float] | None = None
    theta_deg: float | None = None
    covariance: FloatArray | None = None
    p_false: float | None = None
    elapsed_ms: float | None = None


def read_answers(path: str | Path, frames: int) -> tuple[str, dict[int, Answer]]:
    """The name of a method and its answers by frame; a frame without one is not located.

    path: Lines of JSON, one for each frame: frame, located; where located tape or sector, position_mm, theta_deg; optional are
        covariance, p_false, elapsed_ms; other keys are not looked at. The first line may name the format and the method.
    frames: Frames of the data set.
    Raises SpecError with the first problems of the file.
    """
    path, problems = Path(path), list[Problem]()
    method, found = path.name.partition(".")[0], dict[int, Answer]()
    try:
        with open_regular(path) as stream:
            for number in range(1, MOST_FRAMES + 2):
                line = stream.readline(MOST_LINE_BYTES + 1)
                if not line or len(problems) >= _MOST_PROBLEMS:
                    break
                try:
                    if len(line) > MOST_LINE_BYTES:
                        raise ValueError(f"it is longer than {MOST_LINE_BYTES} bytes")
                    content = parse_json(line)
                    if not isinstance(content, dict):
                        raise ValueError("it is no JSON object")
                    if number == 1 and content.get("format") == FORMAT:
                        method = str(content.get("method", method))[:100]
                        continue
                    frame, answer = _answer(content, frames)
                    if frame in found:
                        raise ValueError(f"frame {frame} stands there twice")
                    found[frame] = answer
                except ValueError as error:
                    problems.append(Problem("answers", f"{shown_path(path)}, line {number}: {error}"))
    except OSError as error:
        message = f"{shown_path(path)} cannot be read: {reason_of(error)}; give lines of JSON, as decode --json prints them"
        raise SpecError(Problem("answers", message)) from error
    refuse(problems)
    return method, found


def _answer(content: Mapping[str, Any], frames: int) -> tuple[int, Answer]:
    """Frame and answer of a line. Raises ValueError."""
    given = {key: value for key, value in content.items() if value is not None}
    table = Fields(given)
    frame = table.integer("frame", low=0, high=frames - 1)
    located = table.flag("located")
    position = tuple(table.numbers("position_mm", 2, low=-FARTHEST_MM, high=FARTHEST_MM)) if "position_mm" in given else None
    theta = table.number("theta_deg", low=-1e6, high=1e6, unit="deg") if "theta_deg" in given else None
    tape = table.text("tape") if "tape" in given else None
    sector = table.integer("sector", low=0, high=MOST_SECTOR) if "sector" in given else None
    p_false = table.number("p_false", low=0.0, high=float("inf"), unit="") if "p_false" in given else None
    elapsed = table.number("elapsed_ms", low=0.0, high=1e9, unit="ms") if "elapsed_ms" in given else None
    if located and (position is None or theta is None or (tape is None and sector is None)):
        table.problem("located", "it is located, and position_mm, theta_deg, or both tape and sector are not given")
    covariance = _covariance(given["covariance"], table) if "covariance" in given else None
    if table.problems:
        raise ValueError("; ".join(problem.message for problem in table.problems))
    return frame, Answer(
        located=located,
        tape=tape,
        sector=sector,
        position_mm=position,  # type: ignore[arg-type]
        theta_deg=theta,
        covariance=covariance,
        p_false=p_false,
        elapsed_ms=elapsed,
    )


def _covariance(value: object, table: Fields) -> FloatArray | None:
    """A covariance that has an inverse."""
    try:
        matrix = np.array(value, dtype=np.float64)
        if matrix.shape == (3, 3) and np.isfinite(matrix).all() and np.allclose(matrix, matrix.T):
            np.linalg.cholesky(matrix)
            return matrix
    except (TypeError, ValueError, OverflowError, np.linalg.LinAlgError):
        pass
    table.problem("covariance", f"covariance = {shown(value)} is no positive definite matrix of 3 by 3; leave it out")
    return None
