"""Launcher of all child processes: isolated, in an empty folder of their own, with a reduced environment.

A kit from elsewhere is untrusted data. Python puts the current folder first on its search path for `-c` and `-m`, so that a file
`json.py` in a kit would be executed when the kit is verified there. A child therefore gets the module folders of this process
without the current one, and starts in an empty folder.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from importlib.util import find_spec
from pathlib import Path
from typing import Any

FREECAD = ("freecadcmd", "FreeCADCmd")
PRUSA_SLICER = ("prusa-slicer",)
_KEPT = (
    *("LANG", "LC_ALL", "LC_CTYPE", "TZ", "SYSTEMROOT", "LD_LIBRARY_PATH", "NODE_PATH", "DISPLAY"),
    "SOURCE_DATE_EPOCH",
)
_KEPT_PREFIXES = ("NUMBA_", "TACTAPE_", "OMP_", "OPENBLAS_", "MKL_")
_FOLDER_LISTS = ("PATH", "LD_LIBRARY_PATH", "NODE_PATH")
"""Variables that list folders: an empty or relative entry is the current folder, or lies in it."""

_of_thread = threading.local()


def installed(names: Sequence[str]) -> str | None:
    """Path of the first of these programs that exists, searched in absolute folders only."""
    folders = _absolute(os.environ.get("PATH", os.defpath))
    return next((path for name in names if (path := shutil.which(name, path=folders))), None)


def environment(scratch: Path) -> dict[str, str]:
    """Environment variables of a child; its home is `scratch`, so that it neither reads nor writes the user's settings."""
    kept = {
        name: value for name, value in os.environ.items() if name in _KEPT or name == "PATH" or name.startswith(_KEPT_PREFIXES)
    }
    kept |= {name: _absolute(kept[name]) for name in _FOLDER_LISTS if name in kept}
    cache = _absolute(os.environ.get("XDG_CACHE_HOME", "")) or str(Path("~/.cache").expanduser())
    if not _absolute(kept.get("NUMBA_CACHE_DIR", "")):  # numba unpickles what is there, and it would be in the current folder
        kept.pop("NUMBA_CACHE_DIR", None)
    return kept | {
        "HOME": str(scratch),
        **dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(scratch)),  # that of the user may not exist, and FreeCAD dies of it
        "XDG_CACHE_HOME": cache,  # numba's cache of compiled functions
        "XDG_CONFIG_HOME": str(scratch),
        "PYTHONSAFEPATH": "1",  # for the interpreters inside other programs
    }


def python_command(code: str, *arguments: str) -> list[str]:
    """Command that runs `code` in an isolated interpreter with the modules that this one finds; `arguments` are ``sys.argv[1:]``.

    ``-I`` alone would lose folders that the user named in PYTHONPATH, and their own site-packages.
    """
    return [sys.executable, "-I", "-c", f"import sys; sys.path[:] = {_module_folders()!r}; {code}", *arguments]


def limited(command: Sequence[str], *, cpu_s: int, memory_bytes: int) -> list[str]:
    """Command that runs another within a processor time and a memory, where the system can limit them (not on Windows).

    A program that needs more time ends by SIGXCPU; one that asks for more memory does not get it.
    """
    if find_spec("resource") is None:
        return list(command)
    code = _WITHIN_LIMITS.format(cpu_s=cpu_s, memory_bytes=memory_bytes)
    return [sys.executable, "-I", "-S", "-c", code, *command]


# SIGXCPU at the soft limit, SIGKILL 5 s later for who ignores it; the data segment, not the address space, of which libraries
# reserve more than they use. No limit is set above the hard one that the process was started with: it may not raise that
_WITHIN_LIMITS = (
    "import os, resource as r, sys\n"
    "def limit(of, soft, hard):\n"
    "    most = r.getrlimit(of)[1]\n"
    "    r.setrlimit(of, (soft, hard) if most == r.RLIM_INFINITY else (min(soft, most), most if hard < 0 else min(hard, most)))\n"
    "limit(r.RLIMIT_CPU, {cpu_s}, {cpu_s} + 5)\n"
    "limit(r.RLIMIT_DATA, {memory_bytes}, r.RLIM_INFINITY)\n"
    "os.execv(sys.argv[1], sys.argv[1:])"
)


