"""Files of scans: TIFF, PNG and JPEG. Size and resolution are read from the header, before any pixel is unpacked."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError, reason_of
from tactape_fab.base.fields import shown_path
from tactape_fab.base.image_file import (
    AS_STORED,
    PNG_SIGNATURE,
    TIFF_SIGNATURES,
    TiffDirectory,
    jpeg_frame,
    jpeg_segments,
    png_size,
    unpacked,
)
from tactape_fab.base.input_file import read_regular

Picture = npt.NDArray[np.uint8]
"""Shape (h, w, 3), blue first."""

MOST_PX = 250_000_000
"""A tape of 100 x 50 mm at 4800 dpi has 230 million; unpacked they take 0.75 GB."""
LONGEST_PX = 60_000
LEAST_PX = 64
MM_PER_INCH = 25.4
LEAST_QUALITY = 30
"""Of a JPEG, in libjpeg's scale; its edges move by more than a part's own scatter below."""

_MOST_BYTES = 1 << 30
_BLANK_BYTES, _MOST_PACKED = 64 << 20, 100
"""Unpacked bytes of three channels for a byte of the file, beyond the first: scans have grain, and pack to a fiftieth at most."""
_MOST_CHUNKS = 100
_REMEDY = "give a scan as TIFF, PNG or JPEG with 8 or 16 bits a channel"
_WIDTH, _HEIGHT, _BITS, _RESOLUTION, _UNIT = 256, 257, 258, 282, 296
"""Tags of a TIFF."""
_BIG_TIFF = (b"II+\x00", b"MM\x00+")
_NO_UNIT, _INCH, _CENTIMETRE = 1, 2, 3
_LUMINANCE_50 = (16, 11, 12, 14, 12, 10, 16, 14, 13, 14)
"""First entries of the luminance table at quality 50, in zigzag order (ITU-T T.81, table K.1); others are cut at 255."""
_READABLE_DPI = (50.0, 20_000.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanHeader:
    """The header of a scan: ``dpi`` and ``quality`` (of a JPEG) are None if it has none."""

    width_px: int
    height_px: int
    bits: int
    dpi: float | None = None
    quality: float | None = None


def read_header(data: bytes) -> ScanHeader:
    """The header of a picture. Raises SpecError if it is no picture, or too large to be unpacked."""
    if data.startswith(PNG_SIGNATURE):
        header = _png(data)
    elif data.startswith(b"\xff\xd8"):
        header = _jpeg(data)
    elif data[:4] in TIFF_SIGNATURES:
        header = _tiff(data)
    else:
        kind = "a BigTIFF" if data[:4] in _BIG_TIFF else "no TIFF, PNG or JPEG"
        raise SpecError(f"it is {kind}; {_REMEDY}")
    width, height = header.width_px, header.height_px
    if width < LEAST_PX or height < LEAST_PX:
        raise SpecError(f"it has {width} x {height} px; give a scan of 600 to 4800 dpi")
    if width > LONGEST_PX or height > LONGEST_PX or width * height > MOST_PX:
        limit = f"{MOST_PX // 1_000_000} million px, {LONGEST_PX} px a side"
        raise SpecError(f"it has {width} x {height} px, more than {limit}; scan at fewer dpi, or in several overlapping images")
    if 3 * width * height > _BLANK_BYTES + _MOST_PACKED * len(data):
        message = f"it has {width} x {height} px in {len(data)} bytes, so it shows next to nothing, and would fill the memory"
        raise SpecError(f"{message}; scan the tape, not a blank")
    if header.bits not in (8, 16):
        raise SpecError(f"it has {header.bits} bits a channel; {_REMEDY}")
    if header.quality is not None and header.quality < LEAST_QUALITY:
        raise SpecError(
            f"it is a JPEG of quality {header.quality:.0f}, below {LEAST_QUALITY}: its blocks move edges; scan to TIFF or PNG"
        )
    return header


def read_scan(path: str | Path) -> tuple[Picture, ScanHeader]:
    """A scan and its header; see `read_header`. Raises SpecError that names the file and says why it is no scan."""
    path = Path(path)
    try:
        data = read_regular(path, _MOST_BYTES)
        if len(data) > _MOST_BYTES:
            raise SpecError(f"it is larger than {_MOST_BYTES} bytes; scan at fewer dpi, or in several overlapping images")
        header = read_header(data)
        return _unpacked(data, header), header
    except OSError as error:
        raise SpecError(Problem("scan", f"SCAN = {shown_path(path)} cannot be read: {reason_of(error)}; {_REMEDY}")) from error
    except ValueError as error:
        if isinstance(error, SpecError):
            raise SpecError([Problem("scan", f"{shown_path(path)}: {p.message}") for p in error.problems]) from None
        raise SpecError(Problem("scan", f"{shown_path(path)!r} is no path of a file; {_REMEDY}")) from error
    except MemoryError:
        raise SpecError(Problem("scan", f"{shown_path(path)} does not fit into memory; scan at fewer dpi")) from None


def _unpacked(data: bytes, header: ScanHeader) -> Picture:
    picture = unpacked(data, AS_STORED, "reading a scan")
    # of a TIFF that says it lies on its side, OpenCV swaps both whatever it is asked for; a scan may lie at any turn
    shapes = [(header.height_px, header.width_px, 3), (header.width_px, header.height_px, 3)]
    if picture is None or picture.shape not in shapes or picture.dtype != np.uint8:
        raise SpecError(f"it is damaged and cannot be unpacked; {_REMEDY}")
    return picture


def _plausible(dpi: float) -> float | None:
    return dpi if isfinite(dpi) and _READABLE_DPI[0] <= dpi <= _READABLE_DPI[1] else None


def _png(data: bytes) -> ScanHeader:
    """IHDR and pHYs (PNG, 11.2.2 and 11.3.5.3)."""
    if len(data) < 33 or data[12:16] != b"IHDR":
        raise SpecError(f"it ends in its header; {_REMEDY}")
    dpi = None
    at = 33
    # a chunk is its length, type, data, and a CRC of four bytes
    for _ in range(_MOST_CHUNKS):
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        if kind in (b"IDAT", b"") or at >= len(data):
            break
        # pixels per unit along x, along y, and the unit, 1 for the metre
        if kind == b"pHYs" and data[at + 16 : at + 17] == b"\x01":
            dpi = _plausible(int.from_bytes(data[at + 8 : at + 12], "big") * MM_PER_INCH / 1000)
        at += length + 12
    height, width = png_size(data)
    return ScanHeader(width_px=width, height_px=height, bits=8 if data[25] == 3 else data[24], dpi=dpi)


def _jpeg(data: bytes) -> ScanHeader:
    """The first frame, JFIF's density and the luminance table (ITU-T T.81, B.2)."""
    dpi, quality = None, None
    for marker, at in jpeg_segments(data):
        if marker == 0xE0 and data[at : at + 5] == b"JFIF\x00" and data[at + 7] in (1, 2):
            density = int.from_bytes(data[at + 8 : at + 10], "big")
            dpi = _plausible(density * (2.54 if data[at + 7] == 2 else 1.0))  # 2: per centimetre
        if marker == 0xDB and data[at] & 0x0F == 0 and quality is None:
            quality = _quality(data[at + 1 : at + 65], wide=data[at] >> 4 == 1)
        if (frame := jpeg_frame(marker, data, at)) is not None:
            height, width, bits, _ = frame
            return ScanHeader(width_px=width, height_px=height, bits=bits, dpi=dpi, quality=quality)
    raise SpecError(f"it is a JPEG without a picture; {_REMEDY}")


def _quality(table: bytes, *, wide: bool) -> float | None:
    """Quality as libjpeg counts it, from the luminance table: 50 is the standard's own table, 100 has ones alone."""
    if wide or len(table) < 64:
        return None
    ratio = sum(table[: len(_LUMINANCE_50)]) / sum(_LUMINANCE_50)
    # libjpeg scales its table by 50 / Q below 50, and by 2 - Q / 50 above (jpeg_quality_scaling, in per cent)
    return 100 - 50 * ratio if ratio < 1 else 50 / ratio


def _tiff(data: bytes) -> ScanHeader:
    """The first picture (TIFF 6.0, section 2)."""
    directory = TiffDirectory(data, _REMEDY)
    unit = directory.value(_UNIT, _INCH)
    dpi = float(directory.fraction(_RESOLUTION)) * (2.54 if unit == _CENTIMETRE else 1.0)
    return ScanHeader(
        width_px=directory.value(_WIDTH),
        height_px=directory.value(_HEIGHT),
        bits=directory.value(_BITS, 1),
        dpi=None if unit == _NO_UNIT else _plausible(dpi),
    )
