"""A tag's pose: where fits begin, which of two tilts is taken, and what of the picture does not agree with it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tactape_fab.sense.objects.tag_fit import View
from tactape_fab.sense.objects.tag_pose import _moved_cells, _starts, _tilts, _worst_spot

SQUARE = np.array([(-4.0, 4.0, 0.0), (4.0, 4.0, 0.0), (4.0, -4.0, 0.0), (-4.0, -4.0, 0.0)])
MATRIX = np.array([[500.0, 0.0, 320.0], [0.0, 520.0, 240.0], [0.0, 0.0, 1.0]])
TURN, SHIFT = np.asarray(cv2.Rodrigues(np.array([0.4, 0.2, 0.5]))[0]), np.array([-20.0, 15.0, 60.0])


def spots(per_cell: int = 3) -> np.ndarray:
    """Places on the tag, in cells from its centre, `per_cell` along each side of every cell."""
    along = (np.arange(10 * per_cell) + 0.5) / per_cell - 5.0
    return np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("corner", [(-5, -5), (3, -5), (-5, 3), (3, 3), (-1, 1)])
def test_the_worst_spot_is_two_by_two_cells_that_are_off_wherever_they_are(corner: tuple[int, int]) -> None:
    places = spots()
    there = ((places >= corner) & (places < np.add(corner, 2))).all(axis=1)
    share = np.where(there, -0.3, 0.0)
    assert _worst_spot(places, share) == pytest.approx(0.3)
    # noise of single pixels goes out, and what lies beside the tag does not count
    noisy = share + 0.5 * (-1.0) ** np.arange(len(places))
    assert _worst_spot(places, noisy) == pytest.approx(0.3, abs=0.06)
    assert _worst_spot(np.vstack([places, [(5.5, 0.0), (0.0, -5.5), (0.0, 5.5)]]), np.append(share, [9.0] * 3)) == pytest.approx(
        0.3
    )


def test_spots_of_few_pixels_are_none_and_a_tag_of_none_is_all_off() -> None:
    places = spots()
    at_rim = (places < -3.0).all(axis=1)
    few = np.flatnonzero(at_rim)[:3]
    kept = np.concatenate([np.flatnonzero((places >= -3.0).all(axis=1)), few])
    share = np.where(at_rim, 0.9, 0.1)
    assert _worst_spot(places, share) == pytest.approx(0.9)
    assert _worst_spot(places[kept], share[kept]) == pytest.approx(0.1)
    assert _worst_spot(np.array([(7.0, 7.0)]), np.array([0.0])) == 1.0


def test_fits_begin_at_the_pose_itself_and_through_a_lens_at_what_a_detector_without_it_has_seen() -> None:
    (only,) = _starts(TURN, SHIFT, 8.0, MATRIX, None)
    assert only[0] is TURN and only[1] is SHIFT
    lens = np.array([-0.3, 0.1, 0.001, -0.002])
    seen = np.reshape(cv2.projectPoints(SQUARE, cv2.Rodrigues(TURN)[0], SHIFT, MATRIX, lens)[0], (-1, 2))
    _, told, there = cv2.solvePnP(SQUARE, seen, MATRIX, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    starts = _starts(np.asarray(cv2.Rodrigues(told)[0]), np.ravel(there), 8.0, MATRIX, lens)
    assert len(starts) == 3
    off_mm = [np.abs(SQUARE @ turn.T + shift - (SQUARE @ TURN.T + SHIFT)).max() for turn, shift in starts]
    # the pinhole's pose is far off; of its corners as the lens shows them one is right but for what no pinhole's pose has
    assert off_mm[0] > 1.0 and min(off_mm[1:]) < 0.3 * off_mm[0]


def test_both_tilts_show_the_square_s_corners() -> None:
    points = SQUARE @ TURN.T + SHIFT
    tilts = _tilts(SQUARE, points[:, :2] / points[:, 2:])
    assert len(tilts) == 2
    assert tilts[0][0] == pytest.approx(TURN, abs=1e-4) and tilts[0][1] == pytest.approx(SHIFT, abs=1e-3)
    assert np.abs(tilts[1][0] - TURN).max() > 0.1


def test_a_tag_has_moved_by_what_its_farthest_corner_has_in_cells() -> None:
    view = View(picture=np.zeros((4, 4), dtype=np.uint8), matrix=MATRIX, lens=None, tag_id=7, cell_mm=2.0)
    before = (np.eye(3), np.array([0.0, 0.0, 50.0]))
    assert _moved_cells(view, 8.0, before, (np.eye(3), np.array([3.0, 4.0, 50.0]))) == pytest.approx(2.5)
    # twice as near corners 4 mm from the middle are seen at twice the angle: 4 mm further there, along both sides
    assert _moved_cells(view, 8.0, before, (np.eye(3), np.array([0.0, 0.0, 25.0]))) == pytest.approx(np.sqrt(2.0))
