"""Packed registry: the designs of many tapes in one file, which is read a hundred times as fast as their kits.

The file is the line `tactape-registry/1`; the SHA-256 of everything after it, as a line of 64 hexadecimal digits; the length of
the index, 8 bytes, little-endian; the index, JSON; and the symbols of all tapes, one byte each, row by row. In the index,
`designs` are manifests without the keys that differ from tape to tape, and `tapes` has one row of these keys per tape. The
symbols of a large file are memory-mapped.
"""

from __future__ import annotations

import json
import mmap
from collections.abc import Iterator, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base.errors import SpecError, reason_of, refuse
from tactape_fab.base.fields import Fields, shown_path
from tactape_fab.base.input_file import open_regular
from tactape_fab.base.json_text import parse_json
from tactape_fab.texture.board import TAG_IDS
from tactape_fab.texture.code import get_code
from tactape_fab.texture.frames import SymbolArray, symbols_to_rows
from tactape_fab.texture.manifest import PACKED_FIRST_LINE
from tactape_fab.texture.plane import MOST_POINTS
from tactape_fab.texture.tape import NAME_PATTERN, Tape

MOST_TAPES = 65_536
MOST_INDEX_BYTES = 64 * 1024 * 1024
MOST_BYTES = 4 * 1024**3
MOST_HELD_BYTES = 64 * 1024 * 1024
"""Largest file that is read into memory; larger ones are mapped. If a mapped file is overwritten in place, frames are compared
with symbols that were not checked, or, if it became shorter, SIGBUS ends the process.
"""
_HEADER = len(PACKED_FIRST_LINE) + 64 + 1
_OWN = ("name", "sector", "origin", "symbols", "symbols_sha256")
"""Keys of a manifest that differ from tape to tape, besides the tag's id."""


def pack(tapes: Sequence[Tape], fabs: Sequence[str]) -> bytes:
    """The bytes of a packed registry of tapes; `fabs` has the name of the fab profile of each.

    Raises SpecError if a tape has measured places: a packed registry holds designs only.
    """
    measured = [tape.name for tape in tapes if tape.as_built is not None]
    if measured:
        raise SpecError(
            f"{measured[0]} has measured places in as-built.json, and a packed registry holds designs only; move that file away"
        )
    designs: dict[str, int] = {}
    rows = []
    for tape, fab in zip(tapes, fabs, strict=True):
        content = tape.to_mapping()
        row = {key: content.pop(key) for key in _OWN if key in content and key != "symbols"}
        del content["symbols"]
        # the tag's id differs with the sector: left in, every tape would be a design of its own
        if tape.tag is not None:
            row["tag_id"], content["tag"]["id"] = tape.tag.id, 0
        # sorted keys, so that equal designs are equal texts
        rows.append({"design": designs.setdefault(json.dumps(content, sort_keys=True), len(designs)), **row, "fab": fab})
    # a dict keeps the order of insertion, which is that of the numbers in the rows
    index = json.dumps({"designs": [json.loads(text) for text in designs], "tapes": rows}, separators=(",", ":")).encode()
    rest = b"".join([len(index).to_bytes(8, "little"), index, *(tape.symbols.tobytes() for tape in tapes)])
    return PACKED_FIRST_LINE + sha256(rest).hexdigest().encode() + b"\n" + rest


def is_packed(path: Path) -> bool:
    """Whether a file begins with the first line of a packed registry."""
    try:
        with open_regular(path) as stream:
            return stream.read(len(PACKED_FIRST_LINE)) == PACKED_FIRST_LINE
    except (OSError, ValueError):
        return False


