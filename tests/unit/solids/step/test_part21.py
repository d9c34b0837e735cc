"""STEP text: numbers, strings, and templates that are repeated in numpy."""

from __future__ import annotations

import re
from datetime import datetime, timezone

import numpy as np
import pytest

from tactape_fab.solids.step.part21 import (
    SCHEMA,
    TRAILER,
    Template,
    Writer,
    coloured,
    context,
    fill,
    first_name,
    header,
    index_of,
    names,
    product,
    real,
    reals,
    string,
    triple,
    wrapped_names,
)
from tests.part21 import StepFile

REAL = re.compile(r" *-?\d+\.\d*")
"""ISO 10303-21, 6.4.2: digits, a point, digits; blanks may stand before it."""


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0."),
        (-0.0, "0."),
        (1e-13, "0."),
        (-1e-13, "0."),
        (1.0, "1."),
        (-1.5, "-1.5"),
        (0.1 + 0.2, "0.3"),
        (1e-12, "0.000000000001"),
        (1e9, "1000000000."),
        (2 / 3, "0.666666666667"),
    ],
)
def test_a_number_has_a_point_and_no_exponent(value: float, text: str) -> None:
    assert real(value) == text


def test_three_numbers_stand_in_parentheses() -> None:
    assert triple(np.array([0.5, -1.0, 0.0])) == "(0.5,-1.,0.)"


@pytest.mark.parametrize(
    ("text", "literal"),
    [("plain", "'plain'"), ("", "''"), ("it's", "'it''s'"), ("a\\b", "'a\\\\b'"), ("µm", "'?m'")],
)
def test_strings_are_quoted(text: str, literal: str) -> None:
    assert string(text) == literal


@pytest.mark.parametrize("decimals", [3, 6, 9])
def test_columns_of_numbers_are_as_wide_and_as_exact_as_asked(decimals: int) -> None:
    values = np.array([[0.0, -0.0, 1.0], [-1.0, 9.9999999996, -123.4567891234], [1e-10, -1e-10, 1234.5]])
    texts = reals(values, decimals)
    assert texts.shape == values.shape
    assert {len(text) for text in texts.ravel().tolist()} == {texts.dtype.itemsize}
    for text, value in zip(texts.ravel().tolist(), values.ravel().tolist(), strict=True):
        written = text.decode("ascii")
        assert REAL.fullmatch(written)
        assert float(written) == float(f"{value:.{decimals}f}")
        assert not (float(written) == 0.0 and "-" in written)


def test_many_numbers_are_written_as_python_writes_them() -> None:
    values = np.random.default_rng(1).uniform(-200, 200, 20_000).round(9)
    assert [float(text) for text in reals(values).tolist()] == [float(f"{v:.9f}") for v in values.tolist()]
    assert reals(np.array([-0.5, 0.25]), 3).tolist() == [b"-0.500", b" 0.250"]
    assert reals(np.array([12.0, 0.25]), 3).tolist() == [b"12.000", b" 0.250"]
    assert reals(np.empty(0)).shape == (0,)


@pytest.mark.parametrize("single", [0, 9, 10, 99, 950, 12_345])
@pytest.mark.parametrize(("copies", "size"), [(0, 5), (1, 5), (7, 100), (20_000, 87)])
def test_the_copies_names_all_have_as_many_digits(single: int, copies: int, size: int) -> None:
    first = first_name(single, copies, size)
    assert first > single
    assert first == 10 ** (len(str(first)) - 1)
    assert len(str(first + max(copies * size - 1, 0))) == len(str(first))
    assert first == 10 or first / 10 <= single or first / 10 + copies * size > first


@pytest.mark.parametrize("count", [0, 1, 5, 2048, 2049, 5000])
def test_a_template_is_repeated_with_its_own_names_and_values(count: int) -> None:
    t = Template()
    point = t.add("CARTESIAN_POINT('',(<x>,1.,#9))")
    vertex = t.add(f"VERTEX_POINT('',{point})")
    assert (index_of(vertex), len(t)) == (1, 2)
    x = np.arange(count) / 8 - 3
    text = b"".join(fill(t, 100_000, count, {"x": reals(x, 3)})).decode("ascii")
    rows = re.findall(r"#(\d+)=(\w+)\('',(.*?)\);\n?", text)
    assert len(rows) == 2 * count
    assert [int(row[0]) for row in rows] == list(range(100_000, 100_000 + 2 * count))
    assert [float(row[2][1:].split(",")[0]) for row in rows[::2]] == x.tolist()
    assert [row[2] for row in rows[1::2]] == [f"#{100_000 + 2 * k}" for k in range(count)]


def test_lists_of_names() -> None:
    assert names(10, np.array([0, 3, 1])) == "#10,#13,#11"
    assert names(10, np.array([], dtype=np.int64)) == ""
    listed = wrapped_names(["#1", "", names(0, np.arange(30))])
    assert listed.replace(",\n", ",").split(",") == ["#1", *(f"#{i}" for i in range(30))]
    assert max(map(len, listed.split("\n"))) < 60
    for count in (0, 1, 11, 12, 13, 24, 25):
        lines = [names(0, np.arange(i, min(i + 12, count))) for i in range(0, count, 12)]
        assert wrapped_names([names(0, np.arange(count))]) == ",\n".join(lines)


def test_header_context_product_and_colour_are_whole() -> None:
    w = Writer()
    shared = context(w)
    solid = w.add("MANIFOLD_SOLID_BREP('',#1)")
    product(w, shared, "a 'b'")
    coloured(w, shared, solid, (0.25, 0.5, 1.0))
    data = header("it's", datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc)) + w.text() + TRAILER
    file = StepFile(data)
    assert "FILE_NAME('it''s','2026-01-02T03:04:05'" in file.header
    assert f"FILE_SCHEMA(('{SCHEMA}'))" in file.header
    assert len(file.entities) == w.next - 1
    assert file.of_kind("PRODUCT")[0][1].values[:2] == ["'a ''b'''"] * 2
    assert file.of_kind("COLOUR_RGB")[0][1].values[1:] == [0.25, 0.5, 1.0]
    units = [part for _, entity in file.of_kind("") for part in entity.values if part.kind == "SI_UNIT"]
    assert [unit.values for unit in units] == [[".MILLI.", ".METRE."], ["$", ".RADIAN."], ["$", ".STERADIAN."]]
