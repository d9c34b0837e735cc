"""Opening of untrusted files: regular files only, never blocking.

Opening a FIFO that has the name of a frame would block until somebody writes to it, and reading a device may never end.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
import zipfile
from io import BufferedReader
from pathlib import Path


def open_regular(path: Path) -> BufferedReader:
    """Open a regular file for reading; links are followed.

    Raises OSError if it cannot be opened, or is a FIFO, a device, a socket or a folder.
    """
    # O_NONBLOCK: opening a FIFO does not wait for a writer. The type is that of the open file, as the name may be replaced
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0))
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_regular(path: Path, most_bytes: int) -> bytes:
    """The first ``most_bytes + 1`` bytes of a regular file: the caller sees by the last one that a file is too large.

    Raises OSError as `open_regular`.
    """
    with open_regular(path) as stream:
        return stream.read(most_bytes + 1)


def sha256_of(path: Path) -> str:
    """SHA-256 of a regular file as 64 hexadecimal digits; the file is read in pieces. Raises OSError as `open_regular`."""
    digest = hashlib.sha256()
    with open_regular(path) as stream:
        while piece := stream.read(1 << 20):
            digest.update(piece)
    return digest.hexdigest()


def begins_with(path: Path, mark: str) -> bool:
    """Whether a regular file begins with the ASCII text `mark`. Raises OSError."""
    return read_regular(path, len(mark)).startswith(mark.encode("ascii"))


def read_member(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, most_bytes: int) -> bytes:
    """The bytes of a zip member, at most `most_bytes`, whatever size the zip states.

    `ZipFile.read` decompresses everything before it compares the size with that in the zip's directory.

    Raises ValueError if it has more bytes, or another number than the zip states.
    Raises zipfile.BadZipFile, zlib.error, OSError, NotImplementedError, RuntimeError if it is damaged, encrypted, or compressed
        by a method that Python does not know.
    """
    with archive.open(entry) as member:
        data = member.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise ValueError(f"{entry.filename[:100]!r} unpacks to more than {most_bytes} bytes")
    if len(data) != entry.file_size:
        raise ValueError(f"{entry.filename[:100]!r} unpacks to {len(data)} bytes, and the zip announces {entry.file_size}")
    return data


def mode_of(path: Path) -> int | None:
    """File mode of a path, of the link itself if it is one; None if nothing is there.

    Raises OSError or ValueError if the name is invalid on every system or cannot be looked up; `Path.exists` raises these up to
    Python 3.13 only.
    """
    try:
        return path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
