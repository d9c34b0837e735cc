"""Reader of Gerber files by gerbonara, an independent library, into arrays (board frame, mm)."""

from __future__ import annotations

import gc
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import pairwise
from math import acos, hypot
from typing import Any

import numpy as np

from tactape_fab.base.errors import TactapeError
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray
from tactape_fab.texture.shapes import area_mm2

# 100 m: coordinates in nm stay far below 2**53, so that they are exact in float64
FURTHEST_MM = 1e5
ARC_ERROR_MM = 1e-4
_ARC_MISFIT_MM = 1e-5
_SPARE_CHORDS = 200_000
"""Most chords of a file's arcs, plus half as many as it has bytes. A quarter circle of radius 1 mm counts as 56."""
CIRCLE_POINTS = 64
# circle 1, vector lines 2 and 20, outline 4, rectangles 21 and 22, polygon 5, comment 0; without $ variables and arithmetic
_PLAIN = re.compile(r"\s*(?:(?:1|2|4|20|21|22),[-+.,\d\s]*|5,[01],\d{1,2},[-+.,\d\s]*|0\s[^*%]*)?")
"""Primitives of an aperture macro (Gerber 2024.05 section 4.5.1) whose number of corners is bounded by their bytes."""
# not among these are SR (step-and-repeat), which repeats a block any number of times, IF, which includes a file, and LM, LR and
# LS (mirror, rotate, scale), which gerbonara does not know
_STATEMENTS = {"TF", "TA", "TO", "TD", "FS", "MO", "LP", "AM", "AD"}


class ReadbackError(TactapeError):
    """A fabrication file that its reader does not accept."""


def is_on_earth(points_mm: FloatArray) -> bool:
    """Whether points are plausible board coordinates: finite and within `FURTHEST_MM`."""
    return bool(np.isfinite(points_mm).all() and np.abs(points_mm).max(initial=0.0) <= FURTHEST_MM)


def one_line(error: Exception) -> str:
    """The first line of an error's text, at most 200 characters."""
    lines = str(error).splitlines()
    return (lines[0] if lines else type(error).__name__)[:200]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GerberShapes:
    """The shapes of a Gerber file.

    flash_xy_mm (m, 2): Flashes in file order.
    flash_aperture (m,): Index into `aperture_outlines_mm`.
    aperture_outlines_mm each (k, 2): Outline of each flashed aperture about its origin.
    areas_mm: Regions as polygons.
    strokes_mm each (k, 2): Lines and arcs as polylines, in file order; a line that begins at the open end of the previous one
        continues its polyline.
    stroke_width_mm (s,)
    """

    flash_xy_mm: FloatArray
    flash_aperture: IntArray
    aperture_outlines_mm: tuple[FloatArray, ...]
    areas_mm: tuple[FloatArray, ...]
    strokes_mm: tuple[FloatArray, ...]
    stroke_width_mm: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GerberContent(GerberShapes):
    """Content of a Gerber file.

    aperture_functions: .AperFunction of each flashed aperture, '' if the file has none.
    flash_component, flash_pin: Component (of .P or .C) and pin (of .P) of each flash, '' if the file has none.
    clear: Whether any object is drawn in clear polarity.
    file_attributes: File attributes such as FileFunction, without the leading dot.
    """

    aperture_functions: tuple[str, ...]
    flash_component: tuple[str, ...]
    flash_pin: tuple[str, ...]
    clear: bool
    file_attributes: dict[str, tuple[str, ...]]


