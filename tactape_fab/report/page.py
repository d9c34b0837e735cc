"""Report of a written kit as one HTML page: the content of its files as a map and lists, and its verification."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base.errors import Check, Finding
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.profiles import GERBER_ROLES
from tactape_fab.kit.read.readback import read_cpl
from tactape_fab.report.bom_summary import bom_lines
from tactape_fab.report.html import embedded, page, script_json
from tactape_fab.report.layers import TITLES, Shapes, film_shapes, layer_switches, solid_shapes
from tactape_fab.report.places import Places, measured_places, nominal_places
from tactape_fab.report.solid_view import solid_view
from tactape_fab.texture.tape import Tape

REPORT_NAME = "report.html"
PANEL_READ_ROLES = (*(r for r in GERBER_ROLES if r != "job"), "cpl", "bom", "order-notes", "placement-preview")
"""Roles of the files that the page of a panel needs."""
READ_ROLES = (*PANEL_READ_ROLES, "certificate", "placements", "preview-png")
"""Roles of the files that the page of a kit needs."""
_SCRIPTS = ("arrays.js", "map.js", "parts.js", "window.js", "built.js", "solid.js", "begin.js")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Written:
    """A kit as it was written.

    manifest: Content of the manifest; ``files`` lists all files but the report and the manifest itself.
    files: Bytes by role, of those `READ_ROLES` that the kit has; of the component layer only the first part is needed.
    stl: The mesh, if it has one.
    checks: Lines of the kit's verification; empty if it was not verified.
    findings: Its design rules, measured; empty without any.
    """

    manifest: Mapping[str, Any]
    tape: Tape
    files: Mapping[str, bytes]
    stl: bytes | Path | None = None
    checks: Sequence[Check] = ()
    findings: Sequence[Finding] = ()

    @property
    def is_film(self) -> bool:
        return "cpl" in self.files


def render_report(kit: Written) -> Artifact:
    """The report of a kit; it has no date or duration, so that equal kits give equal bytes."""
    data = page(
        "report.html.j2",
        _SCRIPTS,
        manifest=kit.manifest,
        tape=kit.tape,
        is_film=kit.is_film,
        is_on_part="placements" in kit.files,
        facts=_facts(kit),
        checks=kit.checks,
        findings=kit.findings,
        certificate=json.loads(kit.files["certificate"]),
        notes=kit.files["order-notes"].decode("utf-8") if "order-notes" in kit.files else None,
        bom=bom_lines(kit.files["bom"], kit.manifest) if "bom" in kit.files else None,
        picture=_picture(kit),
        placements=embedded(kit.files.get("placement-preview")),
        data=script_json(report_data(kit)),
    )
    return Artifact(role="report", path=REPORT_NAME, data=data)


def report_data(kit: Written) -> dict[str, Any]:
    """Data for the page's script; arrays are encoded by `packed`."""
    tape = kit.tape
    shapes, places = _drawn(kit)
    return {
        "name": tape.name,
        "texture_origin_mm": list(tape.board.texture_origin_mm),
        "size_mm": list(tape.board.size_mm),
        "pitch_mm": tape.pitch_mm,
        "origin": list(tape.origin),
        "grid": [tape.columns, tape.rows],
        "letters": tape.points_in.letters,
        **({} if tape.points_in.usual else {"codes": tape.points_in.gray_codes.tolist()}),
        "reach_mm": reach_mm(kit.manifest, tape),
        "places": places.to_mapping(),
        "shapes": [shape.to_mapping() for shape in shapes],
        "layers": layer_switches(shapes, TITLES if kit.is_film else {**TITLES, "profile": "Base"}),
        "contact": json.loads(kit.files["certificate"])["smallest_contact"],
        "solid": _solid(kit, places),
        "files": [dict(row) for row in kit.manifest["files"]],
    }


