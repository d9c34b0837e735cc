"""Fresh environments and uv's resolver: what an installation takes, where one can be had, and beside what."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from ast import literal_eval
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
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
_HELD_S = 600
"""A registry's pages are asked for once in so long: by itself uv asks for all of them again in each of a hundred resolutions."""
_UV_NAMES = {"find-links": ("UV_FIND_LINKS", ","), "cert": ("SSL_CERT_FILE", "")}
"""What uv calls the settings of pip, and how it parts several."""
_VENDORED = ("pip", "setuptools", "pkg_resources", "_distutils_hack")
"""What a fresh environment has before anything is installed."""
_COMPILED = (".pyc", ".nbi", ".nbc")
"""What Python and numba write at the first use."""


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


def uv_program() -> str | None:
    """uv, which `dev` brings: beside this Python, or on the path."""
    return shutil.which("uv", path=os.pathsep.join([str(Path(sys.executable).parent), *os.get_exec_path()]))


@cache
def _as_pip() -> tuple[dict[str, str], str]:
    """An environment and settings with which uv asks the registries that pip asks here, and takes the best of all as pip does."""

    def said_by(*words: str) -> str:
        command = [sys.executable, *words]
        return subprocess.run(command, env=clean_environment(), capture_output=True, encoding="utf-8", check=True).stdout

    lines = said_by("-m", "pip", "config", "list")
    usual = said_by("-c", "from pip._internal.models.index import PyPI; print(PyPI.simple_url)").strip()  # pip has no other way
    rows = re.findall(r"^[^.\n]+\.([\w-]+)=(.+)$", lines, re.MULTILINE)
    found = {key: literal_eval(value) for key, value in reversed(rows)}  # what the environment says comes first there, and wins
    said = {name: between.join(found[key].split()) for key, (name, between) in _UV_NAMES.items() if key in found}
    held = f'cache-control = {{ api = "max-age={_HELD_S}", files = "max-age={_HELD_S}" }}'
    registries = [*found.get("extra-index-url", "").split(), found.get("index-url", usual)]
    settings = "".join(f"[[index]]\nurl = {json.dumps(url)}\n{held}\n" for url in registries) + "default = true\n"
    environment = {**said, "UV_INDEX_STRATEGY": "unsafe-best-match", "UV_PYTHON_DOWNLOADS": "never", **clean_environment()}
    return environment, settings


def resolved(python: str, machine: str, wanted: Sequence[str], glibc: int = 28) -> Mapping[str, str] | str:
    """Versions by name that uv's resolver finds in wheels alone, reading nothing but their metadata; or why there are none.

    Parameters
    ----------
    python, machine : str
        ``"3.12"``, ``"aarch64"``.
    wanted : sequence of str
        Requirements.
    glibc : int
        Minor version of the glibc there.
    """
    uv = uv_program()
    assert uv is not None
    command = [uv, "pip", "compile", "-", "--no-header", "--no-annotate", "--only-binary", ":all:", "--python-version", python]
    command += ["--python-platform", f"{machine}-manylinux_2_{glibc}", "--python", sys.executable]
    environment, settings = _as_pip()
    with tempfile.NamedTemporaryFile("w", encoding="utf-8", suffix=".toml") as file:
        file.write(settings)
        file.flush()
        command += ["--config-file", file.name]
        text = "\n".join(wanted)
        run = subprocess.run(command, input=text, env=environment, capture_output=True, encoding="utf-8", check=False)
    if run.returncode != 0:
        reasons = re.findall(r"(\S+?)[\[<>=!]\S* depends on (\S+?),?\s", run.stderr)
        return "{} asks for {}".format(*(word.rstrip(".") for word in reasons[-1])) if reasons else run.stderr.strip()[-200:]
    return dict(line.split("==") for line in run.stdout.splitlines() if "==" in line)


def installable(python: str, machine: str, numpy: str) -> dict[str, Mapping[str, str] | str]:
    """The three installations: the robot's half and the default on glibc 2.28, and [cad] on `cad_glibc`."""
    lists = {"robot": (ROBOT, 28), "default": (requirements(), 28), "[cad]": (requirements("cad"), cad_glibc(python))}
    return {name: resolved(python, machine, [NUMPYS[numpy], *wanted], glibc) for name, (wanted, glibc) in lists.items()}


def free_threaded_wheels(machine: str) -> list[str]:
    """Wheels that pip would install of the robot's half for the free-threaded Python 3.14, which uv cannot be asked for.

    Raises
    ------
    RuntimeError
        When there are none. For another Python pip takes wheels of the stable ABI too, which a free-threaded one cannot load.
    """
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder, "report.json")
        command = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed", "--quiet", "--target", folder]
        command += [
            "--only-binary=:all:",
            "--python-version",
            "3.14",
            "--abi",
            "cp314t",
            "--platform",
            f"manylinux_2_28_{machine}",
        ]
        command += ["--report", str(report), *ROBOT]
        run = subprocess.run(command, env=clean_environment(), capture_output=True, encoding="utf-8", check=False)
        if run.returncode != 0:
            raise RuntimeError(run.stderr.strip()[-300:])
        found = [one["download_info"]["url"].rpartition("/")[2] for one in json.loads(report.read_text())["install"]]
    if others := [name for name in found if not name.endswith("-none-any.whl") and "-cp314t-" not in name]:
        raise RuntimeError(f"not for a free-threaded Python: {', '.join(others)}")
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Companion:
    """What labs have that the package is to be installed beside: its Pythons and its requirements."""

    name: str
    pythons: tuple[str, ...]
    wanted: tuple[str, ...]


