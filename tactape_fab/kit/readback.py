"""Reads fabrication files back through gerbonara, software that is not ours, into plain arrays (board frame, mm)."""

from __future__ import annotations

import csv
import gc
import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import chain, pairwise
from operator import attrgetter
from typing import Any

import numpy as np

from tactape_fab.errors import TactapeError
from tactape_fab.profiles import FORMATS, BomTable, PlacementTable
from tactape_fab.texture.code import BoolArray
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.shapes import area_mm2

FURTHEST_MM = 1e5
_ARC_ERROR_MM = 1e-4
_ARC_MISFIT_MM = 1e-5
_CIRCLE_POINTS = 64
_STATEMENTS = {"TF", "TA", "TO", "TD", "FS", "MO", "LP", "AM", "AD"}


class ReadbackError(TactapeError):
    """A fabrication file that its reader does not accept."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GerberContent:
    """What a Gerber file draws.

    Attributes
    ----------
    flash_xy_mm : ndarray, shape (m, 2)
        Flashes in file order.
    flash_aperture : ndarray of int64, shape (m,)
        Index into `aperture_outlines_mm`.
    aperture_outlines_mm : tuple of ndarray, each (k, 2)
        Outline of each flashed aperture about its origin.
    aperture_functions : tuple of str
        .AperFunction of each flashed aperture, '' where the file has none.
    flash_component, flash_pin : tuple of str
        .P or .C reference of each flash and its pin, '' where the file has none.
    areas_mm : tuple of ndarray
        Regions as polygons.
    strokes_mm : tuple of ndarray, each (k, 2)
        Drawn lines and arcs as polylines, in file order, joined where one begins at the open end of the one before.
    stroke_width_mm : ndarray, shape (s,)
    clear : bool
        Whether any object is drawn in clear polarity.
    file_attributes : dict
        .FileFunction and so on, without the leading dot.
    """

    flash_xy_mm: FloatArray
    flash_aperture: IntArray
    aperture_outlines_mm: tuple[FloatArray, ...]
    aperture_functions: tuple[str, ...]
    flash_component: tuple[str, ...]
    flash_pin: tuple[str, ...]
    areas_mm: tuple[FloatArray, ...]
    strokes_mm: tuple[FloatArray, ...]
    stroke_width_mm: FloatArray
    clear: bool
    file_attributes: dict[str, tuple[str, ...]]


@contextmanager
def _collection_paused() -> Iterator[None]:
    """Parsing makes hundreds of thousands of objects and no cycles; the collector would look at them over and over."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@lru_cache(maxsize=8)
def read_gerber(data: bytes) -> GerberContent:
    """Read a Gerber file. Equal bytes are parsed once: the preview and the verification of a kit read the same files.

    Raises
    ------
    ReadbackError
        When gerbonara refuses the file, warns about it, or finds another unit than millimetres.
    """
    try:
        with _collection_paused(), warnings.catch_warnings():
            warnings.simplefilter("error")
            text = data.decode("ascii")
            _refuse_statements(text)
            content = _content(_parsed(text))
    except ReadbackError:
        raise
    except Exception as error:  # gerbonara raises whatever its parser meets
        raise ReadbackError(f"gerbonara cannot read it: {_one_line(error)}") from error
    shapes = (*content.areas_mm, *content.strokes_mm, *content.aperture_outlines_mm, content.flash_xy_mm)
    if not _is_on_earth(np.concatenate(shapes)):
        raise ReadbackError(f"it draws further out than {FURTHEST_MM:g} mm")
    if any(len(area) < 3 or area_mm2(area) == 0.0 for area in content.areas_mm):
        raise ReadbackError("a region of it has no area")
    return content


def _parsed(text: str) -> Any:
    """The file as gerbonara has it. Its parser tries one statement after the other: the most frequent ones come first."""
    from gerbonara.rs274x import GerberFile, GerberParser

    file = GerberFile()
    parser = GerberParser(file, override_settings=_remembering_settings()())
    known = dict(parser.STATEMENT_REGEXES)
    first = {name: known.pop(name) for name in ("coord", "attribute", "aperture") if name in known}
    parser.STATEMENT_REGEXES = {**first, **known}
    parser.parse(text)
    parser.graphics_state = None  # it knows the parser: without this ring all objects go as soon as they are done with
    return file


