"""The ROS 2 node and its generated package, run against rosbags' message classes and a stub of rclpy's public interface.

No ROS is here. The stub has what the node uses of rclpy, tf2_ros and rosidl_runtime_py, as their documentation has it; messages
are rosbags' classes of the distribution, so that a field which is not there, or of another type, fails.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner
from rosbags.typesys import Stores, get_typestore

from tactape_fab import FrameError, Kit, SpecError, TactapeError
from tactape_fab.base.templates import templates_folder
from tactape_fab.cli import main
from tactape_fab.sense import image_message, simulate_frames
from tactape_fab.sense.files.image_message import PIXELS, depth_of
from tactape_fab.sense.live import ros2_node
from tactape_fab.sense.live.messages import UNMEASURED
from tactape_fab.sense.live.ros2_node import PARAMETERS, run_ros2_node
from tactape_fab.sense.live.ros2_package import DEPENDENCIES, MEANINGS, package_files, write_package
from tests.live import SENSOR

STAMP = 1_763_800_000_123_456_789
STORES = {"humble": get_typestore(Stores.ROS2_HUMBLE), "jazzy": get_typestore(Stores.ROS2_JAZZY)}
PATIENCE_S = 60.0


# Messages


def message(store: Any, kind: str, **given: Any) -> Any:
    """A message as ROS makes one: every field there, numbers zero."""
    values = {}
    details: Any
    for name, (what, details) in store.get_msgdef(kind).fields:
        if what.name == "NAME":
            values[name] = message(store, details)
        elif what.name == "BASE":
            usual: Any = 0.0 if details[0].startswith("float") else 0
            values[name] = {"string": "", "bool": False}.get(details[0], usual)
        elif details[0][0].name == "NAME":
            values[name] = []
        else:
            values[name] = np.zeros(details[1] or 0, dtype={"float64": np.float64}.get(details[0][1][0], np.uint8))
    return store.types[kind](**{**values, **given})


def set_fields(store: Any) -> Callable[[Any, dict[str, Any]], None]:
    """As rosidl_runtime_py's set_message_fields: fields that are not there, or of another type, are refused."""

    def fill(target: Any, values: dict[str, Any]) -> None:
        kinds = dict(store.get_msgdef(target.__msgtype__).fields)
        names = {field.name for field in fields(target)}
        for name, value in values.items():
            assert name in names, name
            old = getattr(target, name)
            if isinstance(value, dict):
                fill(old, value)
            elif isinstance(old, np.ndarray):
                assert old.shape in (np.shape(value), (0,))
                object.__setattr__(target, name, np.array(value, dtype=old.dtype))
            elif isinstance(old, list):
                kind = kinds[name][1][0][1]
                object.__setattr__(target, name, [message(store, kind) for _ in value])
                for element, content in zip(getattr(target, name), value, strict=True):
                    fill(element, content)
            elif isinstance(value, bytes):  # a ROS byte is bytes of one in Python, and a number in rosbags
                assert len(value) == 1
                object.__setattr__(target, name, value[0])
            else:
                assert type(value) is type(old), (name, value)
                object.__setattr__(target, name, value)

    return fill


# rclpy


