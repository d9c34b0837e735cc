"""Untrusted values: every reader says in words what is wrong, collects all problems, and never raises."""

from __future__ import annotations

import math
from datetime import date
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactape_fab.base.fields import Fields, counted, named, shown, unknown_key

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.sampled_from([10**400, -(10**400)]) | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


def messages(table: Fields) -> list[str]:
    """What the problems say before their remedies, which all must have."""
    said = [problem.message.partition("; ") for problem in table.problems]
    assert all(remedy for _, _, remedy in said)
    return [message for message, _, _ in said]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (math.nan, "a = nan mm is not a finite number"),
        (math.inf, "a = inf mm is not a finite number"),
        (-math.inf, "a = -inf mm is not a finite number"),
        (10**400, "is not a finite number"),
        ("1.5", "a = '1.5' is not a number in mm"),
        (True, "a = True is not a number in mm"),
        (None, "a = None is not a number in mm"),
        ([1.0], "a = [1.0] is not a number in mm"),
        (-1, "a = -1 mm is below 0 mm"),
        (11.0, "a = 11 mm exceeds 10 mm"),
    ],
)
def test_numbers_that_are_refused(value: Any, message: str) -> None:
    table = Fields({"a": value})
    assert math.isnan(table.number("a", low=0.0, high=10.0, remedy="use less"))
    assert len(table.problems) == 1
    assert table.problems[0].key == "a"
    assert message in table.problems[0].message
    assert table.problems[0].message.endswith("; use less")


@pytest.mark.parametrize(("value", "message"), [(0.0, "a = 0 deg is not above 0 deg"), (5.0, "a = 5 deg is not below 5 deg")])
def test_open_bounds(value: float, message: str) -> None:
    table = Fields({"a": value})
    table.number("a", above=0.0, below=5.0, unit="deg")
    assert messages(table) == [message]
    assert table.problems[0].message.endswith("; give a number above 0 and below 5 deg")


@pytest.mark.parametrize("value", [0.0, 10.0, 3, 3.5])
def test_numbers_within_closed_bounds(value: float) -> None:
    table = Fields({"a": value})
    assert table.number("a", low=0.0, high=10.0) == value
    assert not table.problems


@pytest.mark.parametrize("value", ["ab", 3.0, None, [1.0], [1.0, 2.0, 3.0], {"x": 1.0, "y": 2.0}])
def test_a_pair_that_is_none(value: Any) -> None:
    table = Fields({"a": value})
    assert table.numbers("a", 2, default=(1.0, 2.0)) == (1.0, 2.0)
    assert len(table.problems) == 1
    assert "is not 2 numbers" in messages(table)[0]


def test_each_item_of_a_pair_is_named() -> None:
    table = Fields({"a": [math.nan, -1.0]})
    table.numbers("a", 2, low=0.0)
    assert [p.key for p in table.problems] == ["a[0]", "a[1]"]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (2.0, "a = 2.0 is not a whole number, as it is written with a point or an exponent"),
        (2.5, "a = 2.5 is not a whole number"),
        (True, "a = True is not a whole number"),
        ("2", "a = '2' is not a whole number"),
        (-1, "a = -1 is outside 0 to 9"),
        (10, "a = 10 is outside 0 to 9"),
    ],
)
def test_whole_numbers_that_are_refused(value: Any, message: str) -> None:
    table = Fields({"a": value})
    assert table.integer("a", low=0, high=9, default=4) == 4
    assert messages(table) == [message]


@pytest.mark.parametrize("value", [10**5000, -(10**5000)], ids=["huge", "minus-huge"])
def test_numbers_too_long_to_print_are_refused_like_any_other(value: int) -> None:
    table = Fields({"a": value, "b": [value, 1]})
    table.integer("a", low=0, high=9)
    table.number("a")
    table.text("a")
    table.integers("b", 2, low=0, high=9)
    table.numbers("b", 2)
    assert [p.key for p in table.problems] == ["a", "a", "a", "b[0]", "b[0]"]
    assert all(len(m) < 150 for m in messages(table))


def test_text_choices_patterns_and_lengths() -> None:
    table = Fields({"a": "blue", "b": 5, "c": "x y", "d": "long"})
    assert table.text("a", choices=("red", "green"), default="red") == "red"
    table.text("b")
    table.text("c", pattern=r"[a-z]+", remedy="use letters")
    table.text("d", longest=3)
    assert messages(table) == [
        "a = 'blue' is none of: red, green",
        "b = 5 is not a text",
        "c = 'x y' has a form that cannot be used",
        "d = 'long' has 4 characters",
    ]


@pytest.mark.parametrize("value", [0, 1, "true", None, []])
def test_flags_are_true_or_false(value: Any) -> None:
    table = Fields({"a": value})
    assert table.flag("a") is False
    assert messages(table) == [f"a = {value!r} is neither true nor false"]


