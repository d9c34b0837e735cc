"""Image files: their headers, which are checked before anything is decoded, and decoding by OpenCV."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import SpecError
from tactape_fab.base.libraries import library

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
PNG_HEADER = PNG_SIGNATURE + b"\x00\x00\x00\rIHDR"
AS_STORED = "IMREAD_COLOR IMREAD_IGNORE_ORIENTATION"
"""Modes of `unpacked`: three channels of 8 bits in the order BGR, not rotated by the EXIF orientation."""
TIFF_SIGNATURES = (b"II*\x00", b"MM\x00*")
_SILENT = 0
"""OpenCV's log level that writes nothing to stderr."""
_MOST_MARKERS = 1000
_MOST_ENTRIES = 200
_NO_FRAME = {0xC4, 0xC8, 0xCC}
"""JPEG markers from C0 to CF that do not start a frame (ITU-T T.81, table B.1)."""
_NO_SEGMENT = {0x00, 0x01, *range(0xD0, 0xDA)}
"""JPEG markers without parameters (ITU-T T.81, table B.1), SOI and EOI among them; and 00, which is not a marker."""
_WHOLE_BYTES = {3: 2, 4: 4}
"""Bytes of the integer types of TIFF, SHORT (3) and LONG (4)."""


def unpacked(data: bytes, flags: str, purpose: str) -> npt.NDArray[Any] | None:
    """Decode the bytes of an image file with OpenCV; None if they are damaged.

    flags: Names of OpenCV's flags, such as ``"IMREAD_COLOR IMREAD_IGNORE_ORIENTATION"``.
    purpose: What needs OpenCV, for the error if it is not installed.
    """
    cv2 = library("cv2", purpose)
    if not chunks_fit(data):
        return None
    logs = cv2 if hasattr(cv2, "setLogLevel") else cv2.utils.logging  # OpenCV 4, which numpy 1.26 needs, and 5
    level = logs.getLogLevel()
    logs.setLogLevel(_SILENT)
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), sum(getattr(cv2, flag) for flag in flags.split()))
    except cv2.error:
        return None
    finally:
        logs.setLogLevel(level)
    return None if image is None else np.asarray(image)


def chunks_fit(data: bytes) -> bool:
    """Whether every chunk of a PNG ends inside the file (PNG, 5.3); true of everything else.

    OpenCV allocates as much memory as a chunk's length says: 4 GB for a file of 300 bytes.
    """
    if not data.startswith(PNG_SIGNATURE):
        return True
    at, kind = len(PNG_SIGNATURE), b""
    while kind != b"IEND":
        # a chunk is 4 bytes of length, 4 of type, its data, and 4 of CRC (PNG, 5.3): 12 and the length
        kind = data[at + 4 : at + 8]
        at += 12 + int.from_bytes(data[at : at + 4], "big")
        if at > len(data):
            return False
    return True


def png_size(data: bytes) -> tuple[int, int]:
    """(height, width) of IHDR (PNG, 11.2.2)."""
    return int.from_bytes(data[20:24], "big"), int.from_bytes(data[16:20], "big")


def jpeg_segments(data: bytes) -> Iterator[tuple[int, int]]:
    """Marker of each segment before the image data, and the offset of its parameters (ITU-T T.81, B.1.1.4)."""
    at = 2
    for _ in range(_MOST_MARKERS):
        if at + 14 > len(data) or data[at] != 0xFF:
            return
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        # libjpeg continues two bytes after such a marker; reading a length there would lead to another frame than libjpeg's
        if marker in _NO_SEGMENT or (marker != 0xFF and length < 2):
            return
        yield marker, at + 4
        # any number of fill bytes FF may precede a marker; the length includes its own two bytes
        at += 1 if marker == 0xFF else 2 + length


def jpeg_frame(marker: int, data: bytes, at: int) -> tuple[int, int, int, int] | None:
    """Height, width, bits and channels from a start-of-frame segment (ITU-T T.81, B.2.2); None for any other segment."""
    if not 0xC0 <= marker <= 0xCF or marker in _NO_FRAME:
        return None
    return int.from_bytes(data[at + 1 : at + 3], "big"), int.from_bytes(data[at + 3 : at + 5], "big"), data[at], data[at + 5]


class TiffDirectory:
    """The first image file directory of a TIFF (TIFF 6.0, section 2): numbers by tag.

    Raises SpecError, with `remedy` at its end, if the directory is too long, has a tag twice, or the file ends in it.
    """

    def __init__(self, data: bytes, remedy: str) -> None:
        self._data, self._remedy = data, remedy
        self._order: Literal["little", "big"] = "little" if data.startswith(b"II") else "big"
        # after the signature comes the offset of the first directory; a
        # directory has a count of entries of 12 bytes (tag, type, count, value)
        start = self._number(4, 4)
        count = self._number(start, 2)
        if count > _MOST_ENTRIES:
            raise SpecError(f"its header has {count} entries; {remedy}")
        # four bytes after the last entry: the offset of the next directory, 0 if there is none
        end = start + 2 + 12 * count
        self.several = any(data[end : end + 4])
        """Whether the file has a further directory."""
        self._entries = {self._number(at, 2): at for at in range(start + 2, end, 12)}
        # a tag occurs twice, of which libtiff takes the first
        if len(self._entries) < count:
            raise SpecError(f"its header has a tag twice; {remedy}")

    def value(self, tag: int, default: int = 0) -> int:
        """An integer, the first of several. Raises SpecError if the type is another one, which libtiff may read differently."""
        at = self._entries.get(tag)
        if at is None:
            return default
        size = _WHOLE_BYTES.get(kind := self._number(at + 2, 2))
        if size is None:
            raise SpecError(f"tag {tag} in its header is of type {kind}, no whole number; {self._remedy}")
        # values of up to four bytes are in the entry itself
        apart = self._number(at + 4, 4) * size > 4  # the entry then holds the values' offset
        return self._number(self._number(at + 8, 4) if apart else at + 8, size)

    def fraction(self, tag: int) -> int:
        """A RATIONAL, rounded to the nearest integer; 0 if the tag is missing."""
        if tag not in self._entries:
            return 0
        at = self._number(self._entries[tag] + 8, 4)
        over, under = self._number(at, 4), self._number(at + 4, 4)
        return round(over / under) if under else 0

    def _number(self, at: int, size: int) -> int:
        if at + size > len(self._data):
            raise SpecError(f"it ends in its header; {self._remedy}")
        return int.from_bytes(self._data[at : at + size], self._order)
