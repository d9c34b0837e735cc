"""Several sensors in one process: in turn, each at its own rate and with its own drops; and the command that names them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from threading import Barrier, Condition, Event
from time import sleep
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from tactape_fab import Kit
from tactape_fab.base.errors import SpecError, TactapeError
from tactape_fab.sense import SensorProfile
from tactape_fab.sense.files.jobs import Job, Locate
from tactape_fab.sense.live.counts import Tally
from tactape_fab.sense.live.opening import SourceSettings, Wanted, open_watches
from tactape_fab.sense.live.sources import Frame, Slot, Source, take_next
from tactape_fab.sense.live.watch import Watch, watch_all
from tests.commands import run
from tests.live import JOB, at_once, ramp


def frames_of(first: int, count: int, pause_s: float = 0.0, keep: bool = True, together: Barrier | None = None) -> Source:
    def source(stop: Event) -> Iterator[Frame]:
        if together is not None:
            together.wait(60.0)
        for k in range(count):
            sleep(pause_s)
            yield Frame(number=k, image=ramp(first + k), keep=keep)

    return source


def answered(sources: list[Source], locator: object = at_once) -> tuple[list[tuple[int, int]], list[Tally]]:
    """Sensor and frame of each answer, and the tallies."""
    tallies = [Tally() for _ in sources]
    watches = [Watch(job=JOB, source=source, locator=locator) for source in sources]  # type: ignore[arg-type]
    found = watch_all(watches, tallies, Event())
    return [(one[0], one[1].frame) for one in found if one is not None], tallies


# The loop


def test_the_thread_that_reads_has_ended_with_the_answers() -> None:
    """Inside OpenCV it would abort the process that ends."""
    done: list[bool] = []

    def source(stop: Event) -> Iterator[Frame]:
        yield Frame(number=0, image=ramp(0))
        stop.wait(60.0)
        sleep(0.1)
        done.append(True)

    stop = Event()
    for found in watch_all([Watch(job=JOB, source=source, locator=at_once)], [Tally()], stop):
        if found is not None:
            stop.set()
    assert done == [True]


def slowly(job: Job, sensor: SensorProfile) -> Locate:
    def locate(depth: object, *, timestamp: float | None = None) -> object:
        sleep(0.01)
        return at_once(job, sensor)(depth, timestamp=timestamp)  # type: ignore[arg-type]

    return locate  # type: ignore[return-value]


def test_no_sensor_waits_for_another() -> None:
    """One has forty frames, the other twenty, all of which may wait: they are taken in turn."""
    both = Barrier(2)
    found, tallies = answered([frames_of(0, 40, together=both), frames_of(100, 20, together=both)], slowly)
    assert [frame for sensor, frame in found if sensor == 0] == list(range(40))
    assert [frame for sensor, frame in found if sensor == 1] == list(range(20))
    assert [(tally.answered, tally.dropped) for tally in tallies] == [(40, 0), (20, 0)]
    last = max(k for k, (sensor, _) in enumerate(found) if sensor == 1)
    assert last < 59  # one that is served last would end the list


def test_a_fast_sensor_drops_its_own_frames_alone() -> None:
    found, (fast, steady) = answered([frames_of(0, 100, 0.001, keep=False), frames_of(200, 5)], slowly)
    assert fast.dropped == 100 - fast.answered > 0
    assert (steady.answered, steady.dropped) == (5, 0)
    assert (0, 99) in found


def test_a_frame_that_comes_while_others_are_looked_at_is_not_slept_through() -> None:
    """It waits for the lock, and is taken as soon as nobody looks."""
    changed, stop = Condition(), Event()
    slots = [Slot(changed), Slot(changed)]
    waits: list[float | None] = []

    def waiting(timeout: float | None = None) -> bool:  # the one moment at which another thread can leave a frame
        waits.append(timeout)
        slots[0].put(Frame(number=len(waits), image=ramp(0)), stop)
        return True

    changed.wait = waiting  # type: ignore[method-assign]
    found = take_next(slots, changed, 0, 5.0)
    assert waits == [5.0]
    assert found is not None and found[0] == 0


def test_sensors_of_one_profile_share_a_locator() -> None:
    made: list[SensorProfile] = []

    def locator(job: Job, sensor: SensorProfile) -> Locate:
        made.append(sensor)
        return at_once(job, sensor)

    answered([frames_of(0, 2), frames_of(10, 2)], locator)
    assert made == [JOB.sensor]


def test_a_source_that_fails_does_not_end_the_others() -> None:
    def broken(stop: Event) -> Iterator[Frame]:
        yield Frame(number=0, image=ramp(0), keep=True)
        raise TactapeError("camera gone")

    tallies, seen = [Tally(), Tally()], []
    watches = [Watch(job=JOB, source=source, locator=at_once) for source in (broken, frames_of(0, 20, 0.002))]
    with pytest.raises(TactapeError, match="camera gone"):
        for found in watch_all(watches, tallies, Event()):
            seen.append(found)
    assert [tally.answered for tally in tallies] == [1, 20]
    assert tallies[0].troubles == {"source failed": 1} and tallies[1].troubles == {}


# What is opened


def test_tapes_and_profiles_are_read_once(small_kit: Kit, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    wanted = [
        Wanted(name=name, sensor=sensor, source=str(tmp_path / "a"), settings=SourceSettings())
        for name, sensor in (("left", "digit"), ("right", "gelsight-mini"), ("third", "digit"))
    ]
    left, right, third = open_watches(wanted, [str(small_kit.path)], ())
    assert left.job.tapes is right.job.tapes is third.job.tapes
    assert left.job.sensor is third.job.sensor and right.job.sensor.name == "gelsight-mini"


def test_problems_of_all_sensors_come_together_with_their_names(small_kit: Kit, tmp_path: Path) -> None:
    wanted = [
        Wanted(name="left", sensor="digitt", source=str(tmp_path), settings=SourceSettings(idle=-1)),
        Wanted(name="right", sensor="digit", source=str(tmp_path / "none"), settings=SourceSettings(rate="fast")),
        Wanted(name="right", sensor="digit", source=str(tmp_path), settings=SourceSettings(background="b.png")),
    ]
    with pytest.raises(SpecError) as caught:
        open_watches([wanted[1], wanted[0], wanted[2]], [str(small_kit.path)], ())
    said = "\n".join(problem.message for problem in caught.value.problems)
    for words in (
        "sensor right is named twice",
        "sensor left: idle = -1",
        "digitt",
        "sensor right: rate",
        "/none",
        "give raw=True",
    ):
        assert words in said, words


# The command


@pytest.fixture(scope="module")
def pair(default_kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Frames of two sensors; not to be changed."""
    folder = tmp_path_factory.mktemp("pair")
    for sensor in ("digit", "gelsight-mini"):
        done = run(f"simulate {default_kit.path} -o {folder}/{sensor}.npz --count 3 --seed 3 --sensor {sensor}")
        assert done.exit_code == 0, done.output
    return folder / "digit.npz", folder / "gelsight-mini.npz"


