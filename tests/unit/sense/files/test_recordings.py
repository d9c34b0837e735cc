"""Recordings as frames: our own MCAP, rosbag2 by rosbags, LeRobot's tables; and what is wrong with them, said in one line."""

from __future__ import annotations

import json
import os
import re
import shlex
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import Result
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

from tactape_fab import Kit
from tactape_fab.base import launch
from tactape_fab.base.errors import FrameError, SpecError
from tactape_fab.base.libraries import library
from tactape_fab.base.templates import templates_folder
from tactape_fab.sense import Scene, load_sensor, simulate, simulate_frames
from tactape_fab.sense.files import lerobot_dataset, mcap_images
from tactape_fab.sense.files.image_message import colour_of, image_of
from tactape_fab.sense.files.recordings import is_recording, open_recording
from tactape_fab.sense.live.cdr import IMAGE
from tests.commands import run
from tests.live import SHAPE, ramp
from tests.recordings import dataset, film, image_message, mcap, pictures, unreadable_film

SENSOR = load_sensor("gelsight-mini")
COUNT = 4


def ramps(encoding: str = "32FC1", kind: str = "<f4") -> list[bytes]:
    return [IMAGE.encode(image_message((1000 * ramp(k)).astype(kind), encoding, k)) for k in range(COUNT)]


def answers(result: Result) -> list[dict[str, Any]]:
    assert result.exit_code == 0, result.output
    left_out = ("elapsed_ms", "timestamp", "force_n", "force_sigma_n")
    return [{k: v for k, v in json.loads(line).items() if k not in left_out} for line in result.stdout.splitlines()]


# MCAP and rosbag2


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize(("encoding", "kind"), [("32FC1", "<f4"), ("16UC1", "<u2")])
def test_images_of_an_mcap_file_are_frames(compression: CompressionType, encoding: str, kind: str, tmp_path: Path) -> None:
    path = mcap(tmp_path / "a.mcap", {"/gel": ramps(encoding, kind)}, compression=compression, chunk_size=400_000)
    file = open_recording(path, SENSOR)
    assert (file.topic, file.count, file.frame_shape, file.ours) == ("/gel", COUNT, SHAPE, False)
    assert [file.time_of(k) for k in range(COUNT)] == [100.5, 101.5, 102.5, 103.5]
    for k, frame in enumerate(file.frames()):
        np.testing.assert_array_equal(frame, (1000 * ramp(k)).astype(kind))