def read_packed(path: Path) -> Iterator[tuple[Tape, str]]:
    """The tapes of a packed registry, each with the name of its fab profile.

    Every value is checked as in a manifest, and symbols against the code. While its tapes are used, a file above
    `MOST_HELD_BYTES` may be replaced by renaming another, as `registry --pack` does, but must not be written to.

    Raises SpecError if it cannot be read, is damaged or too large, or has an invalid tape.
    """
    try:
        with open_regular(path) as stream:
            data: bytes | mmap.mmap = stream.read(MOST_HELD_BYTES + 1)
            if len(data) > MOST_HELD_BYTES:
                data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:
        raise _refused(path, reason_of(error)) from error
    begin = _HEADER + 8
    # the index's length is checked before the digest, and bounds the JSON text
    size = int.from_bytes(data[_HEADER:begin], "little")
    if len(data) > MOST_BYTES or size > min(MOST_INDEX_BYTES, len(data) - begin):
        raise _refused(path, "it is cut off, or too large")
    # a slice of the map itself would copy the file into memory
    with memoryview(data) as view:
        digest = sha256(view[_HEADER:]).hexdigest().encode() + b"\n"
    if data[len(PACKED_FIRST_LINE) : _HEADER] != digest:
        raise _refused(path, "its bytes are not those of its digest: it is damaged, or was changed")
    try:
        index = parse_json(data[begin : begin + size])
    except ValueError as error:
        raise _refused(path, str(error)) from error
    table = Fields(index if isinstance(index, dict) else {})
    designs, rows = table.rows("designs", longest=MOST_TAPES), table.rows("tapes", longest=MOST_TAPES)
    if table.problems or not rows:
        raise _refused(path, "it names no tapes" if not table.problems else table.problems[0].message)
    return _tapes(path, np.frombuffer(data, dtype=np.uint8), begin + size, designs, list(rows))


def _tapes(path: Path, data: SymbolArray, at: int, designs: Sequence[Any], rows: list[Any]) -> Iterator[tuple[Tape, str]]:
    """The tapes of an index, whose symbols begin at offset `at`; rows are released once they are read."""
    first: dict[int, Tape] = {}
    for number in range(len(rows)):
        row, rows[number] = rows[number], None  # its memory is free for the tapes
        table = Fields(row if isinstance(row, dict) else {}, f"tapes[{number}].")
        design, fab = table.integer("design", low=0, high=len(designs) - 1), table.text("fab", longest=200)
        content = designs[design] if not table.problems and isinstance(designs[design], dict) else {}
        of = Fields(content, f"designs[{design}].", table.problems)
        columns, high = (of.integer(key, low=1, high=MOST_POINTS) for key in ("columns", "rows"))
        points = columns * high
        if table.problems or points > MOST_POINTS or at + points > len(data):
            message = table.problems[0].message if table.problems else f"the symbols of {table.where[:-1]} are not all there"
            raise _refused(path, message)
        symbols = data[at : at + points].reshape(high, columns)
        at += points
        try:
            if design not in first:
                first[design] = tape = _first_of(content, row, symbols)
            else:
                tape = _another(first[design], table, symbols)
        except SpecError as error:
            raise _refused(path, f"{table.where[:-1]}: {error.problems[0].message}") from error
        yield tape, fab
    if at != len(data):
        raise _refused(path, "it holds more symbols than its tapes have")


def _first_of(content: dict[str, Any], row: dict[str, Any], symbols: SymbolArray) -> Tape:
    """A tape from its design and its row, as from a manifest."""
    # needed for the letters below; `Tape.from_mapping` refuses any number other than 4 and 8
    directions = 8 if content.get("directions") == 8 else 4
    if symbols.max() >= directions:
        raise SpecError(f"a symbol is {symbols.max()}, and there are {directions}")
    manifest = {**content, **{key: row[key] for key in _OWN if key in row}, "symbols": symbols_to_rows(symbols)}
    if isinstance(content.get("tag"), dict):
        manifest["tag"] = {**content["tag"], "id": row.get("tag_id")}
    return replace(Tape.from_mapping(manifest), symbols=symbols)


def _another(first: Tape, row: Fields, symbols: SymbolArray) -> Tape:
    """Another tape of the same design; only the keys in which it differs from the first one are checked."""
    code = get_code(first.code)
    name, sector = row.text("name", pattern=NAME_PATTERN), row.integer("sector", low=0, high=code.sectors - 1)
    column, line = row.integers("origin", 2, low=0, high=code.range - 1)
    tag = None if first.tag is None else replace(first.tag, id=row.integer("tag_id", low=0, high=TAG_IDS - 1))
    refuse(row.problems)
    if symbols.max() >= first.directions:
        raise SpecError(f"a symbol is {symbols.max()}, and there are {first.directions}")
    code.check_symbols(symbols, sector, (column, line), row)
    refuse(row.problems)
    return replace(first, name=name, sector=sector, origin=(column, line), symbols=symbols, tag=tag)


def _refused(path: Path, why: str) -> SpecError:
    return SpecError(f"{shown_path(path)} cannot be read as a packed registry: {why}; pack its kits again")
