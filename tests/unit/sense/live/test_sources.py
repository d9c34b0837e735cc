"""Sources of frames as they come: files replayed, a folder that grows, a stream, a camera; and what is wrong with them, said."""

from __future__ import annotations

import io
import os
import sys
import threading
from pathlib import Path
from threading import Event
from time import monotonic, process_time, sleep, time
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from tactape_fab.base.errors import SpecError, TactapeError
from tactape_fab.sense.files.depth_maps import SUFFIXES, open_frame_file
from tactape_fab.sense.live import folder as folder_module
from tactape_fab.sense.live.camera import camera_named, camera_source, film_source
from tactape_fab.sense.live.folder import folder_source
from tactape_fab.sense.live.replay import has_stamps, refuse_no_seconds, replay
from tactape_fab.sense.live.sources import Frame, Trouble
from tactape_fab.sense.live.stream import stream_source
from tests.live import SHAPE, npy, ramp, read, save_npz
from tests.recordings import film, turned_film, unreadable_film

# Replay


def test_a_replay_has_the_frames_and_stamps_of_its_file(tmp_path: Path) -> None:
    stamps = np.array([5.0, np.nan, 5.02])
    file = open_frame_file(save_npz(tmp_path / "f.npz", [ramp(k) for k in range(3)], timestamp=stamps, px_per_mm=15.5))
    frames, troubles = read(replay(file))
    assert troubles == []
    assert [(f.number, f.timestamp, f.px_per_mm, f.keep) for f in frames] == [
        (0, 5.0, (15.5, 15.5), False), (1, None, (15.5, 15.5), True), (2, 5.02, (15.5, 15.5), False)
    ]  # fmt: skip
    for k, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.image, ramp(k))


@pytest.mark.parametrize(
    ("rate_hz", "stamps", "least_s"), [(20.0, True, 0.15), (None, True, 0.3), (None, False, 0.12), (float("inf"), True, 0.0)]
)
def test_a_replay_takes_its_time(tmp_path: Path, rate_hz: float | None, stamps: bool, least_s: float) -> None:
    """At the rate given; else at its timestamps' (0.1 s apart here), or at 25 Hz."""
    others = {"timestamp": 7.0 + 0.1 * np.arange(4)} if stamps else {}
    file = open_frame_file(save_npz(tmp_path / "f.npz", [ramp(k) for k in range(4)], **others))
    start = monotonic()
    frames, _ = read(replay(file, rate_hz))
    took_s = monotonic() - start
    assert len(frames) == 4
    assert least_s <= took_s < least_s + 5.0
    assert [f.keep for f in frames] == [rate_hz == float("inf")] * 4


def test_no_frame_is_dropped_because_the_clock_was_set_back(tmp_path: Path) -> None:
    stamps = [5.0, 5.01, 1.0, np.nan, 5.01, 5.02]
    file = open_frame_file(save_npz(tmp_path / "f.npz", [ramp(0)] * 6, timestamp=stamps))
    assert [f.keep for f in read(replay(file))[0]] == [False, False, True, True, True, False]
    assert [f.keep for f in read(replay(file, 200.0))[0]] == [False] * 6


def test_a_rate_stamps_what_has_no_stamp(tmp_path: Path) -> None:
    bare = open_frame_file(save_npz(tmp_path / "bare.npz", [ramp(k) for k in range(3)]))
    stamped = open_frame_file(save_npz(tmp_path / "stamped.npz", [ramp(k) for k in range(3)], timestamp=np.arange(3.0)))
    assert [f.timestamp for f in read(replay(bare, 200.0))[0]] == [0.0, 0.005, 0.01]
    assert [f.timestamp for f in read(replay(bare, float("inf")))[0]] == [None] * 3
    assert [f.timestamp for f in read(replay(stamped, 200.0))[0]] == [0.0, 1.0, 2.0]
    given = [(bare, None), (bare, float("inf")), (bare, 10.0), (stamped, None), (stamped, float("inf"))]
    assert [has_stamps(file, rate) for file, rate in given] == [False, False, True, True, True]


def test_a_replay_that_breaks_off_says_so(tmp_path: Path) -> None:
    path = tmp_path / "f.npy"
    path.write_bytes(npy(np.stack([ramp(k) for k in range(3)]))[:-1000])
    frames, (trouble,) = read(replay(open_frame_file(path), float("inf")))
    assert len(frames) == 2
    assert trouble.kind == "file damaged"
    assert "after 2 of 3 frames" in trouble.message and "ends in the middle of a frame" in trouble.message


