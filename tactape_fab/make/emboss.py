"""emboss_kit: puts a kit's texture on the user's own part, verifies the result, and publishes it as one folder."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base.build_date import build_date, zip_date
from tactape_fab.base.dropped_signal import signals_held
from tactape_fab.base.errors import Check, LostProcessError, Problem, SpecError, VerifyError, reason_of, tried
from tactape_fab.base.fields import shown_path
from tactape_fab.base.input_file import read_regular
from tactape_fab.base.launch import limit_self, too_long
from tactape_fab.base.libraries import library
from tactape_fab.base.pool import ProcessPool, send_message
from tactape_fab.base.version import __version__
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.output_place import Overwrite, refuse_taken
from tactape_fab.kit.render.certificate_json import render_certificate
from tactape_fab.kit.render.sim import render_part_sim
from tactape_fab.kit.writer import TOOL, file_rows, write_kit
from tactape_fab.make.publish import finished
from tactape_fab.report import add_report
from tactape_fab.solids.mesh.triangles import Mesh, stl_bytes, threemf_bytes
from tactape_fab.solids.surface.charts import Chart, Placement
from tactape_fab.solids.surface.fuse import Fused, Progress, fuse_mesh
from tactape_fab.solids.surface.part_files import (
    MESH_FORMATS,
    MOST_BYTES,
    UNITS_MM,
    closed_mesh,
    read_surface_mesh,
    refuse_far_away,
    refuse_wrong_size,
)
from tactape_fab.solids.surface.part_mesh import Facets, MeshChart
from tactape_fab.solids.surface.patch import MOST_PITCH_ERROR
from tactape_fab.solids.surface.place import LaidOut, lay_out, record, refuse_tape, smaller_kit, texture_size_mm
from tactape_fab.solids.surface.placements import placements_csv
from tactape_fab.texture.certify.certificate import certify
from tactape_fab.texture.manifest import find_manifest, read_manifest
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.models.embossed import check_embossed

STEP_FORMATS = ("step", "stp")
STEP_CPU_S, MESH_CPU_S = 5.0, 30.0
"""Limit of processor time per MB of a STEP file, at least one MB: for reading, which took at most 0.7 s, and for meshing within
`chord_error_mm`, which took 7 s for a ball of 30 mm and 12 s per MB of a plate with 400 holes."""
_LOADING_S = 30.0
STEP_MEMORY_BYTES, STEP_MEMORY_PER_BYTE = 3 << 30, 400
_FUSING_S, _FUSING_BYTES = 10, 32 << 30
"""Limits for fusing elements with a valid solid: processor time per element, and memory."""
_FAR = 10.0
"""Distance of the points from which the sides of a part are found, as a multiple of its largest dimension."""
Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Embossed:
    """A finished embossed part.

    path: Its folder.
    surface: The manifest's ``surface``: source, place, radius, distortion, volumes.
    checks: Every line of its verification.
    files: Paths by role, relative to the folder.
    """

    path: Path
    tape: Tape
    surface: Mapping[str, Any]
    checks: tuple[Check, ...]
    files: Mapping[str, str]

    def to_mapping(self) -> dict[str, Any]:
        """The part as the JSON object that `tactape-fab emboss --json` prints."""
        return {
            "path": str(self.path),
            "name": self.tape.name,
            "surface": dict(self.surface),
            "files": dict(self.files),
            "checks": [asdict(c) for c in self.checks],
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class _Source:
    """The user's file: its name, format and bytes."""

    path: Path
    kind: str
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Made:
    """The texture on the part; for a STEP source also the index of its face and the fused STEP file."""

    laid: LaidOut
    fused: Fused
    face: int | None = None
    step: bytes | None = None


