"""A finished folder takes its name in one step, and whatever interrupts leaves nothing half-written behind."""

from __future__ import annotations

import ctypes
import errno
import os
import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from tactape_fab.errors import SpecError, TactapeError
from tactape_fab.fields import Fields, shown_path
from tactape_fab.texture.panel import is_panel, read_placed
from tactape_fab.texture.tape import MANIFEST_NAME, UNFINISHED_SUFFIX, read_any_manifest

_RENAME_EXCHANGE = 2
_AT_FDCWD = -100


@contextmanager
def finished(target: Path, what: str, *, overwrite: bool) -> Iterator[Path]:
    """A new folder beside `target`, which takes its place at the end of the block; nothing stays of it where that is not reached.

    Parameters
    ----------
    target : Path
    what : str
        What is written, for the message where that cannot be.
    overwrite : bool
        Replace an older kit of this tool.

    Raises
    ------
    TactapeError
        When the folder or a file in it cannot be written.
    """
    folder = target.parent / f".{target.name}.{secrets.token_hex(4)}{UNFINISHED_SUFFIX}"
    new_parents = [parent for parent in target.parents if not parent.exists()]
    try:
        folder.mkdir(parents=True)
        yield folder
        put_in_place(folder, target, overwrite=overwrite)
    except OSError as error:
        reason = error.strerror or error
        raise TactapeError(f"the {what} cannot be written to {target}: {reason}; use -o to name another folder") from error
    finally:
        clear_away(folder, new_parents)


def clear_away(folder: Path, new_parents: Sequence[Path]) -> None:
    """Leave nothing behind, also when a second signal comes while this is under way."""
    try:
        shutil.rmtree(folder, ignore_errors=True)
        for parent in new_parents:  # innermost first; one that holds a kit stays
            with suppress(OSError):
                parent.rmdir()
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def refuse_taken(target: Path, *, overwrite: bool) -> None:
    """Raise SpecError where a kit may not take this place: a bad name, a foreign folder, a kit without `overwrite`."""
    if target.name.endswith(UNFINISHED_SUFFIX) or target.name in ("", "..") or target.name.startswith("."):
        raise SpecError(f"output = {target} is no name for a kit; give a folder that does not begin with '.' and ends otherwise")
    try:
        taken = target.exists() or target.is_symlink()
    except (OSError, ValueError) as error:  # a name that no system takes
        reason = getattr(error, "strerror", None) or error
        raise SpecError(f"output = {shown_path(target)} cannot be a folder: {reason}; use -o to name another one") from error
    if taken and (target.is_symlink() or not target.is_dir()):
        raise SpecError(f"output = {target} exists and is not a folder; nothing was touched; use -o to name another folder")
    if taken and not overwrite:
        raise SpecError(f"output = {target} exists already; use --overwrite to replace a kit, or -o to name another folder")
    if taken:
        _refuse_foreign(target)


def _refuse_foreign(target: Path) -> None:
    """Only a folder that is wholly ours may be replaced: our manifest, and no file that it does not list."""
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


def put_in_place(folder: Path, target: Path, *, overwrite: bool) -> None:
    """Give a finished folder its name; whoever looks sees the old kit or the new one, never a mixture."""
    if not (target.exists() or target.is_symlink()):
        folder.rename(target)
        return
    refuse_taken(target, overwrite=overwrite)  # again: it may have come since
    if _exchange(folder, target):
        return
    # without an exchange in one step: the old kit steps aside under an unfinished name, and back if the new one fails
    aside = folder.with_name(folder.name.removesuffix(UNFINISHED_SUFFIX) + ".old" + UNFINISHED_SUFFIX)
    target.rename(aside)
    try:
        folder.rename(target)
    except OSError:
        aside.rename(target)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _exchange(a: Path, b: Path) -> bool:
    """Exchange two folders in one step (Linux renameat2 with RENAME_EXCHANGE); False where the system cannot."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    if rename(_AT_FDCWD, os.fsencode(a), _AT_FDCWD, os.fsencode(b), _RENAME_EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP):
        return False
    raise OSError(code, os.strerror(code))
