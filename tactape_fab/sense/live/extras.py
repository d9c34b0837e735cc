"""Check that the packages which write logs are installed."""

from __future__ import annotations

from collections.abc import Collection
from importlib.util import find_spec

from tactape_fab.base.errors import Problem
from tactape_fab.base.libraries import missing

_NEEDS = {"mcap": "mcap", "rerun": "rerun", "save": "rerun", "zenoh": "zenoh"}


def missing_extra(wanted: Collection[str]) -> list[Problem]:
    """Problems of the options mcap, rerun and save where their packages are not installed."""
    absent = [(option, module) for option, module in _NEEDS.items() if option in wanted and find_spec(module) is None]
    return [Problem(option, missing(module, f"--{option}")) for option, module in absent]
