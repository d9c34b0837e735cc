"""`tactape_fab.simulate` of version 0.1: its names are in `tactape_fab.sense` now."""

from __future__ import annotations

from typing import Any

from tactape_fab.base.old_paths import moved

_HOMES = dict.fromkeys(
    ("Frame", "Frames", "Parts", "Scene", "draw_poses", "iterate_frames", "parts_from_cpl", "simulate", "simulate_frames"),
    "tactape_fab.sense",
)


def __getattr__(name: str) -> Any:
    return moved("tactape_fab.simulate", name, _HOMES)
