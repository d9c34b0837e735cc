"""Options of a spec for the texture: code, sector, grid, outline, place in the code plane, directions."""

from __future__ import annotations

from math import inf
from typing import Any, Literal

from tactape_fab.base.errors import ReachProblem
from tactape_fab.base.fields import Fields, shown
from tactape_fab.kit.profiles import PartProfile
from tactape_fab.kit.spec.scatter import scatter_refusal
from tactape_fab.kit.spec.solid_options import Part, without_film
from tactape_fab.texture.board import LONGEST_MM
from tactape_fab.texture.code import ALL_CODE_NAMES, CODE_NAMES, DEFAULT_CODE, Code, default_origin, get_code, read_directions
from tactape_fab.texture.directions import DIRECTIONS, USUAL_DIRECTIONS
from tactape_fab.texture.frames import snap_mm
from tactape_fab.texture.tape import read_displacement, read_pitch

BEST: Literal["best"] = "best"
"""Value of ``origin`` that asks for a search."""
DEFAULT_SIZE_MM = (100.0, 50.0)


def read_grid_options(table: Fields) -> dict[str, Any]:
    """Values of these options in their final form, without directions; a refused one is replaced by a usable value.

    table: All values given; problems are collected in it.
    """
    code = get_code(table.text("code", choices=ALL_CODE_NAMES, default=DEFAULT_CODE))
    most = max(map(get_code, CODE_NAMES), key=lambda c: c.sectors)
    if table.refused("code"):  # the others are checked against the code with most sectors
        code = most
    other = f"'{most.name}' has {most.sectors}" if code.sectors < most.sectors else "take one of them"
    remedy = f"code '{code.name}' has {code.sectors} sectors; {other}"
    sector = table.integer("sector", low=0, high=code.sectors - 1, remedy=remedy)
    # snapped to 1 nm as in the files, so that the decoder uses exactly the tape that was made
    pitch_mm = float(snap_mm(read_pitch(table, "pitch_mm")))
    displacement_mm = read_displacement(table, "displacement_mm", pitch_mm, pitch_refused=table.refused("pitch_mm"))
    return {
        "code": code.name,
        "sector": sector,
        "pitch_mm": pitch_mm,
        "displacement_mm": float(snap_mm(displacement_mm)),
        "size_mm": _size(table, pitch_mm, code, sector),
        "origin": _origin(table, code, sector),
    }


def read_direction_option(table: Fields, part: Part | None, displacement_mm: float, pitch_mm: float) -> int:
    """Check that eight directions are used only with the touch code, and with parts whose placement scatter allows them."""
    code = None if table.refused("code") else get_code(table.values.get("code", DEFAULT_CODE))
    directions = read_directions(table, code)
    if not DIRECTIONS[directions].usual and isinstance(part, PartProfile) and not table.refused("displacement_mm"):
        message = scatter_refusal(displacement_mm, pitch_mm, without_film(table.values))  # with another code, too
        if message is not None:
            table.problem("directions", message)
    return directions


def _size(table: Fields, pitch_mm: float, code: Code, sector: int) -> tuple[float, float]:
    remedy = "give WIDTHxHEIGHT in millimetres, such as 100x50, or [100, 50] in TOML and Python"
    width, height = table.numbers("size_mm", 2, above=0.0, high=LONGEST_MM, remedy=remedy, default=DEFAULT_SIZE_MM)
    reach_mm = inf if table.refused("pitch_mm") else code.range * pitch_mm
    other = code_of_reach((width / pitch_mm, height / pitch_mm), sector, table.values.get("directions", USUAL_DIRECTIONS))
    larger = f"use --code {other} or a smaller tape" if other else "use a smaller tape"
    for i, side_mm in enumerate((width, height)):
        if side_mm > reach_mm:
            message = (
                f"size_mm[{i}] = {side_mm} mm exceeds {round(reach_mm, 6)} mm, the reach of code '{code.name}' at pitch "
                f"{pitch_mm} mm; {larger}"
            )
            table.problems.append(ReachProblem("size_mm", message))
    return DEFAULT_SIZE_MM if table.refused("size_mm") else (float(snap_mm(width)), float(snap_mm(height)))


def code_of_reach(points: tuple[float, float], sector: int, directions: object) -> str:
    """Code of least range whose tape of this sector has that many columns and rows at the default origin; '' if there is none."""

    def reaches(code: Code) -> bool:
        ends = (first + count for first, count in zip(default_origin(code.name, sector), points, strict=True))
        return points[0] * points[1] <= code.most_points and max(ends) <= code.range

    codes = [code for code in map(get_code, CODE_NAMES) if sector < code.sectors and directions in code.directions]
    return min(((code.range, code.name) for code in codes if reaches(code)), default=(0, ""))[1]


def _origin(table: Fields, code: Code, sector: int) -> tuple[int, int] | Literal["best"]:
    if "origin" not in table.values:
        return default_origin(code.name, sector)
    if code.plane is None:
        if table.values["origin"] not in ((0, 0), [0, 0]):
            given = shown(table.values["origin"])
            message = f"origin = {given} means nothing with code '{code.name}', which has no plane: its tapes are designed"
            table.problem("origin", f"{message}; leave --origin out, and use another --sector for another tape")
        return code.default_origin(sector)
    if table.values["origin"] == BEST:
        return BEST
    remedy = f"give --origin COL,ROW with both from 0 to {code.range - 1}, or best, or leave it to the sector's default; "
    remedy += "in TOML and Python give [COL, ROW]"
    column, row = table.integers("origin", 2, low=0, high=code.range - 1, remedy=remedy)
    return column, row
