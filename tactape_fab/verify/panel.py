"""Verification of a panel: its own files, tape by tape like those of a kit; the rest of the panel; and every kit on it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from tactape_fab.base.errors import Check, SpecError, reason_of, refuse
from tactape_fab.base.fields import Fields, named, shown
from tactape_fab.base.pool import Workers, mapped
from tactape_fab.kit.panel.geometry import CORNER_RADIUS_MM, Panel, read_panel_record
from tactape_fab.kit.panel.panel_drawing import slots_mm
from tactape_fab.kit.read.readback import read_cpl
from tactape_fab.texture.as_built import NOMINAL
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.manifest import MOST_MANIFEST_BYTES, read_any_manifest
from tactape_fab.texture.panel_manifest import PlacedTape, read_placed
from tactape_fab.texture.tape import NAME_PATTERN, NAME_REMEDY, Tape
from tactape_fab.verify.budgets import count_of
from tactape_fab.verify.files import (
    ALWAYS,
    PICTURES,
    WrittenFile,
    check_listed,
    check_picture,
    read_files,
    read_inside,
)
from tactape_fab.verify.film import (
    FilmLayers,
    anchor_lines,
    check_attributes,
    check_tape,
    pair_all_lands,
    read_film_manifest,
    read_layers,
    read_role,
)
from tactape_fab.verify.kit import verify_folder
from tactape_fab.verify.layers.cpl_rows import check_bom, check_cpl
from tactape_fab.verify.layers.drawings import check_drawings
from tactape_fab.verify.layers.fab_zip import check_zip
from tactape_fab.verify.layers.film_layers import FilmManifest, forced_as_warnings
from tactape_fab.verify.layers.job_file import check_job
from tactape_fab.verify.layers.kicad import Shown, check_kicad, sides_of
from tactape_fab.verify.layers.kicad_drawn import Made
from tactape_fab.verify.layers.lands import PLACE_TOLERANCE_MM
from tactape_fab.verify.layers.on_panel import OnPanel, inside, of_tape, part_data_of_tape, rows_of_tape
from tactape_fab.verify.layers.order_notes import Ordered, check_order_notes
from tactape_fab.verify.layers.panel_frame import check_cut, check_rails
from tactape_fab.verify.layers.written_form import check_form
from tactape_fab.verify.pictured import Pictured
from tactape_fab.verify.trip.round_trip import Contact, Progress
from tactape_fab.verify.verification import Beside, OnCheck, Verification, collected, unreadable


@dataclass(frozen=True, slots=True, kw_only=True)
class _PanelRecord:
    """Content of a panel's manifest; `said` is the panel, `rows` its tapes and `spec` their options as they stand there."""

    name: str
    panel: Panel
    said: Mapping[str, Any]
    rows: Sequence[Mapping[str, Any]]
    spec: Mapping[str, Any]
    placed: tuple[PlacedTape, ...]
    film: FilmManifest


@dataclass(frozen=True, slots=True, kw_only=True)
class _OnPanel(OnPanel):
    """A kit's tape and its place, with film and spec of its own manifest, as tapes of a packed panel may differ."""

    film: FilmManifest
    spec: Mapping[str, Any]


def verify_panel_folder(
    manifest_file: Path,
    *,
    quick: bool,
    kits: bool = True,
    contact: Contact | None = None,
    progress: Progress = lambda *_: None,
    on_check: OnCheck = lambda _: None,
    beside: Beside = tuple,
    workers: Workers = 1,
) -> Verification:
    """Verify the panel of `manifest_file`; with `kits` also every kit on it, by `workers`, with one line each.

    Returns: One line for each tape of the panel if all its checks hold, else every line that failed.
    """
    folder = manifest_file.parent
    try:
        manifest = read_any_manifest(manifest_file)
        record = _read_record(manifest)
        tapes = [_on_panel(folder, place) for place in record.placed]
        if any(tape.tape.part.shape != "block" or tape.tape.surface is not None for tape in tapes):
            raise SpecError("a kit on it is no film with parts")
    except SpecError as error:
        return unreadable(folder.name, error, on_check)

    def lines() -> Iterator[Check]:
        yield from _checks(folder, manifest, record, tapes, quick=quick)
        if kits:
            check = partial(_check_kit, quick=quick, contact=contact, progress=progress if workers == 1 else None)
            folders = [(folder / place).absolute() for place in _kit_folders(record)]
            for done, of_kit in enumerate(mapped(check, folders, workers), 1):
                yield from of_kit
                if workers != 1:
                    progress("kits", done, len(folders))
        yield from beside()

    return collected(record.name, lines(), on_check)


