"""Adding of the report to a written kit or panel: it is made from the files in the folder, and listed in the manifest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tactape_fab.base.errors import Check, Finding
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.read.written_gerber import first_part
from tactape_fab.kit.writer import with_file, write_kit
from tactape_fab.report.page import PANEL_READ_ROLES, READ_ROLES, Written, render_report
from tactape_fab.report.panel_page import WrittenPanel, render_panel_report
from tactape_fab.texture.tape import Tape


def add_report(
    folder: Path, content: Mapping[str, Any], tape: Tape, *, checks: Sequence[Check], findings: Sequence[Finding] = ()
) -> Artifact:
    """Write the report of the kit in `folder`, and rewrite its manifest with it.

    content: Content of its manifest.
    checks, findings: Its verification, and its measured design rules.
    Returns: The written report.
    """
    files = _read(folder, content, READ_ROLES)
    stl = next((folder / row["path"] for row in content["files"] if row["role"] == "stl"), None)
    report = render_report(Written(manifest=content, tape=tape, files=files, stl=stl, checks=checks, findings=findings))
    write_kit(folder, with_file(content, report), [report])
    return report


def add_panel_report(
    folder: Path, content: Mapping[str, Any], tapes: Sequence[Tape], *, checks: Sequence[Check], findings: Sequence[Finding]
) -> Artifact:
    """As `add_report`, for the panel of `tapes` in `folder`; the reports of its kits exist already."""
    files = _read(folder, content, PANEL_READ_ROLES)
    report = render_panel_report(WrittenPanel(manifest=content, tapes=tapes, files=files, checks=checks, findings=findings))
    write_kit(folder, with_file(content, report), [report])
    return report


def _read(folder: Path, content: Mapping[str, Any], roles: Sequence[str]) -> dict[str, bytes]:
    """Files of these roles; of the component layer, which is the largest, only the first part."""
    paths = {row["role"]: folder / row["path"] for row in content["files"] if row["role"] in roles}
    return {role: first_part(path) if role == "components-top" else path.read_bytes() for role, path in paths.items()}
