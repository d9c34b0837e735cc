"""How much is tried: CI asks for all of it by TACTAPE_THOROUGH=1, and a run at a desk does with fewer examples of the same."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import pytest

THOROUGH = os.environ.get("TACTAPE_THOROUGH") == "1"
only_thorough = pytest.mark.skipif(not THOROUGH, reason="takes minutes; TACTAPE_THOROUGH=1 asks for it")


def some(many: int) -> int:
    """How many of so many examples are tried."""
    return many if THOROUGH else -(-many // 4)


def thorough(*values: Any) -> Any:
    """One set of parameters that only a thorough run tries."""
    return pytest.param(*values, marks=only_thorough)


def first(at_desk: int, cases: Sequence[Any]) -> list[Any]:
    """Cases (of `pytest.param`) of which a run at a desk tries only the first so many."""
    return [
        *cases[:at_desk],
        *(pytest.param(*case.values, marks=(*case.marks, only_thorough), id=case.id) for case in cases[at_desk:]),
    ]
