"""Form of Gerber and drill files: the writer's own grammar and nothing else, and what they draw read by it a second time.

A Gerber file may say the same thing in several ways, and readers differ in the rare ones: incremental coordinates, apertures that
are defined again, attributes inside of statements, a second header. A file of a kit holds none of them: each line is one of the
few kinds below, in the one order that the writer has (Gerber 2024.05; XNC 2021.11).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import shown
from tactape_fab.kit.read.gerber_file import GerberContent
from tactape_fab.verify.files import WrittenFile, named

_NAME = "written form"
_SAME_MM = 2e-6
"""Largest difference between two readings of one coordinate: gerbonara's are sums of floats."""
_SETTINGS = ("%FSLAX46Y46*%", "%MOMM*%", "%LPD*%", "G75*", "G01*")
_NUMBER = r"-?\d{1,12}"
_DECIMAL = r"-?\d{1,4}\.\d{6}"
_CONTENT = r"T(?:[FAO]\.?[A-Za-z][^*%\x00-\x1f]{0,400}|D(?:\.[A-Z][A-Za-z]{0,20})?)"
_ATTRIBUTE = re.compile(rf"%{_CONTENT}\*%|G04 #@! {_CONTENT}\*")
_FILE_ATTRIBUTE = re.compile(r"(?:%|G04 #@! )TF([^,*]*)")
_FILE_ATTRIBUTES = tuple(
    f".{name}"
    for name in ("GenerationSoftware", "CreationDate", "ProjectId", "SameCoordinates", "Part", "FileFunction", "FilePolarity")
)
"""Those of a header, in the writer's order; readers differ in which one of two they believe."""
_FUNCTION = re.compile(rb"(?<=TA)[^*%]*")
_FUNCTIONS = {
    "copper-top": {b".AperFunction,SMDPad,CuDef", b".AperFunction,Conductor", b".AperFunction,FiducialPad,Global"},
    "profile": {b".AperFunction,Profile"},
    "components-top": {
        *(b".AperFunction,ComponentMain", b".AperFunction,ComponentOutline,Body", b".AperFunction,ComponentPin"),
    },
}
_OTHER_FUNCTIONS = {b".AperFunction,Material"}
_POINT = re.compile(rf"X({_NUMBER})Y({_NUMBER})(I{_NUMBER}J{_NUMBER})?D0([123])\*")
_SELECT = re.compile(r"D(\d{2,4})\*")
_APERTURE = re.compile(r"%ADD(\d{2,4})(?:(C),(\d{1,4}\.\d{6})|(P),(\d{1,4}\.\d{6})X4X0\.000000|([A-Z]{1,20}))\*%")
_MACRO = re.compile(r"%AM([A-Z]{1,20})\*")
_OUTLINE = re.compile(r"4,1,(\d{1,5}),")
_VERTEX = re.compile(rf"({_DECIMAL}),({_DECIMAL}),")
_DRILL = re.compile(
    r"M48\n"
    r"(?:; #@! TF\.(?:GenerationSoftware|CreationDate|SameCoordinates),[^\x00-\x1f]{0,300}\n){3}"
    r"; #@! TF\.Part,(?:Single|Array)\n"
    r"; #@! TF\.FileFunction,NonPlated,1,1,NPTH\n"
    r"METRIC\n"
    r"(?:; #@! TA\.AperFunction,MechanicalDrill\nT\d{1,4}C\d{1,4}\.\d{4}\n){1,1000}"
    r"%\nG05\n"
    r"(?:T\d{1,4}\n(?:X-?\d{1,6}\.\d{4}Y-?\d{1,6}\.\d{4}\n)+){1,1000}"
    r"M30\n"
)


class FormError(Exception):
    """A line that the writer does not write."""


@dataclass(slots=True, kw_only=True)
class Drawn:
    """What the statements of a Gerber file draw, in nm, in file order; read without a library.

    ``apertures`` are the outline in mm or the diameter of each, by its number; ``lines`` are begin and end of each straight line
    outside of regions, ``regions`` the vertices of each.
    """

    apertures: dict[int, tuple[str, tuple[float, ...]]] = field(default_factory=dict)
    flashes: list[tuple[int, int, int]] = field(default_factory=list)
    lines: list[tuple[int, int, int, int]] = field(default_factory=list)
    regions: list[list[tuple[int, int]]] = field(default_factory=list)
    arcs: int = 0


