"""Panel: tapes within rails, held by tabs, with fiducials and tooling holes for assembly.

Frame: x right, y up from the panel's lower left corner, mm. A slot of the gap's width surrounds every tape, interrupted by tabs.
Tapes of one size stand in columns and rows and share slots; packed ones, of any size and turned, each in a frame of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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
_RADIUS = "corner_radius_mm"
MOST_PLACES = 1000
"""Tapes on a packed panel."""
_MARK_APART_MM = 1.5
_CORNERS = ((0, 0), (1, 0), (0, 1), (1, 1))
_HOLE_CORNERS = ((0, 0), (1, 1), (1, 0), (0, 1))

Size = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A tape's place on a panel: p_panel = offset_mm + R_ccw(90 degrees if turned, else 0) p_board.

    ``size_mm`` and ``radius_mm`` are of its outline as a board; ``tabs_x`` and ``tabs_y`` count the tabs on each left and right,
    and on each lower and upper side of it as it lies.
    """

    size_mm: Size
    radius_mm: float
    offset_mm: Offset
    turned: bool = False
    tabs_x: int = 0
    tabs_y: int = 0

    @property
    def rotation_deg(self) -> float:
        return 90.0 if self.turned else 0.0

    @property
    def extent_mm(self) -> Size:
        """Width and height as it lies."""
        return (self.size_mm[1], self.size_mm[0]) if self.turned else self.size_mm

    @property
    def low_mm(self) -> Offset:
        """Its lower left corner as it lies."""
        return (float(snap_mm(self.offset_mm[0] - self.size_mm[1])), self.offset_mm[1]) if self.turned else self.offset_mm

    def on_panel_mm(self, xy_mm: FloatArray) -> tuple[float, float]:
        """Where a point of the board lies on the panel."""
        x, y = (-xy_mm[1], xy_mm[0]) if self.turned else xy_mm
        return float(snap_mm(x + self.offset_mm[0])), float(snap_mm(y + self.offset_mm[1]))

    @property
    def outline_mm(self) -> FloatArray:
        """Its outline on the panel."""
        return outline_of(self.extent_mm, self.radius_mm) + self.low_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """Geometry of a panel.

    grid: Columns and rows of equal tapes that share the slots between them; None if every tape lies in a frame of its own.
    rail_mm, gap_mm, tab_mm: Widths of the rails, of the slot round every tape, and of a tab.
    fiducials_mm (x, y)
    fiducial_mm, fiducial_opening_mm: Diameters of their copper and of its opening.
    tooling_holes_mm (x, y, diameter)
    """

    size_mm: Size
    places: tuple[Place, ...]
    grid: tuple[int, int] | None
    rail_mm: float
    gap_mm: float
    tab_mm: float
    fiducials_mm: tuple[Offset, ...]
    fiducial_mm: float
    fiducial_opening_mm: float
    tooling_holes_mm: tuple[Hole, ...]

    @property
    def count(self) -> int:
        return len(self.places)

    @property
    def words(self) -> str:
        """How many tapes it has, and how they lie."""
        if self.grid is not None:
            return f"{self.grid[0]} x {self.grid[1]} tapes"
        turned = sum(place.turned for place in self.places)
        return f"{self.count} tape{'s' * (self.count > 1)}" + (f" ({turned} turned)" if turned else "")

    @property
    def offsets_mm(self) -> tuple[Offset, ...]:
        """Place of every tape's board origin; of a grid in reading order, the upper left tape first."""
        return tuple(place.offset_mm for place in self.places)

    @property
    def outline_mm(self) -> FloatArray:
        return outline_of(self.size_mm, CORNER_RADIUS_MM)

    @property
    def key(self) -> str:
        """A text that differs from that of every other panel."""
        own = {key: value for key, value in self.to_mapping().items() if self.grid is None or key not in ("size_mm", _RADIUS)}
        return f"Panel({', '.join(f'{key}={value!r}' for key, value in own.items())})"

    def to_mapping(self) -> dict[str, Any]:
        """The panel as its manifest records it."""
        same = {key: value for key, value in asdict(self).items() if key not in ("places", "grid", "size_mm")}
        if self.grid is None:
            own: dict[str, Any] = {"places": [asdict(place) for place in self.places]}
        else:
            first = self.places[0]
            own = {"columns": self.grid[0], "rows": self.grid[1], "tape_mm": first.size_mm, "tape_radius_mm": first.radius_mm}
            tabs = {"tabs_x": first.tabs_x, "tabs_y": first.tabs_y}
            same = {**{key: same[key] for key in ("rail_mm", "gap_mm", "tab_mm")}, **tabs, **same}
        return {**own, **same, "size_mm": self.size_mm, _RADIUS: CORNER_RADIUS_MM}


