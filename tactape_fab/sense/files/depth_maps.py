"""Reader of files of depth maps, frame by frame; their content is untrusted."""

from __future__ import annotations

import lzma
import os
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from math import isfinite, prod
from pathlib import Path
from shlex import quote
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError, TactapeError, reason_of, refuse, tried
from tactape_fab.base.fields import shown, shown_path
from tactape_fab.base.input_file import open_regular
from tactape_fab.sense.raw.image_files import PICTURES, read_picture, read_picture_header
from tactape_fab.sense.sensors import MOST_FRAMES, MOST_PX, SensorProfile
from tactape_fab.texture.manifest import MANIFEST_NAME

SUFFIXES = (".npz", ".npy", *PICTURES)
ZIP_ERRORS = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, ValueError, RuntimeError, NotImplementedError)
"""Exceptions raised by reading a damaged zip."""

_MOST_BYTES = 1 << 30
_MOST_HEADER_BYTES = 10_000
_MOST_MEMBERS = 1000
_SHOWN = 100
_REMEDY = (
    "give an .npz with an array 'depth' of shape (N, h, w) or (h, w), an .npy, a 16-bit .png, or a .tif of 16 bits or of floats"
)
_REMEDIES = {
    "timestamp": "give seconds, of dates such as times.astype('datetime64[ns]').astype('int64') / 1e9, or leave it out",
    "px_per_mm": "give one number or two, or leave it out",
}

