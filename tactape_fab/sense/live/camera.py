"""Colour images from a camera, or from a video file of one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from threading import Event
from time import monotonic, perf_counter, time
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError, TactapeError
from tactape_fab.base.fields import shown, shown_path
from tactape_fab.base.input_file import read_regular
from tactape_fab.base.libraries import library
from tactape_fab.sense.live.sources import Frame, Trouble, as_source
from tactape_fab.sense.raw.image_files import opened_film

FILMS = (".avi", ".mkv", ".mov", ".mp4")
Crop = tuple[int, int, int, int]
"""u, v of the upper left corner, width, height, px."""

USB = "usb:"
"""Before the name of a camera, or a part of it, instead of its path."""
_DEVICES, _MOST_DEVICES, _MOST_NAME_BYTES = Path("/sys/class/video4linux"), 256, 1000
_OLDEST_S = 10.0
_MOST_MISSES = 50
_MISS_S = 0.02
_LEAST_MISSING = 2.0


@as_source
def camera_source(
    stop: Event,
    path: Path,
    size: tuple[int, int],
    crop: Crop | None = None,
    *,
    keep: bool = False,
    opened: Callable[[Path], Any] | None = None,
    clock: Callable[[], float] = time,
) -> Iterator[Frame | Trouble]:
    """Source of a camera's images; their timestamp is the driver's, or the time of the grab if the driver has none.

    path: Such as /dev/video0.
    size: Height and width that images are to have, px: the camera is asked for them, and what `crop` cuts out is scaled to them.
    crop: The part of an image that the sensor's network knows: u, v, width, height, px.
    opened: From a path to something like cv2.VideoCapture.
    clock: Time of a grab, s.
    """
    cv2 = library("cv2", "reading a camera")

    capture = (opened or _camera)(path)
    try:
        if not capture.isOpened():
            remedy = "give another, or the right to read it (group video)"
            raise TactapeError(f"camera {shown_path(path)} cannot be opened; {remedy}")
        if crop is None:
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[0])
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[1])
        number, misses = 0, 0
        while not stop.is_set():
            if not capture.grab():
                misses += 1
                if misses == _MOST_MISSES:
                    raise TactapeError(f"camera {shown_path(path)} gives no more images; is it still plugged in?")
                stop.wait(_MISS_S)
                continue
            stamp, misses = _taken_s(capture, clock), 0
            whole, image = capture.retrieve()
            if whole:
                yield _frame(number, image, size, crop, stamp, keep)
            else:
                yield Trouble(kind="image damaged", message=f"frame {number} of camera {shown_path(path)} cannot be unpacked")
            number += 1
    finally:
        capture.release()


def camera_named(name: str, devices: Path = _DEVICES) -> Path:
    """The path of the camera whose USB name holds a text, in any case: a GelSight Mini says "GelSight Mini" and its number.

    A camera has several devices (V4L2): that of its images is the one with index 0.

    Raises SpecError when there is none, or more than one; those that are there are named.
    """
    found: dict[str, str] = {}
    with suppress(OSError):
        for device in sorted(devices.iterdir())[:_MOST_DEVICES]:
            with suppress(OSError, ValueError):
                label = read_regular(device / "name", _MOST_NAME_BYTES).decode(errors="replace").strip()
                index = device / "index"
                if not index.exists() or int(read_regular(index, _MOST_NAME_BYTES)) == 0:
                    found[device.name] = label
    fitting = [device for device, label in found.items() if name.strip() and name.strip().lower() in label.lower()]
    if len(fitting) == 1:
        return Path("/dev") / fitting[0]
    there = ", ".join(f"{shown(label)} (/dev/{device})" for device, label in found.items()) or "none at all"
    how_many = "no camera has" if not fitting else f"{len(fitting)} cameras have"
    message = f"source {USB}{name}: {how_many} that in its name; there is: {there}; plug it in, or give more of the name"
    raise SpecError(Problem("source", message))


@as_source
def film_source(
    stop: Event, path: Path, size: tuple[int, int], crop: Crop | None = None, *, rate_hz: float | None = None, keep: bool
) -> Iterator[Frame | Trouble]:
    """Source of a video file's images, at its own rate or another; an infinite one drops none. Timestamps: the file's, if any."""
    cv2 = library("cv2", "reading a camera")

    keep = keep or rate_hz == float("inf")
    capture = opened_film(path)
    try:
        if not capture.isOpened():
            raise TactapeError(f"film {shown_path(path)} cannot be opened; give an .avi or .mp4")
        start, number, latest = perf_counter(), 0, 0.0
        while True:
            whole, image = capture.read()
            if not whole and number == 0:
                raise TactapeError(f"film {shown_path(path)} cannot be unpacked by this OpenCV; write it anew as H.264 or MJPEG")
            if not whole:
                # by time, as the header's number is that of its length and mean rate where images are not evenly spaced
                missing = capture.get(cv2.CAP_PROP_FRAME_COUNT) - latest * capture.get(cv2.CAP_PROP_FPS) - 1.0
                if missing >= _LEAST_MISSING:
                    message = f"film {shown_path(path)} ends after {number} images, {missing:.0f} earlier than its header says"
                    yield Trouble(kind="film cut off", message=f"{message}; it was cut off or is damaged: copy it again")
                return
            found = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            # the last images of H.264 in AVI, and of damaged films, have no time, which OpenCV gives as 0
            stamp = None if number > 0 and found <= latest else found
            latest = latest if stamp is None else stamp
            due_s = latest if rate_hz is None else number / rate_hz
            if stop.wait(max(0.0, start + due_s - perf_counter())):
                return
            yield _frame(number, image, size, crop, stamp, keep or stamp is None)
            number += 1
    finally:
        capture.release()


def _camera(path: Path) -> Any:
    cv2 = library("cv2", "reading a camera")

    capture = cv2.VideoCapture(str(path), cv2.CAP_V4L2)
    # older images in a queue would be located first
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    return capture


def _taken_s(capture: Any, clock: Callable[[], float]) -> float:
    """Time at which the driver received the grabbed image, s; the present time if it gives none by V4L2's monotonic clock.

    OpenCV hands the time of the buffer on as its position; uvcvideo takes it of the monotonic clock.
    """
    cv2 = library("cv2", "reading a camera")

    # from one clock to the other by the image's age; no plausible age, no such clock
    now_s, age_s = clock(), monotonic() - capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
    return now_s - age_s if 0.0 <= age_s < _OLDEST_S else now_s


def _frame(
    number: int, image: npt.NDArray[Any], size: tuple[int, int], crop: Crop | None, stamp: float | None, keep: bool
) -> Frame | Trouble:
    """The cropped image, scaled to the size of the sensor's frames; a trouble if the crop lies outside the image."""
    cv2 = library("cv2", "reading a camera")

    if crop is not None:
        u, v, width, height = crop
        part = image[v : v + height, u : u + width]
        if part.shape[:2] != (height, width):  # the whole image might have the frames' size
            there = f"frame {number} has {image.shape[1]} x {image.shape[0]} px"
            message = f"{there}, and crop = {','.join(map(str, crop))} reaches beyond; give crop=U,V,WIDTH,HEIGHT within it"
            return Trouble(kind="image too small", message=message)
        image = np.asarray(cv2.resize(part, (size[1], size[0]), interpolation=cv2.INTER_AREA))
    return Frame(number=number, image=image, timestamp=stamp, keep=keep)
