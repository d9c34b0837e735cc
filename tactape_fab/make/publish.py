"""Atomic publishing of a finished folder under its final name; an interruption leaves no partial files."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from tactape_fab.base.errors import TactapeError, reason_of
from tactape_fab.base.output_file import UNFINISHED_SUFFIX, sync_below, sync_folder, unfinished
from tactape_fab.kit.output_place import Overwrite, refuse_taken
from tactape_fab.texture.manifest import MANIFEST_NAME

if TYPE_CHECKING:
    from tactape_fab.verify.signature import Signer

# from linux/fs.h and fcntl.h: exchange both names; paths are relative to the current folder
_RENAME_EXCHANGE = 2
_AT_FDCWD = -100


@contextmanager
def finished(target: Path, what: str, *, overwrite: Overwrite, signer: Signer | None = None) -> Iterator[Path]:
    """Context manager: a new folder beside `target`, which gets its name at the end of the block, or is removed after an error.

    what: Kind of result, for the error message.
    overwrite: Replace an older kit of this tool.
    signer: Signs the folder at the end of the block.
    Raises TactapeError if the folder or a file in it cannot be written.
    """
    folder = unfinished(target)
    new_parents = [parent for parent in target.parents if not parent.exists()]
    try:
        folder.mkdir(parents=True)
        with suppress(FileNotFoundError):
            target.lstat()  # a name that is too long for the file system is refused before the work, not at the rename
        yield folder
        if signer is not None:
            signer.sign(folder)
        sync_below(folder)  # a power cut after the rename must not find a name without its files
        put_in_place(folder, target, overwrite=overwrite)
        sync_folder(target.parent)
    except OSError as error:
        reason = reason_of(error)
        raise TactapeError(f"the {what} cannot be written to {target}: {reason}; use -o to name another folder") from error
    finally:
        try:
            clear_away(folder, new_parents)
        except BaseException:  # a second signal, or no memory for the call
            clear_away(folder, new_parents)
            raise


def clear_away(folder: Path, new_parents: Sequence[Path]) -> None:
    """Remove an unfinished folder, and new parents that are empty."""
    shutil.rmtree(folder, ignore_errors=True)
    for parent in new_parents:  # innermost first; a folder that contains a kit is kept
        with suppress(OSError):
            parent.rmdir()


def put_in_place(folder: Path, target: Path, *, overwrite: Overwrite) -> None:
    """Give a finished folder its final name; other processes see the old kit or the new one, never a mixture."""
    # `exists` is false for a dangling link, whose name is taken all the same
    if not (target.exists() or target.is_symlink()):
        folder.rename(target)
        return
    if overwrite == "same" and (target / MANIFEST_NAME).read_bytes() != (folder / MANIFEST_NAME).read_bytes():
        overwrite = False
    refuse_taken(target, overwrite=overwrite)  # again, as it may have been created since
    if _exchange(folder, target):
        return
    # without an atomic exchange the old kit is moved aside, and back again if the new one cannot be renamed
    aside = folder.with_name(folder.name.removesuffix(UNFINISHED_SUFFIX) + ".old" + UNFINISHED_SUFFIX)
    target.rename(aside)
    try:
        folder.rename(target)
    except OSError:
        aside.rename(target)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _exchange(a: Path, b: Path) -> bool:
    """Exchange two folders atomically (Linux renameat2 with RENAME_EXCHANGE); False if the system does not support it."""
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