def test_a_replay_stops_when_told(tmp_path: Path) -> None:
    file = open_frame_file(save_npz(tmp_path / "f.npz", [ramp(0)] * 3, timestamp=[0.0, 1000.0, 2000.0]))
    stop = Event()
    found = replay(file)(stop)
    next(found)
    threading.Timer(0.05, stop.set).start()
    start = monotonic()
    assert [one.kind for one in found if isinstance(one, Trouble)] == ["long pause"]
    assert monotonic() - start < 5.0


@pytest.mark.parametrize(
    ("step", "said"),
    [
        (40_000_000, "frame 1 comes 4e+07 s after frame 0, and a replay waits 3600 s at most"),
        (40, "a timestamp is 1.7641e+18 s, not below 1e+11 s"),
    ],
)
def test_stamps_that_are_no_seconds_are_not_replayed(tmp_path: Path, step: int, said: str) -> None:
    stamps = 1_764_100_000_000_000_000 + step * np.arange(3)
    file = open_frame_file(save_npz(tmp_path / "ns.npz", [ramp(k) for k in range(3)], timestamp=stamps))
    assert [file.time_of(k) for k in range(3)] == stamps.tolist()  # every digit
    with pytest.raises(SpecError) as caught:
        refuse_no_seconds(file)
    assert said in str(caught.value) and "timestamps are seconds" in str(caught.value) and "rate=HZ" in str(caught.value)
    refuse_no_seconds(open_frame_file(save_npz(tmp_path / "s.npz", [ramp(0)] * 3, timestamp=[1.7641e9, np.nan, 1.7641e9 + 3600])))


def test_a_long_pause_is_said_before_it_is_made(tmp_path: Path) -> None:
    file = open_frame_file(save_npz(tmp_path / "ms.npz", [ramp(0)] * 2, timestamp=[0, 40]))
    found = replay(file)(Event())
    next(found)
    said = next(found)
    assert isinstance(said, Trouble) and "frame 1 comes in 40" in said.message and "rate=HZ" in said.message


# Stream


def test_a_stream_is_arrays_one_behind_the_other() -> None:
    data = npy(ramp(0)) + npy(np.stack([ramp(1), ramp(2)])) + npy(np.asfortranarray(ramp(3))) + npy(ramp(4).astype(np.uint16))
    frames, troubles = read(stream_source(io.BytesIO(data), clock=lambda: 77.0))
    assert troubles == []
    assert [(f.number, f.timestamp, f.keep) for f in frames] == [
        (0, 77.0, False),
        (1, 77.0, True),
        (2, 77.0, True),
        (3, 77.0, False),
        (4, 77.0, False),
    ]
    for k in range(4):
        np.testing.assert_array_equal(frames[k].image, ramp(k))


def test_a_number_before_a_frame_is_its_timestamp() -> None:
    data = npy(1234.5) + npy(ramp(0)) + npy(ramp(1)) + npy(np.float64(2.5)) + npy(ramp(2))
    assert [f.timestamp for f in read(stream_source(io.BytesIO(data), clock=lambda: 77.0))[0]] == [1234.5, 77.0, 2.5]


@pytest.mark.parametrize("stamp", [np.int64(1763800000123456789), np.uint64(2**64 - 1), np.int32(7), np.longdouble(1.5)])
def test_whole_numbers_are_passed_on_to_the_last_digit(stamp: np.number[Any]) -> None:
    (frame,) = read(stream_source(io.BytesIO(npy(stamp) + npy(ramp(0)))))[0]
    assert frame.timestamp == stamp.item() and type(frame.timestamp) in (int, float)


@pytest.mark.parametrize("damaged", [npy(ramp(0))[:-1000], npy(np.zeros(3)), npy(ramp(0))[1:]])
def test_a_timestamp_is_of_no_frame_behind_a_damaged_one(damaged: bytes) -> None:
    """Cut off, of no frame's shape, and without its first byte."""
    data = npy(1234.5) + damaged + npy(ramp(1)) + npy(2.5) + npy(ramp(2))
    assert [f.timestamp for f in read(stream_source(io.BytesIO(data), clock=lambda: 77.0))[0]] == [77.0, 2.5]


class Dribble(io.RawIOBase):
    """A pipe that gives a few bytes at a time."""

    def __init__(self, data: bytes) -> None:
        self._data, self._rng = io.BytesIO(data), np.random.default_rng(1)

    def read(self, size: int = -1) -> bytes:
        return self._data.read(min(size, int(self._rng.integers(1, 5000))))


