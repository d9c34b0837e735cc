"""Depth maps as pictures: PNG of 16 bits, TIFF of 16 bits or float; colour images as PNG or JPEG.

Sizes are read before anything is unpacked.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import SpecError, reason_of
from tactape_fab.base.fields import shown, shown_path
from tactape_fab.base.image_file import (
    AS_STORED,
    PNG_HEADER,
    TIFF_SIGNATURES,
    TiffDirectory,
    jpeg_frame,
    jpeg_segments,
    png_size,
    unpacked,
)
from tactape_fab.base.input_file import read_regular
from tactape_fab.base.libraries import library
from tactape_fab.sense.sensors import MOST_PX

PICTURES = (".png", ".tif", ".tiff")
COLOUR_PICTURES = (".png", ".jpg", ".jpeg")

_MOST_BYTES = 256 << 20
_WIDTH, _HEIGHT, _BITS, _SAMPLES, _FORMAT, _ORIENTATION = 256, 257, 258, 277, 339, 274
_NUMBERS = {(16, 2): "signed", (16, 3): "floating-point", (32, 1): "unsigned", (32, 2): "signed"}
"""Kinds of numbers by BitsPerSample and SampleFormat (TIFF 6.0, section 19) that are no depth maps here."""
_FILM_BEGIN = re.compile(rb"RIFF.{4}AVI |\x1aE\xdf\xa3|.{4}(ftyp|moov|mdat|wide|free|skip|pnot)", re.DOTALL)
"""How AVI, Matroska and the files of QuickTime and MP4 begin."""
_CODECS = re.compile("av0?1|avc[13]|divx|dx50|ffv1|fmp4|[hx]26[45]|hev[1c]|hvc1|jpeg|mjp[eg]|mp4v|mpeg|vp0?[89]0?|xvid")
"""FourCC of films that are read. FFmpeg has hundreds of decoders, and some write beyond their memory: HFYU of OpenCV 5.0.0."""
_MOST_BEGIN_BYTES, _MOST_FILM_PX = 12, 1 << 25
_PURPOSE = "reading a picture"
_REMEDY = "write it with one channel of 16 bits, or a .tif of floats of 32"
_COLOUR_REMEDY = "give a PNG or JPEG with three channels of 8 bits"


def read_picture_header(path: Path) -> tuple[int, int]:
    """(height, width) of a picture that holds one frame.

    Raises SpecError when it is no such picture.
    Raises OSError when it cannot be opened.
    """
    return _checked_size(_bytes_of(path), path)


def read_picture(path: Path) -> npt.NDArray[Any]:
    """The frame of a picture, shape (height, width); raises as `read_picture_header`."""
    data = _bytes_of(path)
    shape = _checked_size(data, path)
    picture = unpacked(data, "IMREAD_UNCHANGED", _PURPOSE)
    if picture is None or picture.shape != shape or picture.dtype not in (np.uint16, np.float32):
        raise SpecError(f"it is damaged and cannot be unpacked; {_REMEDY}")
    return picture


def read_colour_header(path: Path) -> tuple[int, int]:
    """(height, width) of a colour image; raises as `read_picture_header`."""
    return _checked_colour_size(_bytes_of(path, _COLOUR_REMEDY))


def read_colour(path: Path) -> npt.NDArray[np.uint8]:
    """A colour image, shape (height, width, 3), blue first, as it lies in the file; raises as `read_picture_header`."""
    return unpacked_colour(_bytes_of(path, _COLOUR_REMEDY))


def unpacked_colour(data: bytes) -> npt.NDArray[np.uint8]:
    """The same of a file's bytes; raises as `read_picture_header`."""
    shape = _checked_colour_size(data)
    picture = unpacked(data, AS_STORED, _PURPOSE)
    if picture is None or picture.shape != (*shape, 3) or picture.dtype != np.uint8:
        raise SpecError(f"it is damaged and cannot be unpacked; {_COLOUR_REMEDY}")
    return picture


