"""How long a tape's files take, against other libraries in the same run, and how that grows with the number of parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import Any

import numpy as np

from tests.bench.evidence.fabrication_measure import (
    ASSEMBLY,
    COPPER,
    KIT,
    LIBRARIES,
    ONLY_STL,
    ONLY_THREEMF,
    SOLID,
    STL,
    THREEMF,
    US,
    measure_copper,
    measure_kit,
    measure_models,
    measure_processes,
)
from tests.bench.evidence.job import Job, Result, Size

SECTION = "fabrication"
SIZES = (500, 1_000, 2_000, 10_000, 50_000, 200_000)
WRITERS_MOST, UNION_MOST, KERNEL_MOST = 50_000, 10_000, 2_000
"""Parts of the largest tape that the others write: some seconds each, for a CAD kernel a minute."""
FILES = (COPPER, SOLID, ASSEMBLY, STL, THREEMF, ONLY_STL, ONLY_THREEMF, KIT)
PLOTTED = (COPPER, SOLID, ASSEMBLY, STL, THREEMF, KIT)
STYLES = {
    US: ("#0072b2", "o"),
    "build123d": ("#d55e00", "^"),
    "gerber_writer": ("#cc79a7", "D"),
    "gerbonara": ("#009e73", "s"),
    "gerbonara, pads with sharp corners": ("#56b4e9", "v"),
    "manifold3d, trimesh": ("#e69f00", "P"),
    "manifold3d, lib3mf": ("#e69f00", "X"),
}
LEGEND_ROOM = 100.0
"""Of the axes above the largest value, as a ratio."""
PROCESSES = "whole processes"
Points = dict[str, dict[str, list[tuple[int, float]]]]
"""Parts and seconds by file and by who wrote it, the smallest tape first."""


def jobs(size: Size) -> list[Job]:
    """Every size of tape up to the largest, and whole processes."""
    kernel_most = min(KERNEL_MOST, size.parts // 20)
    wanted = []
    for parts in (parts for parts in SIZES if parts <= size.parts):
        said: dict[str, Any] = {"parts": parts, "turns": _turns(parts, size)}
        others = {"writers": parts <= WRITERS_MOST, "union": parts <= UNION_MOST, "kernel": parts <= kernel_most}
        wanted += [
            _job(f"copper, {parts} parts", measure_copper, said | {"peers": others["writers"]}),
            _job(f"models, {parts} parts", measure_models, said | others),
            _job(f"kit, {parts} parts", measure_kit, said),
        ]
    return [*wanted, _job(PROCESSES, measure_processes, {"turns": _turns(UNION_MOST, size)})]


def _turns(parts: int, size: Size) -> int:
    """Fewer for what takes longer."""
    return 2 if parts > UNION_MOST or size.parts <= UNION_MOST else 3 if parts > KERNEL_MOST else 5


def _job(name: str, measure: Any, options: dict[str, Any]) -> Job:
    return Job(section=SECTION, name=name, measure=measure, options=options, alone=True)


# Figures of the figures


def points_of(results: Mapping[str, Result]) -> Points:
    """Curves of growth from the results of all sizes."""
    found: Points = {}
    for one in sorted((one for one in results.values() if "parts" in one), key=lambda one: int(one["parts"])):
        for file, seconds in one["seconds"].items():
            for who, value in seconds.items():
                found.setdefault(file, {}).setdefault(who, []).append((one["parts"], value))
    return found


def slope_of(points: Sequence[tuple[int, float]]) -> float | None:
    """Exponent of growth: the slope of a straight line through the logarithms; None for a single point."""
    if len(points) < 2:
        return None
    parts, seconds = np.log(np.array(points, dtype=np.float64)).T
    return float(np.polyfit(parts, seconds, 1)[0])


def _largest(results: Mapping[str, Result], file: str, who: str) -> Result:
    """The result of the largest tape of which both sides wrote a file."""
    return max(
        (one for one in results.values() if who in one.get("seconds", {}).get(file, {})), key=lambda one: int(one["parts"])
    )


# The page


def lines(results: Mapping[str, Result]) -> list[str]:
    """The section of the page."""
    points, whole = points_of(results), results[PROCESSES]
    versions = ", ".join(f"{name} {whole['versions'][name]}" for name in LIBRARIES)
    out = [
        "## Fabrication speed",
        "",
        "Seconds of the processor, all threads of a process, the least of some calls; every side has the same tape in one run,",
        "in turns in one process but for build123d, which has one of its own and is called once. Nobody's imports are counted.",
        "Gerber goes from an array of places to bytes, a model from the tape to a file. What the others do, and do not:",
        "",
        "- gerber_writer and gerbonara flash the same pads, but name no component and no pin, which ours does for each pad and",
        "  which makes its file larger. Sharp corners are gerbonara's cheapest turned pad, and another shape than ours.",
        "- build123d (OCCT) fuses one box for each part with the board at once, and exports that as STEP or STL; its assembly",
        "  places copies of one box, which share their shape as ours do. Ours is written face by face, without a kernel.",
        "- manifold3d unites the same boxes with the board, trimesh and lib3mf write its mesh, which has fewer triangles than",
        "  ours. For `of one mesh` they write our mesh, and nobody's time to make it counts.",
        "",
        "None of them knows the texture, checks design rules or verifies what it wrote, nor do the rows here.",
        f"Versions: {versions}.",
        "A ratio above 1 is in our favour: the other's seconds, or bytes, over ours.",
        "",
        "| file | parts | ours, s | other | other, s | ratio of seconds | ratio of bytes |",
        "|---|---|---|---|---|---|---|",
    ]
    for file in FILES:
        out += [_against(_largest(results, file, who), file, who) for who in points.get(file, {}) if who != US]
    out += ["", *wrap(f"Below 1, where ours is slower or larger: {_lost(results, points)}.", 120), ""]
    return [*out, *_memory(results), *_growth(points), *_processes(whole)]


def _ratios(one: Result, file: str, who: str) -> dict[str, float]:
    """The other's over ours."""
    return {unit: one[unit][file][who] / one[unit][file][US] for unit in ("seconds", "bytes")}