@lru_cache(maxsize=8)
def read_gerber(data: bytes) -> GerberContent:
    """Read a Gerber file. The result is cached, as the preview and the verification of a kit read the same bytes.

    Raises ReadbackError if gerbonara refuses the file, warns about it, or finds a unit other than millimetres.
    """
    try:
        with collection_paused(), warnings.catch_warnings():
            # another reader may interpret differently what gerbonara warns of, such as deprecated or ambiguous statements
            warnings.simplefilter("error")
            text = data.decode("ascii")
            # before parsing, as the parser expands repeated blocks and large polygons
            _refuse_statements(text)
            _refuse_costly_apertures(text)
            content = _content(*_drawn(text))
    except ReadbackError:
        raise
    except Exception as error:  # gerbonara raises exceptions of any type
        raise ReadbackError(f"gerbonara cannot read it: {one_line(error)}") from error
    shapes = (*content.areas_mm, *content.strokes_mm, *content.aperture_outlines_mm, content.flash_xy_mm)
    if not is_on_earth(np.concatenate(shapes)):
        raise ReadbackError(f"it draws further out than {FURTHEST_MM:g} mm")
    # readers differ in whether they draw a region without area
    if any(len(area) < 3 or area_mm2(area) == 0.0 for area in content.areas_mm):
        raise ReadbackError("a region of it has no area")
    return content


@contextmanager
def collection_paused() -> Iterator[None]:
    """Context manager that suspends the garbage collector: reading makes hundreds of thousands of objects and no cycles."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _drawn(text: str) -> tuple[_Drawn, Mapping[str, Sequence[str]]]:
    """Parse a file with gerbonara: its objects and file attributes.

    Its parser tries one kind of statement after the other; here the most frequent ones come first. That order is not a public
    setting of gerbonara, so pyproject.toml names the last version that was tried, and a test fails when it changes. With
    `GerberFile.from_string` the default kit's layers take 0.18 s instead of 0.15 s.
    """
    from gerbonara.rs274x import GerberFile, GerberParser

    drawn = _Drawn(_SPARE_CHORDS + len(text) // 2)
    file = GerberFile(objects=drawn)
    parser = GerberParser(file, override_settings=_remembering_settings()())
    known = dict(parser.STATEMENT_REGEXES)
    first = {name: known.pop(name) for name in ("coord", "attribute", "aperture") if name in known}
    parser.STATEMENT_REGEXES = {**first, **known}
    parser.parse(text)
    parser.graphics_state = None  # breaks a reference cycle, so that the memory is freed at once
    return drawn, file.file_attrs


class _Drawn:
    """Replacement for gerbonara's list of objects, which would take many times the memory of these arrays."""

    def __init__(self, most_chords: int) -> None:
        from gerbonara.graphic_objects import Arc, Flash, Line, Region

        self._kinds = Flash, Line, Arc, Region
        self._unit: Any = self  # unit of the last object; `self` equals none
        self.units: dict[int, Any] = {}
        self.clear = False
        self.misfit = False
        self.chords_left = float(most_chords)
        self.flashes_mm: list[float] = []
        self.flashed: list[Any] = []
        self.components: list[str] = []
        self.pins: list[str] = []
        self.lines_mm: list[float] = []
        self.drawn_with: list[Any] = []
        self.areas: list[Any] = []

    def append(self, thing: Any) -> None:
        """Called by gerbonara's parser for each object."""
        flash, line, arc, region = self._kinds
        # a file has one unit and hundreds of thousands of objects, so a unit is checked only when it changes
        if thing.unit is not self._unit:
            self._unit = self.units[id(thing.unit)] = thing.unit
        if not thing.polarity_dark:
            self.clear = True
        kind = type(thing)
        if kind is flash:
            # .P has component and pin (copper pads), .C only the component (component layer)
            pin = thing.attrs.get(".P", ())
            self.flashes_mm += (thing.x, thing.y)
            self.flashed.append(thing.aperture)
            self.components.append((pin or thing.attrs.get(".C") or ("",))[0])
            self.pins.append(pin[1] if len(pin) > 1 else "")
        elif kind is line:
            self.lines_mm += (thing.x1, thing.y1, thing.x2, thing.y2)
            self.drawn_with.append(thing.aperture)
        elif kind is arc:
            # numeric_error: difference of the radii at the start and end
            # points; a centre at the start point is invalid
            self.misfit = self.misfit or thing.numeric_error("mm") > _ARC_MISFIT_MM or thing.cx == thing.cy == 0.0
            if self.misfit:
                return
            # a chord with error e subtends 2 acos(1 - e / r) of a circle of radius r; gerbonara's `approximate` uses half of that
            # angle, and so twice as many chords
            self.chords_left -= thing.sweep_angle() / (2 * acos(max(0.0, 1 - ARC_ERROR_MM / hypot(thing.cx, thing.cy))))
            if not self.chords_left > 0:
                raise ReadbackError("its arcs are longer than those of any board")
            for chord in _chords(thing):
                self.append(chord)
        elif kind is region:
            self.areas.append(thing)


