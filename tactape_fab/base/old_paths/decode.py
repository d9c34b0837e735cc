"""`tactape_fab.decode` of version 0.1: its names are in `tactape_fab` and `tactape_fab.sense` now."""

from __future__ import annotations

from typing import Any

from tactape_fab.base.old_paths import moved

_HOMES = {
    **dict.fromkeys(("Localizer", "Localization", "Prior"), "tactape_fab"),
    **dict.fromkeys(("Reconstruction", "load_network", "make_reconstruction"), "tactape_fab.sense"),
}


def __getattr__(name: str) -> Any:
    return moved("tactape_fab.decode", name, _HOMES)
