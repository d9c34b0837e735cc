"""Answers for programs without our Python: over Zenoh between two processes, and as JSON lines read by C++."""

from __future__ import annotations

import io
import json
import shutil
import socket
import struct
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from tactape_fab import Kit, Localization, SpecError
from tactape_fab.sense import simulate_frames
from tactape_fab.sense.files.jobs import Located
from tactape_fab.sense.live import zenoh_bus
from tactape_fab.sense.live.topics import DEPTH_TOPIC, POSE_TOPIC, TEXT_TOPIC, TOPICS, Naming, encoded
from tactape_fab.sense.live.zenoh_bus import ZenohBus, attachment, key_of
from tests.conftest import _missing
from tests.live import SENSOR, SHAPE, npy
from tests.thorough import slow, some

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
STORE = get_typestore(Stores.ROS2_JAZZY)
TACTAPE = Path(sysconfig.get_path("scripts")) / "tactape-fab"


@pytest.fixture(scope="module")
def zenoh() -> Any:
    try:
        import zenoh
    except ImportError:
        _missing("zenoh", 'pip install "tactape-fab[zenoh]"')
    return zenoh


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def located(k: int, depth: np.ndarray[Any, Any] | None = None) -> Located:
    fix = Localization(
        status="solid",
        located=True,
        tape="t",
        position_mm=(float(k), 2.0),
        theta_deg=30.0,
        covariance=np.diag([1e-4, 1e-4, 1e-6]),
        timestamp=1000.0 + k,
    )
    return Located(frame=k, depth=np.zeros(SHAPE, np.float32) if depth is None else depth, sensor=SENSOR, fix=fix)


