"""Answers as ROS 2 messages: frames, signs, covariance and stamps, and their bytes as rosbags' serializer has them."""

from __future__ import annotations

import json
from math import atan2, pi
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from tactape_fab import Kit, Localization
from tactape_fab.base.errors import SpecError
from tactape_fab.sense import SensorProfile, image_message, pose_message, text_message
from tactape_fab.sense.live.cdr import IMAGE, POSE, TEXT, MessageType
from tactape_fab.sense.live.messages import UNMEASURED, board_covariance, stamp_ns
from tactape_fab.texture.frames import texture_to_board
from tests.live import SENSOR, ramp

COVARIANCE = np.array([(4e-4, 1e-4, 2e-5), (1e-4, 9e-4, -3e-5), (2e-5, -3e-5, 1.6e-5)])
STORE = get_typestore(Stores.ROS2_HUMBLE)


def fix(**others: Any) -> Localization:
    values: dict[str, Any] = {
        "status": "solid", "located": True, "tape": "tactape-s007", "sector": 7, "position_mm": (20.0, 12.0), "theta_deg": 30.0,
        "board_mm": (26.9, 36.25), "covariance": COVARIANCE, "n_dots": 40, "n_agree": 39, "p_false": 1e-9, "timestamp": 12.25,
    }  # fmt: skip
    return Localization(**{**values, **others})


def pose_of(answer: Localization, **others: Any) -> dict[str, Any]:
    message = pose_message(answer, 12_250_000_000, **others)
    assert message is not None
    return message


def test_a_pose_is_that_of_the_image_in_the_board_frame(default_kit: Kit) -> None:
    """SPEC: at S = (20, 12) and 30 degrees the pixel 16 px right of the middle sees (20 + cos 30, 12 - sin 30)."""
    tape = default_kit.tape
    board = texture_to_board([(20.0, 12.0), (20.0 + np.cos(pi / 6), 12.0 - np.sin(pi / 6))], tape.board.texture_origin_mm)
    message = pose_of(fix(board_mm=tuple(board[0])))
    assert message["header"] == {"stamp": {"sec": 12, "nanosec": 250_000_000}, "frame_id": "tactape-s007"}
    position, q = message["pose"]["pose"]["position"], message["pose"]["pose"]["orientation"]
    assert (q["x"], q["y"], position["z"]) == (0.0, 0.0, 0.0)
    yaw = atan2(2 * q["w"] * q["z"], 1 - 2 * q["z"] ** 2)
    seen_m = np.array([position["x"], position["y"]]) + 1e-3 * np.array([np.cos(yaw), np.sin(yaw)])
    np.testing.assert_allclose(seen_m, board[1] * 1e-3, atol=1e-12)


def test_a_stamp_of_an_array_becomes_python_s_own_number() -> None:
    message = pose_message(fix(), np.int64(5))  # type: ignore[arg-type]
    assert message is not None
    assert [type(value) for value in message["header"]["stamp"].values()] == [int, int]


@pytest.mark.parametrize("theta_deg", [-179.9, -90.0, 0.0, 90.0, 180.0])
def test_every_turn_is_a_unit_quaternion(theta_deg: float) -> None:
    q = pose_of(fix(theta_deg=theta_deg))["pose"]["pose"]["orientation"]
    assert np.rad2deg(2 * atan2(q["z"], q["w"])) == pytest.approx(theta_deg)
    assert q["z"] ** 2 + q["w"] ** 2 == pytest.approx(1.0)


