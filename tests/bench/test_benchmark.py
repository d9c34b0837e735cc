"""The page of the public benchmark: its tables are a run's, and its sums are those of today's simulators."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tactape_fab.sense.benchmark.adapters import answer_lines, open_benchmark
from tactape_fab.sense.benchmark.answers import read_answers
from tactape_fab.sense.benchmark.conditions import CONDITIONS
from tactape_fab.sense.benchmark.score import HEADER, read_truth, score
from tactape_fab.sense.benchmark.write import USUAL_FRAMES, truth_path, write_benchmark
from tests.bench.benchmark import TITLES, adapters, brisk, small_sum

PAGE = Path(__file__).parents[2] / "docs" / "benchmark.md"
AGAIN = "run python -m tests.bench.benchmark --page docs/benchmark.md"


def _between(mark: str) -> str:
    (found,) = re.findall(rf"<!-- {mark} -->\n(.*?)<!-- /{mark} -->\n", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return str(found)


def test_the_page_has_the_tables_of_a_whole_run() -> None:
    about, *sections = _between("tables").split("\n### ")
    assert re.search(r"`python -m tests.bench.benchmark .*--page docs/benchmark.md`", about), AGAIN
    assert about.startswith(f"{USUAL_FRAMES * len(CONDITIONS)} frames")
    assert [section.splitlines()[0] for section in sections] == [*TITLES.values()]
    for section in sections:
        rows = [line for line in section.splitlines() if line.count("|") == HEADER[0].count("|")]
        assert rows[:2] == [*HEADER] and [row.split(" | ")[0].strip("| ") for row in rows[2:]] == [*CONDITIONS, "all"]


def test_the_simulators_write_the_published_bytes() -> None:
    assert _between("small") == small_sum(), f"the simulators' bytes have changed, which the changelog names; {AGAIN}"
    assert len(re.findall(r"`[0-9a-f]{64}`", _between("sums"))) == 8


def test_brisk_answers_frames_of_the_benchmark(tmp_path: Path) -> None:
    if "brisk" not in adapters():
        pytest.skip("this OpenCV has no BRISK, which the contributed modules have")
    write_benchmark(tmp_path / "small", frames=4, only=["imprint, 11x9 mm"])
    (tmp_path / "brisk.jsonl").write_text(
        "\n".join(answer_lines("brisk", brisk, open_benchmark(tmp_path / "small"))), encoding="utf-8"
    )
    truth = read_truth(truth_path(tmp_path / "small"))
    row = score(read_answers(tmp_path / "brisk.jsonl", len(truth))[1], truth)["all"]
    assert row.right >= 3 and row.p95_um is not None and row.p95_um < 50.0 and np.isfinite(row.p50_ms or np.nan)
