"""The scale of a file beside that of a calibrated profile."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab import Localizer
from tactape_fab.sense import Scene, iterate_frames, load_sensor
from tactape_fab.sense.files.jobs import at_scale
from tactape_fab.sense.geometry import Geometry
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
