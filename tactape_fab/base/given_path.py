"""Check of path arguments of public functions."""

from __future__ import annotations

from os import PathLike, fspath
from pathlib import Path

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown


def as_path(value: object, key: str, remedy: str) -> Path:
    """A string or path-like object as a Path.

    key: Name of the argument.
    remedy: What path to give; the message has it after "give".
    Raises SpecError if it is neither.
    """
    if isinstance(value, str | PathLike) and isinstance(text := fspath(value), str):
        return Path(text)
    raise SpecError(Problem(key, f"{key} = {shown(value)} is no path; give {remedy}, as a text or a Path"))
