"""How often textures are located that should not be, at full size: `python -m tests.bench.false_accepts --json FILE`.

Counts go to the file as they come, a line a job; the same command takes up again what was interrupted, and asks for more
frames where it is told to. Every frame has its own seed: the figures do not depend on processes, order, or interruptions.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import tactape_fab
from tactape_fab.base.pool import Workers, mapped_as_done
from tests.bench.false_tally import Bound, Tally, total
from tests.bench.impostors import SURFACES
from tests.bench.localization_false import BESIDE_BUMPS, IMPOSTORS, MIRRORED, PART, Job, count
from tests.bench.localization_measure import WORLDS
from tests.bench.localization_rows import SECTOR, SEED
from tests.bench.workers import workers

OTHERS = tuple(sector for sector in range(256) if sector != SECTOR)
NEIGHBOURS = tuple(SECTOR + step for step in (-1, 1, -7, 16, 17, 32, 34))
"""Sectors that a common origin makes most alike; sector 0 stands for those below 16 and 17."""
BESIDE = (SECTOR + 17, SECTOR + 1)
SECTORS_DOTS = "other sectors, dots"
SECTORS_DEPTH = "other sectors, depth maps"
WORST_DEPTH = "worst sector, depth maps"
COMMON_DOTS = "other sectors at a common origin, dots"
_SOURCES = ("texture/**/*.py", "kit/profiles/*.py", "sense/*.py", "sense/simulation/*.py", "sense/decode/**/*.py")
"""Modules of the package by which frames are drawn and located."""
_FRAMES = ("localization_false.py", "localization_rows.py", "dot_records.py")

Done = dict[Job, Tally]


# What is asked


def jobs_of(kind: str, subject: str, level: Any, frames: int, **options: Any) -> list[Job]:
    """Jobs for some frames of a subject."""
    return [
        Job(kind=kind, subject=subject, level=level, part=part, frames=min(PART, frames - part * PART), **options)
        for part in range(-(-frames // PART))
    ]


def plan(per_sector: int, per_kind: int) -> list[Job]:
    """All jobs but those for the worst sector, which the others must find first.

    Parameters
    ----------
    per_sector : int
        Frames for each other sector.
    per_kind : int
        Frames for each kind of texture that is no tape; through depth maps a fifth where dots have been counted.
    """
    jobs: list[Job] = []
    for world in WORLDS:
        for name in (*IMPOSTORS, MIRRORED):
            jobs += jobs_of(f"{name}, dots, {world} world", name, "dots", per_kind, world=world)
            jobs += jobs_of(f"{name}, depth maps, {world} world", name, "depth maps", per_kind // 5, world=world)
        for name in SURFACES:
            jobs += jobs_of(f"{name}, depth maps, {world} world", name, "depth maps", per_kind, world=world)
    for sector in BESIDE:
        for common, origin in ((True, "common origin"), (False, "default origins")):
            kind = f"over the edge beside bumps, {origin}, dots"
            jobs += jobs_of(kind, f"sector {sector}", "dots", per_kind // 2, common=common, contact=BESIDE_BUMPS)
    for sector in OTHERS:
        subject = f"sector {sector}"
        jobs += jobs_of(SECTORS_DEPTH, subject, "depth maps", -(-per_kind // len(OTHERS)))
        few = -(-per_sector // 10) if sector not in NEIGHBOURS else max(per_sector, per_kind // len(NEIGHBOURS))
        jobs += jobs_of(COMMON_DOTS, subject, "dots", few, common=True)
        jobs += jobs_of(SECTORS_DOTS, subject, "dots", per_sector)
    return jobs


def worst_jobs(done: Done, per_kind: int) -> list[Job]:
    """Jobs for the sector that was located most often as dots, or else came nearest."""
    worst = worst_subject(done, SECTORS_DOTS)
    return jobs_of(WORST_DEPTH, worst, "depth maps", per_kind // 5) if worst is not None else []


def worst_subject(done: Done, kind: str) -> str | None:
    """The subject of a kind with the most located frames; among equals, with the least p_place."""
    tallies = by_subject(done, kind)
    return max(tallies, key=lambda name: (tallies[name].located, -tallies[name].least["p_place"])) if tallies else None


def by_subject(done: Done, kind: str) -> dict[str, Tally]:
    """Tallies of a kind's subjects."""
    found: dict[str, list[Tally]] = {}
    for job in sorted(done, key=lambda job: (job.subject, job.part)):
        if job.kind == kind:
            found.setdefault(job.subject, []).append(done[job])
    return {name: total(tallies) for name, tallies in found.items()}


def bound_of(kind: str) -> Bound:
    """The part of p_false that speaks of such a texture: what is no code has p_tape, another place of the code p_place."""
    return "p_place" if "sector" in kind or "beside" in kind else "p_tape"


# Doing it


def run(jobs: Iterable[Job], processes: Workers) -> Iterator[tuple[Job, Tally]]:
    """Count jobs, in whatever order they come to an end."""
    return mapped_as_done(count, jobs, processes)


