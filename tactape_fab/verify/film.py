"""Fabrication files of a film, in a kit or a panel: reading into arrays, and checks tape by tape."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import Fields, named, shown
from tactape_fab.kit.film.anchors import build_anchors
from tactape_fab.kit.profiles import GERBER_ROLES, load_fab, material_words
from tactape_fab.kit.read.gerber_file import GerberContent, ReadbackError, read_gerber
from tactape_fab.kit.read.readback import read_drill
from tactape_fab.kit.spec.options import DEFAULT_FAB
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.shapes import board_outline
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import WrittenFile, check_signature
from tactape_fab.verify.layers.board import check_components, check_drill, check_edges, check_legend_clear, check_part_data
from tactape_fab.verify.layers.cpl_rows import read_assembly
from tactape_fab.verify.layers.film_layers import (
    FilmManifest,
    FilmRecord,
    check_anchors,
    check_backing,
    check_window,
    file_function,
    read_film_record,
)
from tactape_fab.verify.layers.job_file import known_fab, read_fab_order
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
from tactape_fab.verify.layers.legend import check_label, check_tag, read_legend_record
from tactape_fab.verify.symbols import check_symbols

FILE_FUNCTIONS = {
    "copper-top": ("Copper,L1,Top", "Positive"),
    "coverlay-top": ("Soldermask,Top", "Negative"),
    "paste-top": ("Paste,Top", "Positive"),
    "legend-top": ("Legend,Top", "Positive"),
    "profile": ("Profile,NP", "Positive"),
    "components-top": ("Component,L1,Top", "Positive"),
}
"""File function and polarity that the attributes of a Gerber file must state, by role."""

REQUIRED_ATTRIBUTES = ("FileFunction", "FilePolarity", "SameCoordinates", "MD5")
_SHARED = ("SameCoordinates", "ProjectId", "CreationDate", "GenerationSoftware")
"""Attributes that have one value in all layers of a kit."""

T = TypeVar("T")


def read_film_manifest(table: Fields) -> FilmManifest:
    """Read film and assembly from a manifest; problems are collected in `table`."""
    fab, film = table.table("fab"), read_film_record(table)
    known = known_fab(fab) if table.table("spec").values.get("fab") == fab.values.get("name") else None
    profile = known or load_fab(DEFAULT_FAB)
    material = {role: material_words(backing) for role, backing in film.backings.items()}
    return FilmManifest(
        lands=read_recorded(table),
        assembly=read_assembly(table),
        film=film,
        x2=table.table("spec").values.get("x2"),
        legend_is_light=fab.values.get("legend_colour") != "black",
        legend=read_legend_record(table),
        order=read_fab_order(table),
        limits_mm=fab.table("limits_mm").values,
        paths={r: profile.file_path(r, str(table.values.get("name")), material.get(r, "")) for r in GERBER_ROLES},
        names_known=known is not None,
        stencil_mm=None if known is None else known.stencil.thickness_mm,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilmLayers:
    """Contents of a film's files: Gerber layers by role, holes (x, y, diameter) in mm, and rows of the CPL.

    ``holes`` and ``cpl`` are None if the file is missing or cannot be read.
    """

    gerbers: Mapping[str, GerberContent]
    holes: FloatArray | None
    cpl: CplContent | None


def read_role(role: str, read: Callable[[bytes], T], files: Mapping[str, WrittenFile], checks: list[Check]) -> T | None:
    """The content of a role's file; None if it is missing, or cannot be read, which is added to `checks`."""
    try:
        return read(files[role].data)
    except ReadbackError as error:
        checks.append(Check(name=role, passed=False, message=f"{files[role].path}: {error}"))
        return None


def _read_attributed(data: bytes) -> GerberContent:
    """Read a Gerber file whose attributes may be in comments (Gerber 2024.05, 5.1.1), which gerbonara ignores."""
    if b"G04 #@! " in data:
        data = re.sub(rb"^G04 #@! (T[AFOD][^*%\n]*)\*$", rb"%\1*%", data, flags=re.MULTILINE)
    return read_gerber(data)


