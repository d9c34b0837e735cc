"""Limits of processes, beside those that the user has set."""

from __future__ import annotations

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

import pytest

from tactape_fab.base import launch

if find_spec("resource") is None:
    pytest.skip("this system limits no process", allow_module_level=True)
_SAY = "import resource as r; print(r.getrlimit(r.RLIMIT_CPU), r.getrlimit(r.RLIMIT_DATA)[0])"
_LIMIT = "import resource as r; r.setrlimit(r.RLIMIT_CPU, (20, 20)); r.setrlimit(r.RLIMIT_DATA, (2**30, 2**30)); "


def said(command: list[str]) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def test_a_program_is_limited() -> None:
    assert said(launch.limited([sys.executable, "-c", _SAY], cpu_s=60, memory_bytes=2**31)) == f"(60, 65) {2**31}"


def test_a_limit_of_the_user_stays_for_a_program() -> None:
    command = launch.limited([sys.executable, "-c", _SAY], cpu_s=60, memory_bytes=2**31)
    within = f"{_LIMIT}import os; os.execv({command[0]!r}, {command!r})"
    assert said([sys.executable, "-c", within]) == f"(20, 20) {2**30}"


def test_a_limit_of_the_user_stays_for_this_process() -> None:
    limited = f"from tactape_fab.base.launch import limit_self; limit_self(cpu_s=600, memory_bytes=2**31); {_SAY}"
    assert said(launch.python_command(f"{_LIMIT}{limited}")) == f"(20, 20) {2**30}"
    free = f"from tactape_fab.base.launch import limit_self; limit_self(cpu_s=600, memory_bytes=2**31); {_SAY}"
    assert said(launch.python_command(free)).startswith("(60")


@pytest.mark.parametrize("given", ["", "cache", "./cache"])
def test_a_program_keeps_nothing_in_the_current_folder(given: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, given)
    found = launch.environment(tmp_path / "scratch")
    assert "NUMBA_CACHE_DIR" not in found and found["XDG_CACHE_HOME"] == str(tmp_path / ".cache")
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "kept"))
    assert launch.environment(tmp_path)["NUMBA_CACHE_DIR"] == launch.environment(tmp_path)["XDG_CACHE_HOME"] == f"{tmp_path}/kept"


def test_programs_of_threads_end_when_they_are_stopped() -> None:
    """Also one that a thread starts afterwards."""
    children = launch.Children()
    command = launch.python_command("import time; print('begun', flush=True); time.sleep(60)")
    begin = time.monotonic()
    with ThreadPoolExecutor(1, initializer=children.register_thread) as threads:
        runs = [threads.submit(launch.run, command, timeout_s=60) for _ in range(2)]
        time.sleep(0.5)
        children.stop()
    assert [run.result().returncode < 0 for run in runs] == [True, True] and time.monotonic() - begin < 30.0
    assert launch.run(launch.python_command("print(1)"), timeout_s=60).stdout == "1\n"  # of no such thread
