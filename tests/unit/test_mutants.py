"""The mutation runner: what it changes, that its tests see it, and that its list of changes that change nothing is up to date."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.mutants.__main__ import SCORES, chosen
from tests.mutants.changes import changed, mutants
from tests.mutants.trial import in_a_child

SOURCE = '''"""Text of 1 module."""
from __future__ import annotations
LEAST = 3
def least(values: list[int], most: int = 5) -> int | None:
    """Text with 2 in it."""
    found = [v for v in values if v > LEAST and not v == 7]
    if not found:
        return None
    print("said")
    return min(found) - 1 if len(found) < most else -found[0]
'''


def ways(source: str) -> list[str]:
    return [mutant.change for mutant in mutants(source)]


def test_operators_constants_conditions_and_statements_are_changed() -> None:
    assert ways(SOURCE) == [
        *("3 to 4", "5 to 6", "without the condition", "and to or", "> to >=", "> to <=", "not away", "== to !=", "7 to 8"),
        *("condition to its opposite", "not away", "statement away", "returns None", "< to <=", "< to >="),
        *("- to +", "min to max", "1 to 2", "without minus", "0 to 1"),
    ]


def test_each_is_one_change_of_the_module() -> None:
    seen = set()
    for mutant in mutants(SOURCE):
        space: dict[str, object] = {}
        code = changed(SOURCE, mutant, "least.py")
        exec(code, space)
        assert callable(space["least"])
        seen.add((code.co_consts, ast.dump(ast.parse(SOURCE)), mutant.place))
        assert SOURCE.splitlines()[mutant.line - 1].strip() == mutant.text
    assert len(seen) == len(list(mutants(SOURCE)))


@pytest.mark.parametrize(("status", "expected"), [(0, 0), (3, 3)])
def test_a_child_gives_its_status(status: int, expected: int) -> None:
    assert in_a_child(lambda: status, 10.0) == expected


def test_a_child_that_never_ends_is_ended() -> None:
    def forever() -> int:
        while True:
            pass

    assert in_a_child(forever, 0.0) < 0


def test_changes_that_change_nothing_are_still_there_and_say_why() -> None:
    found = dict[str, set[tuple[str, str]]]()  # each file is read once: some have twenty
    for row in chosen().get("same", []):
        if (file := row["file"]) not in found:
            found[file] = {(mutant.text, mutant.change) for mutant in mutants(Path(file).read_text(encoding="utf-8"))}
        assert (row["line"], row["change"]) in found[file] and len(row["why"]) > 20


def test_the_list_names_files_that_are_there() -> None:
    for module, tests in chosen()["modules"].items():
        files = [test.removeprefix("--deselect=").partition("::")[0] for test in tests]
        assert Path(module).is_file() and all(Path(file).exists() for file in files)
    assert SCORES.is_file()
