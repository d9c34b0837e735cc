"""verify of a kit: reads its written files; each check is a line with its figure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tactape_fab.base.errors import Check, SpecError
from tactape_fab.base.fields import Fields
from tactape_fab.kit.read.readback import read_cpl
from tactape_fab.solids.checks import form_problems
from tactape_fab.solids.forms import SolidForm, read_form
from tactape_fab.solids.mesh.stl import MeshError, read_stl
from tactape_fab.texture.code import get_code
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.manifest import read_manifest
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.budgets import count_of
from tactape_fab.verify.certificate import check_certificate
from tactape_fab.verify.files import (
    CERTIFICATE,
    WrittenFile,
    check_as_built,
    check_listed,
    check_picture,
    kind_of,
    named,
    read_files,
    roles_of,
)
from tactape_fab.verify.film import (
    FilmManifest,
    anchor_lines,
    check_attributes,
    check_tape,
    pair_all_lands,
    read_film_manifest,
    read_layers,
    read_role,
)
from tactape_fab.verify.layers.board import check_outline
from tactape_fab.verify.layers.cpl_rows import check_bom, check_cpl, check_order_notes
from tactape_fab.verify.layers.fab_zip import check_zip
from tactape_fab.verify.layers.film_layers import pardoned
from tactape_fab.verify.layers.job_file import check_job
from tactape_fab.verify.layers.kicad import check_kicad, shown_tape
from tactape_fab.verify.layers.written_form import check_form
from tactape_fab.verify.models.expected import Expected, expected_of_embossed, expected_of_kit
from tactape_fab.verify.models.meshes import check_models, check_threemf
from tactape_fab.verify.trip.positions import Source, copper_source, cpl_source, stl_source
from tactape_fab.verify.trip.round_trip import Contact, Progress, Trip, full_trips, quick_trips, trip_checks
from tactape_fab.verify.verification import Verification, unreadable


def verify_folder(
    manifest_file: Path, *, quick: bool, contact: Contact | None = None, progress: Progress = lambda *_: None
) -> Verification:
    """Verify the kit of `manifest_file`; the name of its folder plays no part."""
    folder = manifest_file.parent
    try:
        manifest = read_manifest(manifest_file)
        tape = Tape.from_mapping(manifest)
        kind = kind_of(manifest)
        table = Fields(manifest)
        film = read_film_manifest(table) if kind == "film" else None
        form = read_form(table.table("solid")) if kind == "texture" or (kind == "film" and "solid" in manifest) else None
        table.table("tool")
        table.table("spec")
        if table.problems:
            raise SpecError(table.problems)
    except SpecError as error:
        return unreadable(folder.name, error)
    checks = [Check(name="manifest", passed=True, message=f"{tape.part_count} parts, symbols {get_code(tape.code).vouched}")]
    listed, file_checks = read_files(folder, manifest, count_of(tape))
    backings = () if film is None else tuple(film.film.backings)
    expected = roles_of(tape, kind, models=form is not None, backings=backings)
    files, missing, role_checks = check_listed(manifest, listed, expected, allowed=("step-solid",) if kind == "embossed" else ())
    checks += [*file_checks, *check_as_built(manifest_file, tape), *role_checks]
    if missing:
        checks.append(Check(name="content", passed=False, message=f"nothing further can be checked without {named(missing)}"))
        return Verification(name=tape.name, checks=tuple(checks))
    if kind == "embossed":
        checks += _check_part(manifest, tape, files, quick=quick)
        return Verification(name=tape.name, checks=tuple(checks))
    cpl = None
    sources: list[Source] = []
    if film is not None:
        cpl = read_role("cpl", read_cpl, files, checks)
        checks += [] if cpl is None else check_cpl(cpl, tape, film.assembly, film.lands.pads)
        checks += [check_bom(files["bom"].data, tape.designators(), film.assembly), check_order_notes(files, tape)]
        checks += pardoned(_check_film(tape, film, files, cpl, sources, quick=quick), film.film)
    checks += [check_certificate(files[CERTIFICATE], tape), check_picture(files)]
    if form is not None:
        checks += _check_solids(tape, form, files, cpl, quick=quick)
        if not (quick and sources):
            sources += _read_solid(tape, form, files)
    trips: list[Trip] = []
    if sources:
        trips = quick_trips(tape, sources) if quick else full_trips(tape, sources, contact, progress)
        checks += trip_checks(tape, sources, trips)
    return Verification(name=tape.name, checks=tuple(checks), trips=() if quick else tuple(trips))


def _check_part(manifest: dict[str, Any], tape: Tape, files: dict[str, WrittenFile], *, quick: bool) -> list[Check]:
    """Check the models of a texture on the user's own part, and its certificate."""
    from tactape_fab.verify.models.embossed import (
        check_embossed,  # imported here: verifying a film does not need it and is faster without
    )

    checks = [check_certificate(files[CERTIFICATE], tape)]
    checks += check_embossed(manifest, files["stl"].data, files["placements"].data)
    try:
        checks.append(check_threemf(files["3mf"].data, read_stl(files["stl"].data)))
    except MeshError:  # said already
        return checks
    surface = Fields(manifest["surface"])
    volume_mm3 = surface.number("volume_mm3", above=0.0, unit="mm3", default=1.0)
    bodies = surface.integer("bodies", low=1, high=1_000_000, default=1)
    if quick or surface.problems:
        return checks
    return [*checks, *_check_with_others(tape, expected_of_embossed(volume_mm3, bodies, files), files)]


