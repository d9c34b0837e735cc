"""Checks of the drawings for the people at the fab: outlines of the DXF, form and words of the PDF.

Programs that open these formats also execute or fetch what a file refers to, so only the form that this tool writes is accepted.
"""

from __future__ import annotations

import base64
import re
import zlib
from collections.abc import Mapping, Sequence

import numpy as np

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import named
from tactape_fab.base.fields import shown as quoted
from tactape_fab.texture.frames import BoolArray, FloatArray
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.layers.board import off_outline_mm
from tactape_fab.verify.layers.drawing_words import word_problems
from tactape_fab.verify.layers.film_layers import without_counterpart
from tactape_fab.verify.layers.kicad import Shown
from tactape_fab.verify.layers.kicad_drawn import Made, number
from tactape_fab.verify.layers.lands import PLACE_TOLERANCE_MM, apart_mm
from tactape_fab.verify.layers.legend import inked_or_cut
from tactape_fab.verify.layers.written_form import same_contours, segments

_MOST_TEXT = 8 << 20
"""Most bytes of the decompressed page; one with 20,000 parts has 1.5 MB."""
_TAG = re.compile(r" {0,2}(\d{1,4})\n([^\n]*)\n")
_HEADER = ["0 SECTION", "2 HEADER", "9 $ACADVER", "1 AC1009", "9 $INSUNITS", "70 4", "0 ENDSEC", "0 SECTION", "2 TABLES"]
"""Release 12 in millimetres."""
_LAYERS = re.compile(
    r"0 TABLE\n2 LAYER\n70 \d\n(?:0 LAYER\n2 [A-Z]+\n70 0\n62 [1-9]\n6 CONTINUOUS\n){1,9}0 ENDTAB\n0 ENDSEC\n0 SECTION"
)
"""Table of visible layers: flags (70) could freeze a layer, and a negative colour (62) switch it off."""
Drawn = dict[str, list[FloatArray]]
"""Vertices of polylines by layer; for a circle x, y and diameter."""


def check_drawings(files: Mapping[str, WrittenFile], expected: Shown, made: Made) -> list[Check]:
    """Check those drawings that the kit has."""
    checks = []
    if "fab-dxf" in files:
        problems = _dxf_problems(files["fab-dxf"].data, expected, made)
        right = "outline, slots, holes and ink as the manifest and the legend have them, and every part in a field"
        checks.append(Check(name="fab-dxf", passed=not problems, message=named(problems) or right))
    if "fab-drawing" in files:
        try:
            words = _read_pdf(files["fab-drawing"].data)
            problems = word_problems(words, expected, made)
        except (ValueError, zlib.error) as error:
            problems = [f"it is not in the form that this tool writes: {error}"]
        right = "one page that runs and fetches nothing; its words as the manifest's; not compared: what it draws, and its scales"
        checks.append(Check(name="fab-drawing", passed=not problems, message=named(problems) or right))
    return checks


# DXF


def _dxf_problems(data: bytes, expected: Shown, made: Made) -> list[str]:
    try:
        drawn = _read_dxf(data)
    except (ValueError, IndexError, OverflowError) as error:
        return [f"it cannot be read: {error}"]
    outline, parts, legend = drawn.pop("OUTLINE", []), expected.parts_xy_mm, made.gerbers.get("legend-top")
    problems = []
    closed = outline[0][[*range(len(outline[0])), 0], :2] if len(outline) == 1 else None
    if closed is None or off_outline_mm(closed, expected.size_mm, made.radius_mm) > PLACE_TOLERANCE_MM:
        problems.append(f"its outline is not that of {expected.size_mm[0]:g} x {expected.size_mm[1]:g} mm")
    areas, strokes = ((), ()) if legend is None else (legend.areas_mm, legend.strokes_mm)
    holes, none = np.array(expected.holes, dtype=float).reshape(-1, 1, 3), np.empty((0, 3))
    contours: dict[str, Sequence[FloatArray]] = {"SLOTS": made.slots_mm, "HOLES": [*holes], "TAG": areas, "LABEL": strokes}
    for layer, wanted in contours.items():
        found = drawn.pop(layer, [])
        flat = [line[:, :2] for line in found]
        if layer == "HOLES":
            these, those = (np.concatenate([*circles, none]) for circles in (found, wanted))
            same = len(found) == len(wanted) and apart_mm(these, those) <= PLACE_TOLERANCE_MM
        elif layer == "LABEL":  # a Gerber file may split a polyline that is whole in the DXF
            these, those = (segments(lines).reshape(-1, 2, 2) for lines in (flat, wanted))
            same = not len(without_counterpart(these, those)) + len(without_counterpart(those, these))
        else:
            same = same_contours(flat, wanted, PLACE_TOLERANCE_MM)
        if not same:
            problems.append(f"its {layer} are {len(found)} contours that are not the {len(wanted)} of the kit")
    # a field is the bounding box of its parts; a panel has one per tape
    fields = [_box(line) for line in drawn.pop("FIELD", [])]
    outside = [not any(inside) for inside in zip(*(_inside(parts, *box) for box in fields), strict=True)] or [True]
    if any(outside):
        problems.append(f"{sum(outside)} parts lie in no FIELD of it")
    taken = [*fields, *inked_or_cut(legend, expected.holes)]
    for low, high in map(_box, drawn.pop("NUMBER", [])):
        over = any((low < top).all() and (high > bottom).all() for bottom, top in taken)
        if over or (low < 0.0).any() or (high > expected.size_mm).any():
            problems.append("it lets the fab print on parts, ink or holes, or off the board")
    return problems + [f"it has a layer {quoted(layer)}" for layer, lines in drawn.items() if lines]


