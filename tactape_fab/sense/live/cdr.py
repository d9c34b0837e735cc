"""Messages as bytes: plain CDR, little-endian, as ROS 2 has it (OMG DDSI-RTPS 2.5 §10); and their definitions."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
"""Encapsulation header of plain CDR (DDSI-RTPS 2.5 §10.2); alignment counts from behind it."""

_TIME = "int32 sec\nuint32 nanosec\n"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
_POINT = "float64 x\nfloat64 y\nfloat64 z\n"
_QUATERNION = "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
_POSE = "Point position\nQuaternion orientation\n"
_IMAGE = "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n"


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageType:
    """A message type: name, hash (REP 2016), definition (ros2msg: those of what it is made of behind it), serialization."""

    name: str
    digest: str
    definition: str
    encode: Callable[[Mapping[str, Any]], bytes]


def _with(own: str, **others: str) -> str:
    """A definition with those of the types in it, as rosbag2 stores them."""
    return own + "".join(f"{'=' * 80}\nMSG: {name.replace('__', '/')}\n{text}" for name, text in others.items())


def _align(body: bytearray, size: int) -> None:
    body.extend(bytes(-len(body) % size))


def _string(body: bytearray, text: str) -> None:
    # length with the final zero byte, the bytes, the zero
    data = text.encode()
    _align(body, 4)
    body += struct.pack("<I", len(data) + 1) + data + b"\x00"


def _started(header: Mapping[str, Any]) -> bytearray:
    body = bytearray(struct.pack("<iI", header["stamp"]["sec"], header["stamp"]["nanosec"]))
    _string(body, header["frame_id"])
    return body


def _pose(message: Mapping[str, Any]) -> bytes:
    body = _started(message["header"])
    position, orientation = message["pose"]["pose"]["position"], message["pose"]["pose"]["orientation"]
    values = [*(position[k] for k in "xyz"), *(orientation[k] for k in "xyzw"), *message["pose"]["covariance"]]
    _align(body, 8)
    # 3 of the position, 4 of the quaternion, 36 of the covariance, row by row
    body += struct.pack("<43d", *values)
    return _LITTLE_ENDIAN + bytes(body)


def _image(message: Mapping[str, Any]) -> bytes:
    body = _started(message["header"])
    _align(body, 4)
    body += struct.pack("<II", message["height"], message["width"])
    _string(body, message["encoding"])
    body += struct.pack("<B", message["is_bigendian"])
    _align(body, 4)
    body += struct.pack("<II", message["step"], len(message["data"]))
    return b"".join((_LITTLE_ENDIAN, body, message["data"]))


def _text(message: Mapping[str, Any]) -> bytes:
    body = bytearray()
    _string(body, message["data"])
    return _LITTLE_ENDIAN + bytes(body)


_STAMPED = {"std_msgs__Header": _HEADER, "builtin_interfaces__Time": _TIME}

POSE = MessageType(
    name="geometry_msgs/msg/PoseWithCovarianceStamped",
    digest="RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
    definition=_with(
        "std_msgs/Header header\nPoseWithCovariance pose\n",
        geometry_msgs__PoseWithCovariance="Pose pose\nfloat64[36] covariance\n",
        geometry_msgs__Pose=_POSE,
        geometry_msgs__Point=_POINT,
        geometry_msgs__Quaternion=_QUATERNION,
        **_STAMPED,
    ),
    encode=_pose,
)
IMAGE = MessageType(
    name="sensor_msgs/msg/Image",
    digest="RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    definition=_with(_IMAGE, **_STAMPED),
    encode=_image,
)
TEXT = MessageType(
    name="std_msgs/msg/String",
    digest="RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    definition="string data\n",
    encode=_text,
)
