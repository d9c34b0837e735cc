"""Live frames -> answers: one thread reads, this one locates; of frames that come meanwhile all but the latest are dropped."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from threading import Condition, Event, Thread
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import FrameError, TactapeError
from tactape_fab.sense.files.jobs import Job, Locate, Located, at_scale, by_scale_of_file, make_locator
from tactape_fab.sense.live.counts import Tally
from tactape_fab.sense.live.sources import Frame, Slot, Source, Trouble, take_next
from tactape_fab.sense.sensors import SensorProfile

if TYPE_CHECKING:
    from tactape_fab.sense.raw.reconstruct import Reconstruction

_Locators = dict[tuple[float, float], tuple[SensorProfile, Locate]]

WAIT_S = 0.05
"""Longest time without a frame after which `watch` gives None."""
END_S = 0.5
"""Longest wait for the threads that read, at the end: one that is inside OpenCV when the process ends aborts it."""
MOST_SCALES = 8
"""Scales that the files of a folder may name; each takes a localizer of its own."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Watch:
    """A source of frames with its sensor and locator.

    job: Tapes, sensor and settings; it has no files.
    reconstruction: Makes depth maps of the source's colour images.
    locator: Builds the function that locates a sensor's frames.
    """

    job: Job
    source: Source
    reconstruction: Reconstruction | None = None
    locator: Callable[[Job, SensorProfile], Locate] = make_locator


def watch(watched: Watch, tally: Tally, stop: Event) -> Iterator[Located | None]:
    """Answers as frames come, until there are no more or `stop` is set: `watch_all` of one sensor."""
    for found in watch_all([watched], [tally], stop):
        yield None if found is None else found[1]


def watch_all(watches: Sequence[Watch], tallies: Sequence[Tally], stop: Event) -> Iterator[tuple[int, Located] | None]:
    """Answers of several sensors as their frames come, until there are no more or `stop` is set.

    Each is read by a thread of its own, at its own rate; this one locates, and takes them in turn where several have a frame.
    What the caller does with an answer counts as its latency, which begins when the frame is there or, for one that may wait,
    when it is taken. What is no frame, or no frame of the sensor, is counted in its tally, and the next one looked at. A
    source that fails is counted among several, and the others go on.

    Yields (int, Located): The sensor's index and the answer; None now and then while no frame comes, so that the caller can look
        at the tallies.
    Raises TactapeError when a source failed, after the last frame of all.
    """
    locators: dict[int, _Locators] = {}  # sensors of one profile share them, and all share the tapes
    for watched in watches:
        _locator(watched, None, locators.setdefault(id(watched.job.sensor), {}))  # compiled before the first frame
    changed, last = Condition(), -1
    slots, threads = [Slot(changed) for _ in watches], list[Thread]()
    for watched, tally, slot in zip(watches, tallies, slots, strict=True):
        alone = len(watches) == 1
        threads.append(Thread(target=_read, args=(watched.source, slot, tally, stop, alone), daemon=True, name="frames"))
        threads[-1].start()
    try:
        while not stop.is_set():
            found = take_next(slots, changed, last + 1, WAIT_S)
            for tally, slot in zip(tallies, slots, strict=True):
                tally.dropped = slot.dropped
            if found is None:
                yield None
                continue
            last, frame = found
            watched, tally, taken_s = watches[last], tallies[last], perf_counter()
            try:
                located = _located(watched, frame, tally, locators[id(watched.job.sensor)])
            except FrameError as error:
                tally.unusable += 1
                tally.trouble(Trouble(kind="frame unusable", message=f"frame {frame.number}: {error}"))
                continue
            yield last, located
            tally.answer(located.fix, taken_s if frame.keep else frame.arrived_s)
    except EOFError:
        return
    finally:
        stop.set()
        due_s = perf_counter() + END_S
        for thread in threads:
            thread.join(max(0.0, due_s - perf_counter()))


def _read(source: Source, slot: Slot, tally: Tally, stop: Event, alone: bool) -> None:
    error = None
    try:
        for found in source(stop):
            if isinstance(found, Trouble):
                tally.trouble(found)
            else:
                slot.put(found, stop)
    except BaseException as caught:
        error = caught
        if not alone and isinstance(caught, TactapeError):
            tally.trouble(Trouble(kind="source failed", message=str(caught)))
    slot.end(error)


def _located(watched: Watch, frame: Frame, tally: Tally, locators: _Locators) -> Located:
    """A frame and its answer. Raises FrameError."""
    sensor, locate = _locator(watched, frame.px_per_mm, locators)
    if frame.image.ndim == 2 and frame.image.dtype.kind == "f" and frame.image.shape == sensor.frame_shape:
        holes = int(frame.image.size - np.count_nonzero(np.isfinite(frame.image)))
        if holes:
            message = f"frame {frame.number}: {holes} of {frame.image.size} values are NaN or infinite; they are treated as holes"
            tally.trouble(Trouble(kind="frame with holes", message=message))
    depth = frame.image if watched.reconstruction is None else _depth(frame.image, watched.reconstruction, sensor)
    fix = by_scale_of_file(locate(depth, timestamp=frame.timestamp), frame.px_per_mm)
    return Located(frame=frame.number, depth=depth, sensor=sensor, fix=fix, px_per_mm=frame.px_per_mm)


def _depth(image: npt.NDArray[np.uint8], reconstruction: Reconstruction, sensor: SensorProfile) -> npt.NDArray[np.float32]:
    """The depth map of a colour image. Raises FrameError if the image does not have the size of the sensor's frames."""
    expected = (*sensor.frame_shape, 3)
    if image.shape != expected:
        (height, width), asked = image.shape[:2], f"{expected[0]} x {expected[1]}"
        raise FrameError(
            f"an image of {height} x {width} px is none of sensor '{sensor.name}', whose images are {asked} (height x "
            "width); cut it out of a camera's with crop=U,V,WIDTH,HEIGHT (images of a folder when they are written), or give "
            "another sensor"
        )
    return reconstruction.depth(image)


def _locator(watched: Watch, px_per_mm: tuple[float, float] | None, locators: _Locators) -> tuple[SensorProfile, Locate]:
    """The profile with a frame's scale, and what locates its frames."""
    job = watched.job
    scale = px_per_mm or job.sensor.px_per_mm
    if scale not in locators:
        if len(locators) == MOST_SCALES:
            raise FrameError(f"it has a px_per_mm of its own, {scale}, after {MOST_SCALES} others; leave it out of the files")
        sensor = at_scale(job.sensor, scale)
        locators[scale] = (sensor, watched.locator(job, sensor))
    return locators[scale]
