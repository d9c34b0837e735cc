"""Lands on the film: shifts of lines that are drawn into points, and centres of pictures whose place is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tactape_fab.sense.inspect.colours import Palette
from tactape_fab.sense.inspect.film import _channel, _line_shift, _moved, _vertex, fit_film, refined, shifted, symmetry_offset
from tactape_fab.sense.inspect.patches import patch_grid
from tactape_fab.sense.inspect.warp import Warp, affine_warp
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.shapes import rotate
from tests.tapes import tape_at

RNG = np.random.default_rng(3)
WARP = affine_warp(((47.0, 1.0), (0.5, -46.5)), (30.0, 1400.0), (20.0, 15.0), 20.0)
BOARD: FloatArray = RNG.uniform((0, 0), (40, 30), (2000, 2))


def jitter(px: FloatArray) -> FloatArray:
    """Lines move by up to 0.8 px with a wave of 5 mm, columns by up to 0.3 px."""
    lines = np.stack([0.8 * np.sin(px[:, 1] / 37.0), 0.5 * np.cos(px[:, 1] / 37.0)], axis=1)
    return lines + np.stack([0.3 * np.sin(px[:, 0] / 45.0), 0.0 * px[:, 0]], axis=1)


@pytest.mark.parametrize("odd", [0, 60])
def test_lines_and_columns_that_move_are_followed(odd: int) -> None:
    """Points err by 0.1 px, some by 4 px: the film is found to 0.1 px everywhere inside."""
    smooth = WARP.to_px(BOARD)
    seen = smooth + jitter(smooth) + RNG.normal(0.0, 0.1, smooth.shape)
    seen[:odd] += 4.0
    warp, left = refined(WARP, BOARD, seen)
    inside = BOARD[(BOARD > 2).all(axis=1) & (BOARD < (38, 28)).all(axis=1)]
    off = warp.to_px(inside) - WARP.to_px(inside) - jitter(WARP.to_px(inside))
    assert np.sqrt((off**2).mean()) < 0.08
    assert [line.axis for line in warp.lines] == [1, 0]
    assert 1.4826 * np.median(np.abs(left[odd:])) == pytest.approx(0.1, rel=0.2)


def test_a_line_without_lands_lies_between_its_neighbours() -> None:
    """Ten lands at the first and the last of three lines, all 1 px off: 0.02 (2 v - v0 - v2) + 0.001 v = 0 in the middle."""
    at_px, left_px = np.repeat([5.0, 45.0], 10), np.ones((20, 2))
    shift = _line_shift(at_px, left_px, 0, 20.0)
    (v0, v1, v2), per_line = shift.value_px[:, 0].tolist(), 20 / 3
    assert (shift.start_px, shift.step_px, shift.axis) == (5.0, 20.0, 0) and shift.value_px[:, 1].tolist() == [v0, v1, v2]
    assert v1 == pytest.approx((v0 + v2) / 2.05) and v0 == pytest.approx(v2)
    assert 10.0 * (1.0 - v0) == pytest.approx(per_line * (0.02 * (v0 - v1) + 0.001 * v0), rel=1e-2)


def test_lines_that_no_land_is_near_stay_as_their_neighbours() -> None:
    away = BOARD[np.abs(BOARD[:, 1] - 15.0) > 2.0]
    seen = WARP.to_px(away) + (0.0, 0.4) * (away[:, 1:] > 15.0)
    warp, _ = refined(WARP, away, seen)
    between = np.array([(x, y) for x in (10.0, 20.0, 30.0) for y in (14.0, 15.0, 16.0)])
    off = (warp.to_px(between) - WARP.to_px(between))[:, 1]
    assert off.min() > -0.15 and off.max() < 0.55


@pytest.mark.parametrize("turn_deg", [0.0, 45.0, 90.0])
def test_a_warp_is_moved_in_the_parts_axes(turn_deg: float) -> None:
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    moved: Warp = shifted(WARP.raised(2), np.array([0.03, -0.01]), np.array([(c, -s), (s, c)]))
    by_mm = 0.03 * np.array([c, s]) - 0.01 * np.array([-s, c])
    assert moved.to_px(BOARD) == pytest.approx(WARP.to_px(BOARD + by_mm), abs=1e-9)
    assert _moved(WARP, BOARD, np.tile(by_mm, (2000, 1))) == pytest.approx(WARP.to_px(BOARD + by_mm), abs=1e-9)


GRID = patch_grid(0.6, 0.4, 40.0)


@pytest.mark.parametrize("at_mm", [(0.0, 0.0), (0.013, -0.021), (-0.03, 0.03)])
def test_the_middle_of_two_lands_is_found_beside_a_shadow(at_mm: tuple[float, float]) -> None:
    """Lands at 0.3 mm to either side; a soft slope beyond one of them is not of them."""
    a, b = GRID.a_mm - at_mm[0], GRID.b_mm - at_mm[1]
    lands = 1.0 / (1.0 + np.exp((np.maximum(np.abs(np.abs(a) - 0.3) / 0.1, np.abs(b) / 0.18) - 1.0) / 0.08))
    shadow = 0.1 / (1.0 + np.exp(-(b - 0.1) / 0.1))
    mask = (np.abs(GRID.a_mm) < 0.55) & (np.abs(GRID.b_mm) < 0.35)
    assert symmetry_offset(lands + shadow, GRID, mask) == pytest.approx(at_mm, abs=1e-3)


@pytest.mark.parametrize(
    ("three", "at"),
    [((1.0, 2.0, 1.0), 0.0), ((0.0, 2.0, 1.0), 1 / 6), ((1.0, 2.0, 2.0), 0.5), ((1.0, 0.0, 1.0), 0.0), ((0.0, 1.0, 3.0), 0)],
)
def test_the_top_of_a_parabola(three: tuple[float, float, float], at: float) -> None:
    assert _vertex(np.array(three)) == pytest.approx(at)


def test_metal_is_1_and_film_0_in_the_channel_that_tells_them_best() -> None:
    palette = Palette(
        body=np.zeros(3), metal=np.array([200.0, 60.0, 220.0]), film=np.array([90.0, 180.0, 210.0]), body_axis=np.zeros(4)
    )
    samples = np.array([[[200, 60, 220], [90, 180, 210], [145, 120, 215]]], dtype=np.float32)
    assert _channel(samples, palette) == pytest.approx(np.array([[[1.0, 0.0, 0.5]]]))


@pytest.mark.parametrize("apart", [0.0, 2.0, -2.0])
def test_metal_about_as_bright_as_film_is_counted_in_a_fixed_unit(apart: float) -> None:
    """A grey scan of solder and amber film: samples over no difference were NaN, no land was followed, and places 13 um off."""
    film = np.full(3, 160.0)
    palette = Palette(body=np.full(3, 30.0), metal=film + apart, film=film, body_axis=np.zeros(4))
    found = _channel(np.array([[film, film + 20.0, film - 10.0]], dtype=np.float32), palette)
    assert np.abs(found).ravel().tolist() == pytest.approx([0.0, 1.0, 0.5])


def test_lands_say_where_the_film_is_wherever_the_parts_are() -> None:
    """Drawn lands of 12 x 10 parts, seen with a warp that is 0.04 mm and 0.2 % off; parts are 0.05 mm beside their lands."""
    rng, tape, fine = np.random.default_rng(1), tape_at(7, (12, 10)), 4
    true = affine_warp(((40.0, 0.4), (0.4, -40.0)), (10.0, 850.0), (12.0, 10.5), 12.0)
    big = affine_warp(fine * np.array([(40.0, 0.4), (0.4, -40.0)]), (fine * 10.0 + 1.5, fine * 850.0 + 1.5), (12.0, 10.5), 12.0)
    picture = np.full((fine * 860, fine * 980, 3), (40, 120, 80), dtype=np.uint8)
    square, places = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2, tape.part_xy_mm()
    bodies = places + rng.normal(0.0, 0.05, places.shape)
    for at, size, colour in (
        *((places + rotate((x, 0.0), 45.0), (0.46, 0.4), (60, 190, 220)) for x in (-0.42, 0.42)),
        (bodies, (0.6, 0.3), (20, 20, 20)),
    ):
        for corners in at[:, None] + rotate(square * size, 45.0):
            cv2.fillConvexPoly(picture, np.rint(big.to_px(corners) * 16).astype(np.int32), colour, cv2.LINE_8, 4)
    picture = cv2.blur(cv2.resize(picture, (980, 860), interpolation=cv2.INTER_AREA), (2, 2), anchor=(0, 0)).astype(np.uint8)
    palette = Palette(
        body=np.full(3, 20.0), metal=np.array([60.0, 190.0, 220.0]), film=np.array([40.0, 120.0, 80.0]), body_axis=np.zeros(4)
    )
    start = affine_warp(1.002 * np.array([(40.0, 0.4), (0.4, -40.0)]), (10.0, 851.0), (12.0, 10.5), 12.0)
    found = fit_film(picture, start, tape, palette, np.ones(len(places), dtype=bool))
    off_px = found.warp.to_px(places) - true.to_px(places) + 0.5  # the blur moves by half a pixel
    assert np.sqrt((off_px**2).mean()) < 0.1 and np.abs(off_px.mean(axis=0)).max() < 0.03
    assert 0.0 < found.sigma_mm < 0.003
    few = fit_film(picture, start, tape, palette, np.arange(len(places)) < 30)
    assert few.warp is start and few.sigma_mm == few.common_mm == 0.02
