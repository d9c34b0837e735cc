"""The file as-built.json: its text, and the reading of untrusted content."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base.errors import Problem, SpecError, reason_of
from tactape_fab.base.fields import Fields, shown, shown_path
from tactape_fab.base.input_file import read_regular
from tactape_fab.base.json_text import parse_json
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.plane import MOST_POINTS

AS_BUILT_FORMAT = "tactape-as-built/1"
AS_BUILT_NAME = "as-built.json"
SOURCES = ("scan", "survey", "aoi", "cpl")
MOST_BYTES = 64 * 1024 * 1024
_MOST_VALUES = 7 * MOST_POINTS
"""Limit for the JSON reader: six columns with one value per part, and room for the rest."""
MOST_SOURCES = 1000
MOST_SOURCE_CHARACTERS = 10_000
FARTHEST_MM = 10.0
"""Largest shift, and largest standard deviation of a place. A part farther off is a foreign object."""
MOST_STRETCH = 0.1
"""Largest stretch and shear of the film: polyimide moves by 0.1 % or so."""
RANGES = {
    "dx_mm": (-FARTHEST_MM, FARTHEST_MM),
    "dy_mm": (-FARTHEST_MM, FARTHEST_MM),
    "rotation_deg": (-360.0, 360.0),
    "sigma_mm": (0.0, FARTHEST_MM),
}
"""Columns of numbers, and the values that they may have."""


def file_of(path: Path) -> Path:
    """The path of the file, given that or the folder of its kit."""
    with suppress(OSError, ValueError):  # a name that is invalid on every system is refused when it is read
        return path / AS_BUILT_NAME if path.is_dir() else path
    return path


def rounded(values: FloatArray, digits: int) -> list[float]:
    """A column rounded for the file."""
    # in double precision: a rounded float32 has more digits when it is written as a double
    return [v + 0.0 for v in np.round(values.astype(np.float64), digits).tolist()]  # + 0.0: no -0.0


def as_text(content: Mapping[str, Any]) -> str:
    """JSON text with one line for each key of the tables."""
    lines = []
    for key, value in content.items():
        if key == "parts":
            inner = ",\n".join(f"    {json.dumps(name)}: {json.dumps(column)}" for name, column in value.items())
            lines.append(f"  {json.dumps(key)}: {{\n{inner}\n  }}")
        else:
            lines.append(f"  {json.dumps(key)}: {json.dumps(value, sort_keys=True)}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def content_of(path: Path) -> Mapping[str, Any]:
    """The file's JSON object, its values unchecked. Raises SpecError if it cannot be read, is too large, or is not an object."""
    file = file_of(path)
    what = f"as_built = {shown_path(file)}"
    try:
        data = read_regular(file, MOST_BYTES)
        if len(data) > MOST_BYTES:
            message = f"{what} has more than {MOST_BYTES} bytes; it is no as-built file of this tool"
            raise SpecError(Problem("as-built", message))
        content = parse_json(data, most_values=_MOST_VALUES)
    except (OSError, ValueError) as error:
        if isinstance(error, SpecError):
            raise
        message = f"{what} cannot be read: {reason_of(error)}; give a file that inspect or survey wrote"
        raise SpecError(Problem("as-built", message)) from error
    if not isinstance(content, dict):
        raise SpecError(Problem("as-built", f"{what} holds no table; give a file that inspect or survey wrote"))
    return content


def read_values(table: Fields) -> dict[str, Any]:
    """Keyword arguments of `AsBuilt` from the file's table, all checked. Raises SpecError with all problems together."""
    if isinstance(kind := table.values.get("format"), str) and kind != AS_BUILT_FORMAT:  # its other keys mean something else
        message = f"format = {shown(kind)} is no file of measured places; give one of format '{AS_BUILT_FORMAT}', as survey makes"
        raise SpecError(Problem("as-built", message))
    table.refuse_unknown(("format", "tape", "manifest_sha256", "film", "parts", "source"))
    table.text("format", choices=(AS_BUILT_FORMAT,), remedy="this version reads no other")
    name = table.text("tape", longest=64)
    digest = table.text("manifest_sha256", pattern="[0-9a-f]{64}", remedy="give 64 hexadecimal digits")
    film = _read_film(table.table("film", ("scale", "shear", "sigma"))) if "film" in table.values else {}
    parts = table.table("parts", ("designator", *RANGES, "present"))
    names = parts.rows("designator", longest=MOST_POINTS)
    number = _numbers(parts, names)
    columns = {key: _column(parts, key, len(names)) for key in RANGES}
    present = parts.rows("present", longest=MOST_POINTS)
    if len(present) != len(names) or not set(map(type, present)) <= {bool}:
        parts.problem("present", f"present is not {len(names)} of true and false; give one for each designator")
    source = _read_source(table) if "source" in table.values else ()
    if table.problems:
        raise SpecError([Problem("as-built", problem.message) for problem in table.problems])
    # `AsBuilt` needs ascending numbers; the file may list them in any order
    order = np.argsort(number, kind="stable")
    return {
        "tape": name,
        "manifest_sha256": digest,
        "number": number[order],
        "present": np.array(present, dtype=bool)[order],
        "film": film,
        "source": source,
        **{key: values[order] for key, values in columns.items()},
    }


