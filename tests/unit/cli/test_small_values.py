"""Values that are numbers and too small to be meant are refused, where they ended in a traceback; and messages stop no work."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from tactape_fab.base import launch
from tactape_fab.cli import main

REFUSED = {
    "--bend-axis x --bend-radius 1e-7": "--bend-radius = 1e-07 mm is below 0.1 mm",
    "--part block --body 1e-6x0.3x0.23": "--body = '1e-6x0.3x0.23': 1e-06 mm is below 0.01 mm",
    "--part block --negative --hole 0.8,10,7e-7": "holes_mm[0] has a diameter of 7e-07 mm, below 0.01 mm",
    "--part block --corner-radius 1e-5": "--corner-radius = 1e-05 mm is neither 0 nor at least 0.01 mm; use --corner-radius 0",
}


@pytest.mark.parametrize(("options", "says"), REFUSED.items(), ids=REFUSED.keys())
@pytest.mark.parametrize("command", ["check", "make"])
def test_a_value_too_small_to_be_meant_is_refused(command: str, options: str, says: str, here: Path) -> None:
    run = CliRunner().invoke(main, [command, "--sector", "1", "--size", "20x20", *options.split()])
    assert run.exit_code == 2 and says in run.stderr
    assert list(here.iterdir()) == []


@pytest.mark.parametrize("radius", ["0", "0.01", "0.1"])
def test_a_small_corner_that_is_accepted_is_made(radius: str, tmp_path: Path) -> None:
    options = ["--sector", "1", "--size", "20x20", "--part", "block", "--corner-radius", radius, "-o", str(tmp_path / "kit")]
    assert CliRunner().invoke(main, ["make", *options]).exit_code == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no device that is always full")
def test_messages_that_cannot_be_printed_stop_no_work(tmp_path: Path) -> None:
    command = ["make", "--sector", "1", "--size", "20x20", "--no-3d", "-o", "kit"]
    with Path("/dev/full").open("wb") as full:
        run = subprocess.run([sys.executable, "-m", "tactape_fab", *command], cwd=tmp_path, stderr=full, check=False)
    assert run.returncode == 0 and (tmp_path / "kit" / "manifest.json").is_file()


def test_children_have_a_folder_for_temporary_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", "/nonexistent")
    given = launch.environment(tmp_path)
    assert {given[name] for name in ("TMPDIR", "TEMP", "TMP")} == {str(tmp_path)}
    script = "import os, tempfile; print(tempfile.gettempdir(), os.path.isdir(os.environ['TMPDIR']))"
    answer = launch.run(launch.python_command(script), timeout_s=60.0)
    assert answer.stdout.split()[1] == "True" and not answer.stdout.startswith("/nonexistent")
    assert os.environ["TMPDIR"] == "/nonexistent"