def _kit_folders(record: _PanelRecord) -> list[str]:
    return [str(PurePosixPath(p.manifest).parent) + "/" for p in record.placed]


def _checks(
    folder: Path, manifest: Mapping[str, Any], record: _PanelRecord, tapes: Sequence[_OnPanel], *, quick: bool
) -> Iterator[Check]:
    """Every line of the panel's own files as soon as it is known."""
    arrangement = _check_arrangement(record, tapes)
    yield arrangement
    listed, file_checks = read_files(folder, manifest, count_of(*(on.tape for on in tapes)), _kit_folders(record))
    files, missing, role_checks = check_listed(manifest, listed, _roles(record, tapes), what="panel")
    yield from (*file_checks, _check_kits_listed(folder, record.placed), *role_checks)
    if missing or not arrangement.passed:
        message = f"nothing further can be checked without {named(missing) or 'an arrangement that holds together'}"
        yield Check(name="content", passed=False, message=message)
    else:
        yield from forced_as_warnings(_check_content(record, tapes, files, quick=quick), record.film.film)


def _read_record(manifest: Mapping[str, Any]) -> _PanelRecord:
    table = Fields(manifest)
    table.table("tool")
    record = _PanelRecord(
        name=table.text("name", pattern=NAME_PATTERN, remedy=NAME_REMEDY),
        panel=read_panel_record(table.table("panel")),
        said=table.table("panel").values,
        rows=manifest.get("tapes", ()),
        spec=manifest.get("spec", {}),
        placed=read_placed(table),
        film=read_film_manifest(table),
    )
    refuse(table.problems)
    return record


def _on_panel(folder: Path, place: PlacedTape) -> _OnPanel:
    file = folder / PurePosixPath(place.manifest)
    tape = Tape.load(file, as_built=NOMINAL)
    table = Fields(read_any_manifest(file), f"{place.manifest}: ")
    film, spec = read_film_manifest(table), table.values.get("spec", {})
    refuse(table.problems)
    return _OnPanel(tape=tape, place=place, film=film, spec=spec)


def _check_arrangement(record: _PanelRecord, tapes: Sequence[_OnPanel]) -> Check:
    """Check number, size and places of the kits against those of the panel, and that designators are consecutive."""
    panel = record.panel
    # values that follow from others, as the outline of a grid does, are not read
    follow = {key: value for key, value in panel.to_mapping().items() if key in ("size_mm", "corner_radius_mm")}
    other = [key for key, value in follow.items() if not np.array_equal(record.said.get(key, value), value)]
    problems = [f"the panel's {named(other)} in the manifest do not follow from what else it says"] if other else []
    if len(tapes) != panel.count:
        problems.append(f"{len(tapes)} tapes where the panel has {panel.words}")
    # its options are those of its first tape, but for what each tape has of its own
    if other := [key for key, value in record.spec.items() if key not in tapes[0].spec or tapes[0].spec[key] != value]:
        problems.append(
            f"the spec's {named([shown(key) for key in other])} in the manifest are not those of {tapes[0].tape.name}"
        )
    number = 1
    for on, row, place in zip(tapes, record.rows, panel.places, strict=False):
        own = {"name": on.tape.name, "sector": on.tape.sector, "parts": on.tape.part_count}
        problems += [
            f"{on.tape.name} is listed with {key} {shown(row[key])}" for key in own if row.get(key, own[key]) != own[key]
        ]
        board = on.tape.board
        if np.abs(on.offset - place.offset_mm).max() > PLACE_TOLERANCE_MM or on.place.rotation_deg != place.rotation_deg:
            turned = f" turned {place.rotation_deg:g} deg" * place.turned
            problems.append(f"{on.tape.name} is said to lie at {on.place.offset_mm}, not at {place.offset_mm}{turned}")
        if board.size_mm != place.size_mm or board.corner_radius_mm != place.radius_mm:
            problems.append(f"{on.tape.name} has another outline than {place.size_mm[0]:g} x {place.size_mm[1]:g} mm")
        if on.tape.part != tapes[0].tape.part:
            problems.append(f"{on.tape.name} has other parts than {tapes[0].tape.name}")
        if on.place.first_number != number:
            problems.append(f"{on.tape.name} begins with {on.place.first_designator}, not R{number}")
        number += on.tape.part_count
    problems += [] if problems else _overlaps(panel)
    message = named(problems) or f"{panel.words} with {number - 1} parts"
    return Check(name="arrangement", passed=not problems, message=message, figure=float(len(tapes)))


