"""A few failing calls of each command that writes, in each run of the tests; `python -m tests.faults` tries all of them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tactape_fab import Kit
from tests.faults.injected import KINDS, Outcome, attempt, calls, state
from tests.faults.runs import CASES, Case, prepared, small_kit
from tests.thorough import some

TRIED = some(3)
"""Of each kind of call."""


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Kit:
    return small_kit(tmp_path_factory.mktemp("kit"))


def spread(count: int) -> list[int]:
    """Some of the numbers from 1 to `count`, the one in the middle with them."""
    return sorted({1 + (2 * i + 1) * count // (2 * TRIED) for i in range(TRIED)} & set(range(1, count + 1)))


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest, kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> Case:
    """A case that ran once: what is imported and compiled at the first use is there."""
    found: Case = CASES[request.param]
    found.run(prepared(found, kit, tmp_path_factory.mktemp("first") / "here"))
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_a_failing_call_leaves_the_old_or_the_new(case: Case, kind: str, kit: Kit, tmp_path: Path) -> None:
    folder = tmp_path / "here"
    before = state(prepared(case, kit, folder))
    count = calls(kind, case.run, folder)
    after = state(folder)
    assert count > 0 and after != before
    outcomes = {n: attempt(kind, n, case.run, prepared(case, kit, folder), before, after) for n in spread(count)}
    assert {n: outcome.wrong for n, outcome in outcomes.items() if outcome.wrong} == {}
    if kind == "write":  # a folder that is there already need not be made
        assert all(outcome.failed for outcome in outcomes.values())


@pytest.mark.parametrize("kind", ["write", "create"])
def test_a_command_that_writes_in_place_is_found(kind: str, kit: Kit, tmp_path: Path) -> None:
    def careless(folder: Path) -> None:
        (folder / "mine.txt").write_bytes(b"")
        (folder / "mine.txt").write_bytes(b"new")
        (folder / "other").write_bytes(b"other")

    case, folder = Case(prepare=lambda *_: None, run=careless), tmp_path / "here"
    before = state(prepared(case, kit, folder))
    count = calls(kind, careless, folder)
    after = state(folder)
    found: list[Outcome] = [attempt(kind, n, careless, prepared(case, kit, folder), before, after) for n in range(1, count + 1)]
    assert count >= 2 and all(outcome.wrong for outcome in found[1:])


def test_the_page_has_a_row_for_each_command_and_none_is_wrong() -> None:
    text = (Path(__file__).parents[2] / "docs" / "limits.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"<!-- faults -->\n(.*?)<!-- /faults -->\n", text, re.DOTALL)
    assert re.findall(r"^\| ([a-z][^|]*?) \|", table, re.MULTILINE) == ["run", *CASES]
    assert "wrong" not in table and "`python -m tests.faults " in table
