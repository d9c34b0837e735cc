"""`watch`: the loop that is never late, its counts, and the command with everything that can be wrong about it."""

from __future__ import annotations

import json
import os
import resource
import shlex
import signal
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from threading import Event, Thread
from time import perf_counter, sleep

import numpy as np
import pytest
from click.testing import CliRunner, Result
from rosbags.highlevel import AnyReader

from tactape_fab import Kit, Localization
from tactape_fab.base.errors import TactapeError
from tactape_fab.cli import main
from tactape_fab.sense import SensorProfile
from tactape_fab.sense.files.depth_maps import open_frame_file
from tactape_fab.sense.files.jobs import Job, Locate, Located
from tactape_fab.sense.live.counts import Latencies, Tally
from tactape_fab.sense.live.mcap_log import McapLog
from tactape_fab.sense.live.replay import replay
from tactape_fab.sense.live.sources import Frame, Slot, Source, Trouble
from tactape_fab.sense.live.status_lines import end_lines, status_line
from tactape_fab.sense.live.watch import MOST_SCALES, Watch, watch
from tests.live import JOB, at_once, npy, ramp, save_npz
from tests.tapes import tape_at
from tests.thorough import costly


def run(arguments: str, stdin: bytes | None = None) -> Result:
    return CliRunner().invoke(main, shlex.split(f"watch {arguments}"), input=stdin, prog_name="tactape-fab")


def source_of(items: list[Frame | Trouble]) -> Source:
    return lambda stop: iter(items)


def frame(k: int, **others: object) -> Frame:
    return Frame(number=k, image=ramp(k), **others)  # type: ignore[arg-type]


def answers(source: Source, tally: Tally, locator: object = at_once) -> list[Located]:
    found = watch(Watch(job=JOB, source=source, locator=locator), tally, Event())  # type: ignore[arg-type]
    return [located for located in found if located is not None]


# The loop


def test_the_rate_falls_while_no_answer_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 0.0
    monkeypatch.setattr("tactape_fab.sense.live.counts.perf_counter", lambda: now_s)
    tally = Tally()
    assert tally.hz == 0.0
    for k in range(26):
        now_s = 0.04 * k
        tally.answer(Localization(status="none", located=False), now_s)
    assert tally.hz == pytest.approx(25.0)
    now_s = 1.03
    assert tally.hz == pytest.approx(25.0)
    now_s = 10.04
    assert tally.hz == pytest.approx(2.5) and tally.overall_hz == pytest.approx(25.0)


def test_the_latest_frame_is_located_and_those_before_it_are_counted() -> None:
    """A frame every 5 ms, 20 ms for each answer."""

    def slow(job: Job, sensor: SensorProfile) -> Locate:
        def locate(depth: object, *, timestamp: float | None = None) -> Localization:
            sleep(0.02)
            return at_once(job, sensor)(depth, timestamp=timestamp)  # type: ignore[arg-type]

        return locate

    def source(stop: Event) -> Iterator[Frame]:
        for k in range(60):
            sleep(0.005)
            yield frame(k, timestamp=float(k))

    tally, start_s = Tally(), perf_counter()
    found = answers(source, tally, slow)
    all_ms = 1000.0 * (perf_counter() - start_s)
    numbers = [located.frame for located in found]
    assert numbers == sorted(set(numbers)) and numbers[-1] == 59
    assert tally.dropped == 60 - len(found) > 0
    assert [located.fix.timestamp for located in found] == [float(k) for k in numbers]
    # in a queue the last of 60 frames would wait for three quarters of the time
    assert tally.latencies.percentile_ms(99) < all_ms / 2


def test_frames_that_may_wait_are_all_located() -> None:
    tally = Tally()
    found = answers(source_of([frame(k, keep=True) for k in range(40)]), tally)
    assert [located.frame for located in found] == list(range(40))
    assert (tally.answered, tally.dropped, tally.unusable) == (40, 0, 0)


