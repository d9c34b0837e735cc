"""Output files: written under a temporary name in the same folder, synced, then renamed; no other file is ever replaced."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from tactape_fab.base.errors import Problem, SpecError, TactapeError, reason_of
from tactape_fab.base.fields import shown_path
from tactape_fab.base.input_file import mode_of

UNFINISHED_SUFFIX = ".partial"
"""End of the name of a file or folder that is being written; such a folder is never a kit."""
_MOST_NAME_BYTES = 200
"""Bytes of a file's name that its temporary name keeps: most file systems allow 255 bytes."""
_AT_ONCE = 8
"""Files that are synced at the same time: one by one, waiting for the disk takes a tenth of the time of a kit."""


def refuse_taken_place(
    path: Path, key: str, *, overwrite: bool | None = None, ours: Callable[[Path], bool] | None = None, kind: str = ""
) -> None:
    """Refuse the path of an output file if its folder does not exist or something else is there. Raises SpecError.

    key: The option that gives the path, for the message.
    overwrite: Whether a regular file there may be replaced, as --overwrite asks for; None where there is no such option. A link,
        a folder or a device never is.
    ours: Tells whether a regular file there is of the kind that is written. No other is replaced, not even with `overwrite`; with
        ``overwrite=None`` a file of the kind is replaced without asking. It may raise OSError or ValueError.
    kind: Description of a file that is not of the kind, for the message.
    """
    given = f"{key} = {shown_path(path)}"
    try:
        mode = mode_of(path)
        if mode is None and not path.parent.is_dir():
            nearest = next(place for place in path.parents if mode_of(place) is not None)
            taken = f"{shown_path(nearest)} is there and is no folder; use another name"
            lacks = "there is no folder of that name; make it first" if nearest.is_dir() else taken
            raise SpecError(Problem(key, f"{given}: {lacks}"))
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, SpecError):
            raise
        raise SpecError(Problem(key, f"{given} cannot be looked at: {reason_of(error)}; use another name")) from error
    if mode is None:
        return
    if not stat.S_ISREG(mode):
        what = "a folder" if stat.S_ISDIR(mode) else "a link" if stat.S_ISLNK(mode) else "no regular file"
        raise SpecError(Problem(key, f"{given} is {what}; nothing was touched; use another name"))
    if overwrite is False or (overwrite is None and ours is None):
        remedy = "nothing was touched; use" if overwrite is None else "use --overwrite to replace it, or"
        raise SpecError(Problem(key, f"{given} exists already; {remedy} another name"))
    if ours is not None and not _is_ours(ours, path):
        raise SpecError(Problem(key, f"{given} is there and is {kind}; nothing was touched; use another name"))


def _is_ours(ours: Callable[[Path], bool], path: Path) -> bool:
    try:
        return ours(path)
    except (OSError, ValueError):
        return False


def unfinished(path: Path) -> Path:
    """A new hidden path in the same folder for an unfinished file: links and renames work within one file system only."""
    name = path.name.encode(errors="ignore")[:_MOST_NAME_BYTES].decode(errors="ignore")
    return path.with_name(f".{name}.{secrets.token_hex(4)}{UNFINISHED_SUFFIX}")


def write_file(path: Path, data: bytes, key: str, *, overwrite: bool) -> None:
    """Write a file atomically: an older file stays until the new one is complete.

    key, overwrite: As for `refuse_taken_place`, which is asked again.
    Raises SpecError if the place is taken.
    Raises TactapeError if it cannot be written; the unfinished file is removed.
    """
    refuse_taken_place(path, key, overwrite=overwrite)
    partial = unfinished(path)
    try:
        try:
            # "x" refuses an existing file, so nobody can prepare one under the random name
            with partial.open("xb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            if overwrite:
                refuse_taken_place(path, key, overwrite=True)
                partial.replace(path)
            else:
                # a rename would replace a file that appeared meanwhile; a link refuses that
                _name_if_free(partial, path)
        finally:
            with suppress(OSError):
                partial.unlink()
        # after the file itself: after a power cut there must be no name without its content
        sync_folder(path.parent)
    except FileExistsError:  # the file appeared after the check
        refuse_taken_place(path, key, overwrite=False)
        raise
    except (OSError, ValueError) as error:
        if isinstance(error, SpecError):
            raise
        raise not_written(path, key, error) from error


def not_written(path: Path, key: str, error: OSError | ValueError) -> TactapeError:
    """The error of a file that could not be written, whose name has what it had before."""
    reason = reason_of(error)
    return TactapeError(
        f"{key} = {shown_path(path)} cannot be written: {reason}; what stood there is as it was; use another place"
    )


def _name_if_free(partial: Path, path: Path) -> None:
    """Rename a file unless the name is taken; atomic where the file system has hard links."""
    try:
        os.link(partial, path)
    except FileExistsError:
        raise
    except OSError:
        if path.exists() or path.is_symlink():
            raise FileExistsError(str(path)) from None
        partial.rename(path)


def sync_file(path: Path) -> None:
    """Flush a file to the disk (fsync). Raises OSError."""
    handle = os.open(path, os.O_RDWR)  # some systems sync only files that are open for writing
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_folder(folder: Path) -> None:
    """Flush a folder's entries to the disk, where the system can, so that a rename in it survives a power cut."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def sync_below(folder: Path) -> None:
    """Flush every file and folder below a folder to the disk. Raises OSError if a file cannot be flushed."""
    from concurrent.futures import ThreadPoolExecutor  # imported here: commands that only read do not need it

    # topdown=False: deepest first, so that a folder is synced after its contents
    places = [(Path(place), names) for place, _, names in os.walk(folder, topdown=False)]
    with ThreadPoolExecutor(_AT_ONCE) as threads:
        list(threads.map(sync_file, [place / name for place, names in places for name in names]))
    for place, _ in places:
        sync_folder(place)