def read_form(data: bytes) -> Drawn:
    """Read a Gerber file by the writer's grammar.

    Raises
    ------
    FormError
        At the first line that the writer would not write there.
    """
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError as error:
        raise FormError("it is not ASCII") from error
    lines = text.split("\n")
    if lines[-1] or "\r" in text:
        raise FormError("its lines do not all end with a line feed")
    start = next((i for i, line in enumerate(lines) if not _ATTRIBUTE.fullmatch(line)), 0)
    if tuple(lines[start : start + len(_SETTINGS)]) != _SETTINGS:
        raise FormError(f"line {start + 1} does not begin the writer's settings, {' '.join(_SETTINGS)}")
    _refuse_attributes(lines, start)
    reader = _Reader(lines, start + len(_SETTINGS))
    reader.read()
    return reader.drawn


def _refuse_attributes(lines: Sequence[str], start: int) -> None:
    """Refuse file attributes that are not the writer's header in its order, with a signature at the end, or in two forms."""
    found = [(i, match[1]) for i, line in enumerate(lines) if (match := _FILE_ATTRIBUTE.match(line)) is not None]
    if found and found[-1] == (len(lines) - 3, ".MD5"):
        found.pop()
    header = [name for _, name in found]
    if len(found) != start or header != [name for name in _FILE_ATTRIBUTES if name in set(header)]:
        raise FormError("its file attributes are not those of the writer's header, each once and in order")
    if len({line[0] for line in lines if _ATTRIBUTE.fullmatch(line)}) > 1:
        raise FormError("its attributes are written in two ways, as statements and as comments")


class _Reader:
    """State of a Gerber file between two lines."""

    def __init__(self, lines: Sequence[str], first: int) -> None:
        self.lines, self.at, self.drawn = lines, first, Drawn()
        self.macros: dict[str, tuple[float, ...]] = {}
        self.aperture: int | None = None
        self.pen: tuple[int, int] | None = None
        self.region: list[tuple[int, int]] | None = None
        self.arc = False

    def fail(self, why: str) -> FormError:
        return FormError(f"line {self.at + 1}, {shown(self.lines[self.at])}, {why}")

    def read(self) -> None:
        last = len(self.lines) - 2  # after it the text behind the last line feed, which is empty
        while self.at < last:
            line = self.lines[self.at]
            if (point := _POINT.fullmatch(line)) is not None:
                self._draw(point)
            elif not _ATTRIBUTE.fullmatch(line):
                self._state(line)
            self.at += 1
        if self.at != last or self.lines[last] != "M02*":
            raise FormError("its end, M02, does not stand once and last")
        if self.region is not None:
            raise FormError("its last region does not end")

    def _draw(self, found: re.Match[str]) -> None:
        x, y, centre, operation = int(found[1]), int(found[2]), found[3], found[4]
        if operation == "2":
            if centre is not None:
                raise self.fail("is no move")
            if self.region == []:
                self.region.append((x, y))
            elif self.region is not None:
                raise self.fail("begins a second contour")
        elif operation == "3":
            if self.aperture is None or self.region is not None or self.arc or centre is not None:
                raise self.fail("cannot flash here")
            self.drawn.flashes.append((x, y, self.aperture))
            return
        elif self.pen is None or (centre is not None) is not self.arc or (self.region is None and self.aperture is None):
            raise self.fail("cannot draw here")
        elif self.region is not None:
            self.region.append((x, y))
        elif self.arc:
            self.drawn.arcs += 1
        elif self.drawn.apertures[self.aperture or 0][0] != "C":
            raise self.fail("draws with an aperture that is not round")
        else:
            self.drawn.lines.append((*self.pen, x, y))
        self.pen = (x, y)

    def _state(self, line: str) -> None:
        if (select := _SELECT.fullmatch(line)) is not None:
            self.aperture = int(select[1])
            if self.aperture not in self.drawn.apertures or self.region is not None:
                raise self.fail("takes an aperture that is not defined, or inside of a region")
        elif (aperture := _APERTURE.fullmatch(line)) is not None:
            self._define(aperture)
        elif (macro := _MACRO.fullmatch(line)) is not None and macro[1] not in self.macros:
            self.macros[macro[1]] = self._vertices()
        elif line in ("G03*", "G01*") and self.arc is (line == "G01*") and self.region is None:
            self.arc = not self.arc
        elif line == "G36*" and self.region is None and not self.arc:
            self.region, self.pen = [], None
        elif line == "G37*" and self.region and self.region[0] == self.region[-1]:
            self.drawn.regions.append(self.region[:-1])
            self.region, self.pen = None, None
        else:
            raise self.fail("is none that the writer writes there")

    def _define(self, found: re.Match[str]) -> None:
        number, name = int(found[1]), found[6]
        if number != 10 + len(self.drawn.apertures) or (name is not None and name not in self.macros):
            raise self.fail("defines an aperture out of its order, or again, or of an unknown shape")
        shape = found[2] or found[4] or "M"
        self.drawn.apertures[number] = (shape, self.macros[name] if name else (float(found[3] or found[5]),))

    def _vertices(self) -> tuple[float, ...]:
        """Vertices of the outline macro that begins in this line, the first repeated at its end."""
        outline = _OUTLINE.fullmatch(self.lines[self.at + 1])
        count = int(outline[1]) + 1 if outline is not None else 0
        found = [_VERTEX.fullmatch(line) for line in self.lines[self.at + 2 : self.at + 2 + count]]
        points = [(float(v[1]), float(v[2])) for v in found if v is not None]
        end = self.at + 2 + count
        if count < 4 or len(points) < count or points[0] != points[-1] or self.lines[end : end + 1] != ["0*%"]:
            raise self.fail("is no outline macro of the writer's")
        self.at = end
        return tuple(value for point in points[:-1] for value in point)


