"""as_path: a path that a program gives, or one clear refusal of anything else."""

from __future__ import annotations

from os import PathLike, fspath
from pathlib import Path

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown


def as_path(value: object, key: str, remedy: str) -> Path:
    """The path of a text or of a path-like object.

    key: Name of the argument.
    remedy: What it should be the path of, after "give".
    Raises SpecError if it is neither.
    """
    if isinstance(value, str | PathLike) and isinstance(text := fspath(value), str):
        return Path(text)
    raise SpecError(Problem(key, f"{key} = {shown(value)} is no path; give {remedy}, as a text or a Path"))