def emboss_kit(
    kit_path: str | Path,
    surface_path: str | Path,
    output: str | Path | None = None,
    *,
    placement: Placement = Placement(),  # noqa: B008 (frozen)
    overwrite: Overwrite = False,
    unit: str = "mm",
    sim: bool = False,
    progress: Progress = lambda *_: None,
    known: Sequence[Problem] = (),
) -> Embossed:
    """Put a kit's texture on the user's own part.

    kit_path: Folder of a kit, or its manifest.json.
    surface_path: The part: a closed mesh (STL, 3MF, OBJ, PLY) or a STEP file of one solid.
    output: Folder of the result; by default ``<part>-<tape>`` beside the part.
    placement: Place on the part, and direction of board +y.
    overwrite: Replace an older result at `output`, as for `make_kit`. Anything else there is refused.
    unit {"mm", "cm", "m", "inch"}: Unit of an STL, OBJ or PLY. 3MF and STEP files state their own.
    sim: Add assets for simulators.
    progress: Called with the name of the step, the number of finished elements and their total.
    known: Problems already found, which are raised together with all others.
    Raises SpecError if the kit or the part cannot be read, the part is not a solid, or the texture does not fit on it.
    Raises MissingLibraryError if the extra ``cad`` is not installed.
    Raises VerifyError if the written files fail the verification; nothing is left at `output`.
    """
    problems = list(known)
    kit = tried(lambda: _read_kit(kit_path), problems)
    source = tried(lambda: _read_source(Path(surface_path), unit), problems)
    if source is not None and source.kind != "step" and placement.face is not None:
        message = f"face = {placement.face} is one of a STEP solid, and {shown_path(source.path)} is a mesh; leave it out"
        problems.append(Problem("face", message))
    target = None if output is None else Path(output)
    if target is not None:
        tried(partial(refuse_taken, target, overwrite=overwrite), problems)
    if problems or kit is None or source is None:
        raise SpecError(problems)
    content, tape = kit
    with signals_held():
        library("manifold3d", "emboss")
    # only characters that every file system accepts; a leading dot would hide the folder, a leading hyphen look like an option
    name = re.sub(r"[^A-Za-z0-9._+-]+", "-", f"{source.path.stem}-{tape.name}").lstrip(".-")
    if target is None:
        target = source.path.parent / name
        refuse_taken(target, overwrite=overwrite)
    progress("reading", 0, tape.part_count)
    made = (_on_step if source.kind == "step" else _on_mesh)(tape, source, placement, unit, progress)
    artifacts = [*_artifacts(tape, made, name), *render_certificate(certify(tape))]
    if sim:
        artifacts += render_part_sim(name, made.fused.mesh)
    surface = _surface(source, made, unit)
    manifest = {
        **{key: value for key, value in content.items() if key != "made"},  # "made" describes the kit's own files
        "tool": TOOL,
        "surface": surface,
        "files": file_rows(artifacts),
    }
    progress("verifying", tape.part_count, tape.part_count)
    data = {a.role: a.data for a in artifacts}
    # before anything is at the target, so that a failure leaves no folder
    checks = tuple(check_embossed(manifest, data["stl"], data["placements"]))
    if not all(check.passed or check.warning for check in checks):
        raise VerifyError(_with_remedy(checks))
    with finished(target, "part", overwrite=overwrite) as folder:
        write_kit(folder, manifest, artifacts)
        artifacts.append(add_report(folder, manifest, tape, checks=checks))
    files = {a.role: a.path for a in artifacts}
    return Embossed(path=target, tape=tape, surface=surface, checks=checks, files=files)


def _with_remedy(checks: Sequence[Check]) -> list[Check]:
    """The checks, the last failed one with what to change.

    Elements over folds of coarse facets stand elsewhere than planned: of 30 balls of 80 triangles 25 were refused before and one
    failed, of 60 of 320 and 40 of 1280 none.
    """
    last = max(i for i, check in enumerate(checks) if not (check.passed or check.warning))
    remedy = "where facets are coarse, elements over their edges stand off; give a SURFACE of finer facets, or another place"
    return [replace(check, message=f"{check.message}; {remedy}") if i == last else check for i, check in enumerate(checks)]


def _read_kit(path: str | Path) -> tuple[Mapping[str, Any], Tape]:
    content = read_manifest(find_manifest(path))
    tape = Tape.from_mapping(content)
    refuse_tape(tape)
    solid = content.get("solid")
    if isinstance(solid, Mapping) and solid.get("negative") is True:
        raise SpecError(f"KIT = {shown_path(path)} is a mould; make the texture itself, without --negative, and emboss that")
    return content, tape


