"""What this installation can do: versions, outside programs, extras, and whether the decoder is compiled."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import tactape_fab
from tactape_fab.base.launch import FREECAD, PRUSA_SLICER, installed, run

PACKAGE = "tactape-fab"
EXTRAS = {
    "cad": "emboss puts a texture on a part of yours; verify reads STEP models with OCCT",
    "raw": "decode and watch read colour images of the gel",
    "live": "watch writes MCAP files",
    "rerun": "watch shows what it sees in the Rerun viewer",
    "verify": "verify reads the printed AprilTag with a second detector",
    "evidence": "python -m tests.bench draws the curves of the evidence",
    "docs": "zensical builds this documentation",
    "dev": "the tests and everything that checks the sources",
}
"""What each extra of pyproject.toml adds."""
_REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)\s*(?:\[(?P<extras>[\w,\s-]*)\])?")
_IN_EXTRA = re.compile(r"""extra\s*==\s*['"](?P<extra>[\w-]+)['"]""")
_PATIENCE_S = 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Program:
    """An outside program: its path, or None where it is not installed; what it adds, and what brings it."""

    name: str
    path: str | None
    adds: str
    remedy: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Extra:
    """An extra of this package: version of each distribution that it asks for, None where that is not installed."""

    name: str
    packages: Mapping[str, str | None]
    adds: str

    @property
    def installed(self) -> bool:
        return bool(self.packages) and None not in self.packages.values()


@dataclass(frozen=True, slots=True, kw_only=True)
class Decoder:
    """Whether the decoder is compiled, and the folder that keeps it; None where none can be written."""

    compiled: bool
    cache: str | None
    problem: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """All of it; ``libraries`` are the versions of what the package itself needs, None where one is missing."""

    version: str
    python: str
    machine: str
    cores: int
    package: str
    templates: str | None
    libraries: Mapping[str, str | None]
    decoder: Decoder
    programs: tuple[Program, ...]
    extras: tuple[Extra, ...]

    def to_mapping(self) -> dict[str, Any]:
        extras = [{**asdict(extra), "installed": extra.installed} for extra in self.extras]
        return {**asdict(self), "extras": extras}


def diagnose() -> Diagnosis:
    """Look at the installation; nothing is compiled and nothing but a cache folder is written."""
    required = _required()
    return Diagnosis(
        version=tactape_fab.__version__,
        python=f"{platform.python_implementation()} {platform.python_version()}",
        machine=f"{platform.system()} {platform.machine()}",
        cores=os.cpu_count() or 1,
        package=str(Path(tactape_fab.__file__).resolve().parent),
        templates=_templates(),
        libraries=_versions(required.get("", [])),
        decoder=_decoder(),
        programs=_programs(),
        extras=tuple(Extra(name=name, packages=_versions(required.get(name, [])), adds=adds) for name, adds in EXTRAS.items()),
    )


def _required() -> dict[str, list[str]]:
    """Distributions that this package asks for, by extra; those that it always needs under the empty name.

    Nothing where the package is not installed but only on the path.
    """
    try:
        lines = metadata.requires(PACKAGE) or []
    except metadata.PackageNotFoundError:
        return {}
    rows: dict[str, list[str]] = {}
    for line in lines:
        requirement, _, condition = line.partition(";")
        found, extra = _REQUIREMENT.match(requirement), _IN_EXTRA.search(condition)
        if found is None:
            continue
        names = rows.setdefault(extra["extra"] if extra else "", [])
        names += [f"[{inner.strip()}]" for inner in found["extras"].split(",")] if found["extras"] else [found["name"]]
    return {extra: sorted({found for name in names for found in _spread(name, rows)}) for extra, names in rows.items()}


def _spread(name: str, rows: Mapping[str, list[str]]) -> list[str]:
    """A name, or the names of the extra that it is in brackets."""
    return [name] if not name.startswith("[") else [n for n in rows.get(name[1:-1], []) if not n.startswith("[")]


def _versions(names: list[str]) -> dict[str, str | None]:
    found: dict[str, str | None] = {}
    for name in names:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    return found


def _templates() -> str | None:
    from tactape_fab.base.templates import templates_folder

    try:
        return str(templates_folder())
    except FileNotFoundError:
        return None


def _decoder() -> Decoder:
    """What numba has on the disk; a library that does not load is said, for that is what a doctor is asked about."""
    try:
        from tactape_fab.sense.decode.warm import cache_folder, compiled
    except Exception as error:
        return Decoder(compiled=False, cache=None, problem=f"{type(error).__name__}: {error}".splitlines()[0])
    folder = cache_folder()
    return Decoder(compiled=compiled(), cache=None if folder is None else str(folder))


def _programs() -> tuple[Program, ...]:
    drawn = "the tests draw Gerber layers with it"
    browsers = ("chromium", "chromium-browser", "google-chrome")
    rows = (
        ("FreeCAD", installed(FREECAD), "verify reads the STEP models with it", "freecad-python3, or freecad"),
        ("PrusaSlicer", installed(PRUSA_SLICER), "verify reads the STL and 3MF models with it", "prusa-slicer"),
        ("KiCad", installed(("kicad", "pcbnew")), "opens the kit's board; the tests read it with it", "kicad"),
        ("gerbv", installed(("gerbv",)), f"shows Gerber files; {drawn}", "gerbv"),
        ("gerber-to-svg", _node_module("gerber-to-svg"), drawn, "npm's gerber-to-svg, and name its node_modules in NODE_PATH"),
        ("rsvg-convert", installed(("rsvg-convert",)), "the tests draw SVG files with it", "librsvg2-bin"),
        ("Chromium", installed(browsers), "the tests open pages in it", "chromium"),
    )
    return tuple(Program(name=name, path=path, adds=adds, remedy=remedy) for name, path, adds, remedy in rows)


def _node_module(name: str) -> str | None:
    """Where Node.js finds a module; None without it or without Node.js."""
    node = installed(("node",))
    if node is None:
        return None
    command = [node, "-p", f"require.resolve({name!r})"]
    try:
        answer = run(command, timeout_s=_PATIENCE_S)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return answer.stdout.strip() or None if answer.returncode == 0 else None
