"""Writer of a kit: renders its files, and writes them with hashes, zip and manifest into a given folder."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tactape_fab.base.build_date import build_date, zip_date, zip_entry
from tactape_fab.base.libraries import versions_in_kits
from tactape_fab.base.version import __version__
from tactape_fab.kit.artifact import AnyArtifact, Artifact, LongArtifact
from tactape_fab.kit.film.anchors import anchor_plan
from tactape_fab.kit.film.drawing import Drawing
from tactape_fab.kit.film.layout import Layout
from tactape_fab.kit.panel.geometry import Panel, Place
from tactape_fab.kit.profiles import GERBER_ROLES, FabProfile, LandPattern, PartProfile, ProcessProfile
from tactape_fab.kit.render.backing import render_adhesive, render_stiffener
from tactape_fab.kit.render.components import render_components
from tactape_fab.kit.render.cpl_bom import render_bom, render_cpl
from tactape_fab.kit.render.drill import render_drill
from tactape_fab.kit.render.gerber import render_copper, render_coverlay, render_legend, render_paste, render_profile
from tactape_fab.kit.render.job import render_job
from tactape_fab.kit.render.kicad_board import render_kicad
from tactape_fab.kit.render.placement_preview import render_placement_preview
from tactape_fab.kit.render.preview import render_preview
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.solids.forms import SolidForm
from tactape_fab.texture.certify.origin import Choice
from tactape_fab.texture.manifest import MANIFEST_FORMAT, MANIFEST_NAME, PANEL_FORMAT
from tactape_fab.texture.tape import Tape

RENDERERS: Mapping[str, Callable[[Drawing, FabProfile], Iterable[AnyArtifact]]] = {
    "copper-top": render_copper,
    "coverlay-top": render_coverlay,
    "paste-top": render_paste,
    "legend-top": render_legend,
    "profile": render_profile,
    "drill-npth": render_drill,
    "stiffener-bottom": render_stiffener,
    "adhesive-bottom": render_adhesive,
    "components-top": render_components,
    "job": render_job,
    "cpl": render_cpl,
    "bom": render_bom,
    "kicad-pcb": render_kicad,
}
"""Renderer of each role; a renderer that does not apply to a tape gives no file."""

TOOL = {"name": "tactape-fab", "version": __version__}

FAB_ZIP_ROLES = tuple(role for role in GERBER_ROLES if role != "components-top")
"""Roles in the zip for the fab; the job file only if the profile asks for it, never the component layer."""


def render_all(drawing: Drawing, fab: FabProfile) -> list[AnyArtifact]:
    """Every file of a film or a panel except models, notes and manifest: layers, lists, previews drawn from these, the zip."""
    artifacts = [artifact for render in RENDERERS.values() for artifact in render(drawing, fab)]
    artifacts += (*render_preview(artifacts, fab), *render_placement_preview(artifacts, fab))
    artifacts.append(_fab_zip(drawing.name, [a for a in artifacts if a.role != "job" or fab.job_in_zip]))
    return artifacts


def render_models(tape: Tape, form: SolidForm, fab: FabProfile | None) -> list[AnyArtifact]:
    """The 3D models: for a film with its assembly, for a texture of solid elements (`fab` None) with previews of the mesh."""
    from tactape_fab.kit.render.solid_models import render_assembly, render_solid  # imported here: only kits with models need it
    from tactape_fab.kit.render.solid_preview import render_solid_preview

    models = render_solid(tape, form)
    if fab is None:
        return [*models, *render_solid_preview(models, tape, form)]
    return [render_assembly(tape, fab), *models]


def _fab_zip(name: str, artifacts: Iterable[AnyArtifact]) -> Artifact:
    """The zip for the fab, with fixed dates and order so that its bytes are reproducible."""
    stream = io.BytesIO()
    date = zip_date()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        # file names without folders; sorted, so that the order does not depend on that of the renderers
        for artifact in sorted((a for a in artifacts if a.role in FAB_ZIP_ROLES), key=lambda a: a.path):
            archive.writestr(zip_entry(artifact.path.rsplit("/", 1)[-1], date), artifact.data)
    return Artifact(role="fab-zip", path=f"{name}-fab.zip", data=stream.getvalue())


def manifest(tape: Tape, made_by: Mapping[str, Any], artifacts: Iterable[AnyArtifact]) -> dict[str, Any]:
    """Content of manifest.json: the tape, profiles and options, and every file with size and SHA-256.

    made_by: Result of `film_record` or `texture_record`.
    """
    return {
        "format": MANIFEST_FORMAT,
        "tool": TOOL,
        **tape.to_mapping(),
        **made_by,
        "files": file_rows(artifacts),
    }


def made_record(spec: TapeSpec, *, verified: bool) -> dict[str, Any]:
    """Record of everything other than the spec on which the bytes of a kit depend, so that it can be reproduced.

    spec: The spec as given.
    verified: Whether the kit was verified when it was made, which its report states.
    """
    return {
        "made": {
            "date": f"{build_date():%Y-%m-%dT%H:%M:%S+00:00}",
            "libraries": versions_in_kits(),
            "verified": verified,
            "coverlay_asked": spec.coverlay is not None,
        }
    }


def file_rows(artifacts: Iterable[AnyArtifact]) -> list[dict[str, Any]]:
    """A manifest row for each file; `write_kit` fills in size and digest of long files."""
    return [
        {
            "role": a.role,
            "path": a.path,
            # a long file is generated while it is written, so its size and digest are not known before
            **({"bytes": None, "sha256": None} if isinstance(a, LongArtifact) else _digest([a.data])),
        }
        for a in sorted(artifacts, key=lambda a: a.path)
    ]


def _digest(pieces: Iterable[bytes], write: Callable[[bytes], object] = lambda _: None) -> dict[str, Any]:
    """Size and SHA-256 of a file in pieces, each of which is passed to `write`."""
    size, digest = 0, hashlib.sha256()
    for piece in pieces:
        write(piece)
        digest.update(piece)
        size += len(piece)
    return {"bytes": size, "sha256": digest.hexdigest()}


def with_file(content: Mapping[str, Any], artifact: Artifact) -> dict[str, Any]:
    """The content of a manifest with another file."""
    rows = sorted([*content["files"], *file_rows([artifact])], key=lambda row: str(row["path"]))
    return {**content, "files": rows}


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedKit:
    """A kit on a panel: path and bytes of its manifest, its place, and the number of its first designator."""

    tape: Tape
    manifest: str
    data: bytes
    place: Place
    first: int


def panel_manifest(
    name: str, panel: Panel, kits: Iterable[PlacedKit], made_by: Mapping[str, Any], artifacts: Iterable[AnyArtifact]
) -> dict[str, Any]:
    """Content of a panel's manifest.json: its tapes and their places, profiles and options, and its own files."""
    return {
        "format": PANEL_FORMAT,
        "name": name,
        "tool": TOOL,
        "panel": panel.to_mapping(),
        "tapes": [
            {
                "manifest": kit.manifest,
                "sha256": hashlib.sha256(kit.data).hexdigest(),
                "name": kit.tape.name,
                "sector": kit.tape.sector,
                "parts": kit.tape.part_count,
                "offset_mm": list(kit.place.offset_mm),
                "rotation_deg": kit.place.rotation_deg,
                "first_designator": f"R{kit.first}",
            }
            for kit in kits
        ],
        **made_by,
        "files": file_rows(artifacts),
    }


