"""Calls that fail: the n-th write, fsync, rename, new file or allocation of a command, and what is found afterwards."""

from __future__ import annotations

import builtins
import errno
import io
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any
from unittest import mock

from click.testing import CliRunner

import tactape_fab
from tactape_fab.base.errors import TactapeError
from tactape_fab.cli import main
from tactape_fab.make import publish
from tests.calls import replaced

KINDS = ("write", "fsync", "rename", "create", "allocation")
State = dict[str, bytes | None]
Run = Callable[[Path], object]
_PACKAGE = str(Path(tactape_fab.__file__).parent)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a run with a failing call left and said.

    Attributes
    ----------
    failed : bool
        Whether the run said that it failed.
    wrong : str
        What should not be; empty if all is well.
    """

    failed: bool
    wrong: str


class Counter:
    """Counts calls, and makes one of them fail; number 0 fails none."""

    def __init__(self, number: int) -> None:
        self.number, self.count = number, 0

    def fails(self) -> bool:
        self.count += 1
        return self.count == self.number


def state(folder: Path) -> State:
    """Every file, link and folder below a folder."""
    found: State = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        found[name] = str(path.readlink()).encode() if path.is_symlink() else path.read_bytes() if path.is_file() else None
    return found


def command(*words: str) -> Run:
    """A command line, run in a folder; the exit status and everything that it printed are looked at."""

    def run(folder: Path) -> object:
        before = Path.cwd()
        os.chdir(folder)
        try:
            return CliRunner().invoke(main, list(words))
        finally:
            os.chdir(before)

    return run


def calls(kind: str, run: Run, folder: Path) -> int:
    """How many calls of a kind a run makes."""
    counter = Counter(0)
    with failing(kind, counter, folder):
        assert _said(run, folder) == "", _said(run, folder)
    return counter.count


def attempt(kind: str, number: int, run: Run, folder: Path, before: State, after: State) -> Outcome:
    """Run with one failing call, and compare what is left with what was there and with what a whole run leaves."""
    with failing(kind, Counter(number), folder):
        said = _said(run, folder)
    found = state(folder)
    wrong = []
    if found not in (before, after):
        names = sorted(n for n in found | before if found.get(n, 0) != before.get(n, 0))
        wrong.append(f"neither the old nor the new: {', '.join(names)[:200]}")
    if not said and found != after:
        wrong.append("it says that it is done, and is not")
    if said and (said.count("\n") != 1 or not said.startswith("error: ") or "Traceback" in said):
        wrong.append(f"no single line: {said[-300:]}")
    return Outcome(failed=bool(said), wrong="; ".join(wrong))


def _said(run: Run, folder: Path) -> str:
    """Error lines of a run, empty if it is done; an exception's text where it is none of the package's."""
    try:
        result: Any = run(folder)
    except TactapeError as error:
        return f"error: {error}\n"
    except MemoryError:  # as a function's caller gets it; a command says it in a line
        return "error: no memory\n"
    except BaseException as error:
        return f"Traceback {error!r}\n"
    if not hasattr(result, "exit_code") or result.exit_code == 0:
        return ""
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return f"Traceback {result.exception!r}\n"
    lines = [line for line in result.stderr.splitlines(keepends=True) if line.startswith("error: ") or "Traceback" in line]
    return "".join(lines) or f"exit status {result.exit_code} and no error"


# Failing calls


@contextmanager
def failing(kind: str, counter: Counter, folder: Path) -> Iterator[None]:
    """Context manager: calls of a kind below a folder are counted, and one of them fails."""
    with {"write": _write, "fsync": _fsync, "rename": _rename, "create": _create, "allocation": _allocation}[kind](
        counter, folder
    ):
        yield


def _new_file(mode: object, file: object, folder: Path) -> bool:
    return isinstance(mode, str) and bool(set(mode) & set("wxa+")) and not isinstance(file, int) and _inside(file, folder)


def _inside(file: Any, folder: Path) -> bool:
    with suppress(TypeError, ValueError):
        return Path(os.fsdecode(file)).absolute().is_relative_to(folder)
    return False


def _full() -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@contextmanager
def _write(counter: Counter, folder: Path) -> Iterator[None]:
    """A disk that is full in the middle of a write."""
    real = io.open

    class File(io.FileIO):
        def write(self, data: Any, /) -> Any:
            if counter.fails():
                super().write(memoryview(data)[: len(data) // 2])
                raise _full()
            return super().write(data)

    def opened(file: Any, mode: str = "r", *rest: Any, **more: Any) -> Any:
        if not _new_file(mode, file, folder):
            return real(file, mode, *rest, **more)
        raw = File(file, mode.replace("b", "").replace("t", ""))
        stream: Any = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
        text = dict(zip(("buffering", "encoding", "errors", "newline"), rest, strict=False)) | more
        text.pop("buffering", None)
        return stream if "b" in mode else io.TextIOWrapper(stream, **text)

    with replaced(opened, "open", io, builtins):
        yield


@contextmanager
def _create(counter: Counter, folder: Path) -> Iterator[None]:
    """No room for a new file or folder."""
    real, make = io.open, os.mkdir

    def opened(file: Any, mode: str = "r", *rest: Any, **more: Any) -> Any:
        if _new_file(mode, file, folder) and counter.fails():
            raise _full()
        return real(file, mode, *rest, **more)

    def made(path: Any, *rest: Any, **more: Any) -> None:
        if _inside(path, folder) and counter.fails():
            raise _full()
        make(path, *rest, **more)

    with replaced(opened, "open", io, builtins), replaced(made, "mkdir", os):
        yield


@contextmanager
def _fsync(counter: Counter, folder: Path) -> Iterator[None]:
    real = os.fsync

    def synced(handle: int) -> None:
        if counter.fails():
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        real(handle)

    with mock.patch.object(os, "fsync", synced):
        yield


@contextmanager
def _rename(counter: Counter, folder: Path) -> Iterator[None]:
    """Names that cannot be given: rename, replace, link and the exchange of two folders."""

    def refused(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*places: Any, **more: Any) -> Any:
            if counter.fails():
                raise OSError(errno.EACCES, os.strerror(errno.EACCES))
            return real(*places, **more)

        return call

    with (
        replaced(refused(os.rename), "rename", os),
        replaced(refused(os.replace), "replace", os),
        replaced(refused(os.link), "link", os),
        mock.patch.object(publish, "_exchange", refused(publish._exchange)),
    ):
        yield


@contextmanager
def _allocation(counter: Counter, folder: Path) -> Iterator[None]:
    """No memory in a function of the package, at the first call of each."""
    seen: set[object] = set()

    def called(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event != "call" or code in seen or not code.co_filename.startswith(_PACKAGE):
            return
        if code.co_name == "<module>" or f"{os.sep}cli{os.sep}" in code.co_filename or "__exit__" in code.co_name:
            return
        seen.add(code)
        if counter.fails():
            raise MemoryError

    old = sys.getprofile()
    sys.setprofile(called)
    try:
        yield
    finally:
        sys.setprofile(old)
