"""What an installation says of itself: it is asked when something is missing, so nothing that is missing may stop it."""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner

from tactape_fab import __version__
from tactape_fab.base.templates import read_toml
from tactape_fab.cli import doctor, main
from tactape_fab.cli.doctor import diagnosis_lines, frames_lines
from tactape_fab.sense.calibrate.first_frames import FirstFrames
from tactape_fab.sense.decode import warm as ahead

ROOT = Path(__file__).parents[3]
REQUIRES = [
    "numpy>=2.0",
    "no-such-library>=1",
    'hypothesis>=6; extra == "verify"',
    'no-such-plotter>=3.9 ; extra == "evidence"',
    'no-such-solver>=4; python_version >= "9.0" and extra == "slam"',
    'no-such-recorder[files]>=0.6; extra == "lerobot"',
    'tactape-fab[evidence,verify]; extra == "dev"',
    'pytest>=8.3; extra == "dev"',
]


def test_every_extra_is_explained() -> None:
    project = read_toml(ROOT / "pyproject.toml", "pyproject")["project"]
    assert set(doctor.EXTRAS) == set(project["optional-dependencies"])


def test_what_is_there_is_said_with_its_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metadata, "requires", lambda _: REQUIRES)
    found = doctor.diagnose()
    assert (found.version, found.python) == (__version__, f"CPython {platform.python_version()}")
    assert found.libraries == {"no-such-library": None, "numpy": metadata.version("numpy")}
    extras = {extra.name: extra for extra in found.extras}
    assert extras["verify"].installed and not extras["evidence"].installed
    assert set(extras["dev"].packages) == {"no-such-plotter", "hypothesis", "pytest"}
    assert not extras["dev"].installed and extras["lerobot"].packages == {"no-such-recorder": None}
    text = "\n".join(diagnosis_lines(found))
    assert "no-such-library MISSING" in text
    assert 'pip install "tactape-fab[evidence]"' in text and "tactape-fab[verify]" not in text
    assert "GTSAM; not for this Python" in text and "tactape-fab[slam]" not in text


def test_without_a_single_program_each_says_what_it_would_add(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    programs = doctor.diagnose().programs
    assert {p.name for p in programs} >= {"FreeCAD", "PrusaSlicer", "KiCad", "gerbv", "gerber-to-svg", "rsvg-convert", "Chromium"}
    assert all(p.path is None and p.adds and p.remedy for p in programs)
    lines = diagnosis_lines(doctor.diagnose())
    for p in programs:
        assert any(line.startswith(p.name) and p.remedy in line for line in lines)


def test_a_program_on_the_path_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("FreeCADCmd", "node"):
        (tmp_path / name).write_text("#!/bin/sh\necho /somewhere/index.js\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    found = {p.name: p.path for p in doctor.diagnose().programs}
    assert found["FreeCAD"] == str(tmp_path / "FreeCADCmd")
    assert found["gerber-to-svg"] == "/somewhere/index.js"


def test_on_the_path_without_an_installation_it_still_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(name: str) -> Any:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "requires", refuse)
    found = doctor.diagnose()
    assert found.libraries == {} and not any(extra.installed for extra in found.extras)
    assert any("only on the path" in line for line in diagnosis_lines(found))


@pytest.mark.parametrize(
    ("kept", "compiled", "said"),
    [(True, True, "compiled, in "), (True, False, "not compiled yet"), (False, False, "set NUMBA_CACHE_DIR")],
)
def test_what_the_disk_has_of_the_decoder_is_said(kept: bool, compiled: bool, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead, "KEPT", kept)
    monkeypatch.setattr(ahead, "compiled", lambda: compiled)
    lines = diagnosis_lines(doctor.diagnose())
    assert (
        next(line for line in lines if line.startswith("decoder")).split(maxsplit=1)[1].startswith(("compiled", "not compiled"))
    )
    assert said in "\n".join(lines)


def test_a_broken_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tactape_fab.sense.decode.warm", None)
    assert any(line.startswith("decoder    cannot be loaded: ") for line in diagnosis_lines(doctor.diagnose()))


def test_json_holds_the_same() -> None:
    result = CliRunner().invoke(main, ["doctor", "--json"])
    content = json.loads(result.stdout)
    assert result.exit_code == 0
    assert content["version"] == __version__
    assert set(content["decoder"]) == {"compiled", "cache", "problem"}
    assert {extra["name"] for extra in content["extras"]} == set(doctor.EXTRAS)
    assert all(isinstance(extra["installed"], bool) for extra in content["extras"])


def test_it_answers_where_nothing_can_be_written(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tactape_fab", "doctor"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, encoding="utf-8", check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"tactape-fab {__version__}, ")
    assert list(tmp_path.iterdir()) == []


def test_frames_of_a_sensor_are_looked_at(tmp_path: Path) -> None:
    frames = tmp_path / "frames.npy"
    np.save(frames, np.random.default_rng(0).standard_normal((3, 240, 320)).astype(np.float32) * 0.005)
    result = CliRunner().invoke(main, ["doctor", "--sensor", str(frames)])
    assert result.exit_code == 0 and "nothing looks wrong" in result.stdout and "next: name the kit" in result.stdout
    result = CliRunner().invoke(main, ["doctor", "--sensor", str(frames), "--json"])
    assert len(json.loads(result.stdout)["frames"]) == 3
    other = CliRunner().invoke(main, ["doctor", "--sensor", str(frames), "--like", "digit"])
    assert "those of 'digit' 320 x 240; give another --like, or set width_px = 320, height_px = 240 in" in other.stdout


def test_the_next_step_names_options_as_they_are_typed() -> None:
    found = FirstFrames(frames=(), wrong=(), next_step="another tape was pressed; give its kit")
    with click.Context(doctor.doctor):
        assert frames_lines(found)[-1] == "next: another tape was pressed; give its kit with --tape"


def test_bad_frames_are_refused_and_options_alone_too(tmp_path: Path) -> None:
    missing = CliRunner().invoke(main, ["doctor", "--sensor", str(tmp_path / "no.npz"), "--like", "no-such"])
    assert missing.exit_code == 2 and "no.npz" in missing.stderr and "no-such" in missing.stderr
    alone = CliRunner().invoke(main, ["doctor", "--like", "digit"])
    assert alone.exit_code == 2 and "--tape and --like belong to --sensor" in alone.stderr
