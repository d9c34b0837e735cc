"""Where the processor time of a cold `make` goes: `python -m tests.bench.make_stages [OPTIONS OF make]`, such as --no-verify.

Seconds of each stage without those of the stages that it calls, as shares of the whole process, in the best of some runs.
"""

from __future__ import annotations

import builtins
import json
import os
import subprocess
import sys
import tempfile
from argparse import ArgumentParser
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from inspect import isgeneratorfunction
from pathlib import Path
from time import process_time
from typing import Any

RUNS = 3
REST = "the rest"
STAGES = {
    "plan, layout, rules, certificate": [("kit.examine.order", "examine_order")],
    "layers and lists": [("make.kit", "render_all")],
    "previews": [("kit.writer", "render_preview"), ("kit.writer", "render_placement_preview")],
    "notes and drawings": [("make.kit", f"render_{name}") for name in ("order_notes", "fab_drawing", "fab_dxf")],
    "models": [("make.kit", "render_models")],
    "writing, with digests": [("make.kit", "write_kit"), ("make.publish", "sync_below")],
    "report": [("make.kit", "add_report")],
    "verify, the rest": [("verify", "verify_folder")],
    "verify: Gerber by gerbonara": [("verify.film", "read_gerber")],
    "verify: Gerber by our grammar": [("verify.kit", "check_form")],
    "verify: KiCad": [("verify.kit", "check_kicad")],
    "verify: models": [("verify.kit", "check_models")],
    "verify: round trip": [("verify.kit", "quick_trip")],
    "verify: certificate": [("verify.kit", "check_certificate")],
}
"""Stages by the functions that each is, where they are looked up."""


class Clock:
    """Processor time of this process by stage; what began before it counts as importing."""

    def __init__(self) -> None:
        self.open, self.since = ["imports"], 0.0
        self.spent: dict[str, float] = {}

    def _count(self) -> None:
        now = process_time()
        self.spent[self.open[-1]] = self.spent.get(self.open[-1], 0.0) + now - self.since
        self.since = now

    def staged(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, its time taken from the stage that calls it."""

        @wraps(function)
        def timed(*args: Any, **options: Any) -> Any:
            self._count()
            self.open.append(name)
            try:
                return [*function(*args, **options)] if isgeneratorfunction(function) else function(*args, **options)
            finally:
                self._count()
                self.open.pop()

        return timed


def measured(options: list[str]) -> dict[str, float]:
    """Seconds by stage of a `make` in this process."""
    clock, verified = Clock(), "--no-verify" not in options
    builtins.__import__ = clock.staged("imports", builtins.__import__)
    from tactape_fab.cli import main as command

    for name, functions in STAGES.items():
        for module, function in functions if verified or not name.startswith("verify") else ():
            where = import_module(f"tactape_fab.{module}")
            setattr(where, function, clock.staged(name, getattr(where, function)))
    clock.open[0] = REST
    with tempfile.TemporaryDirectory() as folder:
        command(["make", "--sector", "7", "-o", str(Path(folder, "kit")), *options], standalone_mode=False)
        clock.staged(REST, lambda: None)()
    return clock.spent


def main() -> None:
    parser = ArgumentParser(description=__doc__, usage="%(prog)s [OPTIONS OF make]")
    parser.add_argument("--here", action="store_true", help="measure this process once, and print JSON")
    given, options = parser.parse_known_args()
    if given.here:
        found = measured(options)
        print("\n" + json.dumps(found))
        return
    command = [sys.executable, "-m", "tests.bench.make_stages", *sys.argv[1:], "--here"]
    with tempfile.TemporaryDirectory() as folder:
        env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        env["PYTHONPYCACHEPREFIX"] = folder  # compiled modules, as an installation has them
        runs = [
            json.loads(subprocess.run(command, check=True, capture_output=True, text=True, env=env).stdout.splitlines()[-1])
            for _ in range(RUNS + 1)
        ][1:]  # the first run compiled them
    best = min(runs, key=lambda run: sum(run.values()))
    whole = sum(best.values())
    print(f"| stage of a cold make {' '.join(sys.argv[1:])}| s | share |\n|---|---|---|")
    for name, seconds in sorted(best.items(), key=lambda item: -item[1]):
        print(f"| {name} | {seconds:.3f} | {100 * seconds / whole:.0f} % |")
    print(f"| all | {whole:.3f} | 100 % |")


if __name__ == "__main__":
    main()
