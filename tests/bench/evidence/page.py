"""The page that is made of the figures: docs/evidence.md, and its plots."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.bench.evidence import (
    accuracy,
    codes,
    conditions,
    counts,
    curves,
    fabrication,
    force,
    place,
    resolution,
    simulators,
    table_one,
    table_two,
)
from tests.bench.evidence.job import Job, Size
from tests.bench.evidence.record import results_of

DOCS = Path(__file__).parents[3] / "docs"
FIGURES_JSON, PAGE = DOCS / "evidence.json", DOCS / "evidence.md"
MEASURED = (table_one, table_two, accuracy, conditions, simulators, resolution, place, curves, force, codes, fabrication)


def jobs(size: Size) -> list[Job]:
    """Everything that is measured here, section by section."""
    return [job for section in MEASURED for job in section.jobs(size)]


def page_of(content: dict[str, Any]) -> str:
    """The page's text."""
    about = content["about"]
    out = [
        "# Evidence",
        "",
        "Every figure on this page stands in `evidence.json` beside it, and was made by `python -m tests.bench` (all of it, or",
        "`--quick` for fewer contacts), but for the counts of false accepts, which `python -m tests.bench.false_accepts` makes.",
        f"Size `{content['size']}`, seed {about['seed']}, {about['machine']}; Python {about['python']}, numpy {about['numpy']}, "
        f"numba {about['numba']}.",
        f"The sources were `{about['sources']}`: `python -m tests.bench --sources` prints those of today. Where they differ, the",
        "figures are older than the code, and CHANGELOG.md says what has changed.",
        *_kept(content["results"]),
        "",
        *(OLDER if about.get("noise") is None else _about_noise(about["noise"])),
        "",
    ]
    for section in (*MEASURED, counts):
        found = results_of(content, section.SECTION)
        if found:
            out += section.lines(found)
    return "\n".join(out)


def _kept(results: list[dict[str, Any]]) -> list[str]:
    """What was not measured anew, with its sources."""
    older: dict[str, dict[str, None]] = {}
    for entry in results:
        if "sources" in entry:
            older.setdefault(entry["sources"], {})[entry["section"]] = None
    return [f"Not measured anew, and of the sources `{sources}`: {', '.join(names)}." for sources, names in older.items()]


OLDER = (
    "All contacts are simulated (see [localization](localization.md)); the default scene is a contact of 11x9 mm with 7 µm",
    "of noise after the high-pass, where a real GelSight Mini without contact has 4.3 µm. These figures were made with the",
    "noise model of 0.1.0, white and smooth noise of the depth, kept as `simulate --noise-model smooth`, and with the",
    "decoder of 0.1.0, which took the camera's scale as exact, and less time a frame.",
)
"""Of figures that do not say what noise they have."""


def _about_noise(slope: float) -> list[str]:
    return [
        "All contacts are simulated (see [localization](localization.md)): the default scene is a contact of 11x9 mm with the",
        f"noise measured on a GelSight Mini off contact, white noise of the slopes of {slope:g} rms a pixel, which falls as",
        "1/f² in the depth that they are integrated to. No tape was made and touched for this page: a gel that creeps and",
        "sticks, a camera's own faults and what assembly does are in it as far as they are simulated. Of real sensors there",
        "are images of other things: an outside check of an earlier version decoded 313 of them 2,028 times, and none was",
        "located. `TACTAPE_REAL_IMAGES=FOLDER pytest tests/bench/test_foreign_images.py` does it with yours.",
    ]


def write_page(content: dict[str, Any], folder: Path) -> list[Path]:
    """Write the page, and plots into a folder below its own.

    Raises
    ------
    SystemExit
        Without matplotlib.
    """
    try:
        import matplotlib as mpl
    except ModuleNotFoundError as error:
        raise SystemExit(f'{error.name} is not installed; pip install -e ".[evidence]"') from error
    mpl.rcParams["svg.hashsalt"] = "tactape-fab"
    page = folder / PAGE.name
    page.write_text(page_of(content), encoding="utf-8")
    written = [page]
    (folder / "figures").mkdir(exist_ok=True)
    for section in (curves, force, fabrication, counts):
        found = results_of(content, section.SECTION)
        for name, figure in section.pictures(found).items() if found else ():
            path = folder / "figures" / name
            figure.savefig(path, dpi=110, metadata={"Software": None})
            written.append(path)
    return written
