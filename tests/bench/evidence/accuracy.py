"""Accuracy against the least error that any method could have with the same dots, and against the paper's Eq. 17 and 18."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees

import numpy as np

from tactape_fab.sense import Scene
from tests.bench.evidence.job import Job, Result, Size
from tests.bench.localization_accuracy import PX_PER_MM, accuracy_of
from tests.bench.localization_measure import localizer_of
from tests.bench.localization_rows import Row

SECTION = "accuracy"
SCENES: Mapping[str, Scene] = {
    "default scene": Scene(),
    "without noise": Scene(noise=0.0),
    "twice the noise": Scene(noise=2.0),
    "contact 7x7 mm": Scene(contact_mm=(7.0, 7.0)),
    "placement 0.05 mm": Scene(placement_mm=0.05),
}
PAIR_MM = 8.0
"""Distance D of the paper's two dots, Eq. 17: about as far as two dots of one line are apart in its contacts."""


def jobs(size: Size) -> list[Job]:
    """One for each scene."""
    return [
        Job(section=SECTION, name=name, measure=measure_scene, options={"name": name, "frames": size.frames}) for name in SCENES
    ]


def measure_scene(name: str, frames: int) -> Result:
    """Errors in one scene, their bound, and what the paper's equations give for the same dots."""
    found = accuracy_of(localizer_of(1, "open"), Row(name=name, scenes=(SCENES[name],)), frames)
    dot_px = float(found.dot_px[-1])  # of wholly imprinted dots
    return {
        "frames": found.frames,
        "position_um": float(np.hypot(*found.rms[:2]) / np.sqrt(2)),
        "theta_deg": float(found.rms[2]),
        "position_ratio": float(np.hypot(*found.rms[:2]) / np.hypot(*found.bound[:2])),
        "theta_ratio": float(found.ratio[2]),
        "nees": found.nees,
        "dot_px": dot_px,
        "paper_position_um": 1000.0 * dot_px / PX_PER_MM,
        "paper_theta_deg": degrees(2.0 * dot_px / (PAIR_MM * PX_PER_MM)),
    }


def lines(results: Mapping[str, Result]) -> list[str]:
    """The section of the page."""
    out = [
        "## How near to the bound",
        "",
        "Errors (rms) of contacts located and right; over the Cramér–Rao bound for the dots' own error and a known scale; and",
        "what the paper's Eq. 17 and 18 give for the same dots, where the angle comes from two of them 8 mm apart and the place",
        "from one. `nees` is the mean error squared over the covariance that was reported, 1 where that is calibrated.",
        "",
        "| | contacts | a dot, px | place, µm | over bound | Eq. 18, µm | angle, ° | over bound | Eq. 17, ° | nees |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name in SCENES:
        one = results[name]
        out.append(
            f"| {name} | {one['frames']} | {one['dot_px']:.2f} | {one['position_um']:.1f} | {one['position_ratio']:.2f} "
            f"| {one['paper_position_um']:.1f} | {one['theta_deg']:.3f} | {one['theta_ratio']:.2f} "
            f"| {one['paper_theta_deg']:.2f} | {one['nees']:.2f} |"
        )
    return [*out, ""]
