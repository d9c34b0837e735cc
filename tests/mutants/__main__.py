"""How many small changes of a module its tests notice: `python -m tests.mutants [MODULE...] --count 40`.

Each change is tried in a process of its own, with the tests that reach its line, the quickest first, and then with all others of
the module. Which changes are tried depends on the seed and the text of the file alone. Modules, their tests, and the changes that
change nothing (with the reason) stand in `tests/mutants/chosen.toml`. `--keep` writes the scores to `tests/mutants/scores.json`,
from which `docs/make_limits.py` makes its table.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

# everybody else's libraries, imported once for all of the forked processes
import cv2  # noqa: F401
import gerbonara  # noqa: F401
import hypothesis  # noqa: F401
import jinja2  # noqa: F401
import numba  # noqa: F401
import scipy.ndimage
import scipy.optimize  # noqa: F401
import shapely  # noqa: F401
import tomli
import trimesh  # noqa: F401

from tests.mutants.changes import Mutant, changed, mutants
from tests.mutants.trial import notices, reach

HERE = Path(__file__).parent
CHOSEN, SCORES = HERE / "chosen.toml", HERE / "scores.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """What became of the changes of one module."""

    changes: int
    tried: int
    noticed: int
    explained: int
    survivors: tuple[Mutant, ...]


def chosen() -> dict[str, Any]:
    """The modules that are tried, and the changes that change nothing."""
    with CHOSEN.open("rb") as stream:
        return tomli.load(stream)


def score(
    module: str, tests: Sequence[str], explained: set[tuple[str, str]], *, count: int, seed: int, in_functions: bool
) -> Score:
    """Try so many changes of a module."""
    path = Path(module)
    source = path.read_text(encoding="utf-8")
    every = [mutant for mutant in mutants(source) if mutant.in_function or not in_functions]
    tried = Random(seed).sample(every, min(count, len(every)))
    reached = reach(path, tests)
    patience_s = 5.0 + 4.0 * reached.processor_s
    noticed, known, survivors = 0, 0, []
    for mutant in sorted(tried, key=lambda m: m.line):
        near = reached.of_line(mutant.line)
        others = [name for name in reached.tests if name not in set(near)]
        if (mutant.text, mutant.change) in explained:
            known += 1
        elif any(notices(path, changed(source, mutant, str(path.resolve())), names, patience_s) for names in (near, others)):
            noticed += 1
        else:
            survivors.append(mutant)
            print(f"{module}:{mutant.line}: {mutant.change}: {mutant.text}{'' if near else ' (no test gets here)'}", flush=True)
    return Score(changes=len(every), tried=len(tried), noticed=noticed, explained=known, survivors=tuple(survivors))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("modules", nargs="*")
    parser.add_argument("--tests", action="append", default=[], help="for a module that is not in chosen.toml; may be repeated")
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", action="store_true")
    asked = parser.parse_args()
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    known = chosen()
    for module in asked.modules or known["modules"]:
        # kernels that numba keeps are those of the unchanged text: a module that holds some is run as it is written
        os.environ["NUMBA_DISABLE_JIT"] = "1" if module in known["kernels"] else "0"
        tests = asked.tests or known["modules"][module]
        explained = {(row["line"], row["change"]) for row in known.get("same", []) if row["file"] == module}
        functions = module in known["in_functions"]
        found = score(module, tests, explained, count=asked.count, seed=asked.seed, in_functions=functions)
        told = f"{found.noticed} of {found.tried} noticed, {found.explained} change nothing, {len(found.survivors)} survive"
        print(f"{module}: {told}; {found.changes} possible", flush=True)
        if asked.keep:
            kept = json.loads(SCORES.read_text()) if SCORES.exists() else {}
            row = {name: getattr(found, name) for name in ("changes", "tried", "noticed", "explained")}
            kept[module] = {**row, "survivors": len(found.survivors), "seed": asked.seed}
            SCORES.write_text(json.dumps({name: kept[name] for name in sorted(kept)}, indent=1) + "\n")


if __name__ == "__main__":
    main()
