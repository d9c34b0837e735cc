"""Writes into docs/install.md what each installation takes here, and where and beside what uv's resolver finds wheels for it.

`python docs/make_installs.py [sizes | cells | beside]`; uv (extra dev) and a registry have to be
there, and the sizes take minutes.
"""

from __future__ import annotations

import re
import sys
import tempfile
from argparse import ArgumentParser
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.bench.marks import write_between  # noqa: E402
from tests.installs import (  # noqa: E402
    COMPANIONS,
    MACHINES,
    NO_WHEEL,
    NUMPYS,
    PYTHONS,
    ROBOT,
    beside,
    built_wheel,
    cad_glibc,
    fresh_environment,
    installable,
    lab_extras,
)

PAGE = ROOT / "docs" / "install.md"


def sizes(scratch: Path) -> list[str]:
    """A row for each installation: size, and time that pip took."""
    wheel = built_wheel(ROOT, scratch / "dist")
    kinds: dict[str, list[list[str | Path]]] = {
        "robot's half": [list(ROBOT), ["--no-deps", wheel]],
        "default": [[wheel]],
        "with `[cad]`": [[f"{wheel}[cad]"]],
    }
    rows = ["| installation | MB | s |", "|---|---|---|"]
    for name, installs in kinds.items():
        made = fresh_environment(scratch / re.sub(r"\W", "", name), *installs)
        rows.append(f"| {name} | {made.size_bytes / 1e6:.0f} | {made.seconds:.0f} |")
    return rows


def cells(_: Path) -> list[str]:
    """A row for each Python and machine: what resolves with numpy 1.26, and with numpy 2."""
    rows = ["| Python | machine | numpy 1.26 | numpy 2 |", "|---|---|---|---|"]
    return rows + [f"| {p} | {m} | {' | '.join(_cell(p, m, n) for n in NUMPYS)} |" for p in PYTHONS for m in MACHINES]


def _cell(python: str, machine: str, numpy: str) -> str:
    if (python, numpy) in NO_WHEEL:
        return f"no: numpy {numpy} has no wheel for Python {python}"
    found = installable(python, machine, numpy)
    missing = [name for name, answer in found.items() if isinstance(answer, str)]
    if "default" in missing or "robot" in missing:
        return "no: " + "; ".join(f"{name}: {found[name]}" for name in missing)
    *_, versions = (answer for answer in found.values() if not isinstance(answer, str))
    yes = f"yes: numpy {versions['numpy']}, numba {versions['numba']}"
    if missing:
        return f"{yes}; not `[cad]`: {found['[cad]']}"
    return yes if (glibc := cad_glibc(python)) == 28 else f"{yes}; `[cad]` on glibc 2.{glibc}"


def beside_rows(_: Path) -> list[str]:
    """A row for each companion and Python: the extras that install beside it all at once, and what each other one lacks."""
    rows = ["| beside | Python | install all at once | do not |", "|---|---|---|---|"]
    for companion in COMPANIONS:
        for python in companion.pythons:
            together, refused = beside(companion, python)
            fitting = [f"`{name}`" for name in lab_extras() if name not in refused]
            lacking = "; ".join(f"`{name}`: {why}" for name, why in refused.items()) or "none"
            numpy = f"default (numpy {together['numpy']})"
            rows.append(f"| {companion.name} | {python} | {', '.join([numpy, *fitting])} | {lacking} |")
    return rows


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", help="all unless named")
    asked = parser.parse_args().tables
    with tempfile.TemporaryDirectory() as scratch:
        tables = {"sizes": sizes, "cells": cells, "beside": beside_rows}
        for name, make in ((name, tables[name]) for name in asked or tables):
            rows = "\n".join(make(Path(scratch)))
            print(rows, flush=True)
            write_between(PAGE, name, f"{rows}\n")


if __name__ == "__main__":
    main()