class Node:
    """What the node uses of rclpy's."""

    def __init__(self, name: str, given: dict[str, Any]) -> None:
        self.name, self.given = name, given
        self.published: list[tuple[str, Any]] = []
        self.warnings: list[str] = []
        self.throttled_s = float("-inf")
        self.callback: Any = None
        self.timers: list[Any] = []
        self.destroyed = False
        self.now_ns = STAMP

    def declare_parameter(self, name: str, value: Any) -> SimpleNamespace:
        assert value != []  # rclpy cannot tell its type
        given = self.given.get(name, value)
        if type(given) is not type(value):
            said = f"Trying to set parameter '{name}' to '{given}' of type '{type(given)}', expecting type '{type(value)}'"
            raise InvalidParameterTypeException(said)
        return SimpleNamespace(value=given)

    def create_publisher(self, kind: Any, topic: str, depth: int) -> SimpleNamespace:
        return SimpleNamespace(publish=lambda sent: self.published.append((topic, sent)))

    def create_subscription(self, kind: Any, topic: str, callback: Any, qos: Any) -> None:
        assert (topic, qos) == ("depth", "sensor data")
        self.callback = callback

    def create_timer(self, seconds: float, callback: Any, *, clock: Any = None) -> None:
        assert (seconds, clock) == (1.0, "steady")  # any other stands still while the system's is set back
        self.timers.append(callback)

    def get_clock(self) -> SimpleNamespace:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now_ns))

    def get_name(self) -> str:
        return self.name

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(warning=self._warn)

    def _warn(self, said: str, throttle_duration_sec: float = 0.0) -> None:
        """As rclpy's logger, which throttles by the line that calls it, whatever the message."""
        if time.monotonic() >= self.throttled_s + throttle_duration_sec:
            self.throttled_s = time.monotonic()
            self.warnings.append(said)

    def destroy_node(self) -> None:
        self.destroyed = True

    def of(self, topic: str) -> list[Any]:
        return [sent for place, sent in self.published if place == topic]

    def wait(self, topic: str, count: int) -> None:
        end = time.monotonic() + PATIENCE_S
        while len(self.of(topic)) < count and time.monotonic() < end:
            time.sleep(0.01)
        assert len(self.of(topic)) >= count, self.warnings

    def health(self, answered: int) -> None:
        """The timer's message when so many answers are counted, which is after they are published."""
        end = time.monotonic() + PATIENCE_S
        while True:
            self.timers[0]()
            (counted,) = (entry.value for entry in self.published[-1][1].status[0].values if entry.key == "answered")
            if int(counted) >= answered or time.monotonic() > end:
                return
            self.published.pop()
            time.sleep(0.01)


class ExternalShutdownException(Exception):  # noqa: N818
    """As rclpy's."""


class InvalidParameterTypeException(Exception):  # noqa: N818
    """As rclpy's, which declares no parameter whose value was given in another type."""


@contextmanager
def ros(monkeypatch: pytest.MonkeyPatch, store: Any, spin: Callable[[Node], None], given: dict[str, Any]) -> Iterator[list[Any]]:
    """The modules of ROS; gives the list of arguments that rclpy was started with, then its node."""
    seen: list[Any] = []

    def create_node(name: str) -> Node:
        seen.append(Node(name, given))
        node: Node = seen[-1]
        return node

    def broadcaster(of: Node) -> SimpleNamespace:
        return SimpleNamespace(sendTransform=lambda sent: of.published.append(("tf", sent)))

    def init(args: list[str]) -> None:
        seen.append(args)

    def kind(name: str) -> Any:
        return lambda **values: message(store, name, **values)

    packages = {
        "geometry_msgs": ("PoseWithCovarianceStamped", "TransformStamped"),
        "sensor_msgs": ("Image",),
        "std_msgs": ("String",),
        "diagnostic_msgs": ("DiagnosticArray",),
    }
    modules: dict[str, dict[str, Any]] = {
        "rclpy": {
            "init": init,
            "spin": spin,
            "create_node": create_node,
            "try_shutdown": lambda: None,
            "ok": lambda: True,
        },
        "rclpy.clock": {"Clock": lambda *, clock_type: clock_type, "ClockType": SimpleNamespace(STEADY_TIME="steady")},
        "rclpy.qos": {"qos_profile_sensor_data": "sensor data"},
        "rclpy.exceptions": {"InvalidParameterTypeException": InvalidParameterTypeException},
        "rclpy.executors": {"ExternalShutdownException": ExternalShutdownException},
        "rosidl_runtime_py": {"set_message_fields": set_fields(store)},
        "tf2_ros": {"TransformBroadcaster": broadcaster},
        **{f"{package}.msg": {name: kind(f"{package}/msg/{name}") for name in names} for package, names in packages.items()},
    }
    for name, contents in modules.items():
        module = ModuleType(name)
        module.__dict__.update(contents)
        monkeypatch.setitem(sys.modules, name, module)
        top = name.partition(".")[0]
        monkeypatch.setitem(sys.modules, top, sys.modules.get(top, ModuleType(top)))
    yield seen


def depth_message(store: Any, depth: np.ndarray[Any, Any], stamp: int = STAMP, **others: Any) -> Any:
    sent = message(store, "sensor_msgs/msg/Image")
    values = image_message(depth, SENSOR, stamp, "camera")
    set_fields(store)(sent, {**values, "data": np.frombuffer(values["data"], dtype=np.uint8), **others})
    return sent


