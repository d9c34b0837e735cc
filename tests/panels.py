"""Small panels, made as the command line makes them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from tactape_fab.kit.examine.order import ExaminedPanel, examine_order
from tactape_fab.kit.examine.tape_lists import list_tapes
from tactape_fab.make.many import make_packed, pack_tapes
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


PACKED: dict[str, Any] = {
    "fab": "jlcpcb-fpc",
    "models": False,
    "coverlay": "gang",
    "displacement_mm": 0.25,
    "tapes": [
        {"sector": 3, "size_mm": [36.0, 22.0], "pitch_mm": 1.7},
        {"sector": 17, "size_mm": [80.0, 16.0], "pitch_mm": 1.7, "tag": "none", "name": "long"},
        {"sector": 33, "size_mm": [22.0, 50.0], "pitch_mm": 2.2, "coverlay": "per-part", "anchor": "mesh"},
        {"sector": 40, "size_mm": [26.0, 30.0], "pitch_mm": 1.5, "holes_mm": [[20.0, 10.0, 1.0]]},
        {
            "sector": 77,
            "size_mm": [76.0, 18.0],
            "pitch_mm": 2.2,
            "coverlay": "per-part",
            "tag": "none",
            "holes_mm": [[60.0, 3.0, 0.8]],
        },
    ],
}
"""Tapes of five sizes, with and without strip, holes and anchors, opened in two ways; a tight panel of them has turned ones."""


def packed_panel(folder: Path) -> PanelKit:
    """The one panel that `make --pack` makes of `PACKED`."""
    (film,) = pack_tapes(list_tapes(PACKED, {}, folder, packed=True).tapes)
    (made,) = make_packed([film], folder, workers=1)
    assert isinstance(made, PanelKit), made
    return made


def examined_panel(values: dict[str, Any]) -> ExaminedPanel:
    examined, _ = examine_order(values)
    assert isinstance(examined, ExaminedPanel)
    return examined


def panel_of(values: dict[str, Any], path: Path) -> PanelKit:
    return make_panel(examine_order(values)[0], path)  # as the page on panels does


def copied_panel(kit: PanelKit, tmp_path: Path) -> Path:
    """A copy of a panel to change."""
    return Path(shutil.copytree(kit.path, tmp_path / "panel"))