def _read_source(path: Path, unit: str) -> _Source:
    kind, problems = path.suffix.lower().removeprefix("."), list[Problem]()
    kind = "step" if kind in STEP_FORMATS else kind
    if unit not in UNITS_MM:
        problems.append(Problem("unit", f"unit = {unit!r} is none of: {', '.join(UNITS_MM)}; give one of them"))
    elif unit != "mm" and kind in ("step", "3mf"):
        problems.append(Problem("unit", f"unit = {unit}: a {kind.upper()} file says its unit itself; leave --unit out"))
    if kind not in (*MESH_FORMATS, "step"):
        formats = ", ".join((*MESH_FORMATS, *STEP_FORMATS))
        problems.append(Problem("surface", f"SURFACE = {shown_path(path)} is none of: {formats}; export it as one"))
        raise SpecError(problems)
    source = tried(lambda: _read_model(path, kind), problems)
    if source is None or problems:
        raise SpecError(problems)
    return source


def _read_model(path: Path, kind: str) -> _Source:
    try:
        data = read_regular(path, MOST_BYTES)
        if len(data) > MOST_BYTES:
            raise SpecError(f"SURFACE = {shown_path(path)} has more than {MOST_BYTES} bytes; give a coarser model")
    except (OSError, ValueError) as error:
        if isinstance(error, SpecError):
            raise
        raise SpecError(f"SURFACE = {shown_path(path)} cannot be read: {reason_of(error)}; give a model file") from error
    return _Source(path=path, kind=kind, data=data)


def _on_mesh(tape: Tape, source: _Source, placement: Placement, unit: str, progress: Progress) -> _Made:
    mesh = read_surface_mesh(source.data, source.kind, unit)
    # before the mesh is processed, as a part in the wrong unit may be a thousand times too large or small
    refuse_wrong_size(np.ptp(mesh.vertices_mm, axis=0), None if source.kind == "3mf" else unit, texture_size_mm(tape))
    refuse_far_away(mesh.vertices_mm)
    mesh = closed_mesh(mesh)
    progress("mapping", 0, tape.part_count)
    laid = lay_out_within_error(tape, lambda at: MeshChart(mesh, replace(placement, at_mm=at)), placement, _sides_mm(mesh))
    return _Made(laid=laid, fused=fuse_mesh(mesh, laid, progress))


def _sides_mm(mesh: Mesh) -> list[Point]:
    """Points of a mesh that are nearest to distant points along its coordinate axes: places on its six sides."""
    low, high = mesh.vertices_mm.min(axis=0), mesh.vertices_mm.max(axis=0)
    middle, facets = (low + high) / 2, Facets(mesh=mesh)
    # from ten times its largest dimension the nearest point is on the side that faces the axis, not in a hollow
    far = [middle + sign * _FAR * float((high - low).max()) * axis for axis in np.eye(3) for sign in (1, -1)]
    return [(float(x), float(y), float(z)) for x, y, z in (facets.nearest(point)[1] for point in far)]


def lay_out_within_error(
    tape: Tape, chart_at: Callable[[Point | None], Chart], placement: Placement, others_mm: Sequence[Point] = ()
) -> LaidOut:
    """The texture at the given place, or by default at a place where the error of its pitch is within `MOST_PITCH_ERROR`.

    chart_at: Gives the chart at a point, or for None at the surface's default place, which is used if it is good enough.
    others_mm: Other places to try; the one of least error is used.
    Raises SpecError if the texture fits nowhere, or nowhere without a larger error and no place was asked for.
    """
    # at a given place any distortion is accepted and recorded
    if placement.at_mm is not None or placement.face is not None:
        return lay_out(tape, chart_at(placement.at_mm))
    refused: list[Problem] = []
    usual = tried(lambda: lay_out(tape, chart_at(None)), refused)
    if usual is not None and worst_pitch_error(usual.distortion.to_mapping()) <= MOST_PITCH_ERROR:
        return usual
    found = [usual, *(tried(lambda at=at: lay_out(tape, chart_at(at)), []) for at in others_mm)]  # type: ignore[misc]
    laid = [one for one in found if one is not None]
    if not laid:
        raise SpecError(refused)
    best = min(laid, key=lambda one: worst_pitch_error(one.distortion.to_mapping()))
    if (worst := worst_pitch_error(best.distortion.to_mapping())) <= MOST_PITCH_ERROR:
        return best
    at = ",".join(f"{value:g}" for value in (best.centre.points_mm[0].round(3) + 0.0).tolist())  # + 0.0: no minus before 0
    reach, usable = best.distortion.reach_mm, best.distortion.usable_radius_mm
    message = (
        f"the pitch is off by up to {worst:.0%} at the best of {1 + len(others_mm)} places, more than {MOST_PITCH_ERROR:.0%}; "
        f"the texture reaches {reach:.1f} mm, usable are {usable:.1f} mm; "
        f"use --at {at} to have it so, or {smaller_kit(tape, reach, usable)}"
    )
    raise SpecError(Problem("surface", message))


