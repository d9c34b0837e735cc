"""Values of another type or shape: one refusal that says what to give."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.base.given_value import as_numbers, as_real, refuse_other


@pytest.mark.parametrize("value", [[[1, 2], [3, 4]], np.array([[1.0, 2.0], [3.0, 4.0]], dtype=">f4"), ((1, 2.0), (3, 4))])
def test_numbers_of_any_kind_become_doubles(value: Any) -> None:
    assert as_numbers(value, (None, 2), "xy", "points").tolist() == [[1.0, 2.0], [3.0, 4.0]]


@pytest.mark.parametrize(
    "value", [None, "12", [1, "2"], [[1, 2], [3]], {}, object(), [True, False], [1j, 2j], 10**400, [10**400, 1]]
)
def test_what_is_no_array_of_numbers_is_refused(value: Any) -> None:
    with pytest.raises(SpecError, match=r"^xy = .* is no array of numbers; give points$"):
        as_numbers(value, (2,), "xy", "points")


@pytest.mark.parametrize("value", [3.0, [1.0], [1.0, 2.0, 3.0], [[1.0, 2.0]], []])
def test_another_shape_is_named(value: Any) -> None:
    with pytest.raises(SpecError, match=r"^xy has the shape \(.*\); give points$"):
        as_numbers(value, (2,), "xy", "points")


def test_what_is_not_finite_is_refused_unless_it_may_be() -> None:
    with pytest.raises(SpecError, match=r"^xy has a value that is not finite; give points$"):
        as_numbers([np.nan, 1.0], (2,), "xy", "points")
    assert np.isnan(as_numbers([np.nan, 1.0], (2,), "xy", "points", finite=False)[0])


def test_what_is_masked_is_not_known() -> None:
    masked = np.ma.array([1.0, 2.0], mask=[True, False])
    with pytest.raises(SpecError, match=r"^xy has a value that is not finite; give points$"):
        as_numbers(masked, (2,), "xy", "points")
    np.testing.assert_array_equal(as_numbers(masked, (2,), "xy", "points", finite=False), [np.nan, 2.0])
    assert as_numbers(np.ma.array([1, 2]), (2,), "xy", "points").tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("value", "read"),
    [
        (2.5, 2.5),
        (2**60 + 1, 2**60 + 1),
        (np.int64(2**60 + 1), 2**60 + 1),
        (np.float32(0.5), 0.5),
        (np.longdouble(0.5), 0.5),
        (np.float64(0.5), 0.5),
        (Fraction(1, 4), 0.25),
    ],
)
def test_a_real_number_becomes_pythons_own(value: Any, read: float) -> None:
    found = as_real(value, "t", "time", "seconds")
    assert found == read and type(found) is type(read)


@pytest.mark.parametrize("value", [True, np.True_, "1", None, 1j, np.zeros(1)])
def test_what_is_no_real_number_is_refused(value: Any) -> None:
    with pytest.raises(SpecError, match=r"^t = .* is no time; give seconds$"):
        as_real(value, "t", "time", "seconds")
    with pytest.raises(SpecError, match=r"^t = Fraction\(1000.* is beyond any float; give seconds$"):
        as_real(Fraction(10**400), "t", "time", "seconds")


def test_another_type_is_named_with_what_to_give() -> None:
    refuse_other("a", (str, type(None)), "name", "text", "a text")
    with pytest.raises(SpecError, match=r"^name = 3 is no text; give a text$") as caught:
        refuse_other(3, str, "name", "text", "a text")
    assert [problem.key for problem in caught.value.problems] == ["name"]
