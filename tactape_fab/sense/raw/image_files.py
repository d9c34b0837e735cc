"""Depth maps as pictures: PNG of 16 bits, TIFF of 16 bits or float; colour images as PNG or JPEG.

Sizes are read before anything is unpacked.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import SpecError
from tactape_fab.base.input_file import read_regular
from tactape_fab.base.libraries import library
from tactape_fab.base.png_chunks import chunks_fit
from tactape_fab.sense.sensors import MOST_PX

PICTURES = (".png", ".tif", ".tiff")
COLOUR_PICTURES = (".png", ".jpg", ".jpeg")

_MOST_BYTES = 256 << 20
_PNG_HEADER = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR"
_MOST_TAGS = 200
_WIDTH, _HEIGHT, _BITS, _SAMPLES = 256, 257, 258, 277
_REMEDY = "write it with one channel of 16 bits"
_COLOUR_REMEDY = "give a PNG or JPEG with three channels of 8 bits"
_MOST_MARKERS = 1000
_NO_SIZE = {0xC4, 0xC8, 0xCC}
"""Of the JPEG markers C0 to CF those that start no frame (ITU-T T.81, table B.1)."""


def read_picture_header(path: Path) -> tuple[int, int]:
    """(height, width) of a picture that holds one frame.

    Raises SpecError when it is no such picture.
    Raises OSError when it cannot be opened.
    """
    return _checked_size(_bytes_of(path), path)


def read_picture(path: Path) -> npt.NDArray[Any]:
    """The frame of a picture, shape (height, width); raises as `read_picture_header`."""
    cv2 = library("cv2", "reading a picture")

    data = _bytes_of(path)
    shape = _checked_size(data, path)
    picture = _unpacked(data, cv2.IMREAD_UNCHANGED)
    if picture is None or picture.shape != shape or picture.dtype not in (np.uint16, np.float32):
        raise SpecError(f"it is damaged and cannot be unpacked; {_REMEDY}")
    return picture


def read_colour_header(path: Path) -> tuple[int, int]:
    """(height, width) of a colour image; raises as `read_picture_header`."""
    return _checked_colour_size(_bytes_of(path))


def read_colour(path: Path) -> npt.NDArray[np.uint8]:
    """A colour image, shape (height, width, 3), blue first, as it lies in the file; raises as `read_picture_header`."""
    return unpacked_colour(_bytes_of(path))


def unpacked_colour(data: bytes) -> npt.NDArray[np.uint8]:
    """The same of a file's bytes; raises as `read_picture_header`."""
    cv2 = library("cv2", "reading a picture")

    shape = _checked_colour_size(data)
    picture = _unpacked(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if picture is None or picture.shape != (*shape, 3) or picture.dtype != np.uint8:
        raise SpecError(f"it is damaged and cannot be unpacked; {_COLOUR_REMEDY}")
    return picture


def unpacked_grey(data: bytes) -> npt.NDArray[Any]:
    """A depth map of the bytes of a PNG: one channel of 8 or 16 bits, or three equal ones; raises as `read_picture_header`."""
    cv2 = library("cv2", "reading a picture")

    height, width, bits, channels = _png_header(data)
    if (channels, bits) not in ((1, 8), (1, 16), (3, 8)):
        raise SpecError(f"it has {channels} channel{'s' * (channels != 1)} of {bits} bits; {_REMEDY}")
    shape = _not_too_large(height, width)
    picture = _unpacked(data, cv2.IMREAD_UNCHANGED)
    if picture is None or picture.shape[:2] != shape:
        raise SpecError(f"it is damaged and cannot be unpacked; {_REMEDY}")
    if picture.ndim == 3 and (picture != picture[:, :, :1]).any():
        raise SpecError("it is a colour image; give --raw with --background and --weights")
    return picture if picture.ndim == 2 else np.ascontiguousarray(picture[:, :, 0])


_SILENT = 0
"""OpenCV's level at which nothing is written to stderr."""


def _unpacked(data: bytes, how: int) -> npt.NDArray[Any] | None:
    if not chunks_fit(data):
        return None
    cv2 = library("cv2", "reading a picture")

    logs = cv2 if hasattr(cv2, "setLogLevel") else cv2.utils.logging  # OpenCV 4, which numpy 1.26 needs, and 5
    level = logs.getLogLevel()
    logs.setLogLevel(_SILENT)
    try:
        picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), how)
    except cv2.error:
        return None
    finally:
        logs.setLogLevel(level)
    return None if picture is None else np.asarray(picture)


