"""Opening of untrusted files: regular ones only, without waiting for a writer.

A FIFO that is named like a frame blocks whoever opens it until somebody writes to it, and a link to a device never ends.
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
    """Open a regular file for reading, through links.

    Raises OSError if it cannot be opened, or is a FIFO, a device, a socket or a folder.
    """
    # O_NONBLOCK: opening a FIFO does not wait for a writer. The type is asked of what is open, not of the name, which may change
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0))
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_regular(path: Path, most_bytes: int) -> bytes:
    """The bytes of a regular file, one more than `most_bytes` at most, so that the caller can tell a file that is larger.

    Raises OSError as `open_regular`.
    """
    with open_regular(path) as stream:
        return stream.read(most_bytes + 1)


def sha256_of(path: Path) -> str:
    """SHA-256 of a regular file, which is read piece by piece, in 64 hexadecimal digits. Raises OSError as `open_regular`."""
    digest = hashlib.sha256()
    with open_regular(path) as stream:
        while piece := stream.read(1 << 20):
            digest.update(piece)
    return digest.hexdigest()


def begins_with(path: Path, mark: str) -> bool:
    """Whether a regular file begins with some ASCII text. Raises OSError."""
    return read_regular(path, len(mark)).startswith(mark.encode("ascii"))


def read_member(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, most_bytes: int) -> bytes:
    """The bytes of a member of a zip that unpacks to no more than `most_bytes`, whatever it says of itself.

    `ZipFile.read` unpacks all that the compressed bytes hold before it looks at the size that the directory gives.

    Raises ValueError if it unpacks to more, or to other than the zip announces.
    Raises zipfile.BadZipFile, zlib.error, OSError, NotImplementedError, RuntimeError if it is damaged, encrypted, or packed in a
        way that Python does not know.
    """
    with archive.open(entry) as member:
        data = member.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise ValueError(f"{entry.filename[:100]!r} unpacks to more than {most_bytes} bytes")
    if len(data) != entry.file_size:
        raise ValueError(f"{entry.filename[:100]!r} unpacks to {len(data)} bytes, and the zip announces {entry.file_size}")
    return data


def mode_of(path: Path) -> int | None:
    """Mode of what has a name, that of a link if it is one; None where nothing has.

    Raises OSError or ValueError where the name is invalid on every system or cannot be looked at: `Path.exists` says so up to
    Python 3.13 only.
    """
    try:
        return path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