def _drawn(kit: Written) -> tuple[list[Shapes], Places]:
    """The shapes on the map, and its parts."""
    tape, files = kit.tape, kit.files
    if not kit.is_film:
        from tactape_fab.solids.surface.placements import read_placements  # imported here: a film has none

        on_part = read_placements(files["placements"], tape.part_count) if "placements" in files else None
        return list(solid_shapes(tape)), nominal_places(tape, on_part)
    cpl = read_cpl(files["cpl"])
    places = measured_places(tape, cpl.designators, cpl.xy_mm, cpl.rotation_deg)
    return list(film_shapes(files, cpl, kit.manifest["fab"])), places


def _solid(kit: Written, places: Places) -> dict[str, Any] | None:
    """The written mesh, and for a texture on the user's own part its place on that."""
    if kit.stl is None:
        return None
    on_part = places.on_part
    if on_part is None:
        return solid_view(kit.stl)
    # the middle of all elements, not of the mesh, so that the view opens on the texture
    middle = (on_part.points_mm.min(axis=0) + on_part.points_mm.max(axis=0)) / 2
    view = solid_view(kit.stl, middle)
    reach = float(np.linalg.norm(on_part.points_mm - middle, axis=1).max()) + kit.tape.pitch_mm
    texture = {"middle_mm": middle.tolist(), "reach_mm": reach, "normal": on_part.normal.mean(axis=0).tolist()}
    return {**view, "texture": texture}


def reach_mm(manifest: Mapping[str, Any], tape: Tape) -> float:
    """Radius of a part about its middle, pads included, mm."""
    land = manifest.get("land_pattern")
    body = np.hypot(*tape.part.body_mm[:2]) / 2
    if not land:
        return float(body)
    pads = land["pads"]
    # to the outer corner of a land
    return float(max(body, np.hypot(pads["offset_mm"] + pads["size_mm"][0] / 2, pads["size_mm"][1] / 2)))


def _picture(kit: Written) -> str | None:
    """The shaded preview of a solid texture; none for a film, whose preview is a drawing like the map."""
    shown = not kit.is_film and "preview-png" in kit.files
    return embedded(kit.files["preview-png"]) if shown else None


def _facts(kit: Written) -> Iterator[tuple[str, str]]:
    """Properties of the tape as short texts."""
    tape, surface = kit.tape, kit.manifest.get("surface")
    width_mm, height_mm = tape.board.size_mm
    yield "sector", f"{tape.sector} of {tape.code}"
    yield "origin in the code", f"column {tape.origin[0]}, row {tape.origin[1]}"
    yield "parts", f"{tape.part_count} on {tape.columns} x {tape.rows} grid points"
    yield "pitch W, displacement Δ", f"{tape.pitch_mm:g} mm, {tape.displacement_mm:g} mm{tape.in_directions}"
    if surface is not None:
        yield "on", f"{surface['source']}, round ({', '.join(f'{round(v, 3) + 0.0:.3f}' for v in surface['centre_mm'])}) mm"
        distortion = surface["distortion"]
        yield "pitch error", f"{distortion['pitch_error_min']:+.1%} to {distortion['pitch_error_max']:+.1%}"
        yield "reach", f"{distortion['reach_mm']:.1f} mm from the middle, usable are {distortion['usable_radius_mm']:.1f} mm"
    else:
        yield "size", f"{width_mm:g} x {height_mm:g} mm"
    yield "part", f"{tape.part.name}, {' x '.join(f'{v:g}' for v in tape.part.body_mm)} mm, turned by {tape.part.rotation_deg:g}°"
    if surface is None:
        yield ("fab" if kit.is_film else "process"), str(kit.manifest["fab"]["name"])
    for finding in kit.findings:  # pictures show only the front
        if finding.rule == "mark":
            yield "on its back", finding.message
    if surface is not None:
        yield "mark", "none: write the sector beside it"
    yield "made by", "{name} {version}".format(**kit.manifest["tool"])
