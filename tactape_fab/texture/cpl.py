"""Pick-and-place lists (CPL, centroid files): the format of each assembly house, and a reader of all of them.

A column is a pair: its header, and the key of its content.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown
from tactape_fab.texture.board import LONGEST_MM
from tactape_fab.texture.frames import FloatArray

Style = Literal["csv", "tab", "kicad"]
Columns = tuple[tuple[str, str], ...]
SEPARATORS: Mapping[Style, str] = {"csv": ",", "tab": "\t"}

MM_PER_MIL = 0.0254
MOST_CPL_BYTES = 64 * 1024 * 1024
MOST_PROBLEMS = 20
_MOST_DEG = 360.0
_OF_NUMBERS = "0123456789+-.eE"


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Columns of a table of an assembly house."""

    columns: Columns

    @property
    def headers(self) -> tuple[str, ...]:
        return tuple(header for header, _ in self.columns)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementTable(Table):
    """Format of a pick-and-place list.

    columns: Keys of the content: ``designator``, ``x``, ``y``, ``rotation``, ``side``, ``value``, ``footprint``, ``part_number``,
        ``length`` and ``width`` (of the unturned lands), or a key of ``fixed``.
    ending: Text after the tape's name in the file name.
    style {"csv", "tab", "kicad"}: Commas, tabs with the header as a comment, or aligned columns as in KiCad.
    unit {"mm", "mil"}: Unit of coordinates and lengths.
    side: The house's word for the top side.
    clockwise: Whether rotations are clockwise, seen from above; 0 is the long axis along board x.
    half_turns: Whether rotations are in (-180, 180] instead of [0, 360).
    fixed: Cells that are the same for every part of every tape.
    """

    ending: str = "-cpl.csv"
    style: Style = "csv"
    unit: Literal["mm", "mil"] = "mm"
    side: str = "Top"
    clockwise: bool = False
    half_turns: bool = False
    fixed: Columns = ()

    @property
    def unit_mm(self) -> float:
        """Millimetres in one of the list's units."""
        return MM_PER_MIL if self.unit == "mil" else 1.0

    def written_deg(self, rotation_deg: float) -> float:
        """A counter-clockwise rotation in degrees, converted to this list's convention."""
        # rounding may give 360, which becomes 0
        turned = round((-rotation_deg if self.clockwise else rotation_deg) % 360.0, 4) % 360.0
        return turned - 360.0 if self.half_turns and turned > 180.0 else turned


_COMMON = PlacementTable(
    columns=(("Designator", "designator"), ("Mid X", "x"), ("Mid Y", "y"), ("Layer", "side"), ("Rotation", "rotation"))
)

PLACEMENTS: Mapping[str, PlacementTable] = {
    "generic": _COMMON,
    # JLCPCB help pages 46 (CPL) and "advice for BOM and CPL files" (2026-01-19); KiKit writes the same.
    "jlcpcb": _COMMON,
    # KiKit (kikit/fab/pcbway.py).
    "pcbway": _COMMON,
    # Eurocircuits' upload pages: the first row names the columns, in any wording; these are its own names for them.
    "eurocircuits": PlacementTable(
        columns=(
            ("Reference designator", "designator"),
            ("X (mm)", "x"),
            ("Y (mm)", "y"),
            ("Rotation", "rotation"),
            ("Side", "side"),
        )
    ),
    # MacroFab's help ("Managing Your PCB Bill of Materials") for columns, mils and the comment mark; its API pages ("Upload XYRS
    # File") for the origin and for clockwise rotation. The part's size is that of its lands, unturned.
    "macrofab": PlacementTable(
        columns=(
            ("Designator", "designator"),
            ("X-Loc", "x"),
            ("Y-Loc", "y"),
            ("Rotation", "rotation"),
            ("Side", "side"),
            ("Type", "type"),
            ("X-Size", "length"),
            ("Y-Size", "width"),
            ("Value", "value"),
            ("Footprint", "footprint"),
            ("Populate", "populate"),
            ("MPN", "part_number"),
        ),
        ending=".xyrs",
        style="tab",
        unit="mil",
        side="1",
        clockwise=True,
        fixed=(("type", "1"), ("populate", "1")),
    ),
    # Written line by line as pcbnew 6.0.11 does (PLACE_FILE_EXPORTER, text, mm, top side).
    "kicad": PlacementTable(
        columns=(
            ("Ref", "designator"),
            ("Val", "value"),
            ("Package", "footprint"),
            ("PosX", "x"),
            ("PosY", "y"),
            ("Rot", "rotation"),
            ("Side", "side"),
        ),
        ending="-top.pos",
        style="kicad",
        side="top",
        half_turns=True,
    ),
}

