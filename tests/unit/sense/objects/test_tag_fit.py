"""The pixels of a tag in a picture, and the printed tag that they are held against."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import cv2
import numpy as np
import pytest

from tactape_fab.base.errors import FrameError
from tactape_fab.sense.objects.tag_fit import Flat, View, _blurred, _slopes, fitted, hits, pixels, posed, to_cells_of
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tag import tag_cells

FOCAL_PX, AWAY_MM, CELL_MM = 100.0, 50.0, 1.0
"""A cell of 2 px: the used square, nine cells wide, has 18 px."""
HALF_PX = 9.0


def view_of(shape: tuple[int, int], middle_px: tuple[float, float], levels: FloatArray | None = None) -> View:
    """A camera that looks straight at a tag whose centre is seen at `middle_px`."""
    v, u = np.indices(shape)
    picture = (3 * u + 2 * v if levels is None else levels).astype(np.uint8)
    matrix = np.array([[FOCAL_PX, 0.0, middle_px[0]], [0.0, FOCAL_PX, middle_px[1]], [0.0, 0.0, 1.0]])
    return View(picture=picture, matrix=matrix, lens=None, tag_id=7, cell_mm=CELL_MM)


STRAIGHT = (np.eye(3), np.array([0.0, 0.0, AWAY_MM]))


def test_pixels_have_their_levels_rays_and_places_in_the_light() -> None:
    seen = pixels(view_of((30, 40), (19.0, 13.0)), *STRAIGHT, 0.0)
    at_px = FOCAL_PX * seen.rays[:, :2] / seen.rays[:, 2:] + (19.0, 13.0)
    assert seen.levels == pytest.approx(at_px @ (3.0, 2.0), abs=1e-6)
    assert (at_px.min(axis=0), at_px.max(axis=0)) == (pytest.approx([10, 4], abs=1.0), pytest.approx([28, 22], abs=1.0))
    assert seen.px_per_cell == pytest.approx(2.0, rel=0.06) and seen.smoothed_px == 0.0
    # brightness and contrast: 1, then -1 to 1 from the left to the right, and from above
    assert (seen.light[:, 0] == 1.0).all()
    for axis in (0, 1):
        span = at_px[:, axis]
        expected = 2.0 * (span - span.min()) / (span.max() - span.min()) - 1.0
        assert seen.light[:, axis + 1] == pytest.approx(expected, abs=0.12)
        assert np.abs(seen.light[:, axis + 1]).max() <= 1.0
    in_cells = hits(seen, to_cells_of(*STRAIGHT, CELL_MM))
    assert in_cells == pytest.approx((at_px - (19.0, 13.0)) * AWAY_MM / FOCAL_PX / CELL_MM, abs=1e-9)


def test_a_slope_of_grey_stays_when_pixels_are_smoothed_up_to_the_picture_s_corner() -> None:
    seen = pixels(view_of((19, 24), (HALF_PX, HALF_PX)), *STRAIGHT, 0.5)
    at_px = FOCAL_PX * seen.rays[:, :2] / seen.rays[:, 2:] + HALF_PX
    assert seen.smoothed_px == pytest.approx(0.5 * seen.px_per_cell - 0.35)
    inner = (at_px > 4).all(axis=1) & (at_px < 15).all(axis=1)
    assert inner.sum() > 60 and seen.levels[inner] == pytest.approx(at_px[inner] @ (3.0, 2.0), abs=0.3)


def test_a_tag_that_just_fits_is_taken_and_one_a_pixel_beyond_is_not() -> None:
    for middle_px in ((HALF_PX, HALF_PX), (39 - HALF_PX, 29 - HALF_PX)):
        assert len(pixels(view_of((30, 40), middle_px), *STRAIGHT, 0.0).levels) > 250
    for middle_px in ((HALF_PX - 1, HALF_PX), (HALF_PX, HALF_PX - 1), (40 - HALF_PX, 15.0), (15.0, 30 - HALF_PX)):
        with pytest.raises(FrameError, match="not wholly inside the picture of 40 x 30 px"):
            pixels(view_of((30, 40), middle_px), *STRAIGHT, 0.0)
    with pytest.raises(FrameError, match=r"covers \d+ px, not 60 to"):
        pixels(view_of((30, 40), (19.0, 13.0)), np.eye(3), np.array([0.0, 0.0, 3.0 * AWAY_MM]), 0.0)


def test_light_areas_grow_by_as_much_as_is_said_and_are_blurred() -> None:
    """A cell's edge is a border of light: grown by a tenth of a cell, it is that much further out."""
    sharp = [_blurred(7, np.log(0.02), grown) for grown in (-0.1, 0.0, 0.1)]
    light = [float((tag > 0.5).mean()) for tag in sharp]
    cells = np.pad(tag_cells(7), 2)
    borders = int((cells[1:] != cells[:-1]).sum() + (cells[:, 1:] != cells[:, :-1]).sum())
    for step in (light[2] - light[1], light[1] - light[0]):
        assert step == pytest.approx(0.1 * borders / cells.size, rel=0.4)
    assert light[1] == pytest.approx(cells.mean(), abs=0.02)
    assert _blurred(7, np.log(0.5), 0.0).std() < 0.8 * sharp[1].std()


