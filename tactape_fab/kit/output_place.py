"""Check of a kit's output path: whether something there may not be replaced."""

from __future__ import annotations

import stat
from pathlib import Path, PurePosixPath
from typing import Literal

from tactape_fab.base.errors import Problem, SpecError, reason_of
from tactape_fab.base.fields import Fields, named, shown, shown_path
from tactape_fab.base.input_file import mode_of, sha256_of
from tactape_fab.base.output_file import UNFINISHED_SUFFIX
from tactape_fab.texture.manifest import MANIFEST_NAME, SIGNATURE_NAME, read_any_manifest
from tactape_fab.texture.panel_manifest import is_panel, read_placed

Overwrite = bool | Literal["edits", "same"]
"""Whether an older kit may be replaced: never, if unedited (True), even if edited ("edits"), or only by itself ("same")."""


def refuse_taken(target: Path, *, overwrite: Overwrite) -> None:
    """Raise SpecError if a kit may not be written here: an invalid name, a foreign folder, a kit without `overwrite`, or one
    with files that were edited unless `overwrite` is ``"edits"``.
    """
    given: object = overwrite
    if not (isinstance(given, bool) or (isinstance(given, str) and given in ("edits", "same"))):
        message = f"overwrite = {shown(given)} is neither True, False nor 'edits'; give one of them"
        raise SpecError(Problem("overwrite", message))
    if target.name.endswith(UNFINISHED_SUFFIX) or target.name in ("", "..") or target.name.startswith("."):
        raise SpecError(f"output = {target} is no name for a kit; give a folder that does not begin with '.' and ends otherwise")
    try:
        mode = mode_of(target)
    except (OSError, ValueError) as error:  # a name that is invalid on every system
        reason = reason_of(error)
        raise SpecError(f"output = {shown_path(target)} cannot be a folder: {reason}; use -o to name another one") from error
    if mode is None:
        nearest = next(place for place in target.parents if mode_of(place) is not None)
        if not nearest.is_dir():
            message = (
                f"output = {shown_path(target)}: {shown_path(nearest)} is there and is no folder; use -o to name another one"
            )
            raise SpecError(message)
        return
    if not stat.S_ISDIR(mode):
        raise SpecError(f"output = {target} exists and is not a folder; nothing was touched; use -o to name another folder")
    if not overwrite:
        raise SpecError(f"output = {target} exists already; use --overwrite to replace a kit, or -o to name another folder")
    _refuse_foreign(target, edits=overwrite == "edits")


def _refuse_foreign(target: Path, *, edits: bool) -> None:
    """Refuse a folder that this tool did not make: one without our manifest, with a file or folder that the manifest does not
    list or, unless `edits`, with a file that was changed since it was written.
    """
    remedy = "nothing was touched; use -o to name another folder"
    try:
        listed = _listed(target, "")
    except SpecError as error:
        raise SpecError(f"output = {shown_path(target)} is no kit of this tool ({error}); {remedy}") from None
    # a folder is listed if a listed file lies below it
    folders = {str(parent) for path in listed for parent in PurePosixPath(path).parents}
    edited = []
    for place in sorted(target.rglob("*")):
        path = place.relative_to(target).as_posix()
        # a link to a folder is a file that the manifest does not list
        is_folder = place.is_dir() and not place.is_symlink()
        if path not in (folders if is_folder else listed):
            what = "the folder " if is_folder else ""
            message = f"output = {shown_path(target)} holds {what}{shown_path(path)}, which its manifest does not list; {remedy}"
            raise SpecError(message)
        if not is_folder and not edits and not _as_written(place, listed[path]):
            edited.append(path)
    if edited:
        raise SpecError(
            f"output = {shown_path(target)} holds files that were edited since: {named(edited)}; "
            "nothing was touched; use -o to name another folder, or --discard-edits to lose these edits"
        )


def _as_written(place: Path, sha256: str | None) -> bool:
    """Whether a file has the digest that its manifest records; a manifest itself has none, unless a panel's does."""
    if sha256 is None:
        return True
    try:
        digest = sha256_of(place)
    except OSError:
        return False
    # a link is refused even if it leads to the same bytes, as this tool writes none
    return place.is_file() and not place.is_symlink() and digest == sha256


def _listed(folder: Path, within: str, digest: str | None = None) -> dict[str, str | None]:
    """SHA-256 of every file that the manifest lists, for a panel also those of its kits, by path relative to the outer folder.
    ``digest`` is that of this manifest, if a panel records it.
    """
    content = read_any_manifest(folder / MANIFEST_NAME)
    rows = content.get("files")
    rows = [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    listed: dict[str, str | None] = {f"{within}{row.get('path')}": str(row.get("sha256")) for row in rows}
    listed[f"{within}{MANIFEST_NAME}"] = digest
    listed[f"{within}{SIGNATURE_NAME}"] = None
    # kits on a panel are not panels themselves: `within` ends the recursion after one level
    if is_panel(content) and not within:
        for placed in read_placed(Fields(content)):
            place = PurePosixPath(placed.manifest).parent
            listed |= _listed(folder / place, f"{place}/", placed.sha256)
    return listed
