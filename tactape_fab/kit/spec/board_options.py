"""Options of a spec for the board outside the texture: AprilTag, corners, holes."""

from __future__ import annotations

from collections.abc import Mapping
from math import isnan
from typing import Any

from tactape_fab.base.fields import Fields, shown
from tactape_fab.texture.board import LONGEST_MM, MOST_HOLES, TAG_FAMILY, TAG_IDS
from tactape_fab.texture.frames import snap_mm

LEAST_ROUND_MM = 0.01
"""Least radius of a corner and diameter of a hole: smaller ones cannot be made, and their arcs would become points."""
DEFAULT_CORNER_RADIUS_MM = 1.0
DEFAULT_TAG_CELL_MM = 0.5


def read_board_options(table: Fields, values: Mapping[str, Any], *, solid: bool) -> dict[str, Any]:
    """Values of these options in their final form; a refused one is replaced by a valid value.

    table: All values given; problems are collected in it.
    values: Values that are already in their final form.
    solid: Whether the part is a solid element.
    """
    return {
        "tag_id": _tag_id(table, values["tag"], values["sector"]),
        "corner_radius_mm": _corner_radius(table, values["size_mm"], square=solid and values["cylinder_mm"] is not None),
        "holes_mm": _holes(table, values["size_mm"]),
    }


def no_tag(tag_id: int | None, sector: int) -> str:
    """Options that leave out a tag; an id that does not follow from the sector was asked for, and would contradict them."""
    return "--tag none" if tag_id in (None, sector) else "--tag none without --tag-id"


def _tag_id(table: Fields, tag: str, sector: int) -> int | None:
    if tag == "none":
        if "tag_id" in table.values and not table.refused("tag_id"):
            table.problem("tag_id", f"tag_id = {shown(table.values['tag_id'])} contradicts tag = 'none'; give one of them")
        return None
    if "tag_id" in table.values:
        return table.integer("tag_id", low=0, high=TAG_IDS - 1, remedy=f"family {TAG_FAMILY} has {TAG_IDS} ids")
    if sector >= TAG_IDS:
        table.problem(
            "tag_id",
            f"sector = {sector} exceeds {TAG_IDS - 1}, the last id of {TAG_FAMILY}; choose an id with --tag-id or use --tag none",
        )
        return 0
    return sector


def _corner_radius(table: Fields, size_mm: tuple[float, float], *, square: bool) -> float:
    # half a side is the largest radius that an outline has
    usual_mm = 0.0 if square or min(size_mm) < 2 * DEFAULT_CORNER_RADIUS_MM else DEFAULT_CORNER_RADIUS_MM
    radius_mm = Fields({"corner_radius_mm": usual_mm, **table.values}, "", table.problems).number(
        "corner_radius_mm",
        low=0.0,
        high=LONGEST_MM if table.refused("size_mm") else min(size_mm) / 2,
        remedy="give at most half the shorter side",
        default=0.0,
    )
    if 0.0 < radius_mm < LEAST_ROUND_MM:
        message = f"corner_radius_mm = {radius_mm:g} mm is neither 0 nor at least {LEAST_ROUND_MM:g} mm; use --corner-radius 0"
        table.problem("corner_radius_mm", message)
        radius_mm = 0.0
    if square and radius_mm > 0.0:
        table.problem(
            "corner_radius_mm",
            f"corner_radius_mm = {radius_mm:g} mm contradicts cylinder_mm: a wrapped texture has square corners, 0 mm; "
            "leave out --corner-radius",
        )
    return usual_mm if table.refused("size_mm") else float(snap_mm(radius_mm))


def _holes(table: Fields, size_mm: tuple[float, float]) -> tuple[tuple[float, float, float], ...]:
    holes = []
    remedy = "give X,Y,DIAMETER in mm, or [X, Y, DIAMETER] in TOML and Python"
    for i, hole in enumerate(table.rows("holes_mm", longest=MOST_HOLES)):
        key = f"holes_mm[{i}]"
        x, y, d = Fields({key: hole}, "", table.problems).numbers(key, 3, above=0.0, high=LONGEST_MM, remedy=remedy)
        if d < LEAST_ROUND_MM:
            table.problem(key, f"{key} has a diameter of {d:g} mm, below {LEAST_ROUND_MM:g} mm; {remedy}")
        elif table.refused("size_mm") or isnan(x + y + d):  # refused already
            pass
        elif x + d / 2 >= size_mm[0] or y + d / 2 >= size_mm[1] or x <= d / 2 or y <= d / 2:
            table.problem(
                key, f"{key} = {x:g},{y:g},{d:g} mm does not lie inside the outline {size_mm[0]:g} x {size_mm[1]:g} mm; move it"
            )
        holes.append((round(x, 4), round(y, 4), round(d, 4)))  # number of decimals in the drill file
    return () if table.refused("holes_mm") or table.refused("size_mm") else tuple(holes)