def worst_pitch_error(distortion: Mapping[str, float | None]) -> float:
    """Largest error of the pitch, too long or too short, of a recorded distortion."""
    return max(abs(float(distortion[key] or 0.0)) for key in ("pitch_error_min", "pitch_error_max"))


def _on_step(tape: Tape, source: _Source, placement: Placement, unit: str, progress: Progress) -> _Made:
    """As `_on_mesh`, in a child process with limits, as a damaged STEP file can crash OCCT or keep it busy for ever."""
    with ProcessPool(1, progress) as pool:
        try:
            return pool.submit(_on_step_alone, tape, source, placement).result()
        except LostProcessError as error:
            why = "takes too long" if too_long(error.exit_status) else "ends its process"
            message = f"SURFACE cannot be read as STEP: the CAD kernel {why} over it; export it again, or as STL"
            raise SpecError(message) from error


def _on_step_alone(tape: Tape, source: _Source, placement: Placement) -> _Made:
    # time per MB, at least one MB, as the CAD kernel needs some time in any case
    progress, megabytes = send_message, max(1.0, len(source.data) / 1e6)
    memory_bytes = STEP_MEMORY_BYTES + STEP_MEMORY_PER_BYTE * len(source.data)
    # limits are set anew before each step (loading the kernel, reading, meshing, fusing), on top of what was used before
    limit_self(cpu_s=_LOADING_S, memory_bytes=memory_bytes)
    library("build123d", "emboss")
    from tactape_fab.solids.surface.part_step import FaceChart, read_step_solid
    from tactape_fab.solids.surface.step_fuse import embossed_step

    limit_self(cpu_s=STEP_CPU_S * megabytes, memory_bytes=memory_bytes)
    model = read_step_solid(source.data)
    refuse_wrong_size(model.size_mm, None, texture_size_mm(tape))
    refuse_far_away(model.corners_mm)
    chart = FaceChart(model, placement)
    progress("mapping", 0, tape.part_count)
    limit_self(cpu_s=MESH_CPU_S * megabytes, memory_bytes=memory_bytes)
    mesh = model.tessellated()
    # the remaining time grows with the number of elements; 60 more stand for the base cost
    limit_self(cpu_s=_FUSING_S * (60 + tape.part_count), memory_bytes=_FUSING_BYTES)
    laid = lay_out_within_error(tape, lambda _: chart, placement)
    fused = fuse_mesh(mesh, laid, progress, chord_error_mm=model.chord_error_mm)
    stamp = build_date().replace(tzinfo=None).isoformat()
    step = embossed_step(model.solid, chart.surface, laid, stamp, progress)
    return _Made(laid=laid, fused=fused, face=chart.face, step=step)


def _artifacts(tape: Tape, made: _Made, name: str) -> list[Artifact]:
    description = f"{tape.name} on a surface: code {tape.code}, sector {tape.sector}, {tape.part_count} elements"
    metadata = {"Description": description, "Application": f"tactape-fab {__version__}"}
    mesh = made.fused.mesh
    files = [
        ("stl", f"{name}.stl", stl_bytes(mesh, name)),
        ("3mf", f"{name}.3mf", threemf_bytes(mesh, name, metadata, zip_date())),
        ("placements", f"{name}-placements.csv", placements_csv(made.laid)),
    ]
    if made.step is not None:
        files.append(("step-solid", f"{name}.step", made.step))
    return [Artifact(role=role, path=f"models/{path}", data=data) for role, path, data in files]


def _surface(source: _Source, made: _Made, unit: str) -> dict[str, Any]:
    return {
        "source": source.path.name,
        "sha256": hashlib.sha256(source.data).hexdigest(),
        "format": source.kind,
        "unit": None if source.kind in ("step", "3mf") else unit,
        "face": made.face,
        **record(made.laid),
        "bodies": made.fused.bodies,
        "volume_mm3": round(made.fused.volume_mm3, 6),
        "source_volume_mm3": round(made.fused.host_volume_mm3, 6),
    }
