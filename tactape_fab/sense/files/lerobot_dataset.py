"""Images of a LeRobot dataset (formats 2 and 3): in its parquet files by pyarrow, in its films by OpenCV."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base.errors import SpecError
from tactape_fab.base.fields import Fields, shown
from tactape_fab.base.input_file import open_regular, read_regular
from tactape_fab.base.json_text import parse_json
from tactape_fab.base.libraries import library
from tactape_fab.sense.files.recording_kinds import (
    DATASET,
    MOST_TIMES_PACKED,
    MOST_UNPACKED_BYTES,
    Opened,
    Stamped,
    some_of,
)
from tactape_fab.sense.raw.colour_images import by_number
from tactape_fab.sense.raw.image_files import opened_film, unpacked_colour, unpacked_grey
from tactape_fab.sense.sensors import MOST_PX

_MOST_INFO_BYTES, _MOST_IMAGE_BYTES, _MOST_GROUP_BYTES, _MOST_FILES = 1 << 24, 1 << 28, 1 << 32, 100_000
_BLANK_BYTES, _MOST_PACKED = 1 << 28, 100
"""Unpacked bytes of a group of rows for a byte of its file, beyond the first: pyarrow takes five times as much memory."""
_THRIFT = {"thrift_string_size_limit": 1 << 27, "thrift_container_size_limit": 1 << 22}
_ROWS, _VALUES = 8, 1 << 22
"""Rows that are read at once, and values of arrays in them: equal ones take no room in a file, however many they are."""
_TIMES_UNPACKED, _ROOM_BYTES = 6, 1 << 30
"""Memory limit while rows of a group are read: so many times their stated unpacked size, plus so many bytes."""
_TABLES = "data/**/*.parquet"
_UNSURE = "than its tables have rows, so that no image's time is sure; record it again, or leave out that episode"
_AS_IMAGES = "with use_videos=False (lerobot-record --dataset.video=false, from LeRobot 0.6 on)"
_FLOATS = ("float32", "float64", "uint16", "int16")


def open_dataset(folder: Path, topic: str | None, colour: bool) -> Opened:
    """Feature, False, and what reads it.

    Raises SpecError when it is no dataset, and when no feature, or more than one, has images.
    Raises Exception: whatever pyarrow raises for a damaged file.
    """
    data = read_regular(folder / DATASET, _MOST_INFO_BYTES)
    content = parse_json(data)
    if not isinstance(content, dict):
        raise SpecError(f"its {DATASET} is no JSON object")
    table = Fields(content)
    features = {name: value for name, value in table.table("features").values.items() if isinstance(value, dict)}
    if table.problems:
        raise SpecError(f"its {DATASET} names no features")
    usable = {name: value for name, value in features.items() if _shows(value, colour)}
    if not usable:
        lack = "images or films" if colour else f"images or arrays of depth (films lose depth); record it {_AS_IMAGES}"
        raise SpecError(f"it has no feature of {lack}")
    if topic is None and len(usable) == 1:
        topic = next(iter(usable))
    if topic not in usable:
        message = (
            f"--topic {shown(topic)} is no feature of it with such images"
            if topic
            else "of which feature its images are has to be said"
        )
        kinds = "images or films" if colour else "images (films lose depth) or arrays"
        raise SpecError(f"{message}; give --topic NAME, one of {kinds}: {some_of(usable)}")
    if features[topic]["dtype"] == "video":
        return topic, False, None, partial(_filmed, folder, topic)
    return topic, False, None, partial(_rows, folder, topic, features[topic], colour)


def _shows(feature: dict[str, Any], colour: bool) -> bool:
    """Whether a feature is of images of this kind."""
    kind, shape = feature.get("dtype"), feature.get("shape")
    sides = shape[:2] if isinstance(shape, list) and shape[2:] in ([], [1]) else []
    plane = len(sides) == 2 and all(isinstance(n, int) and 2 <= n <= MOST_PX for n in sides)
    return kind == "image" or (kind == "video" and colour) or (kind in _FLOATS and plane and not colour)


def _files(folder: Path, pattern: str) -> list[Path]:
    found = sorted(folder.glob(pattern), key=lambda path: by_number(path.as_posix()))
    if not 0 < len(found) <= _MOST_FILES:
        raise SpecError(f"it holds {len(found)} files {pattern}, not 1 to {_MOST_FILES}")
    return found


def _batches(folder: Path, columns: list[str], rows: int = _ROWS) -> Iterator[Any]:
    """Rows of the dataset's tables, `rows` at a time."""
    parquet = library("pyarrow.parquet", "reading a LeRobot dataset")
    for path in _files(folder, _TABLES):
        with open_regular(path) as stream:
            # no thread of pyarrow: one that finds no memory ends the process, and the stack of each counts as memory
            file = parquet.ParquetFile(stream, pre_buffer=False, **_THRIFT)
            most = min(_MOST_GROUP_BYTES, _BLANK_BYTES + _MOST_PACKED * os.fstat(stream.fileno()).st_size)
            for group in range(file.metadata.num_row_groups):
                # no .column(k): a wrong size there is thrown through Cython, which ends the process (pyarrow 26.0.1)
                if file.metadata.row_group(group).total_byte_size > most:
                    raise SpecError(f"rows of {path.name} unpack to more than {most} bytes at once; write smaller groups")
            if file.schema_arrow.field("timestamp").type.num_fields:
                raise SpecError(f"timestamps in {path.name} are no numbers; write one for each row")
            batches = file.iter_batches(batch_size=rows, columns=columns, use_threads=False)
            while True:
                with _within(_TIMES_UNPACKED * most + _ROOM_BYTES, path):
                    batch = next(batches, None)
                if batch is None:
                    break
                yield batch


