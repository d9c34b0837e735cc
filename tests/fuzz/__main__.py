"""Entry points under attack for as long as asked: `python -m tests.fuzz --seconds 60` gives each a minute of processor time.

Where Atheris is installed it guides the changes by what code they reach (libFuzzer); elsewhere the same changes come at random.
Each is attacked in a process of its own with limits of time and memory, so that one that dies is reported, too. Every input that
found a fault is kept below `build/fuzz`; `--again FILE --entry NAME` gives it to its entry point once more.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import multiprocessing
import os
import signal
import sys
import tempfile
import time
import warnings
from dataclasses import asdict
from pathlib import Path
from random import Random
from typing import Any

if importlib.util.find_spec("atheris") is not None and "--plain" not in sys.argv:
    import atheris

    with atheris.instrument_imports(include=["tactape_fab"], enable_loader_override=False):
        from tests.fuzz.entries import Entry, all_entries
else:
    atheris = None
    from tests.fuzz.entries import Entry, all_entries

from tests.bench.marks import write_between
from tests.fuzz.cases import Fault, install_watch, limit_memory, run_case
from tests.fuzz.mutate import MOST_BYTES, mutated
from tests.fuzz.seeds import make_seeds

KEPT = Path("build") / "fuzz"
_MOST_SEED_BYTES = 100_000
"""libFuzzer begins with smaller ones: it copies and keeps what it tries."""
_LATE_S = 120.0
"""A process that has told nothing for so long hangs where no signal reaches it."""
_MOST_DEATHS = 20
_NEVER_S = 100_000
"""libFuzzer's own limit of one input: `run_case` has ours. With 0 Atheris 3.0 ends the process (status 77) where its alarm, once
a second, finds an input that was begun in the second before."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="processor time for each entry point")
    parser.add_argument("--entry", action="append", default=[], help="only this one; may be repeated")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--at-a-time", type=int, default=2)
    parser.add_argument("--plain", action="store_true", help="without Atheris")
    parser.add_argument("--page", type=Path, help="a page between whose marks the table is written")
    parser.add_argument("--again", type=Path, help="a file that found a fault")
    asked = parser.parse_args()
    entries = all_entries(make_seeds())
    entries = {name: entries[name] for name in asked.entry} or entries
    install_watch()
    if asked.again:
        with tempfile.TemporaryDirectory() as folder:
            for entry in entries.values():
                print(run_case(entry.read, asked.again.read_bytes(), Path(folder)) or "no fault")
        return
    waiting = list(entries)
    running: list[_Attack] = []
    done: dict[str, _Attack] = {}
    while waiting or running:
        while waiting and len(running) < asked.at_a_time:
            name = waiting.pop(0)
            running.append(_Attack(name, entries[name], asked.seconds, asked.seed))
        time.sleep(0.2)
        for attack in [attack for attack in running if attack.is_over()]:
            running.remove(attack)
            done[attack.name] = attack
            print(attack.told(), flush=True)
    table = _table([done[name] for name in entries], asked.seconds)
    print(f"\n{table}")
    if asked.page is not None:
        write_between(asked.page, "fuzz", table)
    sys.exit(any(attack.faults for attack in done.values()))


def _table(attacks: list[_Attack], seconds: float) -> str:
    how = "random changes" if atheris is None else "Atheris"
    head = f"| entry point | executions ({how}, {seconds:g} seconds each) | refused | faults |\n|---|--:|--:|--:|\n"
    rows = [(attack.name, attack.executions, attack.refused, len(attack.faults)) for attack in attacks]
    rows.append(
        (f"{len(rows)} entry points", sum(row[1] for row in rows), sum(row[2] for row in rows), sum(row[3] for row in rows))
    )
    return head + "".join(f"| {name} | {executions:,} | {refused:,} | {faults} |\n" for name, executions, refused, faults in rows)