def _overlaps(panel: Panel) -> list[str]:
    """Problems of tapes of a packed panel that overlap the rails or each other, slots included."""
    if panel.grid is not None:
        return []
    low = np.array([place.low_mm for place in panel.places])
    high = low + np.array([place.extent_mm for place in panel.places])
    # every tape is surrounded by a slot, also towards the rail
    border_mm = panel.rail_mm + panel.gap_mm - PLACE_TOLERANCE_MM
    off = (low < border_mm).any() or (high > np.array(panel.size_mm) - border_mm).any()
    # gap of two boxes along each axis, negative if they overlap; the larger one is their distance
    apart = np.maximum(low[:, None] - high[None], low[None] - high[:, None]).max(axis=-1)
    np.fill_diagonal(apart, np.inf)
    problems = ["a tape lies on the rails"] if off else []
    # packed tapes do not share slots
    near = apart.min(initial=np.inf) < 2 * panel.gap_mm - PLACE_TOLERANCE_MM
    return [*problems, "two tapes lie nearer than two slots"] if near else problems


def _check_kits_listed(folder: Path, placed: Sequence[PlacedTape]) -> Check:
    """Check that every kit's manifest is the one with which the panel was made."""
    problems = []
    for place in placed:
        try:
            data = read_inside(folder.resolve(), folder / place.manifest, MOST_MANIFEST_BYTES)
        except (OSError, RuntimeError) as error:
            problems.append(f"{place.manifest} {reason_of(error)}")
        else:
            if hashlib.sha256(data).hexdigest() != place.sha256:
                problems.append(f"{place.manifest} is not the one that the panel was made with: its SHA-256 differs")
    message = named(problems) or f"{len(placed)} kits, their manifests as listed"
    return Check(name="kits", passed=not problems, message=message, figure=float(len(placed)))


def _roles(record: _PanelRecord, tapes: Sequence[_OnPanel]) -> tuple[str, ...]:
    legend = ("legend-top",) if any(on.tape.tag is not None for on in tapes) else ()
    holes = record.panel.tooling_holes_mm or any(on.tape.board.holes for on in tapes)
    drill = ("drill-npth",) if holes else ()
    return (*ALWAYS, *legend, *drill, *record.film.film.backings, *PICTURES, "fab-zip")


# Files of the panel


def _check_content(record: _PanelRecord, tapes: Sequence[_OnPanel], files: dict[str, WrittenFile], *, quick: bool) -> list[Check]:
    checks: list[Check] = []
    panel, film = record.panel, record.film
    cpl = read_role("cpl", read_cpl, files, checks)
    layers = read_layers(files, cpl, film.film, checks)
    if "drill-npth" not in files:
        layers = replace(layers, holes=np.empty((0, 3)))
    checks += [check_attributes(layers.gerbers, files, film, "Array"), check_form(files, layers.gerbers)]
    if "profile" in layers.gerbers:
        checks.append(check_cut(layers.gerbers["profile"], panel))
    count = sum(on.tape.part_count for on in tapes)
    names = [f"R{n}" for n in range(1, count + 1)]
    if cpl is not None:
        checks.append(_check_rows(cpl, names))
    checks.append(check_bom(files["bom"].data, names, film.assembly))
    shown = _shown(record, tapes)
    ordered = Ordered(name=record.name, shown=shown, panel=panel)
    checks.append(check_order_notes(files, tapes[0].tape, ordered, film=film))
    checks += check_rails(layers.gerbers, layers.holes, panel, tapes)
    for on in tapes:
        lines = forced_as_warnings(_check_tape(on, layers, files, quick=quick), on.film.film)
        checks += _folded(f"tape {on.tape.name}", lines, f"at ({on.offset[0]:g}, {on.offset[1]:g}) mm, R{on.first + 1} on")
    made = Made(
        name=record.name,
        tape=tapes[0].tape,
        record=film,
        gerbers=layers.gerbers,
        radius_mm=CORNER_RADIUS_MM,
        slots_mm=slots_mm(panel),
        on_panel=True,
    )
    checks += [*check_kicad(files, shown, made), *check_drawings(files, shown, made)]
    checks += [check_job(record.name, panel.size_mm, film.order, files), check_zip(files, with_job=film.film.job_in_zip)]
    pictured = Pictured(
        size_mm=panel.size_mm,
        xy_mm=shown.parts_xy_mm,
        rotation_deg=shown.rotation_deg,
        body_mm=tapes[0].tape.part.body_mm[:2],
    )
    return [*checks, check_picture(files, record.name, pictured)]


