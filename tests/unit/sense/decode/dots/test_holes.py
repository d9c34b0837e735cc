"""Pixels without depth: what they are filled with, and that they move no answer."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tactape_fab import Localizer
from tactape_fab.sense import iterate_frames, load_sensor
from tactape_fab.sense.decode.dots.holes import REACH_MM, filled
from tactape_fab.sense.decode.dots.inputs import canonical_frame
from tests.contacts import TAPE

PROFILE = load_sensor("gelsight-mini")


def spots(shape: tuple[int, int], count: int = 40, radius_px: float = 5.0) -> npt.NDArray[Any]:
    """False in spots, as the printed markers of a gel have them."""
    rng = np.random.default_rng(5)
    v, u = np.indices(shape)
    known = np.ones(shape, dtype=bool)
    for y, x in rng.uniform((0, 0), shape, (count, 2)):
        known[np.hypot(u - x, v - y) < radius_px] = False
    return known


def test_a_slope_goes_on_through_a_hole() -> None:
    v, u = np.indices((40, 50)).astype(np.float32)
    slope = 3.0 * u - 2.0 * v
    known = np.ones(slope.shape, dtype=bool)
    known[10:15, 20:25] = False
    image = filled(np.where(known, slope, np.float32(np.nan)), np.ones_like(known), 1000.0)
    assert np.array_equal(image, filled(slope, known, 1000.0))  # what is hidden is a hole, too
    assert np.array_equal(image[known], slope[known])
    assert image[~known] == pytest.approx(slope[~known], abs=4.0)  # of 150
    assert image[12, 22] == pytest.approx(slope[12, 22], abs=1e-3)


def test_far_from_all_depth_a_hole_has_the_median() -> None:
    image = np.full((30, 900), np.nan, dtype=np.float32)
    image[:, :9] = np.arange(9) + 1.0
    whole = filled(image, np.ones(image.shape, dtype=bool), 16.0)
    assert (whole[:, 9] > 8.9).all()
    half = round(REACH_MM * 16.0)
    assert whole[:, 8 + half] == pytest.approx((9.0 + 5.0) / 2)
    assert whole[:, -1] == pytest.approx(5.0, abs=0.01)
    assert (np.diff(whole[:, 9:], axis=1) < 0.0).all()  # no ridge, whose top could be a dot


def test_a_frame_of_few_pixels_has_their_median() -> None:
    image = np.full((400, 500), np.nan, dtype=np.float32)
    image[100, 200:203] = (1.0, 7.0, 100.0)  # of a sample of all places none may be one of them
    assert filled(image, np.ones(image.shape, dtype=bool), 16.0)[-1, -1] == pytest.approx(7.0)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (16, 16)])
def test_a_frame_that_is_one_hole_is_zero(shape: tuple[int, int]) -> None:
    assert not filled(np.full(shape, np.nan, dtype=np.float32), np.ones(shape, dtype=bool), 16.0).any()


@pytest.mark.parametrize(("mirror", "rotate90"), [(False, 0), (True, 0), (False, 1), (True, 3)])
@pytest.mark.parametrize("hidden", [0.0, np.nan, -np.inf, 1e6, 1e12])
def test_what_a_mask_hides_says_nothing(mirror: bool, rotate90: int, hidden: float) -> None:
    known = spots((240, 320))
    upright = np.random.default_rng(0).random((240, 320)).astype(np.float32)
    sensor = replace(PROFILE, mask=known, mirror=mirror, rotate90=rotate90)

    def delivered(image: npt.NDArray[Any]) -> npt.NDArray[Any]:
        turned = np.rot90(image, -rotate90)
        return turned[:, ::-1] if mirror else turned

    image = canonical_frame(delivered(np.where(known, upright, np.float32(hidden))), sensor)
    assert np.array_equal(image, canonical_frame(delivered(upright), sensor))
    assert np.array_equal(image[known], upright[known])


@pytest.mark.parametrize(("masked", "hidden"), [(False, np.nan), (True, np.nan), (True, 0.0), (True, 1e6)])
def test_markers_move_no_position(masked: bool, hidden: float) -> None:
    known = spots((240, 320))
    localizer = Localizer(TAPE, sensor=replace(PROFILE, mask=known) if masked else PROFILE)
    for frame in iterate_frames(TAPE, 8, seed=11):
        fix = localizer.locate(np.where(known, frame.depth, np.float32(hidden)))
        assert fix.position_mm is not None and fix.theta_deg is not None and fix.covariance is not None
        off = np.array([*(fix.position_mm - frame.position_mm), np.radians(fix.theta_deg - frame.theta_deg)])
        assert np.hypot(*off[:2]) < 0.006
        assert off @ np.linalg.solve(fix.covariance, off) < 20.0
