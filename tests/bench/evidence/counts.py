"""Counts of false accepts, as `python -m tests.bench.false_accepts` writes them."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.sense.decode.rule import UNREGISTERED_SHARE
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
    """Words for `_excess`."""
    return [f"{kind}, {100 * share:.2g} % of them at {x:.0e}" for kind, (x, share) in _excess(results).items()]


def _excess(results: Mapping[str, Result]) -> dict[str, tuple[float, float]]:
    """Kinds with more frames at or below some x than the bound promises, beyond chance: x where they are most, and the share."""
    found = {}
    for kind, one in results.items():
        excess = {
            x: count / one["frames"] / x
            for x, count in zip(STEPS, one["decades"], strict=True)
            if 1.0 - upper_bound(one["frames"] - count, one["frames"]) > x
        }
        if excess:
            x = max(excess, key=lambda step: excess[step])
            found[kind] = (x, excess[x] * x)
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


COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f", "#5e3c99")
"""One for each texture of a plot."""


def pictures(results: Mapping[str, Result]) -> dict[str, Any]:
    """Plots by file name."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 8.2), layout="constrained")
    shown, above = _worlds_as_one(results), _excess(results)
    sides = {"p_tape": "touched: no tape of the code", "p_place": "touched: another place or tape of the code"}
    upper, lower = figure.subplots(2, 2, sharey="row", height_ratios=(2.0, 1.0))
    for axes, below, (bound, title) in zip(upper, lower, sides.items(), strict=True):
        (promise,) = axes.plot((STEPS[-1], 1.0), (STEPS[-1], 1.0), "k--", linewidth=1.0, label="what the bound promises")
        curves = {kind: one for kind, one in shown.items() if one["bound"] == bound}
        colours = dict(zip(dict.fromkeys(map(_texture, curves)), cycle(COLOURS), strict=False))
        handles = [_curve(axes, kind, one, colours[_texture(kind)]) for kind, one in curves.items()]
        _explain(axes, {kind: one for kind, one in curves.items() if kind in above})
        axes.set(xscale="log", yscale="log", xlim=(STEPS[6] / 2, 2.0), ylim=(STEPS[6] / 2, 2.0), title=title, xlabel="x")
        axes.grid(alpha=0.3)
        below.axis("off")
        legend = below.legend(handles=[promise, *handles], fontsize=8.5, loc="upper left", frameon=False)
        legend.set_in_layout(False)
    arrows = "\u2193 no frame was so low: the share that\nso many frames rule out at 95 %"
    upper[0].text(0.03, 0.97, arrows, transform=upper[0].transAxes, va="top", fontsize=9)
    upper[0].set_ylabel("share of the frames with p_false ≤ x")
    return {"evidence-false-accepts.png": figure}


def _texture(kind: str) -> str:
    """What is touched, however it was seen."""
    return re.sub(r", (dots|depth maps|both worlds|open world|closed world)", "", kind)


def _curve(axes: Any, kind: str, one: Result, colour: str) -> Any:
    """Shares where frames were counted, and an arrow at the first step that none reached; dots hollow, depth maps filled."""
    reached = int(np.count_nonzero(one["decades"]))
    shares = np.array(one["decades"][:reached]) / one["frames"]
    look = {"marker": "s", "markersize": 5} if "depth maps" in kind else {"marker": "o", "markersize": 7, "fillstyle": "none"}
    label = f"{kind.removesuffix(', both worlds')}: {one['located']} of {one['frames']:,} located"
    (line,) = axes.plot(STEPS[:reached], shares, color=colour, linewidth=1.3, label=label, **look)
    if reached < len(STEPS):
        axes.plot(STEPS[reached], upper_bound(0, one["frames"]), color=colour, marker="$\u2193$", markersize=8)
    return line


def _explain(axes: Any, above: Mapping[str, Result]) -> None:
    """Names of the curves above the promise, and why they are there."""
    if not above:
        return
    said = f"above the bound, which takes such contacts to be rare\n({100 * UNREGISTERED_SHARE:g} %); here every frame is one"
    axes.text(0.03, 0.97, said, transform=axes.transAxes, va="top", fontsize=9)
    for place, (kind, one) in enumerate(sorted(above.items(), key=lambda item: -item[1]["decades"][0] / item[1]["frames"])):
        last = int(np.count_nonzero(one["decades"])) - 1
        end = (STEPS[last], one["decades"][last] / one["frames"])
        arrow = {"arrowstyle": "-", "color": "0.4", "linewidth": 0.8}
        text = f"{kind}\n{one['located']} located"
        axes.annotate(text, end, (0.03, 0.85 - 0.11 * place), textcoords="axes fraction", va="top", fontsize=8, arrowprops=arrow)