def test_missing_keys_say_what_to_give() -> None:
    table = Fields({})
    table.number("a")
    table.numbers("b", 2)
    table.integer("c", low=0, high=9)
    table.integers("d", 2, low=0, high=9)
    table.text("e", choices=("x", "y"))
    table.rows("f", longest=3)
    table.table("g")
    table.flag("h")
    assert [p.key for p in table.problems] == list("abcdefgh")
    assert table.problems[0].message == "a is missing; give a number in mm"
    assert table.problems[4].message == "e is missing; give one of x, y"
    assert messages(table) == [f"{key} is missing" for key in "abcdefgh"]


def test_nested_tables_share_problems_and_name_the_way() -> None:
    table = Fields({"board": {"size": {"x": -1.0}}})
    table.table("board").table("size").number("x", low=0.0)
    assert [p.key for p in table.problems] == ["board.size.x"]
    assert messages(table) == ["board.size.x = -1 mm is below 0 mm"]


@pytest.mark.parametrize("value", [[], 5, "text", None])
def test_a_table_that_is_none(value: Any) -> None:
    table = Fields({"a": value})
    table.table("a")
    assert messages(table) == [f"a = {value!r} is not a table"]


def test_a_table_that_several_readers_miss_is_one_problem() -> None:
    table = Fields({"a": {}})
    for _ in range(2):
        table.table("b")
        table.table("a").table("b")
    assert [p.key for p in table.problems] == ["b", "a.b"]


def test_lists_have_a_length_limit() -> None:
    table = Fields({"a": [1, 2, 3], "b": "abc"})
    assert table.rows("a", longest=3) == [1, 2, 3]
    assert table.rows("a", longest=2) == ()
    assert table.rows("b", longest=9) == ()
    assert messages(table) == ["a has 3 entries, more than 2", "b = 'abc' is not a list"]


def test_unknown_keys_get_the_nearest_known_one() -> None:
    assert unknown_key("secter", ["sector", "size"]).message == "secter is not a known key; did you mean 'sector'?"
    assert unknown_key("q", ["sector", "size"]).message == "q is not a known key; known are: sector, size"


def test_shown_values_stay_on_one_short_line() -> None:
    assert shown("a\nb") == "'a\\nb'"
    assert shown(date(2026, 11, 20)) == "2026-11-20"  # of TOML, without quotes
    assert len(shown("x" * 10_000)) <= 60
    assert len(shown(list(range(10_000)))) <= 60
    deep: list[Any] = []
    for _ in range(100_000):  # as a key of many parts; Python 3.12 and 3.13 show ten thousand
        deep = [deep]
    assert shown(deep) == "<list too long to show>"


@settings(deadline=None, derandomize=True, max_examples=300)
@given(value=JSON)
def test_no_value_makes_a_reader_raise_and_what_it_accepts_is_in_bounds(value: Any) -> None:
    def read(name: str, *args: Any, **bounds: Any) -> Any:
        table = Fields({"a": value})
        result = getattr(table, name)("a", *args, **bounds)
        return None if table.problems else result

    number = read("number", low=-5.0, below=5.0)
    assert number is None or -5.0 <= number < 5.0
    pair = read("numbers", 2, above=0.0, high=9.0)
    assert pair is None or (len(pair) == 2 and all(0.0 < v <= 9.0 for v in pair))
    whole = read("integer", low=-3, high=3)
    assert whole is None or whole in range(-3, 4)
    wholes = read("integers", 2, low=-3, high=3)
    assert wholes is None or (len(wholes) == 2 and all(v in range(-3, 4) for v in wholes))
    assert read("text", pattern=r"[a-z]{1,3}") in (None, value)
    assert read("flag") in (None, True, False)
    table = Fields({"a": value})
    table.table("a").rows("b", longest=2)
    assert all(p.key in ("a", "a.b") for p in table.problems)


def test_of_many_unknown_keys_the_first_are_named_and_the_rest_counted() -> None:
    table = Fields({f"key_{k}": 0 for k in range(60_000)}, "spec: ")
    table.refuse_unknown(["size_mm", "sector"])
    assert len(table.problems) == 21
    assert table.problems[-1].message == "spec: 59980 more keys are not known; known are: size_mm, sector"


def test_a_few_names_stand_for_many() -> None:
    assert named(list("ab")) == "a, b" and named(list("abcde")) == "a, b, c, d, e"
    assert named(list("abcdefg")) == "a, b, c, d, e and 2 more"
    assert named(list("abc"), 2) == "a, b and 1 more"


def test_what_is_counted_is_one_or_many() -> None:
    assert [counted(number, "body", "bodies") for number in (0, 1, "1", 2, "no")] == [
        *("0 bodies", "1 body", "1 body", "2 bodies", "no bodies"),
    ]