def test_a_stream_goes_on_behind_what_is_no_array() -> None:
    """Noise, an array of words, an array of four axes, one cut off by the next."""
    whole = npy(ramp(9))
    data = b"noise \x93NUM" + npy(ramp(0)) + npy(np.array(["a"], dtype=object)) + npy(ramp(1)) + npy(np.zeros((1, 2, 3, 4)))
    data += npy(ramp(2)) + whole[:100_000] + npy(ramp(3)) + b"\x93NUMPY\x01\x00\x05\x00{{{{{" + npy(ramp(4)) + whole[:-1]
    frames, troubles = read(stream_source(Dribble(data)))
    assert [float(f.image[0, 0]) for f in frames] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert {t.kind for t in troubles} == {"stream damaged"}
    said = "\n".join(t.message for t in troubles)
    for words in (
        "skipped 10 bytes",
        "not real numbers",
        "shape (1, 2, 3, 4)",
        "ends after 99872 of 307200 bytes",
        "ends after 307199 of",
    ):
        assert words in said, said


@pytest.mark.parametrize("cut", [0, 3, 7, 9, 50])
def test_a_stream_that_ends_anywhere_ends(cut: int) -> None:
    frames, troubles = read(stream_source(io.BytesIO(npy(ramp(0)) + npy(ramp(1))[:cut])))
    assert len(frames) == 1
    assert len(troubles) == (cut > 0)
    assert not any("stream ends" in trouble.message and "next array" in trouble.message for trouble in troubles)


@pytest.mark.parametrize("cut", [3, 7, 9, 11, 40, 125, 127])
def test_a_header_that_is_cut_off_does_not_take_the_next_array_along(cut: int) -> None:
    """Within the magic, version, length, text, and where the next magic begins in the text's last bytes."""
    frames, troubles = read(stream_source(Dribble(npy(ramp(0))[:cut] + npy(ramp(1)) + npy(ramp(2)))))
    assert [float(f.image[0, 0]) for f in frames] == [1.0, 2.0]
    assert {t.kind for t in troubles} == {"stream damaged"}


def test_a_stream_does_not_believe_in_a_giant() -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (1_000_000, 1_000_000)})
    frames, (trouble, *_) = read(stream_source(io.BytesIO(header.getvalue() + npy(ramp(0)))))
    assert len(frames) == 1
    assert "shape (1000000, 1000000)" in trouble.message


