"""One case: an entry point is given bytes, and watched for what it must not do."""

from __future__ import annotations

import os
import resource
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from tactape_fab.base.errors import TactapeError
from tests.fuzz.entries import Read

MOST_S, MOST_BYTES = 5.0, 1 << 30
"""What an entry point may cost: processor time, memory."""
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_ACTS = ("os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.truncate", "os.chmod", "shutil.rmtree")
_NEVER = ("os.system", "os.exec", "os.posix_spawn", "socket.connect", "socket.bind", "pty.spawn")


class Slow(BaseException):  # no `except Exception` may swallow it
    """Raised in an entry point whose processor time is over."""


class Elsewhere(BaseException):
    """Raised in an entry point that writes outside of its folder, or reaches for the network or a program."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """What an entry point did wrong: its kind, and where in the package, so that equal ones are told once."""

    kind: str
    place: str
    message: str


_allowed: list[str] = []
"""Folders in which the entry point that runs may write; empty while none runs."""


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if not _allowed or not (event == "open" or event in _ACTS or event in _NEVER):
        return
    if event == "open" and not (isinstance(arguments[2], int) and arguments[2] & _WRITING):
        return
    if event in _NEVER:
        raise Elsewhere(f"{event} {arguments!r:.100}")
    for path in [a for a in arguments[: 2 if event in ("os.rename", "os.link") else 1] if isinstance(a, str | bytes)]:
        place = os.path.realpath(os.fsdecode(path))
        if not place.startswith(tuple(_allowed)) and place != os.devnull and "__pycache__" not in place:
            raise Elsewhere(f"{event} {place}")


@contextmanager
def _watched(folder: Path) -> Iterator[None]:
    def over(_: int, __: FrameType | None) -> None:
        raise Slow

    old = signal.signal(signal.SIGVTALRM, over)
    signal.setitimer(signal.ITIMER_VIRTUAL, MOST_S)
    _allowed[:] = [os.path.realpath(folder), os.path.realpath(tempfile.gettempdir())]
    try:
        yield
    finally:
        _allowed.clear()
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, old)


def install_watch() -> None:
    """Look at every file that this process opens; once, for there is no way back."""
    if not getattr(sys, "_tactape_fuzz_watch", False):
        sys._tactape_fuzz_watch = True  # type: ignore[attr-defined]
        sys.addaudithook(_audit)


def limit_memory() -> None:
    """Let this process have no more than MOST_BYTES besides what it has: what asks for more is told so."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def cost_s() -> float:
    """Processor time of this process and of the children that it has waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def _forget_peak() -> None:
    """Let the peak of resident memory begin anew (proc(5), clear_refs)."""
    with Path("/proc/self/clear_refs").open("w") as stream:
        stream.write("5")


def _memory_bytes(what: str) -> int:
    """Resident memory now (``VmRSS``), or its peak (``VmHWM``)."""
    with Path("/proc/self/status").open() as stream:
        return next(int(line.split()[1]) * 1024 for line in stream if line.startswith(what))


def run_case(read: Read, data: bytes, folder: Path, refused: Callable[[], object] = lambda: None) -> Fault | None:
    """Give an entry point some bytes; what it did wrong, None if it answered or refused them. `refused` is told of a refusal."""
    _forget_peak()
    started, before = cost_s(), _memory_bytes("VmRSS")
    try:
        with _watched(folder):
            read(data, folder)
    except TactapeError:
        refused()
    except Slow as error:
        return Fault(kind="slow", place=_place(error), message=f"more than {MOST_S:g} s")
    except Elsewhere as error:
        return Fault(kind="elsewhere", place=_place(error), message=str(error))
    except Exception as error:
        return Fault(kind=type(error).__name__, place=_place(error), message=str(error)[:200])
    if (spent := cost_s() - started) > MOST_S:
        return Fault(kind="slow", place="", message=f"{spent:.1f} s")
    if (grown := _memory_bytes("VmHWM") - before) > MOST_BYTES:
        return Fault(kind="memory", place="", message=f"{grown / 1e6:.0f} MB")
    return None


def _place(error: BaseException) -> str:
    """The innermost line of the package that an exception came through."""
    lines = [f for f in traceback.extract_tb(error.__traceback__) if "tactape_fab" in f.filename]
    return f"{Path(lines[-1].filename).name}:{lines[-1].lineno} {lines[-1].name}" if lines else ""
