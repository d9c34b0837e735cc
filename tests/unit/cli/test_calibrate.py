"""calibrate: a profile that decode takes, or all problems at once and nothing written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tactape_fab import Kit, __version__
from tactape_fab.sense.live.cdr import IMAGE
from tests.commands import run_words as run
from tests.recordings import image_message, mcap
from tests.unit.sense.calibrate.sensors import presses_on


@pytest.fixture(scope="module")
def folder(default_kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten presses of a sensor that is in no list on the default kit, in a file without px/mm, and poses of an arm for none."""
    made = presses_on(default_kit.tape)
    path = tmp_path_factory.mktemp("presses")
    np.savez(path / "presses.npz", depth=np.array(made.frames))
    return path


def test_presses_become_a_profile_that_decode_takes(folder: Path, default_kit: Kit, tmp_path: Path) -> None:
    output = tmp_path / "mine.toml"
    presses = folder / "presses.npz"
    result = run(
        "calibrate", presses, "--tape", default_kit.path, "-o", output, "--known-theta", "0,20", "--picture", tmp_path / "p"
    )
    assert result.exit_code == 0, result.stderr
    for words in (
        "10 presses of 10 frames",
        "sign = 1, mirror = false, rotate90 = 0",
        "px_per_mm_u",
        "in presses left out of it",
    ):
        assert words in result.stdout
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.toml", "p"] and len(list((tmp_path / "p").iterdir())) == 2
    decoded = run("decode", presses, "--tape", default_kit.path, "--sensor", output, "--json")
    fixes = [json.loads(line) for line in decoded.stdout.splitlines()]
    assert len(fixes) == 10 and all(fix["located"] for fix in fixes) and abs(fixes[0]["theta_deg"] - 20.0) < 0.5
    again = run("calibrate", presses, "--tape", default_kit.path, "--like", output, "-o", output, "--json")
    assert again.exit_code == 0 and abs(json.loads(again.stdout)["quantities"]["aspect"]["value"] - 0.03) < 2e-3


def test_presses_may_be_a_recording(folder: Path, default_kit: Kit, tmp_path: Path) -> None:
    frames = np.load(folder / "presses.npz")["depth"].astype(np.float32)
    images = [IMAGE.encode(image_message(frame, "32FC1", k)) for k, frame in enumerate(frames)]
    told = []
    # with both swapped by the way
    for given in (mcap(tmp_path / "presses.mcap", {"/gel": images}), folder / "presses.npz"):
        result = run("calibrate", default_kit.path, "--tape", given, "-o", tmp_path / "mine.toml", "--json")
        assert result.exit_code == 0, result.stderr
        told.append(json.loads(result.stdout))
    assert told[0]["quantities"] == told[1]["quantities"]
    ours = mcap(tmp_path / "ours.mcap", {"/gel": images}, f"tactape-fab {__version__}")
    refused = run("calibrate", ours, "--tape", default_kit.path, "-o", tmp_path / "other.toml")
    assert refused.exit_code == 2 and "was written by watch, upright and in metres" in refused.stderr


def test_all_problems_are_said_together_and_nothing_is_written(tmp_path: Path) -> None:
    result = run(
        "calibrate", "--like", "no-such", "-o", tmp_path / "x.json", "--known-theta", "up", "--hand-eye", tmp_path / "no.csv"
    )
    assert result.exit_code == 2
    for words in (
        "x.json is no .toml file",
        "no file of frames is given",
        "no tape is given",
        "no-such",
        "--known-theta = 'up' is not FRAME,DEG",
        "no.csv cannot be opened",
    ):
        assert words in result.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("angle", ["nan", "inf", "1e999", "9" * 400])
def test_a_known_angle_that_is_none_is_named_as_typed(angle: str, folder: Path, default_kit: Kit, tmp_path: Path) -> None:
    out = tmp_path / "mine.toml"
    result = run("calibrate", folder / "presses.npz", "--tape", default_kit.path, "-o", out, "--known-theta", f"0,{angle}")
    said = "no array of numbers" if len(angle) > 9 else f"= 0,{float(angle)}: {float(angle)} deg is not from -360 to 360 deg"
    assert result.exit_code == 2 and "error: --known-theta " in result.stderr and said in result.stderr


def test_presses_that_say_too_little_write_nothing(folder: Path, default_kit: Kit, tmp_path: Path) -> None:
    few = tmp_path / "few.npz"
    np.savez(few, depth=np.load(folder / "presses.npz")["depth"][:2])
    result = run("calibrate", few, "--tape", default_kit.path, "-o", tmp_path / "mine.toml", "--picture", tmp_path / "p")
    assert result.exit_code == 2 and "only 2 presses of 2 frames" not in result.stderr
    assert "only 2 presses" in result.stderr and "press the tape some ten times" in result.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["few.npz"]
