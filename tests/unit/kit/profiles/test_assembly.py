"""Part numbers of a profile and of an order: each house takes its own."""

from __future__ import annotations

import pytest

from tactape_fab.base.fields import Fields
from tactape_fab.kit.profiles.assembly import part_number_problem, read_part_numbers


@pytest.mark.parametrize(
    ("number", "house", "right"),
    [
        ("C1", "jlcpcb", True),
        ("C1234567890", "jlcpcb", True),
        ("C12345678901", "jlcpcb", False),
        ("ERJ-1GN0R00C", "jlcpcb", False),
        ("ERJ-1GN0R00C", "pcbway", True),
        ("A", "generic", True),
        (80 * "a", "generic", True),
        (81 * "a", "generic", False),
        ("=1+1", "kicad", False),
        ("a ", "kicad", False),
        ("a,b", "macrofab", False),
    ],
)
def test_a_part_number_is_one_of_the_house(number: str, house: str, right: bool) -> None:
    problem = part_number_problem(number, house)
    assert (problem is None) is right
    remedy = "a C and up to 10 digits" if house == "jlcpcb" else "use 1 to 80 letters"
    assert problem is None or (f"is invalid in assembly format '{house}'" in problem and remedy in problem)
    table = Fields({"part_numbers": {house: number}})
    assert read_part_numbers(table)[house] == (number if right else "") or table.problems
    assert bool(table.problems) is not right


def test_a_profile_without_numbers_has_none() -> None:
    assert read_part_numbers(Fields({})) == {}
    assert read_part_numbers(Fields({"part_numbers": {"pcbway": "ERJ", "jlcpcb": "C1"}})) == {"jlcpcb": "C1", "pcbway": "ERJ"}
