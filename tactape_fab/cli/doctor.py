"""doctor: reports on the installation: versions, outside programs, extras, and whether the decoder is compiled."""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import tactape_fab
from tactape_fab.base.errors import Problem, refuse, tried
from tactape_fab.base.launch import FREECAD, PRUSA_SLICER, installed, run
from tactape_fab.base.libraries import library
from tactape_fab.cli.exits import answers, with_options
from tactape_fab.cli.printing import echo_json, echo_lines, table_lines

if TYPE_CHECKING:
    from tactape_fab.sense.calibrate.first_frames import FirstFrames

PACKAGE = "tactape-fab"
EXTRAS = {
    "cad": "emboss puts a texture on a part of yours; verify reads STEP models with OCCT",
    "measure": "inspect, survey and calibrate measure a tape as it was built and a sensor as it is",
    "raw": "decode and watch read colour images of the gel",
    "live": "watch writes MCAP files",
    "rerun": "watch shows what it sees in the Rerun viewer",
    "lerobot": "LeRobot, which records what the plugin in docs/examples sees; decode reads its datasets",
    "zenoh": "watch publishes its messages over Zenoh",
    "slam": "located contacts as factors of GTSAM",
    "sign": "make signs a kit, and verify asks for the signature",
    "verify": "verify reads the printed AprilTag with a second detector",
    "cluster": "--workers tcp://HOST:PORT gives the work to a Dask cluster",
    "evidence": "python -m tests.bench draws the curves of the evidence",
    "docs": "zensical builds this documentation",
    "dev": "the tests and everything that checks the sources",
}
"""Extras of pyproject.toml, and what each adds."""
_REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)\s*(?:\[(?P<extras>[\w,\s-]*)\])?")
# the two kinds of markers (PEP 508) that pyproject.toml has: version of Python, and extra
_PYTHON = re.compile(r"""python_version\s*(<|>=)\s*['"](\d+)\.(\d+)['"]""")
_IN_EXTRA = re.compile(r"""extra\s*==\s*['"](?P<extra>[\w-]+)['"]""")
_PATIENCE_S = 20.0


@click.command()
@click.option("--sensor", "frames", multiple=True, metavar="FRAMES", help="Say what looks wrong in a sensor's frames instead.")
@click.option("--tape", "kits", multiple=True, metavar="KIT", help="With --sensor: the kit that was pressed.")
@click.option("--like", metavar="NAME|FILE.toml", help="With --sensor: profile to compare with.  [default: generic]")
@click.option("--json", "as_json", is_flag=True, help="Print what was found as JSON.")
def doctor(frames: Sequence[str], kits: Sequence[str], like: str | None, as_json: bool) -> None:
    """Say what this installation can do: versions, the compiled decoder, outside programs and extras, and what each adds.

    With --sensor, say what looks wrong in the first frames of a sensor.

    \b
    Example: tactape-fab doctor
    Example: tactape-fab doctor --sensor frames.npz --tape tactape-s007
    """
    if frames or kits or like is not None:
        with answers():
            looked = _look(frames, kits, like)
            echo_json(looked.to_mapping()) if as_json else echo_lines(frames_lines(looked))
        return
    found = diagnose()
    echo_json(found.to_mapping()) if as_json else echo_lines(diagnosis_lines(found))


def _look(frames: Sequence[str], kits: Sequence[str], like: str | None) -> FirstFrames:
    """Examine a sensor's frames; all invalid values are refused together."""
    library("scipy", "doctor --sensor")
    from tactape_fab.sense.calibrate.first_frames import look_at_frames
    from tactape_fab.sense.files.depth_maps import open_frame_file
    from tactape_fab.sense.sensors import load_sensor
    from tactape_fab.texture.registry import read_tapes

    problems: list[Problem] = []
    if not frames:
        problems.append(Problem("sensor", "--tape and --like belong to --sensor, and no frames are given; give --sensor FRAMES"))
    opened = [tried(partial(open_frame_file, name), problems) for name in frames]
    tapes = tried(lambda: read_tapes(kits), problems)
    sensor = tried(lambda: load_sensor(like or "generic", "like"), problems)
    scales = {file.px_per_mm for file in opened if file is not None}
    if len(scales) > 1:
        problems.append(Problem("sensor", "the files are of sensors with different px/mm; give --sensor one of them at a time"))
    refuse(problems)
    assert sensor is not None
    images = (depth for file in opened if file is not None for depth in file.frames())
    return look_at_frames(images, tapes or (), sensor, scales.pop())