def test_what_is_no_frame_is_said_once_and_counted() -> None:
    """Wrong shapes and holes between good frames, and troubles of the source."""
    items: list[Frame | Trouble] = []
    for k in range(0, 40, 4):
        small = Frame(number=k + 1, image=np.zeros((3, 4)), keep=True)
        holes = ramp(k)
        holes[5, :7] = np.nan
        items += [
            frame(k, keep=True),
            small,
            Frame(number=k + 2, image=holes, keep=True),
            Trouble(kind="noise", message="of a pipe"),
        ]
    tally = Tally()
    found = answers(source_of(items), tally)
    assert len(found) == 20
    assert tally.troubles == {"frame unusable": 10, "frame with holes": 10, "noise": 10}
    said = tally.unreported()
    assert sorted(message.split(":")[0] for message in said) == ["frame unusable", "frame with holes", "noise"]
    assert any("frame 2: 7 of 76800 values are NaN or infinite" in message for message in said)
    assert tally.unreported() == []
    assert sorted(end_lines(tally)[-3:]) == ["frame unusable: 10 times", "frame with holes: 10 times", "noise: 10 times"]


def test_an_error_of_the_source_comes_after_its_frames() -> None:
    def source(stop: Event) -> Iterator[Frame]:
        yield frame(0, keep=True)
        raise TactapeError("camera gone")

    tally = Tally()
    with pytest.raises(TactapeError, match="camera gone"):
        answers(source, tally)
    assert tally.answered == 1


def test_a_source_that_is_silent_can_be_stopped() -> None:
    stop, tally = Event(), Tally()

    def source(stop: Event) -> Iterator[Frame]:
        while not stop.wait(20.0):
            yield frame(0)

    found = watch(Watch(job=JOB, source=source, locator=at_once), tally, stop)
    assert next(found) is None
    stop.set()
    assert list(found) == []


def test_files_of_many_scales_are_refused_after_some() -> None:
    made: list[tuple[float, float]] = []

    def locator(job: Job, sensor: SensorProfile) -> Locate:
        made.append(sensor.px_per_mm)
        return at_once(job, sensor)

    frames: list[Frame | Trouble] = [frame(k, keep=True, px_per_mm=(14.0 + k / 10, 14.0)) for k in range(20)]
    tally = Tally()
    found = answers(source_of(frames), tally, locator)
    assert (len(made), len(found), tally.unusable) == (MOST_SCALES, MOST_SCALES - 1, 20 - MOST_SCALES + 1)
    assert found[3].sensor.px_per_mm == (14.3, 14.0)


def test_memory_does_not_grow(tmp_path: Path) -> None:
    """Of a replay at full speed, after the first hundred frames."""
    file = open_frame_file(save_npz(tmp_path / "f.npz", [ramp(k) for k in range(20)]))

    def again(stop: Event) -> Iterator[Frame | Trouble]:
        for _ in range(30):
            yield from replay(file, float("inf"))(stop)

    tally, used = Tally(), []
    tracemalloc.start()
    try:
        for located in watch(Watch(job=JOB, source=again, locator=at_once), tally, Event()):
            if located is not None and tally.answered in (100, 590):
                used.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert tally.answered == 600
    assert used[1] - used[0] < 2 * ramp(0).nbytes


def test_a_slot_lets_wait_only_until_told() -> None:
    slot, stop = Slot(), Event()
    slot.put(frame(0, keep=True), stop)
    waiting = Thread(target=slot.put, args=(frame(1), stop))
    waiting.start()
    sleep(0.05)
    assert waiting.is_alive()
    taken = slot.take(1.0)
    waiting.join(5.0)
    assert taken is not None and taken.number == 0 and not waiting.is_alive()
    slot.put(frame(2), stop)
    last = slot.take(1.0)
    assert last is not None and last.number == 2 and slot.dropped == 1
    assert slot.take(0.01) is None
    slot.end()
    with pytest.raises(EOFError):
        slot.take(1.0)


# Counts


