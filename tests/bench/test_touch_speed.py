"""What a touch tape costs: its design, and how long one, and 64 of them, take to decode a contact beside microdots-4x4.

Seconds of the processor, which do not count what else a machine does.
"""

from __future__ import annotations

from time import process_time

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tactape_fab.texture.touch import design as touch
from tactape_fab.texture.touch.design import design
from tactape_fab.texture.touch.patches import PATCHES, patch_distances
from tests.bench.measure import run, show
from tests.bench.touch import speeds

GRID = (32, 62)
SECTORS = (7, 8, 9)


@pytest.mark.parametrize(
    ("least", "rungs", "most_s"),
    [((1, 3, 5, 8), touch.ALONE[:-1], 2.0), ((2, 3, 5, 8, 11), touch.ALONE, 30.0)],
    ids=["all but the last rung", "all rungs"],
)
def test_a_design(
    benchmark: BenchmarkFixture,
    monkeypatch: pytest.MonkeyPatch,
    least: tuple[int, ...],
    rungs: tuple[touch.Bits, ...],
    most_s: float,
) -> None:
    """Of a tape of 62 x 32, compiled functions loaded: the distances that it reaches, and how long that takes."""
    design(0, (8, 8))
    monkeypatch.setattr(touch, "ALONE", rungs)

    def designed() -> list[float]:
        seconds = []
        for sector in SECTORS:
            touch._designed.cache_clear()
            start = process_time()
            symbols = design(sector, GRID)
            seconds.append(process_time() - start)
            reached = [found.bits for found in patch_distances(symbols, np.ones(GRID, dtype=bool))]
            assert all(bits is not None and bits >= asked for bits, asked in zip(reached, least, strict=False))
        touch._designed.cache_clear()
        return seconds

    seconds = run(benchmark, designed, rounds=1)
    wanted = ", ".join(f"{shape} {bits}" for shape, bits in zip(PATCHES, least, strict=False))
    show(f"design of a tape of 62 x 32 with {wanted} bits, longest of {len(seconds)}", max(seconds), "s", f"<= {most_s:g}")
    assert max(seconds) <= most_s


def test_decoding(benchmark: BenchmarkFixture) -> None:
    found = run(benchmark, lambda: speeds(None), rounds=1)
    for name, milliseconds in found.items():
        show(f"a contact of 11x9 mm, registered {name}", milliseconds, "ms", "<= 3" if name.endswith("64") else "")
    ratio = found["touch-1, 1"] / found["microdots-4x4, 1"]
    show("one touch tape beside one of microdots-4x4", ratio, "times", "<= 1.5")
    assert found["touch-1, 64"] <= 3.0
    assert ratio <= 1.5
