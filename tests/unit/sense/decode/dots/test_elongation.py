"""What the dots' shape says of the quarter turn: the right half of them, and nothing where bodies are round."""

from __future__ import annotations

from dataclasses import replace
from math import cos, radians, sin

import numpy as np
import pytest
from scipy.stats import norm

from tactape_fab import Tape
from tactape_fab.sense import Scene, iterate_frames
from tactape_fab.sense.decode.dots.detect import detect
from tactape_fab.sense.decode.dots.elongation import (
    COMMON_ERROR,
    USUAL_DOTS,
    USUAL_SCATTER,
    flipped_u,
    parity_log_ratio,
    square_pixels,
    turn_weights,
)
from tactape_fab.sense.decode.rule import GOOD_TRUST, GOOD_WEIGHT, LEAST_GOOD, MOST_TURN_SHARE
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart

PART = TapePart(name="r0201", shape="block", body_mm=(0.6, 0.3, 0.23), rotation_deg=45.0)
FLAT = np.full(4, 0.25)


def grid_at(angle_deg: float) -> FloatArray:
    return 24.0 * np.array([cos(radians(angle_deg)), sin(radians(angle_deg)), 0.0, 0.0])


def long_at(angle_deg: float, count: int = 12, much: float = 0.24, scatter: float = 0.04, seed: int = 1) -> FloatArray:
    """Elongations of tops that are longest at an angle from u towards v."""
    twice = radians(2 * angle_deg)
    noise = np.random.default_rng(seed).normal(0.0, scatter, (count, 2))
    return -much * np.array([cos(twice), sin(twice)]) + noise


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("rotation_deg", [45.0, 10.0, -30.0])
def test_the_turns_that_bodies_lie_along_get_the_weight(turn: int, rotation_deg: float) -> None:
    """Counter-clockwise on the board is from v towards u in the image."""
    part, ones = replace(PART, rotation_deg=rotation_deg), np.ones(12)
    theta_deg = 33.0 + 90.0 * turn
    weights = turn_weights(long_at(theta_deg - rotation_deg), ones, ones, grid_at(33.0), part)
    assert weights.sum() == pytest.approx(1.0)
    assert weights[turn] == pytest.approx(MOST_TURN_SHARE / 2)
    assert weights[(turn + 2) % 4] == weights[turn]


def test_bodies_that_are_wider_than_long_lie_across() -> None:
    ones = np.ones(12)
    wide = replace(PART, body_mm=(0.3, 0.6, 0.23))
    long, across = (parity_log_ratio(long_at(10.0), ones, ones, grid_at(33.0), part) for part in (PART, wide))
    assert long == pytest.approx(-across) and abs(long) > 4.0


@pytest.mark.parametrize(
    "part",
    [
        TapePart(name="dome", shape="dome", body_mm=(0.6, 0.6, 0.2), rotation_deg=45.0),
        replace(PART, body_mm=(0.5, 0.5, 0.2)),
    ],
)
def test_round_bodies_say_nothing(part: TapePart) -> None:
    assert turn_weights(long_at(10.0), np.ones(12), np.ones(12), grid_at(33.0), part) == pytest.approx(FLAT)


def test_few_low_or_unknown_dots_say_nothing() -> None:
    ones, grid = np.ones(12), grid_at(33.0)
    assert turn_weights(None, ones, ones, grid, PART) == pytest.approx(FLAT)
    assert turn_weights(long_at(10.0), 0.5 * ones, ones, grid, PART) == pytest.approx(FLAT)
    assert turn_weights(long_at(10.0), ones, 0.3 * ones, grid, PART) == pytest.approx(FLAT)
    assert turn_weights(long_at(10.0, 3), ones[:3], ones[:3], grid, PART) == pytest.approx(FLAT)


def test_dots_that_are_just_good_enough_count_and_lower_ones_do_not() -> None:
    """Log odds that a mean is positive, by the distribution function of scipy and the sample's own variance."""
    few = long_at(78.0, LEAST_GOOD, much=0.12)
    weights, trust = np.full(LEAST_GOOD + 2, GOOD_WEIGHT), np.full(LEAST_GOOD + 2, GOOD_TRUST)
    weights[0], trust[-1] = GOOD_WEIGHT - 1e-6, GOOD_TRUST - 1e-6
    every = np.concatenate([[(0.9, 0.0)], few, [(0.0, -0.9)]])
    # parts at 33 - 45 degrees in turn 0, and at 78 degrees in turn 1
    twice = radians(2 * (33.0 - 45.0))
    along = few @ (-cos(twice), -sin(twice))
    squares = LEAST_GOOD * few.var(axis=0).sum() / 2.0 + USUAL_DOTS * USUAL_SCATTER**2
    error = np.sqrt(squares / (LEAST_GOOD - 1 + USUAL_DOTS) / LEAST_GOOD + COMMON_ERROR**2)
    z = along.mean() / error
    found = parity_log_ratio(every, weights, trust, grid_at(33.0), PART)
    assert found == pytest.approx(norm.logcdf(z) - norm.logcdf(-z)) and -12.0 < found < -2.0
    assert parity_log_ratio(every[:-2], weights[:-2], trust[:-2], grid_at(33.0), PART) == 0.0


def test_a_small_mean_is_doubted_however_many_dots_share_it() -> None:
    many = np.ones(400)
    weights = turn_weights(long_at(78.0, 400, much=0.02), many, many, grid_at(33.0), PART)
    assert weights.max() < 0.4


def test_oblong_pixels_and_mirrors_are_undone() -> None:
    """A top long at 30 degrees in square pixels, and its second derivatives as pixels twice as wide as high see it."""
    c, s = cos(radians(30.0)), sin(radians(30.0))
    turn = np.array([[c, -s], [s, c]])
    hessian = -turn @ np.diag([0.5, 1.0]) @ turn.T
    aspect = 0.5  # square v = aspect * pixel v
    seen = hessian * np.outer([1.0, aspect], [1.0, aspect])

    def of(h: FloatArray) -> FloatArray:
        return np.array([[h[0, 0] - h[1, 1], 2 * h[0, 1]]]) / float(np.trace(h))

    assert square_pixels(of(seen), aspect) == pytest.approx(of(hessian))
    mirror = np.diag([-1.0, 1.0])
    assert flipped_u(of(hessian)) == pytest.approx(of(mirror @ hessian @ mirror))
    assert square_pixels(None, aspect) is None and flipped_u(None) is None


@pytest.mark.parametrize(
    "scene",
    [
        Scene(),
        Scene(noise=2.0),
        Scene(contact_mm=(5.0, 5.0)),
        Scene(contact="strip", strip_width_mm=4.5, cylinder_radius_mm=8.4),
        Scene(scale_error=-0.06),
        Scene(elastomer_mm=0.25),
    ],
)
def test_the_turns_of_simulated_frames_are_right(tape: Tape, scene: Scene) -> None:
    for frame in iterate_frames(tape, 20, 3, scene=scene):
        dots = detect(frame.depth, 16.0)
        for turn in range(2):
            grid = grid_at(frame.theta_deg - 90.0 * turn)
            assert turn_weights(dots.elongation, dots.weights, dots.trust, grid, tape.part)[turn] > 0.4
