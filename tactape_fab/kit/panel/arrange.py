"""Panel: tapes of one size in columns and rows within rails, held by tabs, with fiducials and tooling holes for assembly.

Frame: x right, y up from the panel's lower left corner, mm. A slot of the gap's width surrounds every tape, interrupted by tabs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from math import ceil
from typing import Any

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import Fields
from tactape_fab.kit.film.drawing import Hole, Offset
from tactape_fab.kit.plan import TOLERANCE_MM
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.kit.spec.panel_options import MOST_ALONG
from tactape_fab.texture.frames import FloatArray, snap_mm
from tactape_fab.texture.shapes import outline_corner_points, rounded_rectangle

CORNER_RADIUS_MM = 1.0
_MARK_APART_MM = 1.5
_CORNERS = ((0, 0), (1, 0), (0, 1), (1, 1))
_HOLE_CORNERS = ((0, 0), (1, 1), (1, 0), (0, 1))

Size = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """Geometry of a panel.

    Attributes
    ----------
    columns, rows : int
    tape_mm, tape_radius_mm
        Outline of every tape.
    rail_mm, gap_mm, tab_mm : float
        Widths of the rails, of the slot round every tape, and of a tab.
    tabs_x, tabs_y : int
        Number of tabs on each left and right, and on each lower and upper side of a tape.
    fiducials_mm : tuple of (x, y)
    fiducial_mm, fiducial_opening_mm : float
        Diameters of their copper and of its opening.
    tooling_holes_mm : tuple of (x, y, diameter)
    """

    columns: int
    rows: int
    tape_mm: Size
    tape_radius_mm: float
    rail_mm: float
    gap_mm: float
    tab_mm: float
    tabs_x: int
    tabs_y: int
    fiducials_mm: tuple[Offset, ...]
    fiducial_mm: float
    fiducial_opening_mm: float
    tooling_holes_mm: tuple[Hole, ...]

    @property
    def count(self) -> int:
        return self.columns * self.rows

    @property
    def size_mm(self) -> Size:
        return panel_size_mm(self.tape_mm, (self.columns, self.rows), self.rail_mm, self.gap_mm)

    @property
    def offsets_mm(self) -> tuple[Offset, ...]:
        """Lower left corner of every tape, in reading order: the upper left tape first."""
        (width, height), start = self.tape_mm, self.rail_mm + self.gap_mm
        return tuple(
            (float(snap_mm(start + c * (width + self.gap_mm))), float(snap_mm(start + r * (height + self.gap_mm))))
            for r in reversed(range(self.rows))
            for c in range(self.columns)
        )

    @property
    def outline_mm(self) -> FloatArray:
        return outline_of(self.size_mm, CORNER_RADIUS_MM)

    @property
    def tape_outline_mm(self) -> FloatArray:
        """A tape's outline in its own frame."""
        return outline_of(self.tape_mm, self.tape_radius_mm)

    def to_mapping(self) -> dict[str, Any]:
        """The panel as its manifest records it."""
        return {**asdict(self), "size_mm": self.size_mm, "corner_radius_mm": CORNER_RADIUS_MM}


def outline_of(size_mm: Size, radius_mm: float) -> FloatArray:
    return rounded_rectangle(size_mm, radius_mm, outline_corner_points(radius_mm)) + np.array(size_mm) / 2


def panel_size_mm(tape_mm: Size, arrangement: tuple[int, int], rail_mm: float, gap_mm: float) -> Size:
    """Outline of a panel with so many columns and rows."""
    width, height = (
        float(snap_mm(2 * rail_mm + gap_mm + n * (side + gap_mm))) for side, n in zip(tape_mm, arrangement, strict=True)
    )
    return width, height


# Choice of the arrangement


def within(size_mm: Size, fab: FabProfile) -> bool:
    """Whether assembly and fab accept a board of this size."""
    longer, shorter = max(size_mm), min(size_mm)
    least, most, board = fab.panel.smallest_mm, fab.panel.largest_mm, fab.size.largest_mm
    largest = (min(most[0], board[0]), min(most[1], board[1]))
    above = longer >= least[0] - TOLERANCE_MM and shorter >= least[1] - TOLERANCE_MM
    return above and longer <= largest[0] + TOLERANCE_MM and shorter <= largest[1] + TOLERANCE_MM


