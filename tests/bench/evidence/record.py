"""The file of what was measured: a line about the machine and the sources, then one for each job, as they come."""

from __future__ import annotations

import json
import platform
import sys
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2

import tactape_fab
from tactape_fab.sense import load_sensor
from tests.bench.evidence.job import Job, Result
from tests.bench.localization_rows import SEED
from tests.bench.marks import digest

LIBRARIES = ("numpy", "numba", "scipy")


def about() -> dict[str, Any]:
    """What all figures of a file have in common."""
    return {
        "tactape_fab": tactape_fab.__version__,
        "sources": digest(),
        "seed": SEED,
        "noise": load_sensor("gelsight-mini").slope_noise,
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}, {_processor()}",
        **{name: version(name) for name in LIBRARIES},
        "opencv": cv2.__version__,
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    names = [line for line in info.read_text().splitlines() if line.startswith("model name")] if info.is_file() else []
    return f"{len(names)} x {names[0].partition(':')[2].strip()}" if names else platform.processor() or "processor unknown"


@dataclass(slots=True)
class Record:
    """Results by the key of their job."""

    path: Path
    about: dict[str, Any]
    results: dict[str, dict[str, Any]]

    @classmethod
    def opened(cls, path: Path) -> Record:
        """A file as it stands, or a new one; a last line that was cut off does not count.

        Raises
        ------
        SystemExit
            When it is of other sources or of another machine.
        """
        record = cls(path, about(), {})
        lines = path.read_text().splitlines() if path.exists() else []
        if lines and json.loads(lines[0]) != record.about:
            sys.exit(f"{path} was measured with other sources or on another machine; give another file")
        for line in lines[1:]:
            try:
                entry = json.loads(line)
            except json.JSONDecodeError:
                continue
            record.results[entry.pop("key")] = entry
        path.write_text("".join(json.dumps(line) + "\n" for line in [record.about, *record._lines()]))
        return record

    def _lines(self) -> list[dict[str, Any]]:
        return [{"key": key, **entry} for key, entry in self.results.items()]

    def keep(self, job: Job, result: Result, seconds: float) -> None:
        """Add what a job returned."""
        entry = {"section": job.section, "name": job.name, "options": dict(job.options), "result": result}
        self.results[job.key] = entry | {"seconds": round(seconds, 3)}
        with self.path.open("a") as stream:
            stream.write(json.dumps({"key": job.key, **self.results[job.key]}) + "\n")


def results_of(content: dict[str, Any], section: str) -> dict[str, Result]:
    """Results of a section by name, from the content of an evidence file."""
    return {entry["name"]: entry["result"] for entry in content["results"] if entry["section"] == section}
