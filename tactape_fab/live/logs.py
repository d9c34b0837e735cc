"""Whether what writes logs is installed."""

from __future__ import annotations

from importlib.util import find_spec

from tactape_fab.errors import Problem


def missing_extra(*, mcap: bool, rerun: bool) -> list[Problem]:
    """What is wrong with wanting an MCAP file, or Rerun."""
    wanted = (("mcap", mcap, "--mcap"), ("rerun", rerun, "--rerun and --save"))
    missing = [option for module, asked, option in wanted if asked and find_spec(module) is None]
    if not missing:
        return []
    return [Problem("live", f"{' and '.join(missing)} need packages that are not installed; pip install 'tactape-fab[live]'")]
