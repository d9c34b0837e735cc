"""Table I of the paper in simulation: the sensor is moved along x, along y and turned, and the answers are regressed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

import numpy as np

from tactape_fab import Localization
from tactape_fab.sense import Parts, Scene, simulate
from tactape_fab.sense.decode.paper import locate_paper
from tactape_fab.sense.simulation.parts import parts_of, scattered
from tactape_fab.texture.frames import FloatArray
from tests.bench.evidence.job import Job, Result, Size
from tests.bench.localization_measure import localizer_of
from tests.bench.localization_rows import SEED, registered_tape

SECTION = "table I"
AXES = {"x": np.arange(21) * 0.5, "y": np.arange(21) * 0.5, "theta": np.arange(21) * 4.0}
"""Paper, IV-A: 0.5 mm steps, 4 degrees."""
MOUNTED_DEG = 1.5
"""No sensor is mounted exactly square; whole pixels beside whole steps would flatter both methods."""
DEFAULT_NOISE_UM, REAL_NOISE_UM = 7.1, 4.3
"""rms after the high-pass: of the default scene's noise, and of a real frame of a GelSight Mini without contact."""
LEVELS: Mapping[str, tuple[float, float]] = {
    "ideal": (0.0, 0.0),
    "real noise": (REAL_NOISE_UM / DEFAULT_NOISE_UM, 0.0),
    "pessimistic": (1.0, 0.0),
    "real noise, placement 0.05 mm": (REAL_NOISE_UM / DEFAULT_NOISE_UM, 0.05),
}
"""Factor on the default scene's noise, and standard deviation of the parts' places (mm)."""
METHODS = ("ml", "paper")
PAPER = {
    "x": {"r2": 0.999, "slope": 0.997, "intercept": 0.052, "rse": 0.063, "rmse": 0.092},
    "y": {"r2": 0.997, "slope": 0.988, "intercept": 0.004, "rse": 0.170, "rmse": 0.184},
    "theta": {"r2": 0.999, "slope": 1.005, "intercept": -0.260, "rse": 0.598, "rmse": 0.610},
}
"""The paper's table I: hardware, its own method."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Regression:
    """Answers over true values, as the paper's table I has them.

    Attributes
    ----------
    r2, slope, intercept, rse : float
        Of the least-squares line; `rse` is the residual standard error, n - 2 degrees of freedom.
    rmse : float
        Of the answers less the true values.
    """

    r2: float
    slope: float
    intercept: float
    rse: float
    rmse: float


def regression(true: FloatArray, answered: FloatArray) -> Regression:
    """Regress answers (n,) on true values (n,)."""
    slope, intercept = np.polyfit(true, answered, 1)
    residual = answered - (slope * true + intercept)
    about_mean = answered - answered.mean()
    return Regression(
        r2=float(1.0 - residual @ residual / (about_mean @ about_mean)),
        slope=float(slope),
        intercept=float(intercept),
        rse=float(np.sqrt(residual @ residual / (len(true) - 2))),
        rmse=float(np.sqrt(np.mean((answered - true) ** 2))),
    )


def jobs(size: Size) -> list[Job]:
    """All axes on all levels."""
    return [
        Job(
            section=SECTION,
            name=f"{level}, {axis}",
            measure=measure,
            options={"level": level, "axis": axis, "trials": size.trials},
        )
        for level in LEVELS
        for axis in AXES
    ]


def measure(level: str, axis: str, trials: int) -> Result:
    """Both methods on the same contacts of one axis.

    The parts of the tape stand where they stand for all contacts, as on a tape that was assembled once.
    """
    noise, placement_mm = LEVELS[level]
    tape, scene = registered_tape(), Scene(noise=noise)
    parts = _assembled(placement_mm)
    start = (np.array([tape.columns - 1, tape.rows - 1]) * tape.pitch_mm - 10.0) / 2
    true = np.repeat(AXES[axis], trials)
    answers: dict[str, list[float]] = {method: [] for method in METHODS}
    for k, value in enumerate(true.tolist()):
        xy = start + value * np.array([axis == "x", axis == "y"])
        theta_deg = MOUNTED_DEG + (value if axis == "theta" else 0.0)
        depth = simulate(tape, xy.tolist(), theta_deg, scene=scene, seed=SEED + k, parts=parts)
        for method, locate in _methods().items():
            answers[method].append(_value(locate(depth), axis, start))
    return {"frames": len(true)} | {method: _described(true, np.array(found)) for method, found in answers.items()}


@cache
def _methods() -> dict[str, Callable[[Any], Localization]]:
    localizer, tapes = localizer_of(1, "open"), [registered_tape()]
    return {"ml": localizer.locate, "paper": lambda depth: locate_paper(depth, tapes, px_per_mm=16.0)[0]}


def _assembled(placement_mm: float) -> Parts:
    parts, _ = scattered(parts_of(registered_tape()), Scene(placement_mm=placement_mm), np.random.default_rng(SEED))
    return parts


def _value(fix: Localization, axis: str, start: FloatArray) -> float:
    """What an answer says on an axis, where the first pose is 0; NaN without one."""
    if not fix.located or fix.position_mm is None or fix.theta_deg is None:
        return float("nan")
    if axis == "theta":
        return (fix.theta_deg - MOUNTED_DEG + 90.0) % 360.0 - 90.0
    along = 0 if axis == "x" else 1
    return float(fix.position_mm[along] - start[along])


def _described(true: FloatArray, answered: FloatArray) -> Result:
    known = np.isfinite(answered)
    if known.sum() < 3:
        return {"located": int(known.sum())}
    return {"located": int(known.sum()), **asdict(regression(true[known], answered[known]))}


def lines(results: Mapping[str, Result]) -> list[str]:
    """The section of the page."""
    out = [
        "## Table I: position and angle",
        "",
        "The sensor is moved by 0.5 mm along x and y, and turned by 4°, as in the paper; answers are regressed on true values.",
        "`rse` is the residual standard error, `rmse` the error itself (mm, or degrees for θ). The first rows are the paper's",
        "own, from hardware. Simulation has no gel that shears, no stage and no sensor mounted askew: what these add is in the",
        "paper's figures and in none of ours, so our rows compare the methods with each other, not with the paper's rows.",
        "",
        "| noise | axis | method | located | R² | slope | intercept | rse | rmse |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    names = {"x": "x", "y": "y", "theta": "θ"}
    for axis in AXES:
        out.append(f"| hardware (paper) | {names[axis]} | paper | | {' | '.join(f'{v:.3f}' for v in PAPER[axis].values())} |")
    for level in LEVELS:
        for axis in AXES:
            found = results[f"{level}, {axis}"]
            for method in METHODS:
                one, of = found[method], found["frames"]
                figures = _figures(one) if "rse" in one else " | | | | "
                out.append(f"| {level} | {names[axis]} | {method} | {one['located']} of {of} | {figures} |")
    return [*out, ""]


def _figures(values: Mapping[str, float]) -> str:
    fit = f"{values['r2']:.6f} | {values['slope']:.5f} | {values['intercept']:.4f}"
    return f"{fit} | {values['rse']:.4f} | {values['rmse']:.4f}"
