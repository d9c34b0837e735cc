"""Opening of untrusted files: regular ones only, without waiting for a writer.

A FIFO that is named like a frame blocks whoever opens it until somebody writes to it, and a link to a device never ends.
"""

from __future__ import annotations

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path


def open_regular(path: Path) -> BufferedReader:
    """Open a regular file for reading, through links.

    Raises
    ------
    OSError
        If it cannot be opened, or is a FIFO, a device, a socket or a folder.
    """
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

    Raises
    ------
    OSError
        As `open_regular`.
    """
    with open_regular(path) as stream:
        return stream.read(most_bytes + 1)