def stamp_of(header: Any) -> int:
    return int(header.stamp.sec * 10**9 + header.stamp.nanosec)


def run(
    monkeypatch: pytest.MonkeyPatch, spin: Callable[[Node], None], distribution: str = "humble", **given: Any
) -> tuple[Any, Node]:
    """Run the node to the end of `spin`."""
    with ros(monkeypatch, STORES[distribution], spin, given) as seen:
        run_ros2_node(["tactape-fab", "--ros-args"])
        arguments, node = seen
    assert node.destroyed
    return arguments, node


# The node


@pytest.mark.parametrize("distribution", sorted(STORES))
def test_a_located_image_is_published_three_ways(default_kit: Kit, monkeypatch: pytest.MonkeyPatch, distribution: str) -> None:
    frames, store = simulate_frames(default_kit.tape, 1, seed=3), STORES[distribution]

    def spin(node: Node) -> None:
        node.callback(depth_message(store, frames.depth[0]))
        node.wait("tf", 1)
        node.health(1)
        raise KeyboardInterrupt

    arguments, node = run(monkeypatch, spin, distribution, kits=[str(default_kit.path)], sensor_frame="finger")
    assert arguments == ["tactape-fab", "--ros-args"]
    assert [topic for topic, _ in node.published] == ["~/fix", "~/pose", "tf", "/diagnostics"]
    answer, pose, transform, health = (sent for _, sent in node.published)
    assert json.loads(answer.data)["located"] is True
    assert stamp_of(pose.header) == stamp_of(transform.header) == STAMP  # to the nanosecond, which a float does not hold
    assert (pose.header.frame_id, transform.header.frame_id, transform.child_frame_id) == (
        "tactape-s007",
        "tactape-s007",
        "finger",
    )
    x0, y0 = default_kit.tape.board.texture_origin_mm
    x, y = frames.position_mm[0]
    at = pose.pose.pose.position
    np.testing.assert_allclose([at.x, at.y, at.z], [(x0 + x) / 1000, (y0 - y) / 1000, 0.0], atol=5e-5)
    assert (transform.transform.translation.x, transform.transform.translation.y) == (at.x, at.y)
    assert transform.transform.rotation.w == pose.pose.pose.orientation.w != 1.0
    assert 0.0 < pose.pose.covariance[0] < 1e-8 and pose.pose.covariance[14] == UNMEASURED
    assert (stamp_of(health.header), health.header.frame_id) == (node.now_ns, "")
    (status,) = health.status
    values = {entry.key: entry.value for entry in status.values}
    assert (status.level, values["answered"], values["located"], values["dropped"]) == (0, "1", "1", "0")
    assert float(values["latency_ms_p50"]) > 0.0
    for sent, kind in ((pose, "geometry_msgs/msg/PoseWithCovarianceStamped"), (health, "diagnostic_msgs/msg/DiagnosticArray")):
        assert store.serialize_cdr(sent, kind)
    assert store.serialize_cdr(transform, "geometry_msgs/msg/TransformStamped")


def test_what_is_not_located_has_an_answer_and_no_pose_and_a_stamp_that_nobody_set_is_no_time(
    default_kit: Kit, monkeypatch: pytest.MonkeyPatch
) -> None:
    def spin(node: Node) -> None:
        node.callback(depth_message(STORES["humble"], np.zeros((240, 320), dtype=np.float32), 0))
        node.wait("~/fix", 1)
        raise ExternalShutdownException

    _, node = run(monkeypatch, spin, kits=[str(default_kit.path)])
    assert [topic for topic, _ in node.published] == ["~/fix"] and node.warnings == []
    assert json.loads(node.of("~/fix")[0].data)["timestamp"] is None