def test_a_stamp_that_nobody_set_is_no_time(tmp_path: Path) -> None:
    """A header of ROS begins as 0, which is 1970; our own log may begin at 0."""
    message = {**image_message(ramp(0), "32FC1"), "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}}
    for writer, time_s in (("other", None), ("tactape-fab 0.1.0", 0.0)):
        path = mcap(tmp_path / f"{writer}.mcap", {"/gel": [IMAGE.encode(message)]}, library=writer)
        assert open_recording(path, SENSOR).time_of(0) == time_s


@pytest.mark.parametrize("sensor", ["digit", "gelsight-mini"])
def test_our_own_log_is_decoded_as_its_frames_are(sensor: str, default_kit: Kit, tmp_path: Path) -> None:
    """DIGIT's frames are turned; the log's are upright and in metres."""
    kit, frames, log = default_kit.path, tmp_path / "f.npz", tmp_path / "f.mcap"
    assert run(f"simulate {kit} -o {frames} --count 3 --seed 3 --sensor {sensor}").exit_code == 0
    assert run(f"watch {frames} --rate 20 --no-drop --tape {kit} --sensor {sensor} --mcap {log}").exit_code == 0
    direct = answers(run(f"decode {frames} --tape {kit} --sensor {sensor} --json"))
    for one, other in zip(answers(run(f"decode {log} --tape {kit} --sensor {sensor} --json")), direct, strict=True):
        assert one["located"] and one["tape"] == other["tape"] and one["cell"] == other["cell"]
        assert one["position_mm"] == pytest.approx(other["position_mm"], abs=1e-5)
        assert one["theta_deg"] == pytest.approx(other["theta_deg"], abs=1e-4)
        if sensor == "gelsight-mini":  # DIGIT's profile knows no gel
            assert one["indentation_mm"] == pytest.approx(other["indentation_mm"], rel=1e-3)


def test_our_own_log_keeps_the_scale_of_its_file(default_kit: Kit, tmp_path: Path) -> None:
    """Of a profile that is 20 % off no frame is located by its own scale."""
    kit, log, sensor = default_kit.path, tmp_path / "f.mcap", tmp_path / "s.toml"
    sensor.write_text(
        (templates_folder() / "sensors" / "gelsight-mini.toml")
        .read_text(encoding="utf-8")
        .replace("[16.0, 16.0]", "[20.0, 20.0]")
    )
    for name, scale in (("f", 16.0), ("g", 16.5)):
        depth = simulate_frames(default_kit.tape, 2, seed=3).depth
        np.savez(tmp_path / f"{name}.npz", depth=depth, timestamp=np.arange(2.0), px_per_mm=(16.0, scale))
    assert run(f"watch {tmp_path}/f.npz --rate max --tape {kit} --sensor {sensor} --mcap {log}").exit_code == 0
    assert open_recording(log, load_sensor(sensor)).px_per_mm == (16.0, 16.0)
    told, direct = (answers(run(f"decode {path} --tape {kit} --sensor {sensor} --json")) for path in (log, tmp_path / "f.npz"))
    assert len(told) == 2 and all(one["located"] for one in told)
    for one, other in zip(told, direct, strict=True):
        assert one["position_mm"] == pytest.approx(other["position_mm"], abs=1e-5)
        assert np.diag(one["covariance"]) == pytest.approx(np.diag(other["covariance"]), rel=1e-3)
    both = f"watch {tmp_path}/in --idle 0.2 --tape {kit} --mcap {tmp_path}/both.mcap"
    (tmp_path / "in").mkdir()
    for name in ("f", "g"):
        (tmp_path / f"{name}.npz").rename(tmp_path / "in" / f"{name}.npz")
    assert run(both).exit_code == 0
    refused = run(f"decode {tmp_path}/both.mcap --tape {kit}")
    assert refused.exit_code == 2 and "images of /tactape/depth are of several px_per_mm" in refused.stderr


def test_recordings_and_files_are_decoded_in_the_order_given(default_kit: Kit, tmp_path: Path) -> None:
    kit, frames, log = default_kit.path, tmp_path / "f.npz", tmp_path / "f.mcap"
    assert run(f"simulate {kit} -o {frames} --count 2 --seed 3").exit_code == 0
    assert run(f"watch {frames} --rate 20 --no-drop --tape {kit} --mcap {log}").exit_code == 0
    other = tmp_path / "g.npz"
    assert run(f"simulate {kit} -o {other} --count 2 --seed 4").exit_code == 0
    told, alone = (answers(run(f"decode {files} --tape {kit} --json")) for files in (f"{log} {other} {log}", other))
    assert [one["frame"] for one in told] == [0, 1, 2, 3, 4, 5]
    assert [one["position_mm"] for one in told[2:4]] == [one["position_mm"] for one in alone]


def test_timestamps_come_back_from_our_own_log_to_the_last_digit(small_kit: Kit, tmp_path: Path) -> None:
    stamps = 1.7e9 + 0.040001234567 * np.arange(12)
    np.savez(tmp_path / "f.npz", depth=np.zeros((12, *SHAPE), dtype=np.float32), timestamp=stamps)
    assert run(f"watch {tmp_path}/f.npz --rate max --tape {small_kit.path} --mcap {tmp_path}/f.mcap").exit_code == 0
    file = open_recording(tmp_path / "f.mcap", SENSOR)
    assert [file.time_of(k) for k in range(12)] == stamps.tolist()


@pytest.mark.parametrize(
    ("library", "ours"),
    [("tactape-fab 0.1.0", True), ("mcap go #v1.7; tactape-fab 0.1.0", True), ("mcap go #v1", False), ("my tactape-fab", False)],
)
def test_our_own_log_stays_ours_when_mcap_s_tools_write_it_anew(library: str, ours: bool, tmp_path: Path) -> None:
    """As `mcap recover`, `filter` and `compress` do: with the sensor's own sign and unit its depths would be others."""
    path = mcap(tmp_path / "a.mcap", {"/tactape/depth": ramps("32FC1", "<f4")}, library=library)
    assert open_recording(path, SENSOR).ours == ours


def test_our_own_log_stays_ours_where_it_is_put_together_with_others(small_kit: Kit, tmp_path: Path) -> None:
    """As by `mcap merge`: answers of a sensor that is turned by 180 degrees were turned by as much."""
    np.save(tmp_path / "f.npy", ramp(0))
    assert run(f"watch {tmp_path}/f.npy --rate 20 --tape {small_kit.path} --mcap {tmp_path}/f.mcap").exit_code == 0
    other = mcap(tmp_path / "other.mcap", {"/gel/depth": ramps()})
    with (tmp_path / "both.mcap").open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start(profile="ros2", library="mcap go v1.7.0")
        for path in (tmp_path / "f.mcap", other):
            for schema, channel, sent in make_reader(BytesIO(path.read_bytes())).iter_messages():
                assert schema is not None
                kind = writer.register_schema(name=schema.name, encoding=schema.encoding, data=schema.data)
                at = writer.register_channel(channel.topic, channel.message_encoding, kind, channel.metadata)
                writer.add_message(at, sent.log_time, sent.data, sent.publish_time)
        writer.finish()
    ours, others = (open_recording(tmp_path / "both.mcap", SENSOR, topic) for topic in ("/tactape/depth", "/gel/depth"))
    assert (ours.ours, others.ours) == (True, False)


def test_depths_of_a_log_without_a_unit_say_nothing_of_the_contact(default_kit: Kit, tmp_path: Path) -> None:
    kit, log = default_kit.path, tmp_path / "f.mcap"
    depth = simulate(default_kit.tape, (40.0, 20.0), 10.0, sensor="digit", scene=Scene(tilt_mm_per_mm=(0.0, 0.0), dome_mm=0.0))
    np.save(tmp_path / "f.npy", 1e-3 * (depth - depth.min()) / np.ptp(depth))  # DIGIT's profile says no unit
    assert run(f"watch {tmp_path}/f.npy --rate 20 --no-drop --tape {kit} --sensor digit --mcap {log}").exit_code == 0
    (answer,) = answers(run(f"decode {log} --tape {kit} --sensor digit --json"))
    assert answer["located"] and [answer[key] for key in ("tilt_deg", "indentation_mm")] == [None, None]


@pytest.mark.parametrize("mode", [None, CompressionMode.STORAGE])
def test_a_folder_of_rosbag2_is_read(mode: CompressionMode | None, tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    writer = BagWriter(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        depth = writer.add_connection("/gel/depth", "sensor_msgs/msg/Image", typestore=store)
        text = writer.add_connection("/said", "std_msgs/msg/String", typestore=store)
        for k in range(COUNT):
            header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](7 + k, 0), "gel")
            data = ramp(k).reshape(-1).view(np.uint8)
            image = types["sensor_msgs/msg/Image"](header, *SHAPE, "32FC1", 0, 4 * SHAPE[1], data)
            writer.write(depth, k, store.serialize_cdr(image, "sensor_msgs/msg/Image"))
            writer.write(text, k, store.serialize_cdr(types["std_msgs/msg/String"]("x"), "std_msgs/msg/String"))
    assert is_recording(tmp_path / "bag")
    file = open_recording(tmp_path / "bag", SENSOR)
    assert (file.topic, [file.time_of(k) for k in range(COUNT)]) == ("/gel/depth", [7.0, 8.0, 9.0, 10.0])
    for k, frame in enumerate(file.frames()):
        np.testing.assert_array_equal(frame, ramp(k))


def _split(folder: Path, *, listed: Sequence[str] = ("b_10.mcap", "b_9.mcap"), mode: str = "") -> Path:
    """A bag of two files with a frame each, and its list, as rosbag2 lays it out."""
    for k in (9, 10):
        mcap(folder / f"b_{k}.mcap", {"/gel": [IMAGE.encode(image_message(ramp(k), "32FC1", k))]})
    lines = "".join(f"    - {name}\n" for name in listed)
    text = f"rosbag2_bagfile_information:\n  compression_mode: {mode}\n  relative_file_paths:\n{lines}  ros_distro: jazzy\n"
    (folder / "metadata.yaml").write_text(text, encoding="utf-8")
    return folder


@pytest.mark.parametrize("listed", [("b_10.mcap", "b_9.mcap"), ('"bag/b_10.mcap"', "'b_9.mcap.zstd'")])
def test_files_of_a_split_bag_are_read_in_the_order_of_its_list(listed: Sequence[str], tmp_path: Path) -> None:
    first, second = open_recording(_split(tmp_path, listed=listed), SENSOR).frames()
    np.testing.assert_array_equal(first, ramp(10))
    np.testing.assert_array_equal(second, ramp(9))


def test_the_file_of_a_bag_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    bag = _split(tmp_path)
    (bag / "b_9.mcap").unlink()
    (bag / "b_9.mcap").mkdir()
    message = f"{re.escape(str(bag / 'b_9.mcap'))} cannot be read: it is no regular file; record it again"
    with pytest.raises(SpecError, match=f"^{message}"):
        open_recording(bag, SENSOR)


@pytest.mark.parametrize("kind", ["folder", ".db3", ".bag"])
def test_a_bag_of_another_kind_is_refused_with_the_line_that_converts_it(kind: str, small_kit: Kit, tmp_path: Path) -> None:
    """ROS 2's SQLite and ROS 1; the line is run as it is said."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == ".bag" else Stores.ROS2_HUMBLE)
    types, bag = store.types, tmp_path / ("a b.bag" if kind == ".bag" else "a bag")
    order = (0,) if kind == ".bag" else ()  # the sequence number
    writer: Any = Ros1Writer(bag) if kind == ".bag" else BagWriter(bag, version=9, storage_plugin=StoragePlugin.SQLITE3)
    with writer:
        depth = writer.add_connection("/gel/depth", "sensor_msgs/msg/Image", typestore=store)
        for k in range(COUNT):
            header = types["std_msgs/msg/Header"](*order, types["builtin_interfaces/msg/Time"](7 + k, 0), "gel")
            image = types["sensor_msgs/msg/Image"](header, *SHAPE, "32FC1", 0, 4 * SHAPE[1], ramp(k).reshape(-1).view(np.uint8))
            write = store.serialize_ros1 if kind == ".bag" else store.serialize_cdr
            writer.write(depth, k, write(image, "sensor_msgs/msg/Image"))
    given = next(bag.glob("*.db3")) if kind == ".db3" else bag
    refused = run(f"decode {shlex.quote(str(given))} --tape {small_kit.path}")
    said = re.search(r"rosbags-convert (--src .* --dst (.*) --dst-storage mcap) makes one", refused.stderr)
    assert refused.exit_code == 2 and said is not None, refused.output
    command = [sys.executable, "-c", "from rosbags.convert.cli import main; main()", *shlex.split(said[1])]
    subprocess.run(command, check=True)
    for k, frame in enumerate(open_recording(shlex.split(said[2])[0], SENSOR).frames()):
        np.testing.assert_array_equal(frame, ramp(k))


def test_colour_images_have_blue_first() -> None:
    image = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    np.testing.assert_array_equal(colour_of(image_of(IMAGE.encode(image_message(image, "bgr8")))), image)
    np.testing.assert_array_equal(colour_of(image_of(IMAGE.encode(image_message(image, "rgb8")))), image[:, :, ::-1])
    with pytest.raises(FrameError, match="encoding is 'mono8'"):
        colour_of(image_of(IMAGE.encode(image_message(image[:, :, 0].copy(), "mono8"))))


def test_a_message_that_breaks_off_is_refused() -> None:
    whole = ramps()[0]
    for cut in (0, 3, 4, 11, 20, 30, 45, len(whole) - 1):
        with pytest.raises(FrameError, match="no image message"):
            image_of(whole[:cut])


# LeRobot


def test_images_of_a_dataset_are_frames(tmp_path: Path) -> None:
    deep = [(100 * ramp(k)).astype(np.uint16) for k in range(COUNT)]
    of_image = {"dtype": "image", "shape": [*SHAPE, 1]}
    grey: list[npt.NDArray[Any]] = [np.repeat((d // 4).astype(np.uint8)[..., None], 3, axis=2) for d in deep]
    images: list[npt.NDArray[Any]]
    exact = [ramp(k) for k in range(COUNT)]
    for k, (images, ending) in enumerate((([*deep], ".png"), (grey, ".png"), ([*deep], ".tif"), ([*exact], ".tiff"))):
        file = open_recording(dataset(tmp_path / str(k), of_image, pictures(images, ending)), SENSOR)
        assert (file.topic, file.count) == ("touch", COUNT)
        assert [file.time_of(k) for k in range(COUNT)] == pytest.approx([0.0, 0.04, 0.08, 0.12])
        for image, frame in zip(images, file.frames(), strict=True):
            np.testing.assert_array_equal(frame, image if image.ndim == 2 else image[:, :, 0])


def test_arrays_of_a_dataset_are_decoded(default_kit: Kit, tmp_path: Path) -> None:
    depth = simulate_frames(default_kit.tape, COUNT, seed=4).depth
    np.savez(tmp_path / "f.npz", depth=depth)
    column = pa.array(depth.tolist(), type=pa.list_(pa.list_(pa.float32())))
    folder = dataset(tmp_path / "set", {"dtype": "float32", "shape": list(SHAPE)}, column)
    expected = answers(run(f"decode {tmp_path}/f.npz --tape {default_kit.path} --json"))
    assert answers(run(f"decode {folder} --tape {default_kit.path} --json")) == expected
    assert answers(run(f"decode --tape {default_kit.path} {folder} --topic touch --json")) == expected  # no kit, though a folder
    nested = pa.array(depth[..., None].tolist(), type=pa.list_(pa.list_(pa.list_(pa.float32()))))
    with_channel = dataset(tmp_path / "one-channel", {"dtype": "float32", "shape": [*SHAPE, 1]}, nested)
    assert answers(run(f"decode {with_channel} --tape {default_kit.path} --json")) == expected
    assert sum(one["located"] for one in expected) == COUNT


def test_equal_images_are_not_unpacked_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows that are equal take no room in a table: as many of them as its size allows are unpacked, and then it is refused."""
    one = np.zeros(SHAPE, np.uint16)
    of_image = {"dtype": "image", "shape": [*SHAPE, 3]}
    monkeypatch.setattr(lerobot_dataset, "MOST_TIMES_PACKED", 1)
    monkeypatch.setattr(lerobot_dataset, "MOST_UNPACKED_BYTES", 20 * one.nbytes)
    assert open_recording(dataset(tmp_path / "few", of_image, pictures([one] * 20), count=20), SENSOR).count == 20
    with pytest.raises(SpecError, match="unpack to far more bytes than a dataset of its size has; write fewer"):
        open_recording(dataset(tmp_path / "many", of_image, pictures([one] * 400), count=400), SENSOR)
    column = pa.FixedSizeListArray.from_arrays(pa.array(np.zeros(400 * one.size, np.float32)), one.size)
    with pytest.raises(SpecError, match="unpack to far more bytes"):
        open_recording(dataset(tmp_path / "arrays", {"dtype": "float32", "shape": list(SHAPE)}, column, count=400), SENSOR)


@pytest.mark.skipif(sys.platform != "linux", reason="memory is bounded on Linux alone")
@pytest.mark.parametrize(
    ("column", "said"),
    [
        ("touch", r"a row of file-000\.parquet unpacks to far more than"),
        ("timestamp", r"timestamps in file-000\.parquet are no num"),
    ],
)
def test_a_list_without_end_is_refused(column: str, said: str, small_kit: Kit, tmp_path: Path) -> None:
    """Equal values take no room in a file, and are counted in none of its sizes.

    They are read in a process that has no room left over, not even for the stack of a thread: pyarrow's would end the process.
    """
    folder = dataset(tmp_path / "set", {"dtype": "float32", "shape": list(SHAPE)}, None)
    count = 20_000_000
    endless = pa.LargeListArray.from_arrays(pa.array([0, count], pa.int64()), pa.array(np.zeros(count, dtype=np.float32)))
    table = pa.table({"touch": [[0.0]], "timestamp": [0.0]} | {column: endless})
    pq.write_table(table, folder / "data" / "chunk-000" / "file-000.parquet", compression="zstd")
    program = (
        "import sys; from tactape_fab.cli import main; from tactape_fab.sense.files import lerobot_dataset as d; "
        "d._BLANK_BYTES, d._ROOM_BYTES = 1 << 20, 1 << 22; main(sys.argv[1:])"
    )
    words = ("decode", str(folder), "--tape", str(small_kit.path))
    done = launch.run(launch.python_command(program, *words), timeout_s=100.0, scratch=tmp_path)
    assert done.returncode == 2 and re.search(said, done.stderr), done.stderr


def test_large_arrays_are_read_one_by_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, batches = list[int](), lerobot_dataset._batches

    def counted(folder: Path, columns: list[str], rows: int = 0) -> Iterator[Any]:
        for batch in batches(folder, columns, rows):
            asked.append(batch.num_rows)
            yield batch

    monkeypatch.setattr(lerobot_dataset, "_batches", counted)
    column = pa.FixedSizeListArray.from_arrays(pa.array(np.zeros(4 * 2048**2, np.float32)), 2048**2)
    with pytest.raises(SpecError, match="holds frames of 2048 x 2048 px"):
        open_recording(dataset(tmp_path / "set", {"dtype": "float32", "shape": [2048, 2048]}, column), SENSOR)
    assert asked == [1] * 4


def test_films_of_a_dataset_are_colour_images(tmp_path: Path) -> None:
    folder = dataset(tmp_path / "set", {"dtype": "video", "shape": [*SHAPE, 3]}, None)
    film(
        folder / "videos" / "touch" / "chunk-000" / "file-000.mp4",
        [np.full((*SHAPE, 3), 50 * k, dtype=np.uint8) for k in range(COUNT)],
    )
    file = open_recording(folder, SENSOR, colour=True)
    assert file.count == COUNT and file.time_of(1) == pytest.approx(0.04)
    assert [round(float(image.mean()) / 50) for image in file.frames()] == list(range(COUNT))
    with pytest.raises(SpecError, match=r"films lose depth"):
        open_recording(folder, SENSOR)


@pytest.mark.parametrize(("counts", "said"), [((1, 2), "fewer"), ((2, 1), "fewer"), ((3, 2), "more")])
def test_films_with_other_images_than_rows_are_refused(counts: tuple[int, int], said: str, tmp_path: Path) -> None:
    """A film that lost one image would give all behind it the times of others."""
    folder = dataset(tmp_path / "set", {"dtype": "video", "shape": [*SHAPE, 3]}, None)
    for k, count in enumerate(counts):
        film(folder / "videos" / "touch" / "chunk-000" / f"file-00{k}.mp4", [np.zeros((*SHAPE, 3), dtype=np.uint8)] * count)
    with pytest.raises(SpecError, match=f"its films have {said} images than its tables have rows"):
        open_recording(folder, SENSOR, colour=True)


def test_a_film_of_which_no_image_can_be_unpacked_is_refused(tmp_path: Path) -> None:
    folder = dataset(tmp_path / "set", {"dtype": "video", "shape": [*SHAPE, 3]}, None)
    unreadable_film(folder / "videos" / "touch" / "chunk-000" / "file-000.mp4", [np.zeros((*SHAPE, 3), dtype=np.uint8)] * COUNT)
    with pytest.raises(SpecError, match=r"file-000\.mp4 cannot be unpacked by this OpenCV; .* with use_videos=False"):
        open_recording(folder, SENSOR, colour=True)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no FIFOs")
def test_a_film_that_is_a_fifo_is_refused(tmp_path: Path) -> None:
    path = dataset(tmp_path / "set", {"dtype": "video", "shape": [*SHAPE, 3]}, None)
    (path / "videos" / "touch" / "chunk-000").mkdir(parents=True)
    os.mkfifo(path / "videos" / "touch" / "chunk-000" / "file-000.mp4")  # OpenCV would wait for its writer
    with pytest.raises(SpecError, match="it is no regular file"):
        open_recording(path, SENSOR, colour=True)


# What is wrong


def _several(folder: Path) -> Path:
    return mcap(folder / "a.mcap", {"/left": ramps(), "/right": ramps()})


def _cut(folder: Path) -> Path:
    path = mcap(folder / "a.mcap", {"/gel": ramps()})
    path.write_bytes(path.read_bytes()[:-2000])
    return path


def _no_file(folder: Path) -> Path:
    (folder / "metadata.yaml").write_text("x", encoding="utf-8")
    return folder


def _bomb(folder: Path) -> Path:
    return mcap(folder / "a.mcap", {"/gel": [bytes(1 << 25)]}, compression=CompressionType.LZ4)


def _noise(folder: Path) -> Path:
    (folder / "a.mcap").write_bytes(np.random.default_rng(1).bytes(5000))
    return folder / "a.mcap"


def _other_size(folder: Path) -> Path:
    return mcap(folder / "a.mcap", {"/gel": [*ramps(), IMAGE.encode(image_message(ramp(0)[:100].copy(), "32FC1"))]})


def _table(folder: Path) -> Path:
    path = dataset(folder / "set", {"dtype": "image", "shape": [*SHAPE, 3]}, pictures([ramp(0).astype(np.uint16)] * COUNT))
    (path / "data" / "chunk-000" / "file-001.parquet").write_bytes(b"PAR1" + bytes(100) + b"PAR1")
    return path


def _statistics(folder: Path) -> Path:
    path = dataset(folder / "set", {"dtype": "image", "shape": [*SHAPE, 3]}, pictures([ramp(0).astype(np.uint16)] * COUNT))
    broken = Path(__file__).parents[3] / "data" / "size_statistics.parquet"
    (path / "data" / "chunk-000" / "file-001.parquet").write_bytes(broken.read_bytes())
    return path


def _colour(folder: Path) -> Path:
    image = np.random.default_rng(2).integers(0, 255, (*SHAPE, 3), dtype=np.uint8)
    return dataset(folder / "set", {"dtype": "image", "shape": [*SHAPE, 3]}, pictures([image] * COUNT))


def _beside(folder: Path) -> Path:
    column = pa.array(
        [{"bytes": None, "path": "../../etc/passwd"}] * COUNT, type=pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    )
    return dataset(folder / "set", {"dtype": "image", "shape": [*SHAPE, 3]}, column)


def _film_of_depth(folder: Path) -> Path:
    return dataset(folder / "set", {"dtype": "video", "shape": [*SHAPE, 1], "info": {"is_depth_map": True}}, None)


def _no_features(folder: Path) -> Path:
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text('{"features": []}', encoding="utf-8")
    return folder


def _flipped(folder: Path) -> Path:
    """One bit of a pixel."""
    path = mcap(folder / "a.mcap", {"/gel": ramps()}, compression=CompressionType.NONE)
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 1
    path.write_bytes(whole)
    return path


def _many_records(folder: Path) -> Path:
    return _chunked(folder, 1_000_000, 1_000_000)


def _half_a_chunk(folder: Path) -> Path:
    return _chunked(folder, 500, 1000)


def _chunked(folder: Path, count: int, announced: int) -> Path:
    """Records of no kind, 9 bytes each, in a chunk without a checksum."""
    junk = (b"\x80" + bytes(8)) * count
    packed = library("zstandard", "this test").compress(junk)
    content = struct.pack("<QQQII4sQ", 0, 0, 9 * announced, 0, 4, b"zstd", len(packed)) + packed
    path = mcap(folder / "a.mcap", {"/gel": ramps()})
    whole = path.read_bytes()
    path.write_bytes(whole[:8] + b"\x06" + struct.pack("<Q", len(content)) + content + whole[8:])
    return path


def _many_bytes(folder: Path) -> Path:
    return mcap(folder / "a.mcap", {"/gel": [bytes(1 << 20)] * 20}, compression=CompressionType.ZSTD, chunk_size=1 << 20)


def _vast_rows(folder: Path) -> Path:
    rows = [{"bytes": bytes(1 << 23), "path": "a.png"}] * COUNT
    return dataset(
        folder / "set",
        {"dtype": "image", "shape": [*SHAPE, 3]},
        pa.array(rows, type=pa.struct([("bytes", pa.binary()), ("path", pa.string())])),
    )


def _long_names(folder: Path) -> Path:
    features = {f"{k} {'x' * 5000}": {"dtype": "image", "shape": [*SHAPE, 3]} for k in range(100)}
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(json.dumps({"features": features}), encoding="utf-8")
    return folder


def _list_alone(folder: Path) -> Path:
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  relative_file_paths:\n    - b_9.mcap\n")
    return folder


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda folder: folder / "a.mcap", r"a\.mcap cannot be read: No such file or directory; record it again"),
        (lambda folder: mcap(folder / "a.mcap", {}), "it has no topic of sensor_msgs/msg/Image; record the images themselves"),
        (_flipped, "crc validation failed"),
        (_half_a_chunk, "a chunk in it holds 4500 of 9000 bytes"),
        (_many_records, "its chunks unpack to far more records"),
        (_many_bytes, "its chunks unpack to far more bytes"),
        (_vast_rows, r"rows of file-000\.parquet unpack to more than [\d]+ bytes at once"),
        (_long_names, r"1 x{98}\.\.\., .*, 19 x{97}\.\.\. and 80 more$"),
        (_several, "give --topic NAME, one of: /left, /right"),
        (_cut, r"is damaged .*; mcap recover FILE\.mcap -o WHOLE\.mcap saves what is whole"),
        (lambda folder: _split(folder, listed=["b_9.mcap", "b_10.mcap", "b_11.mcap"]), r"lists b_11\.mcap, not there"),
        (_list_alone, r"lists b_9\.mcap, not there"),
        (lambda folder: _split(folder, listed=["b_9.mcap"]), r"does not list b_10\.mcap; move that away"),
        (lambda folder: _split(folder, mode="MESSAGE"), "each message in it is packed by itself, .*rosbags-convert --src"),
        (_no_file, "rosbags-convert --src .* --dst-storage mcap"),
        (_bomb, "unpacks to more than"),
        (_noise, "is damaged"),
        (_other_size, "image 4 of /gel has 100 x 320 px"),
        (_table, "cannot be read: .*; record it again"),
        (_statistics, "cannot be read|is damaged"),
        (_colour, "a colour image, which decode reads after --raw"),
        (_beside, "not in the table, but beside it"),
        (_film_of_depth, r"no feature of images or arrays of depth \(films lose depth\); record .* --dataset\.video=false, "),
        (_no_features, "names no features"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    made: Callable[[Path], Path], said: str, small_kit: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_images, "MOST_CHUNK_BYTES", 1 << 24)
    monkeypatch.setattr(mcap_images, "MOST_UNPACKED_BYTES", 1 << 24)
    monkeypatch.setattr(mcap_images, "MOST_TIMES_PACKED", 1)
    monkeypatch.setattr(lerobot_dataset, "_BLANK_BYTES", 1 << 22)
    monkeypatch.setattr(lerobot_dataset, "_MOST_PACKED", 1)
    path = made(tmp_path)
    with pytest.raises(SpecError, match=said):
        list(open_recording(path, SENSOR).frames())
    result = run(f"decode {path} --tape {small_kit.path}")
    lines = [line for line in result.stderr.splitlines() if line.startswith("error")]
    assert result.exit_code == 2 and len(lines) == 1, result.output


def test_a_topic_is_for_recordings(small_kit: Kit, tmp_path: Path) -> None:
    np.save(tmp_path / "f.npy", ramp(0))
    result = run(f"decode {tmp_path}/f.npy --topic /gel --tape {small_kit.path}")
    assert result.exit_code == 2 and "--topic is for recordings" in result.stderr


def test_chunks_that_unpack_to_anything_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bounds hold whatever the packed data say of their size."""
    lz4, zstandard = library("lz4.frame", "this test"), library("zstandard", "this test")
    monkeypatch.setattr(mcap_images, "MOST_CHUNK_BYTES", 1 << 20)
    zeros = bytes(1 << 24)
    for name, data in (("zstd", zstandard.compress(zeros)), ("lz4", lz4.compress(zeros))):
        chunk: Any = type("Chunk", (), {"compression": name, "data": data})()
        with pytest.raises(SpecError, match="unpacks to more"):
            mcap_images._unpacked(chunk)
