"""Panels decided: where everything lies, and what is cut out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import shapely

from tactape_fab.base.errors import SpecError
from tactape_fab.kit.panel.geometry import Panel
from tactape_fab.kit.panel.panel_drawing import slots_mm
from tactape_fab.kit.panel.tabs_and_marks import plan_packed, plan_panel
from tactape_fab.kit.profiles import FabProfile, load_fab

FAB = load_fab("jlcpcb-fpc")


def with_rules(**values: Any) -> FabProfile:
    return replace(FAB, panel=replace(FAB.panel, **values))


def panel(
    columns: int = 2, rows: int = 2, size_mm: tuple[float, float] = (60.0, 40.0), radius_mm: float = 1.0, tabs: str = "auto"
) -> Panel:
    return plan_panel(size_mm, radius_mm, (columns, rows), tabs, FAB)


# Where everything lies


def test_the_upper_left_tape_is_the_first() -> None:
    assert panel().offsets_mm == ((7.0, 49.0), (69.0, 49.0), (7.0, 7.0), (69.0, 7.0))
    assert panel().size_mm == (136.0, 96.0)


def test_marks_are_in_the_middle_of_the_rails_and_the_last_fiducial_is_shifted() -> None:
    made, across = plan_panel((60.0, 40.0), 1.0, (2, 2), "auto", with_rules(tooling_holes=4)), FAB.panel.tooling_hole_mm
    assert made.fiducials_mm == ((6.0, 2.5), (130.0, 2.5), (6.0, 93.5), (125.0, 93.5))
    assert made.tooling_holes_mm == tuple((x, y, across) for x, y in ((2.5, 2.5), (133.5, 93.5), (133.5, 2.5), (2.5, 93.5)))


@pytest.mark.parametrize("fiducials", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("holes", [0, 2, 4])
def test_as_many_marks_and_holes_as_the_profile_asks_for(fiducials: int, holes: int) -> None:
    made = plan_panel((60.0, 40.0), 1.0, (2, 2), "auto", with_rules(fiducials=fiducials, tooling_holes=holes))
    assert (len(made.fiducials_mm), len(made.tooling_holes_mm)) == (fiducials, holes)
    discs = [shapely.Point(xy).buffer(FAB.panel.fiducial_opening_mm / 2) for xy in made.fiducials_mm]
    discs += [shapely.Point(x, y).buffer(d / 2) for x, y, d in made.tooling_holes_mm]
    rails = shapely.box(0, 0, *made.size_mm) - shapely.box(5, 5, made.size_mm[0] - 5, made.size_mm[1] - 5)
    assert all(rails.buffer(-0.5).contains(disc) for disc in discs)
    assert all(a.distance(b) >= 1.0 for i, a in enumerate(discs) for b in discs[:i])


def test_marks_without_room_are_refused() -> None:
    """Each half of a rail of 74 mm has its mark 6 mm from the side, the shift, and half an opening."""
    shift_mm = 74.0 / 2 - 6.0 - FAB.panel.fiducial_opening_mm / 2
    plan_panel((60.0, 40.0), 1.0, (1, 2), "auto", with_rules(fiducial_shift_mm=shift_mm))
    with pytest.raises(SpecError, match=r"two fiducials of its rails, one of them shifted by .* mm, need 74\.2 mm"):
        plan_panel((60.0, 40.0), 1.0, (1, 2), "auto", with_rules(fiducial_shift_mm=shift_mm + 0.1))
    plan_panel((60.0, 40.0), 1.0, (1, 2), "auto", with_rules(fiducial_shift_mm=shift_mm + 0.1, fiducials=0))


def test_tabs_of_a_packed_tape_are_on_its_sides_as_placed() -> None:
    tape = ((101.0, 50.0), 1.0)
    made = plan_packed((130.0, 230.0), [tape, tape], [((10.0, 10.0), False), ((70.0, 80.0), True)], FAB)
    flat, turned = made.places
    assert (flat.tabs_x, flat.tabs_y) == (turned.tabs_y, turned.tabs_x) == (2, 5)


# What is cut out


@pytest.mark.parametrize("arrangement", [(1, 1), (1, 2), (3, 2), (4, 5)])
@pytest.mark.parametrize(("size_mm", "radius_mm"), [((60.0, 40.0), 1.0), ((33.3, 21.7), 0.0), ((47.0, 30.0), 6.0)])
@pytest.mark.parametrize("tabs", ["auto", "x", "y", "xy"])
def test_tapes_are_whole_and_held_by_tabs_alone(
    arrangement: tuple[int, int], size_mm: tuple[float, float], radius_mm: float, tabs: str
) -> None:
    made = panel(*arrangement, size_mm, radius_mm, tabs)
    slots = [shapely.Polygon(slot) for slot in slots_mm(made)]
    assert all(slot.is_valid for slot in slots)
    cut = shapely.union_all(slots)
    assert cut.area == pytest.approx(sum(slot.area for slot in slots))
    left = shapely.box(0, 0, *made.size_mm) - cut
    assert left.geom_type == "Polygon"  # one piece: no tape falls out
    tapes = [shapely.Polygon(place.outline_mm) for place in made.places]
    assert max(tape.intersection(cut).area for tape in tapes) < 1e-4  # snapped to 1 nm
    # without its tabs, each tape would be free
    bare = [tape.buffer(2.0) - tape.buffer(1e-3) - cut for tape in tapes]
    tabs_x, tabs_y = made.places[0].tabs_x, made.places[0].tabs_y
    count = 2 * (tabs_x + tabs_y)
    assert [len([p for p in shapely.get_parts(b) if p.area > 0.5]) for b in bare] == [count] * made.count
    narrow = left.buffer(-0.49).intersection(shapely.box(5.2, 5.2, made.size_mm[0] - 5.2, made.size_mm[1] - 5.2))
    assert len(shapely.get_parts(left.buffer(-0.51))) == 1 + made.count  # a tab is 1 mm wide
    assert len(shapely.get_parts(narrow)) > 0
    assert {"x": tabs_y, "y": tabs_x}.get(tabs, 0) == 0


def test_the_ends_of_slots_are_round() -> None:
    """A cutter as wide as the gap reaches every corner of a slot."""
    for slot in slots_mm(panel(radius_mm=1.0)):
        area = shapely.Polygon(slot)
        opened = area.buffer(-0.99).buffer(0.99)
        assert area.difference(opened.buffer(0.02)).area < 0.01


def test_tabs_are_no_further_apart_than_the_profile_says() -> None:
    made = panel(1, 1, (101.0, 90.0))
    assert (made.places[0].tabs_x, made.places[0].tabs_y) == (4, 5)
