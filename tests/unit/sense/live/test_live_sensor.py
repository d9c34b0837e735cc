"""A sensor on a thread: the latest answer, waiting for a later one, and how it ends; answers as numbers for a policy."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab import Kit, Localization, SpecError, TactapeError
from tactape_fab.sense import LiveSensor, SensorProfile, observation, observation_names, simulate_frames
from tactape_fab.sense.files.jobs import Job, Locate, make_locator
from tests.contacts import TAPE, tape_of

COUNT = 12


@pytest.fixture(scope="module")
def recording(default_kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "frames.npz"
    np.savez(path, depth=simulate_frames(default_kit.tape, COUNT, seed=5).depth)
    return path


@pytest.fixture
def live(default_kit: Kit, recording: Path) -> Iterator[LiveSensor]:
    with LiveSensor(str(recording), [str(default_kit.path)], rate=20.0, world="closed") as sensor:
        yield sensor


def test_each_read_can_wait_for_a_later_frame(live: LiveSensor) -> None:
    assert [tape.name for tape in live.tapes] == ["tactape-s007"] and live.sensor.name == "gelsight-mini"
    frames = [live.read(timeout_s=60.0).frame]
    while frames[-1] < COUNT - 1:
        located = live.read(after=frames[-1], timeout_s=10.0)
        assert located.frame > frames[-1] and located.fix.located and located.depth.shape == (240, 320)
        frames.append(located.frame)
    assert live.read().frame == COUNT - 1  # the latest stays
    with pytest.raises(TactapeError, match="has ended"):
        live.read(after=COUNT - 1, timeout_s=10.0)
    assert not live.running


def test_the_time_that_the_decoder_takes_to_prepare_is_none_of_a_read(
    default_kit: Kit, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slow(job: Job, sensor: SensorProfile) -> Locate:
        time.sleep(1.2)
        return make_locator(job, sensor)

    monkeypatch.setattr("tactape_fab.sense.live.live_sensor.make_locator", slow)
    with LiveSensor(str(recording), [str(default_kit.path)], rate=20.0) as live:
        assert live.read().fix.located


def test_one_that_nobody_closes_has_ended_when_the_process_does(default_kit: Kit, recording: Path) -> None:
    """A thread that is inside OpenCV then aborts it."""
    arguments = f"{str(recording)!r}, [{str(default_kit.path)!r}], rate=1.0"
    code = f"""import atexit
from tactape_fab.sense import LiveSensor
atexit.register(lambda: print(live.running))
live = LiveSensor({arguments})
live.read(timeout_s=60.0)
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout == "False\n"


def test_an_answer_that_is_too_old_is_none(default_kit: Kit, recording: Path, tmp_path: Path) -> None:
    """A policy must not go on with the place of a camera that was pulled out."""
    with LiveSensor(str(tmp_path), [str(default_kit.path)], world="closed") as live:
        with np.load(recording) as frames:
            np.save(tmp_path / "a.npy", frames["depth"][0])
        assert live.read(timeout_s=60.0, max_age_s=60.0).frame == 0
        time.sleep(0.2)
        assert live.read(timeout_s=0.0).frame == live.read(timeout_s=0.0, max_age_s=60.0).frame == 0
        with pytest.raises(TimeoutError, match=r"no frame after -1 in the last 0\.1 s was located"):
            live.read(timeout_s=0.0, max_age_s=0.1)
        (tmp_path / "a.npy").unlink()
        tmp_path.rmdir()
        with pytest.raises(TactapeError, match="cannot be looked into"):
            live.read(timeout_s=float("inf"), max_age_s=0.1)
    with pytest.raises(SpecError, match="max_age_s = '1' is no number of seconds"):
        live.read(max_age_s="1")  # type: ignore[arg-type]
    for key in ("timeout_s", "max_age_s"):
        with pytest.raises(SpecError, match=f"{key} = nan is no number of seconds"):
            live.read(**{key: float("nan")})  # type: ignore[arg-type]
    with pytest.raises(SpecError, match="timeout_s = '1' is no number of seconds"):
        live.read(timeout_s="1")  # type: ignore[arg-type]