def opened_film(path: Path) -> Any:
    """cv2.VideoCapture of a film whose images come as they lie in the file; it may not have opened.

    Raises SpecError when it is no film, or one that OpenCV cannot be given.
    """
    cv2 = library("cv2", "reading a film")
    film = f"film {shown_path(path)}"
    try:
        begin = read_regular(path, _MOST_BEGIN_BYTES)
    except OSError as error:
        raise SpecError(f"{film} cannot be opened: {reason_of(error)}; give another") from error
    # FFmpeg goes by the content alone, and reads lists that name other files: a FIFO for ever, themselves again and again
    if not _FILM_BEGIN.match(begin):
        raise SpecError(f"{film} is no .avi, .mkv, .mov or .mp4 by its first bytes; write it anew as one")
    # absolute, as FFmpeg takes what is before a colon for a protocol: 2026-11-28T10:30.mp4
    name = str(path.absolute())
    if name != name.encode(errors="replace").decode():
        raise SpecError(f"{film} has a path that is no UTF-8, at which OpenCV would end the process; rename it")
    capture = cv2.VideoCapture(name)
    width, height = capture.get(cv2.CAP_PROP_FRAME_WIDTH), capture.get(cv2.CAP_PROP_FRAME_HEIGHT)
    if width * height > _MOST_FILM_PX:  # FFmpeg unpacks images of 2^28 px, several at a time
        raise SpecError(f"{film} has {width:.0f} x {height:.0f} px, more than {_MOST_FILM_PX} in all; scale it down")
    codec = int(capture.get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF
    name = codec.to_bytes(4, "little").rstrip(b"\0").lower().decode("latin-1")
    if capture.isOpened() and capture.getBackendName() == "FFMPEG" and not _CODECS.fullmatch(name):
        raise SpecError(f"{film} is packed by {shown(name)}, not by a codec for cameras; write it anew as H.264, MJPEG or FFV1")
    # OpenCV turns images as the film's header says, and leaves those of PNG and JPEG, and so the background, as they are
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return capture


def unpacked_grey(data: bytes) -> npt.NDArray[Any]:
    """A depth map of the bytes of a file; raises as `read_picture_header`.

    A PNG of one channel of 8 or 16 bits or of three equal ones, or a TIFF, as LeRobot from 0.6 on writes depth.
    """
    tiff = data[:4] in TIFF_SIGNATURES
    height, width, bits, channels = _tiff_header(data) if tiff else _png_header(data)
    if (channels, bits) not in (((1, 16), (1, 32)) if tiff else ((1, 8), (1, 16), (3, 8))):
        raise SpecError(f"it has {channels} channel{'s' * (channels != 1)} of {bits} bits; {_REMEDY}")
    shape = _not_too_large(height, width)
    picture = unpacked(data, "IMREAD_UNCHANGED", _PURPOSE)
    if picture is None or picture.shape[:2] != shape:
        raise SpecError(f"it is damaged and cannot be unpacked; {_REMEDY}")
    if picture.ndim == 3 and (picture != picture[:, :, :1]).any():
        raise SpecError("it is a colour image, which decode reads after --raw, with --background and --weights")
    return picture if picture.ndim == 2 else np.ascontiguousarray(picture[:, :, 0])


def _bytes_of(path: Path, remedy: str = _REMEDY) -> bytes:
    data = read_regular(path, _MOST_BYTES)
    if len(data) > _MOST_BYTES:
        raise SpecError(f"it is larger than {_MOST_BYTES} bytes; {remedy}")
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
    elif data.startswith(PNG_HEADER):
        height, width, bits, channels = _png_header(data)
    else:
        raise SpecError(f"it is neither PNG nor JPEG; {_COLOUR_REMEDY}")
    if channels != 3 or bits != 8:
        raise SpecError(f"it has {channels} channel{'s' * (channels != 1)} of {bits} bits; {_COLOUR_REMEDY}")
    return _not_too_large(height, width)


def _png_header(data: bytes) -> tuple[int, int, int, int]:
    """Height, width, bits, channels (PNG, 11.2.2 IHDR)."""
    if not data.startswith(PNG_HEADER) or len(data) < 33:
        raise SpecError(f"it is no PNG; {_REMEDY}")
    channels = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}.get(data[25], 0)
    return *png_size(data), data[24], channels


def _jpeg_header(data: bytes) -> tuple[int, int, int, int]:
    """Height, width, bits, channels of the first frame."""
    for marker, at in jpeg_segments(data):
        if (frame := jpeg_frame(marker, data, at)) is not None:
            return frame
    raise SpecError(f"it is a JPEG without a picture; {_COLOUR_REMEDY}")


def _tiff_header(data: bytes) -> tuple[int, int, int, int]:
    """Height, width, bits, channels of the first and only picture."""
    if data[:4] not in TIFF_SIGNATURES:
        raise SpecError(f"it is no TIFF; {_REMEDY}")
    directory = TiffDirectory(data, _REMEDY)
    if directory.several:
        raise SpecError("it holds several pictures; give an .npz for many frames")
    # OpenCV turns and mirrors pictures by this tag, whatever its flags: a half turn would be one of the answer's angle
    if 2 <= (turn := directory.value(_ORIENTATION, 1)) <= 8:
        raise SpecError(f"it is to be turned or mirrored (tag Orientation = {turn}); write it without that tag")
    bits, channels = directory.value(_BITS, 1), directory.value(_SAMPLES, 1)
    if (kind := _NUMBERS.get((bits, directory.value(_FORMAT, 1)))) is not None:
        raise SpecError(f"it has {kind} numbers of {bits} bits; write unsigned ones of 16 bits, or floats of 32")
    return directory.value(_HEIGHT), directory.value(_WIDTH), bits, channels