def test_answers_are_those_of_each_sensor_alone(default_kit: Kit, pair: tuple[Path, Path], tmp_path: Path) -> None:
    """Each line names its sensor; one MCAP file has topics for each, with its stamps and its frame."""
    both = f"--sensor left=digit:{pair[0]} --sensor right=gelsight-mini:{pair[1]}"
    log = tmp_path / "both.mcap"
    result = run(f"watch {both} --rate left=50 --rate right=20 --no-drop --tape {default_kit.path} --json --mcap {log}")
    assert result.exit_code == 0, result.output
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    for name, sensor, path in (("left", "digit", pair[0]), ("right", "gelsight-mini", pair[1])):
        alone = run(f"decode {path} --sensor {sensor} --tape {default_kit.path} --json").stdout.splitlines()
        own = [{**line, "elapsed_ms": 0, "timestamp": None} for line in lines if line["sensor"] == name]
        assert own == [{"sensor": name, **json.loads(line), "elapsed_ms": 0} for line in alone]
        assert f"{name}: located 3 of 3 frames" in result.stderr
    with AnyReader([log]) as reader:
        stamps: dict[str, list[int]] = {}
        for connection, time_ns, data in reader.messages():
            stamps.setdefault(connection.topic, []).append(time_ns)
            if connection.topic.endswith("/depth"):
                message: Any = reader.deserialize(data, connection.msgtype)
                assert f"/tactape/{message.header.frame_id}/depth" == connection.topic
    assert set(stamps) == {f"/tactape/{name}/{topic}" for name in ("left", "right") for topic in ("fix", "pose", "depth")}
    assert np.diff(stamps["/tactape/left/fix"]).tolist() == [20_000_000] * 2
    assert np.diff(stamps["/tactape/right/fix"]).tolist() == [50_000_000] * 2


def test_kits_may_follow_tape(default_kit: Kit, small_kit: Kit, pair: tuple[Path, Path]) -> None:
    result = run(f"watch --sensor a=digit:{pair[0]} --rate max --count 2 --tape {small_kit.path} {default_kit.path}")
    assert result.exit_code == 0 and "a: located 2 of 2 frames" in result.stderr


def test_a_folder_beside_a_file_ends_by_an_idle_time_of_its_own(small_kit: Kit, pair: tuple[Path, Path], tmp_path: Path) -> None:
    sensors = f"--sensor a=digit:{pair[0]} --sensor b=digit:{tmp_path} --rate a=max --idle b=0.1"
    result = run(f"watch {sensors} --tape {small_kit.path}")
    assert result.exit_code == 0 and "b: located 0 of 0 frames" in result.stderr, result.output


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("", "no source is given"),
        ("--sensor a=digit:FRAMES --sensor digit", "sensor = 'digit' has no name and others have"),
        ("--sensor a=digit:FRAMES --sensor a/b=digit:FRAMES", "its name becomes part of topics of ROS"),
        ("--sensor a=digit:FRAMES --idle 3", "leave it out, or give it as NAME=VALUE for one that takes it"),
        ("--sensor left-hand=digit:FRAMES", "its name becomes part of topics of ROS, which has rules for it; use a letter"),
        ("--sensor a=digit:- --sensor b=digit:-", "sensors a, b all read standard input"),
        ("FRAMES --sensor a=digit:FRAMES", "stands beside --sensor NAME=SENSOR:SOURCE, which has its own; leave it out"),
        ("--sensor a=digit:FRAMES --rerun", "--rerun and --save show one sensor"),
        ("--sensor a=digit:FRAMES --mcap x.mcap --rate 9 --sensor-frame b", "each has its name as frame"),
        ("--sensor a=digit:FRAMES --rate a=fast", "rate = 'fast'"),
        ("--sensor a=digit:FRAMES --rate b=3", "--rate = 'b=3' is for a sensor b, which there is not; the sensors are a"),
        ("FRAMES --idle b=3", "--idle = 'b=3' is for a sensor b, which there is not; none has a name; give the value alone"),
        ("--sensor a=digit:FRAMES --mcap x.mcap", "sensor a: "),
    ],
)
def test_what_cannot_be_is_said(words: str, said: str, default_kit: Kit, pair: tuple[Path, Path]) -> None:
    result = run(f"watch {words.replace('FRAMES', str(pair[0]))} --tape {default_kit.path}")
    assert result.exit_code == 2 and said in result.stderr, result.output
