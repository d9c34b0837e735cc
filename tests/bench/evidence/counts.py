"""Counts of false accepts, as `python -m tests.bench.false_accepts` writes them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..false_accepts import Record, bound_of, by_subject, worst_subject
from ..false_tally import total
from .job import Result

SECTION = "false accepts"


def entries(path: Path) -> list[dict[str, Any]]:
    """Results of a file of counts, as `record.Record` keeps those of jobs."""
    done = Record.read(path)
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
        }
        found.append({"section": SECTION, "name": kind, "options": {}, "result": result})
    return found


def lines(results: Mapping[str, Result]) -> list[str]:
    """The section of the page."""
    out = [
        "## Located, though it should not be",
        "",
        "Textures that no registered tape shows: each located frame would be a wrong position. `dots` are drawn from what the",
        "detector made of such contacts, `depth maps` go through all of it. The rate is below the last figure, at 95 %.",
        "",
        "| texture | frames | located | worst of them | rate below |",
        "|---|---|---|---|---|",
    ]
    for kind, one in results.items():
        worst = f"{one['worst']}: {one['worst_located']} of {one['worst_frames']}" if one["subjects"] > 1 else ""
        frames = f"{one['frames']:,}" + (
            f" ({one['subjects']} sectors, {one['fewest']:,} or more each)" if one["subjects"] > 1 else ""
        )
        out.append(f"| {kind} | {frames} | {one['located']} | {worst} | {one['below']:.1e} |")
    return [*out, ""]