def test_percentiles_are_those_of_all_times() -> None:
    times = np.random.default_rng(1).lognormal(1.0, 1.0, 5000)
    latencies = Latencies()
    for ms in times:
        latencies.add(float(ms))
    for percent in (1, 50, 99):
        assert latencies.percentile_ms(percent) == pytest.approx(np.percentile(times, percent), rel=0.03)
    for extreme in (0.0, 1e-9, 1e12):
        latencies.add(extreme)
    assert latencies.count == 5003
    assert np.isnan(Latencies().percentile_ms(50))


def test_lines_say_how_it_went() -> None:
    tally = Tally()
    assert status_line(tally) == "waiting for frames; 0 of 0 located; 0.0 Hz; dropped 0"
    assert end_lines(tally) == ["located 0 of 0 frames"]
    fix = Localization(status="solid", located=True, tape="tactape-s007", position_mm=(20.0, 12.0), theta_deg=30.04)
    tally.answer(fix, 0.0)
    assert status_line(tally).startswith("tactape-s007 x 20.00 y 12.00 mm 30.0 deg; 1 of 1 located; ")
    tally.answer(Localization(status="none", located=False, reason="no dots"), 0.0)
    tally.dropped = 3
    assert status_line(tally).startswith("not located: no dots; 1 of 2 located; ")
    assert "; dropped 3; latency p50 " in status_line(tally)
    assert end_lines(tally)[0].startswith("located 1 of 2 frames at ")
    assert end_lines(tally)[1].startswith("dropped 3, ")


# The command


