"""Launcher of all child processes: isolated, in an empty folder of their own, with a reduced environment.

A kit from elsewhere is untrusted data. Python puts the current folder first on its search path for `-c` and `-m`, so that a file
`json.py` in a kit would be executed when the kit is verified there. A child therefore gets the module folders of this process
without the current one, and starts in an empty folder.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
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
    cache = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    if kept.get("NUMBA_CACHE_DIR"):
        kept["NUMBA_CACHE_DIR"] = str(Path(kept["NUMBA_CACHE_DIR"]).absolute())
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


def run(command: Sequence[str], *, timeout_s: float, scratch: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a program to its end in `scratch`, or in a temporary folder.

    Raises
    ------
    OSError
        When it cannot be started.
    subprocess.TimeoutExpired
    """
    with _scratch(scratch) as folder:
        return subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=timeout_s,
            check=False,
            cwd=folder,
            env=environment(folder),
        )


def start(command: Sequence[str], scratch: Path, **settings: Any) -> subprocess.Popen[bytes]:
    """Start a program in `scratch`, which the caller removes; `settings` are Popen's.

    Raises
    ------
    OSError
        When it cannot be started.
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