def test_images_that_come_too_fast_or_too_late_are_dropped_and_counted(default_kit: Kit, monkeypatch: pytest.MonkeyPatch) -> None:
    depth, store = simulate_frames(default_kit.tape, 1, seed=3).depth[0], STORES["humble"]

    def spin(node: Node) -> None:
        node.callback(depth_message(store, depth))
        node.wait("~/fix", 1)
        for k in range(1, 200):
            node.callback(depth_message(store, depth, STAMP + k))
        while json.loads(node.of("~/fix")[-1].data)["frame"] < 199:
            time.sleep(0.01)
        node.callback(depth_message(store, depth, STAMP - 2 * 10**9))
        node.timers[0]()
        raise KeyboardInterrupt

    _, node = run(monkeypatch, spin, kits=[str(default_kit.path)], max_age_s=1.0, publish_tf=False)
    answered, poses = node.of("~/fix"), node.of("~/pose")
    assert len(poses) == len(answered) < 150 and node.of("tf") == []
    for answer, pose in zip(answered, poses, strict=True):  # each pose has the stamp of its own image
        assert stamp_of(pose.header) == STAMP + json.loads(answer.data)["frame"]
    (health,) = node.of("/diagnostics")[0].status
    values = {entry.key: entry.value for entry in health.values}
    assert int(values["dropped"]) == 200 - len(answered) and values["late"] == "1"
    assert health.level == 1 and health.message.endswith("in the last second; late, by max_age_s: 1")


def test_images_that_cannot_be_used_are_said(default_kit: Kit, monkeypatch: pytest.MonkeyPatch) -> None:
    store = STORES["humble"]

    def spin(node: Node) -> None:
        node.callback(depth_message(store, np.zeros((240, 320), dtype=np.float32), encoding="rgb8"))
        node.callback(depth_message(store, np.zeros((24, 320), dtype=np.float32)))
        holes = np.zeros((240, 320), dtype=np.float32)
        holes[:9] = np.nan
        while len(node.warnings) < 2 and time.monotonic() < start + PATIENCE_S:  # before the next takes its place
            time.sleep(0.01)
        node.callback(depth_message(store, holes))
        end = time.monotonic() + PATIENCE_S
        while len(node.warnings) < 3 and time.monotonic() < end:
            time.sleep(0.01)
        node.health(1)
        node.timers[0]()
        raise KeyboardInterrupt

    start = time.monotonic()
    _, node = run(monkeypatch, spin, kits=[str(default_kit.path)])
    assert "encoding is 'rgb8'" in node.warnings[0] and "(24, 320)" in node.warnings[1] and "holes" in node.warnings[2]
    health, later = node.of("/diagnostics")[-2:]
    assert later.status[0].message == "no depth image in the last second"
    assert {"unusable": "2"}.items() <= {v.key: v.value for v in health.status[0].values}.items()


def test_images_that_never_get_an_answer_leave_no_stamps_behind(default_kit: Kit, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros2_node, "_MOST_STAMPS", 10)
    kept: list[int] = []

    def spin(node: Node) -> None:
        for k in range(50):
            node.callback(depth_message(STORES["humble"], np.zeros((24, 320), dtype=np.float32), STAMP + k))
            kept.append(len(node.callback.__self__._stamps))
        raise KeyboardInterrupt

    run(monkeypatch, spin, kits=[str(default_kit.path)])
    assert max(kept) == 10


def test_images_that_come_while_the_locator_compiles_are_not_kept(default_kit: Kit, monkeypatch: pytest.MonkeyPatch) -> None:
    """A minute of them, at 60 Hz, takes gigabytes."""
    monkeypatch.setattr(ros2_node, "watch", lambda *_: iter(()))  # takes none

    def spin(node: Node) -> None:
        for k in range(50):
            node.callback(depth_message(STORES["humble"], np.zeros((240, 320), dtype=np.float32), STAMP + k))
        served = node.callback.__self__
        assert (served._queue.qsize(), served._queue.get().number) == (1, 49)
        node.timers[0]()
        node.timers[0]()
        raise KeyboardInterrupt

    _, node = run(monkeypatch, spin, kits=[str(default_kit.path)])
    (first,), (second,) = (sent.status for sent in node.of("/diagnostics"))
    assert {"dropped": "49"}.items() <= {v.key: v.value for v in first.values}.items()
    assert (first.level, first.message) == (1, "no answer in the last second; depth images: 50")
    assert (second.level, second.message) == (3, "no depth image in the last second")


def test_parameters_that_cannot_be_used_are_said_together(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SpecError) as refused:
        run(monkeypatch, lambda node: None, kits=["no-such-kit"], sensor="no-such-sensor", max_p_false=2.0, max_age_s=-1.0)
    said = str(refused.value)
    for word in ("no-such-kit", "no-such-sensor", "max_p_false", "max_age_s"):
        assert word in said


