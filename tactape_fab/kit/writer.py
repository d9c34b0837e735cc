"""Renderers -> files, hashes, zip, manifest, in a folder that is given."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from tactape_fab import __version__
from tactape_fab.kit.artifact import Artifact, zip_date
from tactape_fab.kit.layout import Layout
from tactape_fab.kit.render.assembly import render_bom, render_cpl
from tactape_fab.kit.render.components import render_components
from tactape_fab.kit.render.drill import render_drill
from tactape_fab.kit.render.gerber import render_copper, render_coverlay, render_legend, render_paste, render_profile
from tactape_fab.kit.render.job import render_job
from tactape_fab.kit.render.preview import render_preview
from tactape_fab.kit.spec import TapeSpec
from tactape_fab.profiles import FabProfile, LandPattern, PartProfile
from tactape_fab.texture.tape import MANIFEST_FORMAT, MANIFEST_NAME

RENDERERS: Mapping[str, Callable[[Layout, FabProfile], Iterable[Artifact]]] = {
    "copper-top": render_copper,
    "coverlay-top": render_coverlay,
    "paste-top": render_paste,
    "legend-top": render_legend,
    "profile": render_profile,
    "drill-npth": render_drill,
    "components-top": render_components,
    "job": render_job,
    "cpl": render_cpl,
    "bom": render_bom,
}
"""Renderer of each role; one that a tape has no use for gives no file."""

FAB_ZIP_ROLES = ("copper-top", "coverlay-top", "paste-top", "legend-top", "profile", "drill-npth", "job")
"""What is uploaded to the fab; never the component layer."""


def render_all(layout: Layout, fab: FabProfile) -> list[Artifact]:
    """Every file of the kit but its manifest: fabrication, assembly, previews drawn from those, and the zip."""
    artifacts = [artifact for render in RENDERERS.values() for artifact in render(layout, fab)]
    artifacts += render_preview(artifacts, fab)
    artifacts.append(_fab_zip(layout, artifacts))
    return artifacts


def _fab_zip(layout: Layout, artifacts: Iterable[Artifact]) -> Artifact:
    """The zip with fixed dates and order, the same bytes every time."""
    stream = io.BytesIO()
    date = zip_date()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for artifact in sorted((a for a in artifacts if a.role in FAB_ZIP_ROLES), key=lambda a: a.path):
            entry = zipfile.ZipInfo(artifact.path.rsplit("/", 1)[-1], date.timetuple()[:6])
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, artifact.data)
    return Artifact(role="fab-zip", path=f"{layout.tape.name}-fab.zip", data=stream.getvalue())


def manifest(layout: Layout, spec: TapeSpec, fab: FabProfile, artifacts: Iterable[Artifact]) -> dict[str, Any]:
    """Content of manifest.json: the tape, what it was made with, and every file with size and SHA-256."""
    return {
        "format": MANIFEST_FORMAT,
        "tool": {"name": "tactape-fab", "version": __version__},
        **layout.tape.to_mapping(),
        "fab": {"name": fab.name, **fab.thresholds()},
        "land_pattern": _land_pattern(layout.part, fab),
        "spec": {**spec.to_mapping(), "assembly": fab.assembly, "x2": fab.x2},
        "files": [
            {"role": a.role, "path": a.path, "bytes": len(a.data), "sha256": hashlib.sha256(a.data).hexdigest()}
            for a in sorted(artifacts, key=lambda a: a.path)
        ],
    }


def _land_pattern(part: PartProfile, fab: FabProfile) -> dict[str, Any]:
    """What `verify` needs to know of the lands without the part's profile."""

    def land(pattern: LandPattern) -> dict[str, Any]:
        return {
            "size_mm": list(pattern.size_mm),
            "corner_radius_mm": pattern.corner_radius_mm,
            "offset_mm": pattern.offset_mm,
        }

    return {
        "pads": land(part.pads),
        "paste": land(part.paste),
        "opening_expansion_mm": fab.coverlay_expansion_mm,
    }


def write_kit(folder: Path, content: Mapping[str, Any], artifacts: Iterable[Artifact]) -> None:
    """Write all files below `folder`, the manifest last, so that an interrupted run leaves no manifest."""
    for artifact in artifacts:
        path = folder / artifact.path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(artifact.data)
    text = json.dumps(content, indent=1, ensure_ascii=True, allow_nan=False)
    (folder / MANIFEST_NAME).write_text(text + "\n", encoding="ascii", newline="\n")