def _check_solids(
    tape: Tape, form: SolidForm, files: dict[str, WrittenFile], cpl: CplContent | None, *, quick: bool
) -> list[Check]:
    problems = form_problems(tape, form)
    if problems:
        return [Check(name="solid", passed=False, message="; ".join(p.message for p in problems))]
    checks = check_models(tape, form, files, cpl)
    return checks if quick else [*checks, *_check_with_others(tape, expected_of_kit(tape, form, files), files, cpl)]


def _check_with_others(
    tape: Tape, expected: Expected, files: dict[str, WrittenFile], cpl: CplContent | None = None
) -> list[Check]:
    from tactape_fab.verify.models.cad_readers import check_with_others

    return check_with_others(tape, expected, files, cpl)


def _read_solid(tape: Tape, form: SolidForm, files: dict[str, WrittenFile]) -> list[Source]:
    try:
        return [stl_source(tape, form, read_stl(files["stl"].data))]
    except MeshError:  # said already
        return []


def _check_film(
    tape: Tape,
    film: FilmManifest,
    files: dict[str, WrittenFile],
    cpl: CplContent | None,
    sources: list[Source],
    *,
    quick: bool,
) -> list[Check]:
    """Check all files that a fab gets, the CPL among them; the part positions of each file are added to `sources`."""
    checks: list[Check] = []
    layers = read_layers(files, cpl, film.film, checks)
    checks += [check_attributes(layers.gerbers, files, film), check_form(files, layers.gerbers)]
    outline_mm = None
    if "profile" in layers.gerbers:
        profile = layers.gerbers["profile"]
        outline_mm = profile.strokes_mm[0] if profile.strokes_mm else None
        checks.append(check_outline(profile, tape))
    pairs = pair_all_lands(layers, film.lands, tape)
    checks += check_tape(layers, pairs, tape, film, files, outline_mm, with_pupil=not quick)
    if cpl is not None:
        sources.append(cpl_source(cpl))
    if "copper-top" in pairs:
        flashes_mm, offset_mm = layers.gerbers["copper-top"].flash_xy_mm, film.lands.pads.offset_mm
        sources.append(copper_source(flashes_mm, offset_mm, tape.part.rotation_deg, pairs["copper-top"]))
    shown = shown_tape(tape, *anchor_lines(film, tape))
    checks += check_kicad(files["kicad-pcb"].data, files["kicad-project"].data, shown, film.lands)
    checks.append(check_job(tape.name, tape.board.size_mm, film.order, files))
    return [*checks, check_zip(files, with_job=film.film.job_in_zip)]
