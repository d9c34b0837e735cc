"""Frames of a file, at the rate at which they were taken or at another."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from threading import Event
from time import perf_counter

from tactape_fab.base.errors import SpecError
from tactape_fab.sense.files.depth_maps import FrameFile
from tactape_fab.sense.live.sources import Frame, Source, Trouble

USUAL_HZ = 25.0
"""Rate of a file without timestamps: a GelSight Mini's."""


def replay(file: FrameFile, rate_hz: float | None = None, *, keep: bool = False) -> Source:
    """Source of a file's frames.

    rate_hz: By default the file's own timestamps say when, and USUAL_HZ where it has none. Infinite: as fast as they are located,
        none dropped.
    keep: Drop none, however long that takes.

    Notes
    -----
    A frame's timestamp is the file's. Where the file has none and a finite rate is given, frame k was taken at k / rate_hz.
    """
    return partial(_replayed, file, rate_hz, keep or rate_hz == float("inf"))


def has_stamps(file: FrameFile, rate_hz: float | None) -> bool:
    """Whether the frames of a replay have timestamps."""
    return file.timestamp is not None or (rate_hz is not None and rate_hz < float("inf"))


def _replayed(file: FrameFile, rate_hz: float | None, keep: bool, stop: Event) -> Iterator[Frame | Trouble]:
    start, first = perf_counter(), None
    by_file = rate_hz is None and file.timestamp is not None
    hz = rate_hz or USUAL_HZ
    k = -1
    try:
        for k, image in enumerate(file.frames()):
            stamp = file.time_of(k)
            due_s = k / hz
            if by_file:
                first = stamp if first is None else first
                due_s = 0.0 if stamp is None or first is None else stamp - first
            if stop.wait(max(0.0, start + due_s - perf_counter())):
                return
            if stamp is None and rate_hz is not None and rate_hz < float("inf") and file.timestamp is None:
                stamp = k / rate_hz
            yield Frame(number=k, image=image, timestamp=stamp, px_per_mm=file.px_per_mm, keep=keep)
    except SpecError as error:
        yield Trouble(kind="file damaged", message=f"after {k + 1} of {file.count} frames: {error}")
