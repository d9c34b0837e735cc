"""A written panel as one HTML page: its picture, its tapes with their own reports, and its verification."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from tactape_fab.base.errors import Check, Finding
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.read.readback import csv_lines
from tactape_fab.report.html import allowed, asset, script_json, template
from tactape_fab.report.page import REPORT_NAME

PANEL_READ_ROLES = ("bom", "order-notes", "preview-png")
"""Roles of the files that the page is made from."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WrittenPanel:
    """A panel as it was written.

    Attributes
    ----------
    manifest : mapping
        Its content; ``files`` lists all its own files but the report and the manifest itself.
    files : mapping of str to bytes
        By role: those of `PANEL_READ_ROLES`.
    checks : sequence of Check
        Lines of its own verification, not of the kits on it; empty where it was not verified.
    findings : sequence of Finding
        Its design rules, as the worst tape measures them.
    """

    manifest: Mapping[str, Any]
    files: Mapping[str, bytes]
    checks: Sequence[Check] = ()
    findings: Sequence[Finding] = ()


def render_panel_report(panel: WrittenPanel) -> Artifact:
    """The report of a panel: the same bytes for the same panel; it holds neither date nor duration, and runs no script."""
    manifest, style = panel.manifest, asset("report.css")
    text = template("panel.html.j2").render(
        name=manifest["name"],
        facts=_facts(manifest),
        tapes=list(_tapes(manifest)),
        checks=panel.checks,
        findings=panel.findings,
        notes=panel.files["order-notes"].decode("utf-8"),
        bom=csv_lines(panel.files["bom"].decode("utf-8-sig")),
        picture=b64encode(panel.files["preview-png"]).decode("ascii"),
        files=manifest["files"],
        data=script_json({"name": manifest["name"], "files": [dict(row) for row in manifest["files"]]}),
        style=style,
        policy=f"default-src 'none'; img-src data:; style-src {allowed(style)}; base-uri 'none'; form-action 'none'",
    )
    return Artifact(role="report", path=REPORT_NAME, data=text.encode("utf-8"))


def _facts(manifest: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Properties of the panel as short texts."""
    panel = manifest["panel"]
    yield "tapes", f"{panel['columns']} x {panel['rows']}"
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
            "at_mm": "{:g}, {:g}".format(*tape["offset_mm"]),
        }
