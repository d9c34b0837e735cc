"""Answers on a Zenoh bus: the CDR messages of an MCAP log, with keys and attachments of rmw_zenoh (Jazzy and later).

https://github.com/ros2/rmw_zenoh: docs/design.md (keys), rmw_zenoh_cpp/src/detail/attachment_helpers.cpp (attachments).
"""

from __future__ import annotations

import json
import re
import struct
from collections import Counter
from collections.abc import Sequence
from time import time_ns
from typing import Any
from uuid import uuid4

from tactape_fab.base.errors import Problem, SpecError, TactapeError
from tactape_fab.base.fields import shown
from tactape_fab.base.libraries import library
from tactape_fab.sense.files.jobs import Located
from tactape_fab.sense.live.topics import TOPICS, Naming, encoded, topic_of

LOCAL, LOCAL_ENDPOINT = "local", "tcp/127.0.0.1:7447"
"""Word for listening on this machine alone, and the endpoint that this is: Zenoh's own port."""
DOMAIN = 0
"""ROS_DOMAIN_ID, of which a key begins."""
_PATIENCE_MS = 3000
_WAIT_BEFORE_DROP_US = 20_000
"""Zenoh's own 1000 us is shorter than a time slice of a busy machine: a pose behind a depth map of 300 kB was dropped, though its
reader kept up (zenoh issue 847). Under the 40 ms of a frame."""
_ENDPOINT = re.compile(r"(tcp|udp|tls|quic|ws|unixsock-stream)/\S{1,200}")


class ZenohBus:
    """Publishers of `watch`'s topics. Messages are dropped for a slow reader, who sees gaps in the attached numbers.

    endpoint: "local" to listen on this machine, or the endpoint of a router or peer to connect to.
    sensors: Names of several sensors, which have topics of their own.
    Raises SpecError when it is no endpoint, or cannot be opened.
    Raises MissingLibraryError.
    """

    def __init__(self, endpoint: str, naming: Naming = Naming(), sensors: Sequence[str] = ("",)) -> None:  # noqa: B008 (frozen)
        if endpoint != LOCAL and not _ENDPOINT.fullmatch(endpoint):
            message = f"zenoh = {shown(endpoint)} is no endpoint; give local, or one to connect to, such as {LOCAL_ENDPOINT}"
            raise SpecError(Problem("zenoh", message))
        self._zenoh = library("zenoh", "--zenoh")
        self._naming, self._gid, self._sent = naming, uuid4().bytes, Counter[str]()
        config = self._zenoh.Config()
        try:
            for key, value in _settings(endpoint).items():
                config.insert_json5(key, json.dumps(value))
            self._session = self._zenoh.open(config)
        except self._zenoh.ZError as error:
            what = (
                f"{LOCAL_ENDPOINT} cannot be listened on; if a router or another watch does, give --zenoh {LOCAL_ENDPOINT}"
                if endpoint == LOCAL
                else f"{endpoint} does not answer; start what listens there, such as ros2 run rmw_zenoh_cpp rmw_zenohd"
            )
            raise SpecError(Problem("zenoh", f"zenoh = {endpoint}: {what}")) from error
        self._publishers = {
            topic_of(topic, sensor): self._session.declare_publisher(
                key_of(topic, sensor),
                encoding=self._zenoh.Encoding.APPLICATION_CDR,
                congestion_control=self._zenoh.CongestionControl.DROP,
            )
            for sensor in sensors
            for topic in TOPICS
        }

    def __enter__(self) -> ZenohBus:
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()

    def write(self, located: Located, sensor: str = "") -> bool:
        """Publish a frame and its answer. False, and nothing sent, where it has no capture time.

        Raises TactapeError when the session has ended.
        """
        found = encoded(located, self._naming, sensor)
        if found is None:
            return False
        for topic, data in found[1]:
            self._sent[topic] += 1
            try:
                self._publishers[topic].put(data, attachment=attachment(self._sent[topic], time_ns(), self._gid))
            except self._zenoh.ZError as error:
                raise TactapeError(f"zenoh: {topic} cannot be published: {error}") from error
        return True


def _settings(endpoint: str) -> dict[str, Any]:
    """Zenoh's configuration: one endpoint, no scouting by multicast, which leaves this machine, and when to drop a message."""
    connect = {"endpoints": [] if endpoint == LOCAL else [endpoint], "exit_on_failure": True, "timeout_ms": _PATIENCE_MS}
    listen = {"endpoints": [LOCAL_ENDPOINT if endpoint == LOCAL else "tcp/127.0.0.1:0"]}
    drop = "transport/link/tx/queue/congestion_control/drop/wait_before_drop"
    return {"mode": "peer", "connect": connect, "listen": listen, "scouting/multicast/enabled": False, drop: _WAIT_BEFORE_DROP_US}


def key_of(topic: str, sensor: str = "") -> str:
    """Key of a topic: domain, name, type as DDS has it, hash of the type (REP 2016)."""
    kind = TOPICS[topic]
    package, _, name = kind.name.split("/")
    return f"{DOMAIN}{topic_of(topic, sensor)}/{package}::msg::dds_::{name}_/{kind.digest}"


def attachment(number: int, time_ns_: int, gid: bytes) -> bytes:
    """Number of a message on its topic, from 1; when it was sent; 16 bytes that name the publisher."""
    # int64, int64, then the length of the publisher's name before it, as Zenoh serialises arrays
    return struct.pack("<qqB16s", number, time_ns_, len(gid), gid)
