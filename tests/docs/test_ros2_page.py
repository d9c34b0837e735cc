"""The node of docs/ros2.md, run with messages of rosbags' classes in place of ROS: the API it uses, and what it publishes."""

from __future__ import annotations

import re
import sys
from dataclasses import fields
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from tactape_fab import Kit
from tactape_fab.sense import image_message, simulate_frames
from tactape_fab.sense.live.messages import UNMEASURED
from tests.live import SENSOR

PAGE = Path(__file__).parents[2] / "docs" / "ros2.md"
STORE = get_typestore(Stores.ROS2_HUMBLE)
STAMP = 1_763_800_000_123_456_789


def node_source() -> str:
    (source,) = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return str(source)


def message(kind: str, **given: Any) -> Any:
    """A message as ROS makes one: every field there, numbers zero."""
    values = {}
    details: Any
    for name, (what, details) in STORE.get_msgdef(kind).fields:
        if what.name == "NAME":
            values[name] = message(details)
        elif what.name == "BASE":
            values[name] = {"string": "", "bool": False}.get(details[0], 0.0 if details[0].startswith("float") else 0)
        else:
            values[name] = np.zeros(details[1] or 0, dtype={"float64": np.float64}.get(details[0][1][0], np.uint8))
    return STORE.types[kind](**{**values, **given})


def set_fields(target: Any, values: dict[str, Any]) -> None:
    """As rosidl_runtime_py does: fields that are not there, or of another type, are refused."""
    names = {field.name for field in fields(target)}
    for name, value in values.items():
        assert name in names, name
        old = getattr(target, name)
        if isinstance(value, dict):
            set_fields(old, value)
        elif isinstance(old, np.ndarray):
            assert old.shape in (np.shape(value), (0,))
            setattr(target, name, np.array(value, dtype=old.dtype))
        else:
            assert type(value) is type(old), (name, value)
            object.__setattr__(target, name, value)


class Node:
    """What of rclpy's node the page uses."""

    parameters: dict[str, Any] = {}  # noqa: RUF012

    def __init__(self, name: str) -> None:
        self.published: list[tuple[str, Any]] = []
        self.errors: list[str] = []
        self.callback: Any = None

    def declare_parameter(self, name: str, value: Any) -> SimpleNamespace:
        return SimpleNamespace(value=self.parameters.get(name, value))

    def create_publisher(self, kind: Any, topic: str, depth: int) -> SimpleNamespace:
        return SimpleNamespace(publish=lambda sent: self.published.append((topic, sent)))

    def create_subscription(self, kind: Any, topic: str, callback: Any, qos: Any) -> None:
        assert (topic, qos["depth"]) == ("depth", 1)
        self.callback = callback

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(error=lambda said, throttle_duration_sec: self.errors.append(said))


@pytest.fixture
def node(default_kit: Kit, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The page's node, started on the default tape."""
    made: list[Any] = []

    def kind(name: str) -> Any:
        return lambda **given: message(name, **given)

    def broadcaster(of: Any) -> SimpleNamespace:
        return SimpleNamespace(sendTransform=lambda sent: of.published.append(("tf", sent)))

    messages = {
        "geometry_msgs": ("PoseWithCovarianceStamped", "TransformStamped"),
        "sensor_msgs": ("Image",),
        "std_msgs": ("String",),
    }
    policy = SimpleNamespace(KEEP_LAST=1, BEST_EFFORT=2)
    modules: dict[str, dict[str, Any]] = {
        "rclpy": {"init": lambda: None, "spin": made.append},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {"QoSProfile": dict, "HistoryPolicy": policy, "ReliabilityPolicy": policy},
        "rosidl_runtime_py": {"set_message_fields": set_fields},
        "tf2_ros": {"TransformBroadcaster": broadcaster},
        **{f"{package}.msg": {name: kind(f"{package}/msg/{name}") for name in names} for package, names in messages.items()},
    }  # fmt: skip
    for name, contents in modules.items():
        module = ModuleType(name)
        module.__dict__.update(contents)
        monkeypatch.setitem(sys.modules, name, module)
        if "." in name:
            monkeypatch.setitem(
                sys.modules, name.partition(".")[0], sys.modules.get(name.partition(".")[0], ModuleType("package"))
            )
    monkeypatch.setattr(Node, "parameters", {"kits": [str(default_kit.path)], "sensor_frame": "finger"})
    exec(compile(node_source(), str(PAGE), "exec"), {"__name__": "__main__"})
    return made[0]


def depth_message(depth: np.ndarray[Any, Any], **others: Any) -> Any:
    sent = message("sensor_msgs/msg/Image")
    values = image_message(depth, SENSOR, STAMP, "camera")
    set_fields(sent, {**values, "data": np.frombuffer(values["data"], dtype=np.uint8), **others})
    return sent


def test_it_is_as_short_as_it_is_said_to_be() -> None:
    assert len(node_source().splitlines()) <= 80


def test_a_located_image_is_published_three_ways(node: Any, default_kit: Kit) -> None:
    frames = simulate_frames(default_kit.tape, 1, seed=3)
    node.callback(depth_message(frames.depth[0]))
    assert [topic for topic, _ in node.published] == ["~/fix", "~/pose", "tf"]
    answer, pose, transform = (sent for _, sent in node.published)
    assert '"frame": 0' in answer.data and '"located": true' in answer.data
    assert pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec == STAMP
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
    assert STORE.serialize_cdr(pose, "geometry_msgs/msg/PoseWithCovarianceStamped")
    assert STORE.serialize_cdr(transform, "geometry_msgs/msg/TransformStamped")


def test_what_is_not_located_has_an_answer_and_no_pose(node: Any) -> None:
    node.callback(depth_message(np.zeros((240, 320), dtype=np.float32)))
    assert [topic for topic, _ in node.published] == ["~/fix"]
    assert node.errors == []


def test_images_that_cannot_be_used_are_said(node: Any) -> None:
    node.callback(depth_message(np.zeros((240, 320), dtype=np.float32), encoding="16UC1"))
    node.callback(depth_message(np.zeros((24, 320), dtype=np.float32)))
    assert node.published == []
    assert "16UC1" in node.errors[0] and "(24, 320)" in node.errors[1]
