"""Answers and depth maps as ROS 2 messages: nested dicts of Python's own values, with the names of the messages' fields.

A node hands them to `rosidl_runtime_py.set_message_fields`, `cdr` makes bytes of them. ROS frames are right-handed, in metres and
radians (REP 103): a pose is given in the board frame (x right, y up, z out of the tape), never in the texture frame, whose y
points down.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from decimal import Decimal
from math import cos, isfinite, radians, sin
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown
from tactape_fab.base.given_value import as_numbers, refuse_other, unmasked
from tactape_fab.sense.decode.result import PLANAR, refuse_no_answer
from tactape_fab.sense.files.answers import object_json
from tactape_fab.sense.objects.taped_object import TapedObject
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import FloatArray

if TYPE_CHECKING:
    from tactape_fab.sense.decode.result import Localization

UNMEASURED = 1e6
"""Variance (m², rad²) of z, roll and pitch, which a contact does not show: so large that a filter ignores them."""

FRAME_BY_NAME = "a frame of poses"
"""Name, in the message of `refuse_equal_names`, of the thing that is named after a tape alone."""
_NS = 1_000_000_000
_LAST_S = 2**31
_MM_TO_M = 1e-3
_TO_BOARD = np.diag([_MM_TO_M, -_MM_TO_M, 1.0])
"""Jacobian of (x, y, yaw) in the board frame, m and rad, by (x mm, y mm, theta rad) in the texture frame: y alone turns round."""


def stamp_ns(timestamp: float | None) -> int | None:
    """Capture time in seconds as whole nanoseconds; None if a ROS 2 time cannot hold it (0 to 2³¹ s)."""
    if timestamp is None or not isfinite(timestamp) or not 0.0 <= timestamp < _LAST_S:
        return None
    # a float of seconds since 1970 holds 0.24 us: of the ns that read back as that float, those of its shortest decimals
    return round(Decimal(repr(float(timestamp))) * _NS)


def pose_message(fix: Localization, stamp: int, frame_id: str | None = None) -> dict[str, Any] | None:
    """An answer as geometry_msgs/PoseWithCovarianceStamped.

    The pose is that of the sensor's image on the tape: origin at the texture point under the middle of the (canonical) image, x
    to the image's right, y to its top, z out of the tape. Its yaw is theta. It is given in the board frame of the tape that was
    found; where `board_mm` is null, in the frame with the same axes and its origin at grid point (0, 0).

    Parameters
    ----------
    fix : Localization
    stamp : int
        Capture time, ns; from 0 to 2³¹ s.
    frame_id : str, optional
        Name of the parent frame; by default that of the tape.

    Returns
    -------
    dict or None
        None where there is no pose on a tape: not located, or only a code is known.

    Raises
    ------
    SpecError
        If an argument is of another type, or no ROS 2 time holds the stamp.
    """
    refuse_no_answer(fix)
    if not fix.located or fix.tape is None or fix.position_mm is None or fix.theta_deg is None:
        return None
    # texture y is down, board y is up
    x_mm, y_mm = fix.board_mm or (fix.position_mm[0], -fix.position_mm[1])
    half = radians(fix.theta_deg) / 2
    return {
        "header": header(stamp, fix.tape if frame_id is None else frame_id),
        "pose": {
            "pose": {
                "position": {"x": x_mm * _MM_TO_M, "y": y_mm * _MM_TO_M, "z": 0.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": sin(half), "w": cos(half)},
            },
            "covariance": board_covariance(fix.covariance).ravel().tolist(),
        },
    }


def transform_message(pose: Mapping[str, Any], child_frame_id: str) -> dict[str, Any]:
    """A pose as geometry_msgs/TransformStamped, from its frame to the sensor's.

    Parameters
    ----------
    pose : mapping
        Of `pose_message`.
    child_frame_id : str
        Name of the sensor's frame.

    Returns
    -------
    dict

    Raises
    ------
    SpecError
        If an argument is of another type.
    """
    remedy = "pose_message(fix, stamp) of a located answer"
    refuse_other(
        pose if isinstance(pose, Mapping) and {"header", "pose"} <= set(pose) else None,
        Mapping,
        "pose",
        "message of a pose",
        remedy,
    )
    at = pose["pose"]["pose"]
    transform = {"translation": dict(at["position"]), "rotation": dict(at["orientation"])}
    return {"header": pose["header"], "child_frame_id": child_frame_id, "transform": transform}


def board_covariance(covariance: FloatArray | None) -> FloatArray:
    """Covariance of a pose in the board frame, of (x, y, z, roll, pitch, yaw) in m and rad, from that of an answer.

    What was not measured has the variance `UNMEASURED`: all of it for a method that states none.

    covariance (3, 3): Of (x mm, y mm, theta rad) in the texture frame.
    Returns (6, 6).
    """
    whole = UNMEASURED * np.eye(6)
    if covariance is not None:
        whole[np.ix_(PLANAR, PLANAR)] = _TO_BOARD @ covariance @ _TO_BOARD
    return whole


def image_message(depth: npt.ArrayLike, sensor: SensorProfile, stamp: int, frame_id: str | None = None) -> dict[str, Any]:
    """A depth map as sensor_msgs/Image, 32FC1.

    It is the canonical image: seen from above the tape, larger where the texture pushes further into the gel. Values are metres,
    as REP 118 asks of 32FC1 (16UC1, whole millimetres, would keep nothing of a texture); where the profile says no unit they are
    those of the frame. Holes, which are values that are NaN, infinite or masked, are NaN.

    Parameters
    ----------
    depth : array_like, shape (h, w)
        As the sensor delivers it.
    sensor : SensorProfile
    stamp : int
        Capture time, ns; from 0 to 2³¹ s.
    frame_id : str, optional
        Name of the sensor's frame; by default that of its profile.

    Returns
    -------
    dict

    Raises
    ------
    SpecError
        If an argument is of another type, or no ROS 2 time holds the stamp.
    """
    refuse_other(sensor, SensorProfile, "sensor", "SensorProfile", "load_sensor(NAME)")
    given = unmasked(depth)
    if isinstance(given, np.ndarray) and given.dtype.kind == "b":  # as the decoder takes them
        given = given.astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        values = as_numbers(given, (None, None), "depth", "a depth map (h, w)", finite=False)
        # a profile without a unit leaves values as they are: 1000 mm in a unit, times mm to m, is 1
        metres = values.astype(np.float32) * np.float32((sensor.depth_unit_mm or 1000.0) * _MM_TO_M)
    # REP 118: an infinite value is an object too near or too far to be seen, which no hole of a gel is
    metres[~np.isfinite(metres)] = np.nan
    image = np.ascontiguousarray(sensor.canonical(metres), dtype="<f4")
    height, width = image.shape
    return {
        "header": header(stamp, sensor.name if frame_id is None else frame_id),
        "height": height,
        "width": width,
        "encoding": "32FC1",
        "is_bigendian": 0,
        "step": 4 * width,
        "data": image.tobytes(),
    }


def text_message(frame: int, fix: Localization, thing: TapedObject | None = None) -> dict[str, Any]:
    """A whole answer as std_msgs/String: the JSON object that `decode --json` prints, with an object as with its `--object`.

    Parameters
    ----------
    frame : int
        Index of the frame.
    fix : Localization
    thing : TapedObject, optional
        The object that the tape is on.

    Returns
    -------
    dict

    Raises
    ------
    SpecError
        If an argument is of another type.
    """
    refuse_other(frame, Integral, "frame", "index", "a whole number")
    refuse_no_answer(fix)
    refuse_other(thing, (TapedObject, type(None)), "thing", "TapedObject", "read_object(FILE), or leave it out")
    more = {} if thing is None else object_json(thing.locate(fix))
    return {"data": json.dumps({**fix.to_mapping(frame), **more}, allow_nan=False)}


def header(stamp: int, frame_id: str) -> dict[str, Any]:
    """A std_msgs/Header with a time in ns. Raises SpecError if that is no whole number, or no ROS 2 time holds it."""
    remedy = "the capture time, such as time.time_ns()"
    refuse_other(stamp, Integral, "stamp", "whole number of ns", remedy)
    if not 0 <= stamp < _LAST_S * _NS:
        message = (
            f"stamp = {shown(int(stamp))} ns is outside 0 to {_LAST_S * _NS - 1} ns, which a ROS 2 time holds; give {remedy}"
        )
        raise SpecError(Problem("stamp", message))
    seconds, nanoseconds = divmod(int(stamp), _NS)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame_id}
