"""Recordings of other programs in small: MCAP files, and datasets as LeRobot 3 lays them out."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.writer import Writer

from tactape_fab.sense.live.cdr import IMAGE


def image_message(image: npt.NDArray[Any], encoding: str, k: int = 0) -> dict[str, Any]:
    """A sensor_msgs/Image that was taken 100.5 s + k after the epoch."""
    height, width = image.shape[:2]
    header = {"stamp": {"sec": 100 + k, "nanosec": 500_000_000}, "frame_id": "gel"}
    size = {"height": height, "width": width, "encoding": encoding, "is_bigendian": 0, "step": image.nbytes // height}
    return {"header": header, **size, "data": image.tobytes()}


def mcap(path: Path, images: dict[str, list[bytes]], library: str = "other", **options: Any) -> Path:
    """An MCAP file of CDR messages by topic."""
    with path.open("wb") as stream:
        writer: Any = Writer(stream, **options)
        writer.start(profile="ros2", library=library)
        schema = writer.register_schema(name=IMAGE.name, encoding="ros2msg", data=IMAGE.definition.encode())
        for topic, messages in images.items():
            channel = writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema)
            for k, data in enumerate(messages):
                writer.add_message(channel, log_time=k, publish_time=k, data=data)
        writer.finish()
    return path


def dataset(folder: Path, feature: dict[str, Any], column: Any, count: int = 4) -> Path:
    """A dataset of two tables."""
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    info = {"codebase_version": "v3.0", "fps": 25, "features": {"touch": feature, "action": {"dtype": "float32", "shape": [2]}}}
    (folder / "meta" / "info.json").write_text(json.dumps(info), encoding="utf-8")
    half = count // 2
    for k, rows in enumerate((slice(0, half), slice(half, count))):
        stamps = pa.array((np.arange(count) / 25.0)[rows].astype(np.float32))
        table = {"timestamp": stamps} if column is None else {"touch": column[rows], "timestamp": stamps}
        pq.write_table(pa.table(table), folder / "data" / "chunk-000" / f"file-00{k}.parquet")
    return folder


def pictures(images: list[npt.NDArray[Any]], ending: str = ".png") -> Any:
    """A column of PNG or TIFF images."""
    found = [{"bytes": cv2.imencode(ending, image)[1].tobytes(), "path": f"frame-{k}{ending}"} for k, image in enumerate(images)]
    return pa.array(found, type=pa.struct([("bytes", pa.binary()), ("path", pa.string())]))


def film(path: Path, images: list[npt.NDArray[np.uint8]]) -> Path:
    """A film of colour images."""
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, images[0].shape[1::-1])
    for image in images:
        writer.write(image)
    writer.release()
    return path


def turned_film(path: Path, images: list[npt.NDArray[np.uint8]]) -> Path:
    """A film whose header asks for a half turn: a matrix of nine numbers in `tkhd`, version 0 (ISO 14496-12, 8.3.2)."""
    data = bytearray(film(path, images).read_bytes())
    at = data.index(b"tkhd") + 44
    height, width = images[0].shape[:2]
    data[at : at + 36] = struct.pack(">9i", -65536, 0, 0, 0, -65536, 0, width << 16, height << 16, 1 << 30)
    path.write_bytes(data)
    return path


def unreadable_film(path: Path, images: list[npt.NDArray[np.uint8]]) -> Path:
    """A film that opens, and of which no image can be unpacked, as of one in a codec that OpenCV was built without."""
    data = film(path, images).read_bytes()
    at = data.index(b"mdat") + 4
    size = int.from_bytes(data[at - 8 : at - 4], "big") - 8
    path.write_bytes(data[:at] + bytes(size) + data[at + size :])
    return path
