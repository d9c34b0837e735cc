"""Print the poses that `tactape-fab watch SOURCE --tape KIT --zenoh local` publishes. Needs: pip install eclipse-zenoh rosbags

Run: python docs/examples/zenoh_reader.py [--listen ENDPOINT] [COUNT]. It connects to the watch on this machine, or listens, for a
watch with --zenoh ENDPOINT. Each message carries its number: a gap is what this reader was too slow for.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from typing import Any

import zenoh
from rosbags.typesys import Stores, get_typestore

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
QUEUE = 8
"""Messages that wait here; older ones make room for newer ones."""


def main(arguments: list[str]) -> None:
    listens = arguments[:1] == ["--listen"]
    endpoints = arguments[1:2] if listens else ["tcp/127.0.0.1:7447"]
    rest = arguments[2:] if listens else arguments
    config = zenoh.Config()
    config.insert_json5("listen/endpoints" if listens else "connect/endpoints", json.dumps(endpoints))
    config.insert_json5("scouting/multicast/enabled", "false")
    store = get_typestore(Stores.ROS2_JAZZY)
    with zenoh.open(config) as session:
        poses = session.declare_subscriber("0/tactape/pose/**", zenoh.handlers.RingChannel(QUEUE))
        print("listening", flush=True)
        last = 0
        for _ in range(int(rest[0]) if rest else 10**9):
            sample = poses.recv()
            assert sample.attachment is not None, "no message of rmw_zenoh"
            number, sent_ns = struct.unpack_from("<qq", sample.attachment.to_bytes())
            late_ms, lost, last = (time.time_ns() - sent_ns) / 1e6, number - last - 1, number
            pose: Any = store.deserialize_cdr(sample.payload.to_bytes(), POSE)
            at = pose.pose.pose.position
            print(f"{number} {pose.header.frame_id} {at.x:.6f} {at.y:.6f} m, {late_ms:.2f} ms late, {lost} lost", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