def _lost(results: Mapping[str, Result], points: Points) -> str:
    found = [
        f"{file} in {unit} against {who} ({ratio:.2f})"
        for file in FILES
        for who in points.get(file, {})
        if who != US
        for unit, ratio in _ratios(_largest(results, file, who), file, who).items()
        if ratio < 0.995
    ]
    return "; ".join(found) or "nowhere"


def _against(one: Result, file: str, who: str) -> str:
    seconds, ratios = one["seconds"][file], _ratios(one, file, who)
    return (
        f"| {file} | {one['parts']:,} | {_seconds(seconds[US])} | {who} | {_seconds(seconds[who])} "
        f"| {_ratio(ratios['seconds'])} | {_ratio(ratios['bytes'])} |"
    )


def _memory(results: Mapping[str, Result]) -> list[str]:
    out = []
    solids = [one for one in results.values() if SOLID in one.get("memory_mb", {})]
    if solids:
        one = max(solids, key=lambda one: int(one["parts"]))
        mb = one["memory_mb"][SOLID]
        out.append(
            f"A process that writes the solid of {one['parts']:,} parts as STEP peaks at {mb[US]:.0f} MB, build123d's at "
            f"{mb['build123d']:.0f} MB."
        )
    kits = [one for one in results.values() if KIT in one.get("memory_mb", {})]
    if kits:
        one = max(kits, key=lambda one: int(one["parts"]))
        out.append(
            f"One that makes the whole kit of {one['parts']:,} parts, {one['bytes'][KIT][US] / 1e6:.0f} MB of files, peaks at "
            f"{one['memory_mb'][KIT][US]:.0f} MB."
        )
    return [*out, ""] if out else []


def _growth(points: Points) -> list[str]:
    sizes = sorted({parts for of_file in points.values() for curve in of_file.values() for parts, _ in curve})
    out = [
        "![Seconds against the number of parts, ours and the others', by file](figures/evidence-growth.png)",
        "",
        "Seconds by the number of parts. The slope is that of a straight line through the logarithms, 1 where time is in",
        "proportion to parts; the last one is between the two largest tapes, where fixed costs no longer flatten it. The others",
        "were not asked for tapes that would take them minutes. The whole kit is `make --no-verify`.",
        "",
        "| file | | " + " | ".join(f"{parts:,}" for parts in sizes) + " | slope | last |",
        "|---" * (len(sizes) + 4) + "|",
    ]
    for file in FILES:
        for who, curve in points.get(file, {}).items():
            known = dict(curve)
            cells = [_seconds(known[parts]) if parts in known else "" for parts in sizes]
            slopes = [_slope(slope_of(curve)), _slope(slope_of(curve[-2:]))]
            out.append(f"| {file} | {'ours' if who == US else who} | {' | '.join([*cells, *slopes])} |")
    return [*out, ""]


def _processes(whole: Result) -> list[str]:
    out = [
        "Whole processes, from start to end, for the default tape; and what it takes to import a library:",
        "",
        "| process | s on the clock | s of the processor |",
        "|---|---|---|",
    ]
    out += [f"| {name} | {one['elapsed_s']:.2f} | {one['cpu_s']:.2f} |" for name, one in whole["processes"].items()]
    return [*out, ""]


def _seconds(value: float) -> str:
    """Three figures that count."""
    return f"{value:.{max(0, 2 - int(np.floor(np.log10(value))))}f}"


def _ratio(value: float) -> str:
    return f"{value:.0f}" if value >= 10 else f"{value:.2f}"


def _slope(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def pictures(results: Mapping[str, Result]) -> dict[str, Any]:
    """Plots by file name."""
    from matplotlib.figure import Figure

    points = points_of(results)
    seconds = [value for file in PLOTTED for curve in points.get(file, {}).values() for _, value in curve]
    figure = Figure(figsize=(12.0, 7.6), layout="constrained")
    grid = figure.subplots(2, 3, sharex=True, sharey=True)
    for axes, file in zip(grid.flat, PLOTTED, strict=True):
        for who, curve in points.get(file, {}).items():
            colour, marker = STYLES[who]
            slope = slope_of(curve)
            label = who if slope is None else f"{who}: {slope:.2f}"
            axes.plot(*np.array(curve).T, color=colour, marker=marker, label=label, markersize=4)
        axes.set(title=file, xscale="log", yscale="log", ylim=(min(seconds) / 2, max(seconds) * LEGEND_ROOM))
        axes.grid(alpha=0.3)
        if axes.lines:
            axes.legend(
                loc="upper left", frameon=False, title="slope", fontsize="small", title_fontsize="small", alignment="left"
            )
    for axes in grid[-1]:
        axes.set_xlabel("parts")
    for axes in grid[:, 0]:
        axes.set_ylabel("processor time, s")
    return {"evidence-growth.png": figure}
