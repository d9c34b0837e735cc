"""Reader of Gerber files in exactly the form that this tool writes, by numpy; any other form is refused.

Gerber has several ways to express the same thing, and readers differ in the rare ones: incremental coordinates, redefined
apertures, attributes inside statements, a second header. Files of a kit have none of these: each line is one of the few kinds
below, in the writer's order (Gerber 2024.05). Pictures of a kit are drawn from this reader, which takes a twentieth of
gerbonara's time; `verify` reads each file with both, and compares.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from math import asin, atan2, ceil, cos, hypot, pi, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base.fields import shown
from tactape_fab.kit.read.gerber_file import ARC_ERROR_MM, CIRCLE_POINTS, GerberShapes, joined_strokes, read_gerber
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

# absolute coordinates with 4 and 6 digits, millimetres, dark polarity, multi-quadrant arcs, linear interpolation
_SETTINGS = (b"%FSLAX46Y46*%", b"%MOMM*%", b"%LPD*%", b"G75*", b"G01*")
# twelve digits of nm, a kilometre, fit in int64
_NUMBER = rb"-?\d{1,12}"
_DECIMAL = rb"-?\d{1,4}\.\d{6}"
# TF, TA, TO with a name, which begins with a dot if it is a standard one; TD alone or with the name that it deletes
_CONTENT = rb"T(?:[FAO]\.?[A-Za-z][^*%\x00-\x1f]{0,400}|D(?:\.[A-Z][A-Za-z]{0,20})?)"
_ATTRIBUTE = re.compile(rb"^(?:%%%b\*%%|G04 #@! %b\*)$" % (_CONTENT, _CONTENT), re.MULTILINE)
_FILE_ATTRIBUTE = re.compile(rb"^(?:%|G04 #@! )TF([^,*\n]*)", re.MULTILINE)
_FILE_ATTRIBUTES = [
    *(b".GenerationSoftware", b".CreationDate", b".ProjectId", b".SameCoordinates"),
    *(b".Part", b".FileFunction", b".FilePolarity"),
]
"""File attributes of the header in the writer's order; readers differ in which one of two equal ones they use."""
_POINT = re.compile(rb"^X(%b)Y(%b)(I%bJ%b)?D0([123])\*$" % ((_NUMBER,) * 4), re.MULTILINE)
_PLAIN_POINT = re.compile(rb"X%bY%bD0[123]\*\n" % (_NUMBER, _NUMBER))
_LETTERS_OF_POINTS = bytes.maketrans(b"XYD*", b"    ")
_SELECT = re.compile(rb"^D(\d{2,4})\*$", re.MULTILINE)
_APERTURE = re.compile(rb"%ADD(\d{2,4})(?:(C),(\d{1,4}\.\d{6})|(P),(\d{1,4}\.\d{6})X4X0\.000000|([A-Z]{1,20}))\*%")
_MACRO = re.compile(rb"%AM([A-Z]{1,20})\*")
_OUTLINE = re.compile(rb"4,1,(\d{1,5}),")
_VERTEX = re.compile(rb"(%b),(%b)," % (_DECIMAL, _DECIMAL))
_PIECE_LINES = 50_000
"""Lines whose coordinates are parsed at once, which bounds the memory."""
_MOST_ARCS = 100
_SECOND_PART, _BEGINNING_BYTES = b"%TO.C,R2*%", 1 << 16
_NONE = -1
_FOREIGN = "is none that the writer writes there"


class FormError(Exception):
    """A line that the writer would not write there."""


@dataclass(slots=True, kw_only=True)
class Drawn:
    """The shapes of a Gerber file's statements, nm, in file order.

    ``apertures`` maps numbers to shapes: M with an outline, C or P with a diameter, in mm. ``flashes`` has x, y and aperture;
    ``lines`` start, end and aperture of each straight line outside regions; ``arcs`` the same for each arc, with its centre
    relative to the start and the number of lines before it; ``regions`` the vertices of each.
    """

    apertures: dict[int, tuple[str, tuple[float, ...]]] = field(default_factory=dict)
    flashes: IntArray = field(default_factory=lambda: np.empty((0, 3), dtype=np.int64))
    lines: IntArray = field(default_factory=lambda: np.empty((0, 5), dtype=np.int64))
    arcs: list[tuple[int, ...]] = field(default_factory=list)
    regions: list[IntArray] = field(default_factory=list)


