"""The oldest libraries that pyproject.toml allows: whether the main job works with them, and makes the files of newer ones.

`python -m tests.lowest` makes an environment with the lower bound of every requirement, makes, verifies and decodes a tape there,
compares its files with those of this environment, and runs some tests; three minutes of processor time, most of it compilation.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from argparse import ArgumentParser
from pathlib import Path
from time import perf_counter
from typing import Any

from tests.installs import ROOT, clean_environment, fresh_environment, interpreter, requirements

PYTHON = ("3.10", "3.11", "3.12")
"""Those with wheels of the oldest numpy and numba."""
EXTRAS = ("live", "measure", "raw")
"""What a wheel of the oldest numpy exists for; that of build123d asks for numpy 2."""
RUNNERS = ("hatchling", "hypothesis", "pypdf", "pytest", "pytest-benchmark", "pytest-xdist")
_BASE = ("blas", "given_value", "image_file", "jit", "kept_kernels", "number_rows", "picture_file", "plain_text")
TESTS = (
    *("tests/golden/test_golden.py", "tests/unit/texture/test_tape.py", "tests/unit/kit/read"),
    *(f"tests/unit/base/test_{name}.py" for name in _BASE),
)
"""Of what calls libraries that have other versions here."""
DRAWN = ("3mf", "fab-drawing", "preview-png", "report", "stl")
"""Roles whose bytes depend on versions of libraries, which the manifest records: pictures, PDF, triangles of equal right."""
_BOUND = re.compile(r"([A-Za-z0-9_.-]+)>=([0-9.]+)[^;]*(;.*)?")


def oldest(lines: list[str]) -> list[str]:
    """Requirements with each lower bound as the version.

    Raises
    ------
    ValueError
        For a requirement without one.
    """
    found = [(line, _BOUND.fullmatch(line)) for line in lines]
    if loose := [line for line, bound in found if bound is None]:
        raise ValueError(f"without a lower bound: {loose}")
    return [f"{bound[1]}=={bound[2]}{bound[3] or ''}" for _, bound in found if bound is not None]


def pins() -> list[str]:
    """The oldest of everything that the environment takes."""
    runners = [line for line in requirements("dev") if line.partition(">=")[0] in RUNNERS]
    return sorted({*oldest(requirements(*EXTRAS)), *oldest(runners)})


def digests(kit: Path) -> dict[str, Any]:
    """What has to be the same with all libraries: digests of files, and the manifest without what says which they were."""
    content = json.loads((kit / "manifest.json").read_bytes())
    files = {row["path"]: row["sha256"] for row in content.pop("files") if row["role"] not in DRAWN}
    del content["made"]["libraries"]
    return {**files, "manifest.json": content}


def main() -> None:
    python = next(filter(None, map(interpreter, PYTHON)), None)
    if python is None:
        sys.exit(f"none of Python {', '.join(PYTHON)} is installed, which the oldest libraries need")
    with tempfile.TemporaryDirectory(prefix="tactape-lowest-") as folder:
        here = Path(folder)
        fresh = fresh_environment(here / "env", ["--only-binary=:all:", *pins()], interpreter=python)
        print(f"{', '.join(pins())}: {fresh.size_bytes / 1e6:.0f} MB in {fresh.seconds:.0f} s", flush=True)
        settings = {**clean_environment(), "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(here / "compiled")}
        settings.pop("TACTAPE_THOROUGH", None)  # libraries of other versions need no more cases

        def run(program: Path | str, *words: str, cwd: Path = here) -> str:
            start = perf_counter()
            done = subprocess.run([program, "-m", *words], cwd=cwd, env=settings, stdout=subprocess.PIPE, text=True, check=False)
            print(f"{' '.join(words)}: {perf_counter() - start:.0f} s", flush=True)
            if done.returncode != 0:
                sys.exit(f"{done.stdout}it failed with the oldest libraries")
            return done.stdout

        make = ("tactape_fab", "make", "--sector", "7", "--size", "60x40", "--hole", "40,20,1", "--overwrite", "-o")
        run(sys.executable, *make, "newest")
        run(fresh.python, *make, "oldest")
        ours, theirs = digests(here / "newest"), digests(here / "oldest")
        if different := sorted(path for path in ours | theirs if ours.get(path) != theirs.get(path)):
            sys.exit(f"other bytes with the oldest libraries: {', '.join(different)}")
        print(f"{len(ours)} files are the same with the oldest libraries")
        run(fresh.python, "tactape_fab", "verify", "oldest", "--quick")
        run(fresh.python, "tactape_fab", "simulate", "oldest", "-o", "frames.npz", "--pose", "20,12,30")
        fix = json.loads(run(fresh.python, "tactape_fab", "decode", "frames.npz", "--tape", "oldest", "--json"))
        if not fix["located"] or max(abs(fix["position_mm"][0] - 20.0), abs(fix["position_mm"][1] - 12.0)) > 0.02:
            sys.exit(f"another answer with the oldest libraries: {fix['reason']}, {fix['position_mm']}")
        run(fresh.python, "pytest", "-n", "0", *TESTS, cwd=ROOT)


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    main()