@cache
def _remembering_settings() -> Any:
    """A class of gerbonara's settings that remember the coordinates they have read: on a grid there are few different ones."""
    from gerbonara.cam import FileSettings

    class Remembering(FileSettings):  # type: ignore[misc]
        def __setattr__(self, name: str, value: object) -> None:
            super().__setattr__(name, value)
            self.__dict__["parse_gerber_value"] = lru_cache(maxsize=None)(super().parse_gerber_value)  # settings decide on it

    return Remembering


def _refuse_statements(text: str) -> None:
    """Refuse what gerbonara passes over in silence though a fab would draw by it."""
    foreign = sorted(set(re.findall(r"%([A-Z]{2})", text)) - _STATEMENTS)
    if foreign:
        raise ReadbackError(f"it holds %{foreign[0]}, which this tool never writes")
    found = re.finditer(r"(M0*[0-2])\*", text)
    ends = [end[1] for end in found if not text[max(0, end.start() - 1) : end.start()].strip("*% \t\r\n")]
    if ends != ["M02"] or not text.rstrip().endswith("M02*"):
        raise ReadbackError("its end, M02, does not stand once and last")


def _content(file: Any) -> GerberContent:
    from gerbonara.graphic_objects import Arc, Flash, Line, Region

    if any(unit is None or unit.shorthand != "mm" for unit in {id(o.unit): o.unit for o in file.objects}.values()):
        raise ReadbackError("it is not in millimetres")
    flashes = [o for o in file.objects if isinstance(o, Flash)]
    apertures = {id(o.aperture): o.aperture for o in flashes}
    index = {key: i for i, key in enumerate(apertures)}
    attributes = [o.attrs for o in flashes]
    strokes, widths = _join_strokes([o for o in file.objects if isinstance(o, Line | Arc)])
    return GerberContent(
        flash_xy_mm=_table(flashes, "x", "y"),
        flash_aperture=np.array([index[id(o.aperture)] for o in flashes], dtype=np.int64),
        aperture_outlines_mm=tuple(_aperture_outline(a) for a in apertures.values()),
        aperture_functions=tuple(",".join(dict(a.attrs or ()).get(".AperFunction", ())) for a in apertures.values()),
        flash_component=tuple([(a.get(".P") or a.get(".C") or ("",))[0] for a in attributes]),
        flash_pin=tuple([(*a.get(".P", ()), "", "")[1] for a in attributes]),
        areas_mm=tuple(np.array(o.outline, dtype=np.float64) for o in file.objects if isinstance(o, Region)),
        strokes_mm=strokes,
        stroke_width_mm=widths,
        clear=not all(map(attrgetter("polarity_dark"), file.objects)),
        file_attributes={key.lstrip("."): tuple(value) for key, value in file.file_attrs.items()},
    )


def _table(objects: list[Any], *names: str) -> FloatArray:
    """Numbers of many objects, a row each."""
    values = chain.from_iterable(map(attrgetter(*names), objects))
    return np.fromiter(values, dtype=np.float64, count=len(objects) * len(names)).reshape(-1, len(names))


def _is_on_earth(points_mm: FloatArray) -> bool:
    """Whether points can be places on a board: finite, and not absurdly far out."""
    return bool(np.isfinite(points_mm).all() and np.abs(points_mm).max(initial=0.0) <= FURTHEST_MM)


def _one_line(error: Exception) -> str:
    lines = str(error).splitlines()
    return (lines[0] if lines else type(error).__name__)[:200]


