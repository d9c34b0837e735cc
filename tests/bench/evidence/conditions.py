"""Whether the covariance of an answer is true: errors against it in many kinds of contacts, row by row as `tests.bench.nees`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from tests.bench.evidence.job import Job, Result, Size
from tests.bench.nees import ROWS, figures_of

SECTION = "conditions"
TITLE = "Is the covariance true?"
RANGE = (0.8, 1.3)
"""NEES/3 within it counts as true."""


def jobs(size: Size) -> list[Job]:
    """One for each row."""
    return [
        Job(section=SECTION, name=row.name, measure=measure_row, options={"name": row.name, "frames": size.frames})
        for row in ROWS
    ]


def measure_row(name: str, frames: int) -> Result:
    """Figures of a row, poses fitted to dots."""
    (row,) = (row for row in ROWS if row.name == name)
    return asdict(figures_of(row, frames, "dots"))


def lines(results: Mapping[str, Result]) -> list[str]:
    """The section of the page."""
    off = [name for name, one in results.items() if not RANGE[0] <= one["nees"] <= RANGE[1]]
    out = [
        f"## {TITLE}",
        "",
        "The decoder has the stock profile of a GelSight Mini in every row, whatever the truth is, but for the size of the gel's",
        "displacement, and its crown, which this scene has not. `nees` is the mean of eᵀ C⁻¹ e / 3 over the answers that are",
        "right, with e the error of (x, y, θ) and C the covariance that was said: 1 where that is true; of N answers it scatters",
        "by √(2 / 3N). Of true ones 5 % are beyond the last column's limit. Places are of the point under the image centre, so a",
        "contact off it adds its distance times the angle's error. A tilt of this scene is a slope of the background, which the",
        "filter takes out: see [both simulators](#two-simulators-side-by-side) for bodies that are tilted.",
        "",
        "| | contacts | located | wrong | place, µm | angle, ° | nees | beyond 95 % |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, one in results.items():
        out.append(
            f"| {name} | {one['frames']} | {one['right']} | {one['wrong']} | {one['position_um']:.1f} | {one['theta_deg']:.3f} "
            f"| {one['nees']:.2f} | {100 * one['beyond']:.1f} % |"
        )
    said = "All rows" if not off else f"All rows but {', '.join(off)}"
    return [*out, "", f"{said} are from {RANGE[0]:g} to {RANGE[1]:g}.", ""]