@pytest.fixture(scope="module")
def frames(default_kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames of the default tape; not to be changed."""
    path = tmp_path_factory.mktemp("frames") / "frames.npz"
    result = CliRunner().invoke(main, shlex.split(f"simulate {default_kit.path} -o {path} --count 6 --seed 3"))
    assert result.exit_code == 0, result.output
    return path


def same(watched: str, decoded: str) -> None:
    """Answers of watch and of decode, but for the time that they took."""
    assert [{**json.loads(line), "elapsed_ms": 0} for line in watched.splitlines()] == [
        {**json.loads(line), "elapsed_ms": 0} for line in decoded.splitlines()
    ]


def test_watch_answers_as_decode_does(default_kit: Kit, frames: Path) -> None:
    watched = run(f"{frames} --rate max --tape {default_kit.path} --json")
    decoded = CliRunner().invoke(main, shlex.split(f"decode {frames} --tape {default_kit.path} --json"))
    assert watched.exit_code == 0
    same(watched.stdout, decoded.stdout)
    (line,) = watched.stderr.splitlines()
    assert line.startswith("located 6 of 6 frames at ") and "latency p50" in line


def test_watch_says_nothing_on_stdout_unless_asked(default_kit: Kit, frames: Path) -> None:
    result = run(f"{frames} --rate max --tape {default_kit.path} --count 2")
    assert (result.exit_code, result.stdout) == (0, "")
    assert result.stderr.startswith("located 2 of 2 frames")


def test_watch_takes_several_kits_behind_tape(default_kit: Kit, small_kit: Kit, frames: Path) -> None:
    assert "located 6 of 6" in run(f"{frames} --rate max --tape {small_kit.path} {default_kit.path}").stderr


def test_watch_takes_a_code_alone(default_kit: Kit, tmp_path: Path) -> None:
    """No tape, no frame to give a pose in: the answers alone are written."""
    CliRunner().invoke(main, shlex.split(f"simulate {default_kit.path} -o {tmp_path}/large.npz --count 2 --contact 15x13"))
    result = run(f"{tmp_path}/large.npz --rate 50 --no-drop --code microdots-4x4 --json --mcap {tmp_path}/touch.mcap")
    found = [json.loads(line) for line in result.stdout.splitlines()]
    assert [(f["sector"], f["tape"], f["timestamp"], len(f["plane_mm"])) for f in found] == [
        (7, None, 0.0, 2),
        (7, None, 0.02, 2),
    ]
    with AnyReader([tmp_path / "touch.mcap"]) as reader:
        assert {c.topic: c.msgcount for c in reader.connections} == {"/tactape/fix": 2, "/tactape/depth": 2, "/tactape/pose": 0}


def test_a_folder_that_grows_is_watched(default_kit: Kit, frames: Path, tmp_path: Path) -> None:
    with np.load(frames) as arrays:
        depth = arrays["depth"]

    def write() -> None:
        for k, image in enumerate(depth[2:], start=2):
            sleep(0.1)
            np.save(tmp_path / f"{k}.npy", image)
        (tmp_path / "cut.npy").write_bytes(npy(depth[0])[:1000])
        np.save(tmp_path / "small.npy", depth[0, :100])

    for k, image in enumerate(depth[:2]):
        np.save(tmp_path / f"{k}.npy", image)
    writer = Thread(target=write)
    writer.start()
    result = run(f"{tmp_path} --tape {default_kit.path} --json --idle 1 --no-drop")
    writer.join()
    assert result.exit_code == 0
    found = [json.loads(line) for line in result.stdout.splitlines()]
    assert [(answer["frame"], answer["located"]) for answer in found] == [(k, True) for k in range(6)]
    assert found[5]["timestamp"] == (tmp_path / "5.npy").stat().st_mtime
    assert "warning: frame unusable: frame 6: a frame of shape (100, 320)" in result.stderr
    assert "cut.npy" in result.stderr and "tried again when it changes" in result.stderr


def process(arguments: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "tactape_fab", "watch", *shlex.split(arguments)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


@pytest.mark.parametrize("place", ["metadata.yaml", "meta/info.json"])
def test_a_folder_of_a_recording_is_refused_and_not_waited_in(place: str, small_kit: Kit, tmp_path: Path) -> None:
    (tmp_path / place).parent.mkdir(exist_ok=True)
    (tmp_path / place).write_text("rosbag2_bagfile_information:\n", encoding="utf-8")
    result = run(f"{tmp_path} --tape {small_kit.path} --idle 0.1")
    assert result.exit_code == 2 and "is a recording, whose frames do not come any more; decode reads it" in result.stderr


def test_a_folder_of_frames_may_hold_a_list_of_another_kind(small_kit: Kit, tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("operator: me\n", encoding="utf-8")
    assert run(f"{tmp_path} --tape {small_kit.path} --idle 0.1").exit_code == 0


@costly
@pytest.mark.parametrize("which", [signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)])
def test_a_stream_is_watched_until_it_is_told_to_end(
    default_kit: Kit, frames: Path, tmp_path: Path, which: signal.Signals
) -> None:
    path = tmp_path / "touch.mcap"
    with np.load(frames) as arrays, process(f"- --tape {default_kit.path} --json --mcap {path}") as watching:
        assert watching.stdin is not None and watching.stdout is not None and watching.stderr is not None
        found = []
        for k, image in enumerate(arrays["depth"]):
            watching.stdin.write(npy(1000.0 + k) + npy(image))
            watching.stdin.flush()
            found.append(json.loads(watching.stdout.readline()))
        watching.send_signal(which)
        assert watching.wait(20.0) == 0
        said = watching.stderr.read().decode()
    assert [(answer["timestamp"], answer["located"]) for answer in found] == [(1000.0 + k, True) for k in range(6)]
    assert said.startswith("located 6 of 6 frames")
    with AnyReader([path]) as reader:
        assert reader.message_count == 18


def garbage() -> bytes:
    return np.random.default_rng(5).integers(0, 256, 100_000, dtype=np.uint8).tobytes()


@costly
@pytest.mark.parametrize(
    ("sent", "status", "said"),
    [
        (garbage(), 1, "warning: stream damaged: skipped 100000 bytes that are not a .npy array, before frame 0"),
        (npy(np.zeros((240, 320), dtype=np.float32))[:1000], 1, "warning: stream damaged: frame 0: the stream ends after 872 of"),
        (npy(np.array(["a"])), 1, "warning: stream damaged: frame 0: "),
        (b"", 0, "located 0 of 0 frames"),
    ],
    ids=["noise", "an array cut off", "words", "nothing"],
)
def test_a_pipe_without_a_frame_that_can_be_used_is_a_failure(default_kit: Kit, sent: bytes, status: int, said: str) -> None:
    with process(f"- --tape {default_kit.path}") as watching:
        out, errors = (data.decode() for data in watching.communicate(sent))
    assert (watching.returncode, out) == (status, ""), errors
    assert errors.startswith(said) and "located 0 of 0 frames" in errors


def test_a_frame_behind_garbage_is_enough(default_kit: Kit, frames: Path) -> None:
    with np.load(frames) as arrays, process(f"- --tape {default_kit.path}") as watching:
        errors = watching.communicate(garbage() + npy(arrays["depth"][0]))[1].decode()
    assert watching.returncode == 0 and "located 1 of 1 frame;" in errors
    assert "skipped 100000 bytes" in errors


def test_frames_of_another_sensor_alone_are_a_failure(default_kit: Kit, frames: Path, tmp_path: Path) -> None:
    with np.load(frames) as arrays:
        np.save(tmp_path / "a.npy", arrays["depth"][:, :50])
    result = run(f"{tmp_path} --tape {default_kit.path} --idle 0.2")
    assert result.exit_code == 1
    assert "frame unusable: 1 time" in result.stderr.splitlines()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("nowhere --tape {kit}", ["source nowhere cannot be opened"]),
        ("{frames}", ["no tape is given"]),
        ("{frames} --tape {kit} --rate -3", ["rate = -3 Hz is below 0.001 Hz"]),
        ("{frames} --tape {kit} --rate 1e-300", ["rate = 1e-300 Hz is below 0.001 Hz", "or max"]),
        ("{frames} --tape {kit} --rate fast", ["rate = 'fast' is not a number", "or max"]),
        ("{frames} --tape {kit} --idle 3", ["--idle = 3 is for folders"]),
        ("{kit} --tape {kit} --rate 3 --idle soon", ["--rate = 3 is for files", "idle = 'soon'", "is a kit, into"]),
        ("{frames} --tape {kit} --count 0", ["count = 0 is outside"]),
        ("{frames} --tape {kit} --mcap a.mcap", ["holds no timestamps", "--rate HZ"]),
        ("{frames} --tape {kit} --mcap a.bag --save none/a.rrd --rate 9", ["a.bag does not end with .mcap", "no folder"]),
        ("{frames} --tape {kit} --frame-id a", ["--mcap FILE.mcap with them"]),
        ("{frames} --tape {kit} --rate 9 --mcap a.mcap --frame-id=", ["--frame-id = '' is no name of a frame"]),
        ("{frames} --tape {kit} --rate 9 --mcap a.mcap --sensor-frame a\udcff", ["--sensor-frame = 'a\\udcff' is no name"]),
        ("{frames} --tape {kit} --raw", ["--raw is for a camera", "give --background FILE", "give --weights FILE"]),
        ("{frames} --tape {kit} --weights a.pth", ["--weights = 'a.pth' is for colour images; give --raw with it, or leave"]),
        ("{frames} --tape {kit} --crop 1,2,3,0 --raw", ["cuts out nothing", "is for cameras"]),
        ("/dev/null --tape {kit}", ["a camera has colour images"]),
        ("{frames} --tape {kit} --world flat", ["world = 'flat'"]),
    ],
)  # fmt: skip
def test_watch_refuses_with_words(default_kit: Kit, frames: Path, arguments: str, words: list[str]) -> None:
    result = run(arguments.format(kit=default_kit.path, frames=frames))
    assert (result.exit_code, result.stdout) == (2, "")
    assert all(line.startswith("error: ") for line in result.stderr.splitlines())
    assert [word for word in words if word not in result.stderr] == []


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no FIFOs")
def test_a_film_that_is_a_fifo_is_refused(default_kit: Kit, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.mp4")  # OpenCV would wait for its writer
    result = run(f"{tmp_path}/a.mp4 --tape {default_kit.path} --raw --background b.png --weights w.pth")
    assert result.exit_code == 2 and "a.mp4 cannot be opened: it is no regular file" in result.stderr


@pytest.mark.parametrize("output", ["--mcap {folder}/a.mcap", "--save {folder}/a.rrd", "--zenoh local"])
def test_tapes_of_one_name_have_no_frames_of_their_own(default_kit: Kit, frames: Path, tmp_path: Path, output: str) -> None:
    kits = []
    for sector in (8, 9):
        (kit := tmp_path / f"kit{sector}").mkdir()
        content = {"format": "tactape-manifest/1", **tape_at(sector, (30, 20), name="a").to_mapping()}
        (kit / "manifest.json").write_text(json.dumps(content))
        kits.append(str(kit))
    result = run(f"{frames} --rate 9 --tape {' '.join(kits)} {output.format(folder=tmp_path)}")
    assert result.exit_code == 2
    assert "error: tapes of sectors 8 and 9 are both named a, and a frame of poses names its tape" in result.stderr
    assert not (tmp_path / "a.mcap").exists() and not (tmp_path / "a.rrd").exists()


def test_a_film_without_raw_is_no_file_of_frames(default_kit: Kit, tmp_path: Path) -> None:
    (tmp_path / "film.MP4").touch()
    result = run(f"{tmp_path}/film.MP4 --tape {default_kit.path}")
    assert result.exit_code == 2
    assert result.stderr == "error: a film has colour images; give --raw with --background FILE and --weights FILE\n"


def test_nothing_is_written_over(default_kit: Kit, frames: Path, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").touch()
    (tmp_path / "a.rrd").touch()
    result = run(f"{frames} --rate 9 --tape {default_kit.path} --mcap {tmp_path}/a.mcap --save {tmp_path}/a.rrd")
    assert result.exit_code == 2
    assert [line.endswith("exists already; nothing was touched; use another name") for line in result.stderr.splitlines()] == [
        True
    ] * 2


def test_an_extra_that_is_missing_is_named(default_kit: Kit, frames: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def without(name: str) -> object:
        return None if name in ("mcap", "rerun") else find_spec(name)

    monkeypatch.setattr("tactape_fab.cli.watch.find_spec", without)
    result = run(f"{frames} --rate 9 --tape {default_kit.path} --mcap a.mcap --rerun")
    assert result.exit_code == 2
    assert result.stderr.splitlines() == [
        'error: --mcap needs mcap, which is not installed; pip install "tactape-fab[live]"',
        'error: --rerun needs rerun, which is not installed; pip install "tactape-fab[rerun]"',
    ]


def test_a_full_disk_is_a_word(default_kit: Kit, frames: Path, tmp_path: Path) -> None:
    """As far as one goes: no file may become larger than three frames."""
    path, limits = tmp_path / "touch.mcap", resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, limits[1]))
    try:
        result = run(f"{frames} --rate 100 --no-drop --tape {default_kit.path} --mcap {path}")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert result.exit_code == 1
    error = f"error: mcap {path} cannot be written: File too large; what is in it can be read"
    assert result.stderr.splitlines()[-1] == error


def test_nothing_is_said_of_a_file_that_was_never_there(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(TactapeError, match=r"a.mcap cannot be written: Not a directory; use another place$"):
        McapLog(tmp_path / "file" / "a.mcap")


def test_a_standard_input_that_is_closed_is_refused(default_kit: Kit) -> None:
    command = f"{shlex.quote(sys.executable)} -m tactape_fab watch - --tape {shlex.quote(str(default_kit.path))} <&-"
    done = subprocess.run(["sh", "-c", command], capture_output=True, encoding="utf-8", check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: SOURCE = -, but standard input is closed; pipe .npy arrays to it")
