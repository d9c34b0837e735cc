"""Reader of untrusted JSON: a bounded number of values, unique keys, no NaN."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

from tactape_fab.base.errors import reason_of
from tactape_fab.base.fields import shown

MOST_VALUES = 2_000_000
"""Most values, keys and brackets of one text: as Python objects they take some 200 MB."""


def parse_json(data: bytes, *, most_values: int = MOST_VALUES) -> Any:
    """Parse a JSON text.

    most_values: Largest number of commas, colons and opening brackets, which bounds the number of objects.
    Raises ValueError if it is not JSON, nested too deep, holds NaN or Infinity, a key twice in one object, or too many values.
    """
    marks = sum(data.count(mark) for mark in (b",", b":", b"[", b"{"))
    if marks > most_values:
        raise ValueError(f"it holds more than {most_values} values")
    try:
        return json.loads(data, parse_constant=_refuse_constant, object_pairs_hook=_each_key_once)
    except (ValueError, RecursionError) as error:
        raise ValueError(reason_of(error)) from error


def _refuse_constant(name: str) -> Any:
    """Refuse NaN and Infinity, which Python reads although JSON does not have them."""
    raise ValueError(f"{name} is no JSON")


def _each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; a repeated key is refused, as readers differ in which value they take."""
    content = dict(pairs)
    if len(content) < len(pairs):
        twice, _ = Counter(key for key, _ in pairs).most_common(1)[0]
        raise ValueError(f"the key {shown(twice)} stands twice in one object")
    return content
