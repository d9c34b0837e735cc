"""Small panels, made as the command line makes them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from tactape_fab.kit.examine.order import ExaminedPanel, examine_order
from tactape_fab.make.panel import PanelKit, make_panel

TWO: dict[str, Any] = {"sector": 7, "panel": "auto", "size_mm": [60.0, 30.0], "models": False}
"""Two tapes: the fewest of this size that a line takes."""
SIX: dict[str, Any] = {
    "sectors": [3, 200, 41, 5, 6, 255],
    "panel": "2x3",
    "size_mm": [32.0, 22.0],
    "pitch_mm": 1.7,
    "holes_mm": [[30.9, 11.0, 0.5]],
    "stiffener": "FR4 0.2",
    "anchor": "spur",
    "models": False,
}
"""Six tapes with a hole and a stiffener each, and anchored pads."""


def examined_panel(values: dict[str, Any]) -> ExaminedPanel:
    examined, _ = examine_order(values)
    assert isinstance(examined, ExaminedPanel)
    return examined


def panel_of(values: dict[str, Any], path: Path) -> PanelKit:
    return make_panel(examined_panel(values), path)


def copied_panel(kit: PanelKit, tmp_path: Path) -> Path:
    """A copy of a panel to change."""
    return Path(shutil.copytree(kit.path, tmp_path / "panel"))
