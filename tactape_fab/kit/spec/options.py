"""Reader of every option of a tape from untrusted values, in one pass."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from tactape_fab.base.errors import Problem, tried
from tactape_fab.base.fields import Fields, nearest, shown
from tactape_fab.base.templates import is_profile_file, profile_names
from tactape_fab.kit.profiles import X2_MODES, ElementProfile, read_part
from tactape_fab.kit.profiles.assembly import PART_NUMBER_PATTERN, PART_NUMBER_REMEDY
from tactape_fab.kit.spec.board_options import DEFAULT_TAG_CELL_MM, read_board_options
from tactape_fab.kit.spec.film_options import read_film_options
from tactape_fab.kit.spec.grid_options import read_direction_option, read_grid_options
from tactape_fab.kit.spec.solid_options import DEFAULT_PROCESS, read_solid_options
from tactape_fab.texture.cpl import ASSEMBLY_FORMATS
from tactape_fab.texture.frames import snap_mm
from tactape_fab.texture.tag import LEAST_CELL_MM
from tactape_fab.texture.tape import NEW_NAME_PATTERN, NEW_NAME_REMEDY

TAG_MODES = ("strip", "none")
DEFAULT_FAB = "generic-fpc"
DEFAULT_PART = "r0201"
DEFAULT_ROTATION_DEG = 45.0
_CHIP_SIZE = re.compile(r"[rRcC]?(\d{4,5})")


def read_options(given: Mapping[str, Any]) -> tuple[dict[str, Any], list[Problem]]:
    """Read the values of every option.

    given: Untrusted; None means not given.
    Returns: Every option in its final form; a usable value if it was refused or depends on a refused one.
    Returns: Every problem.
    """
    table = Fields({key: value for key, value in given.items() if value is not None})
    values = read_grid_options(table)
    cell_mm = table.number("tag_cell_mm", low=LEAST_CELL_MM, high=5.0, default=DEFAULT_TAG_CELL_MM)
    rotation_deg = table.number("rotation_deg", low=-360.0, high=360.0, unit="deg", default=DEFAULT_ROTATION_DEG)
    # rotations are normalised to [0, 360), so that -45 and 315 give the same files
    values |= {"tag_cell_mm": float(snap_mm(cell_mm)), "rotation_deg": rotation_deg % 360.0}
    values["part"] = _profile_name(table, "part", "parts", DEFAULT_PART)
    part = None if table.refused("part") else tried(lambda: read_part(values["part"]), table.problems)
    solid = isinstance(part, ElementProfile)
    values["directions"] = read_direction_option(table, part, values["displacement_mm"], values["pitch_mm"])
    values |= read_solid_options(table, part)
    values |= {"tag": "none", "fab": None} if solid else _tag_and_fab(table)
    values |= read_film_options(table, solid=solid)
    values["process"] = _process(table, DEFAULT_PROCESS if solid else None)
    values |= read_board_options(table, values, solid=solid)
    for key, choices in (("assembly", ASSEMBLY_FORMATS), ("x2", X2_MODES)):
        values[key] = table.text(key, choices=choices) or None if key in table.values else None
    values["part_number"] = _text(table, "part_number", PART_NUMBER_PATTERN, PART_NUMBER_REMEDY, None)
    usual = f"tactape-s{values['sector']:03d}"
    values["name"] = _text(table, "name", NEW_NAME_PATTERN, NEW_NAME_REMEDY, usual)
    return values, table.problems


def _text(table: Fields, key: str, pattern: str, remedy: str, usual: str | None) -> str | None:
    return table.text(key, pattern=pattern, remedy=remedy) or usual if key in table.values else usual


def _tag_and_fab(table: Fields) -> dict[str, Any]:
    """Values of the tag and fab options, which films have and solid elements have not."""
    return {
        "tag": table.choice("tag", TAG_MODES),
        "fab": _profile_name(table, "fab", "fabs", DEFAULT_FAB) if "fab" in table.values else DEFAULT_FAB,
    }


def _process(table: Fields, usual: str | None) -> str | None:
    return _profile_name(table, "process", "processes", usual) if "process" in table.values else usual


def _suggestion(name: str, known: Sequence[str]) -> str:
    """Remedy with the profile that was probably meant; for a chip size, with the chips that come with the package."""
    size = _CHIP_SIZE.fullmatch(name)
    if size is None:
        near = nearest(name, known)
        return "; give one of them" if near is None else f"; did you mean '{near}'?"
    chips = [other for other in known if _CHIP_SIZE.fullmatch(other)]
    near = max((chip for chip in chips if chip[1:] == size[1]), default=None)  # of r0201 and c0201 the resistor
    return f"; did you mean '{near}'?" if near else f"; chips that come with it are {', '.join(chips)}" if chips else ""


def _profile_name(table: Fields, key: str, kind: str, usual: str | None) -> str | None:
    """A profile's name or path; a fab or process profile that cannot be read is reported when it is loaded."""
    name = table.text(key, longest=4096)
    if name and not is_profile_file(name) and name not in (known := profile_names(kind)):
        table.problem(
            key, f"{key} = {shown(name)} is none of: {', '.join(known)}, nor the path of a .toml file{_suggestion(name, known)}"
        )
    return usual if table.refused(key) else name
