"""Verification of a kit's written files; each check is a line with its figure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base.errors import Check, SpecError, refuse
from tactape_fab.base.fields import Fields, named
from tactape_fab.kit.read.readback import read_cpl
from tactape_fab.solids.checks import form_problems
from tactape_fab.solids.forms import SolidForm, read_form
from tactape_fab.solids.mesh.stl import MeshError, read_stl
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.texture.code import get_code
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.manifest import read_manifest
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.budgets import count_of
from tactape_fab.verify.certificate import check_certificate
from tactape_fab.verify.files import (
    CERTIFICATE,
    Kind,
    WrittenFile,
    check_as_built,
    check_listed,
    check_picture,
    kind_of,
    read_files,
    roles_of,
)
from tactape_fab.verify.film import (
    anchor_lines,
    check_attributes,
    check_tape,
    pair_all_lands,
    read_film_manifest,
    read_layers,
    read_role,
)
from tactape_fab.verify.layers.board import check_outline
from tactape_fab.verify.layers.cpl_rows import check_bom, check_cpl
from tactape_fab.verify.layers.drawings import check_drawings
from tactape_fab.verify.layers.fab_zip import check_zip
from tactape_fab.verify.layers.film_layers import FilmManifest, forced_as_warnings
from tactape_fab.verify.layers.job_file import check_job
from tactape_fab.verify.layers.kicad import check_kicad, shown_tape
from tactape_fab.verify.layers.kicad_drawn import Made
from tactape_fab.verify.layers.order_notes import check_order_notes
from tactape_fab.verify.layers.written_form import check_form
from tactape_fab.verify.models.cad_readers import read_by_others
from tactape_fab.verify.models.expected import Expected, expected_of_embossed, expected_of_kit
from tactape_fab.verify.models.meshes import check_models, check_threemf
from tactape_fab.verify.models.step_text import MOST_OF_PART_MM, step_problems
from tactape_fab.verify.pictured import Pictured
from tactape_fab.verify.spec_record import contradictions
from tactape_fab.verify.trip.positions import Source, copper_source, cpl_source, stl_source
from tactape_fab.verify.trip.round_trip import Contact, Progress, Trip, check_measured, full_trips, quick_trip, trip_checks
from tactape_fab.verify.verification import Beside, OnCheck, Verification, collected, unreadable


@dataclass(frozen=True, slots=True, kw_only=True)
class _Record:
    """Content of a kit's manifest."""

    manifest: Mapping[str, Any]
    tape: Tape
    kind: Kind
    film: FilmManifest | None
    form: SolidForm | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Asked:
    """Arguments of a kit's verification."""

    quick: bool
    contact: Contact | None
    progress: Progress
    beside: Beside


def verify_folder(
    manifest_file: Path,
    *,
    quick: bool,
    contact: Contact | None = None,
    progress: Progress = lambda *_: None,
    on_check: OnCheck = lambda _: None,
    beside: Beside = tuple,
) -> Verification:
    """Verify the kit of `manifest_file`; the name of its folder does not matter."""
    try:
        record = _read_record(manifest_file)
    except SpecError as error:
        return unreadable(manifest_file.parent.name, error, on_check)
    asked, trips = _Asked(quick=quick, contact=contact, progress=progress, beside=beside), list[Trip]()
    return collected(record.tape.name, _checks(manifest_file, record, asked, trips), on_check, trips)


def _read_record(manifest_file: Path) -> _Record:
    manifest = read_manifest(manifest_file)
    tape = Tape.from_mapping(manifest)
    kind = kind_of(manifest)
    table = Fields(manifest)
    film = read_film_manifest(table) if kind == "film" else None
    form = read_form(table.table("solid")) if kind == "texture" or (kind == "film" and "solid" in manifest) else None
    table.table("tool")
    table.table("spec")
    refuse(table.problems)
    return _Record(manifest=manifest, tape=tape, kind=kind, film=film, form=form)


def _checks(manifest_file: Path, record: _Record, asked: _Asked, trips: list[Trip]) -> Iterator[Check]:
    """Every line as soon as it is known, those of other programs last; full round trips are appended to `trips`."""
    tape, kind, film = record.tape, record.kind, record.film
    problems = contradictions(record.manifest, tape)
    message = (
        named([p.message for p in problems]) if problems else f"{tape.part_count} parts, symbols {get_code(tape.code).proven_by}"
    )
    yield Check(name="manifest", passed=not problems, message=message)
    listed, file_checks = read_files(manifest_file.parent, record.manifest, count_of(tape))
    backings = () if film is None else tuple(film.film.backings)
    expected = roles_of(tape, kind, models=record.form is not None, backings=backings)
    allowed = ("step-solid",) if kind == "embossed" else ()
    files, missing, role_checks = check_listed(record.manifest, listed, expected, allowed=allowed)
    measured, measured_checks = check_as_built(manifest_file, tape)
    yield from (*file_checks, *measured_checks, *role_checks)
    if missing:
        yield Check(name="content", passed=False, message=f"nothing further can be checked without {named(missing)}")
        yield from asked.beside()
        return
    checks: list[Check] = []
    cpl = None if film is None else read_role("cpl", read_cpl, files, checks)
    yield from checks
    with ExitStack() as stack:  # other programs read the models in the background, while this process does the rest
        others = None if asked.quick else _expected(record, files)
        lines = None if others is None else stack.enter_context(read_by_others(tape, others, files, cpl, asked.progress))
        if kind == "embossed":
            yield from _check_part(record.manifest, tape, files)
        else:
            yield from _check_kit(record, files, cpl, asked, trips)
            if measured.as_built is not None and not asked.quick:
                yield check_measured(measured, asked.contact)
        yield from asked.beside()
        yield from () if lines is None else lines