def test_headers_without_data_take_time_once() -> None:
    """Each announces all that follows: reading that again for each took 12 s for 4 MB."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (8000, 8000)})
    before_s = process_time()
    frames, troubles = read(stream_source(io.BytesIO(header.getvalue() * 20_000)))
    assert not frames and len(troubles) == 20_000
    assert process_time() - before_s < 3.0


@pytest.mark.parametrize(
    ("piece", "most"),
    [(b"\x93NUMPY", 1), (b"\x93NUMPY\x01\x00\x10\x27", 5_000), (b"\x93NUMPY\x02\x00\x10\x27\0\0{'", 5_000)],
    ids=["magic", "header", "header 2.0"],
)
def test_starts_of_arrays_without_an_array_take_time_once(piece: bytes, most: int) -> None:
    """The magic alone took 4 s for 1 MB, and 10 kB that each header announces 60 s for 50 kB."""
    before_s = process_time()
    frames, troubles = read(stream_source(io.BytesIO(piece * 5_000 + npy(ramp(0)))))
    assert len(frames) == 1 and len(troubles) <= most
    assert process_time() - before_s < 2.0


@pytest.mark.parametrize("shape", [(50_000, 0, 0), (50_000, 1, 1)])
def test_a_stack_of_another_sensor_is_told_once(shape: tuple[int, int, int]) -> None:
    """A header of a hundred bytes announces 10^18 frames without a pixel, behind which the next one would never come."""
    data = npy(np.zeros(shape, dtype=np.uint8)) + npy(ramp(0))
    frames, troubles = read(stream_source(io.BytesIO(data), frame_shape=SHAPE))
    assert [f.image.shape for f in frames] == [shape[1:], SHAPE] and not troubles
    whole = npy(np.stack([ramp(k) for k in range(3)]))
    assert len(read(stream_source(io.BytesIO(whole), frame_shape=SHAPE))[0]) == 3


# Folder


class Growing:
    """A folder source that is read by a thread of its own, as `watch` does."""

    def __init__(self, folder: Path, suffixes: tuple[str, ...] = SUFFIXES, **options: Any) -> None:
        self.frames: list[Frame] = []
        self.troubles: list[Trouble] = []
        self._stop = Event()
        self._thread = threading.Thread(target=self._read, args=(folder_source(folder, suffixes, **options),))
        self._thread.start()

    def _read(self, source: Any) -> None:
        for found in source(self._stop):
            (self.frames if isinstance(found, Frame) else self.troubles).append(found)

    def wait(self, frames: int, troubles: int = 0) -> None:
        end = monotonic() + 20.0
        while (len(self.frames) < frames or len(self.troubles) < troubles) and monotonic() < end:
            sleep(0.005)
        assert (len(self.frames), len(self.troubles)) == (frames, troubles), self.troubles

    def __enter__(self) -> Growing:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()


def test_a_folder_gives_what_is_there_in_order_and_then_what_comes(tmp_path: Path) -> None:
    for k in (2, 10, 1):
        np.save(tmp_path / f"frame_{k}.npy", ramp(k))
    (tmp_path / "notes.txt").write_text("no frame")
    (tmp_path / ".frame_0.npy").write_bytes(npy(ramp(0)))
    with Growing(tmp_path) as source:
        source.wait(3)
        save_npz(tmp_path / "two.npz", [ramp(20), ramp(21)], timestamp=[3.5, 4.5], px_per_mm=15.0)
        source.wait(5)
        cv2.imwrite(str(tmp_path / "last.png"), np.full(SHAPE, 30, dtype=np.uint16))
        source.wait(6)
    assert [int(f.image[0, 0]) for f in source.frames] == [1, 2, 10, 20, 21, 30]
    assert [f.number for f in source.frames] == list(range(6))
    assert [f.keep for f in source.frames] == [True] * 3 + [False] * 3
    assert [f.timestamp for f in source.frames[3:5]] == [3.5, 4.5]
    assert source.frames[3].px_per_mm == (15.0, 15.0)
    for k, name in ((0, "frame_1.npy"), (5, "last.png")):
        assert source.frames[k].timestamp == (tmp_path / name).stat().st_mtime


def grow(path: Path, data: bytes, pieces: int) -> None:
    """Write a file piece by piece."""
    with path.open("wb") as stream:
        for k in range(pieces):
            stream.write(data[k * len(data) // pieces : (k + 1) * len(data) // pieces])
            stream.flush()
            sleep(0.03)


def picture(suffix: str) -> bytes:
    shades = (1000.0 * ramp(1)).astype(np.uint16)
    return bytes(cv2.imencode(suffix, shades)[1].tobytes())


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".png", ".tif"])
def test_a_file_is_taken_when_it_is_whole(suffix: str, tmp_path: Path) -> None:
    if suffix == ".npz":
        data = save_npz(tmp_path / "there.npz", [ramp(1)]).read_bytes()
        (tmp_path / "there.npz").unlink()
    else:
        data = npy(ramp(1)) if suffix == ".npy" else picture(suffix)
    with Growing(tmp_path) as source:
        grow(tmp_path / f"frame{suffix}", data, 8)
        source.wait(1)
    wanted = ramp(1) if suffix.startswith(".np") else (1000.0 * ramp(1)).astype(np.uint16)
    np.testing.assert_array_equal(source.frames[0].image, wanted)


def test_a_stack_that_grows_is_taken_frame_by_frame(tmp_path: Path) -> None:
    data = npy(np.stack([ramp(k) for k in range(4)]))
    frame_bytes = ramp(0).nbytes
    with Growing(tmp_path) as source, (tmp_path / "stack.npy").open("wb") as stream:
        stream.write(data[: len(data) - 2 * frame_bytes])
        stream.flush()
        source.wait(2)
        stream.write(data[len(data) - 2 * frame_bytes :])
        stream.flush()
        source.wait(4)
    assert [(f.number, int(f.image[0, 0])) for f in source.frames] == [(0, 0), (1, 1), (2, 2), (3, 3)]


def test_a_file_that_stays_cut_off_is_said_once_and_does_not_hold_up_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder_module, "PATIENCE_S", 0.2)
    for name, data in (("a.npy", npy(ramp(0))), ("a.npz", b"PK\x03\x04"), ("a.png", picture(".png")), ("a.tif", picture(".tif"))):
        (tmp_path / name).write_bytes(data[: max(4, len(data) // 2)])
        os.utime(tmp_path / name, (time() - 9, time() - 9))
    with Growing(tmp_path) as source:
        np.save(tmp_path / "b.npy", ramp(5))
        source.wait(1, troubles=4)
        (tmp_path / "a.npy").write_bytes(npy(ramp(7)))
        source.wait(2, troubles=4)
    assert [int(f.image[0, 0]) for f in source.frames] == [5, 7]
    assert {t.kind for t in source.troubles} == {"file not whole"}
    for name in ("a.npy", "a.npz", "a.png", "a.tif"):
        assert sum(f"{tmp_path / name}" in t.message for t in source.troubles) == 1


def test_a_file_moved_into_the_place_of_an_unfinished_one_is_taken_whole(tmp_path: Path) -> None:
    data = npy(np.stack([ramp(0), ramp(1)]))
    (tmp_path / ".new").write_bytes(npy(np.stack([ramp(2), ramp(3)])))
    with Growing(tmp_path) as source:
        (tmp_path / "a.npy").write_bytes(data[:-1000])
        source.wait(1)
        (tmp_path / ".new").replace(tmp_path / "a.npy")
        source.wait(3)
    assert [int(f.image[0, 0]) for f in source.frames] == [0, 2, 3]


def test_a_folder_ends_when_idle_and_says_what_it_leaves(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", ramp(0))
    (tmp_path / "b.npy").write_bytes(npy(ramp(1))[:-1])
    start = monotonic()
    frames, (trouble,) = read(folder_source(tmp_path, SUFFIXES, idle_s=0.3))
    assert 0.3 <= monotonic() - start < 5.0
    assert len(frames) == 1
    assert "b.npy" in trouble.message


def test_a_file_of_another_sensor_is_told_once(tmp_path: Path) -> None:
    """A megabyte holds a million frames of a pixel; each took 0.3 ms, while those of the sensor waited."""
    np.save(tmp_path / "a.npy", np.zeros((50, 1, 1), dtype=np.uint8))
    np.save(tmp_path / "b.npy", np.stack([ramp(k) for k in range(3)]))
    frames, troubles = read(folder_source(tmp_path, SUFFIXES, idle_s=0.05, frame_shape=SHAPE))
    assert [f.image.shape for f in frames] == [(1, 1), SHAPE, SHAPE, SHAPE] and not troubles


def test_a_folder_says_what_cannot_be_opened_in_one_way(tmp_path: Path) -> None:
    for name in ("a.png", "b.npy"):
        (tmp_path / name).mkdir()
    found = list(folder_source(tmp_path, (".npy", ".png"), idle_s=0.05)(Event()))
    said = sorted(trouble.message.split("; ")[0] for trouble in found if isinstance(trouble, Trouble))
    assert said == [f"{tmp_path}/a.png: it is no regular file", f"{tmp_path}/b.npy cannot be read: it is no regular file"]


def test_a_folder_that_goes_away_is_an_error(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    found = folder_source(folder, SUFFIXES)(Event())
    folder.rmdir()
    with pytest.raises(TactapeError, match="frames cannot be looked into"):
        list(found)


def test_a_folder_of_colour_images(tmp_path: Path) -> None:
    for suffix in (".png", ".jpg"):
        data = bytes(cv2.imencode(suffix, np.full((24, 32, 3), (10, 20, 30), dtype=np.uint8))[1].tobytes())
        (tmp_path / f"whole{suffix}").write_bytes(data)
        (tmp_path / f"half{suffix}").write_bytes(data[: len(data) // 2])
    frames, troubles = read(folder_source(tmp_path, (".png", ".jpg"), colour=True, idle_s=0.1))
    assert [f.image.shape for f in frames] == [(24, 32, 3)] * 2
    assert sorted(Path(t.message.split(": ")[0].split(" ")[0]).stem for t in troubles) == ["half", "half"]


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_half_a_picture_is_none_whatever_opencv_makes_of_it(suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Versions before 5 show the top of it."""
    image = np.zeros((24, 32, 3), dtype=np.uint8)
    data = bytes(cv2.imencode(suffix, image)[1].tobytes())
    monkeypatch.setattr(folder_module, "read_colour", lambda path: image)
    (tmp_path / f"half{suffix}").write_bytes(data[: len(data) // 2])
    (tmp_path / f"whole{suffix}").write_bytes(data)
    frames, troubles = read(folder_source(tmp_path, (suffix,), colour=True, idle_s=0.05))
    assert len(frames) == 1
    assert "ends in the middle of the picture" in troubles[0].message


def test_a_tiff_is_not_looked_at_while_it_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looked = []

    def look(path: Path) -> Any:
        looked.append(time() - path.stat().st_mtime)
        return open_frame_file(path)

    monkeypatch.setattr(folder_module, "open_frame_file", look)
    with Growing(tmp_path) as source:
        grow(tmp_path / "a.tif", picture(".tif"), 8)
        source.wait(1)
    assert len(looked) == 1 and looked[0] >= 0.1


def test_a_tiff_of_a_clock_that_is_ahead_is_taken(tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_bytes(picture(".tif"))
    os.utime(tmp_path / "a.tif", (time() + 3600.0,) * 2)
    frames, troubles = read(folder_source(tmp_path, (".tif",), idle_s=1.0))
    assert (len(frames), troubles) == (1, [])


# Camera


class Shots:
    """A camera as OpenCV has them: images, or None where one cannot be unpacked; then no more."""

    def __init__(self, images: list[npt.NDArray[np.uint8] | None], opened: bool = True) -> None:
        self.images, self.opened, self.released, self.asked = images, opened, False, dict[int, float]()

    def isOpened(self) -> bool:  # noqa: N802
        return self.opened

    def set(self, key: int, value: float) -> None:
        self.asked[key] = value

    def grab(self) -> bool:
        return bool(self.images)

    def retrieve(self) -> tuple[bool, npt.NDArray[np.uint8] | None]:
        image = self.images.pop(0)
        return image is not None, image

    def get(self, key: int) -> float:
        assert key == cv2.CAP_PROP_POS_MSEC
        return self.driver_ms

    driver_ms = 0.0

    def release(self) -> None:
        self.released = True


def coloured(value: int, shape: tuple[int, int] = (240, 320)) -> npt.NDArray[np.uint8]:
    return np.full((*shape, 3), value, dtype=np.uint8)


def test_a_camera_s_images_are_stamped_when_grabbed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tactape_fab.sense.live.camera._MOST_MISSES", 2)
    shots = Shots([coloured(1), None, coloured(3)])
    times = iter([10.0, 10.04, 10.08])
    found = []
    with pytest.raises(TactapeError, match="/dev/video7 gives no more images"):
        for item in camera_source(Path("/dev/video7"), (240, 320), opened=lambda _: shots, clock=lambda: next(times))(Event()):
            found.append(item)
    assert [(f.number, f.timestamp) for f in found if isinstance(f, Frame)] == [(0, 10.0), (2, 10.08)]
    assert [t.kind for t in found if isinstance(t, Trouble)] == ["image damaged"]
    assert shots.released
    assert (shots.asked[cv2.CAP_PROP_FRAME_WIDTH], shots.asked[cv2.CAP_PROP_FRAME_HEIGHT]) == (320, 240)


def test_a_camera_s_images_have_the_driver_s_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the monotonic clock, as V4L2 says it; a fake device, for none with a driver is here. A time of no sense is not taken."""
    monkeypatch.setattr("tactape_fab.sense.live.camera.monotonic", lambda: 500.0)
    for driver_ms, expected in ((499_970.0, 999.97), (0.0, 1000.0), (500_001.0, 1000.0), (480_000.0, 1000.0)):
        monkeypatch.setattr(Shots, "driver_ms", driver_ms)
        frame = next(
            camera_source(Path("/dev/video7"), (240, 320), opened=lambda _: Shots([coloured(1)]), clock=lambda: 1000.0)(Event())
        )
        assert isinstance(frame, Frame) and frame.timestamp == pytest.approx(expected, abs=1e-6)


def test_a_camera_of_25_hz_keeps_its_times_however_late_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a GelSight Mini ticks; a fake device, read up to 35 ms late."""
    late_s, now = [0.001, 0.035, 0.0, 0.02, 0.009], {"s": 0.0}

    class Ticking(Shots):
        def grab(self) -> bool:
            k = len(late_s) - len(self.images)
            self.driver_ms = 500_000.0 + 40.0 * k
            now["s"] = self.driver_ms / 1000 + late_s[k]
            return True

    monkeypatch.setattr("tactape_fab.sense.live.camera.monotonic", lambda: now["s"])
    shots = Ticking([coloured(k) for k in range(len(late_s))])
    found = camera_source(Path("/dev/video7"), (240, 320), opened=lambda _: shots, clock=lambda: 1e9 + now["s"])(Event())
    stamps = [frame.timestamp for _, frame in zip(late_s, found, strict=False) if isinstance(frame, Frame)]
    assert stamps == pytest.approx([1e9 + 500.0 + 0.04 * k for k in range(len(late_s))], rel=0, abs=1e-6)


def devices(folder: Path, *names: tuple[str, int]) -> Path:
    """Names and indices of cameras as Linux has them in /sys/class/video4linux."""
    for k, (name, index) in enumerate(names):
        (folder / f"video{k}").mkdir(parents=True)
        (folder / f"video{k}" / "name").write_text(f"{name}\n", encoding="utf-8")
        (folder / f"video{k}" / "index").write_text(f"{index}\n", encoding="ascii")
    return folder


def test_a_camera_is_found_by_its_usb_name(tmp_path: Path) -> None:
    mini = "GelSight Mini R0B 2D19-HHKU: Gel"
    there = devices(tmp_path / "one", ("Integrated Camera", 0), (mini, 0), (mini, 1))
    assert camera_named("gelsight mini", there) == Path("/dev/video1") == camera_named("2D19", there)
    with pytest.raises(SpecError, match=r"no camera has that .*'Integrated Camera' \(/dev/video0\), 'GelSight Mini"):
        camera_named("digit", there)
    two = devices(tmp_path / "two", (mini, 0), ("GelSight Mini R0B 28VG-9AZ4: Gel", 0))
    with pytest.raises(SpecError, match=r"2 cameras have that .* give more of the name"):
        camera_named("GelSight Mini", two)
    assert camera_named("28VG", two) == Path("/dev/video1")
    with pytest.raises(SpecError, match="there is: none at all"):
        camera_named("GelSight", tmp_path / "none")
    with pytest.raises(SpecError, match=r"no camera has|cameras have"):
        camera_named(" ", there)


def test_a_camera_s_image_is_cut_and_scaled() -> None:
    image = coloured(0, (480, 640))
    image[100:220, 50:210] = 200
    source = camera_source(
        Path("/dev/video0"), (240, 320), (50, 100, 160, 120), opened=lambda _: Shots([image, coloured(1, (90, 90))])
    )
    found = source(Event())
    frame, small = next(found), next(found)
    assert isinstance(frame, Frame) and frame.image.shape == (240, 320, 3) and (frame.image == 200).all()
    assert isinstance(small, Trouble) and "frame 1 has 90 x 90 px, and crop = 50,100,160,120 reaches beyond" in small.message


def test_an_image_as_large_as_frames_is_not_taken_whole_where_a_part_is_to_be_cut() -> None:
    """It shows the gel at another scale than the network's."""
    source = camera_source(Path("/dev/video0"), (240, 320), (40, 20, 640, 480), opened=lambda _: Shots([coloured(1)]))
    assert isinstance(next(source(Event())), Trouble)


def test_a_camera_that_is_none_is_an_error() -> None:
    with pytest.raises(TactapeError, match="/dev/video0 cannot be opened"):
        list(camera_source(Path("/dev/video0"), (240, 320), opened=lambda _: Shots([], opened=False))(Event()))


def test_a_film_that_is_marked_as_turned_is_read_as_it_is_stored(tmp_path: Path) -> None:
    """As images and backgrounds are: OpenCV turns films alone."""
    image = coloured(40)
    image[:120] = 200
    same, turned = (make(tmp_path / f"{make.__name__}.mp4", [image]) for make in (film, turned_film))
    (told,), (stored,) = (read(film_source(path, (240, 320), keep=True))[0] for path in (turned, same))
    np.testing.assert_array_equal(told.image, stored.image)


@pytest.mark.parametrize("name", ["2026-11-28T10:30.mp4", "frame%03d.mp4"])
def test_a_film_is_opened_by_its_name_as_it_is(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """FFmpeg takes what is before a colon for a protocol."""
    monkeypatch.chdir(tmp_path)
    assert len(read(film_source(film(tmp_path / "film.mp4", [coloured(40)]).rename(name), (240, 320), keep=True))[0]) == 1


def test_a_list_of_films_that_ffmpeg_would_follow_is_no_film(tmp_path: Path) -> None:
    """It may name a FIFO, for whose writer FFmpeg waits for ever, or itself, which it opens until no file is left."""
    (tmp_path / "film.mp4").write_text("ffconcat version 1.0\nfile film.mp4\n")
    with pytest.raises(SpecError, match=r"film\.mp4 is no \.avi, \.mkv, \.mov or \.mp4 by its first bytes"):
        read(film_source(tmp_path / "film.mp4", (240, 320), keep=False))


@pytest.mark.skipif(sys.platform != "linux", reason="names are Unicode")
def test_a_film_whose_name_is_no_utf_8_does_not_end_the_process(tmp_path: Path) -> None:
    path = film(tmp_path / "film.mp4", [coloured(40)]).rename(tmp_path / "film\udcff.mp4")
    with pytest.raises(SpecError, match="has a path that is no UTF-8"):
        read(film_source(path, (240, 320), keep=False))


@pytest.mark.parametrize("codec", ["HFYU", "MPNG"])
def test_a_film_of_a_codec_that_no_camera_has_is_refused(codec: str, tmp_path: Path) -> None:
    """FFmpeg of OpenCV 5.0.0 writes beyond its memory as it unpacks a damaged HFYU, which ends the process."""
    writer = cv2.VideoWriter(str(tmp_path / "film.avi"), cv2.VideoWriter.fourcc(*codec), 25.0, (320, 240))
    assert writer.isOpened()
    writer.write(coloured(40))
    writer.release()
    with pytest.raises(SpecError, match=rf"film\.avi is packed by '{codec.lower()}', not by a codec for cameras"):
        read(film_source(tmp_path / "film.avi", (240, 320), keep=False))


def test_images_of_a_film_without_a_time_have_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """As OpenCV 5.0.0 tells five images of an AVI that `ffmpeg -r 10 -c:v libx264rgb` wrote: 0 for what it does not know."""
    milliseconds = [200.0, 300.0, 400.0, 0.0, 0.0]
    left, given = iter(milliseconds), {cv2.CAP_PROP_FRAME_COUNT: 5.0, cv2.CAP_PROP_FPS: 10.0}

    def read_image() -> tuple[bool, Any]:
        given[cv2.CAP_PROP_POS_MSEC] = next(left, -1.0)
        return given[cv2.CAP_PROP_POS_MSEC] >= 0.0, coloured(40)

    capture = SimpleNamespace(isOpened=lambda: True, read=read_image, get=given.get, release=lambda: None)
    monkeypatch.setattr("tactape_fab.sense.live.camera.opened_film", lambda _: capture)
    frames, troubles = read(film_source(Path("film.avi"), (240, 320), rate_hz=float("inf"), keep=False))
    assert [frame.timestamp for frame in frames] == [0.2, 0.3, 0.4, None, None]
    assert troubles == []


def test_a_film_of_huge_images_is_refused_before_they_are_unpacked(tmp_path: Path) -> None:
    """Images of 2^28 px, which FFmpeg unpacks, take more than 2 GB."""
    path = film(tmp_path / "film.mp4", [np.zeros((6000, 6000, 3), dtype=np.uint8)])
    with pytest.raises(SpecError, match=r"film\.mp4 has 6000 x 6000 px, more than 33554432 in all"):
        read(film_source(path, (240, 320), keep=False))


def test_a_film_is_read_by_opencv_as_a_camera_is(tmp_path: Path) -> None:
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 50.0, (320, 240))
    assert writer.isOpened()
    for k in range(6):
        writer.write(coloured(40 * k))
    writer.release()
    frames, troubles = read(film_source(path, (240, 320), rate_hz=float("inf"), keep=False))
    assert troubles == []
    assert [round(float(f.image.mean()) / 40.0) for f in frames] == list(range(6))
    (tmp_path / "cut.avi").write_bytes(path.read_bytes()[:-3000])
    rest, (trouble,) = read(film_source(tmp_path / "cut.avi", (240, 320), rate_hz=float("inf"), keep=False))
    assert len(rest) < 5 and trouble.kind == "film cut off"
    assert f"ends after {len(rest)} images, {6 - len(rest)} earlier" in trouble.message
    np.testing.assert_allclose(np.diff([f.timestamp for f in frames]), 0.02, atol=1e-6)
    by_camera = camera_source(path, (240, 320), opened=lambda p: cv2.VideoCapture(str(p)))(Event())
    for frame in frames:
        shot = next(by_camera)
        assert isinstance(shot, Frame)
        np.testing.assert_array_equal(shot.image, frame.image)
    with pytest.raises(TactapeError, match=r"none\.avi cannot be opened"):
        read(film_source(tmp_path / "none.avi", (240, 320), keep=False))
    with pytest.raises(TactapeError, match=r"dark\.mp4 cannot be unpacked by this OpenCV"):
        read(film_source(unreadable_film(tmp_path / "dark.mp4", [coloured(40)] * 2), (240, 320), keep=False))