class _Attack:
    """The attack on one entry point, by one process after another where they die; and what was found."""

    def __init__(self, name: str, entry: Entry, seconds: float, seed: int) -> None:
        self.name, self.executions, self.refused, self.faults = name, 0, 0, dict[tuple[str, str], dict[str, Any]]()
        self._entry, self._seconds, self._seed, self._deaths = entry, seconds, seed, 0
        self._scratch = tempfile.TemporaryDirectory(prefix="tactape-fuzz-", ignore_cleanup_errors=True)
        self._folder = Path(self._scratch.name)
        self._start()

    def _start(self) -> None:
        (self._folder / "tally.json").write_text("{}")
        arguments = (self.name, self._entry, self._seconds, self._seed + 1000 * self._deaths, self._folder)
        self._process = multiprocessing.get_context("fork").Process(target=_attack, args=arguments)
        self._process.start()

    def is_over(self) -> bool:
        """Whether it is; a process that died is replaced for the time that was left to it."""
        tally = self._folder / "tally.json"
        if self._process.is_alive():
            if time.time() - tally.stat().st_mtime < _LATE_S:
                return False
            self._process.kill()
        self._process.join()
        told = json.loads(tally.read_text() or "{}")
        self.executions += told.get("executions", 0)
        self.refused += told.get("refused", 0)
        self.faults |= {(fault["kind"], fault["place"]): fault for fault in told.get("faults", [])}
        status = self._process.exitcode or 0
        if status == 0:
            self._scratch.cleanup()
            return True
        case = self._folder / "case"
        kept = _keep(self.name, case.read_bytes() if case.exists() else b"")
        what = "hangs" if status == -signal.SIGKILL else f"dies of {status}"
        self.faults[what, ""] = {"kind": what, "place": "", "message": "", "file": str(kept)}
        self._seconds -= told.get("spent", 1.0)
        self._deaths += 1
        if self._seconds <= 0.0 or self._deaths > _MOST_DEATHS:
            return True
        self._start()
        return False

    def told(self) -> str:
        lines = [f"{self.name}: {self.executions:,} executions, {self.refused:,} refused, {len(self.faults)} faults"]
        for fault in self.faults.values():
            lines.append(f"  {fault['kind']} at {fault['place'] or '?'}: {fault['message']} ({fault['file']})")
        return "\n".join(lines)


def _keep(name: str, data: bytes) -> Path:
    folder = KEPT / "".join(c if c.isalnum() else "-" for c in name)
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / hashlib.sha256(data).hexdigest()[:12]
    kept.write_bytes(data)
    return kept


def _attack(name: str, entry: Entry, seconds: float, seed: int, folder: Path) -> None:
    """Give an entry point changed bytes until the processor time is over; the process ends here."""
    tempfile.tempdir = str(folder)
    place = folder / "place"
    place.mkdir(exist_ok=True)
    os.dup2(os.open(folder / "said", os.O_WRONLY | os.O_CREAT), 2)  # libpng and others say much
    warnings.simplefilter("error")  # one that the user would see is a fault
    tally: dict[str, Any] = {"executions": 0, "refused": 0, "faults": [], "spent": 0.0}
    known: set[tuple[str, str]] = set()
    begun, told = time.process_time(), 0.0

    def keep(fault: Fault, data: bytes) -> None:
        if (fault.kind, fault.place) not in known:
            known.add((fault.kind, fault.place))
            tally["faults"].append({**asdict(fault), "file": str(_keep(name, data))})

    def refused() -> None:
        tally["refused"] += 1

    def one(data: bytes) -> None:
        nonlocal told
        (folder / "case").write_bytes(data)
        fault = run_case(entry.read, data, place, refused)
        tally["executions"] += 1
        if fault is not None:
            keep(fault, data)
        if (spent := time.process_time() - begun) - told > 0.5 or fault is not None:
            told = tally["spent"] = spent
            partial = folder / "tally.part"
            partial.write_text(json.dumps(tally))
            partial.replace(folder / "tally.json")
            if spent > seconds:
                os._exit(0)

    for data in entry.seeds:  # what is imported and compiled at the first use is nobody's fault
        if (fault := run_case(entry.read, data, place)) is not None:
            keep(fault, data)
    limit_memory()
    others, chance = tuple(entry.seeds), Random(f"{name} {seed}")
    if atheris is None:
        while True:
            one(mutated(chance.choice(others), chance, others))
    corpus = folder / "corpus"
    corpus.mkdir(exist_ok=True)
    for i, data in enumerate(data for data in others if len(data) <= _MOST_SEED_BYTES):
        (corpus / str(i)).write_bytes(data)

    def changed(data: bytes, most: int, seed: int) -> bytes:
        chance = Random(seed)
        if chance.random() < 0.3:
            return bytes(atheris.Mutate(data, most))
        return mutated(data if chance.random() < 0.8 else chance.choice(others), chance, others)[:most]

    options = [
        f"-artifact_prefix={folder}/",
        f"-max_len={MOST_BYTES}",
        "-len_control=0",
        f"-timeout={_NEVER_S}",
        "-rss_limit_mb=0",
        f"-seed={seed}",
    ]
    atheris.Setup([sys.argv[0], str(corpus), *options], one, custom_mutator=changed)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
