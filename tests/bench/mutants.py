"""How many small changes of a module its tests notice.

`python -m tests.bench.mutants FILE.py TESTS... --count 30` changes one operator, comparison, constant or condition of the file at
a time, in a copy of the checkout, runs the tests, and counts the changes that make one fail. Which changes are tried depends on
the seed and the text of the file alone, so that two commits can be compared.
"""

from __future__ import annotations

import argparse
import ast
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path

_SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
_PATIENCE_S = 600.0


def mutants(text: str) -> Iterator[tuple[int, str]]:
    """Line and whole text of every module that differs from this one in one place."""
    tree = ast.parse(text)
    for index, node in enumerate(ast.walk(tree)):
        changed = deepcopy(tree)
        twin = next(n for i, n in enumerate(ast.walk(changed)) if i == index)
        if isinstance(twin, ast.BinOp | ast.BoolOp) and type(twin.op) in _SWAPS:
            twin.op = _SWAPS[type(twin.op)]()  # type: ignore[assignment]
        elif isinstance(twin, ast.Compare) and type(twin.ops[0]) in _SWAPS:
            twin.ops[0] = _SWAPS[type(twin.ops[0])]()  # type: ignore[call-overload]
        elif isinstance(twin, ast.Constant) and isinstance(twin.value, int | float) and not isinstance(twin.value, bool):
            twin.value += 1
        elif isinstance(twin, ast.If | ast.IfExp):
            twin.test = ast.UnaryOp(op=ast.Not(), operand=twin.test)
        else:
            continue
        yield getattr(node, "lineno", 0), ast.unparse(ast.fix_missing_locations(changed))


def main() -> None:
    """Try some of them, and print which were not noticed and how many were."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("module", type=Path)
    parser.add_argument("tests", nargs="+")
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    tried = list(mutants(asked.module.read_text(encoding="utf-8")))
    random.Random(asked.seed).shuffle(tried)
    tried = tried[: asked.count]
    with tempfile.TemporaryDirectory(prefix="tactape-mutants-") as folder:
        copy = Path(folder) / "tree"
        shutil.copytree(Path.cwd(), copy, ignore=shutil.ignore_patterns(".venv", ".git", ".*_cache"))
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", *asked.tests]
        if subprocess.run(command, cwd=copy, capture_output=True, check=False).returncode != 0:
            sys.exit("the tests fail without any change; mend them first")
        killed = 0
        for line, text in tried:
            (copy / asked.module).write_text(text, encoding="utf-8")
            try:
                run = subprocess.run(command, cwd=copy, capture_output=True, timeout=_PATIENCE_S, check=False)
                noticed = run.returncode in (1, 2)  # 2: it does not even import
            except subprocess.TimeoutExpired:
                noticed = True
            killed += noticed
            if not noticed:
                print(f"{asked.module}:{line} was not noticed", flush=True)
    print(f"{asked.module}: {killed} of {len(tried)} killed")


if __name__ == "__main__":
    main()
