"""Fresh environments and pip's resolver: what an installation takes, and where one can be had."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from tactape_fab.base.templates import read_toml

ROOT = Path(__file__).parents[1]
PYTHONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
MACHINES = ("x86_64", "aarch64")
NUMPYS = {"1.26": "numpy==1.26.*", "2": "numpy>=2"}
ROBOT = ("numpy", "numba", "click")
"""What a robot installs beside the package itself."""
NO_WHEEL = {("3.13", "1.26"), ("3.14", "1.26")}
"""Python and numpy that never met: numpy 1.26 was built for up to Python 3.12."""

# pip takes tags and Requires-Python of the Python that it is asked about, but markers of the one that it runs in
_PIP_ELSEWHERE = """
import runpy, sys
from pip._vendor.packaging import markers
here, (version, machine) = markers.default_environment, sys.argv[1:3]
there = {"python_version": version, "python_full_version": version + ".0", "platform_machine": machine}
markers.default_environment = lambda: {**here(), **there}
sys.argv = ["pip", *sys.argv[3:]]
runpy.run_module("pip", run_name="__main__", alter_sys=True)
"""
_OLDER_NAMES = ("manylinux2014", "manylinux2010", "manylinux1")
_FOR_NUMPY_1 = "opencv-python-headless<4.12"
"""Newer ones ask for numpy 2. Said at once, pip does not have to find it by trying every version."""
_VENDORED = ("pip", "setuptools", "pkg_resources", "_distutils_hack")
"""What a fresh environment has before anything is installed."""


def clean_environment() -> dict[str, str]:
    """This process's environment without what would lead a child to this checkout or its compiled functions."""
    return {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "NUMBA", "VIRTUAL_ENV"))}


def requirements(*extras: str) -> list[str]:
    """What pyproject.toml asks for, with the extras."""
    project = read_toml(ROOT / "pyproject.toml", "pyproject")["project"]
    more = project["optional-dependencies"]
    return [*project["dependencies"], *(line for extra in extras for line in more[extra])]


def interpreter(version: str) -> str | None:
    """A Python of this version: one that the path names, or one of pyenv's."""
    folders = [Path(folder) for folder in os.get_exec_path()]
    folders += sorted((Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions").glob(f"{version}*/bin"))
    for folder in folders:
        program = folder / f"python{version}"
        if program.exists():
            run = subprocess.run([program, "-c", "import venv, ensurepip"], capture_output=True, check=False)
            if run.returncode == 0:
                return str(program)
    return None


def registry_answers() -> bool:
    """Whether pip reaches a registry here."""
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--no-deps", "--ignore-installed", "--quiet", "click"]
    return subprocess.run(command, env=clean_environment(), capture_output=True, check=False).returncode == 0


def cad_glibc(python: str) -> int:
    """Minor version of the oldest glibc with wheels for [cad].

    build123d 0.13 has a kernel built for 2.28, and asks for Python 3.11; the kernel of older ones was built for 2.31.
    """
    return 31 if python == "3.10" else 28


def resolved(python: str, machine: str, wanted: Sequence[str], target: Path, glibc: int = 28) -> Mapping[str, str] | str:
    """Versions by name that pip would install from wheels alone, or why it cannot.

    Parameters
    ----------
    python, machine : str
        ``"3.12"``, ``"aarch64"``.
    wanted : sequence of str
        Requirements.
    target : Path
        A folder that pip wants to hear of; nothing is written.
    glibc : int
        Minor version of the glibc there.
    """
    tags = (*(f"manylinux_2_{minor}" for minor in range(glibc, 4, -1)), *_OLDER_NAMES)
    platforms = [word for tag in tags for word in ("--platform", f"{tag}_{machine}")]
    command = [sys.executable, "-c", _PIP_ELSEWHERE, python, machine, "install", "--dry-run", "--ignore-installed", "--quiet"]
    command += ["--only-binary=:all:", *platforms, "--python-version", python, "--implementation", "cp"]
    command += ["--target", str(target), "--report", "-", *wanted]
    run = subprocess.run(command, env=clean_environment(), capture_output=True, encoding="utf-8", check=False)
    if run.returncode != 0:
        errors = [line for line in run.stderr.splitlines() if line.startswith("ERROR:")]
        return errors[-1].removeprefix("ERROR: ") if errors else run.stderr[-200:]
    return {item["metadata"]["name"].lower(): item["metadata"]["version"] for item in json.loads(run.stdout)["install"]}


def installable(python: str, machine: str, numpy: str, target: Path) -> dict[str, Mapping[str, str] | str]:
    """The three installations: the robot's half and the default on glibc 2.28, and [cad] on `cad_glibc`.

    Where a list resolves, parts of it do.
    """
    lists = {"[cad]": requirements("cad"), "default": requirements(), "robot": [*ROBOT]}
    if (
        numpy == "1.26"
    ):  # no build123d takes it, and pip finds that sooner in a short list; what a part has not, the whole has not
        lists = {"[cad]": ["build123d>=0.10"], "default": [_FOR_NUMPY_1, *requirements()], "robot": [*ROBOT]}
    found: dict[str, Mapping[str, str] | str] = {}
    solved: dict[int, Mapping[str, str]] = {}
    for name, wanted in lists.items():
        glibc = cad_glibc(python) if name == "[cad]" else 28
        answer = solved.get(glibc) or resolved(python, machine, [NUMPYS[numpy], *wanted], target, glibc)
        found[name] = answer
        if not isinstance(answer, str):
            solved[glibc] = answer
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Fresh:
    """A fresh environment: its Python, how large what was installed is (bytes), and how long that took."""

    python: Path
    size_bytes: int
    seconds: float


def fresh_environment(folder: Path, *installs: Sequence[str | Path], interpreter: str = sys.executable) -> Fresh:
    """Make an environment, and have pip install into it, one call for each list of arguments.

    The size is that of the files, without pip's own and without what Python compiles on first use.
    """
    subprocess.run([interpreter, "-m", "venv", folder], env=clean_environment(), check=True)
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    start = perf_counter()
    for words in installs:
        command = [python, "-m", "pip", "install", "--quiet", "--no-compile", *words]
        run = subprocess.run(
            [str(w) for w in command], env=clean_environment(), capture_output=True, encoding="utf-8", check=False
        )
        if run.returncode != 0:
            raise RuntimeError(f"{command}\n{run.stderr}")
    seconds = perf_counter() - start
    (site,) = folder.glob("lib/python3*/site-packages")
    own = [p for p in site.iterdir() if not p.name.startswith(_VENDORED)]
    files = [f for p in own for f in ([p] if p.is_file() else p.rglob("*")) if f.is_file() and f.suffix != ".pyc"]
    return Fresh(python=python, size_bytes=sum(f.stat().st_size for f in files), seconds=seconds)


def built_wheel(sources: Path, folder: Path) -> Path:
    """The wheel of a folder of sources."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=sources, env=clean_environment(), capture_output=True, check=True)
    (wheel,) = folder.glob("*.whl")
    return wheel
