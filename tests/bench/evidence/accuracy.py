"""Accuracy against two bounds, that of the dots and that of the pixels, and against the paper's Eq. 17 and 18."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees, sqrt

import numpy as np

from tactape_fab import Localizer
from tactape_fab.sense import Scene, draw_poses, load_sensor
from tactape_fab.texture.frames import FloatArray
from tests.bench.evidence.job import Job, Result, Size
from tests.bench.localization_accuracy import PX_PER_MM, accuracy_of
from tests.bench.localization_rows import SEED, Row, plane_gel, registered_tape
from tests.bench.pixel_bound import BOUND_POSES, UNITS, PixelRow, bound_of

SECTION = "accuracy"
SCENES: Mapping[str, Scene] = {
    "default scene": Scene(),
    "without noise": Scene(noise=0.0),
    "twice the noise": Scene(noise=2.0),
    "contact 7x7 mm": Scene(contact_mm=(7.0, 7.0)),
    "contact at (4, 3) mm": Scene(contact_offset_mm=(4.0, 3.0)),
    "placement 0.05 mm": Scene(placement_mm=0.05),
    "placement 0.1 mm": Scene(placement_mm=0.1),
}
PAIR_MM = 8.0
"""Distance D of the paper's two dots, Eq. 17: about as far as two dots of one line are apart in its contacts."""


def jobs(size: Size) -> list[Job]:
    """One for each scene."""
    return [
        Job(section=SECTION, name=name, measure=measure_scene, options={"name": name, "frames": size.frames}) for name in SCENES
    ]


def measure_scene(name: str, frames: int) -> Result:
    """Errors in one scene by dots and by pixels, their bounds, and what the paper's equations give for the same dots."""
    row = Row(name=name, scenes=(SCENES[name],))
    found = accuracy_of(Localizer([registered_tape()], plane_gel()), row, frames)
    refined = accuracy_of(Localizer([registered_tape()], plane_gel(), refine="pixels"), row, frames)
    dot_px = float(found.dot_px[-1])  # of wholly imprinted dots
    return {
        "frames": found.frames,
        "position_um": _um(found.rms),
        "theta_deg": float(found.rms[2]),
        "position_ratio": _um(found.rms) / _um(found.bound),
        "theta_ratio": float(found.ratio[2]),
        "nees": found.nees,
        "dot_px": dot_px,
        "paper_position_um": 1000.0 * dot_px / PX_PER_MM,
        "paper_theta_deg": degrees(2.0 * dot_px / (PAIR_MM * PX_PER_MM)),
        "pixels": {"position_um": _um(refined.rms), "theta_deg": float(refined.rms[2]), "nees": refined.nees},
        "pixel_bound": _pixel_bound(SCENES[name]),
    }


def _um(errors: FloatArray) -> float:
    """Of x and y, root mean square of both."""
    return float(np.hypot(errors[0], errors[1]) / sqrt(2))


def _pixel_bound(scene: Scene) -> Result | None:
    """The least error of a scene by its pixels, on the mean of some poses; none without noise."""
    slope = (load_sensor("gelsight-mini").slope_noise or 0.0) * scene.noise
    if slope == 0.0:
        return None
    options = {"contact_mm": scene.contact_mm, "contact_offset_mm": scene.contact_offset_mm}
    row = PixelRow(name="", scene=options, slope=slope)
    poses = draw_poses(registered_tape(), BOUND_POSES, SEED, scene=scene)
    bound = np.sqrt(np.mean([np.diag(bound_of(pose, row)) for pose in poses], axis=0)) * UNITS
    return {"position_um": _um(bound), "theta_deg": float(bound[2])}


def lines(results: Mapping[str, Result]) -> list[str]:
    """The section of the page."""
    out = [
        "## How near to the bound",
        "",
        "Errors (rms) of contacts located and right, by the dots' centres and by the pixels around them (`--refine pixels`),",
        "in µm and degrees, beside two Cramér–Rao bounds. That of the **dots** takes each dot for what its centre says, with",
        "the error that it has here, and the camera as known. It is none for the fit, which knows that neighbours push each",
        "other's centres, a part of that error. That of the **pixels** holds for every method that sees the frame alone:",
        "noise, blur, imprint and camera are known to it, and parts stand where they should. No decoder knows all that: an",
        "unknown shear alone makes the angle 1.5 to 1.8 times less exact. Parts that are off their places err beyond both",
        "bounds. `nees` is the mean error squared over the covariance that was said, 1 where that is true.",
        "",
        "| | contacts | a dot, px | by dots | nees | bound of the dots | by pixels | nees | bound of the pixels |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    shown = {name: results[name] for name in SCENES if name in results}
    for name, one in shown.items():
        dots = {"position_um": one["position_um"] / one["position_ratio"], "theta_deg": one["theta_deg"] / one["theta_ratio"]}
        pixels, bound = one.get("pixels"), one.get("pixel_bound")
        out.append(
            f"| {name} | {one['frames']} | {one['dot_px']:.2f} | {_pair(one)} | {one['nees']:.2f} | {_pair(dots)} "
            f"| {_pair(pixels)} | {'' if pixels is None else format(pixels['nees'], '.2f')} | {_pair(bound)} |"
        )
    return [*out, "", *_equations(shown)]


def _pair(one: Mapping[str, float] | None) -> str:
    return "" if one is None else f"{one['position_um']:.2f}, {one['theta_deg']:.3f}"


def _equations(results: Mapping[str, Result]) -> list[str]:
    """Eq. 17 and 18 of the paper, derived, and what they give."""
    out = [
        "The paper's Eq. 17 takes the angle from two dots that are d = D·R pixels apart, σ_θ ≈ 2σ/d, and Eq. 18 the place",
        "from one, σ_s ≈ σ/R. The angle of the line through two dots is the difference of their errors across it, over d; of",
        "two independent errors of σ that has the variance 2σ², so **σ_θ = √2 σ/d**: the paper's 2σ/d adds both errors as if",
        "they were one. Of n dots at distances r_i from their middle it is σ_θ = σ/(R·√Σr_i²), and the place under their",
        f"middle σ/(R·√n). For dots as above, two of them {PAIR_MM:g} mm apart, or one:",
        "",
        "| | Eq. 17, ° | √2 σ/d, ° | all dots, ° | Eq. 18, µm | all dots, µm |",
        "|---|---|---|---|---|---|",
    ]
    for name, one in results.items():
        out.append(
            f"| {name} | {one['paper_theta_deg']:.3f} | {one['paper_theta_deg'] / sqrt(2):.3f} | {one['theta_deg']:.3f} "
            f"| {one['paper_position_um']:.1f} | {one['position_um']:.1f} |"
        )
    return [*out, ""]
