"""The board of a tape, its printed tag, and the user's surface that carries a texture instead of a board."""

from __future__ import annotations

from dataclasses import dataclass, field

from tactape_fab.base.fields import Fields

TAG_FAMILY = "tag36h11"
TAG_IDS = 587
LONGEST_MM = 10_000.0
LEAST_MM = 0.001
"""Least length of a part, of a tag's cell, and of a round corner's radius: far shorter ones are lost in sums to rounding, and
dividing by them overflows.
"""
MOST_HOLES = 10_000
LEAST_BEND_THICKNESSES = 10.0
"""Least radius that a film is bent to, in thicknesses of it, as fab profiles have it: `[bend]` of generic-fpc says whence."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """The film: outline, place of the texture on it, and its holes (board frame, mm).

    ``holes`` are (x, y, diameter). ``flexible`` is whether it can be bent, as the fab's profile says; None where no fab makes it,
    or nothing is said. It is no part of a board's own record.
    """

    size_mm: tuple[float, float]
    texture_origin_mm: tuple[float, float]
    corner_radius_mm: float
    thickness_mm: float
    holes: tuple[tuple[float, float, float], ...] = ()
    flexible: bool | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tag:
    """The printed AprilTag; ``center_mm`` in the board frame, upright in AprilRobotics' sense at rotation 0."""

    family: str
    id: int
    cell_mm: float
    center_mm: tuple[float, float]
    rotation_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """The user's own part that carries a texture instead of a board.

    ``source`` and ``sha256`` name its file; ``centre_mm`` is the point under the middle of the grid, ``up`` the direction
    of board +y there (the part's coordinates); ``radius_mm`` is that of the patch, None if it is neither sphere nor
    cylinder.
    """

    source: str
    sha256: str
    centre_mm: tuple[float, float, float]
    up: tuple[float, float, float]
    radius_mm: float | None


def read_board(table: Fields) -> Board:
    """A manifest's board. Problems are collected in `table`."""
    size = table.numbers("size_mm", 2, above=0.0, high=LONGEST_MM, default=(LONGEST_MM, LONGEST_MM))
    holes = []
    for i, hole in enumerate(table.rows("holes", longest=MOST_HOLES)):
        entry = Fields({f"holes[{i}]": hole}, table.where, table.problems)
        x, y, d = entry.numbers(f"holes[{i}]", 3, low=0.0, high=LONGEST_MM)
        holes.append((x, y, d))
    return Board(
        size_mm=(size[0], size[1]),
        texture_origin_mm=_pair(table.numbers("texture_origin_mm", 2, low=0.0, high=LONGEST_MM)),
        corner_radius_mm=_corner_radius(table, min(size) / 2),
        thickness_mm=table.number("thickness_mm", above=0.0, high=100.0),
        holes=tuple(holes),
    )


def _corner_radius(table: Fields, most_mm: float) -> float:
    radius_mm = table.number("corner_radius_mm", low=0.0, high=most_mm)
    if 0.0 < radius_mm < LEAST_MM:
        table.problem(
            "corner_radius_mm", f"corner_radius_mm = {radius_mm:g} mm is neither 0 nor at least {LEAST_MM:g} mm; give 0"
        )
    return radius_mm


def read_tag(table: Fields) -> Tag:
    """A manifest's tag. Problems are collected in `table`."""
    return Tag(
        family=table.text("family", choices=(TAG_FAMILY,)),
        id=table.integer("id", low=0, high=TAG_IDS - 1),
        cell_mm=table.number("cell_mm", low=LEAST_MM, high=100.0),
        center_mm=_pair(table.numbers("center_mm", 2, low=0.0, high=LONGEST_MM)),
        rotation_deg=table.number("rotation_deg", low=-360.0, high=360.0, unit="deg"),
    )


def read_surface(table: Fields) -> Surface:
    """A manifest's surface. Problems are collected in `table`."""
    x, y, z = table.numbers("centre_mm", 3, low=-LONGEST_MM * 10, high=LONGEST_MM * 10)
    u, v, w = table.numbers("up", 3, low=-1.0, high=1.0, unit="")
    radius_mm = None
    if table.values.get("radius_mm") is not None:
        radius_mm = table.number("radius_mm", low=-1e9, high=1e9)
    return Surface(
        source=table.text("source", longest=300),
        sha256=table.text("sha256", pattern=r"[0-9a-f]{64}"),
        centre_mm=(x, y, z),
        up=(u, v, w),
        radius_mm=radius_mm,
    )


def _pair(values: tuple[float, ...]) -> tuple[float, float]:
    return values[0], values[1]
