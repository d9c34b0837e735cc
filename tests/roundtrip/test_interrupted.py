"""A `make` that is killed at any moment leaves no folder under the kit's name or a whole kit, and what it leaves behind is never
taken for one; a `make` that is asked to stop cleans up.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tactape_fab import Tape, TapeSpec, make_kit
from tactape_fab.base.errors import SpecError
from tactape_fab.cli import main
from tests.calls import replaced
from tests.roundtrip.kits import Files, contents
from tests.thorough import only_thorough, slow, some

pytestmark = pytest.mark.usefixtures("kits_as_elsewhere")
KILLS = 24
AT_A_TIME = 2
NEW, OLD = 7, 8
SIZE_MM = (24.0, 20.0)


def start_make(folder: Path) -> subprocess.Popen[bytes]:
    """Start to make the new kit as ``tape`` in `folder`."""
    size = f"{SIZE_MM[0]:g}x{SIZE_MM[1]:g}"
    command = ["make", "--sector", str(NEW), "--size", size, "-o", "tape", "--overwrite"]
    return subprocess.Popen(
        [sys.executable, "-m", "tactape_fab", *command], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def wait_for_build(run: subprocess.Popen[bytes], folder: Path) -> None:
    """Wait until a run has made the folder that it builds in, or has ended."""
    while run.poll() is None and not any(p.name.endswith(".partial") for p in folder.iterdir()):
        time.sleep(0.001)


@dataclass(frozen=True, slots=True, kw_only=True)
class Killed:
    """What one killed run left: whether the kill came before its end, the kit under its name, and everything else."""

    early: bool
    had_old: bool
    kit: Files | None
    strays: list[Path]


@pytest.fixture(scope="module")
def kits(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The new kit and the old one, by sector; `make` has verified both. Not to be changed."""
    folder = tmp_path_factory.mktemp("whole")
    return {sector: make_kit(TapeSpec(sector=sector, size_mm=SIZE_MM), folder / str(sector)).path for sector in (NEW, OLD)}