@contextmanager
def _within(most_bytes: int, path: Path) -> Iterator[None]:
    """Bound the memory that this process may allocate on top of its present use; on Linux only.

    A list of a thousand million equal values takes no room in a file, counts nothing in its sizes, and pyarrow unpacks it.
    Raises SpecError where it does not suffice.
    """
    if sys.platform != "linux":
        yield
        return
    import resource

    taken_bytes = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    bound = taken_bytes + most_bytes
    resource.setrlimit(resource.RLIMIT_AS, (bound if soft == resource.RLIM_INFINITY else min(soft, bound), hard))
    try:
        yield
    except MemoryError as error:
        raise SpecError(f"a row of {path.name} unpacks to far more than its file has; write it again") from error
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _rows(folder: Path, topic: str, feature: dict[str, Any], colour: bool) -> Iterator[Stamped]:
    arrays = feature["dtype"] != "image"
    rows = min(max(_VALUES // (feature["shape"][0] * feature["shape"][1]), 1), _ROWS) if arrays else _ROWS
    # equal rows take no room either: a million images from 150 kB
    left = MOST_UNPACKED_BYTES + MOST_TIMES_PACKED * sum(path.stat().st_size for path in _files(folder, _TABLES))
    for batch in _batches(folder, [topic, "timestamp"], rows):
        stamps = [float(value.as_py()) for value in batch.column("timestamp")]
        images = batch.column(topic)
        if arrays:
            found = iter(_arrays(images, len(stamps), feature["shape"][:2]))
        else:
            found = (_picture(value.as_py(), folder, colour) for value in images)
        for stamp, image in zip(stamps, found, strict=True):
            left -= image.nbytes
            if left < 0:
                raise SpecError(
                    "its images unpack to far more bytes than a dataset of its size has; write fewer of them that are equal"
                )
            yield stamp, image


def _picture(value: Any, folder: Path, colour: bool) -> Any:
    """An image of a row: its file's bytes, or the name of a file in the dataset."""
    data = value.get("bytes") if isinstance(value, dict) else None
    if data is None:
        raise SpecError("an image is not in the table, but beside it; write the dataset with its images in it, as LeRobot does")
    if len(data) > _MOST_IMAGE_BYTES:
        raise SpecError(f"an image has {len(data)} bytes, more than {_MOST_IMAGE_BYTES}")
    return unpacked_colour(data) if colour else unpacked_grey(data)


def _arrays(column: Any, count: int, shape: list[int]) -> Any:
    """Arrays of a column, whose lists may be nested, and whose type may be an extension of datasets."""
    values = getattr(column, "storage", column)
    while hasattr(values, "flatten") and str(values.type).startswith(("list", "large_list", "fixed_size_list")):
        values = values.flatten()
    flat = values.to_numpy(zero_copy_only=False)
    if flat.size != count * shape[0] * shape[1]:
        raise SpecError(f"{flat.size} values are no {count} arrays of {shape[0]} x {shape[1]}")
    return np.asarray(flat).reshape(count, *shape)


def _filmed(folder: Path, topic: str) -> Iterator[Stamped]:
    """Images of a feature's films, with the timestamps of the tables."""
    stamps = (float(value.as_py()) for batch in _batches(folder, ["timestamp"]) for value in batch.column("timestamp"))
    for path in _films(folder, topic):
        capture = opened_film(path)
        try:
            there, image = capture.read()
            if not there:  # of AV1, LeRobot's usual codec, OpenCV reads the container and not one image
                raise SpecError(f"{path.name} cannot be unpacked by this OpenCV; write the dataset {_AS_IMAGES}")
            while there:
                stamp = next(stamps, None)
                if stamp is None:
                    raise SpecError(f"its films have more images {_UNSURE}")
                yield stamp, image
                there, image = capture.read()
        finally:
            capture.release()
    if next(stamps, None) is not None:
        raise SpecError(f"its films have fewer images {_UNSURE}")


def _films(folder: Path, topic: str) -> list[Path]:
    """Format 3 has videos/FEATURE/chunk/file, format 2 videos/chunk/FEATURE/episode."""
    every = _files(folder, "videos/*/*/*.mp4")
    found = [path for path in every if topic in (path.parts[-2], path.parts[-3])]
    if not found:
        raise SpecError(f"it has no film of {shown(topic)}")
    return found
