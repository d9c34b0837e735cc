"""Every fab profile of the package with all that it inherits, value by value.

A difference is a change of what fabs are asked for, in every profile that shows one. `pytest tests/golden --update-golden` writes
the files anew.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from tactape_fab.base.templates import profile_names
from tactape_fab.kit.profiles import load_fab
from tests.golden.test_order_notes import compare

FOLDER = Path(__file__).parent / "files" / "fabs"


def lines(values: Mapping[str, Any], where: str = "") -> Iterator[str]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from lines(value, f"{where}{key}.")
        else:
            yield f"{where}{key} = {json.dumps(value)}\n"


@pytest.mark.parametrize("name", profile_names("fabs"))
def test_every_value_of_a_profile_is_the_golden_one(name: str, request: pytest.FixtureRequest) -> None:
    compare(FOLDER / f"{name}.txt", "".join(lines(asdict(load_fab(name)))).encode(), request)
