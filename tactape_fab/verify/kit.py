"""verify: opens the written files of a kit, every check a line with its figure."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from tactape_fab.base.errors import Check, SpecError, VerifyError
from tactape_fab.base.fields import Fields
from tactape_fab.kit.read.gerber_file import GerberContent, ReadbackError, read_gerber
from tactape_fab.kit.read.readback import CplContent, read_cpl, read_drill
from tactape_fab.solids.checks import form_problems
from tactape_fab.solids.forms import SolidForm, read_form
from tactape_fab.solids.mesh.stl import MeshError, read_stl
from tactape_fab.texture.code import get_code
from tactape_fab.texture.manifest import MANIFEST_NAME, find_manifest, read_any_manifest, read_manifest
from tactape_fab.texture.panel_manifest import is_panel
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.certificate import check_certificate
from tactape_fab.verify.files import (
    CERTIFICATE,
    WrittenFile,
    check_job,
    check_picture,
    check_roles,
    check_signature,
    check_zip,
    kind_of,
    named,
    read_files,
    roles_of,
)
from tactape_fab.verify.layers.board import check_components, check_drill, check_edges, check_legend_clear, check_outline
from tactape_fab.verify.layers.cpl_rows import RecordedAssembly, check_bom, check_cpl, check_order_notes, read_assembly
from tactape_fab.verify.layers.film_layers import (
    FilmRecord,
    check_anchors,
    check_backing,
    check_window,
    file_function,
    pardoned,
    read_film_record,
)
from tactape_fab.verify.layers.kicad import check_kicad, shown_tape
from tactape_fab.verify.layers.lands import (
    LandPairs,
    Recorded,
    check_lands,
    check_openings,
    opening_outline,
    pair_lands,
    point_tree,
    read_recorded,
)
from tactape_fab.verify.layers.legend import check_tag
from tactape_fab.verify.models.expected import Expected, expected_of_embossed, expected_of_kit
from tactape_fab.verify.models.meshes import check_models, check_threemf
from tactape_fab.verify.symbols import check_symbols
from tactape_fab.verify.trip.positions import Source, copper_source, cpl_source, stl_source
from tactape_fab.verify.trip.round_trip import Contact, Progress, Trip, full_trips, quick_trips, trip_checks
from tactape_fab.verify.verification import REPORT, check_report

GERBER_ROLES = ("copper-top", "coverlay-top", "paste-top", "legend-top", "profile", "components-top")
FILE_FUNCTIONS = {
    "copper-top": ("Copper,L1,Top", "Positive"),
    "coverlay-top": ("Soldermask,Top", "Negative"),
    "paste-top": ("Paste,Top", "Positive"),
    "legend-top": ("Legend,Top", "Positive"),
    "profile": ("Profile,NP", "Positive"),
    "components-top": ("Component,L1,Top", "Positive"),
}
"""Function and polarity that a file of each role gives itself in its attributes."""


REQUIRED_ATTRIBUTES = ("FileFunction", "FilePolarity", "SameCoordinates", "MD5")

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verification:
    """All lines of a verification.

    Attributes
    ----------
    name : str
        Name of the kit or panel.
    checks : tuple of Check
        Every line, in order.
    trips : tuple of Trip
        Contacts of the round trip, by source; none in a quick verification.
    """

    name: str
    checks: tuple[Check, ...]
    trips: tuple[Trip, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every line holds that is not a mere warning."""
        return all(c.passed or c.warning for c in self.checks)

    def raise_if_failed(self) -> None:
        """Raise an error where a line failed.

        Raises
        ------
        VerifyError
            With every line.
        """
        if not self.passed:
            raise VerifyError(self.checks)


def verify_kit(
    path: str | Path,
    *,
    quick: bool = False,
    contact: Contact | None = None,
    progress: Progress = lambda *_: None,
) -> Verification:
    """Verify a kit, or a panel with every kit on it, by its folder or its manifest.json.

    Parameters
    ----------
    path : str or Path
    quick : bool
        Leave out what needs a CAD kernel, another program or an extra: OCCT, FreeCAD, PrusaSlicer, the second tag detector.
        The round trip is a few contacts then.
    contact : Contact, optional
        Sensor and size of the contacts of the round trip that is not quick.
    progress : callable
        Told what is being done, how much of it is done, and of how much.

    Returns
    -------
    Verification
        Every line, also when some failed; an unreadable manifest is a failed line.

    Raises
    ------
    SpecError
        When there is no kit at `path`.
    """
    file = find_manifest(path)
    if file.name != MANIFEST_NAME:
        raise SpecError(f"{path} is no kit; give the kit's folder or its {MANIFEST_NAME}")
    if is_panel(_format_of(file)):
        from tactape_fab.verify.panel import verify_panel_folder

        return verify_panel_folder(file, quick=quick, contact=contact, progress=progress)
    return verify_folder(file, quick=quick, contact=contact, progress=progress)