def test_a_parameter_of_another_type_is_said(default_kit: Kit, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SpecError, match=r"'max_age_s' to '1' .*; give it as its default is written, such as 1\.0 for 1"):
        run(monkeypatch, lambda node: None, kits=[str(default_kit.path)], max_age_s=1)


def test_what_ends_the_thread_ends_the_node_with_its_reason(default_kit: Kit, monkeypatch: pytest.MonkeyPatch) -> None:
    def spin(node: Node) -> None:
        monkeypatch.setattr("tactape_fab.sense.live.ros2_node.text_message", lambda *_: 1 / 0)
        node.callback(depth_message(STORES["humble"], np.zeros((240, 320), dtype=np.float32)))
        time.sleep(1.0)

    with pytest.raises(ZeroDivisionError):
        run(monkeypatch, spin, kits=[str(default_kit.path)])


def test_without_ros_it_says_what_to_do() -> None:
    with pytest.raises(TactapeError, match=r"needs rclpy, .*source /opt/ros/DISTRO/setup.bash"):
        run_ros2_node([])


# Images


def image(kind: str, array: np.ndarray[Any, Any], big: bool = False, padding: int = 0) -> SimpleNamespace:
    """An image with rows that are longer than their pixels."""
    pixels = array.astype((">" if big else "<") + PIXELS[kind])
    rows = np.pad(pixels.view(np.uint8).reshape(len(array), -1), ((0, 0), (0, padding)), constant_values=255)
    height, width = array.shape
    return SimpleNamespace(
        encoding=kind, is_bigendian=int(big), height=height, width=width, step=rows.shape[1], data=rows.tobytes()
    )


@pytest.mark.parametrize("kind", sorted(PIXELS))
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("padding", [0, 3])
def test_every_encoding_is_read(kind: str, big: bool, padding: int) -> None:
    depth = np.arange(12.0).reshape(3, 4) * 20
    found = depth_of(image(kind, depth, big, padding))
    assert (found == depth).all() and found.dtype.isnative


@pytest.mark.parametrize(
    "wrong", [{"height": 4}, {"width": 5}, {"step": 3}, {"height": 0}, {"encoding": "64FC1"}, {"data": b""}, {"encoding": "\n"}]
)
def test_an_image_that_contradicts_itself_is_refused(wrong: dict[str, Any]) -> None:
    sent = image("32FC1", np.zeros((3, 4)))
    vars(sent).update(wrong)
    with pytest.raises(FrameError):
        depth_of(sent)


# The package


def test_the_generated_package_is_whole(default_kit: Kit, tmp_path: Path) -> None:
    folder = tmp_path / "tactape_node"
    arguments = ["ros2", "--tape", str(default_kit.path), "--sensor", "digit", "--package", str(folder)]
    run = CliRunner().invoke(main, arguments)
    assert run.exit_code == 0, run.output
    written = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert {str(Path(line).relative_to(folder)) for line in run.stdout.splitlines()} == written
    root = ElementTree.parse(folder / "package.xml").getroot()
    assert root.get("format") == "3" and root.findtext("name") == "tactape_node"
    assert [entry.text for entry in root.findall("exec_depend")] == list(DEPENDENCIES)
    assert root.findtext("export/build_type") == "ament_python"
    installed = (folder / "setup.py").read_text()
    for path in ("resource/tactape_node", "launch/tactape.launch.py", "config/tactape.yaml", "package.xml"):
        assert path in written and f'"{path}"' in installed
    again = CliRunner().invoke(main, arguments)
    assert again.exit_code == 2 and "nothing is written over" in again.output


