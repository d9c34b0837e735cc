"""Lines of a verification come as soon as they are known, and outside readers run side by side."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from threading import Barrier

import pytest

from tactape_fab import TapeSpec, make_kit, verify_kit
from tactape_fab.base.errors import Check
from tactape_fab.verify.models import cad_readers


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    spec = TapeSpec(sector=7, size_mm=(30.0, 20.0))
    return make_kit(spec, tmp_path_factory.mktemp("lines") / "kit").path


def test_every_line_is_told_once_and_in_order(kit: Path) -> None:
    told: list[Check] = []
    verification = verify_kit(kit, quick=True, on_check=told.append)
    assert tuple(told) == verification.checks


def test_the_manifest_is_told_before_the_files_are_read(kit: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr("tactape_fab.verify.kit.read_files", lambda *_: pytest.fail(str(told)))
    with pytest.raises(pytest.fail.Exception, match=r"\['manifest'\]"):
        verify_kit(kit, quick=True, on_check=lambda line: told.append(line.name))


def test_readers_run_side_by_side_while_the_rest_is_checked(kit: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two readers wait for each other, and both for what is checked beside them: in a row none would ever end."""
    together = Barrier(3)

    def reader(name: str) -> cad_readers._Reader:
        def read(*_: object) -> list[Check]:
            together.wait(60.0)
            return [Check(name=name, passed=True, message="read")]

        return read

    def beside() -> list[Check]:
        together.wait(60.0)
        return [Check(name="beside", passed=True, message="made")]

    monkeypatch.setattr(cad_readers, "core_count", lambda: 2)
    monkeypatch.setattr(cad_readers, "_READERS", {name: reader(name) for name in ("slow", "fast")})
    monkeypatch.setattr("tactape_fab.verify.kit.full_trips", lambda *_: [])
    monkeypatch.setattr("tactape_fab.verify.kit.trip_checks", lambda *_: [])
    told: list[str] = []
    verify_kit(kit, on_check=lambda line: told.append(line.name), beside=beside)
    assert told[-3:] == ["beside", "fast", "slow"]


def test_a_pipe_gets_lines_before_the_end(kit: Path) -> None:
    command = [sys.executable, "-m", "tactape_fab", "verify", str(kit), "--quick"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, bufsize=1) as process:
        assert process.stdout is not None
        first, running = process.stdout.readline(), process.poll() is None
        rest = process.stdout.readlines()
    assert first.startswith("ok    manifest")
    assert running
    assert len(rest) > 40
    assert process.returncode == 0


def test_one_of_a_kind_is_said_so(tmp_path: Path) -> None:
    spec = TapeSpec(sector=7, size_mm=(9.0, 7.7), pitch_mm=1.5, tag="none", holes_mm=((8.4, 3.9, 0.2),), models=False)
    kit = make_kit(spec, tmp_path / "kit", force=True)
    assert (kit.tape.columns, kit.tape.rows) == (4, 4)
    said = {check.name: check.message for check in kit.checks}
    assert said["bom"] == "16 designators in 1 row, each once"
    assert said["drill-npth"] == "1 hole as in the manifest"
    assert said["windows from CPL"].startswith("the only window of 4x4 decodes to sector 7, origin ")
    assert said["certificate"].startswith("as computed again: 1 window of 4x4 differs by ")