def read_shapes(data: bytes) -> GerberShapes:
    """The shapes of a Gerber file, by `gerber_file.read_gerber` if the file is in another form than the writer's.

    Raises ReadbackError if neither reads it.
    """
    try:
        return written_shapes(data)
    except FormError:
        return read_gerber(data)


@lru_cache(maxsize=8)
def written_shapes(data: bytes) -> GerberShapes:
    """The shapes of a Gerber file in the writer's form. The result is cached for preview, report and verification.

    Raises FormError at a line that the writer would not write there, or if it has more arcs than an outline.
    """
    drawn = read_written(data)
    if len(drawn.arcs) > _MOST_ARCS:
        raise FormError("it has more arcs than an outline")
    used, index = in_order_of_use(drawn.flashes[:, 2])
    ends, number = drawn.lines[:, :4] / 1e6, drawn.lines[:, 4]
    # from the last one on, as an insertion does not shift the places of earlier arcs
    for *arc, aperture, before in reversed(drawn.arcs):
        chords = _chords(*(value / 1e6 for value in arc))
        ends, number = np.insert(ends, before, chords, axis=0), np.insert(number, before, np.full(len(chords), aperture))
    strokes, width_mm = joined_strokes(ends, number, {n: values[0] for n, (_, values) in drawn.apertures.items()})
    return GerberShapes(
        flash_xy_mm=drawn.flashes[:, :2] / 1e6,
        flash_aperture=index,
        aperture_outlines_mm=tuple(_outline(*drawn.apertures[number]) for number in used),
        areas_mm=tuple(np.concatenate([region, region[:1]]) / 1e6 for region in drawn.regions),
        strokes_mm=strokes,
        stroke_width_mm=width_mm,
    )


def first_body_mm(components: bytes) -> tuple[float, float]:
    """Length and width of the first part's body, mm, from a component layer; other parts are not read."""
    second = components.find(_SECOND_PART)
    corners = read_shapes(components[: second if second >= 0 else None] + b"M02*\n").strokes_mm[0][:4]
    # two adjacent sides of the outline are the body's length and width
    sides = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    return max(sides[0], sides[1]), min(sides[0], sides[1])


def first_part(path: Path) -> bytes:
    """The beginning of a component layer, with at least its first part."""
    # 64 kB suffice for the header and one part, as texts of a profile have at most 200 characters
    with path.open("rb") as stream:
        begun = stream.read(_BEGINNING_BYTES)
        return begun if _SECOND_PART in begun else begun + stream.read()


def in_order_of_use(numbers: IntArray) -> tuple[list[int], IntArray]:
    """The distinct numbers in the order of their first occurrence, and the index of each number among them."""
    values, first, inverse = np.unique(numbers, return_index=True, return_inverse=True)
    # np.unique sorts by value, so its indices are ranked by first occurrence
    order = np.argsort(first)
    return values[order].tolist(), np.argsort(order)[inverse.reshape(-1)]


def _outline(kind: str, values: tuple[float, ...]) -> FloatArray:
    """Outline of an aperture about its origin, mm."""
    if kind == "M":
        return np.array(values).reshape(-1, 2)
    # the first vertex is on the x axis, as of P with 4 corners and no rotation
    angle = np.linspace(0.0, 2 * np.pi, CIRCLE_POINTS if kind == "C" else 4, endpoint=False)
    return np.asarray(values[0] / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1), dtype=np.float64)


def _chords(x: float, y: float, x_end: float, y_end: float, i: float, j: float) -> FloatArray:
    """Chords of a counter-clockwise arc about (x + i, y + j), as many as gerbonara uses; shape (n, 4), mm."""
    r = hypot(i, j)
    # gerbonara bounds the error by r (1 - sqrt(1 - sqrt(1/2))), so that no arc becomes less than a square
    error = min(ARC_ERROR_MM, r * 0.4588038998538031)
    # counter-clockwise, G03; equal start and end points mean a full circle in multi-quadrant mode, G75
    sweep = (atan2(y_end - y - j, x_end - x - i) - atan2(-j, -i)) % (2 * pi) or 2 * pi
    # asin(sqrt(r^2 - (r - e)^2) / r) = acos(1 - e / r) is half the angle of a chord with error e. gerbonara uses it as the whole
    # angle, so that its chords err by a quarter of e; here the same number of chords gives the same polylines
    count = ceil(sweep / asin(sqrt(r**2 - (r - error) ** 2) / r))
    turns = [k * sweep / count for k in range(count + 1)]
    # (i, j) is the vector from start to centre; a point is the start rotated about the centre by t
    points = np.array([(x + i - i * cos(t) + j * sin(t), y + j - i * sin(t) - j * cos(t)) for t in turns])
    points[[0, -1]] = (x, y), (x_end, y_end)
    return np.concatenate([points[:-1], points[1:]], axis=1)


