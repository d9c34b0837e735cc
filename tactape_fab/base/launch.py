"""Launcher of all child processes: isolated, in an empty folder of their own, with a reduced environment.

A kit from elsewhere is untrusted. With `-c` and `-m` Python puts the current folder first on its search path, so that a file
`json.py` in a kit would be executed when the kit is verified from within. A child therefore starts in an empty folder, with the
module folders of this process except the current one.
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
"""Variables that list folders; empty and relative entries, which mean the current folder or one in it, are removed."""

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
    if not _absolute(kept.get("NUMBA_CACHE_DIR", "")):  # relative to the current folder, from which nothing may be unpickled
        kept.pop("NUMBA_CACHE_DIR", None)
    return kept | {
        "HOME": str(scratch),
        **dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(scratch)),  # FreeCAD crashes where the user's does not exist
        "XDG_CACHE_HOME": cache,  # numba's cache of compiled functions
        "XDG_CONFIG_HOME": str(scratch),
        "PYTHONSAFEPATH": "1",  # for the interpreters inside other programs
    }


def python_command(code: str, *arguments: str) -> list[str]:
    """Command that runs `code` in an isolated interpreter with this process's module folders; `arguments` are ``sys.argv[1:]``.

    ``-I`` alone would lose folders that the user named in PYTHONPATH, and their own site-packages.
    """
    return [sys.executable, "-I", "-c", f"import sys; sys.path[:] = {_module_folders()!r}; {code}", *arguments]


def limited(command: Sequence[str], *, cpu_s: int, memory_bytes: int) -> list[str]:
    """Command that runs another one with a limit of processor time and memory; unchanged on Windows, which has no such limits.

    A program that exceeds the time is ended by SIGXCPU; an allocation beyond the memory fails.
    """
    if find_spec("resource") is None:
        return list(command)
    code = _WITHIN_LIMITS.format(cpu_s=cpu_s, memory_bytes=memory_bytes)
    return [sys.executable, "-I", "-S", "-c", code, *command]


# SIGXCPU at the soft limit, SIGKILL 5 s later if that is ignored. RLIMIT_DATA, not RLIMIT_AS: libraries reserve more address
# space than they use. No limit is set above the hard one that the process was started with, which it may not raise
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
    """Limit the further processor time of this process, in whole seconds, and its memory; SIGXCPU ends it after that time."""
    if find_spec("resource") is None:
        return
    import resource

    used = resource.getrusage(resource.RUSAGE_SELF)
    # RLIMIT_CPU counts from the process's start, so what was used is added
    total_s = max(1, int(used.ru_utime + used.ru_stime + cpu_s))
    for of, soft in ((resource.RLIMIT_CPU, total_s), (resource.RLIMIT_DATA, memory_bytes)):
        # the hard limit stays, as only root could raise it again; -1 means no limit
        _, most = resource.getrlimit(of)
        resource.setrlimit(of, (soft if most == resource.RLIM_INFINITY else min(soft, most), most))


def too_long(status: int) -> bool:
    """Whether this exit status means that the process exceeded its processor time."""
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
            # no terminal: a program that prompts would wait for ever
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
    """Programs started by `run` in the threads of a pool, so that all can be killed when this process has to stop."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: list[subprocess.Popen[str]] = []
        self._stopped = False

    def register_thread(self) -> None:
        """Register the programs that the calling thread runs from now on; the initializer of a ThreadPoolExecutor."""
        _of_thread.children = self

    def stop(self) -> None:
        """Kill all running programs, and each one that a thread starts later."""
        with self._lock:
            self._stopped = True
            for child in self._running:
                child.kill()

    @contextmanager
    def ended_with(self, child: subprocess.Popen[str]) -> Iterator[None]:
        """Context manager: `child` is one of them inside the block."""
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
    """Folders of this interpreter's modules and of this package, without the current folder, which is untrusted."""
    here, own = Path.cwd().resolve(), str(Path(__file__).resolve().parents[2])
    found = [p for p in sys.path if Path(p).is_absolute() and (p == own or Path(p).resolve() != here)]
    return found if own in found else [*found, own]


def _absolute(folders: str) -> str:
    return os.pathsep.join(folder for folder in folders.split(os.pathsep) if Path(folder).is_absolute())
