"""How late answers come over Zenoh, in another process and in this one. Run: python -m tests.bench.bus (two minutes)

Writes the table of docs/bus.md: percentiles of the best of some runs, as other work on the machine only ever adds to them. The
clock is this machine's; the other process is the one that a reader would be.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.sense.live.topics import DEPTH_TOPIC, POSE_TOPIC
from tactape_fab.sense.live.zenoh_bus import ZenohBus, key_of
from tests.bench.marks import write_between
from tests.readers.test_bus import free_endpoint, listening, located

PAGE = Path(__file__).parents[2] / "docs" / "bus.md"
RUNS, COUNT, RATE_HZ = 5, 500, 50.0
_READER = """
import json, struct, sys, time, zenoh
config = zenoh.Config()
config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
late = {key: [] for key in sys.argv[2:]}
with zenoh.open(config) as session:
    def take(sample):
        late[str(sample.key_expr)].append(time.time_ns() - struct.unpack_from("<qq", sample.attachment.to_bytes())[1])
    readers = [session.declare_subscriber(key, take) for key in late]
    print("listening", flush=True)
    sys.stdin.read()
print(json.dumps(late))
"""


def publish(bus: ZenohBus, count: int) -> list[float]:
    """Publish at a rate; what `write` took, ms."""
    depth = np.random.default_rng(1).normal(size=(240, 320)).astype(np.float32)
    spent = []
    for k in range(count):
        start = time.perf_counter()
        bus.write(located(k, depth))
        spent.append(1e3 * (time.perf_counter() - start))
        time.sleep(max(0.0, 1 / RATE_HZ - spent[-1] / 1e3))
    return spent


def measured(count: int) -> dict[str, list[float]]:
    """Times in ms, by what they are of."""
    import zenoh

    keys = [key_of(POSE_TOPIC), key_of(DEPTH_TOPIC)]
    endpoint = free_endpoint()
    with subprocess.Popen(
        [sys.executable, "-c", _READER, endpoint, *keys], stdin=subprocess.PIPE, stdout=subprocess.PIPE, encoding="utf-8"
    ) as reader:
        assert reader.stdout is not None and reader.stdin is not None
        reader.stdout.readline()
        with ZenohBus(endpoint) as bus:
            time.sleep(0.5)
            spent = publish(bus, count)
            time.sleep(0.5)
        reader.stdin.close()
        late = json.loads(reader.stdout.read())
    here: dict[str, list[float]] = {key: [] for key in keys}
    endpoint = free_endpoint()
    with listening(zenoh, endpoint) as session:

        def take(sample: Any) -> None:
            sent = int.from_bytes(sample.attachment.to_bytes()[8:16], "little", signed=True)
            here[str(sample.key_expr)].append((time.time_ns() - sent) / 1e6)

        subscribers = [session.declare_subscriber(key, take) for key in keys]
        with ZenohBus(endpoint) as bus:
            time.sleep(0.5)
            publish(bus, count)
            time.sleep(0.5)
        for subscriber in subscribers:
            subscriber.undeclare()
    return {
        "pose, in another process": [ns / 1e6 for ns in late[keys[0]]],
        "depth image, in another process": [ns / 1e6 for ns in late[keys[1]]],
        "pose, in the same process": here[keys[0]],
        "depth image, in the same process": here[keys[1]],
        "to encode and hand over all three messages": spent,
    }


def table(runs: Sequence[Mapping[str, Sequence[float]]]) -> str:
    """Of each percentile the smallest of all runs, as Markdown."""
    rows = [f"| {len(runs)} runs of {COUNT} frames at {RATE_HZ:g} Hz | came | p50 | p99 |", "|---|---|---|---|"]
    for name in runs[0]:
        p50, p99 = np.min([np.percentile(run[name], (50, 99)) for run in runs], axis=0)
        rows.append(f"| {name} | {sum(len(run[name]) for run in runs)} | {p50:.2f} ms | {p99:.2f} ms |")
    busy = f"Load average {os.getloadavg()[0]:.0f} on {os.cpu_count()} processors."
    return "\n".join([*rows, "", busy]) + "\n"


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    text = table([measured(COUNT) for _ in range(RUNS)])
    sys.stdout.write(text)
    write_between(PAGE, "latency", text)