ASSEMBLY_FORMATS = tuple(PLACEMENTS)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CplContent:
    """Rows of a pick-and-place file, converted to the board frame.

    table: The known format that matches the file's header best.
    headers: The file's own column headers, in its order.
    lines: Line number of each row in the file, from 1.
    xy_mm (n, 2)
    sides: ``Top``, or the file's word if it is not the house's word for the top.
    rotation_deg (n,): Counter-clockwise.
    texts: Cells of the table's other columns, by the key of their content.
    """

    table: PlacementTable
    headers: tuple[str, ...]
    lines: tuple[int, ...]
    designators: tuple[str, ...]
    xy_mm: FloatArray
    sides: tuple[str, ...]
    rotation_deg: FloatArray
    texts: dict[str, tuple[str, ...]]


def read_cpl(data: bytes, problems: list[Problem]) -> CplContent | None:
    """Read a pick-and-place file of any known house, recognised by its header; other columns are ignored.

    Returns: None if there is no table; an unreadable number is NaN.
    problems: At most twenty are appended: not a text, not such a table, incomplete rows, and coordinates or rotations that are
        not finite or beyond 10 m or a full turn.
    """
    try:
        style, text = _text(data)
        if (plain := plain_columns(text, SEPARATORS.get(style))) is not None:
            header, columns, wrong = [column[0] for column in plain], [column[1:] for column in plain], []
            lines = tuple(range(2, len(plain[0]) + 1))
        else:
            (_, header), *rows = _rows(style, text)
            wrong = [
                (line, f"it has {len(cells)} cells where the header has {len(header)}")
                for line, cells in rows
                if len(cells) != len(header)
            ]
            whole = [(line, cells) for line, cells in rows if len(cells) == len(header)]
            lines = tuple(line for line, _ in whole)
            columns = [[cells[i] for _, cells in whole] for i in range(len(header))]
        table = _table_of(style, header)
    except SpecError as error:
        problems.extend(error.problems)
        return None
    place = {name: i for i, name in enumerate(header)}
    cells = {content: tuple(columns[place[name]]) for name, content in table.columns}
    numbers = []
    for content, most, unit in (
        ("x", LONGEST_MM / table.unit_mm, table.unit),
        ("y", LONGEST_MM / table.unit_mm, table.unit),
        ("rotation", _MOST_DEG, "deg"),
    ):
        numbers.append(_numbers(cells[content], unit))
        name = next(name for name, of in table.columns if of == content)
        wrong += [
            (lines[i], f"{name} = {shown(cells[content][i])} is not a number from {-most:g} to {most:g} {unit}")
            for i in np.flatnonzero(~(np.abs(numbers[-1]) <= most)).tolist()
        ]
    problems += [Problem("cpl", f"cpl line {line}: {what}; correct it") for line, what in sorted(wrong)[:MOST_PROBLEMS]]
    x, y, rotation = numbers
    return CplContent(
        table=table,
        headers=tuple(header),
        lines=lines,
        designators=cells["designator"],
        xy_mm=np.stack([x, y], axis=1) * table.unit_mm,
        sides=tuple("Top" if side == table.side else side for side in cells["side"]),
        rotation_deg=-rotation if table.clockwise else rotation,
        texts={c: cells[c] for _, c in table.columns if c not in ("designator", "x", "y", "side", "rotation")},
    )


def _text(data: bytes) -> tuple[Style, str]:
    """Style and decoded text; the comment mark before the header of a tab-separated table is removed."""
    if len(data) > MOST_CPL_BYTES:
        raise _refused(f"is larger than {MOST_CPL_BYTES} bytes; it is no pick-and-place file")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _refused(f"is not UTF-8: {error.reason} at byte {error.start}; write it again") from error
    # KiCad's files begin with comments; a table with tabs has its header as the first comment.
    style: Style = "kicad" if text.startswith("##") else "tab" if text.startswith("#") else "csv"
    return style, text if style == "kicad" else text.removeprefix("#")