def frames_lines(found: FirstFrames) -> list[str]:
    """The findings of frames as lines: one for each frame, then faults, then the next step."""
    verdicts = {None: "", True: "located", False: "not located"}
    rows = [(str(look.frame), str(look.dots), verdicts[look.located], look.reason or "") for look in found.frames]
    wrong = [f"wrong: {with_options(line)}" for line in found.wrong] or ["nothing looks wrong"]
    return [*table_lines(("frame", "dots", "", "reason"), rows), "", *wrong, f"next: {with_options(found.next_step)}"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Program:
    """An outside program: its path (None if not installed), what it adds, and the package to install."""

    name: str
    path: str | None
    adds: str
    remedy: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Extra:
    """An extra of this package, with the version of each distribution that it requires, None if that is not installed."""

    name: str
    packages: Mapping[str, str | None]
    adds: str

    @property
    def installed(self) -> bool:
        return bool(self.packages) and None not in self.packages.values()


@dataclass(frozen=True, slots=True, kw_only=True)
class Decoder:
    """Whether the decoder is compiled, and the folder of its cache, None if no folder can be written."""

    compiled: bool
    cache: str | None
    problem: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """Everything that `doctor` reports; ``libraries`` has the version of each dependency of the package, None if missing."""

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
    """Diagnose the installation; nothing is compiled, and only a cache folder may be made."""
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


def _of_this_python(condition: str) -> bool:
    """Whether a requirement's marker admits this version of Python; true if it does not mention one."""
    own = sys.version_info[:2]
    for sign, major, minor in _PYTHON.findall(condition):
        named = (int(major), int(minor))
        if not {"<": own < named, ">=": own >= named}[sign]:
            return False
    return True


def _required() -> dict[str, list[str]]:
    """Distributions that this package requires, by extra; those without an extra under the empty name.

    Empty if the package is only on the path, not installed.
    """
    try:
        lines = metadata.requires(PACKAGE) or []
    except metadata.PackageNotFoundError:
        return {}
    rows: dict[str, list[str]] = {}
    for line in lines:
        requirement, _, condition = line.partition(";")
        found, extra = _REQUIREMENT.match(requirement), _IN_EXTRA.search(condition)
        if found is None or not _of_this_python(condition):
            continue
        names = rows.setdefault(extra["extra"] if extra else "", [])
        own = found["extras"] if found["name"] == PACKAGE else None
        # an extra may require the package itself with other extras, as "dev" does; they are expanded, one level deep
        names += [f"[{inner.strip()}]" for inner in own.split(",")] if own else [found["name"]]
    return {extra: sorted({found for name in names for found in _spread(name, rows)}) for extra, names in rows.items()}


def _spread(name: str, rows: Mapping[str, list[str]]) -> list[str]:
    """The name itself, or if it is an extra in brackets, the names of that."""
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
    """State of the decoder's cache on disk; a library that cannot be loaded is not an error here."""
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
    """Path of a Node.js module; None without the module or without Node.js."""
    node = installed(("node",))
    if node is None:
        return None
    command = [node, "-p", f"require.resolve({name!r})"]
    try:
        answer = run(command, timeout_s=_PATIENCE_S)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return answer.stdout.strip() or None if answer.returncode == 0 else None


def diagnosis_lines(found: Diagnosis) -> list[str]:
    """The report as lines: installation, libraries, programs, extras, and how to install each missing one."""
    libraries = ", ".join(f"{name} {version or 'MISSING'}" for name, version in found.libraries.items())
    programs = [(p.name, p.path or "no", p.adds if p.path else f"{p.adds}; install {p.remedy}") for p in found.programs]
    extras = []
    for extra in found.extras:
        remedy = "" if extra.installed else f'; pip install "tactape-fab[{extra.name}]"'
        if found.libraries and not extra.packages:  # its markers exclude everything here
            remedy = "; not for this Python"
        extras.append((extra.name, "yes" if extra.installed else "no", f"{extra.adds}{remedy}"))
    return [
        f"tactape-fab {found.version}, {found.python}, {found.machine}, {found.cores} cores",
        f"package    {found.package}",
        f"templates  {found.templates or 'MISSING: install tactape-fab again'}",
        f"decoder    {_decoder_line(found.decoder)}",
        f"libraries  {libraries or 'unknown: the package is not installed, only on the path'}",
        "",
        *table_lines(("program", "found", "what it adds"), programs),
        "",
        *table_lines(("extra", "installed", "what it adds"), extras),
    ]


def _decoder_line(decoder: Decoder) -> str:
    if decoder.problem is not None:
        return f"cannot be loaded: {decoder.problem}"
    if decoder.cache is None:
        return "compiled anew by every process: no folder can be written; set NUMBA_CACHE_DIR to one that can"
    if decoder.compiled:
        return f"compiled, in {decoder.cache}"
    return f"not compiled yet: the first decode takes some twenty seconds more; then kept in {decoder.cache}"