def read_written(data: bytes) -> Drawn:
    """Read a Gerber file in the writer's form. Raises FormError at a line that the writer would not write there."""
    if not data.isascii():
        raise FormError("it is not ASCII")
    if not data.endswith(b"\n") or b"\r" in data:
        raise FormError("its lines do not all end with a line feed")
    return _Reader(data).read()


class _Reader:
    """The lines of a Gerber file, and the graphics state after each line that is neither point nor attribute."""

    def __init__(self, data: bytes) -> None:
        self.data, self.drawn = data, Drawn()
        self.text = text = np.frombuffer(data, dtype=np.uint8)
        self.ends = np.flatnonzero(text == ord("\n"))
        self.begins = np.concatenate([[0], self.ends[:-1] + 1])
        # clipped to the last byte for a last line of one byte
        first, second = text[self.begins], text[np.minimum(self.begins + 1, len(text) - 1)]
        third = text[np.minimum(self.begins + 2, len(text) - 1)]
        # %T and G04: nothing else begins with these characters in the writer's files
        self.is_attribute = ((first == ord("%")) & (second == ord("T"))) | (
            (first == ord("G")) & (second == ord("0")) & (third == ord("4"))
        )
        self.is_point, self.is_select = first == ord("X"), first == ord("D")
        self.macros: dict[bytes, tuple[float, ...]] = {}
        self.pen: tuple[int, int] | None = None
        self.in_region = self.arc = False
        self.flashes: list[IntArray] = []
        self.lines: list[IntArray] = []
        self.line_count = 0

    def line(self, number: int) -> bytes:
        return self.data[self.begins[number] : self.ends[number]]

    def _lines_where(self, chosen: BoolArray) -> bytes:
        """The chosen lines with their line feeds, concatenated."""
        return self.text[np.repeat(chosen, self.ends - self.begins + 1)].tobytes()

    def fail(self, number: int, why: str) -> FormError:
        return FormError(f"line {number + 1}, {shown(self.line(number).decode('ascii'))}, {why}")

    def read(self) -> Drawn:
        # the header consists of the attributes before the first other line
        start = int(np.argmin(self.is_attribute))
        if tuple(map(self.line, range(start, min(start + len(_SETTINGS), len(self.ends))))) != _SETTINGS:
            raise FormError(f"line {start + 1} does not begin the writer's settings, {b' '.join(_SETTINGS).decode()}")
        self._attributes(start)
        first, last = start + len(_SETTINGS), len(self.ends) - 1
        if self.line(last) != b"M02*" or last < first:
            raise FormError("its end, M02, does not stand once and last")
        self._points()
        others = np.flatnonzero(~(self.is_attribute | self.is_point | self.is_select))
        others = others[(others >= first) & (others < last)]
        # an aperture may be selected only after its definition
        defined = np.array([i for i in others.tolist() if self.line(i).startswith(b"%ADD")], dtype=np.int64)
        self._select(defined)
        at = first
        for i in others.tolist():
            if i >= at:  # further lines of a macro were read with its first one
                # the point lines between two state lines are drawn at once, as arrays
                self._run(at, i)
                at = self._state(i) + 1
        self._run(at, last)
        if self.in_region:
            raise FormError("its last region does not end")
        if self.flashes:
            self.drawn.flashes = np.concatenate(self.flashes)
        if self.lines:
            self.drawn.lines = np.concatenate(self.lines)
        return self.drawn

    def _attributes(self, start: int) -> None:
        """Refuse invalid attributes, a mixture of both notations, and file attributes other than the header's and a signature."""
        if _ATTRIBUTE.sub(b"", self._lines_where(self.is_attribute)).strip(b"\n"):
            # the wrong line is needed for the message only
            right = np.searchsorted(self.begins, [found.start() for found in _ATTRIBUTE.finditer(self.data)])
            raise self.fail(int(np.setdiff1d(np.flatnonzero(self.is_attribute), right)[0]), _FOREIGN)
        # first bytes of all attribute lines: '%' or 'G'
        if len(set(self.text[self.begins[self.is_attribute]].tobytes())) > 1:
            raise FormError("its attributes are written in two ways, as statements and as comments")
        found = [(match.start(), match[1]) for match in _FILE_ATTRIBUTE.finditer(self.data)]
        # .MD5 is the last line but one, before M02 (5.6.9), and not part of the header
        if found and len(self.begins) > 1 and found[-1] == (self.begins[-2], b".MD5"):
            found.pop()
        header = [name for _, name in found]
        if len(found) != start or header != [name for name in _FILE_ATTRIBUTES if name in set(header)]:
            raise FormError("its file attributes are not those of the writer's header, each once and in order")

    def _points(self) -> None:
        """Parse all points: their lines, x, y and operation, and the centres of arcs."""
        self.point_lines = np.flatnonzero(self.is_point)
        self.centres: dict[int, tuple[int, int]] = {}
        points = self._lines_where(self.is_point)
        # if all lines match, letters are replaced by blanks, and one call reads all numbers
        if not _PLAIN_POINT.sub(b"", points):  # no arcs
            values = np.fromstring(points.translate(_LETTERS_OF_POINTS), dtype=np.int64, sep=" ").reshape(-1, 3)
            self.xy, self.operation = values[:, :2], values[:, 2]
            return
        # columns: x, y in nm, and the operation, 1 draw, 2 move, 3 flash
        values = np.empty((len(self.point_lines), 3), dtype=np.int64)
        done = 0
        for a in range(0, len(self.ends), _PIECE_LINES):
            b = min(a + _PIECE_LINES, len(self.ends))
            piece = self.data[self.begins[a] : self.ends[b - 1] + 1]
            rows = _POINT.findall(piece)
            wanted = np.flatnonzero(self.is_point[a:b]) + a
            # findall skips lines that do not match; a set difference finds the first of them
            if len(rows) != len(wanted):
                right = {a + piece.count(b"\n", 0, found.start()) for found in _POINT.finditer(piece)}
                raise self.fail(min(set(wanted.tolist()) - right), _FOREIGN)
            if rows:
                x, y, centres, operation = zip(*rows, strict=True)
                for place, column in enumerate((x, y, operation)):
                    values[done : done + len(rows), place] = list(map(int, column))
                if any(centres):
                    for i, centre in zip(wanted.tolist(), centres, strict=True):
                        if centre:
                            left, right_of = centre[1:].split(b"J")
                            self.centres[i] = int(left), int(right_of)
            done += len(rows)
        self.xy, self.operation = values[:, :2], values[:, 2]

    def _select(self, defined: IntArray) -> None:
        """Find the aperture selected at each point; apertures are defined in the lines `defined` and numbered from 10 on."""
        lines = np.flatnonzero(self.is_select)
        found = _SELECT.findall(self._lines_where(self.is_select))
        if len(found) != len(lines):
            wrong = next(i for i in lines.tolist() if not _SELECT.fullmatch(self.line(i)))
            raise self.fail(wrong, _FOREIGN)
        numbers = np.array(list(map(int, found)), dtype=np.int64)
        # numbers have no gaps, so k definitions above a line allow 10 to 9 + k
        unknown = (numbers < 10) | (numbers >= 10 + np.searchsorted(defined, lines))
        if unknown.any():
            raise self.fail(int(lines[np.argmax(unknown)]), "takes an aperture that is not defined")
        self.select_lines = lines
        # the last select before each point; the index -1, for none, gives the appended _NONE
        last = np.searchsorted(lines, self.point_lines) - 1
        self.aperture = np.where(last >= 0, np.append(numbers, _NONE)[last], _NONE)

    def _run(self, begin: int, end: int) -> None:
        """Draw the points of these lines, between which only the selected aperture changes."""
        p, q = np.searchsorted(self.point_lines, (begin, end)).tolist()
        # an aperture has no effect inside a region, and the writer selects none there
        if self.in_region and np.diff(np.searchsorted(self.select_lines, (begin, end)))[0]:
            raise self.fail(begin, "begins the lines of a region in which an aperture is taken")
        if p == q:
            return
        xy, operation, aperture = self.xy[p:q], self.operation[p:q], self.aperture[p:q]
        centred = np.isin(self.point_lines[p:q], list(self.centres)) if self.centres else np.zeros(q - p, dtype=bool)
        draws = operation == 1
        self._refuse(p, centred & ~draws, "is no move or flash")
        if self.in_region:
            # the first point moves (D02), all others draw (D01): one contour, without arcs
            wrong = (operation == 3) | centred | (draws == (np.arange(q - p) == 0))
            self._refuse(p, wrong, "does not draw the one contour of a region")
            self.drawn.regions.append(xy)
            self.pen = xy[-1, 0].item(), xy[-1, 1].item()
            return
        flashed = operation == 3
        self._refuse(p, flashed & ((aperture == _NONE) | self.arc), "cannot flash here")
        self.flashes.append(np.column_stack([xy, aperture])[flashed])
        moved = np.flatnonzero(~flashed)
        if not len(moved):
            self.pen = None
            return
        # each draw starts at the previous point that moved or drew. A flash sets the current point as well, but the writer always
        # moves after one, so a draw there is refused
        flash_before = np.concatenate([[False], flashed[:-1]])[moved]
        before = np.concatenate([[self.pen or (0, 0)], xy[moved[:-1]]])
        drawn = draws[moved]
        # in arc mode every draw has a centre, in linear mode none has
        wrong = drawn & ((aperture[moved] == _NONE) | (centred[moved] != self.arc))
        # the first draw needs a current point
        wrong[0] |= drawn[0] and self.pen is None
        wrong |= drawn & flash_before
        self._refuse(p, np.isin(np.arange(q - p), moved[wrong]), "cannot draw here")
        self.pen = None if flashed[-1] else (xy[moved[-1], 0].item(), xy[moved[-1], 1].item())
        rows = np.column_stack([before, xy[moved], aperture[moved]])[drawn]
        # arcs are stored with the number of lines before them, by which they are inserted among these
        if self.arc:
            for row, i in zip(rows.tolist(), self.point_lines[p:q][moved][drawn].tolist(), strict=True):
                self.drawn.arcs.append((*row[:4], *self.centres[i], row[4], self.line_count))
            return
        for number in sorted(set(rows[:, 4].tolist())):
            if self.drawn.apertures[number][0] != "C":
                self._refuse(p, draws & (aperture == number), "draws with an aperture that is not round")
        self.lines.append(rows)
        self.line_count += len(rows)

    def _refuse(self, p: int, wrong: BoolArray, why: str) -> None:
        if wrong.any():
            raise self.fail(int(self.point_lines[p + np.argmax(wrong)]), why)

    def _state(self, i: int) -> int:
        """Apply a line that is neither point nor attribute; returns the last line that belongs to it."""
        line = self.line(i)
        if (aperture := _APERTURE.fullmatch(line)) is not None:
            self._define(i, aperture)
        elif (macro := _MACRO.fullmatch(line)) is not None and macro[1] not in self.macros:
            end, self.macros[macro[1]] = self._vertices(i)
            return end
        # the two interpolation modes alternate
        elif line in (b"G03*", b"G01*") and self.arc is (line == b"G01*") and not self.in_region:
            self.arc = not self.arc
        elif line == b"G36*" and not self.in_region and not self.arc:
            self.in_region, self.pen = True, None
        elif line == b"G37*" and self.in_region and self.pen is not None and self._closes():
            self.in_region, self.pen = False, None
        else:
            raise self.fail(i, _FOREIGN)
        return i

    def _closes(self) -> bool:
        """Whether the region ends at its first vertex, whose repetition is then dropped."""
        region = self.drawn.regions[-1]
        closed = bool((region[0] == region[-1]).all())
        self.drawn.regions[-1] = region[:-1]
        return closed

    def _define(self, i: int, found: re.Match[Any]) -> None:
        number, name = int(found[1]), found[6]
        if number != 10 + len(self.drawn.apertures) or (name is not None and name not in self.macros):
            raise self.fail(i, "defines an aperture out of its order, or again, or of an unknown shape")
        shape = found[2] or found[4] or b"M"
        self.drawn.apertures[number] = (shape.decode(), self.macros[name] if name else (float(found[3] or found[5]),))

    def _vertices(self, i: int) -> tuple[int, tuple[float, ...]]:
        """Last line and vertices of the outline macro that begins in this line; the last vertex repeats the first."""
        outline = _OUTLINE.fullmatch(self.line(i + 1))
        count = int(outline[1]) + 1 if outline is not None else 0
        end = i + 2 + count
        texts: Sequence[bytes] = [self.line(k) for k in range(i + 2, end)] if end < len(self.ends) else ()
        found = [_VERTEX.fullmatch(text) for text in texts]
        points = [(float(v[1]), float(v[2])) for v in found if v is not None]
        # k vertices and the first once more: a triangle has four points
        if count < 4 or len(points) < count or points[0] != points[-1] or self.line(end) != b"0*%":
            raise self.fail(i, "is no outline macro of the writer's")
        return end, tuple(value for point in points[:-1] for value in point)
