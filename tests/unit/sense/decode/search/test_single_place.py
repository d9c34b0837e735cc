"""Evidence of single places against a plain sum over the dots, and what is handed on of the dots that stand on parts."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from tactape_fab.sense.decode.rule import GOOD_TRUST
from tactape_fab.sense.decode.search.evidence import tables_of
from tactape_fab.sense.decode.search.families import families
from tactape_fab.sense.decode.search.single_place import NO_PART, evidence_at, parts_under, places_near, shown_by
from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import FloatArray, IntArray
from tests.tapes import tape_at

RNG = np.random.default_rng(6)
TAPE = replace(tape_at(7, (9, 7)), omitted=np.array([(4, 3), (0, 6)]))
SHOWN = shown_by(TAPE)
NODES = np.array([at for at in product(range(4), range(3)) if at != (3, 0)])
Q = RNG.dirichlet(np.ones(4), len(NODES))
TABLES = tables_of(NODES, Q, families([TAPE], open_world=False)[0].signs, 24)


def plain(turn: int, corner: tuple[int, int]) -> tuple[float, int]:
    """Ln of the product of 2 q of both bits, and the number of dots, of those that stand on a part."""
    value, count = 0.0, 0
    for (x, y), (e, s, w, n) in zip(TABLES.cells[turn] + corner, np.roll(Q, -turn, axis=1), strict=True):
        if 0 <= x < TAPE.columns and 0 <= y < TAPE.rows and TAPE.placed[y, x]:
            # N = (0, 0), W = (1, 0), E = (0, 1), S = (1, 1)
            symbol = "NWES"[TAPE.symbols[y, x]]
            value += np.log(2.0 * (w + s if symbol in "WS" else n + e)) + np.log(2.0 * (e + s if symbol in "ES" else n + w))
            count += 1
    return value, count


@pytest.mark.parametrize("turn", range(4))
def test_the_evidence_of_every_place_is_that_of_its_dots_on_parts(turn: int) -> None:
    every = list(product(range(-4, TAPE.columns + 1), range(-4, TAPE.rows + 1)))
    for corner in every:
        assert evidence_at(TABLES, SHOWN, turn, *corner) == pytest.approx(plain(turn, corner), abs=1e-9)
    at = np.array([3.3, 2.8])
    for reach, least in ((0.5, 4), (2.6, 4), (2.6, 10), (30.0, 1), (30.0, 11)):
        wanted = {c: plain(turn, c) for c in every if np.hypot(*(at - c)) <= reach and plain(turn, c)[1] >= least}
        places, values = places_near(TABLES, SHOWN, turn, at, reach, least)
        assert len(places) == len(wanted) and {tuple(place) for place in places.tolist()} == set(wanted)
        assert values.tolist() == pytest.approx([wanted[tuple(place)][0] for place in places.tolist()], abs=1e-9)


@pytest.mark.parametrize("turn", range(4))
def test_of_eight_directions_each_of_three_bits_counts(turn: int) -> None:
    codes = DIRECTIONS[8].gray_codes.astype(np.int64)
    shown = RNG.integers(0, 8, (7, 9)).astype(np.uint8)
    q = RNG.dirichlet(np.ones(8), len(NODES))
    tables = tables_of(NODES, q, families([TAPE], open_world=False)[0].signs, 24)
    value, of_column = 0.0, codes[DIRECTIONS[8].clockwise]
    for (x, y), shares in zip(tables.cells[turn] + (2, 1), np.roll(q, -2 * turn, axis=1), strict=True):
        same = [(of_column >> bit & 1) == (shown[y, x] >> bit & 1) for bit in range(3)]
        value += sum(np.log(2.0 * shares[which].sum()) for which in same)
    found, count = evidence_at(tables, shown, turn, 2, 1)
    assert found == pytest.approx(value, abs=1e-9) and count == len(NODES)


def test_a_region_beyond_the_tape_has_no_places() -> None:
    for at in ((-30.0, 2.0), (50.0, 2.0), (3.0, -30.0), (3.0, 50.0)):
        places, values = places_near(TABLES, SHOWN, 0, np.array(at), 5.0, 1)
        assert (places.shape, values.shape) == ((0, 2), (0,))


def test_dots_on_parts_are_handed_on_with_their_design_s_places() -> None:
    cells = np.array([(0, 0), (8, 6), (4, 3), (-1, 2), (2, -1), (9, 1), (1, 7), (5, 2)])
    n, on = len(cells), np.array([True, True, False, False, False, False, False, True])
    xy_px, weights = RNG.uniform(0.0, 300.0, (n, 2)), RNG.uniform(0.3, 1.0, n)
    trust = np.array([0.9, 0.5 * GOOD_TRUST, 0.9, 0.9, 0.9, 0.9, 0.9, GOOD_TRUST])
    centre_px, around_mm = np.array([160.0, 120.0]), RNG.normal(0.0, 0.25, (8, 2))
    inside, together = np.zeros(n, dtype=np.bool_), np.zeros(n)
    kept: IntArray = np.zeros((n, 2), dtype=np.int64)
    nominal_mm: FloatArray = np.zeros((n, 2))
    offset_px: FloatArray = np.zeros((n, 2))
    seen = (xy_px, weights, trust)
    count, good = parts_under(cells, SHOWN, *seen, 1.5, around_mm, centre_px, inside, kept, nominal_mm, offset_px, together)
    # a trust of just `GOOD_TRUST` is none beyond it
    assert (count, good) == (3, 1) and inside.tolist() == on.tolist()
    assert (kept[:3] == cells[on]).all() and (SHOWN[cells[on][:, 1], cells[on][:, 0]] != NO_PART).all()
    assert nominal_mm[:3] == pytest.approx(1.5 * cells[on] + around_mm[SHOWN[cells[on][:, 1], cells[on][:, 0]]])
    assert offset_px[:3] == pytest.approx(xy_px[on] - centre_px)
    assert together[:3] == pytest.approx(weights[on] * (1.0, 0.5, 1.0))
