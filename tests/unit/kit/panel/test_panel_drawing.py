"""Slots of a panel: no line of theirs is shorter than what a file can say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.kit.panel.panel_drawing import slots_mm
from tactape_fab.kit.panel.tabs_and_marks import plan_panel
from tactape_fab.kit.profiles import load_fab

FAB = load_fab("pcbway-fpc")


@pytest.mark.parametrize(
    ("size_mm", "gap_mm", "tab_mm", "pitch_mm"), [((17.0, 40.0), 0.8, 0.7, 60.0), ((100.0, 50.0), 1.6, 1.0, 25.0)]
)
def test_a_slot_has_no_point_twice(size_mm: tuple[float, float], gap_mm: float, tab_mm: float, pitch_mm: float) -> None:
    rules = replace(FAB.panel, gap_mm=gap_mm, tab_mm=tab_mm, tab_pitch_mm=pitch_mm, fiducials=0)
    panel = plan_panel(size_mm, 1.0, (1, 1), "auto", replace(FAB, panel=rules))
    for slot in slots_mm(panel):
        assert len(np.unique(slot, axis=0)) == len(slot)
