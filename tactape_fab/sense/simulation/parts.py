"""Places of parts on the board: from a tape or a written CPL, with simulated placement errors."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError, reason_of
from tactape_fab.base.fields import shown, shown_path
from tactape_fab.base.given_path import as_path
from tactape_fab.base.given_value import NO_ARRAY, as_numbers, refuse_other, unmasked
from tactape_fab.base.input_file import read_regular
from tactape_fab.sense.simulation.scene import Scene
from tactape_fab.texture.board import LONGEST_MM
from tactape_fab.texture.cpl import MOST_CPL_BYTES, MOST_PROBLEMS, read_cpl
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.plane import MOST_POINTS
from tactape_fab.texture.tape import Tape


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
        shapes: tuple[tuple[str, tuple[int | None, ...]], ...] = (("xy_mm", (None, 2)), ("rotation_deg", (None,)))
        for key, shape in shapes:
            array = as_numbers(getattr(self, key), shape, key, "arrays of numbers, of shapes (n, 2) and (n,)")
            object.__setattr__(self, key, array)
            array.setflags(write=False)

    def taken(self, which: IntArray | npt.NDArray[np.bool_]) -> Parts:
        """Some of the parts.

        Parameters
        ----------
        which : ndarray of int or bool
            Indices, or a mask.

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


def built_parts_of(tape: Tape) -> Parts:
    """The parts of a tape that are there, where they were measured; designator order.

    Raises SpecError if nothing was measured.
    """
    if tape.as_built is None:
        message = f"nobody measured {tape.name}: its kit has no as-built.json; name the file with --as-built, or leave out --from"
        raise SpecError(Problem("from", message))
    built, nominal = tape.built_parts(), parts_of(tape)
    parts = Parts(xy_mm=nominal.xy_mm + built.shift_mm, rotation_deg=nominal.rotation_deg + built.rotation_deg)
    return parts.taken(built.present)


def as_parts(tape: Tape, parts: Parts | npt.ArrayLike | None) -> Parts:
    """The parts to draw: the tape's own for None, else `Parts` or an array of (x, y) or (x, y, rotation) rows.

    Raises SpecError for an array of another shape, or with values that are not valid board places.
    """
    if parts is None:
        return parts_of(tape)
    remedy = "give an array of (x mm, y mm) or (x mm, y mm, rotation deg) rows in the board frame"
    if isinstance(parts, Parts):
        if parts.xy_mm.shape != (len(parts.rotation_deg), 2):
            shapes = f"{parts.xy_mm.shape} and {parts.rotation_deg.shape}"
            raise SpecError(Problem("parts", f"parts has places and rotations of shapes {shapes}; give (n, 2) and (n,)"))
        return parts
    try:
        rows = np.array(unmasked(parts), dtype=np.float64)
    except NO_ARRAY as error:
        raise SpecError(Problem("parts", f"parts is no array of numbers: {error}; {remedy}")) from error
    if rows.ndim != 2 or rows.shape[1] not in (2, 3) or len(rows) > MOST_POINTS:
        raise SpecError(Problem("parts", f"parts has shape {rows.shape}; {remedy}, at most {MOST_POINTS}"))
    if not np.isfinite(rows).all() or (np.abs(rows[:, :2]) > LONGEST_MM).any():
        raise SpecError(Problem("parts", f"parts holds a value that is not finite or beyond {LONGEST_MM:g} mm; {remedy}"))
    rotation = rows[:, 2] if rows.shape[1] == 3 else np.full(len(rows), tape.part.rotation_deg)
    return Parts(xy_mm=rows[:, :2].copy(), rotation_deg=rotation.copy())


def scattered(parts: Parts, scene: Scene, rng: np.random.Generator) -> tuple[Parts, npt.NDArray[np.bool_]]:
    """Parts with placement errors, and a mask of those present; every scene draws the same random numbers."""
    # all numbers are drawn whatever the scene asks for, so that a scene with placement errors loses the very parts of one without
    count = len(parts.xy_mm)
    there = rng.random(count) >= scene.missing
    xy_mm = parts.xy_mm + scene.placement_mm * rng.standard_normal((count, 2))
    return Parts(xy_mm=xy_mm, rotation_deg=parts.rotation_deg + scene.rotation_deg * rng.standard_normal(count)), there


def parts_from_cpl(source: str | Path | bytes, expected: Sequence[str] | None = None) -> Parts:
    """Parts of a written pick-and-place file, in its order.

    Parameters
    ----------
    source : path or bytes
        CSV with the columns Designator, Mid X, Mid Y, Layer, Rotation (mm and degrees, board frame), other columns
        ignored; or a list of any assembly format of kits.
    expected : sequence of str, optional
        Designators that it may name, and no others.

    Returns
    -------
    Parts

    Raises
    ------
    SpecError
        If it cannot be read, a row is incomplete, or it names a part that is not expected; at most twenty problems are listed.
    """
    problems: list[Problem] = []
    cpl = read_cpl(_cpl_bytes(source), problems)
    if cpl is None:
        raise SpecError(problems)
    seen: set[str] = set()
    for line, name, side in zip(cpl.lines, cpl.designators, cpl.sides, strict=True):
        if not name or name in seen:
            message = f"cpl line {line}: designator {shown(name)} is empty or stands twice; correct it"
            problems.append(Problem("cpl", message))
        elif side.strip().lower() not in ("top", "t"):
            problems.append(Problem("cpl", f"cpl line {line}: {shown(name)} is on layer {shown(side)}; parts stand on Top"))
        seen.add(name)
    refuse_other(expected, (Sequence, Set, type(None)), "expected", "list of designators", "Tape.designators(), or leave it out")
    known = None if expected is None else set(expected)
    foreign = [name for name in cpl.designators if known is not None and name not in known]
    if foreign and not problems:
        message = f"cpl names {shown(foreign[0])}, which is no part of the tape ({len(foreign)} of {len(cpl.designators)})"
        problems.append(Problem("cpl", f"{message}; write the file again, or give that of this tape"))
    if not seen and not problems:
        problems.append(Problem("cpl", "cpl names no part; write it again"))
    if len(cpl.lines) >= MOST_POINTS:
        problems.append(Problem("cpl", f"cpl has {MOST_POINTS} rows or more; a tape has fewer parts"))
    if problems:
        raise SpecError(problems[:MOST_PROBLEMS])
    return Parts(xy_mm=cpl.xy_mm, rotation_deg=cpl.rotation_deg)


def _cpl_bytes(source: str | Path | bytes) -> bytes:
    if isinstance(source, bytes):
        return source
    path = as_path(source, "source", "a CSV file")
    try:
        return read_regular(path, MOST_CPL_BYTES)
    except (OSError, ValueError) as error:
        reason = reason_of(error)
        raise SpecError(Problem("cpl", f"cpl {shown_path(path)} cannot be opened: {reason}; give a CSV file")) from error
