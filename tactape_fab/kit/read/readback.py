"""Readers of drill files (gerbonara), part lists (csv) and placement lists (`texture.cpl`); board frame, mm."""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from tactape_fab.base.errors import Problem
from tactape_fab.kit.profiles.assembly import BomTable
from tactape_fab.kit.read.gerber_file import FURTHEST_MM, ReadbackError, is_on_earth, one_line
from tactape_fab.texture import cpl as texture_cpl
from tactape_fab.texture.cpl import SEPARATORS, CplContent, plain_columns, written_with
from tactape_fab.texture.frames import FloatArray

_DIGITS = "0123456789.-"
_KICAD_FORM = re.compile(
    r"(?:### [ -~]{1,200}\n){2}## Unit = mm, Angle = deg\.\n## Side : top\n# [ -~]{1,200}\n(?:[!\"$-~][ -~]*\n)*## End\n"
)
"""Form of a KiCad list: with a second comment on unit or columns, programs differ in which one they use."""
_KEPT_BYTES = 8 << 20
"""Largest list whose content is cached: that of 200,000 parts, which takes 30 MB."""


def read_drill(data: bytes) -> FloatArray:
    """Holes of an Excellon file in file order, (x, y, diameter); shape (m, 3), mm.

    Raises ReadbackError if gerbonara refuses the file or finds anything but round, unplated holes in millimetres.
    """
    from gerbonara.excellon import ExcellonFile
    from gerbonara.graphic_objects import Flash

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            text = data.decode("ascii")
            if re.search(r"^\s*R\s*\d", text, re.MULTILINE):  # a repeat of 12 bytes may mean 100 million holes
                raise ReadbackError("it repeats holes, which this tool never writes")
            file = ExcellonFile.from_string(text, plated=False)
    except ReadbackError:
        raise
    except Exception as error:  # gerbonara raises exceptions of any type
        raise ReadbackError(f"gerbonara cannot read it: {one_line(error)}") from error
    # without M30 the file was cut off
    if not text.rstrip().endswith("\nM30"):
        raise ReadbackError("its end, M30, is missing")
    if re.search(r"TF\.FileFunction,(?!NonPlated,)", text):
        raise ReadbackError("it calls itself another file than one of unplated holes")
    # gerbonara reads a slot as a line, and a tool in inches as another unit
    if not all(isinstance(o, Flash) and o.unit is not None and o.unit.shorthand == "mm" for o in file.objects):
        raise ReadbackError("it holds other things than round holes in millimetres")
    holes = np.array([(o.x, o.y, o.aperture.diameter) for o in file.objects], dtype=np.float64).reshape(-1, 3)
    if not is_on_earth(holes):
        raise ReadbackError(f"a hole of it lies further out than {FURTHEST_MM:g} mm")
    return holes


def read_cpl(data: bytes) -> CplContent:
    """Read a pick-and-place file that has exactly the columns of a known assembly format.

    Raises ReadbackError naming every column or row that cannot be read.
    Equal bytes are read once, unless they are many: previews, report and verification of a kit read the same file.
    """
    return _read_cpl(data) if len(data) <= _KEPT_BYTES else _read_cpl.__wrapped__(data)


@lru_cache(maxsize=2)
def _read_cpl(data: bytes) -> CplContent:
    problems: list[Problem] = []
    content = texture_cpl.read_cpl(data, problems)
    if content is None or problems:
        raise ReadbackError("; ".join(problem.message for problem in problems))
    _refuse_header(content.headers, content.table.headers)
    if content.table.style == "kicad":
        text = _decoded(data)
        if _KICAD_FORM.fullmatch(text) is None:
            raise ReadbackError("its comments are not KiCad's of a top side in mm, each once, or its lines end otherwise")
        rows = [line.split() for line in text.split("\n") if line and not line.startswith("#")]
        columns = [[row[i] for row in rows] for i in range(len(content.headers))]
    else:
        columns = _columns(_decoded(data).removeprefix("#"), SEPARATORS[content.table.style])
    # rotations were converted to counter-clockwise; the range applies to the list's own convention
    low, high = (-180.0, 180.0) if content.table.half_turns else (0.0, 360.0)
    turns = -content.rotation_deg if content.table.clockwise else content.rotation_deg
    if not ((turns >= low) & (turns <= high)).all():
        raise ReadbackError(f"a rotation is not from {low:g} to {high:g} deg, as this list has them")
    # float() also accepts exponents, underscores, blanks and a plus sign, which other readers refuse or read differently
    for number in (place for place, (_, of) in enumerate(content.table.columns) if of in ("x", "y", "rotation")):
        if not written_with("".join(columns[number]), _DIGITS):
            raise ReadbackError(f"a number of column {content.headers[number]} is not written with digits, '-' and '.' alone")
    return content


def read_bom(data: bytes, table: BomTable) -> list[dict[str, str]]:
    """Rows of a bill of materials, by the keys of the table's columns.

    Raises ReadbackError if it is not CSV, its header is not the table's, or a row has another number of cells.
    """
    lines = _plain_lines(_decoded(data))
    _refuse_header(lines[0], table.headers)
    return [dict(zip((content for _, content in table.columns), line, strict=True)) for line in lines[1:]]


def _decoded(data: bytes) -> str:
    try:
        return data.decode("ascii")
    except UnicodeDecodeError as error:
        raise ReadbackError(f"it is no text: {one_line(error)}") from error


def _refuse_header(found: Sequence[str], known: tuple[str, ...]) -> None:
    if tuple(found) != known:
        missing = [name for name in known if name not in found]
        what = f"column {', '.join(repr(name) for name in missing)} is missing; " if missing else ""
        raise ReadbackError(f"{what}its columns are {','.join(found)[:200]}, not {','.join(known)}")


def csv_lines(text: str, separator: str = ",") -> list[list[str]]:
    """Rows of a CSV text as cells, header first; ReadbackError if it is not CSV, or a row has another number of cells."""
    try:
        # newline="" leaves line ends to csv, which needs CR and LF inside quotes (RFC 4180)
        lines = list(csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=separator))
    except csv.Error as error:
        raise ReadbackError(f"it is no CSV: {one_line(error)}") from error
    if not lines:
        raise ReadbackError("it is empty")
    for number, line in enumerate(lines[1:], start=2):
        if len(line) != len(lines[0]):
            raise ReadbackError(f"row {number} has {len(line)} cells where the header has {len(lines[0])}")
    return lines


def _columns(text: str, separator: str) -> list[list[str]]:
    """Cells below the header, by column; the text must be as Python's csv module writes it, see `_plain_lines`."""
    plain = plain_columns(text, separator)
    columns = zip(*_plain_lines(text, separator), strict=True) if plain is None else plain
    return [list(column[1:]) for column in columns]


def _plain_lines(text: str, separator: str = ",") -> list[list[str]]:
    """As `csv_lines`, but refuses text that Python's csv module would write differently, such as with needless quotes."""
    lines, again = csv_lines(text, separator), io.StringIO(newline="")
    csv.writer(again, delimiter=separator, lineterminator="\r\n").writerows(lines)
    if again.getvalue() != text:
        raise ReadbackError("it has blank lines, needless quotes, or lines that do not end with CR LF")
    return lines
