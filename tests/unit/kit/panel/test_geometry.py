"""A tape's place on a panel, turned or not: p_panel = offset + R p_board."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from tactape_fab.base.fields import Fields
from tactape_fab.kit.panel.geometry import Place, read_panel_record


@pytest.mark.parametrize(
    ("turned", "offset_mm", "extent_mm", "low_mm", "corner_mm"),
    [
        (False, (10.0, 7.0), (60.0, 40.0), (10.0, 7.0), (70.0, 47.0)),
        (True, (50.0, 7.0), (40.0, 60.0), (10.0, 7.0), (10.0, 67.0)),
    ],
)
def test_a_place_is_a_rotation_and_a_shift(
    turned: bool,
    offset_mm: tuple[float, float],
    extent_mm: tuple[float, float],
    low_mm: tuple[float, float],
    corner_mm: tuple[float, float],
) -> None:
    place = Place(size_mm=(60.0, 40.0), radius_mm=1.0, offset_mm=offset_mm, turned=turned)
    assert (place.rotation_deg, place.extent_mm, place.low_mm) == (90.0 * turned, extent_mm, low_mm)
    assert place.on_panel_mm(np.array([0.0, 0.0])) == offset_mm
    assert place.on_panel_mm(np.array([60.0, 40.0])) == corner_mm
    assert place.outline_mm.min(axis=0) == pytest.approx(low_mm)
    assert place.outline_mm.max(axis=0) == pytest.approx(np.add(low_mm, extent_mm))


GRID = {
    **{"columns": 3, "rows": 2, "tape_mm": [60.0, 40.0], "tape_radius_mm": 1.0, "rail_mm": 5.0, "gap_mm": 2.0, "tab_mm": 1.0},
    **{"tabs_x": 2, "tabs_y": 0, "fiducials_mm": [[6.0, 2.5]], "fiducial_mm": 1.0, "fiducial_opening_mm": 2.0},
    **{"tooling_holes_mm": [[2.5, 2.5, 2.0]], "size_mm": [198.0, 96.0], "corner_radius_mm": 1.0},
}
FIRST, SECOND = (
    {"size_mm": [60.0, 40.0], "radius_mm": 1.0, "offset_mm": [x, 7.0], "turned": x > 40, "tabs_x": 2, "tabs_y": 3}
    for x in (7.0, 113.0)
)
PACKED = {
    "places": [FIRST, SECOND],
    **{
        key: value
        for key, value in GRID.items()
        if key not in ("columns", "rows", "tape_mm", "tape_radius_mm", "tabs_x", "tabs_y")
    },
}


def test_a_grid_is_in_reading_order_with_a_slot_around_every_tape() -> None:
    """3 columns of 60 mm and 4 slots of 2 mm within rails of 5 mm are 198 mm; 2 rows of 40 mm and 3 slots 96 mm."""
    panel = read_panel_record(Fields(GRID))
    assert panel.size_mm == (198.0, 96.0) and panel.count == 6 and panel.words == "3 x 2 tapes"
    assert panel.offsets_mm == tuple((x, y) for y in (49.0, 7.0) for x in (7.0, 69.0, 131.0))
    assert {(place.tabs_x, place.tabs_y, place.radius_mm) for place in panel.places} == {(2, 0, 1.0)}


@pytest.mark.parametrize("record", [GRID, PACKED], ids=["grid", "packed"])
def test_a_record_is_read_as_it_was_written(record: dict[str, Any]) -> None:
    panel = read_panel_record(Fields(record))
    assert json.loads(json.dumps(panel.to_mapping())) == record
    others = [
        {**record, "rail_mm": 6.0},
        {**record, "fiducials_mm": []},
        {**PACKED, "places": []},
        {**PACKED, "size_mm": [9.0, 9.0]},
    ]
    assert len({panel.key, *(read_panel_record(Fields(other)).key for other in others)}) == 5


def test_words_of_a_packed_panel_count_its_turned_tapes() -> None:
    words = [read_panel_record(Fields({**PACKED, "places": places})).words for places in ([FIRST], [FIRST, SECOND])]
    assert words == ["1 tape", "2 tapes (1 turned)"]


@pytest.mark.parametrize(
    ("record", "change", "says"),
    [
        (GRID, {"rail_mm": 100.1}, "rail_mm = 100.1 mm exceeds 100"),
        (GRID, {"gap_mm": 0.0}, "gap_mm = 0 mm is not above 0"),
        (GRID, {"columns": 0}, "columns = 0 is outside 1 to"),
        (GRID, {"tabs_y": 61}, "tabs_y = 61 is outside 0 to 60"),
        (GRID, {"tape_radius_mm": 20.1}, "tape_radius_mm = 20.1 mm exceeds 20"),
        (GRID, {"fiducials_mm": [[1.0]]}, "fiducials_mm[0] = [1.0] is not 2 numbers"),
        (GRID, {"tooling_holes_mm": [[1.0, -1.0, 2.0]]}, "tooling_holes_mm[0][1] = -1 mm is below 0"),
        (PACKED, {"size_mm": [0.0, 1.0]}, "size_mm[0] = 0 mm is not above 0"),
        (PACKED, {"places": [{**FIRST, "radius_mm": 20.1}]}, "places[0].radius_mm = 20.1 mm exceeds 20"),
        (PACKED, {"places": [{**FIRST, "size_mm": [20.0, 0.0]}]}, "places[0].size_mm[1] = 0 mm is not above 0"),
        (PACKED, {"places": [{**FIRST, "size_mm": [1e4, 10.0], "tabs_x": 1001}]}, "places[0].tabs_x = 1001 is outside 0 to 1000"),
        (PACKED, {"places": [FIRST, {**FIRST, "tabs_x": 61}]}, "places[1].tabs_x = 61 is outside 0 to 60"),
        (PACKED, {"places": [{**FIRST, "tabs_y": -1}]}, "places[0].tabs_y = -1 is outside 0 to 60"),
        (PACKED, {"places": [3]}, "places[0].offset_mm is missing"),
    ],
)
def test_what_is_no_panel_is_named(record: dict[str, Any], change: dict[str, Any], says: str) -> None:
    table = Fields({**record, **change})
    read_panel_record(table)
    assert says in "\n".join(problem.message for problem in table.problems)
