"""Tapes packed into sheets: nothing overlaps or hangs over, as few sheets as can be, and the same every time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactape_fab.base.errors import SpecError
from tactape_fab.kit.panel.packing import Packing, misfit, pack, pack_panels, sheet_room_mm
from tactape_fab.kit.profiles import load_fab
from tactape_fab.texture.frames import FloatArray
from tests.thorough import some

SHEET_MM = (236.0, 236.0)
SIZE = st.tuples(st.integers(50, 2360), st.integers(50, 2360)).map(lambda size: (size[0] / 10, size[1] / 10))


def corners_mm(packing: Packing) -> FloatArray:
    """Lower left and upper right corner of every tape on its sheet, from its offset and turn alone; shape (n, 2, 2)."""
    width, height = packing.sizes_mm.T
    board = np.stack([np.zeros((len(width), 2)), np.stack([width, height], axis=1)], axis=1)
    turned = np.stack([-board[..., 1], board[..., 0]], axis=-1)
    placed = np.where(packing.turned[:, None, None], turned, board) + packing.offset_mm[:, None]
    return np.stack([placed.min(axis=1), placed.max(axis=1)], axis=1)


def assert_packed(packing: Packing, gap_mm: float, sheet_mm: tuple[float, float] = SHEET_MM) -> None:
    box = corners_mm(packing)
    assert (box[:, 0] >= -1e-9).all()
    assert (box[:, 1] <= np.array(sheet_mm) + 1e-9).all()
    assert np.allclose(box[:, 0], packing.xy_mm)
    apart = np.maximum(box[:, None, 0] - box[None, :, 1], box[None, :, 0] - box[:, None, 1]).max(axis=2)
    same_sheet = packing.sheet[:, None] == packing.sheet[None]
    np.fill_diagonal(same_sheet, False)
    assert (apart[same_sheet] >= gap_mm - 1e-6).all()
    assert set(packing.sheet.tolist()) == set(range(packing.sheets))


def areas_mm2(packing: Packing) -> FloatArray:
    """Area of the tapes on each sheet; shape (sheets,)."""
    return np.bincount(packing.sheet, weights=packing.sizes_mm.prod(axis=1)).astype(np.float64)


@settings(max_examples=some(100))
@given(st.lists(SIZE, min_size=1, max_size=25), st.sampled_from([0.0, 2.0, 3.3]))
def test_tapes_keep_their_gap_and_their_sheet(sizes: list[tuple[float, float]], gap_mm: float) -> None:
    packing = pack(sizes, SHEET_MM, gap_mm)
    assert_packed(packing, gap_mm)
    assert np.array_equal(packing.sizes_mm, np.array(sizes))
    area = areas_mm2(packing)
    assert np.isclose(area.sum(), np.prod(sizes, axis=1).sum())
    assert (np.diff(area) <= 1e-6).all(), "the fullest sheet comes first"
    again = pack(sizes, SHEET_MM, gap_mm)
    assert np.array_equal(packing.offset_mm, again.offset_mm) and np.array_equal(packing.sheet, again.sheet)


@pytest.mark.parametrize("seed", range(5))
def test_gaps_do_not_make_a_sheet_fuller(seed: int) -> None:
    """Many small tapes take more room than one large one of their area."""
    rng = np.random.default_rng(seed)
    sizes = [(float(width), float(height)) for width, height in rng.uniform(10.0, 230.0, (24, 2)).round(1)]
    assert (np.diff(areas_mm2(pack(sizes, SHEET_MM, 3.3))) <= 1e-6).all()


@pytest.mark.parametrize(
    ("size_mm", "sheet_mm", "gap_mm", "on_a_sheet"),
    [
        ((100.0, 50.0), SHEET_MM, 2.0, 8),
        ((50.0, 100.0), SHEET_MM, 2.0, 8),
        ((236.0, 236.0), SHEET_MM, 2.0, 1),
        ((236.0, 117.0), SHEET_MM, 2.0, 2),
        ((117.0, 236.0), SHEET_MM, 2.0, 2),
        ((20.0, 20.0), (64.0, 42.0), 2.0, 6),
    ],
)
def test_equal_tapes_fill_a_sheet(
    size_mm: tuple[float, float], sheet_mm: tuple[float, float], gap_mm: float, on_a_sheet: int
) -> None:
    packing = pack([size_mm] * (on_a_sheet + 1), sheet_mm, gap_mm)
    assert_packed(packing, gap_mm, sheet_mm)
    assert np.bincount(packing.sheet).tolist() == [on_a_sheet, 1]


def test_tapes_of_one_size_lie_in_reading_order() -> None:
    packing = pack([(100.0, 50.0)] * 20, SHEET_MM, 2.0)
    places = list(zip(packing.sheet, -packing.xy_mm[:, 1], packing.xy_mm[:, 0], strict=True))
    assert places == sorted(places)


def test_a_small_tape_takes_the_room_that_large_ones_leave() -> None:
    sizes = [(150.0, 236.0), (84.0, 100.0), (84.0, 134.0)]
    assert pack(sizes, SHEET_MM, 2.0).sheets == 1
    # 120 and 110 mm beside each other, 220 x 90 mm above them
    assert pack([(120.0, 130.0), (220.0, 90.0), (30.0, 30.0), (110.0, 140.0)], (240.0, 240.0), 0.0).sheets == 1


@pytest.mark.parametrize("sizes", [[], [(237.0, 10.0)], [(10.0, 237.0)], [(100.0, 50.0), (300.0, 300.0)]])
def test_what_fits_no_sheet_is_refused(sizes: list[tuple[float, float]]) -> None:
    with pytest.raises(SpecError):
        pack(sizes, SHEET_MM, 2.0)


def test_a_long_tape_lies_along_a_long_sheet() -> None:
    packing = pack([(30.0, 300.0)], (310.0, 40.0), 2.0)
    assert packing.turned.tolist() == [True]
    assert_packed(packing, 2.0, (310.0, 40.0))


def test_the_room_of_a_panel_is_without_rails_and_gaps() -> None:
    fab = load_fab("generic-fpc")
    assert sheet_room_mm(fab) == SHEET_MM
    assert misfit((236.0, 236.0), fab) is None
    problem = misfit((50.0, 237.0), fab)
    assert problem is not None
    assert "50 x 237 mm does not fit into 236 x 236 mm" in problem.message


def test_a_panel_is_no_larger_than_the_boards_that_the_fab_makes() -> None:
    usual = load_fab("generic-fpc")
    fab = replace(usual, size=replace(usual.size, largest_mm=(200.0, 150.0)))
    assert sheet_room_mm(fab) == (186.0, 136.0)
    assert misfit((186.0, 136.0), fab) is None
    problem = misfit((187.0, 50.0), fab)
    assert problem is not None
    assert "186 x 136 mm, the room on a panel of 200 x 150 mm" in problem.message
    _, panels = pack_panels([((90.0, 60.0), 1.0)] * 5, fab)
    assert [max(packed.panel.size_mm) <= 200.0 and min(packed.panel.size_mm) <= 150.0 for packed in panels] == [True, True]
    # longer than the room is high: there is one way for it to lie
    (packed,) = pack_panels([((180.0, 20.0), 1.0), ((30.0, 20.0), 1.0)], fab)[1]
    assert packed.panel.size_mm == (194.0, 70.0)


def test_a_panel_is_its_tapes_their_slots_and_the_rails() -> None:
    """Rails of 5 mm, slots of 2 mm, and between two slots a web of 2 mm."""
    (packed,) = pack_panels([((60.0, 40.0), 1.0)] * 2, load_fab("generic-fpc"))[1]
    assert packed.panel.size_mm == (60.0 + 2 * (5 + 2), 2 * 40.0 + 3 * 2 + 2 * (5 + 2))
    assert [place.offset_mm for place in packed.panel.places] == [(7.0, 53.0), (7.0, 7.0)]