def arrangements(tape_mm: Size, fab: FabProfile) -> list[tuple[int, int]]:
    """Every arrangement that fab and assembly accept: the fewest tapes first, then the smallest area, then the squarest."""
    longest = min(fab.panel.largest_mm[0], fab.size.largest_mm[0])
    columns, rows = (min(MOST_ALONG, int(longest // side)) for side in tape_mm)
    sizes = {
        (c, r): panel_size_mm(tape_mm, (c, r), fab.panel.rail_mm, fab.panel.gap_mm)
        for c in range(1, columns + 1)
        for r in range(1, rows + 1)
    }
    fitting = [pair for pair, size in sizes.items() if within(size, fab)]
    return sorted(fitting, key=lambda p: (p[0] * p[1], sizes[p][0] * sizes[p][1], max(sizes[p]), p))


def choose_arrangement(tape_mm: Size, fab: FabProfile, count: int | None) -> tuple[int, int]:
    """The arrangement of the fewest tapes that assembly accepts, or of exactly `count`.

    Raises
    ------
    SpecError
        If there is no such arrangement.
    """
    fitting = arrangements(tape_mm, fab)
    size = f"{tape_mm[0]:g} x {tape_mm[1]:g} mm"
    if not fitting:
        width, height = panel_size_mm(tape_mm, (1, 1), fab.panel.rail_mm, fab.panel.gap_mm)
        message = (
            f"panel = 'auto': tapes of {size} fit on no panel: one with its rails is {width:g} x {height:g} mm, and "
            f"{_takes(fab)}; use another --size, or --panel none"
        )
        raise SpecError(Problem("panel", message))
    matching = [pair for pair in fitting if count is None or pair[0] * pair[1] == count]
    if not matching:
        known = sorted({c * r for c, r in fitting})
        near = ", ".join(str(n) for n in sorted(known, key=lambda n: abs(n - (count or 0)))[:3])
        message = (
            f"panel = 'auto': {count} tapes of {size} fill no panel that {fab.name} takes; name another number of --sectors, "
            f"such as {near}"
        )
        raise SpecError(Problem("panel", message))
    return matching[0]


def _takes(fab: FabProfile) -> str:
    least, most, board = fab.panel.smallest_mm, fab.panel.largest_mm, fab.size.largest_mm
    return (
        f"assembly at {fab.name} takes {least[0]:g} x {least[1]:g} to {most[0]:g} x {most[1]:g} mm, "
        f"the fab boards of up to {board[0]:g} x {board[1]:g} mm"
    )


def arrangement_problem(tape_mm: Size, arrangement: tuple[int, int], fab: FabProfile) -> Problem | None:
    """Problems of a panel of so many columns and rows of tapes at this fab."""
    size = panel_size_mm(tape_mm, arrangement, fab.panel.rail_mm, fab.panel.gap_mm)
    if within(size, fab):
        return None
    count = arrangement[0] * arrangement[1]
    fitting = sorted(arrangements(tape_mm, fab), key=lambda p: abs(p[0] * p[1] - count))
    remedy = f"use --panel {fitting[0][0]}x{fitting[0][1]}" if fitting else "use another --size, or --panel none"
    said = f"panel = {arrangement[0]}x{arrangement[1]} of {tape_mm[0]:g} x {tape_mm[1]:g} mm tapes"
    return Problem("panel", f"{said} is {size[0]:g} x {size[1]:g} mm, but {_takes(fab)}; {remedy}")


# Geometry


def plan_panel(tape_mm: Size, tape_radius_mm: float, arrangement: tuple[int, int], tabs: str, fab: FabProfile) -> Panel:
    """Decide a panel.

    Parameters
    ----------
    tabs : str
        Sides of a tape with tabs: ``x`` left and right, ``y`` lower and upper, ``xy`` all, ``auto`` those with enough space.

    Raises
    ------
    SpecError
        If there is not enough space for the tabs, or for the marks in the rails.
    """
    rules = fab.panel
    counts = [_tabs_along(side_mm, tape_radius_mm, fab) for side_mm in tape_mm]
    panel = Panel(
        columns=arrangement[0],
        rows=arrangement[1],
        tape_mm=tape_mm,
        tape_radius_mm=tape_radius_mm,
        rail_mm=rules.rail_mm,
        gap_mm=rules.gap_mm,
        tab_mm=rules.tab_mm,
        tabs_x=counts[1] if tabs in ("auto", "x", "xy") else 0,
        tabs_y=counts[0] if tabs in ("auto", "y", "xy") else 0,
        fiducials_mm=(),
        fiducial_mm=rules.fiducial_mm,
        fiducial_opening_mm=rules.fiducial_opening_mm,
        tooling_holes_mm=(),
    )
    problems = [*_tab_problems(panel, tabs), *_mark_problems(panel, fab)]
    if problems:
        raise SpecError(problems)
    return replace(panel, fiducials_mm=_fiducials(panel.size_mm, fab), tooling_holes_mm=_tooling_holes(panel.size_mm, fab))


def _least_side_mm(radius_mm: float, count: int, tab_mm: float, gap_mm: float) -> float:
    """Length of the shortest side that holds so many evenly spaced tabs with the round ends of their slots, clear of corners."""
    return count * (2 * radius_mm + tab_mm + gap_mm)


def _tabs_along(side_mm: float, radius_mm: float, fab: FabProfile) -> int:
    """Number of tabs of a side, spaced within the profile's limit if there is space; 0 without space."""
    rules = fab.panel
    wanted = ceil(side_mm / rules.tab_pitch_mm - 1e-9)
    having_room = (
        n for n in range(wanted, 0, -1) if _least_side_mm(radius_mm, n, rules.tab_mm, rules.gap_mm) <= side_mm + TOLERANCE_MM
    )
    return next(having_room, 0)


def _tab_problems(panel: Panel, tabs: str) -> Iterator[Problem]:
    width, height = panel.tape_mm
    sides = {"x": ("left and right", height, panel.tabs_x), "y": ("lower and upper", width, panel.tabs_y)}
    without = [name for name, (_, _, count) in sides.items() if count == 0]
    if tabs == "auto":
        without = without if len(without) == len(sides) else []
    least_mm = _least_side_mm(panel.tape_radius_mm, 1, panel.tab_mm, panel.gap_mm)
    for name in without:
        if name in tabs or tabs == "auto":
            words, side_mm, _ = sides[name]
            other = "y" if name == "x" else "x"
            remedy = f"use --tabs {other}, " if sides[other][2] or tabs == name else "use "
            yield Problem(
                "tabs",
                f"tabs = '{tabs}': the {words} sides of {side_mm:g} mm have no room for a tab of {panel.tab_mm:g} mm, which "
                f"between corners of {panel.tape_radius_mm:g} mm and the ends of slots of {panel.gap_mm:g} mm needs "
                f"{least_mm:g} mm; "
                f"{remedy}a larger --size or a smaller --corner-radius",
            )


def _first_mark_mm(fab: FabProfile) -> float:
    """Distance of a fiducial from the panel's side, past the tooling hole of the corner."""
    rules = fab.panel
    return rules.rail_mm / 2 + (rules.tooling_hole_mm + rules.fiducial_opening_mm) / 2 + _MARK_APART_MM


def _mark_problems(panel: Panel, fab: FabProfile) -> Iterator[Problem]:
    rules = fab.panel
    needed_mm = 2 * (_first_mark_mm(fab) + rules.fiducial_shift_mm + rules.fiducial_opening_mm / 2)
    if rules.fiducials and panel.size_mm[0] < needed_mm:
        message = (
            f"panel is {panel.size_mm[0]:g} mm wide, but two fiducials of its rails, one of them shifted by "
            f"{rules.fiducial_shift_mm:g} mm, need {needed_mm:g} mm; use more columns of tapes"
        )
        yield Problem("panel", message)


def _fiducials(size_mm: Size, fab: FabProfile) -> tuple[Offset, ...]:
    """One in each corner's rail; the last is shifted, so that a rotated panel is recognised."""
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


# From a manifest


def read_panel_record(table: Fields) -> Panel:
    """The panel that a manifest records; problems are collected in `table`."""
    longest = 10_000.0

    def points(key: str, count: int) -> tuple[Any, ...]:
        entries = []
        for i, entry in enumerate(table.rows(key, longest=MOST_ALONG)):
            entries.append(
                Fields({f"{key}[{i}]": entry}, table.where, table.problems).numbers(f"{key}[{i}]", count, low=0.0, high=longest)
            )
        return tuple(entries)

    width, height = table.numbers("tape_mm", 2, above=0.0, high=longest, default=(1.0, 1.0))
    lengths: Mapping[str, Any] = {
        key: table.number(key, above=0.0, high=100.0, default=1.0)
        for key in ("rail_mm", "gap_mm", "tab_mm", "fiducial_mm", "fiducial_opening_mm")
    }
    counts: Mapping[str, Any] = {
        **{key: table.integer(key, low=1, high=MOST_ALONG, default=1) for key in ("columns", "rows")},
        **{key: table.integer(key, low=0, high=1000, default=0) for key in ("tabs_x", "tabs_y")},
    }
    return Panel(
        tape_mm=(width, height),
        tape_radius_mm=table.number("tape_radius_mm", low=0.0, high=min(width, height) / 2, default=0.0),
        fiducials_mm=points("fiducials_mm", 2),
        tooling_holes_mm=points("tooling_holes_mm", 3),
        **lengths,
        **counts,
    )
