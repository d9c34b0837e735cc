"""The map of a tape: what stands where on the picture, and what its legend says."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.verify.trip import coverage as coverage_module
from tactape_fab.verify.trip import limit
from tactape_fab.verify.trip import map as map_module
from tactape_fab.verify.trip.coverage import TURNS, Coverage, coverage_of
from tactape_fab.verify.trip.map import Picture, draw_map, refuse_map
from tactape_fab.verify.trip.round_trip import BARELY, LIMITED, LOST, MISSED, NOISY, RIGHT, WRONG, Trip, read_contact
from tests.tapes import tape_at

TAPE = tape_at(7, (20, 10))
WIDTH_MM, HEIGHT_MM = TAPE.board.size_mm
PX_PER_MM = 1200 / WIDTH_MM
CONTACT = read_contact(size=(8.0, 4.0))
# upper left anywhere, upper right at some angles, all of the lower half nowhere
SHARES = Coverage(x_mm=np.array([5.0, 25.0]), y_mm=np.array([2.0, 12.0]), share=np.array([[1.0, 0.5], [0.0, 0.0]]))


def trip(source: str, *contacts: tuple[int, float, float]) -> Trip:
    """Contacts of outcomes at texture places, mm."""
    poses = np.array([(x, y, 0.0) for _, x, y in contacts]).reshape(-1, 3)
    outcome = np.array([outcome for outcome, _, _ in contacts], dtype=np.int64)
    return Trip(source=source, poses=poses, outcome=outcome, error_um=np.zeros(len(contacts)), reasons=Counter())


def drawn(trips: Sequence[Trip] = (), size: tuple[float, float] | str = (8.0, 4.0)) -> Picture:
    return draw_map(TAPE, SHARES, read_contact(size=size), trips)


def board_of(picture: Picture) -> Picture:
    """The board's pixels, which lie below two lines of words and between margins."""
    return picture[80 : 80 + round(HEIGHT_MM * PX_PER_MM), 60:1260]


def colours_at(picture: Picture, x_mm: float, y_mm: float, reach_px: int = 1) -> set[tuple[int, ...]]:
    """Colours around a place, board frame."""
    u, v = round(x_mm * PX_PER_MM), round((HEIGHT_MM - y_mm) * PX_PER_MM)
    near = board_of(picture)[v - reach_px : v + reach_px + 1, u - reach_px : u + reach_px + 1]
    return {tuple(colour) for colour in near.reshape(-1, 3).tolist()}


def test_areas_and_parts_are_where_they_are_on_the_board() -> None:
    picture = drawn()
    assert picture.shape == (80 + round(HEIGHT_MM * PX_PER_MM) + 60 + 4 * 30, 1320, 3)
    assert not (board_of(picture) == 255).all(axis=2)[:, :20].any() and (picture[:, :10] == 255).all()
    # between the parts of the field, a hatch apart from each other
    for x_mm, y_mm, plain, hatched in [
        (WIDTH_MM * 0.25, HEIGHT_MM - 1.0, map_module._ALL, False),
        (WIDTH_MM * 0.75, HEIGHT_MM - 1.0, map_module._SOME, True),
        (WIDTH_MM * 0.25, 1.0, map_module._NONE, True),
    ]:
        found = colours_at(picture, x_mm, y_mm, 10)
        dark = tuple(int(0.7 * c) for c in plain)
        assert found == ({plain, dark} if hatched else {plain})
    v, u = np.indices((32, 32))
    up, down = (u + v) % 16 < 2, (u - v) % 16 < 2
    for share, plain, lines in ((0.5, map_module._SOME, up), (0.0, map_module._NONE, up | down)):
        assert np.array_equal((map_module._hatched(np.full(u.shape, share)) != np.array(plain)).any(axis=2), lines)
    parts = np.array([map_module._PART in colours_at(picture, x, y) for x, y in TAPE.part_xy_mm()])
    # the ring of a contact, to scale, hides some
    assert parts.mean() > 0.9


