"""Changes of bytes that parsers trip over: numbers, brackets, lengths, repeated, missing and exchanged pieces."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from random import Random

MOST_BYTES = 1 << 20
"""Larger ones are cut: what a megabyte costs is what is asked."""
NUMBERS = (
    *(b"0", b"-0", b"1", b"-1", b"0.5", b"1e-7", b"1e9", b"1e300", b"-1e300", b"1e999", b"nan", b"NaN", b"inf", b"Infinity"),
    *(b"2147483648", b"-2147483649", b"9" * 20, b"9" * 400, b"18446744073709551616", b"0x10", b"1_0", b"", b"true", b"null"),
)
TOKENS = (
    *(b"[", b"{", b'"', b"'", b"(", b"<", b"%", b"*", b"\n", b"\r", b"\0", b",", b";", b"=", b"\xff", b"\\", b"/"),
    *(b"\xef\xbb\xbf", b"[]", b"{}", b"<!DOCTYPE a>", b"../", b"\xe2\x80\xae", b"\x1b[2J", b"\xd9\xa0"),
    *(b"[[tapes]]\n", b"\x93NUMPY", b"PK\5\6"),
)
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def mutated(data: bytes, chance: Random, others: tuple[bytes, ...] = ()) -> bytes:
    """One to some changes of a file, inside the members of a zip half of the time."""
    if data.startswith(b"PK\3\4") and chance.random() < 0.6:
        return _in_zip(data, chance)
    for _ in range(1 + int(chance.expovariate(0.7))):
        data = _changed(data, chance, others)[:MOST_BYTES]
    if data.startswith(b"\x89PNG") and chance.random() < 0.7:
        data = _summed(data)
    return data


def _changed(data: bytes, chance: Random, others: tuple[bytes, ...]) -> bytes:
    at, end = sorted((chance.randrange(len(data) + 1), chance.randrange(len(data) + 1)))
    near = min(end, at + chance.randrange(1, 64))
    match chance.randrange(11):
        case 0 if data:
            at = min(at, len(data) - 1)
            return data[:at] + bytes([data[at] ^ 1 << chance.randrange(8)]) + data[at + 1 :]
        case 1:
            return data[:at] + data[near:]
        case 2:
            return data[:at] + data[end:]
        case 3:
            return data[:near] + data[at:near] * chance.choice((1, 2, 50, 5000)) + data[near:]
        case 4:
            return data[:at] + chance.choice(TOKENS) * chance.choice((1, 1, 2, 5000)) + data[at:]
        case 5 | 6 | 7 if found := list(_NUMBER.finditer(data, at, min(len(data), at + 4000))):
            number = chance.choice(found)
            return data[: number.start()] + chance.choice(NUMBERS) + data[number.end() :]
        case 8:
            form = chance.choice(("<H", ">H", "<I", ">I"))
            size = struct.calcsize(form)
            value = chance.choice((0, 1, 0x7FFF, 0xFFFF)) if size == 2 else chance.choice((0, 1, 1 << 20, 0x7FFFFFFF, 0xFFFFFFFF))
            return data[:at] + struct.pack(form, value) + data[at + size :]
        case 9 if others:
            other = chance.choice(others)
            start = chance.randrange(len(other) + 1)
            return data[:at] + other[start : start + near - at + 1] + data[near:]
    return data[:end]


def _in_zip(data: bytes, chance: Random) -> bytes:
    """The same with members that are changed, and packed again."""
    stream = io.BytesIO()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as new:
            names = old.namelist()
            chosen = chance.choice(names)
            for name in names:
                content = old.read(name)
                content = mutated(content, chance) if name == chosen else content
                new.writestr(name + ("\n" if name == chosen and chance.random() < 0.05 else ""), content)
    except Exception:  # no zip any more
        return data[: chance.randrange(len(data) + 1)]
    return stream.getvalue()


def _summed(png: bytes) -> bytes:
    """A PNG with right check sums, so that what is changed is looked at."""
    out, at = png[:8], 8
    while at + 12 <= len(png):
        size = int.from_bytes(png[at : at + 4], "big")
        if at + 12 + size > len(png):
            break
        body = png[at + 4 : at + 8 + size]
        out += png[at : at + 4] + body + struct.pack(">I", zlib.crc32(body))
        at += 12 + size
    return out + png[at:]