def read_layers(files: Mapping[str, WrittenFile], cpl: CplContent | None, film: FilmRecord, checks: list[Check]) -> FilmLayers:
    """Read every Gerber and drill file of the kit; each unreadable one adds a failed line to `checks`."""
    gerbers = {
        role: content
        for role in (*FILE_FUNCTIONS, *film.backings)
        if role in files and (content := read_role(role, _read_attributed, files, checks)) is not None
    }
    holes = read_role("drill-npth", read_drill, files, checks) if "drill-npth" in files else None
    return FilmLayers(gerbers=gerbers, holes=holes, cpl=cpl)


def pair_all_lands(layers: FilmLayers, lands: Recorded, tape: Tape) -> dict[str, LandPairs]:
    """Pairs of lands in the copper and paste layers, by role."""
    return {
        role: pair_lands(layers.gerbers[role].flash_xy_mm, land.offset_mm, tape.part.rotation_deg)
        for role, land in (("copper-top", lands.pads), ("paste-top", lands.paste))
        if role in layers.gerbers
    }


def anchor_lines(record: FilmManifest, tape: Tape) -> tuple[FloatArray, float]:
    """End points of the anchor lines, shape (k, 2, 2), and their width, mm; empty without anchors."""
    plan = record.film.anchor
    return (np.empty((0, 2, 2)), 0.0) if plan is None else (build_anchors(plan, tape, record.lands.pads).lines_mm, plan.web_mm)


def check_tape(
    layers: FilmLayers,
    pairs: Mapping[str, LandPairs],
    tape: Tape,
    record: FilmManifest,
    files: Mapping[str, WrittenFile],
    *,
    with_pupil: bool,
) -> list[Check]:
    """Check holes, backings, lands, anchors, symbols and tag of one tape, in its board frame.

    ``pairs`` are `pair_all_lands` of these layers.
    """
    checks: list[Check] = []
    gerbers, cpl, anchor = layers.gerbers, layers.cpl, record.film.anchor
    if layers.holes is not None:
        checks.append(check_drill(layers.holes, tape))
    for role, backing in record.film.backings.items():
        if role in gerbers:
            outline_mm = board_outline(tape.board.size_mm, tape.board.corner_radius_mm)
            checks.append(check_backing(role, gerbers[role], files[role].path, backing, outline_mm))
    if cpl is not None:
        checks += _check_with_cpl(gerbers, pairs, record, tape, cpl, files)
    if anchor is not None and "copper-top" in gerbers and "coverlay-top" in gerbers:
        checks += check_anchors(gerbers["copper-top"], gerbers["coverlay-top"], anchor, record.lands.pads, tape)
    if cpl is not None:
        checks += check_symbols(tape, cpl.xy_mm, "CPL")
    if "copper-top" in pairs:
        checks += check_symbols(tape, pairs["copper-top"].centre_mm, "copper")
    if "legend-top" in gerbers:
        checks += check_tag(gerbers["legend-top"], tape, legend_is_light=record.legend_is_light, with_pupil=with_pupil)
        checks.append(check_label(gerbers["legend-top"], tape, record.legend, light=record.legend_is_light))
    return checks


def _check_with_cpl(
    gerbers: Mapping[str, GerberContent],
    pairs: Mapping[str, LandPairs],
    record: FilmManifest,
    tape: Tape,
    cpl: CplContent,
    files: Mapping[str, WrittenFile],
) -> list[Check]:
    """Check that every layer has each part's lands at its CPL place, and keeps the clearances."""
    checks: list[Check] = []
    lands, rows = record.lands, point_tree(cpl.xy_mm)
    for role, land in (("copper-top", lands.pads), ("paste-top", lands.paste)):
        if role in gerbers:
            lines = role == "copper-top" and record.film.anchor is not None
            checks += check_lands(role, gerbers[role], pairs[role], land, tape, cpl, rows, lines=lines)
    if "coverlay-top" in gerbers and record.film.mode == "gang":
        checks += check_window(gerbers["coverlay-top"], opening_outline(lands, tape), record.film, tape, cpl)
    elif "coverlay-top" in gerbers:
        checks += check_openings(gerbers["coverlay-top"], lands, tape, cpl, rows)
    if "components-top" in gerbers:
        checks.append(check_components(gerbers["components-top"], cpl))
        checks.append(check_part_data(gerbers["components-top"], files["components-top"].data, tape, record.assembly, lands.pads))
    if "copper-top" in gerbers:
        checks += check_edges(gerbers, lands, tape, cpl)
    if "legend-top" in gerbers and "coverlay-top" in gerbers:
        checks.append(check_legend_clear(gerbers["legend-top"], gerbers["coverlay-top"], lands))
    return checks


