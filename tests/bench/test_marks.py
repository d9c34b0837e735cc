"""Benches write their tables where pages have marks for them."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType

import pytest

from tests.bench import calibration, contact, inspect_scans

DOCS = Path(__file__).parents[2] / "docs"


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
    assert {line.count("|") for line in rows.splitlines()} == {header.splitlines()[0].count("|")}


def test_a_bench_writes_between_the_marks_and_says_what_was_called(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- contact -->\nold\n<!-- /contact -->\nafter\n", encoding="utf-8")
    options = ["--frames", "2", "--row", "flat", "--force", "2", "--page", str(page)]
    monkeypatch.setattr("sys.argv", ["contact", *options])
    contact.main()
    lines = page.read_text(encoding="utf-8").splitlines()
    assert (lines[:2], lines[-2:]) == (["before", "<!-- contact -->"], ["<!-- /contact -->", "after"])
    assert lines[2] == f"Simulated contacts for each row: 2 (`python -m tests.bench.contact {' '.join(options)}`)."
    assert len(lines) == 9
    assert lines[6].startswith("| flat | 2 | 2 of 2 | 0 |")