def _folded(name: str, lines: Sequence[Check], where: str) -> list[Check]:
    """One line in place of all checks that hold, and every line that does not."""
    # warnings are separate lines; after a failure every line that does not hold is listed
    wrong = [replace(line, name=f"{name}: {line.name}") for line in lines if not line.passed]
    if any(not line.warning for line in wrong):
        return wrong
    return [*wrong, Check(name=name, passed=True, message=f"{len(lines) - len(wrong)} checks {where}", figure=float(len(lines)))]


def _check_kit(folder: Path, *, quick: bool, contact: Contact | None, progress: Progress | None) -> list[Check]:
    on_progress = progress or (lambda *_: None)  # a worker process has no progress function
    verification = verify_folder(folder / "manifest.json", quick=quick, contact=contact, progress=on_progress)
    return _folded(f"kit {verification.name}", verification.checks, "of its own files")


def _check_rows(cpl: CplContent, names: Sequence[str]) -> Check:
    """Check that the CPL has the rows of all tapes in order."""
    wrong = [f"{found} instead of {name}" for found, name in zip(cpl.designators, names, strict=False) if found != name]
    if len(cpl.designators) != len(names):
        wrong.insert(0, f"{len(cpl.designators)} rows for {len(names)} parts")
    message = named(wrong) or f"{len(names)} rows, R1 to R{len(names)} in order"
    return Check(name="cpl order", passed=not wrong, message=message, figure=float(len(cpl.designators)))


def _shown(record: _PanelRecord, tapes: Sequence[_OnPanel]) -> Shown:
    panel, anchors = record.panel, [anchor_lines(on.film, on.tape) for on in tapes]
    holes = [(*on.on_panel(np.array([x, y])).tolist(), d) for on in tapes for x, y, d in on.tape.board.holes]
    return Shown(
        parts_xy_mm=np.concatenate([on.on_panel(on.tape.part_xy_mm()) for on in tapes]),
        rotation_deg=np.concatenate(
            [np.full(on.tape.part_count, on.tape.part.rotation_deg + on.place.rotation_deg) for on in tapes]
        ),
        size_mm=panel.size_mm,
        holes=[*holes, *panel.tooling_holes_mm],
        edge_lines=sides_of(panel.size_mm, CORNER_RADIUS_MM) + sum(len(slot) for slot in slots_mm(panel)),
        fiducials_mm=panel.fiducials_mm,
        fiducial_mm=(panel.fiducial_mm, panel.fiducial_opening_mm),
        tracks_mm=np.concatenate([on.on_panel(lines_mm) for on, (lines_mm, _) in zip(tapes, anchors, strict=True)]),
        track_width_mm=max(width_mm for _, width_mm in anchors),
    )


# Tape by tape


def _check_tape(on: _OnPanel, layers: FilmLayers, files: Mapping[str, WrittenFile], *, quick: bool) -> list[Check]:
    """Check the content of the panel's files within this tape's outline like the tape's own files."""
    tape, film = on.tape, on.film
    own = FilmLayers(
        gerbers={role: of_tape(content, on) for role, content in layers.gerbers.items() if role != "profile"},
        holes=None if layers.holes is None else _holes_of_tape(layers.holes, on),
        cpl=None if layers.cpl is None else rows_of_tape(layers.cpl, on),
    )
    blank: list[Check] = []
    if tape.tag is None and "legend-top" in own.gerbers:  # the legend is that of other tapes
        legend = own.gerbers["legend-top"]
        inked = len(legend.areas_mm) + len(legend.strokes_mm) + len(legend.flash_xy_mm)
        message = f"{inked} objects on a tape that is not printed" if inked else "nothing on it, as it has no strip"
        blank.append(Check(name="legend-top", passed=not inked, message=message, figure=float(inked)))
        own = replace(own, gerbers={role: content for role, content in own.gerbers.items() if role != "legend-top"})
    rows = [] if own.cpl is None else check_cpl(own.cpl, tape, film.assembly, film.lands.pads)
    pairs = pair_all_lands(own, film.lands, tape)
    listed = files["components-top"]
    own_files = {**files, "components-top": replace(listed, data=part_data_of_tape(listed.data, on))}
    return [*rows, *blank, *check_tape(own, pairs, tape, film, own_files, with_pupil=not quick)]


def _holes_of_tape(holes: FloatArray, on: OnPanel) -> FloatArray:
    of_it = holes[inside(holes[:, :2], on)]
    return np.column_stack([on.on_board(of_it[:, :2]), of_it[:, 2]])