def test_all_kits_behind_tape_are_the_node_s(default_kit: Kit, small_kit: Kit, tmp_path: Path) -> None:
    """As in `decode --tape A B`: the second was left to rclpy, which passes over what it does not know."""
    arguments = ["ros2", "--tape", str(default_kit.path), str(small_kit.path), "--package", str(tmp_path / "node")]
    run = CliRunner().invoke(main, arguments)
    assert run.exit_code == 0, run.output
    settings = (tmp_path / "node" / "config" / "tactape.yaml").read_text()
    assert f"kits: {json.dumps([str(default_kit.path.resolve()), str(small_kit.path.resolve())])}" in settings


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--tape KIT --sensr digit", "'--sensr' is no option of ros2; give parameters of the node as --ros-args -p"),
        ("--tape KIT -p world:=closed", "'-p' is no option of ros2"),
        ("KIT", "stands without an option; give kits as --tape KIT"),
        ("--tape KIT --package node --ros-args -p world:=closed", "--ros-args is for a node that runs"),
    ],
)
def test_what_is_for_nobody_is_refused(words: str, said: str, default_kit: Kit) -> None:
    run = CliRunner().invoke(main, ["ros2", *(str(default_kit.path) if word == "KIT" else word for word in words.split())])
    assert run.exit_code == 2 and said in run.output


def test_a_sensor_of_one_s_own_is_found_from_any_folder(default_kit: Kit, here: Path) -> None:
    Path("mine.toml").write_text((templates_folder() / "sensors" / "digit.toml").read_text())
    arguments = ["ros2", "--tape", str(default_kit.path), "--sensor", "mine.toml", "--package", "tactape_node"]
    assert CliRunner().invoke(main, arguments).exit_code == 0
    assert f'sensor: "{here}/mine.toml"' in Path("tactape_node/config/tactape.yaml").read_text()


def test_its_parameters_are_those_of_the_node(tmp_path: Path) -> None:
    yaml = pytest.importorskip("yaml")
    text = package_files("it", {**PARAMETERS, "kits": ["/a b/c", 'quo"ted']})["config/tactape.yaml"]
    assert yaml.safe_load(text) == {"tactape": {"ros__parameters": {**PARAMETERS, "kits": ["/a b/c", 'quo"ted']}}}
    assert MEANINGS.keys() == PARAMETERS.keys()


def test_its_scripts_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """setup.py, node and launch file, with setuptools and launch in place of which their calls are noted."""
    files = package_files("it", PARAMETERS)
    calls: list[tuple[str, Any, dict[str, Any]]] = []

    def noted(name: str) -> Any:
        def note(*args: Any, **named: Any) -> str:
            calls.append((name, args, named))
            return name

        return note

    stubs = {
        "setuptools": ["setup"],
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument"],
        "launch.substitutions": ["LaunchConfiguration", "PathJoinSubstitution"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
        "launch_ros.substitutions": ["FindPackageShare"],
    }
    for name, contents in stubs.items():
        module = ModuleType(name)
        module.__dict__.update({one: noted(one) for one in contents})
        monkeypatch.setitem(sys.modules, name, module)
    exec(compile(files["setup.py"], "setup.py", "exec"), {})
    assert calls.pop()[2]["entry_points"] == {"console_scripts": ["node = it.node:main"]}
    space: dict[str, Any] = {}
    exec(compile(files["launch/tactape.launch.py"], "launch", "exec"), space)
    space["generate_launch_description"]()
    (node,) = [named for name, _, named in calls if name == "Node"]
    assert (node["package"], node["executable"], node["name"]) == ("it", "node", "tactape")
    exec(compile(files["it/node.py"], "node", "exec"), space)
    assert space["run_ros2_node"] is run_ros2_node and callable(space["main"])


@pytest.mark.parametrize("name", ["Tactape", "tactape-node", "7tapes", "tactape__node"])
def test_a_name_that_ros_does_not_take_is_refused(name: str, tmp_path: Path) -> None:
    run = CliRunner().invoke(main, ["ros2", "--package", str(tmp_path / name)])
    assert run.exit_code == 2 and "no name of a ROS package" in run.output and not (tmp_path / name).exists()


def test_a_package_that_cannot_be_written_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its name would be refused as taken when there is room again."""
    monkeypatch.setattr("tactape_fab.sense.live.ros2_package.package_files", lambda *_: {"first": "", "first/second": ""})
    with pytest.raises(TactapeError, match="cannot be written"):
        write_package(tmp_path / "touch_node", {})
    assert list(tmp_path.iterdir()) == []
    monkeypatch.undo()
    assert sorted(write_package(tmp_path / "touch_node", {})) == sorted(
        path.relative_to(tmp_path / "touch_node").as_posix() for path in tmp_path.rglob("*") if path.is_file()
    )