def _read_dxf(data: bytes) -> Drawn:
    """Contours of each layer of a DXF in the writer's form. Raises ValueError for any other form."""
    text = data.decode("ascii")
    tags = [(int(code), value) for code, value in _TAG.findall(text)]
    # written again from the parsed tags, so that any text which the pattern skipped is a difference
    if "".join(f"{code:3d}\n{value}\n" for code, value in tags) != text or tags[-2:] != [(0, "ENDSEC"), (0, "EOF")]:
        raise ValueError("it is not written as this tool writes it, or it was cut off")
    lines = [f"{code} {value}" for code, value in tags]
    start = lines.index("2 ENTITIES")
    # only the table of layers is allowed, as blocks and styles could draw as well, or refer to a file
    table = "\n".join(lines[len(_HEADER) : start])
    if lines[: len(_HEADER)] != _HEADER or not _LAYERS.fullmatch(table):
        raise ValueError("it has another unit or release, a layer that is off or frozen, or holds more before what it draws")
    drawn: Drawn = {name: [] for name in re.findall(r"0 LAYER\n2 ([A-Z]+)", table)}
    if len(drawn) < table.count("0 LAYER"):
        raise ValueError("its table has a layer twice")
    at, end = start + 1, len(tags) - 2
    while at < end:
        kind, (code, layer) = tags[at], tags[at + 1]
        if code != 8 or kind not in ((0, "CIRCLE"), (0, "POLYLINE")):
            raise ValueError(f"it draws a {quoted(kind[1])}")
        if layer not in drawn:
            raise ValueError(f"its table has no layer {quoted(layer)}")
        points: list[tuple[float, ...]] = []
        if kind[1] == "CIRCLE":
            # group codes of the DXF reference: 10, 20, 30 are x, y, z of a point, 40 a radius, 8 the layer; 0 begins an entity
            x, y, radius = _numbers(tags[at + 2 : at + 6], (10, 20, 30, 40))
            points.append((x, y, 2 * radius))
            at += 6
        else:
            # a width (40, 41) or a bulge (42) would draw other shapes than lines through the points, and an outline that is not
            # closed (70, 1) would lack its last side
            if tags[at + 2] != (66, "1") or tags[at + 6] != (70, "0" if layer == "LABEL" else "1"):
                raise ValueError(f"a line of its {quoted(layer)} has a width or a bulge, or is not closed")
            if _numbers(tags[at + 3 : at + 6], (10, 20, 30)) != (0.0, 0.0):
                raise ValueError(f"a line of its {quoted(layer)} has an origin of its own")
            at += 7
            while tags[at] == (0, "VERTEX") and tags[at + 1] == (8, layer):
                points.append((*_numbers(tags[at + 2 : at + 5], (10, 20, 30)), 0.0))
                at += 5
            if tags[at : at + 2] != [(0, "SEQEND"), (8, layer)] or not points:
                raise ValueError("a line of it does not end")
            at += 2
        drawn[layer].append(np.array(points))
    for line in (*drawn.get("FIELD", []), *drawn.get("NUMBER", [])):  # another shape holds less than its bounding box
        (left, low), (right, high) = _box(line)
        if line[:, :2].tolist() != [[left, low], [right, low], [right, high], [left, high]]:
            raise ValueError("a FIELD or NUMBER of it is no rectangle")
    return drawn


_FAR_MM = 10_000.0


def _numbers(tags: list[tuple[int, str]], codes: tuple[int, ...]) -> tuple[float, ...]:
    """The values of a point or circle without z, which must be 0. Raises ValueError for values beyond `_FAR_MM`."""
    if tuple(code for code, _ in tags) != codes or tags[2][1] != "0.0":
        raise ValueError("a point of it is not in the plane")
    values = tuple(number(value) for code, value in tags if code != 30)
    if not all(abs(value) <= _FAR_MM for value in values):  # refuses NaN as well; squares of distances stay finite
        raise ValueError(f"a point of it is farther away than {_FAR_MM:g} mm")
    return values


def _box(line: FloatArray) -> tuple[FloatArray, FloatArray]:
    return line[:, :2].min(axis=0), line[:, :2].max(axis=0)


