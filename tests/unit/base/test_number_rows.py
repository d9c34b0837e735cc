"""Rows of numbers as text: the bytes that Python's own formatting writes, whatever the numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tactape_fab.base.number_rows import digits, number_rows
from tests.thorough import costly

COUNT = 250_000
RANDOM = np.random.default_rng(26)
HALVES = (2 * RANDOM.integers(-(10**9), 10**9, COUNT) + 1) / 2.0
EDGES = 10.0 ** np.arange(17) - np.array([[0.0], [0.5], [1.0], [1e-9]])


def by_python(template: str, *columns: npt.NDArray[Any]) -> bytes:
    values = [column.tolist() for some in columns for column in np.atleast_2d(some.T)]
    return "".join([template % row for row in zip(*values, strict=True)]).encode("ascii")


def beside(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Numbers with their neighbours below and above, and their opposites."""
    near = np.concatenate([np.nextafter(values, -np.inf), values, np.nextafter(values, np.inf)])
    return np.concatenate([near, -near])


@pytest.mark.parametrize("decimals", [0, 1, 2, 3, 4, 6, 9])
@pytest.mark.parametrize(
    "values",
    [
        pytest.param(RANDOM.uniform(-700.0, 700.0, COUNT), id="any"),
        pytest.param(RANDOM.integers(-(10**9), 10**9, COUNT) / 1e6, id="whole nanometres"),
        pytest.param(RANDOM.normal(size=COUNT) * 10.0 ** RANDOM.integers(-12, 22, COUNT), id="every size"),
        pytest.param(np.array([0.0, -0.0, -1e-9, 2.0**52, -(2.0**63), 1e300, np.inf, -np.inf, np.nan]), id="far out"),
        pytest.param(np.array([-0.0, 0.0, 1e-300, -5e-324]), id="nothing"),
    ],
)
def test_decimals_are_those_of_python(values: npt.NDArray[np.float64], decimals: int) -> None:
    template = f"x=%.{decimals}f;"
    assert number_rows(template, values) == by_python(template, values)


@costly
@pytest.mark.parametrize("decimals", [0, 1, 2, 3, 4, 6, 9])
def test_halves_of_the_last_decimal_and_their_neighbours_are_rounded_as_python_does(decimals: int) -> None:
    template = f"%.{decimals}f\n"
    for values in (beside(HALVES / 10.0**decimals), beside(EDGES.ravel() / 10.0**decimals)):
        assert number_rows(template, values) == by_python(template, values)


@pytest.mark.parametrize("most", [1, 10, 10_000, 10**8, 2**32, 2**62])
def test_whole_numbers_are_those_of_python(most: int) -> None:
    values = RANDOM.integers(-most, most, (COUNT, 2))
    assert number_rows("%d%%,%d\r\n", values) == by_python("%d%%,%d\r\n", values)
    edges = np.array([[e + d for d in (-1, 0, 1)] for e in (0, 10, 100, 1000, 9999, 10**4, 10**8, 2**32)])
    assert number_rows("<%d %d %d>", edges) == by_python("<%d %d %d>", edges)


@pytest.mark.parametrize("kind", ["f2", "f4", "i1", "u1", "i4", "u4", "u8"])
def test_numbers_of_every_type_are_those_of_python(kind: str) -> None:
    values = (RANDOM.normal(size=999) * 200.0).astype(kind) if kind[0] == "f" else np.arange(-128, 256).astype(kind)
    template = "%.6f\n" if kind[0] == "f" else "%d\n"
    assert number_rows(template, values) == by_python(template, values)


def test_columns_stand_beside_each_other() -> None:
    number, xy_mm = np.arange(1, 2000), RANDOM.uniform(-9.0, 99.0, (1999, 2))
    assert number_rows("R%d %.4f %.2f", number, xy_mm) == by_python("R%d %.4f %.2f", number, xy_mm)
    assert number_rows("R%d", number[:0]) == b""


def test_digits_have_one_width_where_it_is_given() -> None:
    assert digits(np.array([0, 7, 1234567]), 9).tobytes() == b"000000000000000007001234567"
