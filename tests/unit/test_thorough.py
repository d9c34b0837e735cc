"""Parts of a thorough run: together all cases, and each of them all that a desk tries."""

from __future__ import annotations

from typing import Any

import pytest

from tests.thorough import costly, only_thorough, part_of, slow, spread

CASES = {"tests/unit/test_a.py::test_many": 9, "tests/readers/test_b.py::test_kits": 4, "tests/bench/test_c.py::test_speed": 3}
MARKED = {"tests/unit/test_a.py::test_costly": costly, "tests/test_a.py::test_slow": slow, "tests/d.py::test_d": only_thorough}


class Item:
    """As much of a collected test as `part_of` looks at."""

    def __init__(self, nodeid: str, *marks: pytest.MarkDecorator) -> None:
        self.nodeid, self.marks = nodeid, [decorator.mark for decorator in marks]

    def iter_markers(self, name: str) -> list[pytest.Mark]:
        return [mark for mark in self.marks if mark.name == name]

    def get_closest_marker(self, name: str) -> pytest.Mark | None:
        return next(iter(self.iter_markers(name)), None)


def items() -> list[Any]:
    plain = [Item(f"{test}[{n}]") for test, count in CASES.items() for n in range(count)]
    return plain + [Item(f"{test}[{n}]", mark) for test, mark in MARKED.items() for n in range(5)]


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_parts_are_all_cases_and_share_what_a_desk_tries(parts: int) -> None:
    every = items()
    found = [part_of(every, f"{number}/{parts}") for number in range(parts)]
    assert {i.nodeid for part in found for i in part} == {i.nodeid for i in every}
    at_desk = {i.nodeid for i in spread(every) if not i.nodeid.startswith(("tests/bench/", "tests/d.py"))}
    shared = set.intersection(*({i.nodeid for i in part} for part in found))
    assert shared == (at_desk if parts > 1 else {i.nodeid for i in every})
    assert max(map(len, found)) - min(map(len, found)) <= len(CASES) + len(MARKED)


@pytest.mark.parametrize("part", ["2", "0/0", "-1/2", "a/b", "0/2/3"])
def test_no_part_is_a_message(part: str) -> None:
    with pytest.raises(pytest.UsageError, match="such as 0/3"):
        part_of(items(), part)