def _inside(xy_mm: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    return np.asarray(((xy_mm > low) & (xy_mm < high)).all(axis=1))


# PDF (ISO 32000-1) in the form of ReportLab: objects one after the other, then the cross-reference table

_STRING = rb"\((?:[^()\\]|\\.)*\)"
_DICT = rb"<<(?:[^()<>%]|" + _STRING + rb"|<<[^()<>%]*>>)*>>"
_OBJECT = re.compile(rb"(\d{1,4}) 0 obj\n(" + _DICT + rb")\n(endobj\n|stream\r?\n)", re.DOTALL)
_STREAM = re.compile(rb"<<\n/Filter \[ (/ASCII85Decode )?/FlateDecode \] /Length (\d{1,8})(?: /Length1 \d{1,8})?\n>>")
_END = re.compile(
    rb"trailer\n<<\n/ID \n\[(?:<[0-9a-f]{32}>){2}\]\n% [^\r\n]*\n\n/Info \d+ 0 R\n/Root \d+ 0 R\n/Size \d+\n>>\n"
    rb"startxref\n(\d+)\n%%EOF\n"
)
_START = re.compile(rb"%PDF-1\.\d\n(?:%[^\r\n]*\n)*")
_NAMES = frozenset(
    b"/Type /Page /Pages /Parent /Kids /Count /Catalog /PageMode /UseNone /Contents /MediaBox /Resources /Rotate /Trans /Font "
    b"/ProcSet /PDF /Text /ImageB /ImageC /ImageI /BaseFont /FirstChar /LastChar /FontDescriptor /Name /Subtype /TrueType "
    b"/ToUnicode /Widths /Ascent /CapHeight /Descent /Flags /FontBBox /FontFile2 /FontName /ItalicAngle /MissingWidth /StemV "
    b"/Filter /FlateDecode /ASCII85Decode /Length /Length1 /Author /CreationDate /Creator /Keywords /ModDate /Producer /Subject "
    b"/Title /Trapped /False".split()
)
"""Names of the drawing's objects, without those of actions, scripts, files, forms, links and object streams."""
_NAME = re.compile(rb"/[^\s()<>\[\]{}/%]*")
_OF_FONTS = re.compile(rb"/(?:F\d\+0|AAAAAA\+BitstreamVeraSans-(?:Roman|Bold))")


def _read_pdf(data: bytes) -> str:
    """The words of the single page, separated by blanks; ValueError if the file has more than the page and its fonts."""
    start = _START.match(data)
    if start is None:
        raise ValueError("it does not begin as one")
    at, places, kinds, contents, pages = start.end(), [], list[bytes](), list[int](), list[bytes]()
    while found := _OBJECT.match(data, at):
        places.append(at)
        if int(found[1]) != len(places):
            raise ValueError("its objects are not in order")
        # strings are removed, as they contain no names
        bare = re.sub(_STRING, b"", found[2])
        kinds += re.findall(rb"/Type /(\w+)", bare)
        contents += [int(number or 0) for number in re.findall(rb"/Contents(?: (\d{1,4}) 0 R )?", bare)]
        # only known names are allowed, which excludes /JS, /URI, /Launch and names of later versions of PDF
        strange = [n for n in _NAME.findall(bare) if n not in _NAMES and not _OF_FONTS.fullmatch(n)]
        if strange:
            raise ValueError(f"it holds {quoted(strange[0].decode('latin-1'))}")
        at = found.end()
        if found[3] != b"endobj\n":
            stream = _STREAM.fullmatch(found[2])
            if stream is None:
                raise ValueError("a stream is packed in another way")
            packed = data[at : at + int(stream[2])]
            # the page's stream, by the object number in /Contents; the others are fonts
            if len(places) in contents:
                pages.append(base64.a85decode(packed.strip().removesuffix(b"~>")) if stream[1] else packed)
            at += len(packed)
            if not data.startswith(b"endstream\nendobj\n", at):
                raise ValueError("a stream does not end where it says")
            at += len(b"endstream\nendobj\n")
    # the cross-reference table must be that of these objects, as it could lead a reader to bytes inside a stream
    table = b"".join(b"%010d 00000 n \n" % place for place in places)
    table = b"xref\n0 %d\n0000000000 65535 f \n" % (len(places) + 1) + table
    end = _END.fullmatch(data, at + len(table))
    if end is None or data[at : at + len(table)] != table or int(end[1]) != at:
        raise ValueError("its table of objects is not of those, or something stands behind it")
    if kinds.count(b"Page") != 1 or kinds.count(b"Catalog") != 1 or not len(contents) == len(pages) == 1:
        raise ValueError("it has not one page")
    inflater = zlib.decompressobj()
    # at most `_MOST_TEXT` bytes are decompressed
    content = inflater.decompress(pages[0], _MOST_TEXT)
    if not inflater.eof:
        raise ValueError("its page is too long")
    # "(text) Tj" shows a text, after operators that position it
    lines = b" ".join(before.rpartition(b" (")[2] for before in content.split(b") Tj")[:-1])
    ascii_alone = re.sub(rb"\\[0-7]{3}", b"?", lines)  # their characters are defined by the font's encoding
    words = re.sub(rb"\\(.)", rb"\1", ascii_alone).decode("latin-1")
    return f" {words} "
