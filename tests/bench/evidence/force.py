"""Force: which patch a press makes (`hertz`), and whether such a contact is located.

What the gel of a GelSight Mini is like is from two public repositories, read at the commits named here. None of it was measured
for this page.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import exp, inf, log
from typing import Any

from scipy.optimize import brentq

from tactape_fab.sense import Scene
from tactape_fab.sense.decode.paper import locate_paper
from tests.bench.evidence.curves import LEAST_RATE, rate
from tests.bench.evidence.hertz import Gel, Patch, press, punch_depth_mm
from tests.bench.evidence.job import Job, Result, Size
from tests.bench.localization_measure import is_right, localizer_of
from tests.bench.localization_rows import Row, frames_of, registered_tape

SECTION = "force"
TITLE = "Force"
FORCES_N = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0)
PAPER_N = 2.0
METHODS = ("ours", "paper")
BODIES_MM: Mapping[str, tuple[float, float]] = {
    "flat block": (inf, inf),
    "cylinder of 30 mm": (inf, 30.0),
    "cylinder of 15.7 mm": (inf, 15.7),
    "ball of 40 mm": (40.0, 40.0),
    "ball of 20 mm": (20.0, 20.0),
}
"""Radii of what the tape lies on, along the image's width and its height."""


def _crown_mm(across_mm: float, falls_mm: float) -> float:
    """Radius of a crown that is lower by so much at so great a distance from its top."""
    return across_mm**2 / (2.0 * falls_mm)


# feats-ai/feats, src/calculix: obj/gelsight_mini/model/gelsight_mini.step (commit c52ac19) is 4 mm thick at its crown, 0.0953 mm
# lower 6 mm to the side and 0.0891 mm lower 4.5 mm up, and falls off in a rim outside of 19.4 x 15.1 mm;
# src/hyperelasticity_identification/templates/materials.inp (035fb9e) has a neo-Hookean C10 of 0.0725 MPa, half the shear modulus
_SHAPE: Mapping[str, Any] = {
    "thickness_mm": 4.0,
    "radii_mm": (_crown_mm(6.0, 0.0953), _crown_mm(4.5, 0.0891)),
    "face_mm": (19.4, 15.1),
}
_SHEAR_MPA = 2.0 * 0.0725
# GelSight-lab/EstimateModulus, tactile_estimate.py (commit 05a1380): 275 kPa from a durometer, and Poisson's ratio
_POISSON, _WEDGE_MPA = 0.485, 0.275
_SOFT = Gel(young_mpa=_WEDGE_MPA, poisson=_POISSON, **_SHAPE)
_STIFF = Gel(young_mpa=2.0 * _SHEAR_MPA * (1.0 + _POISSON), poisson=_POISSON, **_SHAPE)
GELS: Mapping[str, Gel] = {f"{1000.0 * gel.young_mpa:.0f} kPa": gel for gel in (_SOFT, _STIFF)}

# the same folder (035fb9e): bayesian-optimization.py has the forces at so many mm that the material is fitted to, and
# templates/all.msh a ball of 7.5 mm
BALL_MM = (7.5, 7.5)
PRESSES_N: Mapping[float, float] = {0.5: 1.6503, 1.0: 5.9641, 1.5: 13.5257, 2.0: 23.2532}
PRESSES = "presses of a ball"


def point(body: str, gel: str, force_n: float) -> str:
    """Name of a press."""
    return f"{body}, {gel}, {force_n:g} N"


