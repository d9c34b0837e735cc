"""Encoding the whole plane of the default code takes well under a second, with every code and wherever it lies."""

from __future__ import annotations

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tactape_fab.texture.code import CODE_NAMES, get_plane
from tactape_fab.texture.plane import encode
from tests.bench.measure import Timed, run, show

SIDE = 3375
MOST_MS = 500.0


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
