"""Which tape a scan shows and where: drawn tags, and points in place of its parts."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tactape_fab.sense.inspect.blobs import Blobs
from tactape_fab.sense.inspect.locate import SeenTag, _middles, find_tags, grow, read_code, warp_of_tag, within
from tactape_fab.sense.inspect.warp import Warp, affine_warp
from tactape_fab.sense.objects.tag_view import tag_corners_mm
from tactape_fab.texture.board import Tag
from tests.tapes import tape_at

TAPE = replace(tape_at(7, (40, 26)), tag=Tag(family="tag36h11", id=7, cell_mm=0.5, center_mm=(2.5, 3.5), rotation_deg=0.0))
PLACES = TAPE.part_xy_mm()
C, S = np.cos(0.4), np.sin(0.4)
# 20 px/mm, turned by 0.4 rad; v is down
LINEAR = 20.0 * np.array([(C, -S), (-S, -C)])
TRUE = affine_warp(LINEAR, (500.0, 1500.0), (33.0, 22.0), 33.0)
SHAPE = (2000, 2000)


@pytest.mark.parametrize(("cell_px", "at"), [(12, (300, 200)), (60, (2000, 900)), (9, (2900, 1500))])
def test_corners_of_a_tag_are_where_it_is_drawn(cell_px: int, at: tuple[int, int]) -> None:
    """Lower left, lower right, upper right, upper left, of the black border; larger pictures are looked at in small first."""
    u, v = at
    marker = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), 7, 8 * cell_px)
    picture = np.full((v + 12 * cell_px, u + 12 * cell_px, 3), 255, dtype=np.uint8)
    # OpenCV draws each tag turned by 180 degrees
    picture[v : v + 8 * cell_px, u : u + 8 * cell_px] = marker[::-1, ::-1, None]
    (tag,) = find_tags(picture)
    side = 8 * cell_px
    corners = np.add([(0, side), (side, side), (side, 0), (0, 0)], (u - 0.5, v - 0.5))
    assert tag.number == 7 and tag.corners_px == pytest.approx(corners, abs=0.15 * cell_px)
    assert find_tags(picture[:, : u + 2 * cell_px]) == []


def test_a_tag_says_scale_turn_and_place() -> None:
    found = warp_of_tag(TAPE, SeenTag(number=7, corners_px=TRUE.to_px(tag_corners_mm(TAPE))))
    assert found.to_px(PLACES) == pytest.approx(TRUE.to_px(PLACES), abs=1e-6)
    assert not found.mirrored and found.px_per_mm == pytest.approx(20.0)
    assert found.middle_mm.tolist() == [33.0, 22.5] and found.half_mm == 33.0


def bent() -> Warp:
    """A warp that is off by 25 px at the far ends of the tape, as a photograph is."""
    warp = TRUE.raised(2)
    coefficients = warp.coefficients.copy()
    coefficients[3:] = [(12.0, -8.0), (10.0, 6.0), (-9.0, 12.0)]
    return replace(warp, coefficients=coefficients)


def test_a_warp_grows_from_one_end_over_the_whole_tape() -> None:
    rng = np.random.default_rng(1)
    true = bent()
    blobs = Blobs(px=np.delete(true.to_px(PLACES) + rng.normal(0.0, 0.5, PLACES.shape), [4, 500, 700], axis=0))
    near = np.array([5.0, 5.0])
    slope = true.jacobian(near[None])[0]
    grown = grow(affine_warp(slope, true.to_px(near[None])[0] - slope @ near, (33.0, 22.5), 33.0), near, TAPE, blobs, SHAPE)
    assert grown is not None and grown.warp.order == 3
    assert np.abs(grown.warp.to_px(PLACES) - true.to_px(PLACES)).max() < 1.0
    assert grown.inside.tolist() == within(true.to_px(PLACES), SHAPE).tolist()
    assert grown.agreeing == pytest.approx(1.0 - 3 / len(PLACES), abs=0.002)


@pytest.mark.parametrize(("columns", "rows", "order"), [(10, 10, 1), (19, 14, 2), (12, 6, 1), (45, 26, 3)])
def test_higher_powers_wait_for_parts_that_tell_them(columns: int, rows: int, order: int) -> None:
    """Affine up to 25 mm, of second order up to 60 mm."""
    tape = tape_at(7, (columns, rows))
    grown = grow(TRUE, np.array([3.0, 3.0]), tape, Blobs(px=TRUE.to_px(tape.part_xy_mm())), SHAPE)
    assert grown is not None and grown.warp.order == order


@pytest.mark.parametrize(("off_mm", "displacement_mm", "agree"), [(0.15, 0.25, True), (0.19, 0.25, False), (0.15, 0.2, False)])
def test_a_part_agrees_that_is_nearer_than_a_wrong_symbol_s(off_mm: float, displacement_mm: float, agree: bool) -> None:
    """0.17 mm of a displacement of 0.25 mm, and less of a smaller one."""
    tape = replace(TAPE, displacement_mm=displacement_mm)
    places = tape.part_xy_mm()
    places[::10] += (off_mm, 0.0)
    grown = grow(TRUE, np.array([30.0, 20.0]), tape, Blobs(px=TRUE.to_px(places)), SHAPE)
    assert grown is not None and grown.agreeing == pytest.approx(1.0 if agree else 0.9, abs=0.005)


def test_where_hardly_a_part_is_seen_nothing_grows() -> None:
    near = np.array([30.0, 20.0])
    few = TRUE.to_px(PLACES[np.hypot(*(PLACES - near).T).argsort()])
    assert grow(TRUE, near, TAPE, Blobs(px=few[:11]), SHAPE) is None
    assert grow(TRUE, near, TAPE, Blobs(px=few[:0]), SHAPE) is None
    assert grow(TRUE, near, TAPE, Blobs(px=few[:40]), SHAPE) is not None


def test_a_scan_is_read_in_its_middle_first_and_nowhere_at_its_rim() -> None:
    """Parts at every 10 px; a speck is far away."""
    u, v = np.meshgrid(np.arange(0.0, 1001.0, 10.0), np.arange(0.0, 501.0, 10.0))
    middles = _middles(np.concatenate([np.column_stack([u.ravel(), v.ravel()]), [(9000.0, 9000.0)]]), 10.0)
    assert middles[0] == pytest.approx((500.0, 250.0), abs=10.0) and len(np.unique(middles, axis=0)) == 7
    assert (middles > (120.0, 60.0)).all() and (middles < (880.0, 440.0)).all()
    assert middles % 10.0 == pytest.approx(3.0)  # beside a part, not on it


@pytest.mark.parametrize("px_per_mm", [20.0, 19.5])
def test_parts_say_which_tape_they_are_of_and_where(px_per_mm: float) -> None:
    blobs = Blobs(px=np.concatenate([TRUE.to_px(PLACES), [(9000.0, 9000.0)]]))
    found = read_code(blobs, px_per_mm, [tape_at(8, (40, 26)), TAPE])
    assert found is not None and found.tape is not None and found.warp is not None
    assert found.tape.name == TAPE.name and found.sector == 7
    assert found.warp.to_px(found.near_mm[None]) == pytest.approx(TRUE.to_px(found.near_mm[None]), abs=2.0)
    near = PLACES[np.hypot(*(PLACES - found.near_mm).T) < 6.0]
    assert found.warp.to_px(near) == pytest.approx(TRUE.to_px(near), abs=2.0)


def test_the_code_names_a_tape_that_is_not_given() -> None:
    blobs = Blobs(px=TRUE.to_px(PLACES))
    found = read_code(blobs, 20.0, [tape_at(8, (40, 26))], plane=True)
    assert found is not None and (found.tape, found.sector, found.warp) == (None, 7, None)
    assert read_code(blobs, 20.0, [tape_at(8, (40, 26))]) is None
    assert read_code(Blobs(px=blobs.px[:15]), 20.0, [TAPE]) is None


@pytest.mark.parametrize(
    ("px", "rim_px", "inside"),
    [
        ((0.0, 0.0), 0.0, True),
        ((99.0, 49.0), 0.0, True),
        ((99.1, 3.0), 0.0, False),
        ((3.0, 49.1), 0.0, False),
        ((-0.1, 3), 0.0, False),
        ((5.0, 5.0), 5.0, True),
        ((4.9, 20.0), 5.0, False),
        ((94.0, 44.0), 5.0, True),
        ((94.1, 20.0), 5.0, False),
    ],
)
def test_a_picture_of_50_lines_of_100_pixels(px: tuple[float, float], rim_px: float, inside: bool) -> None:
    assert within(np.array([px]), (50, 100), rim_px).tolist() == [inside]