def check_attributes(
    gerbers: Mapping[str, GerberContent], files: Mapping[str, WrittenFile], record: FilmManifest, part: str = "Single"
) -> Check:
    """Check the attributes: present according to ``spec.x2``, file function by role, `part`, common origin, and .MD5.

    Also checks the file names, by which many fabs identify the layers.
    """
    problems = list(_name_problems(files, record))
    problems += [problem for role in gerbers if (problem := check_signature(role, files[role].data)) is not None]
    for role in (*gerbers, *(role for role in ("drill-npth",) if role in files)):
        parts = {found.decode("ascii", "replace") for found in re.findall(rb"TF\.Part,([^*\n]*)", files[role].data)}
        problems += [f"{role} has .Part {shown(other)}, not {part}" for other in parts - {part}]
        # pads are not connected, which is the net name N/C
        nets = set(re.findall(rb"TO\.N,([^*\n]*)", files[role].data)) - {b"N/C"}
        problems += [f"{role} has a net {shown(net.decode('ascii', 'replace'))}" for net in nets]
    backings = {role: (file_function(role, backing), "Positive") for role, backing in record.film.backings.items()}
    functions = {**FILE_FUNCTIONS, **backings}
    for role, content in gerbers.items():
        # the component layer consists of attributes, so that they are never off
        mode = "full" if role == "components-top" else record.x2
        start = {"full": b"%TF.", "comments": b"G04 #@! TF."}.get(str(mode))
        if start is not None:
            missing = [n for n in REQUIRED_ATTRIBUTES if start + n.encode() not in files[role].data]
            problems += [f"{role} has no .{name}" for name in missing]
        if start is not None and role == "copper-top":
            problems += _pad_problems(content, part)
        for attribute, expected in zip(("FileFunction", "FilePolarity"), functions[role], strict=True):
            found = content.file_attributes.get(attribute)
            if found is not None and ",".join(found) != expected:
                problems.append(f"{role} has .{attribute} {','.join(found)}, not {expected}")
    # equal values of .SameCoordinates state that layers are aligned, of the others that they are of one design; a drill file
    # has them in comments. A value without its end is in a truncated file, which is reported elsewhere
    drawn = [files[role].data for role in (*gerbers, "drill-npth") if role in files]
    for name in _SHARED:
        form = re.compile(rb"TF\.%b,([^*\r\n]*)[*\r\n]" % name.encode())
        if len({value for data in drawn for value in form.findall(data)}) > 1:
            problems.append(f"the layers have different .{name}")
    message = named(problems) if problems else "names and file functions as the roles, MD5 signatures right"
    return Check(name="attributes", passed=not problems, message=message)


def _name_problems(files: Mapping[str, WrittenFile], record: FilmManifest) -> Iterator[str]:
    of = {path: role for role, path in record.paths.items()}
    for role, path in record.paths.items():
        found = files[role].path if role in files else path
        if (other := of.get(found, role)) != role:
            yield f"{role} has the name of {other}, {found}"
        elif record.names_known and found != path:
            yield f"{role} is named {found}, not {path}"


def _pad_problems(content: GerberContent, part: str) -> Iterator[str]:
    """Problems of pads without a component, or with another function; only a panel has fiducials."""
    functions = [content.aperture_functions[i] for i in content.flash_aperture]
    attributes = {(function, name != "") for function, name in zip(functions, content.flash_component, strict=True)}
    attributes -= {("SMDPad,CuDef", True)} | ({("FiducialPad,Global", False)} if part == "Array" else set())
    if ("SMDPad,CuDef", False) in attributes:
        yield "copper-top has pads without .P"
    yield from (f"copper-top has pads of function {shown(name)}" for name, _ in sorted(attributes) if name != "SMDPad,CuDef")
