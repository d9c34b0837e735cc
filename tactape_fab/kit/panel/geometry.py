"""Panel: tapes within rails, held by tabs, with fiducials and tooling holes for assembly.

Frame: x right, y up from the panel's lower left corner, mm. A slot of width gap surrounds every tape, interrupted by tabs. Tapes
of one size are in columns and rows and share slots; packed tapes, of any size and orientation, have slots of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import ceil
from typing import Any

from tactape_fab.base.fields import Fields
from tactape_fab.kit.film.drawing import Hole, Offset
from tactape_fab.kit.profiles.fab_tables import LEAST_TAB_PITCH_MM
from tactape_fab.kit.spec.panel_options import MOST_ALONG
from tactape_fab.texture.board import LONGEST_MM
from tactape_fab.texture.frames import FloatArray, snap_mm
from tactape_fab.texture.shapes import board_outline

CORNER_RADIUS_MM = 1.0
_RADIUS = "corner_radius_mm"
MOST_PLACES = 1000
"""Most tapes of a packed panel."""
_MOST_TABS = 1000

Size = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A tape's place on a panel: p_panel = offset_mm + R_ccw(90 degrees if turned, else 0) p_board.

    ``size_mm`` and ``radius_mm`` are those of its board; ``tabs_x`` is the number of tabs on its left and on its right side,
    ``tabs_y`` on its lower and on its upper side, as it is placed.
    """

    size_mm: Size
    radius_mm: float
    offset_mm: Offset
    turned: bool = False
    tabs_x: int = 0
    tabs_y: int = 0

    @property
    def rotation_deg(self) -> float:
        """Counter-clockwise rotation of the tape on the panel: 0 or 90."""
        return 90.0 if self.turned else 0.0

    @property
    def extent_mm(self) -> Size:
        """Width and height as placed."""
        return (self.size_mm[1], self.size_mm[0]) if self.turned else self.size_mm

    @property
    def low_mm(self) -> Offset:
        """Its lower left corner as placed."""
        # turned about the board's origin it extends by its height to the
        # left of its offset: [0, w] x [0, h] becomes [-h, 0] x [0, w]
        return (float(snap_mm(self.offset_mm[0] - self.size_mm[1])), self.offset_mm[1]) if self.turned else self.offset_mm

    def on_panel_mm(self, xy_mm: FloatArray) -> tuple[float, float]:
        """A point of the board in the panel's frame."""
        x, y = (-xy_mm[1], xy_mm[0]) if self.turned else xy_mm
        return float(snap_mm(x + self.offset_mm[0])), float(snap_mm(y + self.offset_mm[1]))

    @property
    def outline_mm(self) -> FloatArray:
        """Its outline on the panel."""
        return board_outline(self.extent_mm, self.radius_mm) + self.low_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """Geometry of a panel.

    grid: Columns and rows of equal tapes that share the slots between them; None if every tape has slots of its own.
    rail_mm, gap_mm, tab_mm: Widths of the rails, of the slots around tapes, and of a tab.
    fiducials_mm (x, y)
    fiducial_mm, fiducial_opening_mm: Diameters of their copper and of its mask opening.
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
        """Number and arrangement of the tapes as text."""
        if self.grid is not None:
            return f"{self.grid[0]} x {self.grid[1]} tapes"
        turned = sum(place.turned for place in self.places)
        return f"{self.count} tape{'s' * (self.count > 1)}" + (f" ({turned} turned)" if turned else "")

    @property
    def offsets_mm(self) -> tuple[Offset, ...]:
        """Place of every tape's board origin; for a grid in reading order, from the upper left tape on."""
        return tuple(place.offset_mm for place in self.places)

    @property
    def outline_mm(self) -> FloatArray:
        """Corners and arc points of the panel's outline, its own frame; shape (n, 2)."""
        return board_outline(self.size_mm, CORNER_RADIUS_MM)

    @property
    def key(self) -> str:
        """A text that is different for every panel."""
        # a grid's size follows from its other values; a packed panel may be larger than its tapes need
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
) -> tuple[Place, ...]:
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
        # reading order starts with the upper row, while offsets count from below
        for r in reversed(range(grid[1]))
        for c in range(grid[0])
    )


