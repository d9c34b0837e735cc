"""Lists of tapes made in several processes: the same kits as one by one, and whole ones only, whatever happens meanwhile."""

from __future__ import annotations

import json
import os
import resource
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab import TapeSpec, list_tapes, make_kit, make_kits, verify_kit
from tactape_fab.base.output_file import UNFINISHED_SUFFIX
from tactape_fab.base.pool import mapped
from tactape_fab.make import many
from tactape_fab.make.many import FailedKit, MadeKit
from tests.commands import run
from tests.roundtrip.kits import Files, contents
from tests.thorough import slow, thorough

pytestmark = pytest.mark.usefixtures("kits_as_elsewhere")
SMALL = "--size 20x20 --no-3d"
PATIENCE_S = 60.0
MARK = "TACTAPE_TEST_RUN"
"""Kept by all processes that a run starts; its value is the folder that the run was started in."""


def small_kit(sector: int, folder: Path) -> Files:
    return contents(make_kit(TapeSpec(sector=sector, size_mm=(20.0, 20.0), models=False), folder).path)


def test_a_list_is_the_same_kits_as_one_by_one(here: Path) -> None:
    result = run(f"make --sectors 3-4,9 {SMALL} --jobs 2")
    assert result.exit_code == 0, result.stderr
    folder = here / "tactape-kits"
    assert sorted(p.name for p in folder.iterdir()) == ["tactape-s003", "tactape-s004", "tactape-s009"]
    for sector in (3, 4, 9):
        assert contents(folder / f"tactape-s{sector:03d}") == small_kit(sector, here / str(sector))
    rows = [line.split() for line in result.stdout.splitlines()]
    assert rows[0] == ["kit", "sector", "size", "mm", "grid", "parts", "result"]
    assert [row[:5] for row in rows[1:]] == [[f"tactape-s{s:03d}", str(s), "20x20", "8x12", "96"] for s in (3, 4, 9)]
    assert all(int(row[5]) > 30 and row[6] == "checks" for row in rows[1:])
    assert "made 3 of 3 kits in tactape-kits" in result.stderr