def _read_film(table: Fields) -> dict[str, Any]:
    return {
        "scale": table.numbers("scale", 2, low=1.0 - MOST_STRETCH, high=1.0 + MOST_STRETCH, unit=""),
        "shear": table.number("shear", low=-MOST_STRETCH, high=MOST_STRETCH, unit=""),
        "sigma": table.number("sigma", low=0.0, high=MOST_STRETCH, unit=""),
    }


def _numbers(parts: Fields, names: Sequence[object]) -> IntArray:
    """Numbers of designators such as R12; 1, 2, ... if any of them is invalid."""
    found = [
        int(name[1:])
        if isinstance(name, str) and 1 < len(name) <= 9 and name[0] == "R" and name[1:].isascii() and name[1:].isdigit()
        else 0
        for name in names
    ]
    wrong = [k for k, n in enumerate(found) if n < 1 or names[k] != f"R{n}"]
    if wrong:
        message = f"designator[{wrong[0]}] = {shown(names[wrong[0]])} is no designator; give R and a number, such as R12"
        parts.problem("designator", message + (f" ({len(wrong)} are wrong)" if len(wrong) > 1 else ""))
        return np.arange(1, len(names) + 1)
    number = np.array(found, dtype=np.int64)
    kinds, counts = np.unique(number, return_counts=True)
    if (counts > 1).any():
        parts.problem("designator", f"designator R{kinds[counts > 1][0]} occurs twice; give each part once")
    return number


def _column(parts: Fields, key: str, count: int) -> FloatArray:
    """A column of finite numbers within its range; zeros where there is a problem."""
    low, high = RANGES[key]
    unit = "deg" if key == "rotation_deg" else "mm"
    values = parts.rows(key, longest=max(count, 1_000_000))
    if key not in parts.values or parts.refused(parts.where + key):
        return np.zeros(count)
    if len(values) != count:
        parts.problem(key, f"{key} has {len(values)} entries for {count} designators; give one for each")
        return np.zeros(count)
    if set(map(type, values)) <= {int, float}:
        try:
            column = np.array(values, dtype=np.float64).reshape(count)
        except OverflowError:  # an integer beyond any float
            column = np.full(count, np.nan)
        wrong = np.flatnonzero(~((column >= low) & (column <= high)))
        if not len(wrong):
            return column
        first = int(wrong[0])
    else:
        first = next(k for k, v in enumerate(values) if type(v) not in (int, float))
    message = f"{key}[{first}] = {shown(values[first])} is no number of {unit} from {low:g} to {high:g}; correct it"
    parts.problem(key, message)
    return np.zeros(count)


def _read_source(table: Fields) -> tuple[Mapping[str, Any], ...]:
    found = []
    for i, row in enumerate(table.rows("source", longest=MOST_SOURCES)):
        entry = Fields(row if isinstance(row, Mapping) else {}, f"source[{i}].", table.problems)
        entry.text("kind", choices=SOURCES)
        if "drift_mm" in entry.values:
            entry.number("drift_mm", low=0.0, high=FARTHEST_MM)
        try:
            size = len(json.dumps(row, allow_nan=False))
        except (ValueError, RecursionError):
            size = MOST_SOURCE_CHARACTERS + 1
        if size > MOST_SOURCE_CHARACTERS:
            message = f"source[{i}] has NaN or more than {MOST_SOURCE_CHARACTERS} characters; give less of it"
            table.problem("source", message)
        found.append(dict(entry.values))
    return tuple(found)