@contextmanager
def listening(zenoh: Any, endpoint: str, how: str = "listen") -> Iterator[Any]:
    config = zenoh.Config()
    config.insert_json5(f"{how}/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        yield session


def wait_until_matched(bus: ZenohBus, *topics: str) -> None:
    """Until the bus knows who reads it: what is written before is lost."""
    end = time.monotonic() + 60.0
    while not all(bus._publishers[topic].matching_status.matching for topic in topics):
        assert time.monotonic() < end, "nobody reads"
        time.sleep(0.02)


def received(samples: Any, count: int) -> list[Any]:
    """The next so many samples; a lost one fails a test and does not stop it."""
    found: list[Any] = []
    end = time.monotonic() + 60.0
    while len(found) < count and time.monotonic() < end:
        sample = samples.try_recv()
        found += [sample] if sample is not None else []
        time.sleep(0.0 if sample is not None else 0.01)
    assert len(found) == count
    return found


# Keys and attachments


def test_types_and_their_hashes_are_those_of_ros() -> None:
    for topic, kind in TOPICS.items():
        assert STORE.hash_rihs01(kind.name) == kind.digest
        domain, rest = key_of(topic).split("/", 1)
        assert domain == "0" and f"/{rest}".startswith(f"{topic}/") and rest.endswith(kind.digest)
    assert "/std_msgs::msg::dds_::String_/" in key_of(TEXT_TOPIC)


def test_an_attachment_is_33_bytes_as_rmw_zenoh_reads_them() -> None:
    gid = bytes(range(16))
    data = attachment(7, 1_763_800_000_123_456_789, gid)
    assert len(data) == 33 and data[16] == 16 and data[17:] == gid
    assert struct.unpack_from("<qq", data) == (7, 1_763_800_000_123_456_789)


# The bus


def test_messages_arrive_byte_for_byte_as_in_a_log(zenoh: Any) -> None:
    endpoint = free_endpoint()
    with listening(zenoh, endpoint) as session:
        samples = session.declare_subscriber("**", zenoh.handlers.FifoChannel(100))
        with ZenohBus(endpoint, Naming(frame_id="cup")) as bus:
            wait_until_matched(bus, *TOPICS)
            found = []
            for k in range(3):
                assert bus.write(located(k))
                found += received(samples, 3)  # one frame after the other: a bus drops what a busy reader is too slow for
            assert not bus.write(
                Located(frame=9, depth=np.zeros(SHAPE), sensor=SENSOR, fix=Localization(status="none", located=False))
            )
            assert samples.try_recv() is None
    for k in range(3):
        expected = encoded(located(k), Naming(frame_id="cup"))
        assert expected is not None
        for (topic, data), sample in zip(expected[1], found[3 * k : 3 * k + 3], strict=True):
            assert str(sample.key_expr) == key_of(topic) and sample.payload.to_bytes() == data
            assert struct.unpack_from("<q", sample.attachment.to_bytes()) == (k + 1,)
            assert STORE.deserialize_cdr(data, TOPICS[topic].name) is not None


def test_a_reader_that_is_too_slow_loses_frames_and_hears_so(zenoh: Any) -> None:
    endpoint, count = free_endpoint(), 60
    depth = np.random.default_rng(1).normal(size=SHAPE).astype(np.float32)
    with listening(zenoh, endpoint) as session:
        samples = session.declare_subscriber(key_of(DEPTH_TOPIC), zenoh.handlers.RingChannel(2))
        with ZenohBus(endpoint) as bus:
            wait_until_matched(bus, DEPTH_TOPIC)
            start = time.perf_counter()
            for k in range(count):
                bus.write(located(k, depth))
            spent_s = time.perf_counter() - start
            time.sleep(1.0)
            numbers = [struct.unpack_from("<q", sample.attachment.to_bytes())[0] for sample in iter(samples.try_recv, None)]
    assert len(numbers) == 2 and numbers[0] > 2  # the latest that came, and by their numbers how many went by
    assert spent_s < 30.0  # nobody waited for it


def test_local_is_this_machine_alone_and_is_said_when_taken(zenoh: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    assert zenoh_bus.LOCAL_ENDPOINT.startswith("tcp/127.0.0.1:")
    endpoint = free_endpoint()
    monkeypatch.setattr(zenoh_bus, "LOCAL_ENDPOINT", endpoint)
    with ZenohBus("local") as bus, listening(zenoh, endpoint, "connect") as session:
        samples = session.declare_subscriber(key_of(POSE_TOPIC), zenoh.handlers.FifoChannel(10))
        wait_until_matched(bus, POSE_TOPIC)
        bus.write(located(1))
        pose: Any = STORE.deserialize_cdr(received(samples, 1)[0].payload.to_bytes(), TOPICS[POSE_TOPIC].name)
        assert pose.pose.pose.position.x == 1e-3
        with pytest.raises(SpecError, match=f"give --zenoh {endpoint}"):
            ZenohBus("local")


@pytest.mark.parametrize("endpoint", ["", "7447", "http/a:1", "tcp/a b:1", "tcp/127.0.0.1:1", "tcp/127.0.0.1:1#a=b;="])
def test_an_endpoint_that_cannot_be_used_is_refused(zenoh: Any, endpoint: str) -> None:
    with pytest.raises(SpecError, match="zenoh = "):
        ZenohBus(endpoint)


def test_two_processes_over_zenoh(zenoh: Any, default_kit: Kit, tmp_path: Path) -> None:
    """`watch --zenoh` in one, the page's reader in the other."""
    count, endpoint = 10, free_endpoint()
    frames = simulate_frames(default_kit.tape, count, seed=3)
    np.savez(tmp_path / "frames.npz", depth=frames.depth, timestamp=1000.0 + 0.2 * np.arange(count))
    command = [sys.executable, str(EXAMPLES / "zenoh_reader.py"), "--listen", endpoint, "3"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, encoding="utf-8") as reader:
        assert reader.stdout is not None and reader.stdout.readline() == "listening\n"
        watching = ["watch", str(tmp_path / "frames.npz"), "--tape", str(default_kit.path), "--zenoh", endpoint]
        done = subprocess.run([str(TACTAPE), *watching], capture_output=True, encoding="utf-8", check=False)
        assert done.returncode == 0, done.stderr
        try:
            lines = reader.communicate(timeout=60)[0].splitlines()
        except subprocess.TimeoutExpired:
            reader.kill()
            raise
    board = frames.position_mm * (1, -1) + default_kit.tape.board.texture_origin_mm
    assert len(lines) == 3
    for line in lines:
        number, tape, x, y, *_ = line.split()
        assert tape == default_kit.tape.name
        off = np.abs(board - 1000 * np.array([float(x), float(y)])).max(axis=1)
        assert off.min() < 0.05 and int(number) >= 1


# C++


@pytest.fixture(scope="module")
def cpp_reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        _missing("g++", "install Debian's g++")
    program = tmp_path_factory.mktemp("cpp") / "read_answers"
    flags = ["-std=c++17", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run([str(compiler), *flags, "-o", program, EXAMPLES / "read_answers.cpp"], check=True)
    return program


def test_it_is_as_short_as_it_is_said_to_be() -> None:
    lines = (EXAMPLES / "read_answers.cpp").read_text(encoding="utf-8").splitlines()
    assert sum(1 for line in lines if line.strip() and not line.startswith(("//", "#"))) <= 40


@slow
def test_cpp_reads_the_answers_of_a_thousand_frames(cpp_reader: Path, default_kit: Kit) -> None:
    """A stream of arrays into `watch --json`, its lines into the compiled reader: as a robot without Python would have it."""
    count, different = some(1000), 20
    frames = simulate_frames(default_kit.tape, different, seed=8)
    depth = frames.depth.copy()
    depth[3] = 0.0  # not located
    stream = io.BytesIO()
    for k in range(count):
        stream.write(npy(np.float64(1000.0 + 0.04 * k)) + npy(depth[k % different]))
    command = [str(TACTAPE), "watch", "-", "--tape", str(default_kit.path), "--json", "--no-drop"]
    watching = subprocess.run(command, input=stream.getvalue(), capture_output=True, check=True)
    answers = [json.loads(line) for line in watching.stdout.splitlines()]
    assert len(answers) == count
    read = subprocess.run([cpp_reader], input=watching.stdout, capture_output=True, check=True)
    known = [answer for answer in answers if answer["located"]]
    assert read.stderr.decode() == f"{count} answers, {len(known)} located\n" and len(known) > 0.9 * count * 19 / 20
    rows = np.array([line.split() for line in read.stdout.decode().splitlines()], dtype=float)
    expected = [(*answer["position_mm"], answer["theta_deg"], answer["covariance"][0][0]) for answer in known]
    assert rows == pytest.approx(np.array(expected), rel=1e-3, abs=1e-6)