def plain_columns(text: str, separator: str | None) -> list[list[str]] | None:
    """Columns, header first, of a table whose cells are all unquoted and which Python's csv module would write in the same bytes.

    None for anything else, such as quoted cells or one column, which the csv module then reads in ten times the time.
    """
    ends = text.count("\n")
    # RFC 4180: lines end with CR LF, and only quoted cells hold quotes, separators or line ends
    if separator is None or '"' in text or "\0" in text or not text.endswith("\r\n"):
        return None
    if text.count("\r") != ends or text.count("\r\n") != ends:
        return None
    # in UTF-8 multi-byte characters have no byte below 128, so each byte that equals a separator is one
    letters = np.frombuffer(text.encode("utf-8"), dtype=np.uint8)
    marks = np.flatnonzero((letters == ord(separator)) | (letters == ord("\n")))
    width = len(marks) // ends
    of_row = np.append(np.full(width - 1, ord(separator)), ord("\n"))
    if width < 2 or len(marks) != width * ends or (letters[marks].reshape(-1, width) != of_row).any():
        return None
    # the csv module refuses such a cell, so it is left to that
    if int(np.diff(marks, prepend=-1).max()) > csv.field_size_limit():
        return None
    # every row was found to have the same number of cells, so that column i is every width-th cell
    cells = text.removesuffix("\r\n").replace("\r\n", separator).split(separator)
    return [cells[i::width] for i in range(width)]


def _rows(style: Style, text: str) -> list[tuple[int, list[str]]]:
    """Header and rows, each with its line number; blank lines are skipped."""
    rows = list(_kicad_rows(text) if style == "kicad" else _csv_rows(text, SEPARATORS[style]))
    if not rows:
        raise _refused("is empty; write it again")
    return rows


def _refused(why: str) -> SpecError:
    return SpecError(Problem("cpl", f"cpl {why}"))


def _csv_rows(text: str, separator: str) -> Iterable[tuple[int, list[str]]]:
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=separator)
    try:
        yield from ((reader.line_num, cells) for cells in reader if cells)
    except csv.Error as error:
        raise _refused(f"line {reader.line_num} is no CSV: {error}; write it again") from error


def _kicad_rows(text: str) -> Iterable[tuple[int, list[str]]]:
    """Rows of KiCad's aligned text: comment lines give the unit and the header, and the last comment marks the end."""
    lines = text.splitlines()
    header = next((i for i, line in enumerate(lines) if line.startswith("# ")), None)
    if header is None or lines[-1] != "## End":
        raise _refused("has no header '# Ref ...' or no last line '## End'; export it again")
    if "## Unit = mm, Angle = deg." not in lines:
        raise _refused("is not in millimetres and degrees; export it again in them")
    yield header + 1, lines[header].removeprefix("# ").split()
    for number, line in enumerate(lines[header + 1 :], start=header + 2):
        if line.strip() and not line.startswith("#"):
            yield number, line.split()


def _table_of(style: Style, header: Sequence[str]) -> PlacementTable:
    """The known format of this style that has most columns in common with the header."""
    table = max((t for t in PLACEMENTS.values() if t.style == style), key=lambda t: len(set(t.headers) & set(header)))
    if lacking := [name for name in table.headers if name not in header]:
        raise _refused(f"has no column {', '.join(lacking)}; write it with the columns {', '.join(table.headers)}")
    return table


def _numbers(cells: Sequence[str], unit: str) -> FloatArray:
    """Cells as numbers, with or without the column's unit after them; NaN for a cell that is not a number, or of another unit.

    `float` also accepts '_' and non-ASCII digits: '1_0' would be 10 here and 1 elsewhere.
    """
    # the characters of all cells are checked at once; cells are read one by one only if that fails
    if all(cells) and written_with("".join(cells), _OF_NUMBERS):
        try:
            return np.array(list(map(float, cells)))
        except ValueError:
            pass
    return np.array([_number(cell, unit) for cell in cells], dtype=np.float64)


def written_with(text: str, letters: str) -> bool:
    """Whether a text consists only of these characters."""
    return text.isascii() and not text.encode("ascii").translate(None, letters.encode("ascii"))


def _number(cell: str, unit: str) -> float:
    try:
        return float(text) if written_with(text := cell.strip().removesuffix(unit), _OF_NUMBERS) else np.nan
    except ValueError:
        return np.nan
