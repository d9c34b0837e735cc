"""Planning of a panel: its tabs, and the fiducials and tooling holes in its rails."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import ceil

from tactape_fab.base.errors import Problem, refuse
from tactape_fab.kit.film.drawing import Hole, Offset
from tactape_fab.kit.panel.geometry import Panel, Place, Size, grid_places, panel_size_mm
from tactape_fab.kit.plan import TOLERANCE_MM
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.texture.frames import snap_mm

_MARK_APART_MM = 1.5
_CORNERS = ((0, 0), (1, 0), (0, 1), (1, 1))
# opposite corners first, so that two tooling holes are as far apart as possible
_HOLE_CORNERS = ((0, 0), (1, 1), (1, 0), (0, 1))


def plan_panel(tape_mm: Size, tape_radius_mm: float, arrangement: tuple[int, int], tabs: str, fab: FabProfile) -> Panel:
    """Plan a panel of equal tapes in columns and rows.

    tabs: Sides of a tape with tabs: ``x`` left and right, ``y`` lower and upper, ``xy`` all, ``auto`` those with enough space.
    Raises SpecError if there is not enough space for the tabs, or for the marks in the rails.
    """
    rules = fab.panel
    counts = [_tabs_along(side_mm, tape_radius_mm, fab) for side_mm in tape_mm]
    tabs_x, tabs_y = counts[1] * (tabs in ("auto", "x", "xy")), counts[0] * (tabs in ("auto", "y", "xy"))
    size_mm = panel_size_mm(tape_mm, arrangement, rules.rail_mm, rules.gap_mm)
    places = grid_places(tape_mm, tape_radius_mm, arrangement, (rules.rail_mm, rules.gap_mm), (tabs_x, tabs_y))
    return _checked(size_mm, places, arrangement, tabs, fab)


def plan_packed(
    size_mm: Size, tapes: Sequence[tuple[Size, float]], offsets: Sequence[tuple[Offset, bool]], fab: FabProfile
) -> Panel:
    """Plan a panel of packed tapes, each with slots of its own.

    tapes (size, radius): Outlines of the tapes as boards.
    offsets (offset, turned): Their places, see `Place`, at least `FRAME_GAPS` gaps apart.
    Raises SpecError if there is not enough space for the tabs, or for the marks in the rails.
    """
    places = []
    for (tape_mm, radius_mm), (offset_mm, turned) in zip(tapes, offsets, strict=True):
        along = [_tabs_along(side_mm, radius_mm, fab) for side_mm in tape_mm]
        # tabs_y is on the lower and upper side as placed, which are the board's left and right sides if the tape is turned
        tabs_y, tabs_x = (along[1], along[0]) if turned else (along[0], along[1])
        places.append(
            Place(size_mm=tape_mm, radius_mm=radius_mm, offset_mm=offset_mm, turned=turned, tabs_x=tabs_x, tabs_y=tabs_y)
        )
    return _checked(size_mm, tuple(places), None, "auto", fab)


def _checked(size_mm: Size, places: tuple[Place, ...], grid: tuple[int, int] | None, tabs: str, fab: FabProfile) -> Panel:
    """The panel with its marks, if there is space for these and for the tabs."""
    rules = fab.panel
    problems = [
        problem
        # tapes of one size and rotation have the same problems, which are reported once
        for place in dict.fromkeys(replace(p, offset_mm=(0.0, 0.0)) for p in places)
        for problem in _tab_problems(place, tabs, fab)
    ]
    problems += _mark_problems(size_mm, fab)
    refuse(problems)
    return Panel(
        size_mm=size_mm,
        places=places,
        grid=grid,
        rail_mm=rules.rail_mm,
        gap_mm=rules.gap_mm,
        tab_mm=rules.tab_mm,
        fiducials_mm=_fiducials(size_mm, fab),
        fiducial_mm=rules.fiducial_mm,
        fiducial_opening_mm=rules.fiducial_opening_mm,
        tooling_holes_mm=_tooling_holes(size_mm, fab),
    )


def _least_side_mm(radius_mm: float, count: int, tab_mm: float, gap_mm: float) -> float:
    """Length of the shortest side with room for `count` evenly spaced tabs and the round ends of slots between its corners."""
    # n tabs are in the middles of n equal parts, the first at side / (2 n) from the corner, which has to be at least corner
    # radius, half a tab and the round end of a slot: (2 r + tab + gap) / 2
    return count * (2 * radius_mm + tab_mm + gap_mm)


def _tabs_along(side_mm: float, radius_mm: float, fab: FabProfile) -> int:
    """Number of tabs of a side, no farther apart than the profile's limit if there is room; 0 without room for any."""
    rules = fab.panel
    # 1e-9: a side of exactly n pitches has n tabs
    wanted = ceil(side_mm / rules.tab_pitch_mm - 1e-9)
    fitting = (
        n for n in range(wanted, 0, -1) if _least_side_mm(radius_mm, n, rules.tab_mm, rules.gap_mm) <= side_mm + TOLERANCE_MM
    )
    return next(fitting, 0)


