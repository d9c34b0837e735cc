"""Counts of false accepts, as `python -m tests.bench.false_accepts` writes them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.bench.evidence.job import Result
from tests.bench.false_accepts import Done, Record, bound_of, by_subject, worst_subject
from tests.bench.false_tally import DECADES, total, upper_bound
from tests.bench.localization_false import Job

SECTION = "false accepts"
TITLE = "Located, though it should not be"
STEPS = tuple(10.0**-k for k in range(1, DECADES + 1))
"""What `Tally.decades` counts frames at or below."""


def entries(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Results of files of counts, as `record.Record` keeps those of jobs; of a job that two of them hold, the later file's.

    Raises
    ------
    OSError, LookupError, TypeError, ValueError
        For a file that is none, or has no counts.
    """
    done: Done = {}
    sources: dict[Job, str] = {}
    for path in paths:
        read = Record.read(path)
        if not read:
            raise ValueError(f"{path} has no counts")
        done |= read
        sources |= dict.fromkeys(read, str(json.loads(path.read_text().partition("\n")[0])["sources"]))
    found = []
    for kind in sorted({job.kind for job in done}):
        tallies = by_subject(done, kind)
        whole, worst = total(tallies.values()), worst_subject(done, kind)
        assert worst is not None
        result: Result = {
            "subjects": len(tallies),
            "frames": whole.frames,
            "fewest": min(tally.frames for tally in tallies.values()),
            "located": whole.located,
            "below": whole.most_likely,
            "bound": bound_of(kind),
            "worst": worst,
            "worst_located": tallies[worst].located,
            "worst_frames": tallies[worst].frames,
            "decades": whole.decades["p_false"],
            "sources": sorted({sources[job] for job in done if job.kind == kind}),
        }
        found.append({"section": SECTION, "name": kind, "options": {}, "result": result})
    return found


def lines(results: Mapping[str, Result]) -> list[str]:
    """The section of the page."""
    out = [
        f"## {TITLE}",
        "",
        "Textures that no registered tape shows: each located frame would be a wrong position. `dots` are drawn from what the",
        "detector made of such contacts, `depth maps` go through all of it. The rate is below the last figure, at 95 %.",
        "",
        "![Share of such frames with a bound of at most x, against x](figures/evidence-false-accepts.png)",
        "",
        "How small `p_false` gets on them, whether they are located or not: at most a share x of the frames should have one of",
        "at most x (dashed). Arrows stand where no frame was so low, at the share that this many frames rule out at 95 %.",
        "Above the line, beyond chance: " + ("; ".join(_above(results)) or "none") + ".",
        "`p_false` holds where tapes that nobody registered are as rare as its prior says (1 %), and contacts over an edge too;",
        "here every frame is of that kind. What refuses them then is the lead that an answer must have over any other place.",
        "",
        "`sources` is the digest of decoder, simulator and frames that the count was made with.",
        "",
        "| texture | frames | located | worst of them | rate below | sources |",
        "|---|---|---|---|---|---|",
    ]
    for kind, one in results.items():
        worst = f"{one['worst']}: {one['worst_located']} of {one['worst_frames']}" if one["subjects"] > 1 else ""
        said = ", ".join(f"`{digest[:8]}`" for digest in one["sources"])
        frames = f"{one['frames']:,}" + (
            f" ({one['subjects']} sectors, {one['fewest']:,} or more each)" if one["subjects"] > 1 else ""
        )
        out.append(f"| {kind} | {frames} | {one['located']} | {worst} | {one['below']:.1e} | {said} |")
    return [*out, ""]


def _above(results: Mapping[str, Result]) -> list[str]:
    """Kinds with more frames at or below some x than the bound promises, where they are most."""
    found = []
    for kind, one in results.items():
        excess = {
            x: count / one["frames"] / x
            for x, count in zip(STEPS, one["decades"], strict=True)
            if 1.0 - upper_bound(one["frames"] - count, one["frames"]) > x
        }
        if excess:
            x = max(excess, key=lambda step: excess[step])
            found.append(f"{kind}, {100 * excess[x] * x:.2g} % of them at {x:.0e}")
    return found


def _worlds_as_one(results: Mapping[str, Result]) -> dict[str, Result]:
    """Results with those of both worlds under one name where their curves are the same."""
    found: dict[str, Result] = {}
    for kind, one in results.items():
        texture, _, world = kind.rpartition(", ")
        other = {"open world": "closed world", "closed world": "open world"}.get(world, world)
        twin = results.get(f"{texture}, {other}", {})
        same = other != world and all(twin.get(key) == one[key] for key in ("frames", "decades"))
        found[f"{texture}, both worlds" if same else kind] = one
    return found


def pictures(results: Mapping[str, Result]) -> dict[str, Any]:
    """Plots by file name."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 5.2), layout="constrained")
    shown = _worlds_as_one(results)
    sides = {"p_tape": "no tape of the code", "p_place": "another place or tape of the code"}
    for axes, (bound, title) in zip(figure.subplots(1, 2, sharey=True), sides.items(), strict=True):
        axes.plot((1.0, STEPS[-1]), (1.0, STEPS[-1]), "k--", linewidth=1.0, label="what the bound promises")
        for k, (kind, one) in enumerate((kind, one) for kind, one in shown.items() if one["bound"] == bound):
            _curve(axes, kind, one, k)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlim(2.0, STEPS[-1] / 2)
        axes.set_ylim(STEPS[-1] / 2, 2.0)
        axes.set_title(title)
        axes.set_xlabel("x")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7, loc="lower left")
    figure.axes[0].set_ylabel("share of frames with p_false ≤ x")
    return {"evidence-false-accepts.png": figure}


def _curve(axes: Any, kind: str, one: Result, k: int) -> None:
    """Shares where frames were counted, and an arrow at the first step that none reached."""
    colour = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999999")[k % 7]
    reached = int(np.count_nonzero(one["decades"]))
    shares = np.array(one["decades"][:reached]) / one["frames"]
    marker = "os^vD<>p*"[k // 7]
    axes.plot(STEPS[:reached], shares, color=colour, marker=marker, markersize=4, linewidth=1.0, label=kind)
    if reached < len(STEPS):
        axes.plot(STEPS[reached], upper_bound(0, one["frames"]), color=colour, marker="$\u2193$", markersize=8)
