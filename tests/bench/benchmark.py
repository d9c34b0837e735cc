"""The public benchmark's table: `python -m tests.bench.benchmark [--frames N] [--folder DIR] [--page docs/benchmark.md]`.

Writes the data set where the folder is not there, has it answered by this package's methods, the paper's, and BRISK with RANSAC
on maps of all tapes where OpenCV has its contributed modules (see `evidence.table_two.create_brisk`), and scores all of them.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2

from tactape_fab.base.input_file import sha256_of
from tactape_fab.sense.benchmark.adapters import (
    ADAPTERS,
    Adapter,
    Benchmark,
    Locate,
    Say,
    answer_lines,
    open_benchmark,
    read_index,
)
from tactape_fab.sense.benchmark.answers import read_answers
from tactape_fab.sense.benchmark.score import HEADER, calibration_lines, line, read_truth, score
from tactape_fab.sense.benchmark.write import FRAMES, INDEX, USUAL_FRAMES, truth_path, write_benchmark
from tests.bench.evidence.record import about
from tests.bench.evidence.table_two import SETTINGS, Baseline, Found, create_brisk
from tests.bench.marks import all_replaced, command, measured_line, stamp


def brisk(benchmark: Benchmark) -> tuple[Locate, Say]:
    """BRISK and RANSAC, tuned, with a noiseless map of each whole tape; the one with the most inliers is taken."""
    cv2.setNumThreads(1)
    maps = {tape.name: Baseline(SETTINGS["tuned, the whole tape as map"], tape) for tape in benchmark.tapes}
    unit_mm = benchmark.sensor.depth_unit_mm or 1.0

    def locate(depth: Any) -> tuple[str, Found] | None:
        found = [(name, one.locate(depth.astype("float32") * unit_mm)) for name, one in maps.items()]
        return max(((name, one) for name, one in found if one is not None), key=lambda pair: pair[1][2], default=None)

    return locate, _said


def _said(found: tuple[str, Found] | None) -> Mapping[str, Any]:
    if found is None:
        return {"located": False}
    position, theta_deg, _ = found[1]
    return {"located": True, "tape": found[0], "position_mm": position.tolist(), "theta_deg": float(theta_deg)}


def adapters() -> Mapping[str, Adapter]:
    """Ours, the paper's, and BRISK where it is there."""
    try:
        create_brisk()
    except RuntimeError as error:
        print(error, file=sys.stderr)
        return ADAPTERS
    return {**ADAPTERS, "brisk": brisk}


TITLES = {
    "ml": "Ours, as `decode` has it",
    "ml-pixels": "Ours, `--refine pixels`",
    "paper": "The paper's method",
    "brisk": "BRISK and RANSAC, tuned, a noiseless map of each whole tape",
}


def tables(folder: Path, methods: Mapping[str, Adapter]) -> str:
    """All tables of a data set, as Markdown."""
    truth, benchmark, said = read_truth(truth_path(folder)), open_benchmark(folder), about()
    out = [f"{len(truth)} frames ({command('tests.bench.benchmark')}); load average {os.getloadavg()[0]:.0f} on {os.cpu_count()}"]
    out[0] += (
        f" processors, {said['machine']}; tactape-fab {said['tactape_fab']}, numpy {said['numpy']}, OpenCV {said['opencv']}."
    )
    for name, adapter in methods.items():
        path = folder.with_name(f"{folder.name}-{name}.jsonl")
        path.write_text("".join(f"{text}\n" for text in answer_lines(name, adapter, benchmark)), encoding="utf-8")
        _, answers = read_answers(path, len(truth))
        rows = [line(row_name, row) for row_name, row in score(answers, truth).items()]
        calibrated = calibration_lines(answers, truth)
        section = ["", f"### {TITLES[name]}", "", *HEADER, *rows, *(["", *calibrated] if calibrated else [])]
        print(*section, sep="\n", flush=True)
        out += section
    return "\n".join(out) + "\n"


def sums(folder: Path) -> str:
    """Sums of a data set's files, as Markdown."""
    files = {**read_index(folder)["files"], INDEX: sha256_of(folder / INDEX), "FOLDER-truth.jsonl": sha256_of(truth_path(folder))}
    rows = [
        f"| `{name}` | {(folder / name).stat().st_size if name in read_index(folder)['files'] else ''} | `{value}` |"
        for name, value in files.items()
    ]
    return "\n".join(["| file | bytes | SHA-256 |", "|---|---|---|", *rows]) + "\n"


SMALL = ("imprint, 11x9 mm", "imprint, 7x7 mm")
"""Conditions of the set that the page's reader tries first, and a test writes."""


def small_sum() -> str:
    """Sum of its frames."""
    with TemporaryDirectory() as scratch:
        return f"`{write_benchmark(Path(scratch) / 'small', frames=1, seed=5, only=SMALL)[FRAMES]}`\n"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.benchmark", description=__doc__)
    parser.add_argument("--frames", type=int, default=USUAL_FRAMES, metavar="N", help="of each condition")
    parser.add_argument("--folder", type=Path, default=Path("build/benchmark"), metavar="DIR")
    parser.add_argument(
        "--page", type=Path, metavar="FILE.md", help="write the tables between marks of a page, docs/benchmark.md"
    )
    given = parser.parse_args()
    given.folder.parent.mkdir(parents=True, exist_ok=True)
    if not given.folder.exists():
        write_benchmark(given.folder, frames=given.frames)
    found = {"tables": tables(given.folder, adapters()), "sums": sums(given.folder), "small": small_sum()}
    if given.page is not None:
        text = all_replaced(
            given.page.read_text(encoding="utf-8"), found | {"tables": found["tables"] + measured_line([stamp()])}
        )
        given.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
