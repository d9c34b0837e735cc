"""The scale of a file beside that of a calibrated profile."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tactape_fab import Kit, Localizer
from tactape_fab.base.templates import templates_folder
from tactape_fab.cli import main
from tactape_fab.sense import Scene, iterate_frames, load_sensor
from tactape_fab.sense.files.jobs import at_scale
from tactape_fab.sense.files.simulated import simulate_file
from tactape_fab.sense.geometry import Geometry
from tactape_fab.sense.survey.survey import survey_files
from tests.contacts import TAPE

CALIBRATED = Geometry(sigma_px_per_mm=0.01, sigma_aspect=0.0005, sigma_shear=0.0005, sigma_k1=0.0005)
SENSOR = replace(load_sensor("gelsight-mini"), geometry=CALIBRATED, scale_tolerance=0.02)


@pytest.mark.parametrize("scale", [(16.3, 16.3), (15.7, 15.7), (16.0, 16.2)])
def test_a_scale_that_a_file_says_is_not_as_sure_as_a_calibration(scale: tuple[float, float]) -> None:
    """It was taken for that of the calibration: 4 mm beside the image's centre poses were 4 to 9 standard deviations off."""
    localizer, squares = Localizer([TAPE], at_scale(SENSOR, scale), refine="dots"), []
    for frame in iterate_frames(TAPE, 4, 5, scene=Scene(contact_mm=(9.0, 8.0), contact_offset_mm=(4.0, -2.0))):
        fix = localizer.locate(frame.depth)
        assert fix.position_mm is not None and fix.covariance is not None
        error = np.asarray(fix.position_mm) - frame.position_mm
        squares.append(error @ np.linalg.solve(fix.covariance[:2, :2], error) / 2)
    assert np.mean(squares) < 3.0


def test_a_file_of_the_profile_s_scale_changes_nothing() -> None:
    assert at_scale(SENSOR, (16.0, 16.0)) is SENSOR
    assert at_scale(SENSOR, (160.0, 16.0)).geometry.sigma_aspect == 0.2
    unsure = replace(SENSOR, geometry=replace(CALIBRATED, sigma_px_per_mm=None))
    assert at_scale(unsure, (32.0, 32.0)).geometry == unsure.geometry


def test_watch_and_survey_take_the_scale_of_a_file_as_decode_does(small_kit: Kit, tmp_path: Path) -> None:
    """They took a scale 3 % off for as sure as the calibration: dots of a survey were 0.05 mm off, answers five times as far."""
    text = (templates_folder() / "sensors" / "gelsight-mini.toml").read_text(encoding="utf-8")
    sigmas = "".join(f"{key} = {value}\n" for key, value in asdict(CALIBRATED).items() if key.startswith("sigma_"))
    (tmp_path / "mine.toml").write_text(f"{text}\n[geometry]\n{sigmas}", encoding="utf-8")
    with np.load(simulate_file(small_kit.path, tmp_path / "own.npz", count=16).path) as own:
        np.savez(tmp_path / "other.npz", depth=own["depth"], px_per_mm=16.5)
    places = []
    for command in ("decode", "watch --rate max"):
        options = f"{command} {tmp_path / 'other.npz'} --tape {small_kit.path} --sensor {tmp_path / 'mine.toml'} --json"
        run = CliRunner().invoke(main, options.split())
        places.append([json.loads(line)["position_mm"] for line in run.stdout.splitlines()])
    assert places[0] == places[1] and len(places[0]) == 16
    found = survey_files([str(tmp_path / "other.npz")], small_kit.path, sensor=str(tmp_path / "mine.toml"))
    assert found.contacts == 16 and found.adjusted.dot_mm < 0.01
