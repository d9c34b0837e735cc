"""Frames from a folder into which another process writes files, each taken as soon as it is complete."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from threading import Event
from time import perf_counter, thread_time, time
from typing import Any

import numpy.typing as npt

from tactape_fab.base.errors import SpecError, TactapeError, reason_of
from tactape_fab.base.fields import shown_path
from tactape_fab.base.input_file import open_regular
from tactape_fab.sense.files.depth_maps import open_frame_file
from tactape_fab.sense.live.sources import Frame, Trouble, as_source
from tactape_fab.sense.raw.colour_images import by_number
from tactape_fab.sense.raw.image_files import read_colour

PATIENCE_S = 2.0
"""Time, s, after which an incomplete file that does not change is reported."""

_POLL_S = 0.005
_SHARE = 5.0
"""The pause between two listings is so many times as long as a listing, which takes a moment with ten thousand files."""
_LIST_S = 0.25
"""Longest time between two listings, for file systems that do not change the folder's time when a file is added."""
_TICK_S = 0.05
"""A folder's time may stay the same for so long after a file is added."""
_ENDINGS = {".png": (b"IEND\xaeB`\x82", 8), ".jpg": (b"\xff\xd9", 64), ".jpeg": (b"\xff\xd9", 64)}
"""End marks of complete images (PNG, 11.2.5; ITU-T T.81, B.1.1.3); OpenCV decodes the top of a truncated file."""
_SAY_LENGTH = (".npz", ".npy")
_SETTLED_S = 0.1
"""Any other file, such as a TIFF, does not say where it ends: it is whole once it has not changed for so long."""


@dataclass(slots=True, kw_only=True)
class _Waiting:
    """A file that is not fully read yet: its state at the last look and try, since when, the fault, and its frames so far."""

    found: tuple[int, int] = (-1, -1)
    found_s: float = 0.0
    seen: tuple[int, int] = (-1, -1)
    since_s: float = 0.0
    reason: str = ""
    reported: bool = False
    taken: int = 0
    inode: int = 0
    keep: bool = False


@as_source
def folder_source(
    stop: Event,
    folder: Path,
    suffixes: Sequence[str],
    *,
    colour: bool = False,
    keep: bool = False,
    idle_s: float | None = None,
    frame_shape: tuple[int, int] | None = None,
) -> Iterator[Frame | Trouble]:
    """Source of a folder's files, in the order of the numbers in their names as far as they are there together.

    Those that are there at the start are all taken; of those that come, the latest is. A file counts when it is whole: one that
    is still being written is tried again whenever it has changed, and said after `PATIENCE_S`. A frame's timestamp is
    its file's own, or the time when the file was last written.

    suffixes: Names of files that are frames end so; hidden files are none.
    colour: The files are colour images.
    keep: Drop none of those that come, either.
    idle_s: End when no new file has come for so long; by default never.
    frame_shape: That of the sensor. A file of other frames is given as its first one, which is told as unusable: a megabyte may
        hold a million, and those of the sensor would wait behind them.
    """
    taken: set[str] = set()
    waiting: dict[str, _Waiting] = {}
    number, listed_ns, listed_s = 0, -1, float("-inf")
    last_s, start = perf_counter(), True
    while not stop.is_set():
        now_s, changed_ns = perf_counter(), _changed_ns(folder)
        looking_s, looked_s = thread_time(), 0.0
        # a folder's time has its file system's grain: what comes within one tick of it does not change it again
        if changed_ns != listed_ns or time() - changed_ns / 1e9 < _TICK_S or now_s - listed_s > _LIST_S:
            listed_ns, listed_s = changed_ns, now_s
            names = _names(folder, tuple(suffixes))
            # a name that is gone and comes again is another file
            taken &= names
            for name in names - taken - waiting.keys():
                waiting[name] = _Waiting(keep=keep or start)
                last_s = now_s
            for name in waiting.keys() - names:
                del waiting[name]
            start, looked_s = False, thread_time() - looking_s
        # frame_2 before frame_10
        for name in sorted(waiting, key=lambda name: (by_number(name), name)):
            file = waiting[name]
            for found in _tried(folder / name, file, colour, number, frame_shape):
                number += isinstance(found, Frame)
                last_s = perf_counter()
                yield found
            if not file.reason:
                del waiting[name]
                taken.add(name)
        if idle_s is not None and perf_counter() - last_s > idle_s:
            yield from (_unfinished(folder / name, file) for name, file in waiting.items() if not file.reported)
            return
        stop.wait(max(_POLL_S, _SHARE * looked_s))


