"""Report of a written panel as one HTML page: a map of its files, links to its tapes' reports, and its verification."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from tactape_fab.base.errors import Check, Finding
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.read.readback import read_cpl
from tactape_fab.report.bom_summary import bom_lines
from tactape_fab.report.html import embedded, page, script_json
from tactape_fab.report.layers import film_shapes, layer_switches
from tactape_fab.report.page import REPORT_NAME, reach_mm
from tactape_fab.report.places import Places, measured_places
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.shapes import rotate
from tactape_fab.texture.tape import Tape

_SCRIPTS = ("arrays.js", "map.js", "parts.js", "begin.js")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WrittenPanel:
    """A panel as it was written.

    manifest: Content of the manifest; ``files`` lists the panel's own files but the report and the manifest itself.
    tapes: In the order of the manifest's ``tapes``.
    files: Bytes by role, of `PANEL_READ_ROLES`.
    checks: Lines of the panel's own verification, without those of its kits; empty if it was not verified.
    findings: Its design rules, each with the value of the worst tape.
    """

    manifest: Mapping[str, Any]
    tapes: Sequence[Tape]
    files: Mapping[str, bytes]
    checks: Sequence[Check] = ()
    findings: Sequence[Finding] = ()


def render_panel_report(panel: WrittenPanel) -> Artifact:
    """The report of a panel; it has no date or duration, so that equal panels give equal bytes."""
    manifest = panel.manifest
    data = page(
        "panel.html.j2",
        _SCRIPTS,
        name=manifest["name"],
        facts=_facts(manifest),
        tapes=list(_tapes(manifest)),
        checks=panel.checks,
        findings=panel.findings,
        notes=panel.files["order-notes"].decode("utf-8"),
        bom=bom_lines(panel.files["bom"], manifest),
        placements=embedded(panel.files.get("placement-preview")),
        files=manifest["files"],
        data=script_json(_data(panel)),
    )
    return Artifact(role="report", path=REPORT_NAME, data=data)


def _data(panel: WrittenPanel) -> dict[str, Any]:
    """Data for the page's script; arrays are encoded by `packed`."""
    manifest, first = panel.manifest, panel.tapes[0]
    cpl = read_cpl(panel.files["cpl"])
    shapes = list(film_shapes(panel.files, cpl, manifest["fab"]))
    return {
        "name": manifest["name"],
        "size_mm": list(manifest["panel"]["size_mm"]),
        "pitch_mm": max(tape.pitch_mm for tape in panel.tapes),
        "reach_mm": reach_mm(manifest, first),
        "letters": first.points_in.letters,
        **({} if first.points_in.usual else {"codes": first.points_in.gray_codes.tolist()}),
        "tapes": [
            {"name": tape.name, "origin": list(tape.origin), "turned": bool(row["rotation_deg"])}
            for tape, row in zip(panel.tapes, manifest["tapes"], strict=True)
        ],
        "places": _places(panel, cpl).to_mapping(),
        "shapes": [shape.to_mapping() for shape in shapes],
        "layers": layer_switches(shapes),
        "files": [dict(row) for row in manifest["files"]],
    }


def _places(panel: WrittenPanel, cpl: CplContent) -> Places:
    """Parts of the panel's list, each with its grid point on its tape; of the tapes only the grids are used."""
    counts = [int(row["parts"]) for row in panel.manifest["tapes"]]
    ends = np.cumsum(counts)
    on_tapes = []
    for row, tape, end, count in zip(panel.manifest["tapes"], panel.tapes, ends, counts, strict=True):
        own = slice(end - count, end)
        # the inverse of the place on the panel: translated, then rotated back
        on_board = rotate(cpl.xy_mm[own] - row["offset_mm"], -float(row["rotation_deg"]))
        on_tapes.append(measured_places(tape, cpl.designators[own], on_board, cpl.rotation_deg[own]))
    return Places(
        designators=cpl.designators,
        xy_mm=cpl.xy_mm,
        cells=np.concatenate([places.cells for places in on_tapes]),
        symbols=np.concatenate([places.symbols for places in on_tapes]),
        rotation_deg=cpl.rotation_deg,
        tapes=np.repeat(np.arange(len(counts), dtype=np.uint16), counts),
    )


def _facts(manifest: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Properties of the panel as short texts."""
    panel = manifest["panel"]
    yield "tapes", f"{panel['columns']} x {panel['rows']}" if "columns" in panel else str(len(manifest["tapes"]))
    yield "size", "{:g} x {:g} mm".format(*panel["size_mm"])
    yield "parts", str(sum(tape["parts"] for tape in manifest["tapes"]))
    yield "fab", str(manifest["fab"]["name"])
    yield "made by", "{name} {version}".format(**manifest["tool"])


def _tapes(manifest: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """A row for each tape, with a link to its own report."""
    for tape in manifest["tapes"]:
        first = int(tape["first_designator"].removeprefix("R"))
        yield {
            "name": tape["name"],
            "report": str(PurePosixPath(tape["manifest"]).parent / REPORT_NAME),
            "sector": tape["sector"],
            "parts": tape["parts"],
            "designators": f"R{first} to R{first + tape['parts'] - 1}",
            "at_mm": "{:g}, {:g}".format(*tape["offset_mm"]) + _turned(tape["rotation_deg"]),
        }


def _turned(rotation_deg: float) -> str:
    """Text for the rotation of a tape on the panel."""
    return f", turned by {rotation_deg:g}° round it" if rotation_deg else ""
