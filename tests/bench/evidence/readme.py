"""The README's five numbers, each with a link to the line of evidence that made it: `python -m tests.bench.evidence.readme`.

Run for a README that docs/evidence.json was remade under; `python -m tests.bench` does it by itself.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.bench.evidence import counts, curves, force, table_two
from tests.bench.evidence.job import Result
from tests.bench.evidence.page import FIGURES_JSON, PAGE
from tests.bench.evidence.record import results_of
from tests.bench.marks import replaced

ROOT = FIGURES_JSON.parents[1]
README, VERIFY = ROOT / "README.md", ROOT / "docs" / "verify.md"
MARK = "numbers"
NUMBERS = 5
WINDOWS = "4x4 windows of the written copper that decode, the right way up, to their place"
"""A line of the table that docs/make_numbers.py writes into docs/verify.md."""
_PEER = "tuned"
_SQUARE = curves.CURVES[0]
_PLACED = "placement 0.05"
"""The curves' point of parts that are placed as a line for 0201 places them (standard deviation along an axis, mm)."""


def table(content: Mapping[str, Any], verify: str) -> str:
    """The README's table.

    Parameters
    ----------
    content : mapping
        Of docs/evidence.json. What it holds no figures of has no line.
    verify : str
        The text of docs/verify.md.
    """
    out = ["| | | beside it |", "|---|---|---|"]
    points = results_of(dict(content), curves.SECTION)
    if found := results_of(dict(content), table_two.SECTION):
        out += _accuracy_and_time(found[_PEER], points.get(_PLACED))
    if points:
        out.append(_smallest(points, results_of(dict(content), force.SECTION)))
    if found := results_of(dict(content), counts.SECTION):
        out.append(_false_accepts(found))
    windows = next(line for line in verify.splitlines() if line.startswith(f"| {WINDOWS} |")).split("|")[2].strip()
    out.append(_row(WINDOWS, _link(windows, VERIFY, "The default kit"), "read back by software that is not ours"))
    return "\n".join([*out, ""])


def _accuracy_and_time(found: Result, placed: Result | None) -> list[str]:
    ours, peer = found["ours"], found["baseline"]
    right = 100 * peer["right"] / found["frames"]
    what, figure = "error of position and angle (rms), every part in its place", _link(_errors(ours), PAGE, table_two.TITLE)
    if placed is not None:
        what += f"; and with parts placed to {float(_PLACED.split()[1]):g} mm, until [measured](docs/measure.md)"
        figure += "; " + _link(_errors(placed["open"]), PAGE, curves.TITLE)
    return [
        _row(what, figure, f"BRISK and RANSAC, tuned, every part in its place: {_errors(peer)}, on the {right:.0f} % it finds"),
        _row(
            "time to locate a frame, one thread (median)",
            _link(f"{ours['p50_ms']:.2f} ms", PAGE, table_two.TITLE),
            f"BRISK and RANSAC, tuned: {peer['p50_ms']:.2f} ms",
        ),
    ]


def _errors(found: Mapping[str, Any]) -> str:
    return f"{found['position_um']:.1f} µm, {found['theta_deg']:.2f}°"


def _smallest(found: Mapping[str, Result], presses: Mapping[str, Result]) -> str:
    said = [_mm(curves.bound(_SQUARE, found, method)) for method in ("open", "paper")]
    figure, beside = _link(said[0], PAGE, curves.TITLE), f"the paper's method: {said[1]}"
    if presses:
        least = [
            _newton([force.least_force(presses, "flat block", gel, method) for gel in force.GELS]) for method in ("ours", "paper")
        ]
        figure += ", " + _link(least[0], PAGE, force.TITLE)
        beside += f", {least[1]}"
    what = f"smallest contact with at least {100 * curves.LEAST_RATE:g} % located" + (
        ", and force on a flat block (by a model, soft gel to stiff)" if presses else ""
    )
    return _row(what, figure, beside)


def _mm(value: float | None) -> str:
    return "none" if value is None else f"{value:g} mm"


def _newton(values: list[float | None]) -> str:
    return " to ".join("none" if value is None else f"{value:g} N" for value in values)


def _false_accepts(found: Mapping[str, Result]) -> str:
    once = [one for kind, one in found.items() if not kind.endswith("closed world")]  # which has the open world's frames again
    located, frames = (sum(one[key] for one in once) for key in ("located", "frames"))
    return _row(
        "contacts of other tapes, and of what is no tape, that were located (open world)",
        _link(f"{located} of {frames:,}", PAGE, counts.TITLE),
        "at the default bound of 1e-4 for each frame",
    )


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _link(words: str, page: Path, heading: str) -> str:
    return f"[{words}]({page.relative_to(ROOT)}#{anchor(heading)})"


def anchor(heading: str) -> str:
    """The name that GitHub gives to a heading."""
    return "".join(c for c in heading.lower().replace(" ", "-") if c.isalnum() or c in "-_")


def write(content: Mapping[str, Any]) -> Path:
    """Write the table into the README."""
    found = table(content, VERIFY.read_text(encoding="utf-8"))
    README.write_text(replaced(README.read_text(encoding="utf-8"), MARK, found), encoding="utf-8")
    return README


if __name__ == "__main__":
    print(write(json.loads(FIGURES_JSON.read_text(encoding="utf-8"))))
