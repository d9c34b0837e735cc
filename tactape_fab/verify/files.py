"""Checks that a kit's files are listed, complete and unchanged. No file outside the kit's folder is opened."""

from __future__ import annotations

import base64
import hashlib
import html
import os
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import numpy as np
import shapely

from tactape_fab.base.errors import Check, SpecError, reason_of
from tactape_fab.base.fields import named, shown
from tactape_fab.base.image_file import PNG_SIGNATURE, png_size, unpacked
from tactape_fab.base.input_file import open_regular
from tactape_fab.base.json_text import parse_json
from tactape_fab.base.templates import templates_folder
from tactape_fab.base.version import __version__
from tactape_fab.kit.render.preview import MOST_PX
from tactape_fab.texture.as_built_file import AS_BUILT_NAME
from tactape_fab.texture.cpl import PLACEMENTS
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.manifest import MANIFEST_NAME, SIGNATURE_NAME, safe_path
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.budgets import MOST_FILES, WHOLE_KIT, most_bytes
from tactape_fab.verify.pictured import Pictured, placements_problem, png_problem, shows_bodies

ALWAYS = (
    *("copper-top", "coverlay-top", "paste-top", "profile", "components-top", "job", "cpl", "bom"),
    *("order-notes", "kicad-pcb", "kicad-project"),
)
PICTURES = ("preview-svg", "preview-png")
CERTIFICATE = "certificate"
EMBOSSED = ("stl", "3mf", "placements", CERTIFICATE)
MODELS = ("step-solid", "stl", "3mf")
LATER = ("fab-drawing", "fab-dxf", "placement-preview")
"""Roles that older kits do not have: drawings for the fab, and the placement preview."""
SIM = "sim"
"""Role of all assets for simulators, which are checked by their hashes and by reproduction."""
REPORT = "report"
"""Role of the report, the only file that may be missing, as it is made after the others are verified."""
_DATA, _DATA_END = b'<script type="application/json" id="data">', b"</script>"
_POLICY = re.compile(
    rb'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<meta http-equiv="Content-Security-Policy" content="'
    rb"default-src &#39;none&#39;; img-src data:; script-src &#39;sha256-([\w+/=]{44})&#39;; "
    rb"style-src &#39;sha256-([\w+/=]{44})&#39;; base-uri &#39;none&#39;; form-action &#39;none&#39;\">\n"
)
_FRAME = (b"(() => {", b'"use strict";', b"})();")

# a match may start only at the beginning of a name: starting at each of its letters takes half a minute for 100,000
_TAG, _ATTRIBUTE = re.compile(rb"</?([^\s/>]*)"), re.compile(rb"(?<![^\s\"'<>/])([^\s\"'<>/]+)\s*=")
_TAGS = {b"svg", b"title", b"defs", b"g", b"path", b"use", b"polygon", b"polyline", b"circle", b"text"}
_ATTRIBUTES = {
    *(b"xmlns", b"width", b"height", b"viewBox", b"id", b"d", b"x", b"y", b"cx", b"cy", b"r", b"points", b"href"),
    *(b"fill", b"fill-opacity", b"fill-rule", b"stroke", b"stroke-width", b"stroke-linecap", b"stroke-linejoin"),
    *(b"stroke-dasharray", b"font-family", b"font-size", b"text-anchor", b"dominant-baseline"),
}

_TITLE = re.compile(rb"<title>([^<]{0,1000})</title>")
_BODY = re.compile(rb'<use href="#bodies-\d{1,9}" x="(-?\d{1,9}\.\d{1,9})" y="(-?\d{1,9}\.\d{1,9})"')
_SVG_ERROR_MM = 1e-3
_NAMED_AS_CPL = tuple({house.ending for house in PLACEMENTS.values()})
"""Suffixes that a preview's title may have: it is the placement list's file name, from which only the default one is removed."""

_NO_DIGITS = bytes.maketrans(b"123456789", b"0" * 9)

