"""Gaps of elements that are near each other on a surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.solids.surface.charts import Frames
from tactape_fab.solids.surface.patch import gaps_mm
from tests.solids import DOME, tape_of


@pytest.mark.parametrize("turn_deg", [0.0, 7.0, 15.0, 22.0, 30.0])
@pytest.mark.parametrize("apart_mm", [-0.05, 0.0, 0.004, 0.3])
def test_the_gap_of_domes_on_a_plane_is_that_of_their_circles(turn_deg: float, apart_mm: float) -> None:
    tape = replace(tape_of(DOME, 4, 4), part=DOME)
    turn = np.radians(turn_deg)
    distance_mm = DOME.body_mm[0] + apart_mm
    points = np.array([[0.0, 0.0, 0.0], [distance_mm * np.cos(turn), distance_mm * np.sin(turn), 0.0]])
    frames = Frames(
        points_mm=points,
        x_axis=np.tile([1.0, 0.0, 0.0], (2, 1)),
        normal=np.tile([0.0, 0.0, 1.0], (2, 1)),
        facet=np.zeros(2, dtype=np.int64),
        walked_mm=np.zeros(2),
        arrived=np.ones(2, dtype=bool),
    )
    gaps, pairs = gaps_mm(tape, frames)
    assert pairs.tolist() == [[0, 1]] and np.allclose(gaps, apart_mm, atol=1e-9)