@pytest.mark.parametrize(
    ("outcome", "inside", "rim", "beside"),
    [
        (RIGHT, map_module._GOOD, map_module._GOOD, None),
        (LIMITED, map_module._WHITE, map_module._OPEN, None),
        (NOISY, map_module._OPEN, map_module._OPEN, "across"),
        (BARELY, map_module._OPEN, map_module._OPEN, "across"),
        (MISSED, map_module._OPEN, map_module._OPEN, "both"),
        (LOST, map_module._BAD, None, "ring"),
        (WRONG, map_module._BAD, None, "slanted"),
    ],
)
def test_contacts_are_marked_at_their_place(
    outcome: int, inside: tuple[int, int, int], rim: tuple[int, int, int] | None, beside: str | None
) -> None:
    picture = drawn([trip("CPL", (outcome, 10.5, 3.0))])
    # texture y is down from the origin, which is 3 mm right of the board's left edge and 3 mm below its upper one
    x_mm, y_mm = 3.0 + 10.5, HEIGHT_MM - 3.0 - 3.0
    assert inside in colours_at(picture, x_mm, y_mm, 0)
    changed = (board_of(picture) != board_of(drawn())).any(axis=2)
    # pixels have their middles half a pixel from the corner that board coordinates count from
    middle = np.argwhere(changed)[:, ::-1].mean(axis=0) + 0.5
    assert middle == pytest.approx(np.multiply((x_mm, HEIGHT_MM - y_mm), PX_PER_MM), abs=0.6)

    def at(right_px: int, up_px: int) -> set[tuple[int, ...]]:
        return colours_at(picture, x_mm + right_px / PX_PER_MM, y_mm + up_px / PX_PER_MM, 0)

    if rim is not None:
        assert rim in (at(3, 2) if rim == map_module._GOOD else at(4, 3))
    assert (map_module._OPEN in at(8, 0)) == (beside in ("across", "both")) and (map_module._OPEN in at(0, 8)) == (
        beside == "both"
    )
    assert (map_module._BAD in at(12, 0)) == (beside == "ring")
    assert all((map_module._BAD in at(7 * a, 7 * b)) == (beside in ("ring", "slanted")) for a in (1, -1) for b in (1, -1))


def test_the_legend_counts_the_contacts_of_each_outcome_and_names_their_sources() -> None:
    trips = [trip("CPL", (RIGHT, 5.0, 5.0), (RIGHT, 9.0, 5.0), (WRONG, 5.0, 5.0)), trip("copper", (RIGHT, 5.0, 5.0))]
    rows = map_module._legend(CONTACT, trips)
    assert [swatch for swatch, _ in rows] == [1.0, 0.5, 0.0, map_module._SIZE, RIGHT, WRONG]
    assert [text for _, text in rows[4:]] == [
        "located and right in the round trip (3 contacts; parts from CPL, copper)",
        "located elsewhere: wrong (1 contact; parts from CPL)",
    ]
    # the whole pad has no size to be drawn
    assert [swatch for swatch, _ in map_module._legend(read_contact(size="pad"), [])] == [1.0, 0.5, 0.0]


def test_the_words_tell_how_much_of_the_board_is_of_use() -> None:
    first, second = map_module._words(replace(TAPE, name="tape-é"), SHARES, CONTACT)
    assert first == "tape-?: where contacts of 8 x 4 mm of gelsight-mini can be located"
    assert second == "at any angle on 25 %, at some on 25 %, nowhere on 50 % of the board"
    assert "where the whole pad of" in map_module._words(TAPE, SHARES, read_contact(size="pad"))[0]


def test_a_contact_is_drawn_to_scale() -> None:
    """An ellipse of 8 x 4 mm in the lower right corner, and none of a whole pad."""
    ring = (board_of(drawn()) != board_of(drawn(size="pad"))).any(axis=2)
    v, u = np.nonzero(ring)
    # its line is some pixels wide
    size_px = [u.max() - u.min(), v.max() - v.min()]
    assert size_px == pytest.approx([8.0 * PX_PER_MM, 4.0 * PX_PER_MM], abs=10)
    assert 1200 - u.max() < 15 and ring.shape[0] - v.max() < 15