def test_covariance_is_that_of_the_board_frame_in_metres() -> None:
    """Against errors that are drawn in the texture frame and carried over one by one."""
    errors = np.random.default_rng(1).multivariate_normal((20.0, 12.0, 0.5), COVARIANCE, 200_000)
    board = texture_to_board(errors[:, :2], (6.9, 48.25)) / 1000.0
    drawn = np.cov(np.column_stack([board, errors[:, 2]]).T)
    whole = np.reshape(pose_of(fix())["pose"]["covariance"], (6, 6))
    planar = whole[np.ix_((0, 1, 5), (0, 1, 5))]
    scale = np.sqrt(np.outer(np.diag(planar), np.diag(planar)))
    np.testing.assert_allclose(planar / scale, drawn / scale, atol=0.01)
    others = np.delete(np.delete(whole, (0, 1, 5), axis=0), (0, 1, 5), axis=1)
    np.testing.assert_array_equal(others, UNMEASURED * np.eye(3))
    assert np.count_nonzero(whole) == 9 + 3


def test_a_method_without_covariance_measures_nothing() -> None:
    np.testing.assert_array_equal(board_covariance(None), UNMEASURED * np.eye(6))


@pytest.mark.parametrize("other", [{"located": False}, {"tape": None, "position_mm": None}, {"theta_deg": None}])
def test_there_is_no_pose_without_an_answer(other: dict[str, Any]) -> None:
    assert pose_message(fix(**other), 0) is None


def test_a_texture_on_no_board_has_its_grid_point_0_0_as_origin() -> None:
    position = pose_of(fix(board_mm=None))["pose"]["pose"]["position"]
    assert (position["x"], position["y"]) == pytest.approx((0.02, -0.012))


def test_frames_can_be_named() -> None:
    assert pose_of(fix(), frame_id="bottle")["header"]["frame_id"] == "bottle"
    image = image_message(ramp(0), SENSOR, 5, "finger")
    assert (image["header"]["frame_id"], image_message(ramp(0), SENSOR, 5)["header"]["frame_id"]) == ("finger", "gelsight-mini")


@pytest.mark.parametrize(
    ("seconds", "ns"),
    [
        (0.0, 0),
        (1.7e9 + 0.04, 1_700_000_000_040_000_000),
        (None, None),
        (-1.0, None),
        (2.0**31, None),
        (float("nan"), None),
        (float("inf"), None),
    ],
)
def test_a_stamp_is_what_ros_can_hold(seconds: float | None, ns: int | None) -> None:
    assert stamp_ns(seconds) == ns


def test_a_stamp_is_read_back_as_the_timestamp() -> None:
    for seconds in (1.7e9 + np.random.default_rng(1).uniform(0.0, 1e6, 500)).tolist():
        ns = stamp_ns(seconds)
        assert ns is not None and ns / 10**9 == seconds  # of whole numbers: 1e9 would round twice


def test_a_depth_image_is_metres_seen_from_above() -> None:
    sensor = SensorProfile(
        name="s", title="", width_px=2, height_px=3, px_per_mm=(16.0, 16.0), sign=-1, mirror=True, rotate90=1, depth_unit_mm=0.5
    )
    frame = np.array([(1.0, 2.0, 3.0), (4.0, np.nan, 6.0)])
    message = image_message(frame, sensor, 0)
    image = np.frombuffer(message["data"], dtype="<f4").reshape(message["height"], message["width"])
    assert (message["encoding"], message["step"], message["is_bigendian"]) == ("32FC1", 8, 0)
    np.testing.assert_allclose(image, np.array([(-1.0, -4.0), (-2.0, np.nan), (-3.0, -6.0)]) * 0.5e-3)
    plain = image_message(frame.T, SensorProfile(name="s", title="", width_px=2, height_px=3, px_per_mm=(16.0, 16.0)), 0)
    np.testing.assert_array_equal(np.frombuffer(plain["data"], dtype="<f4"), frame.T.ravel().astype("<f4"))


@pytest.mark.parametrize("kind", ["?", "u1", "i8", "<u2", ">f4", "f2", "g"])
def test_every_frame_that_is_located_has_an_image(kind: str) -> None:
    frame = np.array([[1, 0], [0, 1]]).astype(kind)
    plain = SensorProfile(name="s", title="", width_px=2, height_px=2, px_per_mm=(16.0, 16.0))
    assert np.frombuffer(image_message(frame, plain, 0)["data"], dtype="<f4").tolist() == [1.0, 0.0, 0.0, 1.0]


