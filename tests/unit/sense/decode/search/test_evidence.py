"""Evidence of lines together, added by kernels in several orders, against plain sums."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.search.evidence import (
    add_everywhere,
    add_lines,
    add_lines_at,
    columns_by_symbol,
    fill_range,
    signs_of,
    tables_of,
)
from tactape_fab.texture.code import get_code
from tactape_fab.texture.directions import DIRECTIONS

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


@kernel(fastmath=True)
def ranged(out: Any, lines: Any, low: int, high: int, count: int) -> None:
    fill_range(out, lines, (low, high), count)


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


def test_the_largest_of_all_phases_is_found_wherever_it_is(scene: tuple[Any, Any, Any]) -> None:
    """From each phase on in turn, so that the largest comes at each place."""
    said, phases, length = scene
    wanted, out = plain(said, phases, length, (0, LINES), 3), np.empty(length, dtype=np.float32)
    for phase in range(length):
        assert some_phases(out, said, (0, LINES), phases, 3, phase) == pytest.approx(wanted.max(), abs=1e-4)
        assert out == pytest.approx(np.roll(wanted, -phase), abs=1e-4)


def test_a_range_of_dots_is_the_difference_of_those_below() -> None:
    """Of three lines the first two; the last row is the caller's."""
    lines = np.random.default_rng(3).normal(size=(4, 3, 10)).astype(np.float32)
    out = np.full((4, 10), 99.0, dtype=np.float32)
    ranged(out, lines, np.int64(1), np.int64(3), np.int64(2))
    assert out[:2] == pytest.approx(lines[3, :2] - lines[1, :2]) and (out[2:] == 99.0).all()


def test_columns_of_a_turned_grid_are_the_texture_s_symbols() -> None:
    """The grid has its symbols clockwise from its first axis, a tape in the order N, W, E, S."""
    clockwise = "ESWN"
    for turn in range(4):
        assert [int(column) for column in columns_by_symbol(4)[turn]] == [(clockwise.index(s) + turn) % 4 for s in "NWES"]
    eight = "EeSsWwNn"
    for turn in range(4):
        assert [int(column) for column in columns_by_symbol(8)[turn]] == [(eight.index(s) + 2 * turn) % 8 for s in "NWESnwes"]


# Tables


def dots_of(directions: int) -> tuple[Any, Any]:
    rng = np.random.default_rng(directions)
    box = np.array([(k, j) for k in range(5) for j in range(4)])
    nodes = box[np.sort(rng.choice(20, 13, replace=False))] + np.array([3, -8])
    return nodes, rng.dirichlet(np.full(directions, 0.4), 13)


@pytest.mark.parametrize("directions", [4, 8])
def test_tables_hold_what_dots_say_of_each_bit(directions: int) -> None:
    """Bit by bit: ln of twice the probability, for a 1 and for a 0."""
    nodes, q = dots_of(directions)
    found = tables_of(nodes, q, np.empty(0, dtype=np.float32), 24)
    assert found.evidence.shape == (4, len(q), 3 if directions == 4 else 4)
    around = np.array([2, 3, 1, 0]) if directions == 4 else DIRECTIONS[8].gray_codes[DIRECTIONS[8].clockwise].astype(int)
    k, j = nodes.T
    for turn, at in enumerate(((k, j), (j, -k), (-k, -j), (-j, k))):
        cells = np.stack(at, axis=1)
        assert np.array_equal(found.corner[turn], cells.min(axis=0))
        assert np.array_equal(found.cells[turn], cells - cells.min(axis=0))
        assert np.array_equal(found.size[turn], np.ptp(cells, axis=0) + 1)
        shares, each = np.roll(q, -turn * directions // 4, axis=1), []
        for bit in range(2 if directions == 4 else 3):
            one = shares[:, around >> bit & 1 == 1].sum(axis=1)
            each.append((np.log(2.0 * one), np.log(2.0 * (1.0 - one))))
        mean = sum((one + zero) / 2.0 for one, zero in each)
        assert found.evidence[turn, :, 0] == pytest.approx(mean)
        for bit, (one, zero) in enumerate(each):
            assert found.evidence[turn, :, 1 + bit] == pytest.approx((one - zero) / 2.0)
        # a table of sums: of columns below c and rows below r; a third bit counts with the y bit
        best = [np.maximum(one, zero) - (one + zero) / 2.0 for one, zero in each]
        most = mean / 2.0 + best[0], mean / 2.0 + sum(best[1:])
        for c, r in np.ndindex(found.dots.shape[1:]):
            below = (found.cells[turn] < (c, r)).all(axis=1)
            assert found.dots[turn, c, r] == below.sum()
            assert found.most[turn, :, c, r] == pytest.approx([of[below].sum() for of in most])


def test_lines_of_a_plane_hold_the_evidence_of_each_phase() -> None:
    nodes, q = dots_of(4)
    code = get_code("microdots-4x4").sequences
    assert code is not None
    bits, length = 2.0 * np.array(code.main.digits) - 1.0, code.main.length
    found = tables_of(nodes, q, signs_of(code), 24)
    m = found.dots.shape[1] - 1
    assert found.lines.shape == (4, 2, m + 1, m, 2 * length) and m == 5
    for turn, axis, below, line in np.ndindex(found.lines.shape[:4]):
        cells, evidence = found.cells[turn], found.evidence[turn]
        dots = np.flatnonzero((cells[:, axis] == line) & (cells[:, 1 - axis] < below))
        expected = np.zeros(2 * length)
        for i in dots:
            expected += evidence[i, 0] / 2.0 + evidence[i, 1 + axis] * bits[(np.arange(2 * length) + cells[i, 1 - axis]) % length]
        assert found.lines[turn, axis, below, line] == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(("most", "size"), [(5, 5), (4, 0)])
def test_dots_that_reach_farther_than_a_contact_get_no_tables(most: int, size: int) -> None:
    nodes, q = dots_of(4)
    found = tables_of(nodes, q, np.empty(0, dtype=np.float32), most)
    assert found.dots.shape == (4, size + 1, size + 1) and found.size.max() == 5
    assert found.lines.shape == (4, 2, size + 1, size, 0)
