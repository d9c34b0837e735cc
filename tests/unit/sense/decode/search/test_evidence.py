"""Evidence of lines together, added by kernels in several orders, against plain sums."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.search.evidence import add_everywhere, add_lines, add_lines_at, columns_by_symbol

LINES, PLANE = 7, 60


@kernel(fastmath=True)
def everywhere(out: Any, most: Any, said: Any, count: int, phases: Any) -> None:
    add_everywhere(out, most, said, count, phases)


@kernel(fastmath=True)
def at_one_phase(out: Any, most: Any, said: Any, span: Any, phases: Any, start: int, phase: int, places: int) -> float:
    return float(add_lines_at(out, most, said, span, phases, start, phase, places))


@kernel(fastmath=True)
def some_phases(out: Any, said: Any, span: Any, phases: Any, start: int, phase: int) -> float:
    return float(add_lines(out, said, span, phases, start, phase))


@pytest.fixture(params=[16, 63])
def scene(request: pytest.FixtureRequest) -> tuple[Any, Any, Any]:
    """What lines say for each phase, twice over; phases of a plane; and by a plain sum, what all lines say at each start."""
    rng, length = np.random.default_rng(2), request.param
    said = np.zeros((LINES + 1, 2 * length), dtype=np.float32)
    said[:LINES] = np.tile(rng.normal(0.0, 3.0, (LINES, length)), 2)
    phases = rng.integers(0, length, PLANE)
    return said, phases, length


def plain(said: Any, phases: Any, length: int, span: tuple[int, int], start: int) -> Any:
    p = np.arange(length)
    return sum(said[k, (p + phases[start + k]) % length].astype(float) for k in range(*span))


@pytest.mark.parametrize("count", [1, 4, LINES])
def test_all_starts_are_added_up_to_where_a_line_would_lie_beyond(scene: tuple[Any, Any, Any], count: int) -> None:
    said, phases, length = scene
    out, most = np.full((PLANE, length), 99.0, dtype=np.float32), np.full(PLANE, 99.0, dtype=np.float32)
    everywhere(out, most, said, np.int64(count), phases)
    for start in range(PLANE - count + 1):
        assert out[start] == pytest.approx(plain(said, phases, length, (0, count), start), abs=1e-4)
        assert most[start] == out[start].max()
    assert (out[PLANE - count + 1 :] == 99.0).all() and (most[PLANE - count + 1 :] == 99.0).all()


@pytest.mark.parametrize("span", [(0, 1), (1, 5), (0, LINES)])
def test_lines_are_added_at_one_phase_and_at_some_that_pass_the_last(scene: tuple[Any, Any, Any], span: tuple[int, int]) -> None:
    said, phases, length = scene
    places, start, phase = 9, 30, length - 2
    wanted = np.array([plain(said, phases, length, span, start + j) for j in range(places)])
    out, most = np.full((places, length), 99.0, dtype=np.float32), np.empty(places)
    largest = at_one_phase(out, most, said, span, phases, start, phase, places)
    assert out[:, 0] == pytest.approx(wanted[:, phase], abs=1e-4) and (out[:, 1:] == 99.0).all()
    assert (most == out[:, 0]).all() and largest == out[:, 0].max()
    few = np.empty(5, dtype=np.float32)
    assert some_phases(few, said, span, phases, start, phase) == few.max()
    assert few == pytest.approx(wanted[0, (phase + np.arange(5)) % length], abs=1e-4)


def test_columns_of_a_turned_grid_are_the_texture_s_symbols() -> None:
    """The grid has its symbols clockwise from its first axis, a tape in the order N, W, E, S."""
    clockwise = "ESWN"
    for turn in range(4):
        assert [int(column) for column in columns_by_symbol(4)[turn]] == [(clockwise.index(s) + turn) % 4 for s in "NWES"]
    eight = "EeSsWwNn"
    for turn in range(4):
        assert [int(column) for column in columns_by_symbol(8)[turn]] == [(eight.index(s) + 2 * turn) % 8 for s in "NWESnwes"]
