"""What decides that a kit is verified: every line must hold, warnings excepted; and a certificate is compared value by value."""

from __future__ import annotations

import json
from copy import deepcopy
from typing import Any

import pytest

from tactape_fab.base.errors import Check, Problem, SpecError, VerifyError
from tactape_fab.texture.certify.certificate import certify
from tactape_fab.verify.certificate import check_certificate, difference
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.verification import Verification, collected, unreadable
from tests.tapes import tape_at

GOOD = Check(name="good", passed=True, message="fits")
BAD = Check(name="bad", passed=False, message="does not fit")
WARNING = Check(name="warned", passed=False, message="fits hardly", warning=True)


@pytest.mark.parametrize(
    ("lines", "passed"),
    [
        ([], True),
        ([GOOD], True),
        ([GOOD, WARNING], True),
        ([WARNING], True),
        ([BAD], False),
        ([GOOD, GOOD, BAD], False),
        ([BAD, GOOD, WARNING], False),
    ],
)
def test_one_line_that_fails_is_enough(lines: list[Check], passed: bool) -> None:
    told: list[Check] = []
    verification = collected("kit", iter(lines), told.append)
    assert (verification.name, verification.checks, told) == ("kit", tuple(lines), lines)
    assert verification.passed is passed
    if passed:
        verification.raise_if_failed()
        return
    with pytest.raises(VerifyError) as error:
        verification.raise_if_failed()
    assert error.value.checks == tuple(lines) and str(error.value) == "bad: does not fit"


def test_contacts_that_come_with_the_lines_are_kept() -> None:
    trips: list[Any] = []

    def lines() -> Any:
        yield GOOD
        trips.append("a contact")

    assert list(collected("kit", lines(), lambda _: None, trips).trips) == trips == ["a contact"]
    assert Verification(name="kit", checks=()).trips == ()


def test_a_manifest_that_cannot_be_read_verifies_nothing() -> None:
    told: list[Check] = []
    found = unreadable("kit", SpecError([Problem("a", "a = 1 is wrong"), Problem("b", "b = 2 is wrong")]), told.append)
    assert not found.passed and told == [*found.checks] and len(told) == 1
    assert (told[0].name, told[0].passed, told[0].warning) == ("manifest", False, False)
    assert told[0].message == "a = 1 is wrong; b = 2 is wrong"


# Certificate

TAPE = tape_at(7, (6, 5))


def checked(content: object) -> Check:
    return check_certificate(WrittenFile(path="certificate.json", data=json.dumps(content).encode()), TAPE)


def places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Path of every value in a JSON document that holds no other."""
    if isinstance(value, dict | list):
        rows = value.items() if isinstance(value, dict) else enumerate(value)
        return [path for key, inner in rows for path in places(inner, (*at, key))]
    return [at]


def owner(content: Any, path: tuple[Any, ...]) -> Any:
    for key in path[:-1]:
        content = content[key]
    return content


def test_the_certificate_of_a_tape_passes_with_its_figures() -> None:
    found = checked(certify(TAPE).to_mapping())
    distance = certify(TAPE).of_side(4).distance
    assert found.passed and found.figure == distance
    assert found.message == f"as computed again: 6 windows of 4x4 differ by {distance} symbols or more"
    small = tape_at(7, (3, 3))
    file = WrittenFile(path="c", data=json.dumps(certify(small).to_mapping()).encode())
    none = check_certificate(file, small)
    assert none.passed and none.figure is None and none.message.endswith("the tape has no whole window of 4x4")


def test_no_value_of_a_certificate_may_be_another() -> None:
    right = certify(TAPE).to_mapping()
    assert len(places(right)) > 40
    for path in places(right):
        value = owner(right, path)[path[-1]]
        others = [None, f"{value}!", [value], not value] + ([value + 1, float(value)] if type(value) is int else [])
        for other in others:
            if type(other) is type(value) and other == value:
                continue
            wrong = deepcopy(right)
            owner(wrong, path)[path[-1]] = other
            assert not checked(wrong).passed, (path, other)


def test_keys_and_items_are_neither_missing_nor_added() -> None:
    right = certify(TAPE).to_mapping()
    for path in ((), ("windows", 0), ("smallest_contact",), ("windows", 0, "nearest", 0)):
        inner = owner(right, (*path, None))
        for key in inner:
            wrong = deepcopy(right)
            del owner(wrong, (*path, None))[key]
            name = ".".join([*map(str, path), key]).replace(".0", "[0]")
            assert checked(wrong).message.endswith(f"is not this tape's: '{name}' is missing")
        more = deepcopy(right)
        owner(more, (*path, None))["remark"] = 1
        assert checked(more).message.endswith("remark' does not belong there")
    for change in (list.pop, list.clear, lambda rows: rows.append(rows[0])):
        wrong = deepcopy(right)
        change(wrong["windows"])
        assert not checked(wrong).passed


@pytest.mark.parametrize(
    ("found", "expected", "said"),
    [
        ({"a": [1, 2]}, {"a": [1, 2]}, None),
        ({"a": [1, 3]}, {"a": [1, 2]}, "a[1] = 3, computed 2"),
        ({"a": {"b": 1}}, {"a": {"b": 2}}, "a.b = 1, computed 2"),
        ([1], [1, 2], "the content = [1], computed [1, 2]"),
        (True, 1, "the content = True, computed 1"),
        ([], {}, "the content = [], computed {}"),
        ({"b": 1, "c": 2}, {"b": 2, "a": 1}, "b = 1, computed 2"),
        ({"b": 2, "c": 2}, {"b": 2, "a": 1}, "'a' is missing"),
    ],
)
def test_the_first_difference_is_named(found: object, expected: object, said: str | None) -> None:
    assert difference(found, expected) == said


def test_what_is_no_json_is_no_certificate() -> None:
    found = check_certificate(WrittenFile(path="c.json", data=b"{"), TAPE)
    assert not found.passed and found.message.startswith("c.json cannot be read as JSON: ")
