"""PNG files written without the library that reads them."""

from __future__ import annotations

import struct
import zlib


def png_chunk(kind: bytes, data: bytes) -> bytes:
    """Length, kind, data and checksum."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_of(width: int, height: int, packed: bytes, *, bits: int = 8, more: bytes = b"") -> bytes:
    """A grey PNG of rows that zlib packed, each behind its filter's byte; `more` are chunks before them."""
    header = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + more + png_chunk(b"IDAT", packed) + png_chunk(b"IEND", b"")


def black_png(width: int, height: int, bits: int = 8) -> bytes:
    """A PNG of so many black pixels, in a few hundred kilobytes at most."""
    packer, row = zlib.compressobj(9), bytes(1 + (width * bits + 7) // 8)
    packed = b"".join([*(packer.compress(row) for _ in range(height)), packer.flush()])
    return png_of(width, height, packed, bits=bits)