def test_what_does_not_come_in_time_is_said(default_kit: Kit, tmp_path: Path) -> None:
    with LiveSensor(str(tmp_path), [str(default_kit.path)]) as live, pytest.raises(TimeoutError, match=r"within 0\.1 s"):
        live.read(timeout_s=0.1)
    assert not live.running


def test_why_nothing_comes_is_said_with_it(default_kit: Kit, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((24, 32), dtype=np.float32))
    with LiveSensor(str(tmp_path), [str(default_kit.path)]) as live:
        end = time.monotonic() + 60.0
        while live._tally.unusable == 0 and time.monotonic() < end:
            time.sleep(0.01)
        for _ in range(2):
            with pytest.raises(TimeoutError, match=r"within 0 s; frame unusable: frame 0: a frame of shape \(24, 32\)"):
                live.read(timeout_s=0.0)


def test_a_source_that_fails_says_so_where_it_is_read(default_kit: Kit, tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    with LiveSensor(str(folder), [str(default_kit.path)]) as live:
        folder.rmdir()
        with pytest.raises(TactapeError, match="cannot be looked into"):
            live.read(timeout_s=60.0)


def test_everything_that_cannot_be_opened_is_said_at_once(tmp_path: Path) -> None:
    with pytest.raises(SpecError) as refused:
        LiveSensor(str(tmp_path / "none"), [str(tmp_path / "no-kit")], world="flat")
    assert "no-kit" in str(refused.value) and "world" in str(refused.value)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            {"rate": 3.0, "crop": (1, 2, 3, 4)},
            ("rate = 3.0 is for files", "crop = (1, 2, 3, 4) is for colour images; give raw=True"),
        ),
        ({"weights": "a.pth"}, ("weights = 'a.pth' is for colour images; give raw=True with it",)),
        ({"raw": True}, ("colour images need an image", "give background=FILE", "give weights=FILE")),
    ],
)
def test_a_refusal_names_arguments_and_no_option(
    default_kit: Kit, tmp_path: Path, given: dict[str, Any], said: tuple[str, ...]
) -> None:
    with pytest.raises(SpecError) as refused:
        LiveSensor(str(tmp_path), [str(default_kit.path)], **given)
    assert [words for words in said if words not in str(refused.value)] == [] and "--" not in str(refused.value)


def test_an_answer_as_numbers() -> None:
    tapes = [tape_of(3), TAPE]
    fix = Localization(
        status="solid",
        located=True,
        tape=TAPE.name,
        position_mm=(3.0, 4.0),
        theta_deg=-180.0,
        covariance=np.diag([1e-4, 2e-4, 3e-6]),
        p_false=1e-9,
    )
    values = observation(fix, tapes)
    assert list(values) == observation_names(tapes) and all(type(value) is float for value in values.values())
    assert (values["on_s3"], values[f"on_{TAPE.name}"], values["located"]) == (0.0, 1.0, 1.0)
    assert [values[name] for name in ("x_mm", "y_mm", "x_var_mm2", "theta_var_rad2", "p_false")] == [3.0, 4.0, 1e-4, 3e-6, 1e-9]
    assert (values["theta_sin"], values["theta_cos"]) == pytest.approx((0.0, -1.0))
    with pytest.raises(SpecError, match="an observation names its tape by that alone"):
        observation_names([replace(tapes[0], name=TAPE.name), TAPE])
    with pytest.raises(SpecError, match=f"tapes has no {TAPE.name}, on which the answer is; give all that are registered"):
        observation(fix, tapes[:1])
    lost = observation(Localization(status="none", located=False, p_false=0.2), tapes)
    assert list(lost) == list(values) and lost["p_false"] == 1.0 and sum(lost.values()) == 1.0