def panel_size_mm(tape_mm: Size, arrangement: tuple[int, int], rail_mm: float, gap_mm: float) -> Size:
    """Outline of a panel with so many columns and rows."""
    # n tapes have n + 1 slots: one between every two, and one along each rail
    width, height = (
        float(snap_mm(2 * rail_mm + gap_mm + n * (side + gap_mm))) for side, n in zip(tape_mm, arrangement, strict=True)
    )
    return width, height


# From a manifest


def read_panel_record(table: Fields) -> Panel:
    """The panel that a manifest records; problems are collected in `table`."""
    lengths: Mapping[str, Any] = {
        key: table.number(key, above=0.0, high=100.0, default=1.0)
        for key in ("rail_mm", "gap_mm", "tab_mm", "fiducial_mm", "fiducial_opening_mm")
    }
    marks: Mapping[str, Any] = {
        "fiducials_mm": _read_points(table, "fiducials_mm", 2),
        "tooling_holes_mm": _read_points(table, "tooling_holes_mm", 3),
    }
    own = _read_packed(table) if "places" in table.values else _read_grid(table, lengths["rail_mm"], lengths["gap_mm"])
    return Panel(**own, **lengths, **marks)


def _read_points(table: Fields, key: str, count: int) -> tuple[Any, ...]:
    rows = [
        Fields({f"{key}[{i}]": row}, table.where, table.problems) for i, row in enumerate(table.rows(key, longest=MOST_ALONG))
    ]
    return tuple(row.numbers(f"{key}[{i}]", count, low=0.0, high=LONGEST_MM) for i, row in enumerate(rows))


def _read_packed(table: Fields) -> dict[str, Any]:
    """Size and places of a packed panel."""
    entries = [
        Fields(row if isinstance(row, Mapping) else {}, f"{table.where}places[{i}].", table.problems)
        for i, row in enumerate(table.rows("places", longest=MOST_PLACES))
    ]
    size_mm = table.numbers("size_mm", 2, above=0.0, high=LONGEST_MM)
    return {"size_mm": size_mm, "places": tuple(map(_read_place, entries)), "grid": None}


def _read_place(entry: Fields) -> Place:
    width, height = entry.numbers("size_mm", 2, above=0.0, high=LONGEST_MM, default=(LONGEST_MM, LONGEST_MM))
    tabs_x, tabs_y = _read_tabs(entry, max(width, height))
    x, y = entry.numbers("offset_mm", 2, low=0.0, high=LONGEST_MM)
    return Place(
        size_mm=(width, height),
        radius_mm=entry.number("radius_mm", low=0.0, high=min(width, height) / 2),
        offset_mm=(x, y),
        turned=entry.flag("turned"),
        tabs_x=tabs_x,
        tabs_y=tabs_y,
    )


def _read_tabs(table: Fields, side_mm: float) -> tuple[int, int]:
    """Numbers of tabs of the sides of a tape, of which `side_mm` is the longest; to draw more than `make` plans takes minutes."""
    most = min(ceil(side_mm / LEAST_TAB_PITCH_MM), _MOST_TABS)
    return table.integer("tabs_x", low=0, high=most), table.integer("tabs_y", low=0, high=most)


def _read_grid(table: Fields, rail_mm: float, gap_mm: float) -> dict[str, Any]:
    """Size and places of a panel of equal tapes in columns and rows."""
    width, height = table.numbers("tape_mm", 2, above=0.0, high=LONGEST_MM, default=(1.0, 1.0))
    columns, rows = (table.integer(key, low=1, high=MOST_ALONG, default=1) for key in ("columns", "rows"))
    tabs_x, tabs_y = _read_tabs(table, max(width, height))
    radius_mm = table.number("tape_radius_mm", low=0.0, high=min(width, height) / 2)
    return {
        "size_mm": panel_size_mm((width, height), (columns, rows), rail_mm, gap_mm),
        "places": grid_places((width, height), radius_mm, (columns, rows), (rail_mm, gap_mm), (tabs_x, tabs_y)),
        "grid": (columns, rows),
    }