def _changed_ns(folder: Path) -> int:
    try:
        return folder.stat().st_mtime_ns
    except OSError as error:
        raise _gone(folder, error) from error


def _names(folder: Path, suffixes: tuple[str, ...]) -> set[str]:
    try:
        return {e.name for e in os.scandir(folder) if e.name.lower().endswith(suffixes) and not e.name.startswith(".")}
    except OSError as error:
        raise _gone(folder, error) from error


def _gone(folder: Path, error: OSError) -> TactapeError:
    return TactapeError(f"folder {shown_path(folder)} cannot be looked into: {reason_of(error)}; is it still there?")


def _tried(
    path: Path, file: _Waiting, colour: bool, number: int, frame_shape: tuple[int, int] | None
) -> Iterator[Frame | Trouble]:
    """The frames of a file that have not been taken yet; `file.reason` says why it cannot be taken whole, if so."""
    try:
        status = path.stat()
    except OSError as error:
        file.reason = reason_of(error)
        return
    if status.st_ino != file.inode:  # another file was moved into its place: none of its frames was taken
        file.inode, file.taken, file.seen = status.st_ino, 0, (-1, -1)
    seen, now_s = (status.st_size, status.st_mtime_ns), perf_counter()
    if seen != file.found:
        file.found, file.found_s = seen, now_s
    # who writes may have another clock: by its time a file may be of the future for hours
    unchanged_s = max(time() - status.st_mtime, now_s - file.found_s)
    settled = path.suffix.lower() in (*_ENDINGS, *_SAY_LENGTH) or unchanged_s > _SETTLED_S
    # neither size nor time has changed: another try would end as the last one did
    if seen == file.seen:
        if not file.reported and now_s - file.since_s > PATIENCE_S:
            file.reported = True
            yield _unfinished(path, file)
        return
    if not settled:
        file.reason, file.since_s = "it is still being written", now_s
        return
    file.seen, file.since_s, file.reason = seen, now_s, ""
    before = file.taken
    try:
        for k, (image, timestamp, px_per_mm) in enumerate(_read(path, colour, frame_shape)):
            # a file that grew was read before to this frame
            if k < before:
                continue
            stamp = status.st_mtime if timestamp is None else timestamp
            yield Frame(number=number + k - before, image=image, timestamp=stamp, px_per_mm=px_per_mm, keep=file.keep)
            file.taken = k + 1
    except (SpecError, OSError) as error:
        file.reason = reason_of(error)


def _read(
    path: Path, colour: bool, frame_shape: tuple[int, int] | None
) -> Iterator[tuple[npt.NDArray[Any], float | None, tuple[float, float] | None]]:
    ending = _ENDINGS.get(path.suffix.lower())
    if ending is not None:
        with open_regular(path) as stream:
            stream.seek(max(0, stream.seek(0, os.SEEK_END) - ending[1]))
            if ending[0] not in stream.read():
                raise SpecError(f"{shown_path(path)} ends in the middle of the picture")
    if colour:
        yield read_colour(path), None, None
        return
    file = open_frame_file(path)
    of_sensor = frame_shape in (None, file.frame_shape)
    for k, image in enumerate(islice(file.frames(), None if of_sensor else 1)):
        yield image, file.time_of(k), file.px_per_mm


def _unfinished(path: Path, file: _Waiting) -> Trouble:
    reason = file.reason if str(path) in file.reason else f"{shown_path(path)}: {file.reason}"
    return Trouble(kind="file not whole", message=f"{reason}; it is tried again when it changes")