COMPANIONS = (
    Companion(name="LeRobot 0.6 with `dataset` and `viz`", pythons=("3.12", "3.13"), wanted=("lerobot[dataset,viz]>=0.6,<0.7",)),
    Companion(  # setup.py of joehjhuang/gs_sdk; normalflow, which is used with it, asks for the same numpy
        name="gs_sdk and normalflow",
        pythons=("3.10", "3.12"),
        wanted=(
            *("pillow==10.0.0", "numpy==1.26.4", "opencv-python>=4.9.0", "scipy>=1.13.1", "torch>=2.1.0", "PyYaml>=6.0.1"),
            *("matplotlib>=3.9.0", "ffmpeg-python", "nanogui"),
        ),
    ),
    Companion(  # requirements.txt of gelsightinc/gsrobotics, without pygrabber, which is for Windows
        name="gsrobotics",
        pythons=("3.10", "3.12"),
        wanted=(
            *("Kivy==2.3.1", "Kivy-Garden==0.1.5", "open3d>=0.18.0", "opencv-python==4.11.0.86", "pydantic==2.10.6"),
            *("pydantic_core==2.27.2", "scikit-image>=0.24.0", "scipy>=1.13.0", "torch==2.6.0"),
        ),
    ),
    Companion(name="cv_bridge of ROS 2 Humble: numpy 1.26", pythons=("3.10",), wanted=(NUMPYS["1.26"],)),
    Companion(name="cv_bridge of Jazzy and Kilted: numpy 1.26", pythons=("3.12",), wanted=(NUMPYS["1.26"],)),
    Companion(name="cv_bridge of Lyrical: numpy 2", pythons=("3.14",), wanted=(NUMPYS["2"],)),
)
DESKTOP_GLIBC = 35
"""That of Ubuntu 22.04."""


def lab_extras() -> dict[str, list[str]]:
    """Requirements of every extra but `dev`."""
    extras = read_toml(ROOT / "pyproject.toml", "pyproject")["project"]["optional-dependencies"]
    return {name: lines for name, lines in extras.items() if name != "dev"}


def beside(companion: Companion, python: str) -> tuple[Mapping[str, str], dict[str, str]]:
    """Versions of everything that installs beside it at once on x86-64, and of each extra that does not, why.

    Raises
    ------
    RuntimeError
        When not even the default installation does.
    """

    def asked(extras: Sequence[str]) -> Mapping[str, str] | str:
        return resolved(python, "x86_64", [*companion.wanted, *requirements(*extras)], DESKTOP_GLIBC)

    fitting, refused = list(lab_extras()), dict[str, str]()
    if isinstance(asked(fitting), str):
        refused = {name: answer for name in fitting if isinstance(answer := asked([name]), str)}
        fitting = [name for name in fitting if name not in refused]
    together = asked(fitting)
    if isinstance(together, str):
        raise RuntimeError(f"{companion.name}, Python {python}, with {fitting}: {together}")
    for name in fitting:  # a marker may leave an extra empty on this Python
        words = [re.split(r"[\[<>=]", line)[0] for line in lab_extras()[name] if ";" in line]
        if missing := [word for word in words if word not in together]:
            refused[name] = f"{' and '.join(missing)} not for this Python"
    return together, refused


@dataclass(frozen=True, slots=True, kw_only=True)
class Fresh:
    """A fresh environment: its Python, how large what was installed is (bytes), and how long that took."""

    python: Path
    size_bytes: int
    seconds: float


def fresh_environment(folder: Path, *installs: Sequence[str | Path], interpreter: str = sys.executable) -> Fresh:
    """Make an environment, and have pip install into it, one call for each list of arguments.

    The size is that of the files, without pip's own and without what Python and numba compile on first use.
    """
    subprocess.run([interpreter, "-m", "venv", folder], env=clean_environment(), check=True)
    return installed(folder, *installs)


def installed(folder: Path, *installs: Sequence[str | Path]) -> Fresh:
    """The same of an environment that is there."""
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
    files = [f for p in own for f in ([p] if p.is_file() else p.rglob("*")) if f.is_file() and f.suffix not in _COMPILED]
    return Fresh(python=python, size_bytes=sum(f.stat().st_size for f in files), seconds=seconds)


def built_wheel(sources: Path, folder: Path) -> Path:
    """The wheel of a folder of sources."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=sources, env=clean_environment(), capture_output=True, check=True)
    (wheel,) = folder.glob("*.whl")
    return wheel
