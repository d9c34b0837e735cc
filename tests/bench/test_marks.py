"""Benches write their tables where pages have marks for them."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType

import pytest

from tests.bench import calibration, contact, inspect_scans
from tests.bench.marks import measured_line

DOCS = Path(__file__).parents[2] / "docs"
MADE_ANEW = {
    "benchmark.md": {"sums", "small"},
    "certify.md": {"numbers"},
    "codes.md": {"codes"},
    "fabs.md": {"profiles", "pitches"},
    "limits.md": {"budgets", "changes", "attacks", "mutants"},
    "manifest.md": {"kit", "panel"},
    "slam.md": {"drift"},
    "verify.md": {"numbers"},
}
"""Tables that a test computes anew, or holds to a file that one does."""


@pytest.mark.parametrize("page", sorted(DOCS.glob("*.md")), ids=lambda page: page.name)
def test_what_was_measured_says_when(page: Path) -> None:
    """Line ends included, so that a table does not run into it."""
    text = page.read_text(encoding="utf-8")
    for mark, made in re.findall(r"<!-- ([a-z][a-z0-9_-]*) -->\n(.*?)<!-- /\1 -->\n", text, re.DOTALL):
        says = re.findall(r"\n\nMeasured (?:on|by) \d{4}-\d\d-\d\d with sources .*; \[evidence\]\(evidence.md\) .*\n\Z", made)
        assert len(says) == (mark not in MADE_ANEW.get(page.name, ())), mark


def test_figures_of_several_days_and_sources_name_them_all() -> None:
    new, old = {"day": "2027-01-02", "sources": "0123456789abcdef"}, {"day": "2026-11-22"}
    said = measured_line([new, old, new])
    assert "Measured by 2026-11-22 with sources not recorded, and on 2027-01-02 with sources `0123456789abcdef`;" in said


@pytest.mark.parametrize(
    ("page", "mark", "bench"),
    [
        ("calibrate.md", "calibration", calibration),
        ("frames.md", "contact", contact),
        ("measure.md", "inspected", inspect_scans),
    ],
)
def test_a_page_has_the_table_that_its_command_makes(page: str, mark: str, bench: ModuleType) -> None:
    header: str = bench.HEADER
    text = (DOCS / page).read_text(encoding="utf-8")
    (made,) = re.findall(rf"<!-- {mark} -->\n(.*?)<!-- /{mark} -->\n", text, re.DOTALL)
    about, found, rows = made.partition(header)
    assert found, f"run python -m {bench.__name__} --page docs/{page}"
    assert re.search(rf"`python -m {bench.__name__} .*--page docs/{page}`", about)
    table, _, line = rows.rpartition("\n\n")
    assert {row.count("|") for row in table.splitlines()} == {header.splitlines()[0].count("|")}
    assert line.startswith("Measured ")


def test_a_bench_writes_between_the_marks_and_says_what_was_called(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- contact -->\nold\n<!-- /contact -->\nafter\n", encoding="utf-8")
    options = ["--frames", "2", "--row", "flat", "--force", "2", "--page", str(page)]
    monkeypatch.setattr("sys.argv", ["contact", *options])
    contact.main()
    lines = page.read_text(encoding="utf-8").splitlines()
    assert (lines[:2], lines[-2:]) == (["before", "<!-- contact -->"], ["<!-- /contact -->", "after"])
    assert lines[2] == f"Simulated contacts for each row: 2 (`python -m tests.bench.contact {' '.join(options)}`)."
    assert len(lines) == 11
    assert re.fullmatch(r"Measured on \d{4}-\d\d-\d\d with sources `[0-9a-f]{16}`; .*", lines[8])
    assert lines[6].startswith("| flat | 2 | 2 of 2 | 0 |")
