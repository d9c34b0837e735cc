"""Success against what makes a contact hard, for both methods, with the information limit beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tactape_fab.sense import Scene
from tests.bench.evidence.job import Job, Result, Size
from tests.bench.localization_measure import measure
from tests.bench.localization_rows import Row

SECTION = "curves"
TITLE = "What makes a contact hard"
LEAST_RATE = 0.99
"""Share of contacts that the paper, and this page, call enough."""
METHODS = {"open": "ours, open world", "closed": "ours, closed world", "paper": "the paper's method"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """One thing that grows while all else is the default scene.

    Attributes
    ----------
    title, unit : str
    option : str
        Attribute of `Scene`; "contact" for the side of a square contact, "strip" for a cylinder's radius.
    values : tuple of float
    falling : bool
        Whether contacts get harder as the value falls.
    """

    title: str
    unit: str
    option: str
    values: tuple[float, ...]
    falling: bool = False


CURVES = (
    Curve(
        title="contact size", unit="mm", option="contact", values=(5.0, 5.5, 6.0, 6.5, 7.0, 8.0, 9.0, 10.0, 12.0), falling=True
    ),
    Curve(title="parts missing", unit="share", option="missing", values=(0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)),
    Curve(title="noise", unit="x default", option="noise", values=(0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)),
    Curve(title="elastomer blur", unit="mm", option="elastomer_mm", values=(0.1, 0.15, 0.2, 0.25, 0.3, 0.35)),
    Curve(title="placement", unit="mm", option="placement_mm", values=(0.0, 0.025, 0.05, 0.075, 0.1, 0.15)),
    Curve(title="scale off, not told", unit="share", option="scale_error", values=(-0.08, -0.06, -0.03, 0.0, 0.03, 0.06, 0.08)),
    Curve(
        title="cylinder radius",
        unit="mm",
        option="strip",
        values=(4.0, 5.0, 6.0, 8.0, 10.0, 12.5, 15.7, 20.0, 30.0),
        falling=True,
    ),
)


def scene_of(option: str, value: float) -> Scene:
    """The default scene with one thing changed; a strip is as wide as the cylinder is where the gel meets it."""
    if option == "contact":
        return Scene(contact_mm=(value, value))
    if option == "strip":
        return Scene(contact="strip", cylinder_radius_mm=value)
    return Scene().changed({option: value})


def jobs(size: Size) -> list[Job]:
    """Every point of every curve."""
    return [
        Job(
            section=SECTION,
            name=f"{curve.title} {value:g}",
            measure=measure_point,
            options={"option": curve.option, "value": value, "frames": size.frames},
        )
        for curve in CURVES
        for value in curve.values
    ]


def measure_point(option: str, value: float, frames: int) -> Result:
    """Figures of both worlds and of the paper's method on the same contacts."""
    scale = None if option == "scale_error" else 16.0  # the paper's Eq. 14-16 where the scale is not known
    row = Row(name=option, scenes=(scene_of(option, value),), paper_scale=scale)
    figures = measure(row, frames)
    kept = ("frames", "right", "wrong", "limit", "position_um", "theta_deg", "lost")
    return {name: {key: getattr(found, key) for key in kept} for name, found in figures.items()}


def rate(found: Mapping[str, Any], key: str = "right") -> float:
    """Share of the contacts."""
    return float(found[key]) / float(found["frames"])


def bound(curve: Curve, results: Mapping[str, Result], method: str) -> float | None:
    """Hardest value up to which, from the easiest on, enough contacts are located and right; None where that is none."""
    kept = None
    for value in sorted(curve.values, reverse=curve.falling, key=abs if not curve.falling else None):
        if rate(results[f"{curve.title} {value:g}"][method]) < LEAST_RATE:
            break
        kept = value
    return kept


