"""Bounds of lines together: never less than the lines say in any sector, and no more where one run has them all."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.search import bounds
from tactape_fab.sense.decode.search.bounds import NEVER
from tactape_fab.sense.decode.search.evidence import add_lines, fill_range
from tactape_fab.sense.decode.search.plane_sites import Starts, _starts
from tactape_fab.texture.code import CODES, get_code
from tactape_fab.texture.frames import FloatArray, IntArray

MOST_LINES, PLANE = 8, 90
ROUNDING = 1e-4


@kernel()
def runs_at(lines: int, way: int) -> tuple[int, int, int]:
    return bounds.runs_of(lines, way)  # type: ignore[no-any-return]


@kernel(fastmath=True)
def bounds_at_once(out: Any, known: Any, lines: Any, dots: Any, steps: Any, span: Any, way: int) -> None:
    slot = bounds.slot_of(known, lines, np.int64(0), np.int64(0), dots, lines.shape[1], span, way)
    bounds.bound_starts(out, known, slot, steps, span, way)


@kernel(fastmath=True)
def bounds_one_by_one(out: Any, known: Any, lines: Any, dots: Any, steps: Any, places: Any, span: Any, least: float) -> None:
    slot = bounds.slot_of(known, lines, np.int64(0), np.int64(0), dots, lines.shape[1], span, np.int64(0))
    bounds.bound_lines(out, known, slot, (steps, places, np.int64(0)), span, (np.int64(0), len(places)), least)


@kernel(fastmath=True)
def most_evidence(out: Any, buffer: Any, said: Any, lines: Any, dots: Any, phases: Any, span: Any) -> None:
    fill_range(said, lines, dots, span[1])
    for start in range(len(out)):
        out[start] = add_lines(buffer, said, span, phases, start - span[0], np.int64(0))


def scene(length: int, count: int, seed: int = 1) -> tuple[FloatArray, IntArray, Any]:
    """Evidence of lines for each phase, summed over the dots along them; phases of a plane, and `Sites.steps` of them."""
    rng = np.random.default_rng(seed)
    one = np.zeros((MOST_LINES + 1, count, length), dtype=np.float32)
    one[1:] = np.cumsum(rng.normal(0.0, 3.0, (MOST_LINES, count, length)), axis=0)
    phases = rng.integers(0, length, PLANE)
    step = np.diff(phases, append=0) % length
    steps = np.stack([step, step * length + np.roll(step, -1)]).astype(np.uint16)
    return np.concatenate([one, one], axis=2), phases, steps


@pytest.mark.parametrize("length", [15, 16, 63])
@pytest.mark.parametrize("span", [(0, 1), (0, 2), (0, 3), (1, 4), (0, 4), (2, 7), (0, 6), (1, 7), (0, 7)])
def test_lines_say_no_more_together_than_their_bound(length: int, span: tuple[int, int]) -> None:
    count = 7
    lines, phases, steps = scene(length, count)
    known, first, number = bounds.no_bounds(MOST_LINES, length, np.array([0, length - 1])), span[0], span[1] - span[0]
    places = PLANE - number + 1
    at_once, said, alone = np.empty(PLANE, dtype=np.float32), np.empty(places), np.empty(places)
    for dots in ((np.int64(0), np.int64(8)), (np.int64(2), np.int64(5))):
        bounds_at_once(at_once, known, lines, dots, steps, span, 0)
        buffer, each_line = np.empty(length, dtype=np.float32), np.zeros((count + 1, 2 * length), dtype=np.float32)
        most_evidence(said, buffer, each_line, lines, dots, phases, span)
        bounds_one_by_one(alone, known, lines, dots, steps, np.arange(places) - first, span, -np.inf)
        assert (at_once[:places] >= said - ROUNDING).all() and (at_once[places:] == np.float32(NEVER)).all()
        assert np.allclose(alone, at_once[:places], atol=ROUNDING)
        if number <= 3:
            assert np.allclose(said, at_once[:places], atol=ROUNDING)
        elif number == 6:  # of two runs, each at its best: bounds are not those of lines by themselves
            each = sum(float((lines[dots[1], k] - lines[dots[0], k]).max()) for k in range(*span))
            assert at_once[:places].max() < each
        for way in range(1, bounds.WAYS):
            again = np.empty_like(at_once)
            bounds_at_once(again, known, lines, dots, steps, span, way)
            assert (again[:places] >= said - ROUNDING).all() and (again[places:] == np.float32(NEVER)).all()
            if number <= 3:
                assert np.array_equal(again, at_once)
            else:  # neither is the less everywhere
                assert (again[:places] < at_once[:places]).any() and (at_once[:places] < again[:places]).any()


@pytest.mark.parametrize("number", range(1, 25))
def test_ways_take_all_lines_and_differ(number: int) -> None:
    found = [runs_at(number, way) for way in range(bounds.WAYS)]
    assert all(0 <= before <= 2 and 0 <= after <= 2 and before + 3 * threes + after == number for before, threes, after in found)
    assert len(set(found)) == (bounds.WAYS if number > 3 else 1)


@pytest.mark.parametrize("name", [name for name in CODES if get_code(name).sequences is not None])
def test_a_plane_has_no_other_steps_than_its_bounds(name: str) -> None:
    code = get_code(name).sequences
    assert code is not None
    steps = np.diff(code.phase_before(np.arange(min(code.range, 1_000_000)))) % code.main.length
    assert (steps.min(), steps.max()) == (code.least_difference, code.greatest_difference)


def test_a_bound_is_followed_no_farther_than_it_matters() -> None:
    lines, _, steps = scene(16, 7)
    known, places = bounds.no_bounds(MOST_LINES, 16, np.array([0, 15])), np.arange(PLANE - 6)
    whole, cut = np.empty(len(places)), np.empty(len(places))
    dots = (np.int64(0), np.int64(8))
    bounds_one_by_one(whole, known, lines, dots, steps, places, (0, 7), -np.inf)
    least = float(np.percentile(whole, 90)) + bounds.DEEP
    bounds_one_by_one(cut, known, lines, dots, steps, places, (0, 7), least)
    assert (cut >= whole - ROUNDING).all() and ((cut < least - bounds.DEEP) == (whole < least - bounds.DEEP)).all()
    assert (cut > whole + ROUNDING).any()


@kernel()
def of_each_site(out: Any, each: Any, span: Any, least: float) -> tuple[int, float, float]:
    return bounds.survivors(out, each, span[0], span[1], least)  # type: ignore[no-any-return]


@kernel()
def of_starts(out: Any, said: Any, starts: Any, axis: int, of: Any, least: float) -> tuple[int, float, float]:
    return bounds.survivors_of_starts(out, said, starts, axis, of, least)  # type: ignore[no-any-return]


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 1.0])
def test_sites_of_one_start_are_left_together(axis: int, share: float) -> None:
    """As if each were bounded by itself: the same sites in the same order, the same weight of the others."""
    rng = np.random.default_rng(2)
    starts, edges = rng.integers(0, 60, (500, 2)), [0, 200, 500]
    found: Starts = _starts(starts, edges)
    for kind, (first, last) in enumerate([(0, 200), (200, 500)]):
        begin, end = found.spans[kind, axis]
        assert np.array_equal(found.place[axis, begin:end], np.unique(starts[first:last, axis]))
        assert np.array_equal(found.place[axis, found.rank[first:last, axis]], starts[first:last, axis])
        said = np.full(500, np.nan)
        said[begin:end] = rng.normal(0.0, 8.0, end - begin)
        each = np.full(500, np.nan)
        each[first:last] = said[found.rank[first:last, axis]]
        least = float(np.quantile(each[first:last], 1.0 - share)) + (1.0 if share == 0.0 else 0.0)
        one, other = np.empty(500, dtype=np.int64), np.empty(500, dtype=np.int64)
        expected = of_each_site(one, each, (first, last), least)
        got = of_starts(other, said, found, axis, (kind, first, last), least)
        assert got[0] == expected[0] and np.array_equal(other[: got[0]], one[: got[0]])
        assert got[1:] == pytest.approx(expected[1:])
        assert (got[0] > 0) == (share > 0.0)
