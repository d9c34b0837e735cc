"""What is kept of compiled kernels: nothing of it is taken for another kernel's, and no start fails for it."""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from tactape_fab.base import jit
from tests.thorough import costly, slow

pytestmark = pytest.mark.skipif(not jit.KEPT, reason="nothing is compiled, or kept")

ADDED = """
import sys
from tactape_fab.base.jit import kernel

@kernel()
def add(a, b):
    return a + b

print(add(1, 2), sum(add.stats.cache_hits.values()))
"""
CALLED = """
from typing import NamedTuple
from tactape_fab.base.jit import inner_kernel

class Pair(NamedTuple):
    a: int
    b: int

PLACES = 10

@inner_kernel()
def placed(pair):
    return PLACES * pair.a
"""
CALLING = """
from called import Pair, placed
from tactape_fab.base.jit import kernel

@kernel()
def joined(pair):
    return placed(pair) + pair.b

print(joined(Pair(a=1, b=2)), sum(joined.stats.cache_hits.values()))
"""
LARGEST_INDEX = 4096
"""An index has less bytes, code more: where a file can have no more, the first alone is written."""


def run(program: Path, kept: Path, *, most_bytes: int | None = None) -> subprocess.CompletedProcess[str]:
    """Run the program with a folder of kept kernels, and files of so many bytes at most."""
    search = os.pathsep.join([str(program.parent), *sys.path])
    # Python's own kept code has dates of whole seconds: a module that changes within one would be taken for the same
    environment = {**os.environ, "PYTHONPATH": search, "NUMBA_CACHE_DIR": str(kept), "PYTHONDONTWRITEBYTECODE": "1"}
    line = [sys.executable, str(program)]
    if most_bytes is not None:
        limit = f"resource.setrlimit(resource.RLIMIT_FSIZE, ({most_bytes}, -1))"
        line = [sys.executable, "-c", f"import resource, runpy; {limit}; runpy.run_path({str(program)!r})"]
    return subprocess.run(line, capture_output=True, encoding="utf-8", check=True, env=environment)


def added(program: Path, kept: Path) -> str:
    """Output of the program with a folder of kept kernels."""
    return run(program, kept).stdout


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the program and its kept kernel, which a second start reads."""
    folder = tmp_path_factory.mktemp("compiled")
    program = folder / "program.py"
    program.write_text(ADDED, encoding="utf-8")
    assert added(program, folder / "kept") == "3 0\n" and added(program, folder / "kept") == "3 1\n"
    return folder


@pytest.fixture(scope="module")
def calling(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of the program that calls another; each test writes the called one anew."""
    folder = tmp_path_factory.mktemp("calling")
    program = folder / "program.py"
    program.write_text(CALLING, encoding="utf-8")
    (folder / "called.py").write_text(CALLED, encoding="utf-8")
    assert added(program, folder / "kept") == "12 0\n" and added(program, folder / "kept") == "12 1\n"
    return folder


@slow
@pytest.mark.parametrize("kind", ["nbi", "nbc"])
@pytest.mark.parametrize("content", [b"", b"cut off", "class of another version"])
def test_a_kept_kernel_that_cannot_be_read_is_compiled_anew(
    kind: str, content: bytes | str, compiled: Path, tmp_path: Path
) -> None:
    kept = Path(shutil.copytree(compiled / "kept", tmp_path / "kept"))
    (file,) = kept.rglob(f"*.{kind}")
    if isinstance(content, str):
        content = b"ctactape_fab.base.jit\nGone\n."
        content = (
            pickle.dumps(version("numba"), protocol=-1) if kind == "nbi" else b""
        ) + content  # an index begins with numba's own
    file.write_bytes(content)
    assert added(compiled / "program.py", kept) == "3 0\n" and added(compiled / "program.py", kept) == "3 1\n"


@costly
@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ("PLACES = 10", "PLACES = 50", 52),  # a constant of what is called
        ("PLACES * pair.a", "PLACES + pair.a", 13),  # its code
        ("    a: int\n    b: int", "    b: int\n    a: int", 12),  # the order of fields, by which numba reads them
    ],
)
def test_a_kernel_is_compiled_anew_where_what_it_calls_has_changed(
    before: str, after: str, expected: int, calling: Path, tmp_path: Path
) -> None:
    program, kept = calling / "program.py", Path(shutil.copytree(calling / "kept", tmp_path / "kept"))
    (calling / "called.py").write_text(CALLED.replace(before, after), encoding="utf-8")
    assert added(program, kept) == f"{expected} 0\n" and added(program, kept) == f"{expected} 1\n"


@slow
@pytest.mark.skipif(sys.platform == "win32", reason="no limits of files")
def test_code_of_an_older_version_under_a_newer_index_is_not_taken(tmp_path: Path) -> None:
    """A full disk keeps no kernel, and ends no start: numba writes the newer index first, for which there is room."""
    program, kept = tmp_path / "program.py", tmp_path / "kept"
    program.write_text(ADDED, encoding="utf-8")
    assert added(program, kept) == "3 0\n"
    (code,) = kept.rglob("*.nbc")
    older = code.read_bytes()
    program.write_text(ADDED.replace("a + b", "a - b * 2"), encoding="utf-8")
    full = run(program, kept, most_bytes=LARGEST_INDEX)
    assert full.stdout == "-3 0\n" and code.read_bytes() == older
    assert full.stderr.count("\n") == 1 and "cannot be kept" in full.stderr and "NUMBA_CACHE_DIR" in full.stderr
    assert added(program, kept) == "-3 0\n" and added(program, kept) == "-3 1\n"


DIGESTS = """
import importlib, pkgutil, sys
import tactape_fab
from tactape_fab.base.kept_kernels import _made_of
for module in pkgutil.walk_packages(tactape_fab.__path__, "tactape_fab."):
    if ".sense.decode" in module.name or ".texture." in module.name:
        importlib.import_module(module.name)
for name in sorted(name for name in sys.modules if name.startswith("tactape_fab.")):
    for kernel in vars(sys.modules[name]).values():
        if hasattr(kernel, "py_func"):
            print(name, kernel.py_func.__name__, _made_of(kernel))
"""


@costly
def test_every_process_finds_the_same_digests() -> None:
    """Python keeps sets, as of `fastmath`, in another order in each: a kernel would be compiled by every process."""
    found = [
        subprocess.run(
            [sys.executable, "-c", DIGESTS],
            capture_output=True,
            encoding="utf-8",
            check=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "PYTHONHASHSEED": seed},
        ).stdout
        for seed in ("1", "2")
    ]
    assert found[0] == found[1] and found[0].count("\n") > 100
