"""Recordings of other programs as files of frames: MCAP and rosbag2, and datasets of LeRobot; their content is untrusted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import FrameError, MissingLibraryError, Problem, SpecError, reason_of
from tactape_fab.base.fields import shown, shown_path
from tactape_fab.sense.files.depth_maps import other_shape
from tactape_fab.sense.files.recording_kinds import BAG, DATASET, MCAP, OTHER_BAGS, Image, Stamped
from tactape_fab.sense.sensors import MOST_FRAMES, SensorProfile

if TYPE_CHECKING:
    from tactape_fab.sense.raw.reconstruct import Reconstruction

_OF_OURS = 1000.0
"""Millimetres in one unit of the depth images that `watch --mcap` writes (REP 118)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """A recording whose images were looked at once; they are read one by one.

    topic: Topic of ROS, or feature of LeRobot.
    timestamp (count,): s; NaN where an image has none.
    frame_shape: Height and width of the first image.
    read: Timestamps and images, in order.
    ours: Whether `watch` wrote it: upright depth images in metres.
    reconstruction: Makes depth maps of colour images.
    px_per_mm: Scale that the file says from which `watch` wrote it.
    """

    path: Path
    topic: str
    timestamp: npt.NDArray[np.float64]
    frame_shape: tuple[int, int]
    read: Callable[[], Iterator[Stamped]]
    ours: bool = False
    reconstruction: Reconstruction | None = None
    px_per_mm: tuple[float, float] | None = None

    @property
    def count(self) -> int:
        """Number of its images."""
        return len(self.timestamp)

    def frames(self) -> Iterator[Image]:
        """The depth maps in order. Raises SpecError when one of them is invalid, or of another size."""
        for k, (_, image) in enumerate(_refused(self.path, self.read)):
            if image.shape[:2] != self.frame_shape or k == self.count:
                message = f"image {k} of {self.topic} has {image.shape[0]} x {image.shape[1]} px, the first not, or came later"
                raise SpecError(Problem("frames", f"{shown_path(self.path)}: {message}; record images of one size"))
            yield image if self.reconstruction is None else self.reconstruction.depth(image)

    def time_of(self, frame: int) -> float | None:
        """Timestamp of an image, s; None without one."""
        stamp = float(self.timestamp[frame])
        return stamp if isfinite(stamp) else None

    def seen_by(self, sensor: SensorProfile) -> SensorProfile:
        """The profile of its depth maps."""
        return upright(sensor) if self.ours else sensor


def upright(sensor: SensorProfile) -> SensorProfile:
    """The profile of canonical depth maps in metres, or in the sensor's own unit where its profile says none."""
    unit_mm = None if sensor.depth_unit_mm is None else _OF_OURS
    return replace(sensor, sign=1, mirror=False, rotate90=0, depth_unit_mm=unit_mm)


def is_recording(path: str | Path) -> bool:
    """Whether a path is that of a recording: an .mcap, or a folder of rosbag2 or of a LeRobot dataset."""
    path = Path(path)
    try:
        return _is_bag(path) or (path / DATASET).is_file()
    except (OSError, ValueError):
        return False


def _is_bag(path: Path) -> bool:
    return path.suffix.lower() in (MCAP, *OTHER_BAGS) or (path / BAG).is_file()


def open_recording(path: str | Path, sensor: SensorProfile, topic: str | None = None, *, colour: bool = False) -> Recording:
    """Open a recording of a sensor's frames.

    path: An .mcap, a folder of rosbag2 with such files, or a dataset of LeRobot (2 and 3).
    topic: Topic of sensor_msgs/Image, or feature; not needed where there is one alone.
    colour: Its images are colour images of the gel.
    Raises SpecError.
    Raises MissingLibraryError when the library that reads it is not installed.
    """
    from tactape_fab.sense.files.lerobot_dataset import open_dataset
    from tactape_fab.sense.files.mcap_images import open_bag

    path = Path(path)
    opened = open_bag if _is_bag(path) else open_dataset
    try:
        topic, ours, scale, read = opened(path, topic, colour)
    except MissingLibraryError:
        raise
    except Exception as error:  # damaged files make the readers of others raise what they like
        raise _damaged(path, error) from error
    stamps, shape = list[float](), (0, 0)
    # images are counted, and none is kept: the index of a log that was cut off is missing
    for stamp, image in _refused(path, read):
        shape = shape if stamps else image.shape[:2]
        stamps.append(float("nan") if stamp is None else stamp)
        if len(stamps) > MOST_FRAMES:
            raise SpecError(Problem("frames", f"{shown_path(path)} holds more than {MOST_FRAMES} images; cut it"))
    if not stamps:
        raise SpecError(Problem("frames", f"{shown_path(path)} holds no image of {shown(topic)}; give another --topic"))
    found = Recording(
        path=path,
        topic=topic,
        timestamp=np.array(stamps),
        frame_shape=shape,
        read=read,
        ours=ours and not colour,
        px_per_mm=scale,
    )
    if shape != found.seen_by(sensor).frame_shape:
        raise SpecError(other_shape(path, shape, found.seen_by(sensor)))
    return found


def _refused(path: Path, read: Callable[[], Iterator[Stamped]]) -> Iterator[Stamped]:
    """Iterate over a reader; any failure becomes a SpecError that names the file."""
    try:
        yield from read()
    except MissingLibraryError:
        raise
    except Exception as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> SpecError:
    if isinstance(error, SpecError):
        return SpecError([Problem("frames", f"{shown_path(path)}: {p.message}") for p in error.problems])
    reason = reason_of(error).split("\n", maxsplit=1)[0][:200] or type(error).__name__
    if isinstance(error, FrameError | ValueError | OSError):
        which = getattr(error, "filename", None) or path  # the one file of a folder
        return SpecError(Problem("frames", f"{shown_path(which)} cannot be read: {reason}; record it again, or give another"))
    remedy = "mcap recover FILE.mcap -o WHOLE.mcap saves what is whole" if _is_bag(path) else "record it again"
    return SpecError(Problem("frames", f"{shown_path(path)} is damaged ({type(error).__name__}: {reason}); {remedy}"))