def lines(results: Mapping[str, Result]) -> list[str]:
    """The section of the page."""
    out = [
        f"## {TITLE}",
        "",
        "![Success against size, missing parts, noise, blur, placement, scale and curvature](figures/evidence-curves.png)",
        "",
        "Contacts located and right, of those simulated, all at poses of a low-discrepancy sequence; thin, what the same rule",
        "makes of error-free symbols of the dots that are imprinted by 0.3 or more. That is no bound: dots of less imprint say",
        f"something, too. The hardest value with at least {100 * LEAST_RATE:g} % of the contacts:",
        "",
        "| | " + " | ".join(METHODS.values()) + " | wrong answers |",
        "|---" * (len(METHODS) + 2) + "|",
    ]
    for curve in CURVES:
        found = [bound(curve, results, method) for method in METHODS]
        said = ["none" if value is None else f"{value:g} {curve.unit}" for value in found]
        out.append(f"| {curve.title} | {' | '.join(said)} | {_wrong([curve], results)} |")
    out += [
        "",
        "The paper states a smallest radius of curvature of 15.7 mm, and a success rate above 99 % given sufficient input.",
        "Of the contacts that the paper's method loses, most are lost at these steps: " + _lost(results) + ".",
        "",
        *_detached(results),
    ]
    return out


def _detached(results: Mapping[str, Result]) -> list[str]:
    """What parts that are missing cost, against the paper's word of it."""
    said = []
    for share in (0.02, 0.05, 0.1):
        point = results[f"{CURVES[1].title} {share:g}"]
        said.append(f"{100 * share:g} %: {100 * rate(point['open']):.0f} % and {100 * rate(point['paper']):.0f} %")
    return [
        "The paper says that parts which detach lead to a marginal decrease in decoding success only, owing to its redundancy.",
        "That does not hold for its own method, which reads windows of 4x4 in one square of 5x5: with one part in fifty gone,",
        "two in five of these squares have a gap. Located and right, ours and the paper's, with so many parts missing:",
        "; ".join(said) + ".",
        "",
    ]


def _wrong(curves: Sequence[Curve], results: Mapping[str, Result]) -> str:
    points = [results[f"{curve.title} {value:g}"] for curve in curves for value in curve.values]
    counts = {method: sum(point[method]["wrong"] for point in points) for method in METHODS}
    frames = sum(point["open"]["frames"] for point in points)
    return f"{counts['open']}, {counts['closed']}, {counts['paper']} of {frames}"


def _lost(results: Mapping[str, Result]) -> str:
    steps: dict[str, int] = {}
    for point in results.values():
        for step, count in (point["paper"]["lost"] or {}).items():
            steps[step] = steps.get(step, 0) + count
    whole = sum(steps.values())
    most = sorted(steps.items(), key=lambda item: -item[1])[:4]
    return ", ".join(f"{step} ({100 * count / whole:.0f} %)" for step, count in most) if whole else "none"


def pictures(results: Mapping[str, Result]) -> dict[str, Any]:
    """Plots by file name."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 6.2), layout="constrained")
    grid = figure.subplots(2, 4)
    style = {  # the closed world as a broad band, so that the open one shows where both are the same
        "closed": {"color": "#8fd3bd", "linewidth": 6.0},
        "open": {"color": "#0072b2", "linewidth": 1.5, "marker": "o", "markersize": 4},
        "paper": {"color": "#d55e00", "linewidth": 1.5, "marker": "^", "markersize": 5},
    }
    limits = {"closed": {"color": "#2f8f72", "linestyle": ":"}, "open": {"color": "#0072b2", "linestyle": "--"}}
    for axes, curve in zip(grid.flat, CURVES, strict=False):
        points = [results[f"{curve.title} {value:g}"] for value in curve.values]
        for method, look in style.items():
            axes.plot(curve.values, [100 * rate(p[method]) for p in points], label=METHODS[method], **look)
        for method, thin in limits.items():
            axes.plot(curve.values, [100 * rate(p[method], "limit") for p in points], linewidth=1.0, **thin)
        axes.set_title(curve.title)
        axes.set_xlabel(curve.unit)
        axes.set_ylim(-3, 103)
        axes.grid(alpha=0.3)
    for axes in grid[:, 0]:
        axes.set_ylabel("located and right, %")
    grid.flat[-1].axis("off")
    handles, labels = grid.flat[0].get_legend_handles_labels()
    title = "thin: error-free symbols,\nopen world (dashed), closed (dotted)"
    grid.flat[-1].legend(handles, labels, loc="center", frameon=False, title=title)
    return {"evidence-curves.png": figure}