@dataclass(slots=True)
class Record:
    """The file of what is done: a line of what it is about, then one for each job."""

    path: Path | None
    done: Done

    @classmethod
    def opened(cls, path: Path | None) -> Record:
        """A file as it stands, or a new one; a last line that was cut off does not count.

        Raises
        ------
        SystemExit
            When it is of another seed or of other sources.
        """
        if path is None:
            return cls(path, {})
        lines = path.read_text().splitlines() if path.exists() else []
        if lines and json.loads(lines[0]) != about():
            sys.exit(f"{path} was counted with another seed or other sources; give another file")
        record = cls(path, cls.read(path) if lines else {})
        path.write_text("".join(line + "\n" for line in [json.dumps(about()), *map(_line, record.done.items())]))
        return record

    @classmethod
    def read(cls, path: Path) -> Done:
        """What a file holds, of whatever sources; a last line that was cut off does not count."""
        done: Done = {}
        for line in path.read_text().splitlines()[1:]:
            try:
                values = json.loads(line)
            except json.JSONDecodeError:
                continue
            done[Job(**values["job"])] = Tally.from_mapping(values["tally"])
        return done

    def add(self, job: Job, tally: Tally) -> None:
        """Keep a job's counts."""
        self.done[job] = tally
        if self.path is not None:
            with self.path.open("a") as stream:
                stream.write(_line((job, tally)) + "\n")


def _line(item: tuple[Job, Tally]) -> str:
    return json.dumps({"job": asdict(item[0]), "tally": item[1].to_mapping()})


def sources() -> list[Path]:
    """Files that decide an answer, in the order of their paths."""
    package, here = Path(tactape_fab.__file__).parent, Path(__file__).parent
    return sorted([*(path for pattern in _SOURCES for path in package.glob(pattern)), *(here / name for name in _FRAMES)])


def about() -> Mapping[str, Any]:
    """Seed, and a digest of everything that decides an answer."""
    digest = hashlib.sha256()
    for path in sources():
        digest.update(path.name.encode() + path.read_bytes())
    return {"seed": SEED, "sources": digest.hexdigest()[:16]}


def complete(jobs: list[Job], record: Record, processes: Workers, say: Callable[[str], None]) -> None:
    """Count what is not in the record yet."""
    todo = [job for job in jobs if job not in record.done]
    say(f"{len(jobs) - len(todo)} of {len(jobs)} jobs are done, {sum(job.frames for job in todo)} frames to go")
    start, frames, whole = perf_counter(), 0, sum(job.frames for job in todo)
    for job, tally in run(todo, processes):
        record.add(job, tally)
        frames += job.frames
        left_min = (perf_counter() - start) / frames * (whole - frames) / 60
        found = f"{tally.located} of {tally.frames} located" + (f": {tally.accepted}" if tally.accepted else "")
        say(f"{100 * frames / whole:5.1f} %, {left_min:.0f} min left; {job.kind}, {job.subject}, part {job.part}: {found}")


# Saying it


def table(done: Done) -> str:
    """What was counted, a line a kind."""
    lines = [f"{'kind':<46}{'frames':>9}{'located':>8}{'below':>9}{'least p_false':>15}{'and':>16}  worst"]
    for kind in sorted({job.kind for job in done}):
        tallies = by_subject(done, kind)
        whole, bound, worst = total(tallies.values()), bound_of(kind), worst_subject(done, kind)
        assert worst is not None
        one = tallies[worst]
        named = f"{worst}: {one.located} of {one.frames}, below {one.most_likely:.1e}" if len(tallies) > 1 else worst
        lines.append(
            f"{kind:<46}{whole.frames:>9}{whole.located:>8}{whole.most_likely:>9.1e}{whole.least['p_false']:>15.1e}"
            f"{bound:>8}{whole.least[bound]:>8.1e}  {named}{f' {dict(whole.by)}' if whole.by else ''}"
        )
        lines += [f"    {name}" for name in whole.accepted[:20]]
    whole = total(done.values())
    lines.append(
        f"a frame: {1e6 * whole.made_s / whole.frames:.0f} us to make, {1e6 * whole.located_s / whole.frames:.0f} to locate"
    )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.false_accepts", description=__doc__)
    parser.add_argument("--frames-per-sector", type=int, default=10000, metavar="N")
    parser.add_argument("--frames-per-kind", type=int, metavar="N", help="as many as for a sector unless said")
    parser.add_argument("--json", type=Path, metavar="FILE", help="JSON lines; taken up again where it exists")
    parser.add_argument("--workers", type=workers, default=2, metavar="N|tcp://HOST:PORT")
    parser.add_argument("--only", metavar="WORDS", help="kinds whose name holds these words")
    chosen = parser.parse_args()
    per_kind = chosen.frames_per_sector if chosen.frames_per_kind is None else chosen.frames_per_kind

    def say(words: str) -> None:
        print(words, file=sys.stderr, flush=True)

    def wanted(jobs: list[Job]) -> list[Job]:
        return [job for job in jobs if chosen.only is None or chosen.only in job.kind]

    def done(jobs: list[Job]) -> Done:
        complete(jobs, record, chosen.workers, say)
        return {job: record.done[job] for job in jobs}

    record = Record.opened(chosen.json)
    counted = done(wanted(plan(chosen.frames_per_sector, per_kind)))
    print(table(counted | done(wanted(worst_jobs(counted, per_kind)))))


if __name__ == "__main__":
    main()
