"""Images of MCAP files and of rosbag2 folders of them, read by mcap; chunks are unpacked within a bound."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from tactape_fab.base.errors import SpecError
from tactape_fab.base.fields import shown, shown_path
from tactape_fab.base.input_file import open_regular, read_regular
from tactape_fab.base.libraries import library
from tactape_fab.sense.files.depth_maps import scale_of
from tactape_fab.sense.files.image_message import IMAGE_TYPE, colour_of, depth_of, image_of
from tactape_fab.sense.files.recording_kinds import (
    BAG,
    MCAP,
    MOST_TIMES_PACKED,
    MOST_UNPACKED_BYTES,
    OTHER_BAGS,
    SCALE,
    UPRIGHT,
    Opened,
    Stamped,
    some_of,
)
from tactape_fab.sense.raw.colour_images import by_number

MOST_CHUNK_BYTES = 1 << 28
_MOST_CHANNELS = 10_000
_MOST_RECORDS, _BYTES_OF_RECORD = 250_000, 8
"""Limit of the records in a file's packed chunks: the first, plus one per so many bytes of the file. The shortest message takes
31 bytes unpacked."""
_RECORD_BEGIN = 9
"""Bytes before the content of a record: its kind, and its length in eight bytes, the lowest first (MCAP 0, "Records")."""
_LIST = re.compile(r"^ *relative_file_paths: *\n((?: *-[^\n]+(?:\n|$))+)", re.MULTILINE)
"""List of a bag's files in its metadata.yaml, a name a line, as rosbag2 and rosbags write it."""
_PACKED_ALONE = re.compile(r"^ *compression_mode: *[\"']?message\b", re.MULTILINE | re.IGNORECASE)
_MOST_LIST_BYTES = 1 << 24
_ZSTD = ".zstd"
"""Ending that rosbag2 gives to a file that it packed as a whole."""
_OURS = "tactape-fab "
"""Begin of one of the programs in a file's header: mcap's own tools put themselves before what was there ("mcap go #v1; ...")."""


def open_bag(path: Path, topic: str | None, colour: bool) -> Opened:
    """Topic, whether `watch` wrote it, the scale of its file, and what reads it.

    Raises SpecError when no topic, or more than one, has images.
    Raises Exception: whatever mcap raises for a damaged file.
    """
    files = [path]
    if path.suffix.lower() != MCAP:
        files = _files_of(path)
    topics, scales, ours = dict[str, bool](), dict[str, set[str | None]](), True
    for file in files:
        for kind, record in _records(file):
            if kind == "Header":
                ours = ours and any(name.strip().startswith(_OURS) for name in record.library.split(";"))
            elif kind == IMAGE_TYPE:
                topics[record[0]] = topics.get(record[0], True) and UPRIGHT in record[2].items()
                scales.setdefault(record[0], set()).add(record[2].get(SCALE))
    if not topics:
        raise SpecError(f"it has no topic of {IMAGE_TYPE}; record the images themselves, which CompressedImage is not")
    if topic is None and len(topics) == 1:
        topic = next(iter(topics))
    if topic not in topics:
        there = some_of(topics)
        message = (
            f"--topic {shown(topic)} is no topic of images in it" if topic else "of which topic its images are has to be said"
        )
        raise SpecError(f"{message}; give --topic NAME, one of: {there}")
    ours = ours or topics[topic]
    scale, *others = scales[topic] if ours else {None}
    if others:
        raise SpecError(f"images of {topic} are of several {SCALE}; give the files from which watch wrote it")
    known = None if scale is None else scale_of(np.array(scale.split(), dtype=np.float64))
    return topic, ours, known, partial(_images, files, topic, colour, ours)


def _files_of(path: Path) -> list[Path]:
    """The MCAP files of a bag, in the order of its metadata's list, as rosbag2 plays them.

    Raises SpecError when one of the list is not there, or one is there that is not in the list: a recording would have a gap, or
    frames of another one.
    """
    bag = path if path.suffix.lower() != OTHER_BAGS[0] else path.absolute().parent
    words = f"--src {quote(shown_path(bag))} --dst {quote(f'{shown_path(bag)}-mcap')} --dst-storage mcap"
    convert = f"with pip install rosbags, rosbags-convert {words} makes one"
    files = sorted(path.glob(f"*{MCAP}"), key=lambda file: by_number(file.name))
    listed: list[str] = []
    if (path / BAG).is_file():  # a folder that is only named as a bag has no list
        text = read_regular(path / BAG, _MOST_LIST_BYTES).decode(errors="replace").replace("\r", "")
        if files and _PACKED_ALONE.search(text):
            raise SpecError(f"each message in it is packed by itself, which no {MCAP} file that can be read has; {convert}")
        found = _LIST.search(text)
        lines = [] if found is None else found[1].splitlines()
        # rosbag2 before version 4 of the list put the folder before each name
        listed = [Path(line.strip().removeprefix("-").strip().strip("\"'")).name.removesuffix(_ZSTD) for line in lines]
    ours = bool(listed) and all(name.lower().endswith(MCAP) for name in listed)
    if not files and (not ours or any(path.glob(f"*{MCAP}{_ZSTD}"))):
        raise SpecError(f"it is a bag without an {MCAP} file; {convert}")
    if not ours:
        return files
    there = {file.name: file for file in files}
    gone, more = [name for name in listed if name not in there], [name for name in there if name not in listed]
    if gone:
        raise SpecError(f"its {BAG} lists {some_of(gone)}, not there (unpacked); copy all of the bag, or give its {MCAP} files")
    if more:
        raise SpecError(f"its {BAG} does not list {some_of(more)}; move that away, or give the {MCAP} files that you mean")
    return [there[name] for name in listed]


