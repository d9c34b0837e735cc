"""Whether what writes logs is installed."""

from __future__ import annotations

from collections.abc import Collection
from importlib.util import find_spec

from tactape_fab.base.errors import Problem

_NEEDS = {"mcap": "mcap", "rerun": "rerun", "save": "rerun"}


def missing_extra(wanted: Collection[str]) -> list[Problem]:
    """Problems of the options mcap, rerun and save where their packages are not installed."""
    missing = [f"--{option}" for option, module in _NEEDS.items() if option in wanted and find_spec(module) is None]
    if not missing:
        return []
    message = f"{', '.join(missing)} need packages that are not installed; pip install 'tactape-fab[live]'"
    return [Problem("live", message)]
