"""The ROS 2 node: depth images in; poses, whole answers, transforms and diagnostics out. rclpy is imported when it runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

from tactape_fab.base.errors import FrameError, Problem, SpecError, TactapeError, refuse, tried
from tactape_fab.base.fields import Fields
from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.sense.files.image_message import depth_of
from tactape_fab.sense.files.jobs import prepare_without_frames
from tactape_fab.sense.live.counts import Tally
from tactape_fab.sense.live.messages import FRAME_BY_NAME, header, pose_message, text_message, transform_message
from tactape_fab.sense.live.sources import Frame, Trouble
from tactape_fab.sense.live.watch import Watch, watch
from tactape_fab.texture.registry import refuse_equal_names

if TYPE_CHECKING:
    from tactape_fab.sense.files.jobs import Located

_NS = 1_000_000_000
_DIAGNOSED_S, _PATIENCE_S = 1.0, 0.1
_UNUSABLE = "image unusable"
_MOST_STAMPS = 10_000
"""Largest number of stamps kept: unusable images get no answer that would remove theirs, and a sensor may send nothing else."""
_OK, _WARN, _STALE = b"\x00", b"\x01", b"\x03"
"""Levels of diagnostic_msgs/DiagnosticStatus."""
PARAMETERS: Mapping[str, Any] = {
    "kits": ["tactape-s007"],
    "sensor": DEFAULT_SENSOR,
    "world": "open",
    "max_p_false": 1e-4,
    "frame_id": "",
    "sensor_frame": "",
    "publish_tf": True,
    "max_age_s": 0.0,
}
"""The node's parameters and their defaults; docs/ros2.md says what they mean."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Ros:
    """The modules and classes of ROS 2 that the node uses: public ones of Humble and later."""

    rclpy: Any
    clock: Any
    sensor_qos: Any
    image: Any
    pose: Any
    text: Any
    transform: Any
    diagnostics: Any
    broadcaster: Any
    filled: Any
    ended: tuple[type[BaseException], ...]
    other_type: type[Exception]


def _ros() -> _Ros:
    try:
        return _Ros(
            rclpy=import_module("rclpy"),
            clock=import_module("rclpy.clock"),
            sensor_qos=import_module("rclpy.qos").qos_profile_sensor_data,
            image=import_module("sensor_msgs.msg").Image,
            pose=import_module("geometry_msgs.msg").PoseWithCovarianceStamped,
            text=import_module("std_msgs.msg").String,
            transform=import_module("geometry_msgs.msg").TransformStamped,
            diagnostics=import_module("diagnostic_msgs.msg").DiagnosticArray,
            broadcaster=import_module("tf2_ros").TransformBroadcaster,
            filled=import_module("rosidl_runtime_py").set_message_fields,
            ended=(KeyboardInterrupt, import_module("rclpy.executors").ExternalShutdownException),
            other_type=import_module("rclpy.exceptions").InvalidParameterTypeException,
        )
    except ModuleNotFoundError as error:
        message = (
            f"the ROS 2 node needs {error.name}, which is not on this Python's path; source /opt/ros/DISTRO/setup.bash first"
        )
        raise TactapeError(message) from error


def run_ros2_node(arguments: Sequence[str] | None = None, **parameters: Any) -> None:
    """Run the node until it is told to end.

    Parameters
    ----------
    arguments : sequence of str, optional
        For rclpy, such as ``["--ros-args", "-r", "depth:=/gelsight/depth"]``; by default the program's own.
    **parameters
        Defaults of the node's parameters.

    Raises
    ------
    TactapeError
        When ROS 2 is not there, or the node's frames end it.
    SpecError
        For invalid parameters, all together.
    """
    ros = _ros()
    ros.rclpy.init(args=None if arguments is None else list(arguments))
    node = ros.rclpy.create_node("tactape")
    try:
        served = _Served(ros, node, {name: parameters.get(name, usual) for name, usual in PARAMETERS.items()})
        with served, suppress(*ros.ended):
            ros.rclpy.spin(node)
        if served.error is not None:
            raise served.error
    finally:
        node.destroy_node()
        ros.rclpy.try_shutdown()


