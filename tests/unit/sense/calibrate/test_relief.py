"""Blur and height of parts, against those that frames were drawn with."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab.sense import SensorProfile
from tactape_fab.sense.calibrate.presses import Frame, Press, located
from tactape_fab.sense.calibrate.relief import FINE, Relief, _least, find_relief
from tactape_fab.texture.frames import FloatArray
from tests.unit.sense.calibrate.sensors import TAPE, TRUE, pressed


def test_blurs_that_are_tried_are_near_each_other_in_their_order() -> None:
    """What is interpolated between three of them is no further than half as much again."""
    steps = np.diff(np.log(FINE))
    assert (steps > 0.0).all() and (steps < np.log(1.5)).all()


def test_a_blur_between_those_tried_is_that_of_a_parabola_in_its_logarithm() -> None:
    for blur in (0.05, 0.11, 0.4):
        sums = np.log(np.array(FINE) / blur) ** 2 + 1.0
        assert _least(FINE, sums, int(sums.argmin())) == pytest.approx(blur)
    # the first and the last have no neighbour on one side; three equal sums have no least one
    assert _least(FINE, np.arange(len(FINE), dtype=float), 0) == FINE[0]
    assert _least(FINE, -np.arange(len(FINE), dtype=float), len(FINE) - 1) == FINE[-1]
    assert _least(FINE, np.ones(len(FINE)), 2) == FINE[2]


@cache
def seen(blur_mm: float, factor: int = 1) -> tuple[SensorProfile, tuple[Frame, ...], tuple[Press, ...], Any]:
    """A sensor whose gel smooths by so much, three presses of it, and their true poses."""
    sensor = replace(
        TRUE,
        gel=replace(TRUE.gel, blur_mm=blur_mm),
        width_px=320 * factor,
        height_px=240 * factor,
        px_per_mm=(15.0 * factor, 15.0 * factor),
    )
    made = pressed(sensor, 3, 1, (3.0, 2.0), 20.0)
    found, _ = located(made.frames, [TAPE], sensor)
    poses: FloatArray = made.poses * (1.0, 1.0, np.pi / 180.0)
    return sensor, tuple(made.frames), tuple(found), SimpleNamespace(sensor=sensor, poses=poses)


def relief(blur_mm: float, factor: int = 1, scale: float = 1.0) -> Relief:
    _, frames, presses, bundle = seen(blur_mm, factor)
    found = find_relief([np.float32(scale) * frame for frame in frames], presses, bundle, [TAPE])
    assert found is not None
    return found


@pytest.mark.parametrize(("blur_mm", "factor"), [(0.08, 1), (0.2, 1), (0.15, 2)])
def test_blur_and_height_are_those_of_the_drawn_gel(blur_mm: float, factor: int) -> None:
    found = relief(blur_mm, factor)
    assert found.blur_mm == pytest.approx(blur_mm, rel=0.15) and found.sigma_blur_mm is not None
    assert found.sigma_blur_mm < 0.02
    # what is left is the noise of the slopes, mm between two pixels
    if factor == 1:
        assert TRUE.slope_noise is not None and found.left == pytest.approx((TRUE.slope_noise / 15.0) ** 2, rel=0.2)
    # the height of a part, in mm; frames in another unit have it in theirs
    twice = relief(blur_mm, factor, 2.0)
    assert twice.amplitude == pytest.approx(2.0 * found.amplitude, rel=1e-3) and twice.blur_mm == pytest.approx(
        found.blur_mm, rel=1e-2
    )
    assert twice.left == pytest.approx(4.0 * found.left, rel=1e-2) and twice.freedom == found.freedom > 1000.0


@pytest.mark.parametrize("factor", [1, 2])
def test_a_sharp_gel_s_blur_is_found_to_two_percent(factor: int) -> None:
    """Dots are looked for to half a pixel where they are, of averaged pixels too: a pixel off, it seems 5 % softer."""
    assert relief(0.08, factor).blur_mm == pytest.approx(0.08, rel=0.02)


def test_parts_of_no_known_relief_and_few_dots_say_nothing() -> None:
    _, frames, presses, bundle = seen(0.2)
    assert find_relief(frames, presses, bundle, [replace(TAPE, part=replace(TAPE.part, shape="dome"))]) is None
    light = [replace(press, weights=0.89 * press.weights) for press in presses]
    assert find_relief(frames, light, bundle, [TAPE]) is None
    whole = [press.taken(np.flatnonzero(press.weights >= 0.9)) for press in presses]
    assert find_relief(frames, [press.taken(np.arange(3)) for press in whole], bundle, [TAPE]) is None
    # of four the blur is known, and not how it differs from press to press
    one: Any = SimpleNamespace(sensor=bundle.sensor, poses=bundle.poses[:1])
    four, every = (find_relief(frames, some, one, [TAPE]) for some in ([whole[0].taken(np.arange(4))], whole[:1]))
    assert four is not None and every is not None
    assert four.sigma_blur_mm is None and four.sigma_amplitude is None and 0.0 < four.freedom < every.freedom