Kind = Literal["film", "texture", "embossed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class WrittenFile:
    """A file of a kit as it was read; the path is relative to the kit's folder."""

    path: str
    data: bytes


def kind_of(manifest: Mapping[str, Any]) -> Kind:
    """Kind of kit: a film with parts, a texture of solid elements, or a texture on the user's own part."""
    if "surface" in manifest:
        return "embossed"
    spec = manifest.get("spec")
    made_by_fab = "land_pattern" in manifest or not isinstance(spec, Mapping) or spec.get("fab") is not None
    return "film" if made_by_fab else "texture"


def roles_of(tape: Tape, kind: Kind = "film", *, models: bool = True, backings: Sequence[str] = ()) -> tuple[str, ...]:
    """Roles that a kit must have, each once; for an embossed kit only those that do not depend on its source."""
    if kind == "embossed":
        return EMBOSSED
    if kind == "texture":
        return (*MODELS, *PICTURES, CERTIFICATE)
    legend = ("legend-top",) if tape.tag is not None else ()
    drill = ("drill-npth",) if tape.board.holes else ()
    solids = ("step-assembly", *MODELS) if models else ()
    return (*ALWAYS, *legend, *drill, *backings, *solids, *PICTURES, CERTIFICATE, "fab-zip")


def read_files(
    folder: Path, manifest: Mapping[str, Any], count: int, kits: Collection[str] = ()
) -> tuple[dict[str, list[WrittenFile]], list[Check]]:
    """Read every listed file, and compare size and SHA-256; each path is read once, within its role's size limit.

    ``count`` is the number of parts and holes; ``kits`` are subfolders, ending in '/', with manifests of their own. Returns
    files by role, and checks.
    """
    rows = manifest.get("files")
    files: dict[str, list[WrittenFile]] = {}
    problems: list[str] = []
    known: dict[PurePosixPath, tuple[bytes, str] | None] = {}
    listed = {MANIFEST_NAME, SIGNATURE_NAME}
    if not isinstance(rows, list) or not rows:
        return files, [Check(name="files", passed=False, message="the manifest lists no files")]
    if len(rows) > MOST_FILES:
        return files, [Check(name="files", passed=False, message=f"the manifest lists {len(rows)} files, more than {MOST_FILES}")]
    root, embossed = folder.resolve(), "surface" in manifest
    left = most_bytes(WHOLE_KIT, count, embossed=embossed)
    for row in rows:
        path = safe_path(row.get("path")) if isinstance(row, dict) else None
        if path is None:
            problems.append(f"{shown(row)} names no file inside the kit")
            continue
        listed.add(str(path))
        role = str(row.get("role"))
        if path not in known:
            known[path] = None
            try:
                # the total is limited as well, as a thousand files within their own limits would fill the memory
                data = read_inside(root, folder / path, min(left, most_bytes(role, count, embossed=embossed)))
                known[path] = data, hashlib.sha256(data).hexdigest()
                left -= len(data)
            except (OSError, RuntimeError) as error:  # RuntimeError: a link loop
                problems.append(f"{path} {reason_of(error)}")
        # a path that is listed twice is one file with two roles, read once
        if (found := known[path]) is not None:
            files.setdefault(role, []).append(WrittenFile(path=str(path), data=found[0]))
            if row.get("sha256") != found[1]:
                problems.append(f"{path} is not the file that was written: its SHA-256 differs")
            elif row.get("bytes") != len(found[0]):
                text = f"{path} has {len(found[0])} bytes and the SHA-256 as listed"
                problems.append(f"{text}, but the manifest lists {shown(row.get('bytes'))} bytes")
    message = named(problems) if problems else f"{len(rows)} files, sizes and SHA-256 as listed"
    checks = [Check(name="files", passed=not problems, message=message, figure=float(len(rows)))]
    listed.add(AS_BUILT_NAME)  # added by the user; `check_as_built` checks it
    places, own = (p.relative_to(folder) for p in folder.rglob("*") if not p.is_dir()), set(kits)
    unlisted = sorted(
        path.as_posix() for path in places if path.as_posix() not in listed and "/".join(path.parts[:2]) + "/" not in own
    )
    if unlisted:
        checks.append(
            Check(
                name="unlisted", passed=False, warning=True, message=f"files that the manifest does not list: {named(unlisted)}"
            )
        )
    return files, checks


def read_inside(root: Path, place: Path, most_bytes: int) -> bytes:
    """The bytes of a regular file of bounded size below `root`. Raises OSError with the reason otherwise."""
    # links are resolved before the comparison, so that none leads out of the folder
    if not place.resolve().is_relative_to(root):
        raise OSError(0, "leads out of the kit's folder")
    if not place.is_file():
        raise OSError(0, "is missing")
    with open_regular(place) as stream:
        # the size is that of the open file, as the path may be replaced; one byte more is read, as the file may grow
        if os.fstat(stream.fileno()).st_size <= most_bytes and len(data := stream.read(most_bytes + 1)) <= most_bytes:
            return data
    raise OSError(0, f"has more than {most_bytes} bytes, which this tool does not write for so few parts")


def check_listed(
    manifest: Mapping[str, Any],
    files: Mapping[str, list[WrittenFile]],
    expected: Sequence[str],
    *,
    allowed: Sequence[str] = (),
    what: str = "tape",
) -> tuple[dict[str, WrittenFile], list[str], list[Check]]:
    """The first file of each role, the expected roles without a file, and checks of the roles, of the report and of assets."""
    single = {role: rows[0] for role, rows in files.items() if rows}
    checks = [_check_roles(expected, files, (REPORT, *LATER, *allowed))]
    if REPORT in single:
        checks.append(_check_report(single[REPORT], manifest, what, single.get("order-notes")))
    if SIM in single:
        message = f"{len(files[SIM])} files; not compared: what simulators load of them"
        checks.append(Check(name="sim", passed=True, message=message))
    return single, [role for role in expected if role not in single], checks


def _check_roles(expected: Sequence[str], files: Mapping[str, list[WrittenFile]], allowed: Sequence[str]) -> Check:
    """Check that every expected role occurs once, allowed ones at most once, and no others."""
    wrong = [f"{role} {len(files.get(role, []))} times" for role in expected if len(files.get(role, [])) != 1]
    wrong += [f"{role} {len(files[role])} times" for role in allowed if len(files.get(role, [])) > 1]
    wrong += [f"{role}, which this tape has no use for" for role in files if role not in (*expected, *allowed, SIM)]
    message = f"the kit holds {named(wrong)}" if wrong else f"{len(expected)} roles, one file each"
    return Check(name="roles", passed=not wrong, message=message)


def _check_report(file: WrittenFile, manifest: Mapping[str, Any], what: str, notes: WrittenFile | None) -> Check:
    """Check that the report shows this tape or panel with its notes, lists every other file of the kit as in the manifest, and
    has a content security policy that allows its own script only.
    """
    problem, count = None, 0
    tool = manifest.get("tool")
    own = isinstance(tool, Mapping) and tool.get("version") == __version__
    try:
        # fails with a second data block, of which the page's script might use another one than this check
        _, text = file.data.split(_DATA)
        content = parse_json(text[: text.index(_DATA_END)])
        by_path = {str(row["path"]): (row["role"], row["bytes"], row["sha256"]) for row in content["files"]}
        listed = {
            str(row["path"]): (row["role"], row["bytes"], row["sha256"]) for row in manifest["files"] if row["role"] != REPORT
        }
        count = len(listed)
        differing = [path for path in sorted(by_path.keys() | listed.keys()) if by_path.get(path) != listed.get(path)]
        if content["name"] != manifest["name"]:
            problem = f"it is that of another {what}"
        elif differing:
            problem = f"it does not show as they are: {named(differing)}"
        elif notes is not None and f'<pre tabindex="0">{_escaped(notes.data)}</pre>'.encode() not in file.data:
            problem = "its order notes are not the kit's"
        else:
            problem = _page_problem(file.data, own_version=own)
    except (ValueError, KeyError, TypeError) as error:
        problem = f"its data cannot be read: {type(error).__name__}"
    right = f"of this {what}, with the SHA-256 of the {count} other files; it runs its own script and fetches nothing"
    others = "what it draws and says beside notes and digests" + ("" if own else ", and the script, of another version")
    message = f"{file.path}: {problem}" if problem else f"{right}; not compared: {others}"
    return Check(name=REPORT, passed=problem is None, message=message)


def _escaped(data: bytes) -> str:
    """Text as escaped by the page's template."""
    return html.escape(data.decode("utf-8")).replace("&#x27;", "&#39;").replace("&quot;", "&#34;")


def _page_problem(data: bytes, *, own_version: bool) -> str | None:
    """Description of a script or address in the page that is not this tool's; None if there is none."""
    policy, lower = _POLICY.match(data), data.lower()
    if policy is None:
        return "it does not begin with the policy that keeps a browser from running and fetching"
    # HTML tags are case-insensitive; the two scripts are the data and the page's own
    if [lower.count(word) for word in (b"<script", b"http-equiv", b"<style")] != [2, 1, 1]:
        return "it has another script, style or directive than its own"
    # line by line, as the page is assembled from several files and a frame
    known = {line for file in (templates_folder() / "report").iterdir() for line in file.read_bytes().splitlines()}
    for allowed, tag in zip(policy.groups(), (b"script", b"style"), strict=True):
        text = data.rpartition(b"<%b>" % tag)[2].partition(b"</%b>" % tag)[0]
        # Content-Security-Policy: 'sha256-...' is the digest of exactly the text between the tags
        if base64.b64encode(hashlib.sha256(text).digest()) != allowed:
            return f"its {tag.decode()} is not the one that its policy names"
        if own_version and (strange := [line for line in text.splitlines() if line not in known and line not in _FRAME]):
            return f"its {tag.decode()} is not this version's: {shown(strange[0].decode('latin-1'))}"
    return None


def check_as_built(manifest: Path, tape: Tape) -> tuple[Tape, list[Check]]:
    """The tape with the measured places beside its manifest, and a check of them; the tape itself and no check without any."""
    try:
        measured = tape.with_as_built(manifest)
    except SpecError as error:
        first, *more = error.problems  # a check is one line
        text = f"{first.message}{f' (and {len(more)} more)' if more else ''}"
        return tape, [Check(name="as-built", passed=False, message=f"{AS_BUILT_NAME}: {text}; or delete the file")]
    if (built := measured.as_built) is None:
        return tape, []
    sources = ", ".join(dict.fromkeys(str(entry["kind"]) for entry in built.source)) or "a source that it does not name"
    # the film's stretch shifts a part by (F - 1) p: not included in `mean_mm`, and largest at the far end of the tape
    stretch_mm = np.hypot(*(tape.part_xy_mm() @ (built.film.matrix - np.eye(2)).T).T).max(initial=0.0)
    stretched = f", and a stretch of the film that moves them by up to {stretch_mm * 1000:.1f} um more" if stretch_mm else ""
    message = (
        f"{len(built.number)} of {tape.part_count} parts measured by {sources}: {built.missing} missing, the others "
        f"{built.scatter_mm * 1000:.1f} um off the design (rms per axis); on the mean {built.mean_mm * 1000:.1f} um, by which "
        f"they move every position{stretched}; nothing in the kit vouches for them"
    )
    return measured, [Check(name="as-built", passed=True, message=message, figure=built.scatter_mm, unit="mm")]


def check_signature(role: str, data: bytes) -> str | None:
    """Problem of a Gerber file's .MD5 attribute (Gerber 2024.05 section 5.6.9); None if it is correct or absent."""
    for found in re.finditer(rb"TF\.MD5,([^*]*)\*", data):
        # as a command or a standardised comment (Gerber 2024.05 section 5.1.1); a part's name may contain the same text
        before = next((mark for mark in (b"%", b"G04 #@! ") if data.endswith(mark, 0, found.start())), None)
        if before is not None:
            signed = data[: found.start() - len(before)].replace(b"\n", b"").replace(b"\r", b"")
            right = hashlib.md5(signed, usedforsecurity=False).hexdigest().encode() == found.group(1)
            return None if right else f"{role}: its .MD5 signature does not fit its content"
    return None


def _is_drawing(data: bytes) -> bool:
    """Whether an SVG is complete, and has only shapes and text: a browser would run scripts and fetch references."""
    whole = data.startswith(b"<svg") and data.rstrip().endswith(b"</svg>")
    # only references within the drawing, for <use>
    inside = b"url(" not in data and data.count(b"href=") == data.count(b'href="#')
    different = b">".join(dict.fromkeys(data.translate(_NO_DIGITS).split(b">")))  # allowed names have no digits
    return whole and inside and {*_TAG.findall(different)} <= _TAGS and {*_ATTRIBUTE.findall(different)} <= _ATTRIBUTES


def check_picture(files: Mapping[str, WrittenFile], name: str | None = None, film: Pictured | None = None) -> Check:
    """Check that the previews can be opened; the size in a PNG's header is checked first, to bound the memory (PNG, 11.2.2).

    name: The SVG's title. film: The parts of a film, which all pictures must show; the SVG must not have others.
    """
    data = files["preview-png"].data
    height, width = png_size(data)
    # a PNG of a few kilobytes can decompress to gigabytes
    small = data.startswith(PNG_SIGNATURE) and max(width, height) <= MOST_PX
    image = unpacked(data, "IMREAD_COLOR", "opening a preview") if small else None
    drawn = [files[role].data for role in ("preview-svg", "placement-preview") if role in files]
    svg_whole = all(map(_is_drawing, drawn))
    if image is None or not svg_whole:
        return Check(name="previews", passed=False, message=f"the {'PNG' if image is None else 'SVG'} cannot be opened")
    names = () if name is None else (name, *(f"{name}{ending}" for ending in _NAMED_AS_CPL))
    problem = _other_tape(files["preview-svg"].data, names, None if film is None else film.xy_mm)
    compared = "what they show"
    if film is not None:
        compared = "all but parts of them" if shows_bodies(image, film) else "what the PNG shows, and all but parts of the SVG"
        problem = problem or png_problem(image, film)
        if problem is None and "placement-preview" in files:
            problem = placements_problem(files["placement-preview"].data, film)
    right = f"PNG {image.shape[1]} x {image.shape[0]} px and SVG; not compared: {compared}"
    return Check(name="previews", passed=problem is None, message=problem or right)


def _other_tape(svg: bytes, names: Collection[str], parts_xy_mm: FloatArray | None) -> str | None:
    """Reason why an SVG shows another tape or panel; None if there is none."""
    title = _TITLE.search(svg)
    if names and title is not None and html.unescape(title[1].decode("utf-8", "replace")) not in names:
        return f"the SVG is of {shown(title[1].decode('utf-8', 'replace'))}"
    if parts_xy_mm is None:
        return None
    places = np.array(_BODY.findall(svg), dtype=np.float64).reshape(-1, 2) * (1, -1)  # SVG has y down
    if places.shape != parts_xy_mm.shape:
        return f"the SVG shows {len(places)} parts, not {len(parts_xy_mm)}"
    if np.abs(places - parts_xy_mm).max(initial=0.0) <= _SVG_ERROR_MM:
        return None
    # bodies are grouped by kind, so they may not be in the order of designators
    near, _ = shapely.STRtree(shapely.points(places)).query(shapely.points(parts_xy_mm), "dwithin", _SVG_ERROR_MM)
    off = len(parts_xy_mm) - len(np.unique(near))
    return f"the SVG shows {off} parts in other places" if off else None