def _format_of(file: Path) -> dict[str, Any]:
    """Content of a manifest; nothing where it cannot be read, which is said where it is read as a kit's."""
    try:
        return read_any_manifest(file)
    except SpecError:
        return {}


def verify_folder(
    manifest_file: Path, *, quick: bool, contact: Contact | None = None, progress: Progress = lambda *_: None
) -> Verification:
    """Verify the kit whose manifest is `manifest_file`, whatever its folder is called."""
    folder = manifest_file.parent
    try:
        manifest = read_manifest(manifest_file)
        tape = Tape.from_mapping(manifest)
        kind = kind_of(manifest)
        table = Fields(manifest)
        recorded = read_recorded(table) if kind == "film" else None
        assembly = read_assembly(table) if kind == "film" else None
        film = read_film_record(table) if kind == "film" else None
        form = read_form(table.table("solid")) if kind == "texture" or (kind == "film" and "solid" in manifest) else None
        table.table("tool")
        table.table("spec")
        if table.problems:
            raise SpecError(table.problems)
    except SpecError as error:
        return Verification(
            name=folder.name, checks=(Check(name="manifest", passed=False, message="; ".join(str(error).splitlines())),)
        )
    checks = [Check(name="manifest", passed=True, message=f"{tape.part_count} parts, symbols {get_code(tape.code).vouched}")]
    files, file_checks = read_files(folder, manifest)
    expected = roles_of(tape, kind, models=form is not None, backings=tuple(film.backings) if film is not None else ())
    checks += [*file_checks, check_roles(expected, files, (REPORT, "step-solid") if kind == "embossed" else (REPORT,))]
    single = {role: rows[0] for role, rows in files.items() if rows}
    if REPORT in single:
        checks.append(check_report(single[REPORT], manifest))
    missing = [role for role in expected if role not in single]
    if missing:
        checks.append(Check(name="content", passed=False, message=f"nothing further can be checked without {named(missing)}"))
        return Verification(name=tape.name, checks=tuple(checks))
    if kind == "embossed":
        checks += _check_part(manifest, tape, single, quick=quick)
        return Verification(name=tape.name, checks=tuple(checks))
    cpl = None
    sources: list[Source] = []
    if recorded is not None and assembly is not None and film is not None:
        cpl = read_role("cpl", read_cpl, single, checks)
        checks += _check_assembly(tape, recorded, assembly, single, cpl)
        checks += pardoned(_check_content(manifest, tape, recorded, film, single, cpl, sources, quick=quick), film)
    checks += [check_certificate(single[CERTIFICATE], tape), check_picture(single)]
    if form is not None:
        checks += _check_solids(tape, form, single, cpl, quick=quick)
        if not (quick and sources):
            sources += _read_solid(tape, form, single)
    trips: list[Trip] = []
    if sources:
        trips = quick_trips(tape, sources) if quick else full_trips(tape, sources, contact, progress)
        checks += trip_checks(tape, sources, trips)
    return Verification(name=tape.name, checks=tuple(checks), trips=() if quick else tuple(trips))


