"""Encoding the whole plane of the default code takes well under a second, with every code and wherever it lies."""

from __future__ import annotations

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tactape_fab.texture.code import CODE_NAMES, get_plane
from tactape_fab.texture.plane import encode
from tests.bench.measure import Timed, run, show

SIDE = 3375
MOST_MS = 500.0
SMALL_SIDE, SMALL_MS = 600, 5.0
"""Points along a side, and what that many are to take on a quiet machine; ten times as much fails."""


@pytest.mark.parametrize("name", CODE_NAMES)
def test_plane_is_encoded_in_well_under_a_second(benchmark: BenchmarkFixture, name: str) -> None:
    code = get_plane(name)
    side = min(SIDE, code.range)
    far = code.range - side
    timed = Timed(lambda: encode(code, code.sectors - 1, (far, far), (side, side)))
    symbols = run(benchmark, timed, rounds=5)
    assert symbols.shape == (side, side)
    best_ms = min(timed.seconds) * 1000
    show(f"encode {side} x {side} of {name}, best of 5", best_ms, "ms", f"< {MOST_MS:g}")
    assert best_ms < MOST_MS


@pytest.mark.parametrize("name", CODE_NAMES)
def test_a_tape_is_encoded_in_milliseconds(benchmark: BenchmarkFixture, name: str) -> None:
    """Of a code with smaller sectors as many sectors as have that many points."""
    code = get_plane(name)
    side = min(SMALL_SIDE, code.range)
    timed = Timed(lambda: encode(code, code.sectors - 1, (0, 0), (side, side)))
    run(benchmark, timed, rounds=9)
    best_ms = min(timed.seconds) * 1000 * (SMALL_SIDE / side) ** 2
    show(f"encode {SMALL_SIDE} x {SMALL_SIDE} of {name}, best of 9", best_ms, "ms", f"< {SMALL_MS:g}")
    assert best_ms < 10 * SMALL_MS