@pytest.mark.parametrize(("px_per_mm", "step_mm"), [(70.0, 1), (60.0, 1), (59.9, 2), (12.0, 5), (2.0, 50), (1.0, 100)])
def test_ticks_are_as_far_apart_as_their_figures_need(px_per_mm: float, step_mm: int, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[tuple[str, tuple[int, int]]] = []
    monkeypatch.setattr(map_module, "_text", lambda _, text, at, _size: said.append((text.strip(), at)))
    size_mm = (2.5 * step_mm, 1.5 * step_mm)
    map_module._draw_scale(np.zeros((400, 400, 3), dtype=np.uint8), size_mm, px_per_mm, (60, 20))
    bottom = 20 + round(size_mm[1] * px_per_mm)
    along = [(f"{k * step_mm}" if k else "0 mm", (round(60 + k * step_mm * px_per_mm) - 6, bottom + 22)) for k in range(3)]
    up = [(f"{k * step_mm}", (14, round(bottom - k * step_mm * px_per_mm) + 5)) for k in range(2)]
    assert said == along + up


def test_places_of_a_map_are_even_over_the_board(monkeypatch: pytest.MonkeyPatch) -> None:
    """Texture frame, rows from the upper edge; located here is what lies above the middle of the board, whatever its angle."""
    told: list[tuple[str, int, int]] = []
    angles: list[float] = []

    def error_free(_rule: object, pose: np.ndarray, _scene: object) -> object:
        angles.append(float(pose[2]))
        located = pose[1] < HEIGHT_MM / 2 - 3.0 and (pose[0] < WIDTH_MM / 2 - 3.0 or len(angles) % TURNS == 0)
        return type("Fix", (), {"located": located})

    monkeypatch.setattr(coverage_module, "_PLACES", 32)
    monkeypatch.setattr(limit, "error_free", error_free)
    monkeypatch.setattr(limit, "rule_of", lambda *_: None)
    found = coverage_of(TAPE, CONTACT, lambda *words: told.append(words))
    assert found.share.shape == (4, 7)
    edges = np.arange(8) * WIDTH_MM / 7
    assert found.x_mm == pytest.approx((edges[1:] + edges[:-1]) / 2 - 3.0)
    assert found.y_mm == pytest.approx((np.arange(4) + 0.5) * HEIGHT_MM / 4 - 3.0)
    assert (found.share[:2, :3] == 1.0).all() and (found.share[2:] == 0.0).all()
    assert found.share[:2, 4:] == pytest.approx(1 / TURNS)
    assert told[0] == ("map: place", 1, 28) and told[-1] == ("map: place", 28, 28)
    # an ellipse repeats after half a turn, which the angles of a place divide evenly
    turns = np.sort(np.array(angles).reshape(-1, TURNS) % 180.0, axis=1)
    assert np.diff(turns, axis=1) == pytest.approx(180.0 / TURNS) and min(angles) >= -180.0 and max(angles) < 180.0
    # neighbouring places are tried at other angles
    assert len(np.unique(turns[:, 0].round(3))) == 28


@pytest.mark.parametrize(
    ("name", "says"),
    [("kit/map.png", "lies in the kit"), ("map.jpg", "does not end with .png"), ("kit/../map.png", ""), ("map.png", "")],
)
def test_a_map_lies_beside_its_kit(name: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "kit").mkdir()
    (tmp_path / "kit" / "manifest.json").write_text("{}")
    if says:
        with pytest.raises(SpecError, match=says):
            refuse_map(tmp_path / "kit", tmp_path / name)
    else:
        assert refuse_map(tmp_path / "kit", tmp_path / name) == tmp_path / name
