"""What the tests of live sources share: sources read to their end, and a locator that takes no time."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab import Localization
from tactape_fab.base.errors import FrameError
from tactape_fab.sense import SensorProfile, load_sensor
from tactape_fab.sense.files.jobs import Job, Locate
from tactape_fab.sense.live.sources import Frame, Source, Trouble

SENSOR = load_sensor("gelsight-mini")
SHAPE = SENSOR.frame_shape
JOB = Job(files=(), sensor=SENSOR, tapes=(), code=None, settings={})


def read(source: Source) -> tuple[list[Frame], list[Trouble]]:
    """Everything that a source has, which must end of itself."""
    found = list(source(Event()))
    return [f for f in found if isinstance(f, Frame)], [t for t in found if isinstance(t, Trouble)]


def ramp(k: int) -> npt.NDArray[np.float32]:
    """A frame that can be told from others: its values are k and more."""
    return (k + np.linspace(0.0, 0.5, SHAPE[0] * SHAPE[1]).reshape(SHAPE)).astype(np.float32)


def npy(array: npt.ArrayLike) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.asarray(array))
    return stream.getvalue()


def save_npz(path: Path, frames: Sequence[npt.NDArray[Any]], **others: Any) -> Path:
    np.savez(path, depth=np.stack(frames), **others)
    return path


def at_once(job: Job, sensor: SensorProfile) -> Locate:
    """A locator whose answer is the frame's first value as x; frames of another shape it refuses."""

    def locate(depth: npt.ArrayLike, *, timestamp: float | None = None) -> Localization:
        frame = np.asarray(depth)
        if frame.shape != sensor.frame_shape:
            raise FrameError(f"a frame of shape {frame.shape}")
        return Localization(status="solid", located=True, position_mm=(float(frame.flat[0]), 0.0), timestamp=timestamp)

    return locate
