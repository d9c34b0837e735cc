"""Tests run on a changed module, each time in a forked process that has imported everybody else's libraries already."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import json
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any

import pytest

_MOST_BYTES = 4 << 30
_IMPORT = "import"
"""The name under which lines are kept that run when the module is imported."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """What a run without any change has shown.

    Attributes
    ----------
    tests : dict of str to list of int
        Lines of the module that each test runs.
    seconds : dict of str to float
        Duration of each test.
    processor_s : float
        What the whole run took, with its imports.
    at_import : set of int
        Lines that run when the module is imported.
    """

    tests: dict[str, list[int]]
    seconds: dict[str, float]
    processor_s: float
    at_import: set[int]

    def of_line(self, line: int) -> list[str]:
        """Tests that run a line, the quickest first; all of them for one that runs at import."""
        found = [name for name, lines in self.tests.items() if line in self.at_import or line in lines]
        return sorted(found, key=lambda name: self.seconds[name])


class _Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives one module other code."""

    def __init__(self, name: str, path: Path, code: CodeType) -> None:
        self._name, self._path, self._code = name, path, code

    def find_spec(self, fullname: str, path: object, target: object = None) -> importlib.machinery.ModuleSpec | None:
        if fullname != self._name:
            return None
        return importlib.machinery.ModuleSpec(fullname, self, origin=str(self._path))

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = str(self._path)
        exec(self._code, module.__dict__)


class _Chosen:
    """A pytest plugin: some tests, in an order."""

    def __init__(self, names: Sequence[str]) -> None:
        self._places = {name: place for place, name in enumerate(names)}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted((item for item in items if item.nodeid in self._places), key=lambda item: self._places[item.nodeid])


class _Reached:
    """A pytest plugin: which lines of a file each test runs, with its fixtures, and how long it takes."""

    def __init__(self, path: Path) -> None:
        self._path, self._now = str(path), _IMPORT
        self.lines: dict[str, set[int]] = {_IMPORT: set()}
        self.seconds: dict[str, float] = {}

    def trace(self, frame: FrameType, event: str, argument: object) -> Any:
        if frame.f_code.co_filename != self._path:
            return None
        self.lines[self._now].add(frame.f_lineno)
        return self.trace

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        self._now, begun = item.nodeid, time.perf_counter()
        self.lines[item.nodeid] = set()
        try:
            return (yield)
        finally:
            self.seconds[item.nodeid] = time.perf_counter() - begun
            self._now = _IMPORT


def name_of(path: Path) -> str:
    """A module's name, from its path in the checkout."""
    return ".".join(path.with_suffix("").parts)


def reach(path: Path, tests: Sequence[str]) -> Reach:
    """Run the tests without a change; SystemExit if one fails."""
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "reach.json"

        def run() -> int:
            watch = _Reached(path.resolve())
            sys.settrace(watch.trace)
            status = _pytest(tests, watch)
            sys.settrace(None)
            lines = {name: sorted(found) for name, found in watch.lines.items()}
            told.write_text(json.dumps({"lines": lines, "seconds": watch.seconds, "processor_s": time.process_time()}))
            return status

        if (status := in_a_child(run, 3600.0)) != 0:
            raise SystemExit(f"the tests of {path} end with {status} without any change; mend them first")
        found = json.loads(told.read_text())
    at_import = set(found["lines"].pop(_IMPORT))
    return Reach(tests=found["lines"], seconds=found["seconds"], processor_s=found["processor_s"], at_import=at_import)


def notices(path: Path, code: CodeType, names: Sequence[str], patience_s: float) -> bool:
    """Whether one of these tests fails, or none ends, when a module has other code."""
    if not names:
        return False

    def run() -> int:
        sys.meta_path.insert(0, _Changed(name_of(path), path.resolve(), code))
        return _pytest(sorted({name.partition("::")[0] for name in names}), _Chosen(names))

    return in_a_child(run, patience_s) != 0


def _pytest(arguments: Sequence[str], plugin: object) -> int:
    words = ["-x", "-q", "-n", "0", "--no-header", "--tb=no", "-p", "no:cacheprovider", "--hypothesis-seed=0"]
    words += ["-W", "ignore::pytest.PytestAssertRewriteWarning", *arguments]  # of what was imported before the fork
    return int(pytest.main(words, plugins=[plugin]))


def in_a_child(run: Callable[[], int], patience_s: float) -> int:
    """Status of a function in a process of its own, that may use so much processor time; negative if a signal ended it."""
    child = os.fork()
    if child == 0:
        status = 70
        try:
            nothing = os.open(os.devnull, os.O_RDWR)
            for stream in (1, 2) if not os.environ.get("TACTAPE_MUTANTS_SAY") else ():
                os.dup2(nothing, stream)
            os.setsid()
            most_s = int(patience_s) + 1
            resource.setrlimit(resource.RLIMIT_CPU, (most_s, most_s))
            resource.setrlimit(resource.RLIMIT_AS, (_MOST_BYTES, _MOST_BYTES))
            status = run()
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(status)
    late = time.monotonic() + 20.0 * patience_s + 60.0  # it sleeps, or waits for a process that it started
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > late:
            os.killpg(child, signal.SIGKILL)
        time.sleep(0.02)
