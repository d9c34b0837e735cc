"""Untrusted values examined: everything that is refused, all together, and the rules that the rest breaks."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tactape_fab.base.errors import Finding, Problem, SpecError
from tactape_fab.kit.examine.tape import Examined, examine, fixed_origin
from tactape_fab.kit.output_place import refuse_taken
from tactape_fab.kit.spec.tape_spec import BEST, KEYS, TapeSpec
from tactape_fab.texture.certify.origin import choose_sector
from tactape_fab.texture.code import get_plane, has_plane
from tactape_fab.texture.tape import Tape

_ELEMENT = {"part", "body_mm", "dome_top_mm", "rotation_deg", "pitch_mm", "displacement_mm"}
"""Where one of these was set aside, the rules would measure other parts than those asked for."""
_RESTS_ON = {
    "displacement_mm": {"pitch_mm"},
    "size_mm": {"code", "fab", "process", "tag_cell_mm", "corner_radius_mm", *_ELEMENT},
    "directions": {"code", "part", "pitch_mm", "displacement_mm"},
    "origin": {"code", "sector", "size_mm", "pitch_mm"},
    "corner_radius_mm": {"size_mm", "tag_cell_mm", "part", "cylinder_mm"},
    "holes_mm": {"size_mm", "corner_radius_mm"},
    "part": _ELEMENT,
    "body_mm": {"part", "dome_top_mm"},
    "dome_top_mm": {"part", "body_mm"},
    "part_number": {"assembly", "fab", "part"},
    "cylinder_mm": {"size_mm", "base_mm", "around", *_ELEMENT},
    "around": {"cylinder_mm"},
    "shell": {"cylinder_mm", "size_mm", "around"},
    "coverlay": {"fab", "part"},
    "anchor": {"coverlay", "rotation_deg", "part"},
    "stiffener": {"fab", "part"},
    "adhesive": {"fab", "part"},
    "bend_radius_mm": {"fab", "part", "bend_axis"},
    "bend_axis": {"part", "bend_radius_mm"},
}
"""What else decides whether a value is refused: where that was set aside, the value cannot be judged."""


def _root(key: str) -> str:
    """The key of the spec that a problem's key belongs to."""
    return re.split(r"[ .\[:]", key)[0]


def examine_values(
    values: Mapping[str, Any], *, output: str | None = None, overwrite: bool = False, avoid: Sequence[Tape] = ()
) -> Examined:
    """Examine untrusted values, and the place that the kit is to take.

    With tapes to avoid the origin is chosen, and the sector where none is given.

    A refusal lists everything: what is refused is set aside for its default and the rest is examined again, until
    nothing new is found; broken design rules are listed where the values that they measure were not refused.

    Raises
    ------
    SpecError
        With every problem, and in `findings` the rules that the remaining values break.
    """
    problems: list[Problem] = []
    raised: list[type[SpecError]] = []
    if output is not None:
        try:
            refuse_taken(Path(output), overwrite=overwrite)
        except SpecError as error:
            problems += error.problems
            raised.append(SpecError)
    findings: Sequence[Finding] = ()
    kept = dict(values)
    set_aside: set[str] = set()
    if avoid and has_plane(kept.get("code")) and kept.setdefault("origin", BEST) != BEST:
        problems.append(fixed_origin(kept["origin"]))
        raised.append(SpecError)
        kept["origin"] = BEST
    while True:
        try:
            if problems:
                examined = examine(TapeSpec.from_mapping(_unsearched(kept, avoid)))
            else:
                if avoid and "sector" not in kept:
                    kept["sector"] = _free_sector(kept, avoid)
                examined = examine(TapeSpec.from_mapping(kept), avoid=avoid)
        except SpecError as error:
            new = [p for p in error.problems if p not in problems and not _RESTS_ON.get(_root(p.key), set()) & set_aside]
            if not new:
                break
            problems += new
            raised.append(type(error))
            if not set_aside & _ELEMENT:
                findings = [replace(finding, at_mm=None) for finding in error.findings] or findings
            refused = {_root(problem.key) for problem in new}
            set_aside |= refused
            kept = {"sector": 0, **{k: v for k, v in kept.items() if k in KEYS and k not in refused}}
        else:
            if not problems:
                return examined
            if not set_aside & _ELEMENT and not findings:
                findings = [replace(finding, at_mm=None) for finding in examined.findings if finding.blocks]
            break
    raise (raised[0] if len(set(raised)) == 1 else SpecError)(problems, findings)


def _unsearched(values: Mapping[str, Any], avoid: Sequence[Tape]) -> dict[str, Any]:
    """The values without a search, which has nothing to say where something else is refused."""
    plain = {key: value for key, value in values.items() if key != "origin" or value != BEST}
    return {"sector": 0, **plain} if avoid else plain


def _free_sector(values: Mapping[str, Any], avoid: Sequence[Tape]) -> int:
    """The sector farthest from tapes to avoid, for a tape of these values; its grid is the same in every sector.

    Of a touch code any sector will do that is none of theirs, and no id of their tags.
    """
    if not has_plane(values.get("code")):
        used = {t.sector for t in avoid if t.code == values["code"]} | {t.tag.id for t in avoid if t.tag is not None}
        return min(set(range(len(used) + 1)) - used)
    tape = examine(TapeSpec.from_mapping({**values, "sector": 0, "origin": (0, 0)})).tape
    return choose_sector(get_plane(tape.code), tape.placed, avoid)