@cache
def _remembering_settings() -> Any:
    """Subclass of gerbonara's FileSettings that caches parsed coordinates, of which a grid has few different ones."""
    from gerbonara.cam import FileSettings

    class Remembering(FileSettings):  # type: ignore[misc]
        def __setattr__(self, name: str, value: object) -> None:
            super().__setattr__(name, value)
            # set in the instance, as the parser calls it for each coordinate;
            # any changed setting, such as the unit, starts a new cache
            self.__dict__["parse_gerber_value"] = lru_cache(maxsize=None)(super().parse_gerber_value)  # depends on the settings

    return Remembering


def _refuse_costly_apertures(text: str) -> None:
    """Refuse apertures whose few bytes may expand to any number of corners; this tool writes none."""
    # a polygon aperture (P) may have at most two digits, 99 corners
    for corners in re.findall(r"AD[^*%]*P,[^*%X]*X([^*%X]*)", text):
        if not (corners.isdecimal() and len(corners) < 3):
            raise ReadbackError("it has a polygon of more corners than this tool writes")
    for body in re.findall(r"%AM[^*%]*\*([^%]*)", text):
        if not all(_PLAIN.fullmatch(block) for block in body.split("*")):
            raise ReadbackError("it has a macro that computes, or that draws more than its text says")


def _refuse_statements(text: str) -> None:
    """Refuse statements that change what a fab draws but that gerbonara silently ignores."""
    # the two letters after a per cent sign are the code of an extended command
    foreign = sorted(set(re.findall(r"%([A-Z]{2})", text)) - _STATEMENTS)
    if foreign:
        raise ReadbackError(f"it holds %{foreign[0]}, which this tool never writes")
    found = re.finditer(r"(M0*[0-2])\*", text)
    # M02 counts only at the beginning of a word, as an attribute's text may contain it
    ends = [end[1] for end in found if not text[max(0, end.start() - 1) : end.start()].strip("*% \t\r\n")]
    if ends != ["M02"] or not text.rstrip().endswith("M02*"):
        raise ReadbackError("its end, M02, does not stand once and last")


def _content(drawn: _Drawn, attributes: Mapping[str, Sequence[str]]) -> GerberContent:
    if any(unit is None or unit.shorthand != "mm" for unit in drawn.units.values()):
        raise ReadbackError("it is not in millimetres")
    if drawn.misfit:
        raise ReadbackError("an arc of it does not fit its centre")
    # apertures are distinguished by identity, so that two definitions of one shape remain two, as in the file
    apertures = {id(aperture): aperture for aperture in drawn.flashed}
    index = {key: i for i, key in enumerate(apertures)}
    strokes, widths = joined_strokes(
        np.array(drawn.lines_mm, dtype=np.float64).reshape(-1, 4),
        np.array([id(aperture) for aperture in drawn.drawn_with], dtype=np.int64),
        _diameters_mm(drawn.drawn_with),
    )
    return GerberContent(
        flash_xy_mm=np.array(drawn.flashes_mm, dtype=np.float64).reshape(-1, 2),
        flash_aperture=np.array([index[id(aperture)] for aperture in drawn.flashed], dtype=np.int64),
        aperture_outlines_mm=tuple(_aperture_outline(a) for a in apertures.values()),
        aperture_functions=tuple(",".join(dict(a.attrs or ()).get(".AperFunction", ())) for a in apertures.values()),
        flash_component=tuple(drawn.components),
        flash_pin=tuple(drawn.pins),
        areas_mm=tuple(np.array(area.outline, dtype=np.float64) for area in drawn.areas),
        strokes_mm=strokes,
        stroke_width_mm=widths,
        clear=drawn.clear,
        file_attributes={key.lstrip("."): tuple(value) for key, value in attributes.items()},
    )


