"""Reading of profiles: TOML files of templates/, or a user's own by path."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from functools import cache, lru_cache, wraps
from pathlib import Path
from typing import Any, TypeVar

from tactape_fab.base.errors import Problem, SpecError, reason_of, refuse
from tactape_fab.base.fields import Fields, nearest, shown, shown_path
from tactape_fab.base.input_file import read_regular
from tactape_fab.base.libraries import library

T = TypeVar("T")
DEFAULT_SENSOR = "gelsight-mini"
"""Name of the sensor profile that stands where none is given."""
_PARSER = "tomllib" if sys.version_info >= (3, 11) else "tomli"
_PROFILE_BYTES = 1024 * 1024
_MOST_PARTS = 64
"""Most parts of a dotted key: the parser keeps the table of every prefix, which takes gigabytes for 100,000 parts."""
_LONG_INTEGER = re.compile(r"0[xob][0-9A-Fa-f_]{3000}")
"""Matches an integer that Python may refuse to write as decimals, of which it allows 4300; longer decimals it does not read."""
# alternatives in order: a multi-line string, which cannot be in a key; a quoted or bare part; a dot with blanks around it; a
# comment; blanks or any other character, which end a key
_TOKENS = re.compile(
    r'''"""(?:[^"\\]+|\\.|"(?!""))*(?:"{3,5})?|'''
    r"""'''(?:[^']+|'(?!''))*(?:'{3,5})?|"""
    r"""(?P<part>"(?:[^"\\\n]+|\\[^\n])*"?|'[^'\n]*'?|[\w-]+)|(?P<dot>[ \t]*\.[ \t]*)|#[^\n]*|[ \t]+|[^\w"'#. \t-]+""",
    re.DOTALL,
)


def templates_folder() -> Path:
    """Folder of the data files: inside the package in a wheel, beside it in a checkout or an editable install.

    Returns
    -------
    Path
        Folder with one subfolder of TOML files for each kind of profile: ``fabs``, ``parts``, ``processes``, ``sensors``.

    Raises
    ------
    FileNotFoundError
        If the folder is missing from the installation.
    """
    package = Path(__file__).resolve().parent.parent
    for folder in (package / "templates", package.parent / "templates"):
        if folder.is_dir():
            return folder
    raise FileNotFoundError("the templates folder is missing from this installation of tactape-fab; install it again")


def profile_names(kind: str) -> list[str]:
    """Names of the profiles that come with the package; `kind` is ``fabs``, ``parts``, ``processes`` or ``sensors``."""
    return list(_names(kind))


@cache
def _names(kind: str) -> tuple[str, ...]:
    return tuple(sorted(path.stem for path in (templates_folder() / kind).glob("*.toml")))


def read_toml(path: Path, key: str) -> dict[str, Any]:
    """Parse a TOML file of bounded size. Raises SpecError if it cannot be opened, is too large, or is not TOML.

    Raises MissingLibraryError on Python 3.10 without tomli.
    """
    try:
        data = read_regular(path, _PROFILE_BYTES)
    except (OSError, ValueError) as error:  # ValueError: a path that is invalid on every system
        reason = reason_of(error)
        message = f"{key} = {shown_path(path)} cannot be opened: {reason}; give the path of a TOML file that can be read"
        raise SpecError(Problem(key, message)) from error
    if len(data) > _PROFILE_BYTES:
        message = f"{key} = {shown_path(path)} is larger than {_PROFILE_BYTES} bytes; it is not a spec or profile, give one"
        raise SpecError(Problem(key, message))
    try:
        text = data.decode("utf-8-sig")
        # a key is on one line, so a line with few dots has no long key; the slow tokeniser runs only if some line has many
        if any(line.count(".") >= _MOST_PARTS for line in text.split("\n")) and _parts(text) > _MOST_PARTS:
            raise ValueError(f"a key has more than {_MOST_PARTS} parts, with dots between them")
        if _LONG_INTEGER.search(text):  # every message and key with its value would raise a ValueError
            raise ValueError("it holds an integer of thousands of digits")
        content: dict[str, Any] = library(_PARSER, "reading TOML").loads(text)
        return content
    except (ValueError, RecursionError) as error:  # UnicodeDecodeError and TOMLDecodeError among them
        raise SpecError(Problem(key, f"{key} = {shown_path(path)} is not TOML: {reason_of(error)}; correct it")) from error


def _parts(text: str) -> int:
    """Number of parts of the longest dotted key in a text; a quoted part counts as one."""
    most = parts = 0
    for token in _TOKENS.finditer(text):
        parts = parts + 1 if token.lastgroup == "part" else parts if token.lastgroup == "dot" else 0
        most = max(most, parts)
    return most


def is_profile_file(name: object) -> bool:
    """Whether the name of a profile is the path of a TOML file, which may end in capitals."""
    return isinstance(name, str | Path) and str(name).lower().endswith(".toml")


def profile_table(kind: str, key: str, name: str) -> Fields:
    if is_profile_file(name):
        path = Path(name)
    elif name in (known := profile_names(kind)):
        path = templates_folder() / kind / f"{name}.toml"
    else:
        near = nearest(name, known)
        hint = "give one of them" if near is None else f"did you mean '{near}'?"
        message = f"{key} = {shown(name)} is none of: {', '.join(known)}, nor the path of a .toml file; {hint}"
        raise SpecError(Problem(key, message))
    return Fields(read_toml(path, key), f"{key} {path.stem}: ")


def read_once(kind: str) -> Callable[[Callable[[str], T]], Callable[[str], T]]:
    """Decorator of a profile reader: profiles of the package are cached, a user's own file is read each time."""

    def decorated(read: Callable[[str], T]) -> Callable[[str], T]:
        # not cached: a user's own file may be edited between two calls
        known = lru_cache(maxsize=64)(read)
        return wraps(read)(lambda name: known(name) if name in _names(kind) else read(name))

    return decorated


def refuse_problems(table: Fields) -> None:
    refuse(table.problems)
