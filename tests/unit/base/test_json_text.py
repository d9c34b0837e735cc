"""Untrusted JSON: what is no JSON, is said twice, or is too much is refused."""

from __future__ import annotations

import pytest

from tactape_fab.base.json_text import parse_json


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (b'{"a": NaN}', "NaN"),
        (b"[-Infinity]", "Infinity"),
        (b'{"a": 1, "a": 2}', "twice"),
        (b'[{"b": {"a": 1, "a": 1}}]', "twice"),
        (b"[" * 100_000, "deep"),
        (b"[" + b"[]," * 20 + b"[]]", "more than 30 values"),
        (b"9" * 5000, "value has 5000 digits$"),
        (b"{", "Expecting"),
        (b"\xff", "decode"),
    ],
)
def test_what_is_no_plain_json_is_refused(text: bytes, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        parse_json(text, most_values=30 if len(text) < 1000 else 10**6)


def test_values_are_read_as_they_are() -> None:
    assert parse_json(b'{"a": [1, 2.5, "x", null], "b": {}}') == {"a": [1, 2.5, "x", None], "b": {}}