def test_every_hole_of_a_depth_image_is_nan() -> None:
    """As the decoder has holes: infinite, masked, and too large for single precision."""
    sensor = SensorProfile(name="s", title="", width_px=4, height_px=1, px_per_mm=(16.0, 16.0), sign=-1)
    frame = np.ma.masked_array([[np.inf, -np.inf, 1e300, 3.0]], [[False, False, False, True]])
    assert np.isnan(np.frombuffer(image_message(frame, sensor, 0)["data"], dtype="<f4")).all()
    whole = np.ma.masked_array([[1, 2, 3, 65535]], [[False, False, False, True]], dtype=np.uint16)
    seen = np.frombuffer(image_message(whole, sensor, 0)["data"], dtype="<f4")
    np.testing.assert_array_equal(seen, np.array([-1.0, -2.0, -3.0, np.nan], dtype="<f4"))


@pytest.mark.parametrize("stamp", [-1, -(10**9), 2**31 * 10**9, 10**30])
def test_a_stamp_that_ros_cannot_hold_is_refused(stamp: int) -> None:
    sensor = SensorProfile(name="s", title="", width_px=1, height_px=1, px_per_mm=(16.0, 16.0), sign=1)
    said = rf"^stamp = {stamp} ns is outside 0 to 2147483647999999999 ns, which a ROS 2 time holds; give the capture time"
    with pytest.raises(SpecError, match=said):
        image_message(np.zeros((1, 1)), sensor, stamp)
    with pytest.raises(SpecError, match=said):
        pose_message(fix(), stamp)
    last = {"sec": 2**31 - 1, "nanosec": 10**9 - 1}
    assert image_message(np.zeros((1, 1)), sensor, 2**31 * 10**9 - 1)["header"]["stamp"] == last


def test_the_text_is_the_answer_that_decode_prints() -> None:
    answer = fix(px_per_mm=float("nan"))
    assert json.loads(text_message(3, answer)["data"]) == json.loads(json.dumps(answer.to_mapping(3)))


# Bytes


def ros(kind: str, values: dict[str, Any]) -> Any:
    """A message of rosbags' own classes."""
    nested = {"header": "std_msgs/msg/Header", "stamp": "builtin_interfaces/msg/Time", "position": "geometry_msgs/msg/Point"}
    nested["orientation"] = "geometry_msgs/msg/Quaternion"
    read = {}
    for name, value in values.items():
        if isinstance(value, dict):
            pose = "geometry_msgs/msg/PoseWithCovariance" if "covariance" in value else "geometry_msgs/msg/Pose"
            read[name] = ros(nested.get(name, pose), value)
        elif name == "covariance":
            read[name] = np.array(value)
        else:
            read[name] = np.frombuffer(value, dtype=np.uint8) if isinstance(value, bytes) else value
    return STORE.types[kind](**read)


@pytest.mark.parametrize("name", ["", "a", "ab", "abc", "abcd", "tape-ü", "x" * 100])
def test_bytes_are_those_of_another_serializer(name: str) -> None:
    """Names of every length, which shift what stands behind them."""
    image = image_message(ramp(3), SENSOR, 7, name)
    for kind, message in ((POSE, pose_of(fix(), frame_id=name)), (IMAGE, image), (TEXT, {"data": name})):
        assert kind.encode(message) == bytes(STORE.serialize_cdr(ros(kind.name, message), kind.name))


@pytest.mark.parametrize("kind", [POSE, IMAGE, TEXT], ids=lambda k: k.name)
def test_definitions_are_those_of_ros(kind: MessageType) -> None:
    """The hash that ROS 2 itself takes of a type (REP 2011), of our definition and of the one rosbags has."""
    from rosbags.typesys import get_types_from_msg

    ours = get_typestore(Stores.EMPTY)
    ours.register(get_types_from_msg(kind.definition, kind.name))
    assert ours.hash_rihs01(kind.name) == STORE.hash_rihs01(kind.name)