def _check_kit(
    record: _Record, files: dict[str, WrittenFile], cpl: CplContent | None, asked: _Asked, trips: list[Trip]
) -> Iterator[Check]:
    """Check the files of a film or texture, and decode contacts with the parts at the places in these files."""
    tape, film, form = record.tape, record.film, record.form
    sources: list[Source] = []
    if film is not None:
        yield from () if cpl is None else check_cpl(cpl, tape, film.assembly, film.lands.pads)
        yield check_bom(files["bom"].data, tape.designators(), film.assembly)
        yield check_order_notes(files, tape, film=film)
        yield from forced_as_warnings(_check_film(tape, film, files, cpl, sources, quick=asked.quick), film.film)
    yield check_certificate(files[CERTIFICATE], tape)
    xy_mm, part = tape.part_xy_mm(), tape.part
    angles = np.full(len(xy_mm), part.rotation_deg)
    shown = Pictured(size_mm=tape.board.size_mm, xy_mm=xy_mm, rotation_deg=angles, body_mm=part.body_mm[:2])
    yield check_picture(files, tape.name, None if film is None else shown)
    if form is not None:
        mesh, problems = _read_mesh(files), form_problems(tape, form)
        if problems:
            yield Check(name="solid", passed=False, message="; ".join(p.message for p in problems))
        elif isinstance(mesh, str):
            yield Check(name="stl", passed=False, message=mesh)
        else:
            yield from check_models(tape, form, files, mesh, cpl)
        # in a quick verification the contacts by CPL and copper are enough for a film
        if isinstance(mesh, Mesh) and not (asked.quick and sources):
            sources.append(stl_source(tape, form, mesh))
    if sources:
        made = [quick_trip(tape, s) for s in sources] if asked.quick else full_trips(tape, sources, asked.contact, asked.progress)
        trips += () if asked.quick else made
        yield from trip_checks(tape, sources, made)


def _read_mesh(files: Mapping[str, WrittenFile]) -> Mesh | str:
    """The mesh of the STL, or the reason why it cannot be read."""
    try:
        return read_stl(files["stl"].data)
    except MeshError as error:
        return f"{files['stl'].path}: {error}"


def _check_part(manifest: Mapping[str, Any], tape: Tape, files: dict[str, WrittenFile]) -> Iterator[Check]:
    """Check the models of a texture on the user's own part, and its certificate."""
    from tactape_fab.verify.models.embossed import (
        check_embossed,  # imported here: verifying a film does not need it
    )

    yield check_certificate(files[CERTIFICATE], tape)
    yield from check_embossed(manifest, files["stl"].data, files["placements"].data)
    mesh = _read_mesh(files)
    if isinstance(mesh, Mesh):  # otherwise reported already
        yield check_threemf(files["3mf"].data, mesh)
    if "step-solid" in files:
        problems = step_problems(files["step-solid"].data, MOST_OF_PART_MM)
        yield Check(name="step-solid", passed=not problems, message="; ".join(problems) or "a whole file in millimetres")


def _expected(record: _Record, files: dict[str, WrittenFile]) -> Expected | None:
    """Values that other programs must find in the models; None without models, or if the manifest's record is invalid."""
    if record.kind != "embossed":
        valid = record.form is not None and not form_problems(record.tape, record.form)
        return expected_of_kit(record.tape, record.form, files) if valid and record.form is not None else None
    surface = Fields(record.manifest["surface"])
    volume_mm3 = surface.number("volume_mm3", above=0.0, unit="mm3", default=1.0)
    bodies = surface.integer("bodies", low=1, high=1_000_000, default=1)
    return None if surface.problems else expected_of_embossed(volume_mm3, bodies, files)


def _check_film(
    tape: Tape,
    film: FilmManifest,
    files: dict[str, WrittenFile],
    cpl: CplContent | None,
    sources: list[Source],
    *,
    quick: bool,
) -> list[Check]:
    """Check all files for the fab, including the CPL; the part positions of each file are appended to `sources`."""
    checks: list[Check] = []
    layers = read_layers(files, cpl, film.film, checks)
    checks += [check_attributes(layers.gerbers, files, film), check_form(files, layers.gerbers)]
    if "profile" in layers.gerbers:
        checks.append(check_outline(layers.gerbers["profile"], tape))
    pairs = pair_all_lands(layers, film.lands, tape)
    checks += check_tape(layers, pairs, tape, film, files, with_pupil=not quick)
    if cpl is not None:
        sources.append(cpl_source(cpl))
    if "copper-top" in pairs:
        flashes_mm, offset_mm = layers.gerbers["copper-top"].flash_xy_mm, film.lands.pads.offset_mm
        sources.append(copper_source(flashes_mm, offset_mm, tape.part.rotation_deg, pairs["copper-top"]))
    shown = shown_tape(tape, *anchor_lines(film, tape))
    made = Made(name=tape.name, tape=tape, record=film, gerbers=layers.gerbers, radius_mm=tape.board.corner_radius_mm)
    checks += [*check_kicad(files, shown, made), *check_drawings(files, shown, made)]
    checks.append(check_job(tape.name, tape.board.size_mm, film.order, files))
    return [*checks, check_zip(files, with_job=film.film.job_in_zip)]