def grid_places(
    tape_mm: Size, radius_mm: float, grid: tuple[int, int], border: tuple[float, float], tabs: tuple[int, int]
) -> Any:
    """Places of equal tapes in columns and rows, in reading order; ``border`` is the rails' width, and the gap's."""
    (width, height), start, gap_mm = tape_mm, sum(border), border[1]
    return tuple(
        Place(
            size_mm=tape_mm,
            radius_mm=radius_mm,
            offset_mm=(float(snap_mm(start + c * (width + gap_mm))), float(snap_mm(start + r * (height + gap_mm)))),
            tabs_x=tabs[0],
            tabs_y=tabs[1],
        )
        for r in reversed(range(grid[1]))
        for c in range(grid[0])
    )


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

    Raises SpecError if there is no such arrangement.
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
    """A panel with every tape in a frame of its own.

    tapes (size, radius): Outlines of the tapes as boards.
    offsets (offset, turned): Their places, see `Place`, two gaps and a web apart: see `packing`.
    Raises SpecError if there is not enough space for the tabs, or for the marks in the rails.
    """
    places = []
    for (tape_mm, radius_mm), (offset_mm, turned) in zip(tapes, offsets, strict=True):
        along = [_tabs_along(side_mm, radius_mm, fab) for side_mm in tape_mm]
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
        for place in dict.fromkeys(replace(p, offset_mm=(0.0, 0.0)) for p in places)
        for problem in _tab_problems(place, tabs, fab)
    ]
    problems += _mark_problems(size_mm, fab)
    if problems:
        raise SpecError(problems)
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
    return rules.rail_mm / 2 + (rules.tooling_hole_mm + rules.fiducial_opening_mm) / 2 + _MARK_APART_MM


def _mark_problems(size_mm: Size, fab: FabProfile) -> Iterator[Problem]:
    rules = fab.panel
    needed_mm = 2 * (_first_mark_mm(fab) + rules.fiducial_shift_mm + rules.fiducial_opening_mm / 2)
    if rules.fiducials and size_mm[0] < needed_mm:
        message = (
            f"panel is {size_mm[0]:g} mm wide, but two fiducials of its rails, one of them shifted by "
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

    def place(entry: Fields) -> Place:
        width, height = entry.numbers("size_mm", 2, above=0.0, high=longest, default=(1.0, 1.0))
        x, y = entry.numbers("offset_mm", 2, low=0.0, high=longest, default=(0.0, 0.0))
        return Place(
            size_mm=(width, height),
            radius_mm=entry.number("radius_mm", low=0.0, high=min(width, height) / 2, default=0.0),
            offset_mm=(x, y),
            turned=entry.flag("turned"),
            tabs_x=entry.integer("tabs_x", low=0, high=1000, default=0),
            tabs_y=entry.integer("tabs_y", low=0, high=1000, default=0),
        )

    lengths: Mapping[str, Any] = {
        key: table.number(key, above=0.0, high=100.0, default=1.0)
        for key in ("rail_mm", "gap_mm", "tab_mm", "fiducial_mm", "fiducial_opening_mm")
    }
    marks: Mapping[str, Any] = {"fiducials_mm": points("fiducials_mm", 2), "tooling_holes_mm": points("tooling_holes_mm", 3)}
    if "places" in table.values:
        rows = table.rows("places", longest=MOST_PLACES)
        entries = [
            Fields(row if isinstance(row, Mapping) else {}, f"{table.where}places[{i}].", table.problems)
            for i, row in enumerate(rows)
        ]
        width, height = table.numbers("size_mm", 2, above=0.0, high=longest, default=(1.0, 1.0))
        return Panel(size_mm=(width, height), places=tuple(place(entry) for entry in entries), grid=None, **lengths, **marks)
    width, height = table.numbers("tape_mm", 2, above=0.0, high=longest, default=(1.0, 1.0))
    columns, rows_n = (table.integer(key, low=1, high=MOST_ALONG, default=1) for key in ("columns", "rows"))
    tabs_x, tabs_y = (table.integer(key, low=0, high=1000, default=0) for key in ("tabs_x", "tabs_y"))
    radius_mm = table.number("tape_radius_mm", low=0.0, high=min(width, height) / 2, default=0.0)
    grid, rail_mm, gap_mm = (columns, rows_n), lengths["rail_mm"], lengths["gap_mm"]
    return Panel(
        size_mm=panel_size_mm((width, height), grid, rail_mm, gap_mm),
        places=grid_places((width, height), radius_mm, grid, (rail_mm, gap_mm), (tabs_x, tabs_y)),
        grid=grid,
        **lengths,
        **marks,
    )
