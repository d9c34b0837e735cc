"""How much is tried: TACTAPE_THOROUGH=1 asks for all of it, and a run at a desk does with fewer examples of the same.

`.ci/run` asks for all examples of what a desk tries, and by TACTAPE_PART for one tenth of the further cases, its commit's.
"""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from zlib import crc32

import pytest

from tactape_fab.kit.render import preview, solid_preview
from tactape_fab.verify.trip import round_trip

THOROUGH = os.environ.get("TACTAPE_THOROUGH") == "1"
only_thorough = pytest.mark.skipif(not THOROUGH, reason="takes minutes; TACTAPE_THOROUGH=1 asks for it")
PART = os.environ.get("TACTAPE_PART", "")
"""Which part of the cases that a desk leaves out a thorough run of whole folders tries, such as 0/3; empty for all of them."""

AT_DESK = 2
"""Cases of one test that a run of whole folders tries at a desk: first and last. Of one that is `costly`, of whole kits, or with
an outside reader the first."""
costly = pytest.mark.costly
"""A test of which each case takes more than half a second."""
slow = pytest.mark.slow
"""A test of two seconds or so, whose subject quicker ones have too: a run of whole folders at a desk leaves it out."""
_ONE_OF = ("tests/readers/", "tests/roundtrip/")


_LESS: tuple[tuple[Any, str, float], ...] = (
    (round_trip, "QUICK", 2),
    (preview, "PX_PER_MM", 4.0),
    (solid_preview, "WIDTH_PX", 200),
    (solid_preview, "CYLINDER_WIDTH_PX", 150),
)
_ELSEWHERE = tuple((module, name, getattr(module, name)) for module, name, _ in _LESS)


@contextmanager
def with_less() -> Iterator[None]:
    """Kits with small pictures, whose quick verification decodes two contacts of each file in place of six.

    Both take more than half of the time of a small kit, and most tests look at neither.
    """
    with pytest.MonkeyPatch.context() as patch:
        for module, name, value in _LESS:
            patch.setattr(module, name, value)
        yield


@contextmanager
def as_elsewhere() -> Iterator[None]:
    """Kits as everybody makes them: where they are compared with those of other processes."""
    with pytest.MonkeyPatch.context() as patch:
        for module, name, value in _ELSEWHERE:
            patch.setattr(module, name, value)
        yield


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


def spread(items: Sequence[pytest.Item]) -> list[pytest.Item]:
    """Of each test that would run, the cases that a run at a desk tries; the others stay as they are."""
    cases: dict[str, list[pytest.Item]] = defaultdict(list)
    left: set[pytest.Item] = set()
    for item in items:
        if not any(mark.args and mark.args[0] for mark in item.iter_markers("skipif")):
            cases[item.nodeid.partition("[")[0]].append(item)
    for test, found in cases.items():
        if found[0].get_closest_marker("slow") is not None:
            left |= set(found)
        one = test.startswith(_ONE_OF) or found[0].get_closest_marker("costly") is not None
        left |= set(found[1:] if one else found[1:-1])
    return [item for item in items if item not in left]


def part_of(items: Sequence[pytest.Item], part: str) -> list[pytest.Item]:
    """What a desk tries, and one part of the further cases: of each test every so many, so that all parts together are all.

    part: Its number from 0, and how many there are, such as 0/3.
    """
    match = re.fullmatch(r"(\d+)/([1-9]\d*)", part)
    if match is None:
        raise pytest.UsageError(f"TACTAPE_PART = {part!r} is no part; give its number from 0, a slash and how many, such as 0/3")
    number, parts = map(int, match.groups())
    further = {i for i in items if i.nodeid.startswith("tests/bench/") or only_thorough.mark in i.iter_markers("skipif")}
    at_desk = set(spread([item for item in items if item not in further]))
    seen: dict[str, int] = defaultdict(int)
    left: set[pytest.Item] = set()
    for item in items:
        if item not in at_desk:
            test = item.nodeid.partition("[")[0]
            if (seen[test] + crc32(test.encode())) % parts != number:
                left.add(item)
            seen[test] += 1
    return [item for item in items if item not in left]