class _Served:
    """The node's publishers, and the thread that locates."""

    def __init__(self, ros: _Ros, node: Any, usual: Mapping[str, Any]) -> None:
        self._ros, self._node = ros, node
        try:
            given = {name: node.declare_parameter(name, value).value for name, value in usual.items()}
        except ros.other_type as error:  # rclpy takes no whole number for a real one
            raise SpecError(Problem("parameter", f"{error}; give it as its default is written, such as 1.0 for 1")) from error
        self._most_age_s, self._watched = _read(given, self._frames)
        self._frame_id = given["frame_id"] or None
        self._sensor_frame = given["sensor_frame"] or self._watched.job.sensor.name
        self._tally, self._stop = Tally(), Event()
        self.error: Exception | None = None
        self._queue: SimpleQueue[Frame] = SimpleQueue()
        self._stamps: dict[int, int] = {}
        self._number = self._late = self._dropped = 0
        self._told = (0, 0, 0, 0)
        self._poses = node.create_publisher(ros.pose, "~/pose", 10)
        self._answers = node.create_publisher(ros.text, "~/fix", 10)
        self._health = node.create_publisher(ros.diagnostics, "/diagnostics", 10)
        self._transforms = ros.broadcaster(node) if given["publish_tf"] else None
        self._thread = Thread(target=self._locate, daemon=True, name="locate")

    def __enter__(self) -> None:
        self._thread.start()  # compiles; images that come before it is done are dropped but for the latest
        self._node.create_subscription(self._ros.image, "depth", self._take, self._ros.sensor_qos)
        clock = self._ros.clock
        # by the node's own clock, rclpy's default, it waits for the hour by which that was set back (ros2/rclpy#1490)
        steady = clock.Clock(clock_type=clock.ClockType.STEADY_TIME)
        self._node.create_timer(_DIAGNOSED_S, self._diagnose, clock=steady)

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _take(self, image: Any) -> None:
        """Subscription callback: hand the image to the locating thread."""
        number, self._number = self._number, self._number + 1
        stamp = image.header.stamp.sec * _NS + image.header.stamp.nanosec
        age_s = (self._node.get_clock().now().nanoseconds - stamp) / _NS
        if 0.0 < self._most_age_s < age_s:
            self._late += 1
            return
        try:
            depth = depth_of(image)
        except FrameError as error:
            self._tally.trouble(Trouble(kind=_UNUSABLE, message=f"frame {number}: {error}"))
            return
        # whole ns beside the frame: its float of seconds would not give them back
        self._stamps[number] = stamp
        if len(self._stamps) > _MOST_STAMPS:
            # in one call, as the other thread deletes as well
            for old in list(self._stamps)[: _MOST_STAMPS // 2]:
                self._stamps.pop(old, None)
        with suppress(Empty):  # nobody takes them while the locator compiles, and a minute of images fills a robot's memory
            self._queue.get_nowait()
            self._dropped += 1
        # 0 is a stamp that nobody set
        self._queue.put(Frame(number=number, image=depth, timestamp=stamp / _NS if stamp else None))

    def _frames(self, stop: Event) -> Iterator[Frame]:
        while not stop.is_set():
            try:
                yield self._queue.get(timeout=_PATIENCE_S)
            except Empty:
                continue

    def _locate(self) -> None:
        try:
            for located in watch(self._watched, self._tally, self._stop):
                if located is not None:
                    self._publish(located)
                for message in self._tally.unreported():  # the first of each kind: rclpy would throttle the other kinds with it
                    self._node.get_logger().warning(message)
        except Exception as error:
            if self._ros.rclpy.ok():  # else ROS was told to end meanwhile, and takes no messages any more
                self.error = error
        finally:
            if not self._stop.is_set() or self.error is not None:
                self._ros.rclpy.try_shutdown()

    def _publish(self, located: Located) -> None:
        stamp = self._stamps[located.frame]
        # frames that were dropped get no answer; their stamps go with the next one's
        for number in [number for number in list(self._stamps) if number <= located.frame]:
            self._stamps.pop(number, None)
        self._send(self._answers, self._ros.text, text_message(located.frame, located.fix))
        message = pose_message(located.fix, stamp, self._frame_id)
        if message is None:  # not located: no pose, and no transform, rather than a guess
            return
        self._send(self._poses, self._ros.pose, message)
        if self._transforms is not None:
            transform = self._ros.transform()
            self._ros.filled(transform, transform_message(message, self._sensor_frame))
            self._transforms.sendTransform(transform)

    def _send(self, publisher: Any, kind: Any, values: Mapping[str, Any]) -> None:
        message = kind()
        self._ros.filled(message, values)
        publisher.publish(message)

    def _diagnose(self) -> None:
        now_ns, tally = self._node.get_clock().now().nanoseconds, self._tally
        # other troubles are those, or holes in images that are used
        unusable = tally.unusable + tally.troubles.get(_UNUSABLE, 0)
        now = (tally.answered, self._number, unusable, self._late)
        answered, came, useless, late = (count - before for count, before in zip(now, self._told, strict=True))
        self._told = now
        level, message = _STALE, "no depth image in the last second"
        if answered:
            level, message = _OK, f"{answered} answers in the last second"
        elif came:
            level, message = _WARN, f"no answer in the last second; depth images: {came}"
        for count, what in ((useless, "unusable"), (late, "late, by max_age_s")):
            if count:
                level, message = _WARN, f"{message}; {what}: {count}"
        values = {
            "answered": tally.answered,
            "located": tally.located,
            "dropped": tally.dropped + self._dropped,
            "late": self._late,
            "unusable": unusable,
            "latency_ms_p50": f"{tally.latencies.percentile_ms(50):.2f}",
            "latency_ms_p99": f"{tally.latencies.percentile_ms(99):.2f}",
        }
        status = {
            "level": level,
            "name": f"{self._node.get_name()}: {self._watched.job.sensor.name}",
            "message": message,
            "hardware_id": self._sensor_frame,
            "values": [{"key": key, "value": str(value)} for key, value in values.items()],
        }
        self._send(self._health, self._ros.diagnostics, {"header": header(now_ns, ""), "status": [status]})


def _read(given: Mapping[str, Any], source: Any) -> tuple[float, Watch]:
    """The most that an image may be old (s; 0: any), and what is watched. Raises SpecError with every invalid parameter."""
    table = Fields(given, "parameter ")
    most_age_s = table.number("max_age_s", low=0.0, high=3600.0, unit="s")
    problems: list[Problem] = table.problems
    settings = {name: given[name] for name in ("world", "max_p_false")}
    job = prepare_without_frames(list(given["kits"]), given["sensor"], problems, **settings)
    if job is not None and not given["frame_id"]:
        tried(lambda: refuse_equal_names(job.tapes, FRAME_BY_NAME), problems)
    refuse(problems)
    assert job is not None
    return most_age_s, Watch(job=job, source=source)
