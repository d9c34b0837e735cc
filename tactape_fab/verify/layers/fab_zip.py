"""Check of the zip for the fab: byte for byte a zip of the kit's checked files and nothing else.

Programs that open a zip use different parts of it: the central directory, the local headers, names in extra fields, file types in
attributes. So only the date and the compressed data may be arbitrary.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import named
from tactape_fab.kit.writer import FAB_ZIP_ROLES
from tactape_fab.verify.files import WrittenFile

# APPNOTE.TXT 6.3.10, sections 4.3.7, 4.3.12 and 4.3.16
_LOCAL = struct.Struct("<4s5H3I2H")
_ENTRY = struct.Struct("<4s6H3I5H2I")
_END = struct.Struct("<4s4H2IH")
_VERSION, _UNIX, _DEFLATED = 20, 3 << 8 | 20, 8
_MODE = 0o644 << 16


def check_zip(files: Mapping[str, WrittenFile], *, with_job: bool = True) -> Check:
    """Check that the zip holds exactly the fabrication files, in the writer's order and form."""
    roles = [role for role in FAB_ZIP_ROLES if role in files and (with_job or role != "job")]
    ordered = sorted((files[role] for role in roles), key=lambda file: file.path)
    expected = {file.path.rsplit("/", 1)[-1]: file.data for file in ordered}
    problems = list(zip_problems(files["fab-zip"].data, expected))
    if len(expected) < len(ordered):  # two folders have a file of the same name
        problems.append(f"{len(ordered)} files of the kit have {len(expected)} names in it")
    message = named(problems) if problems else f"{len(expected)} files, each as in the kit, nothing else"
    return Check(name="fab-zip", passed=not problems, message=message)


def zip_problems(data: bytes, expected: Mapping[str, bytes]) -> Iterator[str]:
    """Differences of a zip from that of `expected`, which maps names to contents in order; not necessarily all."""
    try:
        members, directory = _members(data, len(expected))
    except (struct.error, ValueError) as error:
        yield f"it cannot be opened: {error}"
        return
    names = [name for name, _, _ in members]
    yield from (f"{name} is missing from the zip" for name in expected if name not in names)
    yield from (f"{name} does not belong in the zip" for name in dict.fromkeys(names) if name not in expected)
    yield from (f"{name} is in the zip twice" for name in sorted(set(names)) if names.count(name) > 1)
    if sorted(names) != sorted(expected):
        return
    # besides the compressed bytes, only the date is taken from the zip, one for all members
    rebuilt, entries, date = b"", b"", members[0][2] if members else 0
    for name, packed, _ in members:
        content, raw = expected[name], name.encode("ascii")
        if _unpacked(packed, len(content)) != content:
            yield f"{name} in the zip differs from the kit's"
            return
        # fields that local header and directory entry share: method, time, date, CRC-32, compressed and uncompressed size
        fields = (_DEFLATED, date & 0xFFFF, date >> 16, zlib.crc32(content), len(packed), len(content))
        entries += _ENTRY.pack(b"PK\1\2", _UNIX, _VERSION, 0, *fields, len(raw), 0, 0, 0, 0, _MODE, len(rebuilt)) + raw
        rebuilt += _LOCAL.pack(b"PK\3\4", _VERSION, 0, *fields, len(raw), 0) + raw + packed
    # disk 0 of 0, entries of this disk and of all, size and offset of the directory, no comment
    end = _END.pack(b"PK\5\6", 0, 0, len(members), len(members), len(entries), len(rebuilt), 0)
    if names != list(expected):
        yield "its files stand in another order than the writer's"
    elif rebuilt + entries + end != data:
        where = "its directory" if data.startswith(rebuilt) and directory == len(rebuilt) else "it"
        yield f"{where} holds more, or says other things of its files, than the writer does"


def _members(data: bytes, count: int) -> tuple[list[tuple[str, bytes, int]], int]:
    """Name, compressed bytes and date of each member in the central directory, and the directory's offset.

    At most a few more than `count` are read, as a zip with more is not this tool's.
    """
    size = len(data)
    # a comment of up to 65,535 bytes may follow the end record, so the last signature within that range counts, as for readers
    start = data.rfind(b"PK\5\6", max(0, size - _END.size - 65_535))
    if start < 0:
        raise ValueError("its end is missing")
    *_, total, _, at, _ = _END.unpack_from(data, start)
    directory, members = at, []
    for _ in range(min(total, count + 5)):
        mark, _, _, _, method, time, day, _, packed, _, long, extra, comment, _, _, _, offset = _ENTRY.unpack_from(data, at)
        if mark != b"PK\1\2" or method != _DEFLATED:
            raise ValueError("its directory is broken, or a file is packed in a way that few programs open")
        name = data[at + _ENTRY.size : at + _ENTRY.size + long].decode("ascii", "backslashreplace")
        local = _LOCAL.unpack_from(data, offset)
        first = offset + _LOCAL.size + local[-2] + local[-1]
        if local[0] != b"PK\3\4" or first + packed > size:
            raise ValueError(f"{name} does not lie in it")
        members.append((name, data[first : first + packed], day << 16 | time))
        at += _ENTRY.size + long + extra + comment
    return members, directory


def _unpacked(packed: bytes, size: int) -> bytes | None:
    """The content of a deflated member; None if it is longer than `size`, damaged, or followed by more bytes."""
    inflater = zlib.decompressobj(-zlib.MAX_WBITS)
    try:
        # one more byte shows that it is too long, without decompressing all of it
        content = inflater.decompress(packed, size + 1)
    except zlib.error:
        return None
    return content if inflater.eof and not inflater.unused_data else None
