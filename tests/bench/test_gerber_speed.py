"""One copper layer: faster than two Gerber libraries that write the same pads, small in memory, linear in cost.

Every figure of a comparison is taken in one process, in turns. Ours goes from the layout's arrays to the file's bytes
and names component and pin of every pad; a peer goes from the same arrays through its own objects to bytes, without.
"""

from __future__ import annotations

import gc
import sys
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.film.drawing import tape_drawing
from tactape_fab.kit.film.layout import build_layout
from tactape_fab.kit.plan import plan
from tactape_fab.kit.profiles import load_part
from tactape_fab.kit.render.gerber import render_copper
from tests.bench.gerber_peers import PEERS, flashes_mm
from tests.bench.measure import Timed, large_spec, peak_memory_mb, run, show

PARTS = 50_000
LEAST_RATIO = 10.0
MOST_MEMORY_MB = 300.0
SIZES = (2_000, 10_000, 50_000, 200_000)
REFERENCE_SIZE = 10_000
MOST_GROWTH = 2.0
PLACE_TOLERANCE_MM = 1e-5
ROOT = Path(__file__).parents[2]
RENDER_IN_A_PROCESS = f"""
from tactape_fab.kit.render.gerber import render_copper
from tactape_fab.make.kit import examine
from tests.bench.measure import large_spec
examined = examine(large_spec({PARTS}))
assert len(examined.layout.pads.xy_mm) >= {2 * PARTS}
render_copper(examined.drawing, examined.fab)
"""


@pytest.fixture(scope="module")
def large() -> Examined:
    return examine(large_spec(PARTS))


def test_copper_is_ten_times_faster_than_gerber_writer_and_gerbonara(benchmark: BenchmarkFixture, large: Examined) -> None:
    layout, fab, spec = large.layout, large.fab, large.spec
    part = load_part(spec.part)
    peers = {name: Timed(write) for name, write in PEERS.items()}
    copper = Timed(lambda: render_copper(tape_drawing(layout), fab))
    from_spec = Timed(lambda: render_copper(tape_drawing(build_layout(plan(spec, fab, part), spec, fab, part)), fab))
    written: dict[str, bytes] = {}
    turns = cycle(PEERS)

    def others() -> None:
        name = next(turns)
        gc.collect()
        written[name] = peers[name](layout)
        gc.collect()
        from_spec()

    (artifact,) = run(benchmark, copper, rounds=2 * len(PEERS), before=others)

    for gerber in (artifact.data, *written.values()):
        np.testing.assert_allclose(flashes_mm(gerber), layout.pads.xy_mm, atol=PLACE_TOLERANCE_MM)
    our_s = min(copper.seconds)
    show(f"copper layer of {layout.tape.part_count} parts, tactape-fab", our_s * 1000, "ms")
    show("copper layer with plan and layout, tactape-fab", min(from_spec.seconds) * 1000, "ms")
    for name, peer in peers.items():
        show(f"copper layer, {name}", min(peer.seconds) * 1000, "ms")
        show(f"copper layer, {name} / tactape-fab", min(peer.seconds) / our_s, "times", f">= {LEAST_RATIO:g}")
        show(f"copper layer, {name} / tactape-fab with plan and layout", min(peer.seconds) / min(from_spec.seconds), "times")
    assert min(min(peer.seconds) for peer in peers.values()) >= LEAST_RATIO * our_s


def test_copper_needs_little_memory(benchmark: BenchmarkFixture) -> None:
    process = [sys.executable, "-c", RENDER_IN_A_PROCESS]
    peak_mb = run(benchmark, lambda: peak_memory_mb(process, ROOT), rounds=1)
    show(f"copper layer of {PARTS} parts, peak memory of the process", peak_mb, "MB", f"< {MOST_MEMORY_MB:g}")
    assert peak_mb < MOST_MEMORY_MB


def test_cost_of_copper_is_linear(benchmark: BenchmarkFixture) -> None:
    tapes = {size: examine(large_spec(size)) for size in SIZES}
    render = {size: Timed(render_copper) for size in SIZES}

    def copper_of(size: int) -> None:
        render[size](tapes[size].drawing, tapes[size].fab)

    def smaller_ones() -> None:
        for size in SIZES[:-1]:
            copper_of(size)
            copper_of(size)

    run(benchmark, lambda: copper_of(SIZES[-1]), rounds=8, before=smaller_ones)

    parts = {size: tapes[size].layout.tape.part_count for size in SIZES}
    per_part_us = {size: min(render[size].seconds) / parts[size] * 1e6 for size in SIZES}
    print("\n   parts        ms  us per part")
    for size in SIZES:
        print(f"{parts[size]:8d}  {min(render[size].seconds) * 1000:8.2f}  {per_part_us[size]:11.3f}")
    ratio = {size: per_part_us[size] / per_part_us[REFERENCE_SIZE] for size in SIZES}
    for size in SIZES:
        show(f"copper layer, time of a part at {size} / at {REFERENCE_SIZE}", ratio[size], "times", f"<= {MOST_GROWTH:g}")
    assert max(ratio.values()) <= MOST_GROWTH
