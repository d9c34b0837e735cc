"""Answers as an MCAP file that ROS 2 tools, Foxglove and rosbags read: pose, depth image and the whole answer of every frame."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from tactape_fab.base.errors import TactapeError, reason_of
from tactape_fab.base.fields import shown_path
from tactape_fab.base.version import __version__
from tactape_fab.sense.files.jobs import Located
from tactape_fab.sense.files.recording_kinds import SCALE, UPRIGHT
from tactape_fab.sense.live.cdr import IMAGE, MessageType
from tactape_fab.sense.live.topics import DEPTH_TOPIC, TOPICS, Naming, encoded, topic_of

_CHUNK_BYTES = 1 << 20
"""Bytes a killed process may lose: three frames of a GelSight Mini."""


class McapLog:
    """A file that is written as answers come; what is complete of it can be read however the process ends.

    path: Must not be there.
    sensors: Names of several sensors, which have topics of their own.
    Raises TactapeError when it cannot be written.
    """

    def __init__(self, path: Path, naming: Naming = Naming(), sensors: Sequence[str] = ("",)) -> None:  # noqa: B008 (frozen)
        from mcap.writer import CompressionType, Writer

        self.path, self._naming = path, naming
        self._writer: Any = None
        try:
            self._stream = path.open("xb")
            writer: Any = Writer(self._stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.NONE)
            writer.start(profile="ros2", library=f"tactape-fab {__version__}")
            named = [(topic_of(topic, sensor), kind) for sensor in sensors for topic, kind in TOPICS.items()]
            self._channels: dict[tuple[str, Any], int] = {(topic, None): _channel(writer, topic, kind) for topic, kind in named}
            self._writer = writer
        except OSError as error:
            raise self._failed(error) from error

    def __enter__(self) -> McapLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, located: Located, sensor: str = "") -> bool:
        """Write a frame and its answer; no pose where there is none. False, and nothing written, where it has no capture time.

        Raises TactapeError when it cannot be written.
        """
        found = encoded(located, self._naming, sensor)
        if found is None:
            return False
        stamp, messages = found
        try:
            for topic, data in messages:
                # a scale is that of the images: a file's own has a channel that says it
                of = topic, located.px_per_mm if topic == topic_of(DEPTH_TOPIC, sensor) else None
                if of not in self._channels:
                    self._channels[of] = _channel(self._writer, topic, IMAGE, of[1])
                self._add(self._channels[of], stamp, located.frame, data)
            self._stream.flush()
        except OSError as error:
            raise self._failed(error) from error
        return True

    def close(self) -> None:
        """Write the index and close the file; it can be read without, too."""
        if self._writer is None:
            return
        writer, self._writer = self._writer, None
        try:
            writer.finish()
            self._stream.close()
        except OSError as error:
            raise self._failed(error) from error

    def _add(self, channel: int, stamp: int, frame: int, data: bytes) -> None:
        self._writer.add_message(channel, log_time=stamp, publish_time=stamp, sequence=frame % 2**32, data=data)

    def _failed(self, error: OSError) -> TactapeError:
        self._writer = None
        remedy = "use another place"
        if hasattr(self, "_stream"):
            remedy = "what is in it can be read"
            with suppress(OSError):
                self._stream.close()
        return TactapeError(f"mcap {shown_path(self.path)} cannot be written: {reason_of(error)}; {remedy}")


def _channel(writer: Any, topic: str, kind: MessageType, scale: tuple[float, float] | None = None) -> int:
    schema = writer.register_schema(name=kind.name, encoding="ros2msg", data=kind.definition.encode())
    metadata = {"offered_qos_profiles": "", **({UPRIGHT[0]: UPRIGHT[1]} if kind is IMAGE else {})}
    if scale is not None:
        metadata[SCALE] = f"{scale[0]!r} {scale[1]!r}"
    return int(writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema, metadata=metadata))
