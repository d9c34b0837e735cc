"""Measure everything that docs/evidence.md says, and make the page: `python -m tests.bench [--quick]`.

Results go to the file as they come; the same command takes up again what was interrupted.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from contextlib import closing
from operator import methodcaller
from pathlib import Path
from time import perf_counter

from tactape_fab.base.pool import Workers, mapped_as_done
from tests.bench.evidence import counts, readme
from tests.bench.evidence.job import FULL, QUICK, Job, Result
from tests.bench.evidence.page import FIGURES_JSON, MEASURED, jobs, page_of, write_page
from tests.bench.evidence.record import Record, about
from tests.bench.workers import workers


def say(words: str) -> None:
    """A line on stderr."""
    print(words, file=sys.stderr, flush=True)


def measure(wanted: Iterable[Job], record: Record, processes: Workers) -> None:
    """Run all jobs that have no result yet, those that measure times first and one by one."""
    todo = [job for job in wanted if job.key not in record.results]
    start, done = perf_counter(), 0

    def keep(job: Job, result: Result, seconds: float) -> None:
        nonlocal done
        done += 1
        record.keep(job, result, seconds)
        left_min = (perf_counter() - start) / done * (len(todo) - done) / 60
        say(f"{done} of {len(todo)}, {left_min:.1f} min left; {job.section}: {job.name}, {seconds:.1f} s")

    for job in todo:
        if job.alone or processes == 1:
            keep(job, *job.timed())
    rest = [job for job in todo if not job.alone and processes != 1]
    with closing(mapped_as_done(methodcaller("timed"), rest, processes)) as results:
        for job, (result, seconds) in results:
            keep(job, result, seconds)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer contacts: some minutes")
    parser.add_argument("--json", type=Path, metavar="FILE", help="JSON lines; taken up again where it exists")
    about_counts = (
        "what tests.bench.false_accepts --json wrote; a job in two of them counts as the later file has it; "
        "those of docs/evidence.json unless said"
    )
    parser.add_argument("--counts", type=Path, nargs="+", default=[], metavar="FILE", help=about_counts)
    parser.add_argument("--workers", type=workers, default=2, metavar="N|tcp://HOST:PORT")
    about_page = "where evidence.json, the page and its plots go; docs/ unless said, and then the README's numbers, too"
    parser.add_argument("--page", type=Path, metavar="FOLDER", help=about_page)
    parser.add_argument("--sources", action="store_true", help="only print the digest of the sources that figures are made with")
    about_keep = "sections whose figures are not measured anew but taken from docs/evidence.json; the page names their sources"
    sections = [section.SECTION for section in MEASURED]
    parser.add_argument("--keep", choices=sections, nargs="+", default=[], metavar="SECTION", help=about_keep)
    chosen = parser.parse_args()
    if chosen.sources:
        print(about()["sources"])
        return
    try:
        counted = counts.entries(chosen.counts)
    except (OSError, LookupError, TypeError, ValueError) as error:
        parser.error(f"--counts: {error}; give files that tests.bench.false_accepts --json wrote")
    size = QUICK if chosen.quick else FULL
    record = Record.opened(chosen.json or Path(f"evidence-{size.name}.jsonl"))
    wanted = [job for job in jobs(size) if job.section not in chosen.keep]
    measure(wanted, record, chosen.workers)
    folder = chosen.page or FIGURES_JSON.parent
    kept = []
    if FIGURES_JSON.exists():
        earlier = json.loads(FIGURES_JSON.read_text(encoding="utf-8"))
        sources = {"sources": earlier["about"]["sources"]}
        kept = [sources | entry for entry in earlier["results"] if entry["section"] in chosen.keep]
        if not counted:  # counting takes a day: each row names the sources it was counted with
            counted = [entry for entry in earlier["results"] if entry["section"] == counts.SECTION]
    content = {
        "size": size.name,
        "about": record.about,
        "results": [record.results[job.key] for job in wanted] + kept + counted,
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / FIGURES_JSON.name).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    for path in write_page(content, folder):
        say(str(path))
    if chosen.page is None:
        say(str(readme.write(content)))
    print(page_of(content))


if __name__ == "__main__":
    main()
