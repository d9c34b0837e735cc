"""Consistency of the spec in a manifest with the tape, film and solid in the rest of the manifest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from tactape_fab.base.errors import Problem
from tactape_fab.base.fields import shown
from tactape_fab.base.templates import is_profile_file
from tactape_fab.texture.directions import USUAL_DIRECTIONS
from tactape_fab.texture.tape import Tape


def of_tape(tape: Tape) -> dict[str, Any]:
    """Options of a spec that follow from the manifest's tape; some are None if the tape does not determine them."""
    board = tape.board
    return {
        "sector": tape.sector,
        "name": tape.name,
        "code": tape.code,
        "origin": list(tape.origin),
        "pitch_mm": tape.pitch_mm,
        "displacement_mm": tape.displacement_mm,
        "size_mm": list(board.size_mm),
        "corner_radius_mm": board.corner_radius_mm,
        "holes_mm": [list(hole) for hole in board.holes],
        "rotation_deg": tape.part.rotation_deg,
        "tag_id": None if tape.tag is None else tape.tag.id,
    }


def other_values(values: Mapping[str, Any], known: Mapping[str, Any]) -> list[Problem]:
    """Problems of options whose values differ from the `known` ones."""
    return [
        Problem(key, f"spec.{key} = {shown(values.get(key))} is not that of the tape, {shown(value)}")
        for key, value in known.items()
        if values.get(key) != value and not (key == "origin" and values.get(key) == "best")
    ]


def contradictions(content: Mapping[str, Any], tape: Tape) -> list[Problem]:
    """Problems of options in a manifest's spec that contradict the rest of the manifest, for manifests of any version."""
    spec = content.get("spec")
    values = {key: value for key, value in spec.items() if value is not None} if isinstance(spec, Mapping) else {}
    known = {**of_tape(tape), **dict(_elsewhere(content, tape, values))}
    return other_values(values, {key: value for key, value in known.items() if key in values})


def _elsewhere(content: Mapping[str, Any], tape: Tape, values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Options that follow from the manifest's other tables."""

    def table(key: str) -> Mapping[str, Any]:
        found = content.get(key)
        return found if isinstance(found, Mapping) else {}

    fab, solid, cylinder = table("fab"), table("solid"), table("solid").get("cylinder")
    # a user's own profile may have any name
    profiles = {"fab": fab.get("name"), "part": tape.part.name, "process": table("process").get("name")}
    yield from ((key, name) for key, name in profiles.items() if not is_profile_file(values.get(key)))
    yield "directions", content.get("directions", USUAL_DIRECTIONS)
    yield from (("body_mm", list(tape.part.body_mm)), ("dome_top_mm", tape.part.top_mm))
    yield "tag", "none" if tape.tag is None else "strip"
    if tape.tag is not None:
        yield "tag_cell_mm", tape.tag.cell_mm
    if fab:
        if fab.get("coverlay_mode") != "gang":  # which has no anchors: those asked for are a broken rule that may be forced
            yield "anchor", table("anchor").get("mode", "none")
        yield from ((key, content.get(key)) for key in ("stiffener", "adhesive"))
    if "coverlay_mode" in fab:
        yield "coverlay", fab["coverlay_mode"]
    yield from ((key, table("assembly")[name]) for key, name in _OF_ASSEMBLY.items() if name in table("assembly"))
    yield from ((key, solid[key]) for key in ("base_mm", "negative", "top", "mark") if key in solid)
    if solid:
        of_cylinder = cylinder if isinstance(cylinder, Mapping) else {}
        yield from ((key, of_cylinder.get(name)) for key, name in _OF_CYLINDER.items())


_OF_ASSEMBLY = {"assembly": "format", "part_number": "part_number"}
_OF_CYLINDER = {"cylinder_mm": "radius_mm", "around": "around", "shell": "shell"}
