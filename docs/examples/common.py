"""What the examples share: tapes, JSON and tables of applications.md, and the look of the plots."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # a dependency installs a package `tests`, too

from tactape_fab import Tape, TapeSpec, examine
from tests.bench.marks import all_replaced, measured_line, stamp

FloatArray = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

DOCS = Path(__file__).resolve().parents[1]
PAGE, FIGURES, PICTURES = DOCS / "applications.md", DOCS / "applications.json", DOCS / "figures"
TRIALS = 120
TAPE, BARE = "#1f6f8b", "#c4622d"
"""Colours of trials with the tape and without."""


def tape_of(sector: int, size_mm: tuple[float, float]) -> Tape:
    """The tape that `make` would write: no tag, so that the texture covers all of it."""
    return examine(TapeSpec(sector=sector, size_mm=size_mm, tag="none")).tape


def table(entry: dict[str, Any]) -> str:
    """Success of every way, and the error that decides it."""
    out = ["| | trials | success | error p50 | p95 |", "|---|---|---|---|---|"]
    for row in entry["ways"]:
        errors = " | ".join("" if row[key] is None else f"{row[key]:.2f} {entry['unit']}" for key in ("p50", "p95"))
        out.append(f"| {row['way']} | {row['trials']} | {100 * row['success'] / row['trials']:.0f} % | {errors} |")
    return "\n".join(out) + "\n"


def way(name: str, success: list[bool], errors: list[float]) -> dict[str, Any]:
    """One row of a table: successes, and quantiles of the errors of the trials that have one."""
    known = [error for error in errors if np.isfinite(error)]
    p50, p95 = (round(float(np.percentile(known, p)), 4) if known else None for p in (50, 95))
    return {"way": name, "trials": len(success), "success": int(sum(success)), "p50": p50, "p95": p95}


def made_anew(text: str, content: dict[str, Any]) -> str:
    """The page's text with its tables as the figures have them."""
    return all_replaced(text, {name: table(entry) + measured_line([entry["measured"]]) for name, entry in content.items()})


def keep(name: str, unit: str, ways: list[dict[str, Any]], seed: int) -> None:
    """Write an example's figures beside those of the others, and the page's table."""
    content = json.loads(FIGURES.read_text(encoding="utf-8")) if FIGURES.exists() else {}
    content[name] = {"measured": stamp(), "unit": unit, "seed": seed, "ways": ways}
    FIGURES.write_text(json.dumps(dict(sorted(content.items())), indent=1) + "\n", encoding="utf-8")
    if PAGE.exists():
        PAGE.write_text(made_anew(PAGE.read_text(encoding="utf-8"), content), encoding="utf-8")
    sys.stdout.write(table(content[name]))


def axes(width: float = 7.0, height: float = 3.2, count: int = 1) -> tuple[Any, Any]:
    """A figure and its axes, in the style of the pages."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, ax = plt.subplots(1, count, figsize=(width, height), constrained_layout=True)
    for one in np.atleast_1d(ax):
        one.spines[["top", "right"]].set_visible(False)
        one.grid(alpha=0.25)
    return figure, ax


def save(figure: Any, name: str) -> None:
    figure.savefig(PICTURES / f"application-{name}.png", dpi=130, metadata={"Software": None})