def _tab_problems(place: Place, tabs: str, fab: FabProfile) -> Iterator[Problem]:
    (width, height), rules = place.extent_mm, fab.panel
    sides = {"x": ("left and right", height, place.tabs_x), "y": ("lower and upper", width, place.tabs_y)}
    without = [name for name, (_, _, count) in sides.items() if count == 0]
    if tabs == "auto":
        without = without if len(without) == len(sides) else []
    least_mm = _least_side_mm(place.radius_mm, 1, rules.tab_mm, rules.gap_mm)
    for name in without:
        if name in tabs or tabs == "auto":
            words, side_mm, _ = sides[name]
            other = "y" if name == "x" else "x"
            remedy = f"use --tabs {other}, " if sides[other][2] or tabs == name else "use "
            yield Problem(
                "tabs",
                f"tabs = '{tabs}': the {words} sides of {side_mm:g} mm have no room for a tab of {rules.tab_mm:g} mm, which "
                f"between corners of {place.radius_mm:g} mm and the ends of slots of {rules.gap_mm:g} mm needs "
                f"{least_mm:g} mm; "
                f"{remedy}a larger --size or a smaller --corner-radius",
            )


def _first_mark_mm(fab: FabProfile) -> float:
    """Distance of a fiducial from the panel's side, past the tooling hole of the corner."""
    rules = fab.panel
    # the hole's centre, its radius, the space between, and the radius of the fiducial's opening
    return rules.rail_mm / 2 + (rules.tooling_hole_mm + rules.fiducial_opening_mm) / 2 + _MARK_APART_MM


def _mark_problems(size_mm: Size, fab: FabProfile) -> Iterator[Problem]:
    rules = fab.panel
    # each of the two marks of a rail, also the shifted one, has to be in its half of the rail
    needed_mm = 2 * (_first_mark_mm(fab) + rules.fiducial_shift_mm + rules.fiducial_opening_mm / 2)
    if rules.fiducials and size_mm[0] < needed_mm:
        message = (
            f"panel is {size_mm[0]:g} mm wide, but two fiducials of its rails, one of them shifted by "
            f"{rules.fiducial_shift_mm:g} mm, need {needed_mm:g} mm; use more columns of tapes"
        )
        yield Problem("panel", message)


def _fiducials(size_mm: Size, fab: FabProfile) -> tuple[Offset, ...]:
    """A fiducial in each corner; the last is shifted, so that a rotated panel is recognised."""
    corners = _CORNERS[: fab.panel.fiducials]
    first, middle = _first_mark_mm(fab), fab.panel.rail_mm / 2
    marks = []
    for n, (right, upper) in enumerate(corners, start=1):
        x = first + (fab.panel.fiducial_shift_mm if n == len(corners) else 0.0)
        marks.append((float(snap_mm(size_mm[0] - x if right else x)), float(snap_mm(size_mm[1] - middle if upper else middle))))
    return tuple(marks)


def _tooling_holes(size_mm: Size, fab: FabProfile) -> tuple[Hole, ...]:
    middle = fab.panel.rail_mm / 2
    return tuple(
        (
            float(snap_mm(size_mm[0] - middle if right else middle)),
            float(snap_mm(size_mm[1] - middle if upper else middle)),
            fab.panel.tooling_hole_mm,
        )
        for right, upper in _HOLE_CORNERS[: fab.panel.tooling_holes]
    )