def _bytes_of(path: Path) -> bytes:
    data = read_regular(path, _MOST_BYTES)
    if len(data) > _MOST_BYTES:
        raise SpecError(f"it is larger than {_MOST_BYTES} bytes; {_REMEDY}")
    return data


def _checked_size(data: bytes, path: Path) -> tuple[int, int]:
    height, width, bits, channels = _png_header(data) if path.suffix.lower() == ".png" else _tiff_header(data)
    if channels != 1 or bits not in (16, 32):
        raise SpecError(f"it has {channels} channel{'s' * (channels != 1)} of {bits} bits; {_REMEDY}")
    return _not_too_large(height, width)


def _not_too_large(height: int, width: int) -> tuple[int, int]:
    if not (1 <= height <= MOST_PX and 1 <= width <= MOST_PX):
        raise SpecError(f"it has {width} x {height} px; give at most {MOST_PX} x {MOST_PX}")
    return height, width


def _checked_colour_size(data: bytes) -> tuple[int, int]:
    if data.startswith(b"\xff\xd8"):
        height, width, bits, channels = _jpeg_header(data)
    elif data.startswith(_PNG_HEADER):
        height, width, bits, channels = _png_header(data)
    else:
        raise SpecError(f"it is neither PNG nor JPEG; {_COLOUR_REMEDY}")
    if channels != 3 or bits != 8:
        raise SpecError(f"it has {channels} channel{'s' * (channels != 1)} of {bits} bits; {_COLOUR_REMEDY}")
    return _not_too_large(height, width)


def _png_header(data: bytes) -> tuple[int, int, int, int]:
    """Height, width, bits, channels (PNG, 11.2.2 IHDR)."""
    if not data.startswith(_PNG_HEADER) or len(data) < 33:
        raise SpecError(f"it is no PNG; {_REMEDY}")
    channels = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}.get(data[25], 0)
    return int.from_bytes(data[20:24], "big"), int.from_bytes(data[16:20], "big"), data[24], channels


def _jpeg_header(data: bytes) -> tuple[int, int, int, int]:
    """Height, width, bits, channels of the first frame (ITU-T T.81, B.2.2)."""
    at = 2
    for _ in range(_MOST_MARKERS):
        if at + 10 > len(data) or data[at] != 0xFF:
            break
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if 0xC0 <= marker <= 0xCF and marker not in _NO_SIZE:
            height, width = int.from_bytes(data[at + 5 : at + 7], "big"), int.from_bytes(data[at + 7 : at + 9], "big")
            return height, width, data[at + 4], data[at + 9]
        at += 1 if marker == 0xFF else 2 + length
    raise SpecError(f"it is a JPEG without a picture; {_COLOUR_REMEDY}")


def _tiff_header(data: bytes) -> tuple[int, int, int, int]:
    """Height, width, bits, channels of the first and only picture (TIFF 6.0, section 2)."""
    if data[:4] not in (b"II*\x00", b"MM\x00*"):
        raise SpecError(f"it is no TIFF; {_REMEDY}")

    order: Literal["little", "big"] = "little" if data.startswith(b"II") else "big"

    def number(at: int, size: int) -> int:
        if at + size > len(data):
            raise SpecError(f"it ends in its header; {_REMEDY}")
        return int.from_bytes(data[at : at + size], order)

    start = number(4, 4)
    count = number(start, 2)
    if count > _MOST_TAGS:
        raise SpecError(f"its header has {count} entries; {_REMEDY}")
    if number(start + 2 + 12 * count, 4) != 0:
        raise SpecError("it holds several pictures; give an .npz for many frames")
    values = {_SAMPLES: 1, _BITS: 1}
    for entry in range(start + 2, start + 2 + 12 * count, 12):
        values[number(entry, 2)] = number(entry + 8, 2 if number(entry + 2, 2) == 3 else 4)  # type 3: SHORT
    return values.get(_HEIGHT, 0), values.get(_WIDTH, 0), values[_BITS], values[_SAMPLES]