def _aperture_outline(aperture: Any) -> FloatArray:
    """Outline of an aperture about its origin."""
    from gerbonara.graphic_primitives import ArcPoly, Circle
    from gerbonara.utils import MM

    (shape,) = aperture.flash(0.0, 0.0, MM, True)
    if not shape.polarity_dark:
        raise ReadbackError("an aperture of it draws nothing: its exposure is off")
    if isinstance(shape, ArcPoly) and not any(shape.arc_centers or ()):
        outline = np.array(shape.outline, dtype=np.float64)
        outline = outline[:-1] if np.allclose(outline[0], outline[-1], atol=1e-9) else outline
        if len(outline) < 3 or area_mm2(outline) == 0.0:
            raise ReadbackError("a flashed aperture of it has no area")
        return outline
    if isinstance(shape, Circle):
        angle = np.linspace(0.0, 2 * np.pi, _CIRCLE_POINTS, endpoint=False)
        return np.asarray(shape.r * np.stack([np.cos(angle), np.sin(angle)], axis=1), dtype=np.float64)
    raise ReadbackError(f"aperture shape {type(shape).__name__} is none that this tool writes")


def _join_strokes(objects: list[Any]) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """Lines and arcs as polylines, joined where one begins at the open end of the one before with the same aperture."""
    from gerbonara.apertures import CircleAperture
    from gerbonara.graphic_objects import Arc

    if not objects:
        return (), np.empty(0)
    lines = [line for o in objects for line in (_chords(o) if isinstance(o, Arc) else [o])]
    used = {id(line.aperture): line.aperture for line in lines}
    if not all(isinstance(aperture, CircleAperture) for aperture in used.values()):
        raise ReadbackError("it draws lines with an aperture that is not round")
    aperture = np.array([id(line.aperture) for line in lines])
    ends = _table(lines, "x1", "y1", "x2", "y2")
    begins = np.ones(len(lines), dtype=bool)
    begins[1:] = (aperture[1:] != aperture[:-1]) | (ends[1:, :2] != ends[:-1, 2:]).any(axis=1)
    _split_closed(begins, ends)
    first = np.flatnonzero(begins)
    points = np.insert(ends[:, 2:], first, ends[first, :2], axis=0)
    cuts = [*(first + np.arange(len(first))).tolist(), len(points)]
    widths = [used[key].diameter for key in aperture[first].tolist()]
    return tuple(points[a:b] for a, b in pairwise(cuts)), np.array(widths, dtype=np.float64)


def _chords(arc: Any) -> list[Any]:
    """An arc as lines, which begin and end where it does."""
    if arc.numeric_error("mm") > _ARC_MISFIT_MM or arc.cx == arc.cy == 0.0:
        raise ReadbackError("an arc of it does not fit its centre")
    lines: list[Any] = arc.approximate(max_error=_ARC_ERROR_MM)
    lines[0].x1, lines[0].y1, lines[-1].x2, lines[-1].y2 = arc.x1, arc.y1, arc.x2, arc.y2
    return lines


def _split_closed(begins: BoolArray, ends: FloatArray) -> None:
    """Let a line that follows on a closed polyline begin another one."""
    first = np.flatnonzero(begins)
    run = np.cumsum(begins) - 1
    goes_on = ~np.append(begins[1:], True)
    suspects = np.unique(run[goes_on & (ends[:, 2:] == ends[first[run], :2]).all(axis=1)])
    for since, after in zip(first[suspects].tolist(), np.append(first[1:], len(begins))[suspects].tolist(), strict=True):
        start = since
        for i in range(since, after - 1):
            if i > start and (ends[i, 2:] == ends[start, :2]).all():
                start = i + 1
                begins[start] = True


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
        raise ReadbackError(f"gerbonara cannot read it: {_one_line(error)}") from error
    if not text.rstrip().endswith("\nM30"):
        raise ReadbackError("its end, M30, is missing")
    if re.search(r"TF\.FileFunction,(?!NonPlated,)", text):
        raise ReadbackError("it calls itself another file than one of unplated holes")
    if not all(isinstance(o, Flash) and o.unit is not None and o.unit.shorthand == "mm" for o in file.objects):
        raise ReadbackError("it holds other things than round holes in millimetres")
    holes = np.array([(o.x, o.y, o.aperture.diameter) for o in file.objects], dtype=np.float64).reshape(-1, 3)
    if not _is_on_earth(holes):
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
        raise ReadbackError(f"a coordinate or rotation is no number: {_one_line(error)}") from error
    if not (_is_on_earth(xy) and _is_on_earth(rotation)):
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
        raise ReadbackError(f"it is no text: {_one_line(error)}") from error


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
        raise ReadbackError(f"it is no CSV: {_one_line(error)}") from error
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
