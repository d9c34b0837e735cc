"""The option --workers of the benchmarks, as that of the commands."""

from __future__ import annotations

import argparse

from tactape_fab.base.errors import Problem
from tactape_fab.base.pool import Workers, checked_workers


def workers(text: str) -> Workers:
    """A number of processes, or the address of a Dask scheduler."""
    problems: list[Problem] = []
    chosen = checked_workers(int(text) if text.isdecimal() else text, problems)
    if problems:
        raise argparse.ArgumentTypeError(problems[0].message)
    return chosen
