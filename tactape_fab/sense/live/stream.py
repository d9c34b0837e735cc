"""Frames from a pipe: arrays in numpy's .npy format, one behind the other."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator
from math import prod
from threading import Event
from time import time
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import SpecError
from tactape_fab.base.fields import shown
from tactape_fab.sense.files.depth_maps import ArrayHeader, read_array_header
from tactape_fab.sense.live.sources import Frame, Trouble, as_source

MAGIC = b"\x93NUMPY"
_START = re.compile(rb"\x93NUMPY[\x01-\x03]\x00")
"""An array's first bytes (NEP 1: the magic and the format's version). The magic alone begins none."""
_START_BYTES = 8
_MOST_BYTES = 256 << 20
_PIECE = 1 << 16


class Readable(Protocol):
    """A binary stream."""

    def read(self, size: int, /) -> bytes | None: ...


@as_source
def stream_source(
    stop: Event,
    stream: Readable,
    *,
    keep: bool = False,
    frame_shape: tuple[int, int] | None = None,
    clock: Callable[[], float] = time,
) -> Iterator[Frame | Trouble]:
    """Source of the arrays in a stream: (h, w), or (N, h, w) as N frames.

    The frames of a stack are never dropped: they came at once. A single number before a frame (an array of shape ()) is its
    timestamp; other frames were taken when their first byte came. What is no array is skipped up to the next that is.

    stream: Unbuffered: what `read` gives is looked at when it comes.
    keep: Let the writer wait instead of dropping frames.
    frame_shape: That of the sensor. A stack of other frames is given as its first one, which is told as unusable: in a hundred
        bytes a header may announce 10^18 frames of no pixel.
    """
    source = _Bytes(stream)
    number, last = 0, None
    while not stop.is_set():
        skipped = source.skip_to_array()
        if skipped:
            last = None  # the frame that it was of may be among them
            yield Trouble(
                kind="stream damaged", message=f"skipped {skipped} bytes that are not a .npy array, before frame {number}"
            )
        came = clock()
        try:
            array = _array(source)
        except (EOFError, ValueError) as error:
            ended = isinstance(error, EOFError)
            if str(error):
                what_then = "" if ended else "; looking for the next array"
                yield Trouble(kind="stream damaged", message=f"frame {number}: {error}{what_then}")
            if ended:
                return
            number, last = number + 1, None
            continue
        if array.ndim == 0:
            # as of a file: a float does not hold whole numbers beyond 2^53, such as ns since 1970
            last = int(array) if array.dtype.kind in "iu" and abs(int(array)) > 2**53 else float(array)
            continue
        stack = array.ndim == 3
        if stack and frame_shape not in (None, array.shape[1:]):
            array = array[:1]
        for image in array if stack else [array]:
            yield Frame(number=number, image=image, timestamp=came if last is None else last, keep=keep or stack)
            number += 1
        last = None


class _Bytes:
    """Buffer over a stream, for reads of a given size."""

    def __init__(self, stream: Readable) -> None:
        self._stream = stream
        self._ahead = bytearray()

    def read(self, size: int) -> bytes:
        """`size` bytes; fewer at the end."""
        data = bytearray(self._ahead[:size])
        del self._ahead[:size]
        while len(data) < size:
            piece = self._stream.read(min(size - len(data), _PIECE * 16))
            if not piece:
                break
            data += piece
        return bytes(data)

    def read_to(self, mark: bytes, size: int) -> bytes:
        """`size` bytes; fewer at the end, or before a mark among them, which comes next then.

        It is looked for as bytes come: to read all of them and give back what follows it would take a second time for each mark.
        """
        looked = 0
        while (at := self._ahead.find(mark, looked, size)) < 0 and len(self._ahead) < size:
            # the last bytes may be the mark's first
            looked = max(0, len(self._ahead) - len(mark) + 1)
            piece = self._stream.read(min(size - len(self._ahead), _PIECE * 16))
            if not piece:
                break
            self._ahead += piece
        return self.read(min(size, len(self._ahead)) if at < 0 else at)

    def comes(self, mark: bytes) -> bool:
        """Whether the next bytes are the mark."""
        return self._ahead.startswith(mark)

    def give_back(self, data: bytes) -> None:
        """Put bytes back, to be read next."""
        self._ahead[:0] = data

    def skip_to_array(self) -> int:
        """Skip all before the first bytes of an array, or to the end; how many bytes that was."""
        skipped = 0
        while (start := _START.search(self._ahead)) is None:
            # the last bytes may be an array's first
            gone = max(0, len(self._ahead) - _START_BYTES + 1)
            del self._ahead[:gone]
            skipped += gone
            piece = self._stream.read(_PIECE)
            if not piece:
                skipped += len(self._ahead)
                self._ahead.clear()
                return skipped
            self._ahead += piece
        del self._ahead[: start.start()]
        return skipped + start.start()


def _array(source: _Bytes) -> npt.NDArray[Any]:
    """The array that begins here.

    Raises EOFError at the end, with a message where that is in the middle of an array.
    Raises ValueError if the array is invalid.
    """
    start = source.read(_START_BYTES)
    if not start:
        raise EOFError
    header = _header(start, source)
    size = prod(header.shape) * header.dtype.itemsize
    if size > _MOST_BYTES or len(header.shape) not in (0, 2, 3):
        raise ValueError(f"an array of shape {shown(header.shape)} is no frame, and no stack of at most {_MOST_BYTES} bytes")
    # chance puts these six bytes at a given place once in 2^48
    data = source.read_to(MAGIC, size)
    if len(data) < size and source.comes(MAGIC):  # its writer was stopped, and another one has started
        raise ValueError(f"it ends after {len(data)} of {size} bytes")
    if len(data) < size:
        raise EOFError(f"the stream ends after {len(data)} of {size} bytes")
    return np.frombuffer(data, dtype=header.dtype).reshape(header.shape, order="F" if header.fortran else "C")


def _header(start: bytes, source: _Bytes) -> ArrayHeader:
    """A header behind magic and version (NEP 1: two or four bytes of length, a literal)."""
    width = 2 if start[-2:] == b"\x01\x00" else 4
    length = source.read(width)
    # up to another mark: numpy takes 12 ms to refuse the 10 kB that a header may announce
    text = source.read_to(MAGIC, min(int.from_bytes(length, "little"), _PIECE))
    if len(length) < width or not (text or source.comes(MAGIC)):
        raise EOFError("the stream ends in a header")
    try:
        return read_array_header(io.BytesIO(start + length + text))
    except (SpecError, ValueError) as error:
        # its writer may have been stopped in the header, and another one's array begin in these bytes
        behind = length + text
        source.give_back(behind[behind.find(MAGIC[:1]) :] if MAGIC[:1] in behind else b"")
        raise ValueError(str(error)) from error