def _images(files: Sequence[Path], topic: str, colour: bool, ours: bool) -> Iterator[Stamped]:
    """Capture times and images of a topic, in the order of the files; a time of 0 is one that nobody set, but in our own."""
    for file in files:
        for kind, record in _records(file):
            if kind == IMAGE_TYPE and record[0] == topic:
                image = image_of(record[1])
                stamp = image.stamp_ns / 10**9 if image.stamp_ns or ours else None
                yield stamp, colour_of(image) if colour else depth_of(image)


def _records(file: Path) -> Iterator[tuple[str, Any]]:
    """The header, and each message as its type with (topic, bytes, metadata of its channel)."""
    reading = library("mcap.stream_reader", "reading an MCAP file")
    schemas, channels = dict[int, str](), dict[int, tuple[str, str, dict[str, str]]]()
    with open_regular(file) as stream:
        reader = reading.StreamReader(stream, emit_chunks=True, validate_crcs=True, record_size_limit=MOST_CHUNK_BYTES)
        left = _Budget(os.fstat(stream.fileno()).st_size)
        for outer in reader.records:
            chunk = left.taken(_unpacked(outer)) if type(outer).__name__ == "Chunk" else None
            for record in [outer] if chunk is None else reading.breakup_chunk(chunk, validate_crc=True):
                kind = type(record).__name__
                if kind == "Header":
                    yield kind, record
                elif kind == "Schema":
                    schemas[record.id] = record.name
                elif kind == "Channel":
                    channels[record.id] = (schemas.get(record.schema_id, ""), record.topic, record.metadata)
                elif kind == "Message" and record.channel_id in channels:
                    of_type, topic, metadata = channels[record.channel_id]
                    yield of_type, (topic, record.data, metadata)
                if len(schemas) + len(channels) > _MOST_CHANNELS:
                    raise SpecError(f"{shown_path(file)} has more than {_MOST_CHANNELS} topics")


class _Budget:
    """Budget of what the packed chunks of a file unpack to: 20 kB of zstd unpack to eight million records."""

    def __init__(self, size: int) -> None:
        self._bytes = MOST_UNPACKED_BYTES + MOST_TIMES_PACKED * size
        self._records = _MOST_RECORDS + size // _BYTES_OF_RECORD

    def taken(self, chunk: Any) -> Any:
        """An unpacked chunk, when it is within the budget. Raises SpecError."""
        data: bytes = chunk.data
        self._bytes -= len(data)
        at = 0
        # counted before mcap makes an object of each
        while at < len(data) and self._records >= 0:
            at += _RECORD_BEGIN + int.from_bytes(data[at + 1 : at + _RECORD_BEGIN], "little")
            self._records -= 1
        if self._bytes < 0 or self._records < 0:
            what = "bytes" if self._bytes < 0 else "records"
            raise SpecError(f"its chunks unpack to far more {what} than a recording of its size has")
        return chunk


def _unpacked(chunk: Any) -> Any:
    """The chunk with its data unpacked within a limit: mcap itself unpacks to whatever size the packed data state."""
    if chunk.compression == "zstd":
        # one byte more than is allowed tells that there is more, without unpacking it
        unpacker = library("zstandard", "reading a compressed MCAP file").ZstdDecompressor().stream_reader(chunk.data)
        chunk.data = unpacker.read(MOST_CHUNK_BYTES + 1)
    elif chunk.compression == "lz4":
        chunk.data = (
            library("lz4.frame", "reading a compressed MCAP file")
            .LZ4FrameDecompressor()
            .decompress(chunk.data, max_length=MOST_CHUNK_BYTES + 1)
        )
    elif chunk.compression:
        raise SpecError(f"its chunks are packed by {shown(chunk.compression)}; mcap compress makes them zstd")
    if len(chunk.data) > MOST_CHUNK_BYTES:
        raise SpecError(f"a chunk in it unpacks to more than {MOST_CHUNK_BYTES} bytes")
    if len(chunk.data) != chunk.uncompressed_size:  # of a writer that has no checksums it is all that tells
        raise ValueError(f"a chunk in it holds {len(chunk.data)} of {chunk.uncompressed_size} bytes")
    chunk.compression = ""
    return chunk
