"""The information limit: the grid of an ideal reader is the true one, whatever the image's turn, and more parts locate more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense import Scene, load_sensor, simulate
from tactape_fab.sense.decode.rule import GOOD_WEIGHT, KAPPA, LEAST_DOTS, MAX_P_FALSE, USUAL_SIGMA
from tactape_fab.sense.simulation.view import make_view
from tactape_fab.texture.frames import DIRECTIONS_XY
from tactape_fab.verify.trip.limit import (
    _dots_of,
    _grid_of,
    _known_parts,
    _on_own_grid,
    _parts_shown,
    as_seen,
    error_free,
    rule_of,
)
from tests.tapes import tape_at

TAPE = tape_at(7, (40, 24))
# pixels that are not square
SENSOR = replace(load_sensor("gelsight-mini"), px_per_mm=(16.0, 14.0))
RULE = rule_of(TAPE, SENSOR)
POSE = np.array([30.0, 17.0, 35.0])
SCENE = Scene(contact_mm=(10.0, 9.0))
OWN = TAPE.cells() + TAPE.displacement_mm / TAPE.pitch_mm * DIRECTIONS_XY[TAPE.symbols[TAPE.placed]]


def test_a_margin_makes_both_limits_stricter() -> None:
    plain, strict = RULE.limits, rule_of(TAPE, SENSOR, 2.0).limits
    assert (plain.max_p_false, plain.kappa) == (MAX_P_FALSE, KAPPA)
    assert (strict.max_p_false, strict.kappa) == (MAX_P_FALSE / 2.0, KAPPA * 2.0)


@pytest.mark.parametrize(("size_mm", "located"), [((10.0, 9.0), True), ((5.0, 4.0), False), ((1.0, 1.0), False)])
def test_error_free_dots_locate_where_there_are_enough(size_mm: tuple[float, float], located: bool) -> None:
    found = error_free(RULE, POSE, Scene(contact_mm=size_mm))
    assert found.located == located and found.n_dots == len(_parts_shown(RULE, POSE, Scene(contact_mm=size_mm))[0])
    if located:
        assert found.p_tape is not None and found.p_tape < MAX_P_FALSE


def test_tops_of_a_frame_locate_as_error_free_dots_do() -> None:
    depth = simulate(TAPE, (30.0, 17.0), 35.0, sensor=SENSOR, scene=SCENE, seed=3)
    for known_parts in (False, True):
        assert as_seen(RULE, POSE, SCENE, depth, known_parts=known_parts).located
    assert not as_seen(rule_of(TAPE, SENSOR, 1e60), POSE, SCENE, depth, known_parts=True).located
    # whose tops would have to be on another grid
    assert not as_seen(RULE, np.add(POSE, (0.7, 0.7, 0.0)), SCENE, depth, known_parts=False).located
    small = Scene(contact_mm=(0.5, 0.5))
    nothing = as_seen(RULE, POSE, small, np.zeros_like(depth), known_parts=False)
    assert (nothing.located, nothing.n_dots) == (False, 0)


def test_tops_are_at_the_places_of_parts_whatever_the_pixels() -> None:
    depth = simulate(TAPE, (30.0, 17.0), 35.0, sensor=SENSOR, scene=SCENE, seed=3)
    dots, view = _dots_of(RULE, depth), make_view(TAPE, POSE[:2], 35.0, SENSOR, SCENE)
    there = view.to_board(view.from_px(dots.xy_px[dots.trust * dots.weights > 0.9]))
    apart = np.hypot(*(there[:, None] - TAPE.part_xy_mm()).transpose(2, 0, 1)).min(axis=1)
    assert len(there) > 20 and np.median(apart) < 0.02
    # the texture's x axis in an image of square pixels: the image is turned clockwise by theta, y down
    length = TAPE.pitch_mm * SENSOR.px_per_mm[0]
    along = length * np.array([np.cos(np.radians(35.0)), np.sin(np.radians(35.0))])
    assert _grid_of(RULE, view) == pytest.approx([*along, 0.0, 0.0])


def test_the_grid_of_known_symbols_is_the_true_one() -> None:
    """Tops that a turn, a scale and a shift moved together go back to their places, and the error is what is left of them."""
    own = OWN[(np.abs(OWN - (20.0, 12.0)) < 4.0).all(axis=1)]
    rng = np.random.default_rng(1)
    factor = 1.003 * np.exp(1j * np.radians(0.4))
    moved = (own - own.mean(axis=0)) @ (1.0, 1.0j) * factor
    error = rng.normal(0.0, 0.01, own.shape)
    at = np.stack([moved.real, moved.imag], axis=1) + own.mean(axis=0) + (0.03, -0.02) + error
    # one of them beside its place by 0.2 pitches, and one that no part of the tape can be
    at = np.concatenate([at, np.add(own[:1], (0.2, 0.0)), [(-3.1, 2.0)]])
    n = len(at)
    found, sigma = _on_own_grid(RULE, at, np.ones(n), np.ones(n))
    assert np.abs(found[:-2] - own).max() < 0.04 and np.abs((found[:-2] - own).mean(axis=0)).max() < 1e-9
    slope = np.linalg.lstsq(own - own.mean(axis=0), found[:-2] - own.mean(axis=0), rcond=None)[0]
    assert slope == pytest.approx(np.eye(2), abs=0.002)
    assert 0.005 < sigma < 0.02
    # of dots without trust, and of few, nothing is fitted
    for trust in (np.zeros(n), (np.arange(n) < LEAST_DOTS - 1).astype(float)):
        as_it_was, usual = _on_own_grid(RULE, at, np.ones(n), trust)
        assert np.array_equal(as_it_was, at) and usual == USUAL_SIGMA
    assert not np.array_equal(_on_own_grid(RULE, at, np.ones(n), (np.arange(n) < LEAST_DOTS).astype(float))[0], at)
    # low tops place the grid, but their error is not that of good ones
    low = np.where(np.arange(n) < 10, 1.0, GOOD_WEIGHT - 0.01)
    wide = at + np.where(low[:, None] < 1.0, rng.normal(0.0, 0.03, at.shape), 0.0)
    assert _on_own_grid(RULE, wide, low, np.ones(n))[1] < 0.02 < _on_own_grid(RULE, wide, np.ones(n), np.ones(n))[1]


def test_parts_are_at_their_nearest_top_and_other_dots_stay() -> None:
    part_at = np.array([(5.2, 4.0), (6.0, 4.2), (7.0, 3.8)])
    # two tops at the first part's grid point, one at the second's, one beside all
    at = np.array([(5.3, 4.1), (5.19, 4.02), (6.1, 4.3), (9.0, 9.0)])
    ones = np.ones(3)
    places, weights, trust = _known_parts(at, np.array([0.9, 0.8, 0.7, 0.6]), np.full(4, 0.5), part_at.copy(), ones.copy(), ones)
    assert places.tolist() == [[5.19, 4.02], [6.1, 4.3], [7.0, 3.8], [9.0, 9.0]]
    assert weights.tolist() == [0.8, 0.7, 1.0, 0.6] and trust.tolist() == [1.0, 1.0, 1.0, 0.5]
    # without any top at a part
    places, weights, trust = _known_parts(at[3:], ones[:1] * 0.6, ones[:1] * 0.5, part_at.copy(), ones.copy(), ones)
    assert places.tolist() == [*part_at.tolist(), [9.0, 9.0]] and weights.tolist() == [1.0, 1.0, 1.0, 0.6]
