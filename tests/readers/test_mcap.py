"""MCAP files of `watch`, read by rosbags: every message, stamp and covariance, in order; and what a killed process leaves."""

from __future__ import annotations

import json
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.exceptions import McapError
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader, AnyReaderError

from tactape_fab import Kit
from tactape_fab.cli import main
from tactape_fab.sense import simulate_frames
from tactape_fab.sense.live.messages import UNMEASURED
from tactape_fab.sense.live.topics import DEPTH_TOPIC, POSE_TOPIC, TEXT_TOPIC
from tests.live import npy

COUNT = 12
STAMPS = 1_763_800_000.0 + 0.04 * np.arange(COUNT)
NOT_LOCATED = (4, 9)


@pytest.fixture(scope="module")
def recording(default_kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames with timestamps, two of them of no contact; not to be changed."""
    depth = simulate_frames(default_kit.tape, COUNT, seed=5).depth.copy()
    depth[list(NOT_LOCATED)] = 0.0
    depth[1, :3, :3] = np.nan
    path = tmp_path_factory.mktemp("recording") / "frames.npz"
    np.savez(path, depth=depth, timestamp=STAMPS)
    return path


def watch(arguments: str) -> list[dict[str, Any]]:
    result = CliRunner().invoke(main, shlex.split(f"watch {arguments}"), prog_name="tactape-fab")
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()]


def messages(path: Path) -> list[tuple[str, int, Any]]:
    """Topic, time and content of every message, in the order in which rosbags gives them."""
    with AnyReader([path]) as reader:
        return [(c.topic, t, reader.deserialize(data, c.msgtype)) for c, t, data in reader.messages()]


def test_another_reader_finds_every_answer(default_kit: Kit, recording: Path, tmp_path: Path) -> None:
    path = tmp_path / "touch.mcap"
    printed = watch(f"{recording} --rate max --tape {default_kit.path} --json --mcap {path} --sensor-frame finger")
    assert len(printed) == COUNT
    found = messages(path)
    stamps_ns = [round(stamp * 1e9) for stamp in STAMPS]
    texts = [(t, m) for topic, t, m in found if topic == TEXT_TOPIC]
    assert [t for t, _ in texts] == stamps_ns
    assert [json.loads(m.data) for _, m in texts] == printed

    located = [k for k in range(COUNT) if k not in NOT_LOCATED]
    assert [k for k in range(COUNT) if printed[k]["located"]] == located
    poses = [(t, m) for topic, t, m in found if topic == POSE_TOPIC]
    assert [t for t, _ in poses] == [stamps_ns[k] for k in located]
    for (t, pose), k in zip(poses, located, strict=True):
        answer = printed[k]
        assert (pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec, pose.header.frame_id) == (t, "tactape-s007")
        position, q = pose.pose.pose.position, pose.pose.pose.orientation
        np.testing.assert_allclose([position.x, position.y, position.z], [*np.array(answer["board_mm"]) / 1000.0, 0.0])
        assert np.rad2deg(2 * np.arctan2(q.z, q.w)) == pytest.approx(answer["theta_deg"])
        signs = np.outer((1, -1, 1), (1, -1, 1)) * np.outer((1e-3, 1e-3, 1), (1e-3, 1e-3, 1))
        whole = pose.pose.covariance.reshape(6, 6)
        np.testing.assert_allclose(whole[np.ix_((0, 1, 5), (0, 1, 5))], signs * answer["covariance"], rtol=1e-12)
        assert list(np.diag(whole)[2:5]) == [UNMEASURED] * 3

    images = [(t, m) for topic, t, m in found if topic == DEPTH_TOPIC]
    assert [t for t, _ in images] == stamps_ns
    with np.load(recording) as truth:
        for (_, image), depth in zip(images, truth["depth"], strict=True):
            assert (image.header.frame_id, image.encoding, image.height, image.width) == ("finger", "32FC1", 240, 320)
            np.testing.assert_allclose(image.data.view("<f4").reshape(240, 320), depth * np.float32(1e-3), rtol=1e-6)
    assert [t for _, t, _ in found] == sorted(t for _, t, _ in found)


def test_frames_without_a_time_are_left_out_and_said(default_kit: Kit, recording: Path, tmp_path: Path) -> None:
    with np.load(recording) as arrays:
        np.savez(tmp_path / "f.npz", depth=arrays["depth"][:3], timestamp=[1.0, np.nan, 2.0])
    arguments = f"watch {tmp_path}/f.npz --rate max --tape {default_kit.path} --mcap {tmp_path}/touch.mcap"
    result = CliRunner().invoke(main, shlex.split(arguments))
    assert result.exit_code == 0
    assert "warning: no timestamp: frame 1 has no timestamp that a message can have" in result.stderr
    assert "no timestamp: 1 time" in result.stderr.splitlines()
    assert [t for topic, t, _ in messages(tmp_path / "touch.mcap") if topic == TEXT_TOPIC] == [10**9, 2 * 10**9]


def readable(path: Path) -> Iterator[Any]:
    """Records of a file as far as they go."""
    with path.open("rb") as stream, suppress(McapError):
        yield from StreamReader(stream).records


def rewritten(path: Path, new: Path) -> Path:
    """A whole file of what can be read of another, as `mcap recover` makes one."""
    with new.open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start(profile="ros2")
        for record in readable(path):
            match record:
                case Schema():
                    writer.register_schema(record.name, record.encoding, record.data)
                case Channel():
                    writer.register_channel(record.topic, record.message_encoding, record.schema_id, record.metadata)
                case Message():
                    writer.add_message(record.channel_id, record.log_time, record.data, record.publish_time, record.sequence)
        writer.finish()
    return new


def test_a_killed_process_leaves_what_it_had_written(default_kit: Kit, recording: Path, tmp_path: Path) -> None:
    """SIGKILL in the middle: rosbags wants the index that is not there, but the records are, up to the last full chunk."""
    path = tmp_path / "touch.mcap"
    command = [sys.executable, "-m", "tactape_fab", "watch", "-", "--tape", str(default_kit.path), "--mcap", str(path), "--json"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process, np.load(recording) as arrays:
        assert process.stdin is not None and process.stdout is not None
        for stamp, depth in zip(STAMPS, arrays["depth"], strict=True):
            process.stdin.write(npy(stamp) + npy(depth))
            process.stdin.flush()
            assert process.stdout.readline()
        time.sleep(0.2)
        process.send_signal(signal.SIGKILL)
    with pytest.raises(AnyReaderError):
        messages(path)
    stamps = [record.log_time for record in readable(path) if isinstance(record, Message)]
    whole = sorted(set(stamps))
    assert whole == [round(stamp * 1e9) for stamp in STAMPS[: len(whole)]]
    assert len(whole) >= COUNT - 4
    recovered = rewritten(path, tmp_path / "recovered.mcap")
    texts = [json.loads(m.data) for topic, _, m in messages(recovered) if topic == TEXT_TOPIC]
    assert [text["frame"] for text in texts[: len(whole)]] == list(range(len(whole)))
    assert [text["located"] for text in texts] == [k not in NOT_LOCATED for k in range(len(texts))]