@pytest.fixture(scope="module")
def whole(kits: dict[int, Path]) -> dict[int, Files]:
    """The only two kits that may ever be found, by sector."""
    return {sector: contents(path) for sector, path in kits.items()}


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory, kits: dict[int, Path], whole: dict[int, Files]) -> list[Killed]:
    """Runs, two at a time, killed at random moments.

    Every other one stands over an older kit. Half of the moments count from the start of the process, half from the start
    of the build, which takes less of the time and more of the care; a few come when the run is over.
    """
    root = tmp_path_factory.mktemp("killed")
    chance = random.Random(20240607)
    lasted_s: list[float] = []

    def run_one(name: str, span: tuple[float, float] | None, *, had_old: bool = False, from_build: bool = False) -> Killed:
        folder = root / name
        folder.mkdir()
        if had_old:
            shutil.copytree(kits[OLD], folder / "tape")
        begin = time.perf_counter()
        run = start_make(folder)
        if from_build:
            wait_for_build(run, folder)
        with suppress(subprocess.TimeoutExpired):
            run.wait(None if span is None else chance.uniform(*span) * lasted_s[-1])
        run.kill()
        early = run.wait() == -signal.SIGKILL
        if not early:
            lasted_s.append(time.perf_counter() - begin)  # the machine may be busy now and quiet a moment later
        kit = contents(folder / "tape") if (folder / "tape").exists() else None
        return Killed(early=early, had_old=had_old, kit=kit, strays=[p for p in folder.iterdir() if p.name != "tape"])

    def kill_one(number: int) -> Killed:
        from_build = number % 4 >= 2
        span = (1.5, 3.0) if number in late else (0.0, 0.25) if from_build else (0.0, 1.0)
        return run_one(str(number), span, had_old=number % 2 == 1, from_build=from_build)

    late = chance.sample(range(KILLS), KILLS // 8)
    with ThreadPoolExecutor(AT_A_TIME) as pool:
        list(pool.map(lambda i: run_one(f"whole{i}", None), range(AT_A_TIME)))
        results = list(pool.map(kill_one, range(KILLS)))
    early, strays = sum(k.early for k in results), sum(bool(k.strays) for k in results)
    new = sum(k.kit == whole[NEW] for k in results)
    print(f"\n{KILLS} kills of runs of {min(lasted_s):.2f} to {max(lasted_s):.2f} s: ", end="")
    print(f"{early} before the end, {strays} left an unfinished folder, {new} new kits")
    return results


@only_thorough
def test_kills_hit_before_during_and_after(killed: list[Killed], whole: dict[int, Files]) -> None:
    assert sum(k.early for k in killed) >= KILLS // 4
    assert any(not k.early for k in killed)
    assert any(k.kit == whole[NEW] for k in killed)
    assert any(k.strays for k in killed), "no kill hit while the kit was being built"


@only_thorough
def test_a_kill_leaves_no_kit_or_a_whole_one(killed: list[Killed], whole: dict[int, Files]) -> None:
    fresh = [k for k in killed if not k.had_old]
    assert [k for k in fresh if k.kit is not None and k.kit != whole[NEW]] == []
    assert any(k.kit is None for k in fresh)


@only_thorough
def test_a_kill_leaves_the_old_kit_or_the_new_one(killed: list[Killed], whole: dict[int, Files]) -> None:
    over = [k for k in killed if k.had_old]
    assert [k for k in over if k.kit not in (whole[OLD], whole[NEW])] == []
    assert any(k.kit == whole[OLD] for k in over)


@only_thorough
def test_what_a_kill_leaves_behind_is_never_taken_for_a_kit(killed: list[Killed]) -> None:
    for stray in (stray for k in killed for stray in k.strays):
        for path in (stray, stray / "manifest.json"):
            result = CliRunner().invoke(main, ["verify", str(path), "--quick"])
            assert (result.exit_code, result.stdout) == (2, "")
            assert "unfinished kit" in result.stderr or not path.exists()
            with pytest.raises(SpecError):
                Tape.load(path)


def test_an_unfinished_folder_is_no_kit_however_far_it_came(tmp_path: Path, kits: dict[int, Path]) -> None:
    stray = Path(shutil.copytree(kits[NEW], tmp_path / ".tape.abc.partial"))
    (tmp_path / "link").symlink_to(stray)
    for path in (stray, stray / "manifest.json", tmp_path / "link"):
        result = CliRunner().invoke(main, ["verify", str(path)])
        assert result.exit_code == 2
        assert "is an unfinished kit that an interrupted run left behind; delete it" in result.stderr


@only_thorough
def test_make_works_beside_what_a_kill_left_behind(killed: list[Killed], whole: dict[int, Files]) -> None:
    folder = next(stray for k in killed for stray in k.strays).parent
    assert start_make(folder).wait() == 0
    assert contents(folder / "tape") == whole[NEW]


def stop_in_the_middle(folder: Path, number: int, after_s: float) -> int:
    """Start a run, wait until it has begun to build, send it a signal a moment later, and return its exit status."""
    run = start_make(folder)
    wait_for_build(run, folder)
    time.sleep(after_s)
    run.send_signal(number)
    return run.wait()


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_run_that_is_asked_to_stop_leaves_nothing_behind(
    number: signal.Signals, status: int, tmp_path: Path, kits: dict[int, Path], whole: dict[int, Files]
) -> None:
    def stop(after_s: float, had_old: bool) -> int:
        folder = tmp_path / f"{after_s} {had_old}"
        folder.mkdir()
        if had_old:
            shutil.copytree(kits[OLD], folder / "tape")
        ended = stop_in_the_middle(folder, number, after_s)
        assert [p.name for p in folder.iterdir() if p.name != "tape"] == []
        found = contents(folder / "tape") if (folder / "tape").exists() else None
        assert found in ((whole[OLD], whole[NEW]) if had_old else (None, whole[NEW]))
        return ended

    moments = [(after_s, had_old) for after_s in (0.002, 0.0, 0.02, 0.1) for had_old in (False, True)]
    moments = moments[: 2 * some(4)]
    with ThreadPoolExecutor(AT_A_TIME) as pool:
        found = set(pool.map(stop, *zip(*moments, strict=True)))
    assert found <= {0, -number, status}  # by the signal itself once the interpreter is on its way out
    assert status in found, "no signal hit while the kit was being built"


@pytest.mark.parametrize("call", ["mkdir", "unlink", "rmdir"])
def test_a_signal_between_two_calls_leaves_nothing_behind(
    call: str, tmp_path: Path, kits: dict[int, Path], whole: dict[int, Files]
) -> None:
    shutil.copytree(kits[OLD], tmp_path / "tape")
    real = getattr(os, call)
    pending = [signal.SIGINT]

    def interrupted(path: str, *args: Any, **options: Any) -> None:
        real(path, *args, **options)
        if pending:
            signal.raise_signal(pending.pop())

    with replaced(interrupted, call, os), pytest.raises(KeyboardInterrupt):
        make_kit(TapeSpec(sector=NEW, size_mm=SIZE_MM), tmp_path / "tape", overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["tape"]
    assert contents(tmp_path / "tape") == whole[OLD if call == "mkdir" else NEW]


@slow
def test_two_runs_at_once_leave_one_whole_kit(tmp_path: Path, whole: dict[int, Files]) -> None:
    runs = [start_make(tmp_path) for _ in range(3)]
    statuses = sorted(run.wait() for run in runs)
    assert statuses[0] == 0
    assert contents(tmp_path / "tape") == whole[NEW]
    assert [p.name for p in tmp_path.iterdir()] == ["tape"]
    assert json.loads((tmp_path / "tape" / "manifest.json").read_text())["sector"] == NEW