Depth = npt.NDArray[Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class ArrayHeader:
    """Header of an array in numpy's format."""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameFile:
    """A file of frames with its header read and checked; the frames are read one by one.

    frame_shape: Height and width of each frame.
    timestamp (count,): As the file has it, whole numbers too: a float does not hold all of those in ns.
    px_per_mm: Scale along u and v of the canonical image, where the file says it.
    """

    path: Path
    count: int
    frame_shape: tuple[int, int]
    timestamp: npt.NDArray[Any] | None = None
    px_per_mm: tuple[float, float] | None = None

    def frames(self) -> Iterator[Depth]:
        """The frames in order, each of `frame_shape`, as the file has them.

        Raises SpecError when the file ends early or is damaged.
        """
        with _refused(self.path):
            if self.path.suffix.lower() in PICTURES:
                yield read_picture(self.path)
                return
            with _opened(self.path) as (stream, header):
                if _counted(header) != (self.count, self.frame_shape):
                    raise SpecError("it was written anew while it was read; give it when it is whole")
                # column by column a frame's values are spread over the whole file: the stack is read at once
                if header.fortran:
                    yield from _read(stream, header).reshape(self.count, *self.frame_shape)
                    return
                one = ArrayHeader(shape=self.frame_shape, fortran=False, dtype=header.dtype)
                for _ in range(self.count):
                    yield _read(stream, one)

    def time_of(self, frame: int) -> float | None:
        """Timestamp of a frame, s; None without timestamps."""
        if self.timestamp is None or not isfinite(self.timestamp[frame]):
            return None
        # a float holds whole numbers up to 2^53 exactly; time in ns since 1970 is beyond
        stamp: int | float = self.timestamp[frame].item()
        return float(stamp) if abs(stamp) <= 2**53 else stamp


def open_frames(paths: Sequence[str | Path], sensor: SensorProfile) -> list[FrameFile]:
    """Open files of frames that a sensor took.

    paths: ``.npz`` with ``depth`` (N, h, w) or (h, w), optionally ``timestamp`` (N,) and ``px_per_mm`` (a number, or one along u
        and one along v); ``.npy`` with the same array; one frame as a ``.png`` or ``.tif``.
    sensor: Sensor of the frames.
    Raises SpecError with every problem of the files.
    """
    opened: list[FrameFile] = []
    problems: list[Problem] = []
    for path in paths:
        file = tried(partial(open_frame_file, path), problems)
        if file is None:
            continue
        opened.append(file)
        if file.frame_shape != sensor.frame_shape:
            problems.append(other_shape(file.path, file.frame_shape, sensor))
    refuse(problems)
    return opened


def other_shape(path: Path, shape: tuple[int, int], sensor: SensorProfile) -> Problem:
    """The problem of frames of a shape that is not the sensor's."""
    (h, w), (height, width) = shape, sensor.frame_shape
    message = f"{shown_path(path)} holds frames of {h} x {w} px (height x width), those of sensor '{sensor.name}' are"
    return Problem("frames", f"{message} {height} x {width}; give another sensor")


def has_manifest(path: Path) -> bool:
    """Whether a path that should be of frames is that of a kit or its manifest."""
    try:
        return path.name == MANIFEST_NAME or (path / MANIFEST_NAME).is_file()
    except (OSError, ValueError):  # a path that is invalid on every system
        return False


def open_frame_file(path: str | Path) -> FrameFile:
    """One file of frames, its header checked; see `open_frames`. Raises SpecError."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        if has_manifest(path):
            raise SpecError(Problem("frames", f"{shown_path(path)} is a kit, no file of frames; use --tape {quote(str(path))}"))
        remedy = "for arrays on standard input use watch -" if path == Path("-") else _REMEDY
        raise SpecError(Problem("frames", f"{shown_path(path)} is no file of frames; {remedy}"))
    with _refused(path):
        if suffix in PICTURES:
            return FrameFile(path=path, count=1, frame_shape=read_picture_header(path))
        with _opened(path) as (stream, header):
            if suffix == ".npy":
                _refuse_more(stream, header)
            count, shape = _counted(header)
        if suffix == ".npy":
            return FrameFile(path=path, count=count, frame_shape=shape)
        timestamp = _small_array(path, "timestamp", ((count,), ()) if count == 1 else ((count,),))
        scale = _small_array(path, "px_per_mm", ((), (1,), (2,)))
        return FrameFile(
            path=path,
            count=count,
            frame_shape=shape,
            timestamp=None if timestamp is None else timestamp.reshape(count),
            px_per_mm=None if scale is None else scale_of(scale),
        )


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    """Context manager: any failure to read a file becomes a SpecError that names the file."""
    try:
        yield
    except SpecError as error:
        raise SpecError([Problem("frames", f"{shown_path(path)}: {p.message}") for p in error.problems]) from None
    except TactapeError:
        raise
    except MemoryError:
        raise SpecError(Problem("frames", f"{shown_path(path)} does not fit into memory; {_REMEDY}")) from None
    except ZIP_ERRORS as error:
        reason = reason_of(error).split("\n", maxsplit=1)[0]
        message = f"{shown_path(path)} cannot be read: {reason or type(error).__name__}; {_REMEDY}"
        raise SpecError(Problem("frames", message)) from error


@contextmanager
def _opened(path: Path, name: str = "depth") -> Iterator[tuple[IO[bytes], ArrayHeader]]:
    """An array of a file: header read, stream positioned at its data."""
    with open_regular(path) as stream:
        if path.suffix.lower() == ".npy":
            yield stream, read_array_header(stream)
            return
        with zipfile.ZipFile(stream) as archive:
            members = archive.namelist()
            if len(members) > _MOST_MEMBERS:
                raise ValueError(f"it holds {len(members)} arrays, more than {_MOST_MEMBERS}")
            if name + ".npy" not in members:
                named = (m.removesuffix(".npy") if m.endswith(".npy") else f"{m} (without .npy)" for m in members)
                has = ", only " + ", ".join(sorted(named)) if members else ", and no other"
                raise SpecError(f"it has no array '{name}'{has[:_SHOWN]}; {_REMEDY}")
            if archive.getinfo(name + ".npy").compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                # numpy writes no other. 1 kB of bzip2 unpacks to 3,000 frames, deflated to three
                raise ValueError(f"its array '{name}' is packed in a way in which numpy writes none")
            with archive.open(name + ".npy") as member:
                yield member, read_array_header(member, name)


def read_array_header(stream: IO[bytes], name: str = "depth") -> ArrayHeader:
    """Read an array's header; object arrays, which need pickle, are refused. Raises SpecError, ValueError."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            version = np.lib.format.read_magic(stream)
            # numpy reads a header of any announced length, up to 4 GB, before it looks at it
            # NPY format: two bytes for the header's length in version 1.0, four from 2.0 on, the lowest first
            width = 2 if version == (1, 0) else 4
            announced = stream.read(width)
            length = int.from_bytes(announced, "little")
            if length > _MOST_HEADER_BYTES:
                raise ValueError(f"the header of an array has {length} bytes, more than {_MOST_HEADER_BYTES}")
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, fortran, dtype = read(BytesIO(announced + stream.read(length)))
    except ZIP_ERRORS:
        raise
    except Exception as error:  # numpy tokenizes an invalid literal, and passes on the tokenizer's exceptions
        raise ValueError(f"the header of an array is damaged ({type(error).__name__})") from error
    if dtype.hasobject or dtype.kind not in "fiub":
        held = f"holds values of type {shown(str(dtype))}, not real numbers"
        raise SpecError(f"it {held}; {_REMEDY}" if name == "depth" else f"{name} {held}; {_REMEDIES[name]}")
    if any(n < 0 for n in shape):
        raise ValueError(f"its shape is {shape}")
    # both orders are one for a single axis
    return ArrayHeader(shape=shape, fortran=fortran and len(shape) > 1, dtype=dtype)


def _refuse_more(stream: IO[bytes], header: ArrayHeader) -> None:
    """Refuse bytes behind the array of an .npy: frames that numpy.save appended to one file would be left out unsaid."""
    more = os.fstat(stream.fileno()).st_size - stream.tell() - prod(header.shape) * header.dtype.itemsize
    if more > 0:
        held = f"{more} bytes follow its array of shape {shown(header.shape)}, as where numpy.save wrote several into one file"
        raise SpecError(f"{held}; give one array of all frames, or the file on standard input of watch - --no-drop")


def _counted(header: ArrayHeader) -> tuple[int, tuple[int, int]]:
    """Number of frames and the shape of one; refuses arrays that are not stacks of depth maps."""
    shape = header.shape
    if len(shape) not in (2, 3):
        raise SpecError(f"depth has shape {shown(shape)}; {_REMEDY}")
    count, (height, width) = shape[0] if len(shape) == 3 else 1, shape[-2:]
    if not 1 <= count <= MOST_FRAMES or not 1 <= height <= MOST_PX or not 1 <= width <= MOST_PX:
        raise SpecError(f"depth has shape {shown(shape)}; give 1 to {MOST_FRAMES} frames of at most {MOST_PX} x {MOST_PX} px")
    if header.fortran and prod(shape) * header.dtype.itemsize > _MOST_BYTES:
        raise SpecError("depth is stored column by column, and too large for that; save numpy.ascontiguousarray of it")
    return count, (height, width)


def _read(stream: IO[bytes], header: ArrayHeader) -> Depth:
    """Read an array's data, whose size has been checked."""
    size = prod(header.shape) * header.dtype.itemsize
    data = stream.read(size)
    if len(data) != size:
        raise SpecError("it ends in the middle of a frame; write it again")
    return np.frombuffer(data, dtype=header.dtype).reshape(header.shape, order="F" if header.fortran else "C")


def _small_array(path: Path, name: str, shapes: Sequence[tuple[int, ...]]) -> npt.NDArray[Any] | None:
    """Optional array of one of the allowed shapes, whole numbers or float64; None if the file does not have it."""
    with open_regular(path) as file, zipfile.ZipFile(file) as archive:
        if name + ".npy" not in archive.namelist():
            return None
    with _opened(path, name) as (stream, header):
        if header.shape not in shapes:
            raise SpecError(f"{name} has shape {shown(header.shape)}; give {' or '.join(str(s) for s in shapes)}")
        values = _read(stream, header)
        return values if values.dtype.kind in "iu" else values.astype(np.float64)


def scale_of(values: npt.NDArray[Any]) -> tuple[float, float]:
    """px/mm along u and v; one number is that of both. Raises SpecError."""
    u, v = (float(x) for x in np.broadcast_to(values, 2))
    if not (1.0 <= u <= 1000.0 and 1.0 <= v <= 1000.0):
        raise SpecError(f"px_per_mm = {shown(values.tolist())} is not from 1 to 1000 px/mm; correct it or leave it out")
    return u, v
