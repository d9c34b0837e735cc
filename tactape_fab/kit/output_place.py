"""Check of a kit's output path: whether something there may not be replaced."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from tactape_fab.base.errors import SpecError
from tactape_fab.base.fields import Fields, shown_path
from tactape_fab.texture.manifest import MANIFEST_NAME, UNFINISHED_SUFFIX, read_any_manifest
from tactape_fab.texture.panel_manifest import is_panel, read_placed


def refuse_taken(target: Path, *, overwrite: bool) -> None:
    """Raise SpecError if a kit may not be written here: an invalid name, a foreign folder, a kit without `overwrite`."""
    if target.name.endswith(UNFINISHED_SUFFIX) or target.name in ("", "..") or target.name.startswith("."):
        raise SpecError(f"output = {target} is no name for a kit; give a folder that does not begin with '.' and ends otherwise")
    try:
        taken = target.exists() or target.is_symlink()
    except (OSError, ValueError) as error:  # a name that is invalid on every system
        reason = getattr(error, "strerror", None) or error
        raise SpecError(f"output = {shown_path(target)} cannot be a folder: {reason}; use -o to name another one") from error
    if taken and (target.is_symlink() or not target.is_dir()):
        raise SpecError(f"output = {target} exists and is not a folder; nothing was touched; use -o to name another folder")
    if taken and not overwrite:
        raise SpecError(f"output = {target} exists already; use --overwrite to replace a kit, or -o to name another folder")
    if taken:
        _refuse_foreign(target)


def _refuse_foreign(target: Path) -> None:
    """Only a folder made by this tool may be replaced: it has our manifest, and no file that the manifest does not list."""
    remedy = "nothing was touched; use -o to name another folder"
    try:
        listed = _listed(target, "")
    except SpecError as error:
        raise SpecError(f"output = {target} is no kit of this tool ({error}); {remedy}") from None
    for place in target.rglob("*"):
        if (place.is_symlink() or not place.is_dir()) and place.relative_to(target).as_posix() not in listed:
            raise SpecError(f"output = {target} holds {place.relative_to(target)}, which its manifest does not list; {remedy}")


def _listed(folder: Path, within: str) -> set[str]:
    """Every file that the manifest of a kit lists, or that of a panel and of each kit on it; relative to the outer folder."""
    content = read_any_manifest(folder / MANIFEST_NAME)
    rows = content.get("files")
    listed = {f"{within}{row.get('path')}" for row in rows if isinstance(row, dict)} if isinstance(rows, list) else set()
    listed.add(f"{within}{MANIFEST_NAME}")
    if is_panel(content) and not within:
        for placed in read_placed(Fields(content)):
            place = PurePosixPath(placed.manifest).parent
            listed |= _listed(folder / place, f"{place}/")
    return listed