@slow
def test_dates_are_those_of_who_asks(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def elsewhere(*args: Any, **how: Any) -> Any:
        monkeypatch.delenv("SOURCE_DATE_EPOCH")  # as a cluster's worker, which has an environment of its own
        return mapped(*args, **how)

    monkeypatch.setattr(many, "mapped", elsewhere)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767225600")  # 2026-01-01
    assert run(f"make --sectors 3 {SMALL} --jobs 1").exit_code == 0
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767225600")
    assert contents(here / "tactape-kits" / "tactape-s003") == small_kit(3, here / "3")


def test_a_file_of_tapes_as_json(here: Path) -> None:
    (here / "lab.toml").write_text(
        'models = false\n[[tapes]]\nsectors = "1-2"\nsize_mm = [20, 20]\n'
        '[[tapes]]\nsector = 7\nname = "seven"\nsize_mm = [30, 20]\ntag = "none"\n'
    )
    result = run("make lab.toml -o out/kits --no-verify --pack --json --jobs 1")
    assert result.exit_code == 0, result.stderr
    answer = json.loads(result.stdout)
    assert answer["failed"] == [] and "kits" not in answer
    (made,), (film,) = answer["panels"], answer["packed"]
    assert (Path(made["path"]) / made["files"]["fab-zip"]).is_file() and Path(made["path"]).name == film["panels"][0]["name"]
    assert {(tape["name"], tape["sector"]) for tape in made["tapes"]} == {("tactape-s001", 1), ("tactape-s002", 2), ("seven", 7)}
    assert all((Path(made["path"]) / tape["kit"] / "manifest.json").is_file() for tape in made["tapes"])
    (panel,) = film["panels"]
    assert [tape["name"] for tape in panel["tapes"]] == [tape["name"] for tape in made["tapes"]]
    assert max(panel["size_mm"]) <= 250.0 and min(panel["size_mm"]) >= 70.0
    assert panel["share"] == film["share"] == pytest.approx((2 * 400 + 600) / np.prod(panel["size_mm"]), abs=1e-6)
    assert all(v >= 7.0 for tape in panel["tapes"] for v in tape["offset_mm"])


def test_the_assembly_line_is_asked_about_a_packed_panel_as_about_any(here: Path) -> None:
    """Four tapes of 300 parts go on one panel of 1,200; of a limit of 300 nothing was said, or each tape's parts were."""
    tapes = "--sectors 1-4 --size 30x32 --fab jlcpcb-fpc --no-3d"
    packed = run(f"make {tapes} -o out --no-verify --pack --jobs 1")
    assert packed.exit_code == 0, packed.stderr
    panel = run(f"check {tapes} --panel 2x2")
    (said,) = (line for line in panel.stderr.splitlines() if line.startswith("warning: part-count: "))
    assert [line for line in packed.stderr.splitlines() if "part-count" in line or "assembly-size" in line] == [
        said.replace("part-count: ", "part-count: tactape-panel-1: ")
    ]


def test_every_kit_of_a_list_records_its_search(here: Path) -> None:
    """That of the first sector did not: the list had searched, and made it at an origin that was given."""
    tapes = "--size 20x20 --origin best --no-3d --no-verify"
    assert run(f"make --sector 21 {tapes} -o alone").exit_code == 0
    assert run(f"make --sectors 21-22 {tapes} --jobs 1").exit_code == 0
    assert contents(here / "tactape-kits" / "tactape-s021") == contents(here / "alone")
    assert b'"search"' in contents(here / "tactape-kits" / "tactape-s022")["manifest.json"]


def test_a_warning_of_a_later_sector_alone_is_said_once(here: Path) -> None:
    """The strip holds the label of sectors 8 and 9; of the tapes after them it lost a line, and nothing said so."""
    tapes = "--w 1.2 --delta 0.2 --size 40x30 --coverlay gang --no-3d"
    made = run(f"make --sectors 8-11 {tapes} --no-verify --jobs 1")
    alone = run(f"check --sector 10 {tapes}")
    (said,) = (line for line in alone.stderr.splitlines() if line.startswith("warning: label: "))
    assert [line for line in made.stderr.splitlines() if "label" in line] == [said.replace("label: ", "label: tactape-s010: ")]


@slow
def test_kits_join_a_folder_and_replace_only_when_asked(here: Path) -> None:
    assert run(f"make --sectors 1 {SMALL} -o lab --no-verify").exit_code == 0
    (here / "lab" / "note.txt").write_text("mine")
    before = contents(here / "lab")
    refused = run(f"make --sectors 1-2 {SMALL} -o lab --no-verify")
    assert refused.exit_code == 2
    assert "lab holds tactape-s001 already; use --overwrite" in refused.stderr
    assert contents(here / "lab") == before
    assert run(f"make --sectors 2 {SMALL} -o lab --no-verify").exit_code == 0
    assert run(f"make --sectors 1-2 {SMALL} --tag none -o lab --overwrite --no-verify").exit_code == 0
    after = contents(here / "lab")
    assert after["note.txt"] == b"mine"
    assert after["tactape-s001/manifest.json"] != before["tactape-s001/manifest.json"]
    assert "tactape-s002/manifest.json" in after


def test_tapes_that_cannot_be_told_apart_are_warned_of(here: Path) -> None:
    (here / "lab.toml").write_text(
        'models = false\nsize_mm = [20, 20]\n[[tapes]]\nsector = 1\nname = "a"\n[[tapes]]\nsector = 1\nname = "b"\n'
    )
    result = run("make lab.toml --no-verify")
    assert result.exit_code == 0
    assert "warning: copies: a, b show the same texture and cannot be told apart" in result.stderr


# What goes wrong on the way


def started(folder: Path, args: str, **options: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tactape_fab", *shlex.split(args)]
    return subprocess.Popen(
        command,
        cwd=folder,
        env=os.environ | {MARK: str(folder)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        start_new_session=True,
        **options,
    )


def no_large_files() -> None:
    """As on a full disk: writing a file of more than 200 kB fails."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))


def test_one_kit_that_fails_does_not_stop_the_others(tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text(
        'models = false\n[[tapes]]\nsectors = "1-2"\nsize_mm = [20, 20]\n[[tapes]]\nsector = 3\n'
        "[[tapes]]\nsector = 4\nsize_mm = [20, 20]\n"
    )
    run = started(tmp_path, "make lab.toml --json --jobs 2", preexec_fn=no_large_files)
    stdout, stderr = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 1, stderr
    answer = json.loads(stdout)
    assert [k["name"] for k in answer["kits"]] == ["tactape-s001", "tactape-s002", "tactape-s004"]
    (failed,) = answer["failed"]
    assert (failed["name"], failed["status"]) == ("tactape-s003", 1)
    assert "error: tactape-s003: the kit cannot be written to" in stderr
    assert "Traceback" not in stderr
    assert "made 3 of 4 kits" in stderr
    folder = tmp_path / "tactape-kits"
    assert sorted(p.name for p in folder.iterdir()) == ["tactape-s001", "tactape-s002", "tactape-s004"]


def processes_of(folder: Path) -> list[int]:
    """Living processes of the run that was started in a folder."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            state = (place / "stat").read_text().rsplit(")", 1)[1].split()[0]
            if state != "Z" and f"{MARK}={folder}".encode() in (place / "environ").read_bytes().split(b"\0"):
                found.append(int(place.name))
        except OSError:
            continue
    return found


def wait_until(condition: Callable[[], object], what: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.002)


def stop_at_work(folder: Path, send: Callable[[int], None], kits: int) -> tuple[int, str]:
    """Start a list, send a signal while a kit is being built and `kits` stand, and see that no process is left."""
    run = started(folder, f"make --sectors 0-255 {SMALL} -o kits --jobs 2")
    place = folder / "kits"

    def names() -> Sequence[str]:
        return [p.name for p in place.iterdir()] if place.is_dir() else []

    def at_work() -> bool:
        found = names()
        unfinished = any(name.endswith(UNFINISHED_SUFFIX) for name in found)
        return unfinished and sum(not name.startswith(".") for name in found) >= kits

    wait_until(lambda: at_work() or run.poll() is not None, "no kit was begun")
    send(run.pid)
    _, stderr = run.communicate(timeout=PATIENCE_S)
    wait_until(lambda: not processes_of(folder), "processes are left")
    return run.returncode, stderr


def assert_whole_only(folder: Path, least: int) -> None:
    kits = sorted(folder.iterdir()) if folder.exists() else []
    assert [p.name for p in kits if p.name.startswith(".")] == []
    assert least <= len(kits) < 256
    for kit in kits:
        assert verify_kit(kit, quick=True).passed, kit


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
@pytest.mark.parametrize("kits", [thorough(0), 1, thorough(5)])
def test_ctrl_c_leaves_whole_kits_and_no_process(kits: int, tmp_path: Path) -> None:
    status, stderr = stop_at_work(tmp_path, lambda pid: os.killpg(pid, signal.SIGINT), kits)
    assert status == 130
    assert "stopped; the kits that stand in kits are whole" in stderr
    assert "Traceback" not in stderr
    assert_whole_only(tmp_path / "kits", kits)


@slow
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
def test_a_polite_end_leaves_whole_kits_and_no_process(tmp_path: Path) -> None:
    status, stderr = stop_at_work(tmp_path, lambda pid: os.kill(pid, signal.SIGTERM), 2)
    assert status == 128 + signal.SIGTERM
    assert "Traceback" not in stderr
    assert_whole_only(tmp_path / "kits", 2)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
def test_processes_end_when_the_one_that_started_them_is_killed(tmp_path: Path) -> None:
    status, stderr = stop_at_work(tmp_path, lambda pid: os.kill(pid, signal.SIGKILL), 2)
    assert status == -signal.SIGKILL
    assert "Traceback" not in stderr
    assert_whole_only(tmp_path / "kits", 2)


@slow
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
def test_a_killed_process_costs_its_kit_a_second_try(tmp_path: Path) -> None:
    run = started(tmp_path, f"make --sectors 0-3 {SMALL} --no-verify -o kits --workers 1")
    wait_until(lambda: len(list(tmp_path.glob("kits/tactape*"))) >= 1, "no kit was made")
    worker = max(set(processes_of(tmp_path)) - {run.pid})
    os.kill(worker, signal.SIGKILL)
    _, stderr = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 0, stderr
    assert "made 4 of 4 kits" in stderr
    made = sorted(tmp_path.glob("kits/tactape*"))
    assert [path.name for path in made] == [f"tactape-s00{k}" for k in range(4)]
    for kit in made:
        assert verify_kit(kit, quick=True).passed, kit


def test_a_kit_of_another_run_is_not_replaced(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that makes a kit of the same name meanwhile, of another W or of the same."""
    specs = [TapeSpec(sector=sector, size_mm=(20.0, 20.0), models=False) for sector in (1, 2)]
    listed = list_tapes({"models": False, "size_mm": (20, 20)}, {"sectors": "1-2"}, here / "lab")
    for spec in (specs[0].with_values(pitch_mm=1.6), specs[1]):
        make_kit(spec, here / "lab" / spec.name, verify=False)
    before = contents(here / "lab")
    monkeypatch.setattr("tactape_fab.make.many.time.time", lambda: 0.0)  # both kits are younger than this run
    one, two = make_kits(listed.tapes, here / "lab", verify=False, workers=1)
    assert isinstance(one, FailedKit) and "lab/tactape-s001 exists already" in str(one.error)
    assert isinstance(two, MadeKit)
    assert contents(here / "lab") == before