def _aperture_outline(aperture: Any) -> FloatArray:
    """Outline of an aperture about its origin."""
    from gerbonara.graphic_primitives import ArcPoly, Circle
    from gerbonara.utils import MM

    # unpacking refuses a macro of several primitives, which this tool does not write
    (shape,) = aperture.flash(0.0, 0.0, MM, True)
    if not shape.polarity_dark:
        raise ReadbackError("an aperture of it draws nothing: its exposure is off")
    if isinstance(shape, ArcPoly) and not any(shape.arc_centers or ()):
        outline = np.array(shape.outline, dtype=np.float64)
        # an outline primitive repeats its first vertex (4.5.1.6); here polygons are not closed
        outline = outline[:-1] if np.allclose(outline[0], outline[-1], atol=1e-9) else outline
        if len(outline) < 3 or area_mm2(outline) == 0.0:
            raise ReadbackError("a flashed aperture of it has no area")
        return outline
    if isinstance(shape, Circle):
        angle = np.linspace(0.0, 2 * np.pi, CIRCLE_POINTS, endpoint=False)
        return np.asarray(shape.r * np.stack([np.cos(angle), np.sin(angle)], axis=1), dtype=np.float64)
    raise ReadbackError(f"aperture shape {type(shape).__name__} is none that this tool writes")


def _diameters_mm(apertures: Sequence[Any]) -> dict[int, float]:
    """Diameter of each aperture that draws lines, by its identity."""
    from gerbonara.apertures import CircleAperture

    used = {id(aperture): aperture for aperture in apertures}
    if not all(isinstance(aperture, CircleAperture) for aperture in used.values()):
        raise ReadbackError("it draws lines with an aperture that is not round")
    return {key: aperture.diameter for key, aperture in used.items()}


def joined_strokes(
    ends: FloatArray, apertures: IntArray, diameters_mm: Mapping[int, float]
) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """Join lines to polylines: a line continues the previous one if it begins at its open end with the same aperture.

    ends (n, 4): x and y of the start and of the end of each line, mm.
    apertures (n,): Key of each line's aperture in `diameters_mm`.
    Returns each (k, 2).
    """
    if not len(ends):
        return (), np.empty(0)
    # compared exactly, as a continued line begins with the same text at which the previous one ended
    begins = np.ones(len(ends), dtype=bool)
    begins[1:] = (apertures[1:] != apertures[:-1]) | (ends[1:, :2] != ends[:-1, 2:]).any(axis=1)
    _split_closed(begins, ends)
    first = np.flatnonzero(begins)
    # each run of k lines has k + 1 points: its first start, and all ends
    points = np.insert(ends[:, 2:], first, ends[first, :2], axis=0)
    # np.insert has shifted the k-th run by k points
    cuts = [*(first + np.arange(len(first))).tolist(), len(points)]
    widths = [diameters_mm[key] for key in apertures[first].tolist()]
    return tuple(points[a:b] for a, b in pairwise(cuts)), np.array(widths, dtype=np.float64)


def _chords(arc: Any) -> list[Any]:
    """An arc as chords with exactly the same end points."""
    # both ends as written: computed ones would be off by rounding, and the outline would not close
    lines: list[Any] = arc.approximate(max_error=ARC_ERROR_MM)
    lines[0].x1, lines[0].y1, lines[-1].x2, lines[-1].y2 = arc.x1, arc.y1, arc.x2, arc.y2
    return lines


def _split_closed(begins: BoolArray, ends: FloatArray) -> None:
    """Start a new polyline for a line that continues from a closed one."""
    first = np.flatnonzero(begins)
    run = np.cumsum(begins) - 1
    goes_on = ~np.append(begins[1:], True)
    # only the few runs that return to their start and continue, so that the loop in Python is short
    suspects = sorted({*run[goes_on & (ends[:, 2:] == ends[first[run], :2]).all(axis=1)].tolist()})
    for since, after in zip(first[suspects].tolist(), np.append(first[1:], len(begins))[suspects].tolist(), strict=True):
        start = since
        for i in range(since, after - 1):
            if i > start and (ends[i, 2:] == ends[start, :2]).all():
                start = i + 1
                begins[start] = True