def jobs(size: Size) -> list[Job]:
    """Every press, and the presses of the ball."""
    frames = max(size.frames // 2, 40)
    presses = [
        Job(
            section=SECTION,
            name=point(body, gel, force_n),
            measure=measure_press,
            options={"body": body, "gel": gel, "force_n": force_n, "frames": frames},
        )
        for body in BODIES_MM
        for gel in GELS
        for force_n in FORCES_N
    ]
    return [Job(section=SECTION, name=PRESSES, measure=measure_ball), *presses]


def scene_of(patch: Patch, gel: Gel) -> Scene:
    """A contact of this patch; parts imprint themselves as deep as punches that carry its pressure, at most as by default."""
    tape = registered_tape()
    length_mm, width_mm = tape.part.body_mm[:2]
    depth_mm = punch_depth_mm(patch.pressure_mpa * tape.pitch_mm**2, length_mm * width_mm, gel)
    return Scene(contact_mm=patch.axes_mm, dome_mm=patch.depth_mm, texture_mm=min(depth_mm, Scene().texture_mm))


def measure_press(body: str, gel: str, force_n: float, frames: int) -> Result:
    """The patch, and how many of its contacts both methods locate."""
    patch = press(force_n, BODIES_MM[body], GELS[gel])
    scene = scene_of(patch, GELS[gel])
    localizer, tapes = localizer_of(1, "open"), [registered_tape()]
    counts = {f"{method} {what}": 0 for method in METHODS for what in ("right", "wrong")}
    for frame in frames_of(Row(name=body, scenes=(scene,)), frames):
        for method, fix in (
            ("ours", localizer.locate(frame.depth)),
            ("paper", locate_paper(frame.depth, tapes, px_per_mm=16.0)[0]),
        ):
            if fix.located:
                counts[f"{method} {'right' if is_right(fix, frame) else 'wrong'}"] += 1
    return {
        "frames": frames,
        **counts,
        "axes_mm": list(patch.axes_mm),
        "depth_mm": patch.depth_mm,
        "pressure_kpa": 1000.0 * patch.pressure_mpa,
        "texture_mm": scene.texture_mm,
    }


def measure_ball() -> Result:
    """Force that presses of the ball take by the model, for each gel."""
    return {name: {f"{depth_mm:g}": force_to(depth_mm, gel) for depth_mm in PRESSES_N} for name, gel in GELS.items()}


def force_to(depth_mm: float, gel: Gel) -> float:
    """Force that presses the ball so deep."""

    def above(log_n: float) -> float:
        return press(exp(log_n), BALL_MM, gel).depth_mm - depth_mm

    return exp(float(brentq(above, log(0.01), log(100.0), rtol=1e-4)))


def least_force(results: Mapping[str, Result], body: str, gel: str, method: str) -> float | None:
    """Smallest force from which on, at all larger ones, enough contacts are located and right; None where there is none."""
    least = None
    for force_n in sorted(FORCES_N, reverse=True):
        if rate(results[point(body, gel, force_n)], f"{method} right") < LEAST_RATE:
            break
        least = force_n
    return least


def lines(results: Mapping[str, Result]) -> list[str]:
    """The section of the page."""
    soft, stiff = GELS
    frames = results[point("flat block", soft, PAPER_N)]["frames"]
    out = [
        f"## {TITLE}",
        "",
        "![Contacts located against force, for blocks, cylinders and balls](figures/evidence-force.png)",
        "",
        f"The smallest force with at least {100 * LEAST_RATE:g} % of the contacts located and right, at it and at every larger",
        f"one of {', '.join(f'{n:g}' for n in FORCES_N)} N, {frames} contacts each. What the tape lies on is",
        "pressed on the crown of a GelSight Mini's gel, soft or stiff; the patch is that at the paper's 2 N, by the model:",
        "",
        f"| radius of what is under the tape | patch at 2 N, {soft} | {stiff} | least force, {soft}: ours | the paper's method "
        f"| {stiff}: ours | the paper's method |",
        "|---|---|---|---|---|---|---|",
    ]
    for body in BODIES_MM:
        patches = [_size(results[point(body, gel, PAPER_N)]) for gel in GELS]
        found = [least_force(results, body, gel, method) for gel in GELS for method in METHODS]
        said = ["none" if force is None else f"{force:g} N" for force in found]
        out.append(f"| {' | '.join([body, *patches, *said])} |")
    return [
        *out,
        "",
        f"Wrong answers: {_wrong(results, 'ours')} of ours, {_wrong(results, 'paper')} of the paper's method. The paper",
        "states 2 N, for a flat block, and 15.7 mm.",
        "",
        *_model(results),
        "",
    ]


def _model(results: Mapping[str, Result]) -> list[str]:
    """What is model in all this, what it was made of, and the presses beside it."""
    soft, stiff = GELS
    out = [
        "**This is a model, and no force was measured here.** Linear elasticity gives the patch: a smooth rigid body on a bonded",
        "layer of the gel's thickness and crown, without friction; parts sink in as small punches that carry the mean",
        "pressure, at most as deep as in the default scene; what a frame looks like then is simulated as all on this page.",
        "Stiffness of the film, sliding, tilt of the body, and what cylinders and balls hide on their flanks are left out.",
        f"Thickness, crown and the stiffer modulus ({stiff}) are from the CAD file and the fitted material of FEATS",
        "([feats-ai/feats](https://github.com/feats-ai/feats), `src/calculix`, for the GelSight Mini); the softer one",
        f"({soft}), and Poisson's ratio {_POISSON:g} for both, from",
        "[EstimateModulus](https://github.com/GelSight-lab/EstimateModulus) (`tactile_estimate.py`, another gel, by durometer).",
        "FEATS fitted its material, by finite elements, to the forces that presses of a ball of 7.5 mm took; nothing was fitted",
        "here:",
        "",
        "| pressed in, mm | FEATS, N | " + " | ".join(f"model, {name}, N" for name in GELS) + " |",
        "|---" * (2 + len(GELS)) + "|",
    ]
    for depth_mm, force_n in PRESSES_N.items():
        modelled = [f"{results[PRESSES][name][f'{depth_mm:g}']:.2f}" for name in GELS]
        out.append(f"| {depth_mm:g} | {force_n:.2f} | {' | '.join(modelled)} |")
    return out


def _size(found: Result) -> str:
    return "{:.1f} x {:.1f} mm".format(*found["axes_mm"])


def _wrong(results: Mapping[str, Result], method: str) -> str:
    presses = [found for name, found in results.items() if name != PRESSES]
    return f"{sum(found[f'{method} wrong'] for found in presses)} of {sum(found['frames'] for found in presses):,}"


def pictures(results: Mapping[str, Result]) -> dict[str, Any]:
    """Plots by file name."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.2), layout="constrained")
    colours = ("#000000", "#0072b2", "#56b4e9", "#d55e00", "#e69f00")
    for axes, gel in zip(figure.subplots(1, 2, sharey=True), GELS, strict=True):
        for body, colour in zip(BODIES_MM, colours, strict=True):
            points = [results[point(body, gel, force_n)] for force_n in FORCES_N]
            for method, style in (("ours", "o-"), ("paper", "^--")):
                shares = [100.0 * rate(found, f"{method} right") for found in points]
                axes.plot(FORCES_N, shares, style, color=colour, label=body, markersize=4, linewidth=1.2)
        axes.axvline(PAPER_N, color="#999999", linestyle=":")
        axes.set_xscale("log")
        axes.set_xticks((0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0), ("0.05", "0.1", "0.2", "0.5", "1", "2", "5"))
        axes.set_title(f"gel of {gel}")
        axes.set_xlabel("force, N")
        axes.set_ylim(-3, 103)
        axes.grid(alpha=0.3)
    axes = figure.axes[0]
    axes.set_ylabel("located and right, %")
    handles = axes.get_legend_handles_labels()[0][::2]
    title = "solid: ours, open world\ndashed: the paper's method\ndotted: the paper's 2 N"
    figure.legend(handles, BODIES_MM, loc="outside right center", frameon=False, title=title)
    return {"evidence-force.png": figure}
