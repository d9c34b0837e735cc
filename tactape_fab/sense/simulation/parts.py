"""Where parts stand on the board: from a tape, from a written CPL, and what is wrong with their placement."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown, shown_path
from tactape_fab.sense.simulation.scene import Scene
from tactape_fab.texture.cpl import FORMATS, PlacementTable
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.plane import MOST_POINTS
from tactape_fab.texture.tape import LONGEST_MM, Tape

CPL_COLUMNS = ("Designator", "Mid X", "Mid Y", "Layer", "Rotation")
_CPL_BYTES = 64 * 1024 * 1024
_MOST_NAMED = 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Parts:
    """Parts on a board.

    Attributes
    ----------
    xy_mm : ndarray, shape (n, 2)
        Centres (board frame, mm).
    rotation_deg : ndarray, shape (n,)
        Degrees, counter-clockwise seen from above.
    """

    xy_mm: FloatArray
    rotation_deg: FloatArray

    def __post_init__(self) -> None:
        self.xy_mm.setflags(write=False)
        self.rotation_deg.setflags(write=False)

    def taken(self, which: IntArray | npt.NDArray[np.bool_]) -> Parts:
        """Some of the parts.

        Parameters
        ----------
        which : ndarray of int or bool
            Indices, or whether each is taken.

        Returns
        -------
        Parts
        """
        return Parts(xy_mm=self.xy_mm[which], rotation_deg=self.rotation_deg[which])


@lru_cache(maxsize=32)
def parts_of(tape: Tape) -> Parts:
    """All parts of a tape at their nominal places, designator order."""
    xy_mm = tape.part_xy_mm()
    return Parts(xy_mm=xy_mm, rotation_deg=np.full(len(xy_mm), tape.part.rotation_deg))


def as_parts(tape: Tape, parts: Parts | npt.ArrayLike | None) -> Parts:
    """The parts to draw: the tape's own for None, else `Parts` or an array of (x, y) or (x, y, rotation) rows.

    Raises
    ------
    SpecError
        For an array of another form, or with values that are no place on a board.
    """
    if parts is None:
        return parts_of(tape)
    if isinstance(parts, Parts):
        return parts
    remedy = "give an array of (x mm, y mm) or (x mm, y mm, rotation deg) rows in the board frame"
    try:
        rows = np.array(parts, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise SpecError(Problem("parts", f"parts is no array of numbers: {error}; {remedy}")) from error
    if rows.ndim != 2 or rows.shape[1] not in (2, 3) or len(rows) > MOST_POINTS:
        raise SpecError(Problem("parts", f"parts has shape {rows.shape}; {remedy}, at most {MOST_POINTS}"))
    if not np.isfinite(rows).all() or (np.abs(rows[:, :2]) > LONGEST_MM).any():
        raise SpecError(Problem("parts", f"parts holds a value that is not finite or beyond {LONGEST_MM:g} mm; {remedy}"))
    rotation = rows[:, 2] if rows.shape[1] == 3 else np.full(len(rows), tape.part.rotation_deg)
    return Parts(xy_mm=rows[:, :2].copy(), rotation_deg=rotation.copy())


def scattered(parts: Parts, scene: Scene, rng: np.random.Generator) -> tuple[Parts, npt.NDArray[np.bool_]]:
    """Parts as they really stand, and which of them are there; every scene draws the same numbers."""
    count = len(parts.xy_mm)
    there = rng.random(count) >= scene.missing
    xy_mm = parts.xy_mm + scene.placement_mm * rng.standard_normal((count, 2))
    return Parts(xy_mm=xy_mm, rotation_deg=parts.rotation_deg + scene.rotation_deg * rng.standard_normal(count)), there


def parts_from_cpl(source: str | Path | bytes) -> Parts:
    """Parts of a written pick-and-place file, in its order.

    Parameters
    ----------
    source : path or bytes
        CSV with the columns Designator, Mid X, Mid Y, Layer, Rotation (mm and degrees, board frame), where others are
        ignored; or a list of any assembly format that kits are made in.

    Returns
    -------
    Parts

    Raises
    ------
    SpecError
        When it cannot be read, or a row is not whole; the first twenty rows that are not are named.
    """
    text = _as_common(_cpl_text(source))
    reader = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    problems: list[Problem] = []
    rows: list[tuple[float, float, float]] = []
    seen: set[str] = set()
    try:
        lacking = [name for name in CPL_COLUMNS if name not in (reader.fieldnames or ())]
        if lacking:
            message = f"cpl has no column {', '.join(lacking)}; write it with the columns {', '.join(CPL_COLUMNS)}"
            raise SpecError(Problem("cpl", message))
        for row in reader:
            if len(rows) >= MOST_POINTS or len(problems) >= _MOST_NAMED:
                break
            rows.append(_cpl_row(row, reader.line_num, seen, problems))
    except csv.Error as error:
        raise SpecError(Problem("cpl", f"cpl line {reader.line_num} is no CSV: {error}; write it again")) from error
    if not rows:
        problems.append(Problem("cpl", "cpl names no part; write it again"))
    if len(rows) >= MOST_POINTS:
        problems.append(Problem("cpl", f"cpl has {MOST_POINTS} rows or more; a tape has fewer parts"))
    if problems:
        raise SpecError(problems)
    table = np.array(rows)
    return Parts(xy_mm=table[:, :2].copy(), rotation_deg=table[:, 2].copy())


def _cpl_text(source: str | Path | bytes) -> str:
    try:
        if isinstance(source, bytes):
            data = source
        else:
            with Path(source).open("rb") as stream:
                data = stream.read(_CPL_BYTES + 1)
        if len(data) > _CPL_BYTES:
            raise SpecError(Problem("cpl", f"cpl is larger than {_CPL_BYTES} bytes; it is no pick-and-place file"))
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SpecError(Problem("cpl", f"cpl is not UTF-8: {error.reason} at byte {error.start}; write it again")) from error
    except (OSError, ValueError) as error:
        if isinstance(error, SpecError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise SpecError(Problem("cpl", f"cpl {shown_path(source)} cannot be opened: {reason}; give a CSV file")) from error


def _as_common(text: str) -> str:
    """A list of another known format as the CSV that is read here, line by line; any other text as it is."""
    lines = text.splitlines()
    for table in (f.placements for f in FORMATS.values() if f.placements.headers != CPL_COLUMNS):
        separator = {"csv": ",", "tab": "\t", "kicad": None}[table.style]
        head = next((i for i, line in enumerate(lines[:9]) if tuple(line.lstrip("# ").split(separator)) == table.headers), None)
        if head is not None:
            rows = [",".join(_common_cells(line.split(separator), table)) for line in lines[head + 1 :] if line[:1] != "#"]
            return "\n".join([",".join(CPL_COLUMNS), *[""] * head, *rows, ""])
    return text


def _common_cells(cells: Sequence[str], table: PlacementTable) -> list[str]:
    """Designator, x and y in mm, side and counter-clockwise rotation; what is no number stays as it is."""
    row = dict(zip((content for _, content in table.columns), cells, strict=False))

    def scaled(content: str, factor: float) -> str:
        try:
            return repr(float(row.get(content, "")) * factor)
        except ValueError:
            return row.get(content, "")

    side = "Top" if row.get("side") == table.side else row.get("side", "")
    turn = scaled("rotation", -1.0 if table.clockwise else 1.0)
    return [row.get("designator", ""), scaled("x", table.unit_mm), scaled("y", table.unit_mm), side, turn]


def _cpl_row(
    row: dict[str | None, str | Sequence[str] | None], line: int, seen: set[str], problems: list[Problem]
) -> tuple[float, float, float]:
    """x, y and rotation of one row; what is wrong with it is added to `problems`."""
    name, side = row["Designator"], row["Layer"]
    if not isinstance(name, str) or not name or name in seen:
        problems.append(Problem("cpl", f"cpl line {line}: designator {shown(name)} is empty or stands twice; correct it"))
    elif not isinstance(side, str) or side.strip().lower() not in ("top", "t"):
        problems.append(Problem("cpl", f"cpl line {line}: {shown(name)} is on layer {shown(side)}; parts stand on Top"))
    seen.add(str(name))
    values = []
    for column, most, unit in (("Mid X", LONGEST_MM, "mm"), ("Mid Y", LONGEST_MM, "mm"), ("Rotation", 360.0, "deg")):
        try:
            value = float(str(row[column]).removesuffix("mm"))
        except ValueError:
            value = math.nan
        if not abs(value) <= most:
            message = (
                f"cpl line {line}: {column} = {shown(row[column])} is no number from {-most:g} to {most:g} {unit}; correct it"
            )
            problems.append(Problem("cpl", message))
        values.append(value)
    return values[0], values[1], values[2]