def check_form(files: Mapping[str, WrittenFile], gerbers: Mapping[str, GerberContent]) -> Check:
    """Check that Gerber and drill files are written in the writer's grammar, and that both readings of them draw the same."""
    problems = []
    for role, content in gerbers.items():
        try:
            problems += [f"{role}: {problem}" for problem in _differences(read_form(files[role].data), content)]
            if others := set(_FUNCTION.findall(files[role].data)) - _FUNCTIONS.get(role, _OTHER_FUNCTIONS):
                problems.append(f"{role}: an aperture of it is for {shown(others.pop().decode('ascii'))}")
        except FormError as error:
            problems.append(f"{role}: {error}")
    if "drill-npth" in files:
        problems += [f"drill-npth: {problem}" for problem in drill_problems(files["drill-npth"].data)]
    count = len(gerbers) + ("drill-npth" in files)
    message = named(problems) or f"{count} files in the writer's grammar, read alike by gerbonara and by it"
    return Check(name=_NAME, passed=not problems, message=message, figure=float(count))


def drill_problems(data: bytes) -> list[str]:
    """Faults of a drill file's form: another grammar, or a tool that is defined or taken twice."""
    text = data.decode("ascii", "replace")
    if _DRILL.fullmatch(text) is None:
        return ["it is not as the writer writes it: header, tools, then the holes of each tool"]
    defined = re.findall(r"^T(\d+)C", text, re.MULTILINE)
    taken = re.findall(r"^T(\d+)$", text, re.MULTILINE)
    right = [str(number) for number in range(1, len(defined) + 1)]
    return [] if defined == right == taken else ["its tools are not each defined and taken once, in order"]


def _differences(drawn: Drawn, content: GerberContent) -> list[str]:
    """What the two readings of a file see differently."""
    flashes = np.array(drawn.flashes, dtype=np.float64).reshape(-1, 3)
    used = list(dict.fromkeys(number for _, _, number in drawn.flashes))
    place = {number: i for i, number in enumerate(used)}
    index = np.array([place[number] for _, _, number in drawn.flashes], dtype=np.int64)
    problems = []
    if not _same(flashes[:, :2] / 1e6, content.flash_xy_mm) or not np.array_equal(index, content.flash_aperture):
        problems.append("gerbonara reads other flashes than the grammar")
    shapes = [drawn.apertures[number] for number in used]
    if len(shapes) != len(content.aperture_outlines_mm) or not all(
        _same_shape(shape, outline) for shape, outline in zip(shapes, content.aperture_outlines_mm, strict=True)
    ):
        problems.append("gerbonara reads other apertures than the grammar")
    regions = [np.array(region) / 1e6 for region in drawn.regions]
    if len(regions) != len(content.areas_mm) or not all(map(_same_area, regions, content.areas_mm)):
        problems.append("gerbonara reads other regions than the grammar")
    lines = np.array(drawn.lines, dtype=np.float64).reshape(-1, 4) / 1e6
    if not drawn.arcs and not _same(lines, segments(content.strokes_mm)):
        problems.append("gerbonara reads other lines than the grammar")
    return problems


def segments(strokes_mm: Sequence[np.ndarray]) -> np.ndarray:
    """Begin and end of each line of some polylines; shape (n, 4), mm."""
    pieces = [np.concatenate([stroke[:-1], stroke[1:]], axis=1) for stroke in strokes_mm]
    return np.concatenate([np.empty((0, 4)), *pieces])


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and bool((np.abs(a - b) <= _SAME_MM).all())


def _same_area(a: np.ndarray, b: np.ndarray) -> bool:
    return _same(a, b[:-1] if len(b) == len(a) + 1 else b)


def _same_shape(shape: tuple[str, tuple[float, ...]], outline_mm: np.ndarray) -> bool:
    kind, values = shape
    if kind == "M":
        return _same(np.array(values).reshape(-1, 2), outline_mm)
    radius = np.hypot(*outline_mm.T)
    return bool((np.abs(radius - values[0] / 2) <= _SAME_MM).all())
