"""Pictures of frames: which tape is drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tactape_fab import Localizer
from tactape_fab.sense import load_sensor, simulate
from tactape_fab.sense.overlay import draw_overlay
from tests.contacts import TAPE, tape_of


def test_of_two_tapes_of_one_name_that_of_the_answer_is_drawn() -> None:
    other = replace(tape_of(30), name=TAPE.name)
    depth = simulate(other, (30.0, 20.0), 37.0)
    fix = Localizer([TAPE, other]).locate(depth)
    assert fix.sector == 30
    drawn, alone = (draw_overlay(depth, load_sensor("gelsight-mini"), tapes, fix, 0) for tapes in ([TAPE, other], [other]))
    assert np.array_equal(drawn, alone)
