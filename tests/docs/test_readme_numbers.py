"""Figures in README and docs are those of the evidence, and links lead to where they were made."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tactape_fab.kit.spec.scatter import MOST_SYMBOL_ERRORS
from tactape_fab.make.emboss import MESH_CPU_S, STEP_CPU_S
from tactape_fab.sense import load_sensor
from tactape_fab.sense.decode.contact.plane import GAIN_SIGMA
from tactape_fab.sense.decode.contact.surface import TOP_SIGMA
from tactape_fab.sense.decode.rule import MOST_TURN_SHARE, OVERHANG_SHARE, WRONG_SHARE
from tactape_fab.sense.geometry import Geometry
from tactape_fab.sense.live.replay import LONG_GAP_S, USUAL_HZ
from tactape_fab.sense.live.rerun_log import BOX_UM
from tactape_fab.sense.simulation.elastic import MODULUS_KPA
from tactape_fab.solids.mark import MOST_SHARE_OF_BASE
from tactape_fab.solids.surface.patch import MOST_PITCH_ERROR, MOST_PITCH_ERROR_AT_ALL
from tactape_fab.verify.models.cad_readers import CPU_S, CPU_S_OF_OWN, PLACE_TOLERANCE_MM
from tactape_fab.verify.trip.visible_parts import IN_PLACE_MM
from tests.attacks import MOST_CPU_S
from tests.bench.evidence import counts, readme
from tests.bench.evidence.page import FIGURES_JSON, PAGE
from tests.bench.marks import replaced
from tests.bench.tracking import RATE_HZ
from tests.fuzz.cases import MOST_S

MADE = re.compile(r"<!-- (.+?) -->\n.*?<!-- /\1 -->\n", re.DOTALL)
CODE = re.compile(r"```.*?```|^ {4}.*?$", re.DOTALL | re.MULTILINE)
FIGURE = re.compile(r"(?<![\w.])\d[\d.,]*\s?(?:ms|µm|%|s|N|kPa|fps|Hz)(?!\w)")
"""What something measured would have for a unit; lengths in mm are options."""
UNCALIBRATED = (Geometry().sigma_aspect, Geometry().sigma_shear, Geometry().sigma_k1)
DECIDED = {
    "codes.md": [f"{100 * (1 - MOST_TURN_SHARE):g} %"],
    "dots.md": [f"{100 * WRONG_SHARE:g} %"],
    "frames.md": [f"{100 * GAIN_SIGMA:g} %", f"{100 * TOP_SIGMA:g} %"],
    "limits.md": [
        f"{MOST_CPU_S:g} s",
        *(f"{of:g} s" for of in (STEP_CPU_S, MESH_CPU_S, CPU_S, CPU_S_OF_OWN, MOST_S)),
    ],
    "live.md": [f"{USUAL_HZ:g} Hz", f"{LONG_GAP_S:g} s", f"{BOX_UM:g} µm"],
    "localization.md": [f"{100 * MOST_TURN_SHARE:g} %", f"{100 * (1 - OVERHANG_SHARE):g} %", f"{MODULUS_KPA:g} kPa"],
    "robot.md": [f"{RATE_HZ:g} Hz"],
    "solids.md": [
        f"{100 * MOST_SHARE_OF_BASE:g} %",
        *(f"{100 * error:g} %" for error in (MOST_PITCH_ERROR, MOST_PITCH_ERROR_AT_ALL)),
        f"{1000 * PLACE_TOLERANCE_MM:g} µm",
    ],
    "touch-code.md": [f"{100 * MOST_SYMBOL_ERRORS:g} %"],
    "trust.md": [f"{50 * load_sensor('gelsight-mini').scale_tolerance:g} %", *(f"{100 * sigma:g} %" for sigma in UNCALIBRATED)],
    "verify.md": [f"{1000 * IN_PLACE_MM:g} µm"],
}
"""Figures of pages that the code decides."""


@pytest.fixture
def content() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(FIGURES_JSON.read_text(encoding="utf-8"))
    return found


def headings(page: Path) -> set[str]:
    return {readme.anchor(line.lstrip("# ")) for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("#")}


def test_the_readme_has_the_numbers_of_the_evidence(content: dict[str, Any]) -> None:
    table = readme.table(content, readme.VERIFY.read_text(encoding="utf-8"))
    text = readme.README.read_text(encoding="utf-8")
    assert replaced(text, readme.MARK, table) == text, "run python -m tests.bench.evidence.readme"
    rows = table.splitlines()[2:]
    if content["size"] == "full":
        assert len(rows) == readme.NUMBERS, "counts are missing: run python -m tests.bench --counts FILE ..."
    assert all(re.search(r"\]\(docs/[\w-]+\.md#[\w-]+\)", row) for row in rows)


def test_links_of_the_readme_lead_to_headings() -> None:
    links = re.findall(r"\]\((docs/[\w-]+\.md)#([\w-]+)\)", readme.README.read_text(encoding="utf-8"))
    assert links
    for page, name in links:
        assert name in headings(readme.ROOT / page), f"{page}#{name}"


def test_no_page_quotes_a_figure_by_hand() -> None:
    """Speed, accuracy and rates stand where a command writes them: between marks, or on the page of evidence."""
    for page in [readme.README, *sorted((readme.ROOT / "docs").glob("*.md"))]:
        if page == PAGE:
            continue
        text = CODE.sub("", MADE.sub("", page.read_text(encoding="utf-8")))
        assert FIGURE.findall(text) == DECIDED.get(page.name, []), page.name


def test_every_number_is_in_a_full_table(content: dict[str, Any]) -> None:
    bare = {"size": "quick", "results": []}
    verify = f"| {readme.WINDOWS} | 5 of 5 |\n"
    assert readme.table(bare, verify).splitlines()[2:] == [
        f"| {readme.WINDOWS} | [5 of 5](docs/verify.md#the-default-kit) | read back by software that is not ours |"
    ]
    counted = {
        "section": counts.SECTION,
        "name": "other sectors, dots",
        "result": {"located": 3, "frames": 20000},
    }
    whole = {
        "results": [
            *(entry for entry in content["results"] if entry["section"] != counts.SECTION),
            counted,
            counted | {"name": "ball, dots, open world"},
            counted | {"name": "ball, dots, closed world"},
        ]
    }
    rows = readme.table(whole, verify).splitlines()[2:]
    assert len(rows) == readme.NUMBERS
    assert "[6 of 40,000](docs/evidence.md#located-though-it-should-not-be)" in rows[3]


def test_a_table_replaces_the_one_before() -> None:
    page = "a\n<!-- x -->\nold\n<!-- /x -->\nb\n"
    assert replaced(page, "x", "new\n") == page.replace("old", "new")
    for mark in ("y", "/x"):
        with pytest.raises(ValueError, match=f"no lines <!-- {mark} -->"):
            replaced(page, mark, "new\n")