def test_slopes_of_the_printed_tag_are_its_differences() -> None:
    tag, right, down, wider, further = _slopes(7, np.log(0.3), 0.05)
    inner = (slice(32, -32), slice(32, -32))
    assert tag is _blurred(7, np.log(0.3), 0.05)
    assert 8 * (tag[:, 2:] - tag[:, :-2])[inner] == pytest.approx(right[:, 1:-1][inner], abs=1e-4)
    assert 8 * (tag[2:] - tag[:-2])[inner] == pytest.approx(down[1:-1][inner], abs=1e-4)
    for slope, more in ((wider, _blurred(7, np.log(0.3) + 0.1, 0.05)), (further, _blurred(7, np.log(0.3), 0.15))):
        assert np.abs((more - tag) / 0.1 - slope)[inner].max() < 0.25 * np.abs(slope).max()


def drawn(rotation: FloatArray, translation_mm: FloatArray) -> View:
    """The printed tag, as a camera 260 px wide sees it, without noise."""
    view = view_of((260, 260), (129.5, 129.5))
    v, u = np.indices(view.picture.shape)
    rays = np.stack([(u - 129.5) / FOCAL_PX, (v - 129.5) / FOCAL_PX, np.ones_like(u)], axis=-1)
    hit = rays @ to_cells_of(rotation, translation_mm, CELL_MM).T
    at = ((hit[..., :2] / hit[..., 2:] + 7.0) * 16 - 0.5).astype(np.float32)
    tag = cv2.remap(_blurred(7, np.log(0.15), 0.0), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    return replace(view, picture=np.rint(40 + 180 * tag).astype(np.uint8))


TILTED = (np.asarray(cv2.Rodrigues(np.array([0.4, -0.3, 0.8]))[0]), np.array([0.3, -0.2, 8.0]))


def test_the_tag_is_fitted_by_what_its_rays_meet_its_blur_and_its_growth() -> None:
    view = drawn(*TILTED)
    seen = pixels(view, *TILTED, 0.0)
    nearly = np.asarray(cv2.Rodrigues(np.array([0.03, 0.02, -0.03]))[0]) @ TILTED[0]
    flat = fitted(seen, view, nearly, TILTED[1] * 1.02)
    assert hits(seen, flat.to_cells) == pytest.approx(hits(seen, to_cells_of(*TILTED, CELL_MM)), abs=2e-3)
    assert flat.blur_cells == pytest.approx(0.15, rel=0.02) and flat.grown_cells == pytest.approx(0.0, abs=3e-3)
    assert flat.border_cells < 0.01 and sqrt(flat.squares / len(seen.levels)) < 1.0


@pytest.mark.parametrize("side", range(4))
def test_a_border_that_is_light_by_a_part_of_a_cell_is_told(side: int) -> None:
    """A light strip over a seventh of a cell, along half of a side."""
    straight = (np.eye(3), np.array([0.0, 0.0, 5.0]))
    view = drawn(*straight)
    picture = np.rot90(view.picture, side).copy()
    picture[129 - 80 : 129, 129 + 80 - 3 : 129 + 84] = 220
    covered = replace(view, picture=np.rot90(picture, -side).copy())
    told = [fitted(pixels(of, *straight, 0.0), of, *straight) for of in (view, covered)]
    assert told[0].border_cells < 0.01 and 0.06 < told[1].border_cells < 0.25


def test_a_pose_is_what_fits_the_rays_best_by_their_information() -> None:
    to_cells = to_cells_of(*TILTED, CELL_MM)
    rest = np.random.default_rng(2).normal(size=(8, 8))
    flat = Flat(
        to_cells=2.0 * to_cells,
        unit=np.diag([4.0, 5.0, 1.0]),
        information=rest.T @ rest,
        squares=9.0,
        blur_cells=0.2,
        grown_cells=0.0,
        border_cells=0.0,
    )
    start = np.asarray(cv2.Rodrigues(np.array([0.1, 0.1, -0.1]))[0]) @ TILTED[0]
    (turn, shift), squares = posed(flat, 100, CELL_MM, start, 1.1 * TILTED[1])
    assert turn == pytest.approx(TILTED[0], abs=0.02) and shift == pytest.approx(TILTED[1], abs=0.05)
    assert 9.0 <= squares < 9.0 + 9.0 / 100
    # of what no pose has, the part that is left grows the sum of squares by its information
    off = flat.to_cells.copy()
    off[0, 0] *= 1.1
    _, more = posed(replace(flat, to_cells=off), 100, CELL_MM, *TILTED)
    assert more > squares
