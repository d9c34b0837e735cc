"""The first time ever: half of the decoder is compiled by another process."""

from __future__ import annotations

import logging
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tactape_fab import Localizer
from tactape_fab.base import jit as kernels
from tactape_fab.sense.decode import warm as ahead
from tactape_fab.sense.decode.search.all_places import _weigh
from tactape_fab.sense.decode.search.single_place import _add_evidence, compile_near
from tests.contacts import tape_of


class Process:
    """One that compiles for ever, unless it is told how long."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def wait(self, timeout: float | None = None) -> None:
        self.told.append("wait")

    def poll(self) -> int | None:
        return 0 if "wait" in self.told else None

    def kill(self) -> None:
        self.told.append("kill")


@pytest.fixture
def process(monkeypatch: pytest.MonkeyPatch) -> Process:
    """Nothing is on the disk, and another process is at work."""
    found = Process()
    monkeypatch.setattr(ahead, "compiled", lambda: False)
    monkeypatch.setattr(ahead, "_started", lambda *_: found)
    return found


def test_what_is_compiled_ahead_is_what_is_called() -> None:
    ahead.compile_search()
    compile_near()
    Localizer([tape_of(7)])
    assert len(_weigh.signatures) == len(_add_evidence.signatures) == 1


def test_it_is_said_and_waited_for(process: Process, caplog: pytest.LogCaptureFixture) -> None:
    with ahead.search_compiled():
        assert "compiles its decoder" in caplog.text
        assert process.told == []
    assert process.told == ["wait"]


def test_no_process_is_left_behind(process: Process) -> None:
    with pytest.raises(KeyboardInterrupt), ahead.search_compiled():
        raise KeyboardInterrupt
    assert process.told[0] == "kill"


def test_what_is_on_the_disk_is_not_compiled_again(
    process: Process, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(ahead, "compiled", lambda: True)
    with caplog.at_level(logging.DEBUG), ahead.search_compiled():
        pass
    assert caplog.text == "" and process.told == []


@pytest.mark.parametrize(("name", "value"), [("frozen", True), ("executable", "/opt/blender/blender"), ("executable", None)])
def test_a_program_that_is_no_python_is_not_started_again(monkeypatch: pytest.MonkeyPatch, name: str, value: Any) -> None:
    monkeypatch.setattr(sys, name, value, raising=False)
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("it was started"))
    assert ahead._started(Path()) is None


def test_where_nothing_can_be_kept_nothing_is_compiled_ahead(
    process: Process, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(ahead, "KEPT", False)
    with ahead.search_compiled():
        assert "NUMBA_CACHE_DIR" in caplog.text
    assert process.told == [] and ahead.cache_folder() is None


def test_a_folder_that_nothing_can_be_kept_in_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> Any:
        raise RuntimeError("cannot cache function '_probe': no locator available")

    assert kernels._can_be_kept()
    monkeypatch.setattr(kernels, "njit", refuse)
    assert not kernels._can_be_kept()
