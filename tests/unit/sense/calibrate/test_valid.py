"""Pixels that carry depth, and how far from the others a detector sees them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense.calibrate.valid import clear_of_blind, valid_pixels
from tactape_fab.sense.decode.rule import BACKGROUND_MM
from tests.unit.sense.calibrate.sensors import STOCK


def frames(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    return [rng.standard_normal((60, 80)).astype(np.float32) for _ in range(count)]


def test_a_pixel_that_is_nan_in_half_of_the_frames_is_blind() -> None:
    some = frames(6)
    for frame in some[:3]:
        frame[10, 10] = np.nan
    some[0][20, 20] = some[1][20, 20] = np.nan
    some[5][30, 30] = np.inf
    # the same value but for one frame
    for frame in some:
        frame[40, 40] = 2.0
    some[4][40, 40] = 2.5
    valid = valid_pixels(some, STOCK)
    assert valid is not None and np.argwhere(~valid).tolist() == [[10, 10]]


def test_empty_frames_and_too_few_say_nothing() -> None:
    empty = np.full((60, 80), np.nan, dtype=np.float32)
    blind = [np.where(np.arange(80) < 20, np.float32(1.0), frame) for frame in frames(3)]
    assert valid_pixels([*blind[:2], empty], STOCK) is None
    valid = valid_pixels([empty, *blind], STOCK)
    assert valid is not None and np.array_equal(valid, np.broadcast_to(np.arange(80) >= 20, (60, 80)))
    # what a profile's own mask hides counts as valid, as frames are delivered
    mask = np.broadcast_to(np.arange(80) >= 20, (60, 80))
    assert valid_pixels(blind, replace(STOCK, width_px=80, height_px=60, mask=mask)) is None
    mirrored = replace(STOCK, width_px=80, height_px=60, mask=mask[:, ::-1], mirror=True)
    assert valid_pixels(blind, mirrored) is None


@pytest.mark.parametrize("px_per_mm", [6.0, 9.0])
def test_a_detector_is_clear_of_a_blind_area_by_half_its_background(px_per_mm: float) -> None:
    reach = round(BACKGROUND_MM / 2.0 * px_per_mm)
    valid = np.ones((90, 120), dtype=bool)
    # an area of four pixels, one of three, which smoothing hides, and a strip along the border
    valid[40:44, 50:54] = valid[40:43, 90:93] = valid[:, -1] = False
    clear = clear_of_blind(valid, px_per_mm)
    assert clear is not None
    wanted = np.ones_like(valid)
    wanted[40 - reach : 44 + reach, 50 - reach : 54 + reach] = wanted[:, 119 - reach :] = False
    assert np.array_equal(clear, wanted)
    assert clear_of_blind(np.ones((90, 120), dtype=bool), px_per_mm) is None
    single = np.ones((90, 120), dtype=bool)
    single[5, 5] = False
    assert clear_of_blind(single, px_per_mm) is None