def _check_part(manifest: dict[str, Any], tape: Tape, files: dict[str, WrittenFile], *, quick: bool) -> list[Check]:
    """The models of a texture on a part of the user's own, and its certificate."""
    from tactape_fab.verify.models.embossed import (
        check_embossed,  # loaded where it is needed: a film is verified sooner without it
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


def read_role(role: str, read: Callable[[bytes], T], files: dict[str, WrittenFile], checks: list[Check]) -> T | None:
    try:
        return read(files[role].data)
    except ReadbackError as error:
        checks.append(Check(name=role, passed=False, message=f"{files[role].path}: {error}"))
        return None


def _check_assembly(
    tape: Tape, recorded: Recorded, assembly: RecordedAssembly, files: dict[str, WrittenFile], cpl: CplContent | None
) -> list[Check]:
    """What an assembly line gets."""
    lists = [] if cpl is None else check_cpl(cpl, tape, assembly, recorded.pads)
    return [*lists, check_bom(files["bom"].data, tape.designators(), assembly), check_order_notes(files, tape)]


def _check_content(
    manifest: dict[str, Any],
    tape: Tape,
    recorded: Recorded,
    film: FilmRecord,
    files: dict[str, WrittenFile],
    cpl: CplContent | None,
    sources: list[Source],
    *,
    quick: bool,
) -> list[Check]:
    """Everything that a fab gets, and that the CPL says the same; where that says that parts stand is added to `sources`."""
    checks: list[Check] = []
    layers: dict[str, GerberContent] = {}
    for role in (*GERBER_ROLES, *film.backings):
        if role in files and (content := read_role(role, read_gerber, files, checks)) is not None:
            layers[role] = content
    holes = read_role("drill-npth", read_drill, files, checks) if "drill-npth" in files else None
    checks.append(check_attributes(layers, files, manifest["spec"].get("x2"), film))
    if "profile" in layers:
        checks.append(check_outline(layers["profile"], tape))
    if holes is not None:
        checks.append(check_drill(holes, tape))
    for role, backing in film.backings.items():
        if role in layers and "profile" in layers:
            outline = layers["profile"].strokes_mm
            checks.append(check_backing(role, layers[role], files[role].path, backing, outline[0] if outline else None))
    lands = {"copper-top": recorded.pads, "paste-top": recorded.paste}
    pairs = {
        role: pair_lands(layers[role].flash_xy_mm, land.offset_mm, tape.part.rotation_deg)
        for role, land in lands.items()
        if role in layers
    }
    if cpl is not None:
        checks += check_layers_with_cpl(layers, pairs, recorded, film, tape, cpl)
    if film.anchor is not None and "copper-top" in layers and "coverlay-top" in layers:
        checks += check_anchors(layers["copper-top"], layers["coverlay-top"], film.anchor, recorded.pads, tape)
    if cpl is not None:
        checks += check_symbols(tape, cpl.xy_mm, "CPL")
        sources.append(cpl_source(cpl))
    if "copper-top" in pairs:
        checks += check_symbols(tape, pairs["copper-top"].centre_mm, "copper")
        copper, offset_mm = layers["copper-top"].flash_xy_mm, recorded.pads.offset_mm
        sources.append(copper_source(copper, offset_mm, tape.part.rotation_deg, pairs["copper-top"]))
    if "legend-top" in layers:
        light = manifest.get("fab", {}).get("legend_colour") != "black"
        checks += check_tag(layers["legend-top"], tape, legend_is_light=light, with_pupil=not quick)
    checks += check_kicad(files["kicad-pcb"].data, files["kicad-project"].data, shown_tape(tape), recorded)
    return [*checks, check_job(tape.board.size_mm, files), check_zip(files, with_job=film.job_in_zip)]


def check_layers_with_cpl(
    layers: dict[str, GerberContent],
    pairs: dict[str, LandPairs],
    recorded: Recorded,
    film: FilmRecord,
    tape: Tape,
    cpl: CplContent,
) -> list[Check]:
    checks: list[Check] = []
    rows = point_tree(cpl.xy_mm)
    for role, land in (("copper-top", recorded.pads), ("paste-top", recorded.paste)):
        if role in layers:
            lines = role == "copper-top" and film.anchor is not None
            checks += check_lands(role, layers[role], pairs[role], land, tape, cpl, rows, lines=lines)
    if "coverlay-top" in layers and film.mode == "gang":
        checks += check_window(layers["coverlay-top"], opening_outline(recorded, tape), film, tape, cpl)
    elif "coverlay-top" in layers:
        checks += check_openings(layers["coverlay-top"], recorded, tape, cpl, rows)
    if "components-top" in layers:
        checks.append(check_components(layers["components-top"], tape, cpl))
    if "copper-top" in layers:
        checks += check_edges(layers, recorded, tape, cpl)
    if "legend-top" in layers and "coverlay-top" in layers:
        checks.append(check_legend_clear(layers["legend-top"], layers["coverlay-top"], recorded))
    return checks


def _parts_of_pads(content: GerberContent) -> list[str]:
    """The part that each flash names; fiducials belong to none."""
    mark = [function.startswith("FiducialPad") for function in content.aperture_functions]
    return [part for part, i in zip(content.flash_component, content.flash_aperture, strict=True) if not mark[i]]


def check_attributes(layers: dict[str, GerberContent], files: dict[str, WrittenFile], x2: object, film: FilmRecord) -> Check:
    """Attributes are there as the manifest's ``spec.x2`` says; functions are the roles', one origin, signatures fit."""
    problems = [problem for role in layers if (problem := check_signature(role, files[role].data)) is not None]
    functions = {**FILE_FUNCTIONS, **{role: (file_function(role, b), "Positive") for role, b in film.backings.items()}}
    origins = set()
    for role, content in layers.items():
        mode = "full" if role == "components-top" else x2
        start = {"full": b"%TF.", "comments": b"G04 #@! TF."}.get(str(mode))
        if start is not None:
            missing = [n for n in REQUIRED_ATTRIBUTES if start + n.encode() not in files[role].data]
            problems += [f"{role} has no .{name}" for name in missing]
            origins.add(re.search(rb"TF\.SameCoordinates,([^*]*)\*", files[role].data))
        if mode == "full" and role == "copper-top" and not all(_parts_of_pads(content)):
            problems.append("copper-top has pads without .P")
        for attribute, expected in zip(("FileFunction", "FilePolarity"), functions[role], strict=True):
            found = content.file_attributes.get(attribute)
            if found is not None and ",".join(found) != expected:
                problems.append(f"{role} has .{attribute} {','.join(found)}, not {expected}")
    if len({match[1] for match in origins if match is not None}) > 1:
        problems.append("the layers have different .SameCoordinates")
    message = named(problems) if problems else "file functions as the roles, MD5 signatures right"
    return Check(name="attributes", passed=not problems, message=message)
