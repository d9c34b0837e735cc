"""Frames of a file, at the rate at which they were taken or at another."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Event
from time import perf_counter

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown_path
from tactape_fab.sense.files.depth_maps import FrameFile
from tactape_fab.sense.live.sources import Frame, Trouble, as_source

USUAL_HZ = 25.0
"""Rate of a file without timestamps: a GelSight Mini's."""
LONGEST_GAP_S = 3600.0
"""Files with longer pauses between timestamps are refused: their unit is not seconds (25 Hz in µs are 40,000 apart), or the
replay would take hours."""
LAST_S = 1e11
"""Timestamps from here on are no seconds since 1970: as such they are those of the year 5138, in ms those of 1973."""
LONG_GAP_S = 10.0
"""A pause from which on the replay says that it waits: stamps of 25 Hz in ms are 40 apart."""
_SECONDS = "timestamps are seconds: divide those in ms by 1e3, in ns by 1e9, or give rate=HZ, or rate='max'"


@as_source
def replay(stop: Event, file: FrameFile, rate_hz: float | None = None, *, keep: bool = False) -> Iterator[Frame | Trouble]:
    """Source of a file's frames.

    A frame's timestamp is the file's. Where the file has none and a finite rate is given, frame k was taken at k / rate_hz.

    rate_hz: By default the file's own timestamps say when, and USUAL_HZ where it has none; a frame
        whose timestamp is not after all before it is not dropped. Infinite: as fast as they are located, none dropped.
    keep: Drop none, however long that takes.
    """
    keep = keep or rate_hz == float("inf")
    start, first = perf_counter(), None
    by_file = rate_hz is None and file.timestamp is not None
    hz = rate_hz or USUAL_HZ
    k, warned, latest = -1, False, float("-inf")
    try:
        for k, image in enumerate(file.frames()):
            stamp = file.time_of(k)
            due_s, waits = k / hz, keep
            if by_file:
                first = stamp if first is None else first
                due_s = 0.0 if stamp is None or first is None else stamp - first
                # a stamp that is not after all before it, as of a clock that was set back, does not say when its frame is due
                waits = keep or stamp is None or stamp <= latest
                latest = latest if stamp is None else max(latest, stamp)
            # counted from the start, so that delays do not add up
            wait_s = max(0.0, start + due_s - perf_counter())
            if wait_s > LONG_GAP_S and not warned:
                warned = True
                by = f"the file's timestamps; {_SECONDS}" if by_file else f"a rate of {hz:g} Hz"
                yield Trouble(kind="long pause", message=f"frame {k} comes in {wait_s:.3g} s by {by}")
            if stop.wait(wait_s):
                return
            if stamp is None and rate_hz is not None and rate_hz < float("inf") and file.timestamp is None:
                stamp = k / rate_hz
            yield Frame(number=k, image=image, timestamp=stamp, px_per_mm=file.px_per_mm, keep=waits)
    except SpecError as error:
        yield Trouble(kind="file damaged", message=f"after {k + 1} of {file.count} frames: {error}")


def has_stamps(file: FrameFile, rate_hz: float | None) -> bool:
    """Whether the frames of a replay have timestamps."""
    return file.timestamp is not None or (rate_hz is not None and rate_hz < float("inf"))


def refuse_no_seconds(file: FrameFile) -> None:
    """Refuse a file whose own timestamps would have a replay wait for hours. Raises SpecError."""
    if file.timestamp is None:
        return
    at = np.flatnonzero(np.isfinite(file.timestamp))
    # a replay does not wait for a stamp before one that it has reached
    stamps = np.maximum.accumulate(file.timestamp[at].astype(np.float64))
    gaps = np.diff(stamps)
    message = None
    if (gaps > LONGEST_GAP_S).any():
        k = int(np.argmax(gaps > LONGEST_GAP_S))
        message = f"frame {at[k + 1]} comes {gaps[k]:g} s after frame {at[k]}, and a replay waits {LONGEST_GAP_S:g} s at most"
    elif len(stamps) and stamps[-1] >= LAST_S:
        message = f"a timestamp is {stamps[-1]:g} s, not below {LAST_S:g} s, the year 5138"
    if message is not None:
        raise SpecError(Problem("rate", f"{shown_path(file.path)}: {message}; {_SECONDS}"))
