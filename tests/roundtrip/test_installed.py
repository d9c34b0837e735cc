"""The wheel in a fresh environment of each Python, as pipx would install it: the main job, and a frame decoded."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import tactape_fab
from tests.thorough import only_thorough

ROOT = Path(tactape_fab.__file__).resolve().parent.parent
VERSIONS = ("3.11", "3.12", "3.13")


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


def run(command: list[str | Path], cwd: Path, path: str = os.defpath) -> str:
    """Output of a command that knows nothing of this checkout."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "NUMBA", "VIRTUAL_ENV"))}
    done = subprocess.run(
        [str(word) for word in command], cwd=cwd, env={**environment, "PATH": path}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if not (ROOT / "pyproject.toml").is_file():
        pytest.skip("the package under test does not come from a checkout, so there is nothing to build; run this in a checkout")
    sources, folder = tmp_path_factory.mktemp("sources") / "sources", tmp_path_factory.mktemp("dist")
    sources.mkdir()
    for name in ("tactape_fab", "templates"):
        shutil.copytree(ROOT / name, sources / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md"):
        shutil.copy(ROOT / name, sources / name)
    run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder], sources)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture
def environment(tmp_path: Path) -> Iterator[Path]:
    """A folder for an environment, which is large and not kept."""
    yield tmp_path / "env"
    shutil.rmtree(tmp_path / "env", ignore_errors=True)


@only_thorough
@pytest.mark.parametrize("version", VERSIONS)
def test_fresh_environment_makes_a_tape_and_decodes_a_frame(version: str, wheel: Path, environment: Path, tmp_path: Path) -> None:
    python = interpreter(version)
    if python is None:
        pytest.skip(f"Python {version} is not installed")
    run([python, "-m", "venv", environment], tmp_path)
    programs = environment / ("Scripts" if os.name == "nt" else "bin")
    run([programs / "python", "-m", "pip", "install", "--quiet", "--no-compile", wheel], tmp_path)

    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "tactape-fab").symlink_to(programs / "tactape-fab")  # as pipx puts it on the path
    path = os.pathsep.join([str(tmp_path / "bin"), os.defpath])

    def tactape(line: str) -> str:
        return run([tmp_path / "bin" / "tactape-fab", *line.split()], elsewhere, path)

    diagnosis = json.loads(tactape("doctor --json"))
    assert diagnosis["python"].split()[1].startswith(f"{version}.")
    assert Path(diagnosis["package"]).is_relative_to(environment)
    assert None not in diagnosis["libraries"].values() and not diagnosis["decoder"]["compiled"]

    tactape("make --sector 7 --w 1.5 --delta 0.25")
    tactape("verify tactape-s007 --quick")
    tactape("simulate tactape-s007 -o frames.npz --pose 20,12,30")
    (fix,) = map(json.loads, tactape("decode frames.npz --tape tactape-s007 --json --overlay pictures").splitlines())
    assert fix["located"] and fix["tape"] == "tactape-s007"
    assert fix["position_mm"] == pytest.approx([20.0, 12.0], abs=0.02) and fix["theta_deg"] == pytest.approx(30.0, abs=0.5)
    assert (elsewhere / "pictures" / "frame-000000.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads(tactape("doctor --json"))["decoder"]["compiled"]
