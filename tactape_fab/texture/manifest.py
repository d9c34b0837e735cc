"""Manifest files: finding, reading and checking the format; `texture.tape` and `texture.panel_manifest` read the content."""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath
from typing import Any

from tactape_fab.base.errors import Problem, SpecError, reason_of
from tactape_fab.base.fields import shown, shown_path
from tactape_fab.base.given_path import as_path
from tactape_fab.base.input_file import mode_of, read_regular
from tactape_fab.base.json_text import parse_json
from tactape_fab.base.output_file import UNFINISHED_SUFFIX

MANIFEST_FORMAT = "tactape-manifest/1"
PANEL_FORMAT = "tactape-panel/1"
PACKED_FIRST_LINE = b"tactape-registry/1\n"
"""First line of a packed registry, which holds many tapes and is not a kit."""
MANIFEST_NAME = "manifest.json"
SIGNATURE_NAME = f"{MANIFEST_NAME}.sig"
"""Detached signature of the manifest, by the maker of the kit."""
MOST_MANIFEST_BYTES = 16 * 1024 * 1024
"""Most bytes of a manifest: one with 500,000 grid points, half of them omitted, 10,000 holes and 100 files takes 5 MB."""


def find_manifest(path: str | Path) -> Path:
    """The manifest file of a kit, given its folder or the file itself.

    Raises SpecError if there is no manifest, or the folder was left unfinished by an interrupted run.
    """
    place = as_path(path, "path", f"the folder of a kit or its {MANIFEST_NAME}")
    try:
        mode_of(place)
        is_folder = place.is_dir()
        file = place / MANIFEST_NAME if is_folder else place
        unfinished = file.resolve().parent.name.endswith(UNFINISHED_SUFFIX)
        there, is_other = file.is_file(), file.exists()
    except (OSError, RuntimeError, ValueError) as error:  # a link loop, or a name that is invalid on every system
        raise SpecError(f"{shown_path(place)} is no kit: {reason_of(error)}; give the folder of a kit") from error
    if unfinished:
        raise SpecError(f"{place} is an unfinished kit that an interrupted run left behind; delete it and run make again")
    if not there:
        lacks = f"it holds no {MANIFEST_NAME}" if is_folder else "there is no such file"
        reason = f"{f'its {MANIFEST_NAME}' if is_folder else 'it'} is no regular file" if is_other else lacks
        raise SpecError(f"{shown_path(place)} is no kit: {reason}; give the folder of a kit or its {MANIFEST_NAME}")
    return file


def read_manifest(file: Path) -> dict[str, Any]:
    """The content of a kit's manifest.json as a mapping, its size and format checked.

    Raises SpecError if the file is too large, not JSON, or not of this format.
    """
    content = read_any_manifest(file)
    if content["format"] == PANEL_FORMAT:
        message = f"{shown_path(file)} is that of a panel, not of one tape"
        first = min(file.parent.glob(f"tapes/*/{MANIFEST_NAME}"), default=Path("PANEL/tapes/NAME") / MANIFEST_NAME)
        raise SpecError(f"{message}; give the folder of one of the kits on it, such as {shown_path(first.parent)}")
    return content


def read_any_manifest(file: Path) -> dict[str, Any]:
    """The content of a manifest.json of a kit or of a panel.

    Raises SpecError if the file is too large, not JSON, or of neither format.
    """
    try:
        data = read_regular(file, MOST_MANIFEST_BYTES)
        if data.startswith(PACKED_FIRST_LINE):
            raise SpecError(f"{file.name} is a packed registry, and one kit is asked for; give the folder of a kit")
        if len(data) > MOST_MANIFEST_BYTES:
            raise SpecError(f"{file.name} is larger than {MOST_MANIFEST_BYTES} bytes; it is not a manifest of this tool")
        content = parse_json(data)
    except (OSError, ValueError) as error:
        if isinstance(error, SpecError):
            raise
        message = f"{file.name} cannot be read as JSON: {reason_of(error)}; give the folder of a kit, or its manifest.json"
        raise SpecError(message) from error
    found = content.get("format") if isinstance(content, dict) else None
    if found not in (MANIFEST_FORMAT, PANEL_FORMAT):
        raise SpecError(f"{file.name} has format {shown(found)}; this version reads '{MANIFEST_FORMAT}'")
    return dict(content)


def of_kit(place: Path, problem: Problem) -> Problem:
    """A problem of a kit's file, with the kit's path put before its message unless that names the file already."""
    if problem.message.startswith(f"{place}{os.sep}"):
        return Problem("tape", problem.message)
    if problem.message.startswith(f"{place.name} ") and place.is_file():  # a folder might have the name of a key
        return Problem("tape", f"{shown_path(place)}{problem.message.removeprefix(place.name)}")
    return Problem(f"tape {shown_path(place)}: {problem.key}", f"{shown_path(place)}: {problem.message}")


def safe_path(text: object) -> PurePosixPath | None:
    """A path from a manifest; None if it could lead out of the kit's folder."""
    if not isinstance(text, str) or not re.fullmatch(r"[A-Za-z0-9._ /+-]{1,300}", text):
        return None
    path = PurePosixPath(text)
    return None if path.is_absolute() or ".." in path.parts or str(path) != text else path
