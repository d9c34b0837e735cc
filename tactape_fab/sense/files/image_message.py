"""sensor_msgs/Image, as a message or as its bytes, to an array; its content is untrusted."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import FrameError
from tactape_fab.base.fields import shown

IMAGE_TYPE = "sensor_msgs/msg/Image"
PIXELS = {"32FC1": "f4", "16UC1": "u2", "mono16": "u2", "8UC1": "u1", "mono8": "u1"}
COLOURS = {"bgr8": slice(None), "rgb8": slice(None, None, -1)}
"""Order of the channels that makes blue the first."""
_NS = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Image:
    """A message's fields, with those of its header."""

    stamp_ns: int
    frame_id: str
    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: memoryview


def image_of(cdr: bytes) -> Image:
    """The message in plain CDR (OMG DDSI-RTPS 2.5, 10). Raises FrameError when the bytes are no such message."""
    # encapsulation: CDR_LE or CDR_BE, then two bytes of options; alignment counts from behind these four bytes
    order = {b"\x00\x01": "<", b"\x00\x00": ">"}.get(cdr[:2])
    at = 4

    def number(kind: str) -> int:
        nonlocal at
        size = struct.calcsize(kind)
        at += -(at - 4) % size
        (value,) = struct.unpack_from(f"{order}{kind}", cdr, at)
        at += size
        return int(value)

    def text() -> str:
        nonlocal at
        length = number("I")
        if not 1 <= length <= len(cdr) - at:
            raise ValueError("a text in it is longer than the message")
        # a string's length counts its final zero byte
        found = bytes(cdr[at : at + length - 1]).decode()
        at += length
        return found

    try:
        if order is None:
            raise ValueError("it is no plain CDR")
        seconds, nanoseconds = number("i"), number("I")
        frame_id, height, width, encoding = text(), number("I"), number("I"), text()
        big, step, length = number("B"), number("I"), number("I")
        if length > len(cdr) - at:
            raise ValueError(f"it holds {len(cdr) - at} of {length} bytes")
    except (ValueError, struct.error) as error:
        raise FrameError(f"{len(cdr)} bytes are no image message: {error}") from error
    return Image(
        stamp_ns=seconds * _NS + nanoseconds,
        frame_id=frame_id,
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=big,
        step=step,
        data=memoryview(cdr)[at : at + length],
    )


def depth_of(image: Any) -> npt.NDArray[Any]:
    """The depth map in a sensor_msgs/Image, shape (height, width).

    Raises FrameError for another encoding, and for data that is not as long as its size says.
    """
    kind = PIXELS.get(image.encoding)
    if kind is None:
        raise FrameError(f"its encoding is {shown(image.encoding)}; depth images are one of: {', '.join(PIXELS)}")
    pixel = np.dtype((">" if image.is_bigendian else "<") + kind)
    return np.ascontiguousarray(_rows(image, pixel.itemsize)).view(pixel).astype(pixel.newbyteorder("="), copy=False)


def colour_of(image: Any) -> npt.NDArray[np.uint8]:
    """The colour image in a sensor_msgs/Image, shape (height, width, 3), blue first. Raises FrameError as `depth_of`."""
    order = COLOURS.get(image.encoding)
    if order is None:
        raise FrameError(f"its encoding is {shown(image.encoding)}; colour images are one of: {', '.join(COLOURS)}")
    return np.ascontiguousarray(_rows(image, 3).reshape(image.height, image.width, 3)[:, :, order])


def _rows(image: Any, pixel_bytes: int) -> npt.NDArray[np.uint8]:
    """The bytes of the pixels, shape (height, width * pixel_bytes)."""
    data = np.frombuffer(image.data, dtype=np.uint8)
    row = image.width * pixel_bytes
    if image.step < row or data.size < image.height * image.step or image.height * row == 0:
        raise FrameError(f"{data.size} bytes are no {image.width} x {image.height} image of rows of {image.step} bytes")
    # rows may be padded to `step` bytes
    return data[: image.height * image.step].reshape(image.height, image.step)[:, :row]