def limit_self(*, cpu_s: float, memory_bytes: int) -> None:
    """Limit this process to a further processor time, to whole seconds, and to a memory; it ends by SIGXCPU when that is over."""
    if find_spec("resource") is None:
        return
    import resource

    used = resource.getrusage(resource.RUSAGE_SELF)
    # RLIMIT_CPU counts from the process's start, so what was used is added
    total_s = max(1, int(used.ru_utime + used.ru_stime + cpu_s))
    for of, soft in ((resource.RLIMIT_CPU, total_s), (resource.RLIMIT_DATA, memory_bytes)):
        # the hard limit stays, as only root can raise it again; none is -1
        _, most = resource.getrlimit(of)
        resource.setrlimit(of, (soft if most == resource.RLIM_INFINITY else min(soft, most), most))


def too_long(status: int) -> bool:
    """Whether a process with this exit status was ended because its processor time was over."""
    return status == -getattr(signal, "SIGXCPU", 0) != 0


def run(command: Sequence[str], *, timeout_s: float, scratch: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a program to its end in `scratch`, or in a temporary folder.

    Raises OSError when it cannot be started.
    Raises subprocess.TimeoutExpired.
    """
    children: Children | None = getattr(_of_thread, "children", None)
    with (
        _scratch(scratch) as folder,
        subprocess.Popen(
            command,
            # no terminal: a program that asks would wait for ever
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            errors="replace",
            cwd=folder,
            env=environment(folder),
        ) as child,
        nullcontext() if children is None else children.ended_with(child),
    ):
        try:
            out, err = child.communicate(timeout=timeout_s)
        except BaseException:
            child.kill()
            raise
    return subprocess.CompletedProcess(child.args, child.returncode, out, err)


class Children:
    """The programs that threads of a pool `run`: all are ended when the program that waits for the threads is to end itself."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: list[subprocess.Popen[str]] = []
        self._stopped = False

    def adopt(self) -> None:
        """Count what the calling thread runs among them: the initializer of a ThreadPoolExecutor."""
        _of_thread.children = self

    def stop(self) -> None:
        """End all that run, and each that a thread starts later."""
        with self._lock:
            self._stopped = True
            for child in self._running:
                child.kill()

    @contextmanager
    def ended_with(self, child: subprocess.Popen[str]) -> Iterator[None]:
        """Context manager: a program is one of them."""
        with self._lock:
            self._running.append(child)
            if self._stopped:
                child.kill()
        try:
            yield
        finally:
            with self._lock:
                self._running.remove(child)


def start(command: Sequence[str], scratch: Path, **settings: Any) -> subprocess.Popen[bytes]:
    """Start a program in `scratch`, which the caller removes; `settings` are Popen's.

    Raises OSError when it cannot be started.
    """
    return subprocess.Popen(command, cwd=scratch, env=environment(scratch), **settings)


@contextmanager
def _scratch(given: Path | None) -> Iterator[Path]:
    if given is not None:
        yield given
        return
    with tempfile.TemporaryDirectory(prefix="tactape-", ignore_cleanup_errors=True) as folder:
        yield Path(folder)


def _module_folders() -> list[str]:
    """Folders of this interpreter's modules without the current folder, which is untrusted, and this package's own."""
    here, own = Path.cwd().resolve(), str(Path(__file__).resolve().parents[2])
    found = [p for p in sys.path if Path(p).is_absolute() and (p == own or Path(p).resolve() != here)]
    return found if own in found else [*found, own]


def _absolute(folders: str) -> str:
    return os.pathsep.join(folder for folder in folders.split(os.pathsep) if Path(folder).is_absolute())