def panel_record(layout: Layout, spec: TapeSpec, fab: FabProfile) -> dict[str, Any]:
    """Record of profiles and options in a panel's manifest: as `film_record`, without keys of single tapes."""
    record = film_record(layout, spec, fab, None)
    own = ("name", "sector", "origin", "tag_id")
    return {
        **{key: value for key, value in record.items() if key not in ("solid", "process")},
        "spec": {key: value for key, value in record["spec"].items() if key not in own},
    }


def film_record(layout: Layout, spec: TapeSpec, fab: FabProfile, process: ProcessProfile | None) -> dict[str, Any]:
    """Record of profiles and options in a film's manifest."""
    return {
        "fab": {"name": fab.name, **fab.thresholds()},
        "land_pattern": _land_pattern(layout.part, fab),
        "assembly": {
            "format": fab.assembly,
            "value": layout.part.value,
            "footprint": layout.part.footprint,
            "description": layout.part.description,
            "part_number": layout.part.part_numbers.get(fab.assembly),
        },
        **_film_extras(layout, fab),
        **_models_record(spec.form, process),
        "spec": {**spec.to_mapping(), "assembly": fab.assembly, "x2": fab.x2, "coverlay": fab.coverlay_mode},
    }


def _film_extras(layout: Layout, fab: FabProfile) -> dict[str, Any]:
    """Anchors, stiffener and adhesive for `verify`, if there are any."""
    extras: dict[str, Any] = {}
    if layout.anchors is not None:
        extras["anchor"] = asdict(anchor_plan(layout.anchors.mode, fab, layout.outlines))
    for key, backing in (("stiffener", layout.stiffener), ("adhesive", layout.adhesive)):
        if backing is not None:
            extras[key] = backing
    return extras


def texture_record(spec: TapeSpec, process: ProcessProfile) -> dict[str, Any]:
    """Record of profiles and options in the manifest of a texture of solid elements, with a process in place of a fab."""
    return {
        "fab": {"name": process.name, **process.thresholds()},
        **_models_record(spec.form, process),
        "spec": spec.to_mapping(),
    }


def search_record(choice: Choice | None, avoided: Sequence[str]) -> dict[str, Any]:
    """Record of a search for the origin, or of the tapes from which a design had to differ."""
    if choice is None:
        return {"avoided": list(avoided)} if avoided else {}
    return {"search": {**asdict(choice), "origin": list(choice.origin), "avoided": list(avoided)}}


def _models_record(form: SolidForm | None, process: ProcessProfile | None) -> dict[str, Any]:
    if form is None:
        return {}
    return {
        "solid": form.to_mapping(),
        "process": None if process is None else {"name": process.name, **process.thresholds()},
    }


def _land_pattern(part: PartProfile, fab: FabProfile) -> dict[str, Any]:
    """Land pattern in the form that `verify` reads without the part's profile."""

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


def write_kit(folder: Path, content: Mapping[str, Any], artifacts: Iterable[AnyArtifact]) -> None:
    """Write all files below `folder`, the manifest last, so that an interrupted run leaves no manifest."""
    rows = {row["path"]: row for row in content["files"]}
    for artifact in artifacts:
        path = folder / artifact.path
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as stream:
            if isinstance(artifact, LongArtifact):
                rows[artifact.path].update(_digest(artifact.pieces(), stream.write))
            else:
                stream.write(artifact.data)
    # allow_nan=False: JSON has no NaN and Infinity (RFC 8259), and a reader would refuse the manifest
    text = json.dumps(content, indent=1, ensure_ascii=True, allow_nan=False)
    (folder / MANIFEST_NAME).write_text(text + "\n", encoding="ascii", newline="\n")
