"""A file that a user asks for: written beside its place, on the disk before it gets its name, and never over another file."""

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
"""Of a name in that of its unfinished file: file systems bound one in bytes, most of them at 255."""
_AT_ONCE = 8
"""Files that are brought to the disk at a time: one by one, waiting for it takes a tenth of the time of a kit."""


def refuse_taken_place(
    path: Path, key: str, *, overwrite: bool | None = None, ours: Callable[[Path], bool] | None = None, kind: str = ""
) -> None:
    """Refuse a path of a new file: in no folder, or that of something else. Raises SpecError.

    key: The option that names it, for the message.
    overwrite: Whether a regular file there may be replaced, as --overwrite asks for; None where there is no such option. A link,
        a folder or a device never is.
    ours: Whether a regular file there is of the kind that is written: no other is replaced, with `overwrite` neither, and where
        there is no such option it is replaced without being asked to. It may raise OSError or ValueError.
    kind: What a file is that is not, for the message.
    """
    said = f"{key} = {shown_path(path)}"
    try:
        mode = mode_of(path)
        if mode is None and not path.parent.is_dir():
            raise SpecError(Problem(key, f"{said}: there is no folder of that name; make it first"))
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, SpecError):
            raise
        raise SpecError(Problem(key, f"{said} cannot be looked at: {reason_of(error)}; use another name")) from error
    if mode is None:
        return
    if not stat.S_ISREG(mode):
        what = "a folder" if stat.S_ISDIR(mode) else "a link" if stat.S_ISLNK(mode) else "no regular file"
        raise SpecError(Problem(key, f"{said} is {what}; nothing was touched; use another name"))
    if overwrite is False or (overwrite is None and ours is None):
        remedy = "nothing was touched; use" if overwrite is None else "use --overwrite to replace it, or"
        raise SpecError(Problem(key, f"{said} exists already; {remedy} another name"))
    if ours is not None and not _is(ours, path):
        raise SpecError(Problem(key, f"{said} is there and is {kind}; nothing was touched; use another name"))


def _is(ours: Callable[[Path], bool], path: Path) -> bool:
    try:
        return ours(path)
    except (OSError, ValueError):
        return False


def unfinished(path: Path) -> Path:
    """A new path for what is not finished: hidden, in the same folder, as a link or a rename works within one file system."""
    name = path.name.encode(errors="ignore")[:_MOST_NAME_BYTES].decode(errors="ignore")
    return path.with_name(f".{name}.{secrets.token_hex(4)}{UNFINISHED_SUFFIX}")


def write_file(path: Path, data: bytes, key: str, *, overwrite: bool) -> None:
    """Write a file, whole or not at all: an older file stays until the new one has its name.

    key, overwrite: As for `refuse_taken_place`, which is asked again.
    Raises SpecError if the place is taken.
    Raises TactapeError if it cannot be written; nothing is left of it.
    """
    refuse_taken_place(path, key, overwrite=overwrite)
    partial = unfinished(path)
    try:
        try:
            # "x" refuses a file that is there: the random name cannot be taken over
            with partial.open("xb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            if overwrite:
                refuse_taken_place(path, key, overwrite=True)
                partial.replace(path)
            else:
                # rename would replace a file that has come in between; link refuses it
                _name_if_free(partial, path)
        finally:
            with suppress(OSError):
                partial.unlink()
        # after the file itself: a name on the disk must not outlive its content
        sync_folder(path.parent)
    except FileExistsError:  # it came into being since
        refuse_taken_place(path, key, overwrite=False)
        raise
    except (OSError, ValueError) as error:
        if isinstance(error, SpecError):
            raise
        reason = reason_of(error)
        message = f"{key} = {shown_path(path)} cannot be written: {reason}; what stood there is as it was; use another place"
        raise TactapeError(message) from error


def _name_if_free(partial: Path, path: Path) -> None:
    """Give a file its name unless another one has it; in one step where the file system has hard links."""
    try:
        os.link(partial, path)
    except FileExistsError:
        raise
    except OSError:
        if path.exists() or path.is_symlink():
            raise FileExistsError(str(path)) from None
        partial.rename(path)


def sync_file(path: Path) -> None:
    """Bring a file to the disk. Raises OSError."""
    handle = os.open(path, os.O_RDWR)  # some systems sync only what may be written
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_folder(folder: Path) -> None:
    """Bring a folder's list of names to the disk, where the system can: a rename in it outlives a power cut."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def sync_below(folder: Path) -> None:
    """Bring every file and folder below a folder to the disk. Raises OSError if a file cannot be brought there."""
    from concurrent.futures import ThreadPoolExecutor  # imported here: reading commands do without

    # topdown=False: what lies deepest first, so that a folder is synced after all that it holds
    places = [(Path(place), names) for place, _, names in os.walk(folder, topdown=False)]
    with ThreadPoolExecutor(_AT_ONCE) as threads:
        list(threads.map(sync_file, [place / name for place, names in places for name in names]))
    for place, _ in places:
        sync_folder(place)
