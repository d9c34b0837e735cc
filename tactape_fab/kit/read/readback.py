"""Reads drill files through gerbonara, placement and part lists through csv, into plain arrays (board frame, mm)."""

from __future__ import annotations

import csv
import io
import re
import warnings
from dataclasses import dataclass

import numpy as np

from tactape_fab.kit.read.gerber_file import FURTHEST_MM, ReadbackError, is_on_earth, one_line
from tactape_fab.texture.cpl import FORMATS, BomTable, PlacementTable
from tactape_fab.texture.frames import FloatArray


def read_drill(data: bytes) -> FloatArray:
    """Holes of an Excellon file in file order, (x, y, diameter); shape (m, 3), mm.

    Raises
    ------
    ReadbackError
        When gerbonara refuses the file or finds anything but round, unplated holes in millimetres.
    """
    from gerbonara.excellon import ExcellonFile
    from gerbonara.graphic_objects import Flash

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            text = data.decode("ascii")
            file = ExcellonFile.from_string(text, plated=False)
    except Exception as error:  # gerbonara raises whatever its parser meets
        raise ReadbackError(f"gerbonara cannot read it: {one_line(error)}") from error
    if not text.rstrip().endswith("\nM30"):
        raise ReadbackError("its end, M30, is missing")
    if re.search(r"TF\.FileFunction,(?!NonPlated,)", text):
        raise ReadbackError("it calls itself another file than one of unplated holes")
    if not all(isinstance(o, Flash) and o.unit is not None and o.unit.shorthand == "mm" for o in file.objects):
        raise ReadbackError("it holds other things than round holes in millimetres")
    holes = np.array([(o.x, o.y, o.aperture.diameter) for o in file.objects], dtype=np.float64).reshape(-1, 3)
    if not is_on_earth(holes):
        raise ReadbackError(f"a hole of it lies further out than {FURTHEST_MM:g} mm")
    return holes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CplContent:
    """Rows of a pick-and-place file, in the board frame whatever the house's conventions are.

    Attributes
    ----------
    table : PlacementTable
        The known list whose header the file has.
    designators : tuple of str
    xy_mm : ndarray, shape (n, 2)
    sides : tuple of str
        ``Top``, or the file's word where it is not the house's for the top.
    rotation_deg : ndarray, shape (n,)
        Counter-clockwise.
    texts : dict of str to tuple of str
        Cells of the other columns, by what stands in them.
    """

    table: PlacementTable
    designators: tuple[str, ...]
    xy_mm: FloatArray
    sides: tuple[str, ...]
    rotation_deg: FloatArray
    texts: dict[str, tuple[str, ...]]


def read_cpl(data: bytes) -> CplContent:
    """Read a pick-and-place file of any known assembly format, which its header tells.

    Raises
    ------
    ReadbackError
        Naming the column or the row that cannot be read.
    """
    text = _decoded(data)
    style = "kicad" if text.startswith("##") else "tab" if text.startswith("#") else "csv"
    lines = {"kicad": _kicad_lines, "tab": _tab_lines, "csv": csv_lines}[style](text)
    tables = [f.placements for f in FORMATS.values() if f.placements.style == style]
    table = max(tables, key=lambda t: len(set(t.headers) & set(lines[0])))
    _refuse_header(lines[0], table.headers)
    cells = dict(zip((content for _, content in table.columns), map(tuple, zip(*lines[1:], strict=True)), strict=False))
    try:
        xy = np.array([cells.pop(axis, ()) for axis in "xy"], dtype=np.float64).T.reshape(-1, 2) * table.unit_mm
        rotation = np.array(cells.pop("rotation", ()), dtype=np.float64)
    except ValueError as error:
        raise ReadbackError(f"a coordinate or rotation is no number: {one_line(error)}") from error
    if not (is_on_earth(xy) and is_on_earth(rotation)):
        raise ReadbackError(f"a coordinate or rotation is not finite, or beyond {FURTHEST_MM:g}")
    return CplContent(
        table=table,
        designators=cells.pop("designator", ()),
        xy_mm=xy,
        sides=tuple("Top" if side == table.side else side for side in cells.pop("side", ())),
        rotation_deg=-rotation if table.clockwise else rotation,
        texts=cells,
    )


def read_bom(data: bytes, table: BomTable) -> list[dict[str, str]]:
    """Rows of a bill of materials by what stands in its columns.

    Raises
    ------
    ReadbackError
        When it is no CSV, its header is not the table's, or a row has another number of cells.
    """
    lines = csv_lines(_decoded(data))
    _refuse_header(lines[0], table.headers)
    return [dict(zip((content for _, content in table.columns), line, strict=True)) for line in lines[1:]]


def _decoded(data: bytes) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ReadbackError(f"it is no text: {one_line(error)}") from error


def _refuse_header(found: list[str], known: tuple[str, ...]) -> None:
    if tuple(found) != known:
        missing = [name for name in known if name not in found]
        what = f"column {', '.join(repr(name) for name in missing)} is missing; " if missing else ""
        raise ReadbackError(f"{what}its columns are {','.join(found)[:200]}, not {','.join(known)}")


def csv_lines(text: str, separator: str = ",") -> list[list[str]]:
    """Lines of a table as cells, the header first; ReadbackError where it is none, or a row has another number of cells."""
    try:
        lines = list(csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=separator))
    except csv.Error as error:
        raise ReadbackError(f"it is no CSV: {one_line(error)}") from error
    return _even(lines)


def _even(lines: list[list[str]]) -> list[list[str]]:
    if not lines:
        raise ReadbackError("it is empty")
    for number, line in enumerate(lines[1:], start=2):
        if len(line) != len(lines[0]):
            raise ReadbackError(f"row {number} has {len(line)} cells where the header has {len(lines[0])}")
    return lines


def _tab_lines(text: str) -> list[list[str]]:
    """A table whose header is its first comment."""
    return csv_lines(text.removeprefix("#"), "\t")


def _kicad_lines(text: str) -> list[list[str]]:
    """The aligned text of KiCad: comments, of which one gives the unit, one the header, and the last is the end."""
    lines = text.splitlines()
    header = next((line for line in lines if line.startswith("# ")), None)
    if header is None or lines[-1] != "## End":
        raise ReadbackError("its header '# Ref ...' or its last line '## End' is missing")
    if "## Unit = mm, Angle = deg." not in lines:
        raise ReadbackError("it is not in millimetres and degrees")
    return _even([header.removeprefix("# ").split(), *(line.split() for line in lines if not line.startswith("#"))])
