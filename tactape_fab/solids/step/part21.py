"""STEP files as text (ISO 10303-21): single entities, and templates of entities that numpy repeats by the thousand.

Rows of a template have a fixed width, so that whole blocks are filled column by column without a Python loop: all instance
names have the same number of digits, and coordinates are padded with spaces (which ISO 10303-21 allows between tokens).
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from tactape_fab.base.number_rows import digits, number_rows
from tactape_fab.texture.frames import FloatArray

Rgb = tuple[float, float, float]
TextArray = npt.NDArray[np.bytes_]

DECIMALS = 9
"""Decimals of coordinates, with which a tape's volume has a relative error of 1e-9 (with six decimals 3e-8)."""
SCHEMA = "AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }"
_ROWS_AT_ONCE = 512
MOST_OF_FRAME = 100
"""Upper bound of the entities of a product other than its faces and copies."""
_LINE_OF_NAMES = re.compile(r"(?:#\d+,?){1,12}")
_PLACE = re.compile(r"#\[(\d+)\]|<(\w+)>")


@lru_cache(maxsize=1 << 12)
def real(value: float) -> str:
    """A REAL of ISO 10303-21, with a point and without an exponent."""
    # three decimals more than `reals`, as thousands of copies refer to directions and radii of single entities
    text = f"{value:.12f}".rstrip("0")
    return "0." if text in ("-0.", "0.") else text


def triple(values: Sequence[float] | FloatArray) -> str:
    """Three numbers in parentheses."""
    return "(" + ",".join(real(float(v)) for v in values) + ")"


def string(text: str) -> str:
    """A string literal: apostrophes and backslashes doubled (ISO 10303-21, 6.4.3), non-ASCII characters replaced."""
    plain = text.encode("ascii", "replace").decode("ascii")
    return "'" + plain.replace("\\", "\\\\").replace("'", "''") + "'"


Step = tuple[str, bool]
"""An edge, and whether it is followed from its start to its end."""


def reversed_steps(steps: Sequence[Step]) -> list[Step]:
    """The reversed loop, for a mould."""
    return [(edge, not forward) for edge, forward in reversed(steps)]


class Entities(ABC):
    """Entities that are composed in the same way singly and in a template."""

    @abstractmethod
    def add(self, entity: str) -> str:
        """Append an entity, and return its name."""

    def axes(self, origin: str, axis: str, ref: str) -> str:
        """An AXIS2_PLACEMENT_3D of a point and two directions."""
        return self.add(f"AXIS2_PLACEMENT_3D('',{origin},{axis},{ref})")

    def edge(self, start: str, end: str, curve: str) -> str:
        return self.add(f"EDGE_CURVE('',{start},{end},{curve},.T.)")

    def loop(self, steps: Sequence[Step]) -> str:
        """An EDGE_LOOP of steps."""
        oriented = [self.add(f"ORIENTED_EDGE('',*,*,{edge},.{'T' if forward else 'F'}.)") for edge, forward in steps]
        return self.add(f"EDGE_LOOP('',({','.join(oriented)}))")


class Writer(Entities):
    """Single entities with consecutive numbers."""

    def __init__(self, first: int = 1) -> None:
        self.next = first
        self._lines: list[str] = []

    def add(self, entity: str) -> str:
        """Append an entity, and return its name, such as ``#12``."""
        name = f"#{self.next}"
        self._lines.append(f"{name}={entity};\n")
        self.next += 1
        return name

    def point(self, xyz: Sequence[float] | FloatArray) -> str:
        return self.add(f"CARTESIAN_POINT('',{triple(xyz)})")

    def direction(self, xyz: Sequence[float] | FloatArray) -> str:
        return self.add(f"DIRECTION('',{triple(xyz)})")

    def placement(
        self, origin: Sequence[float] | FloatArray, axis: Sequence[float] | FloatArray, ref: Sequence[float] | FloatArray
    ) -> str:
        return self.axes(self.point(origin), self.direction(axis), self.direction(ref))

    def vertex(self, xyz: Sequence[float] | FloatArray) -> str:
        return self.add(f"VERTEX_POINT('',{self.point(xyz)})")

    def line_edge(self, start: str, end: str, a: FloatArray, b: FloatArray) -> str:
        """A straight edge from vertex `start` at a to vertex `end` at b."""
        along = (b - a) / np.linalg.norm(b - a)
        vector = self.add(f"VECTOR('',{self.direction(along)},1.)")
        return self.edge(start, end, self.add(f"LINE('',{self.point(a)},{vector})"))

    def face(self, loops: Sequence[str], surface: str, *, bounds: Sequence[str] = (), same_sense: bool = True) -> str:
        """A face with an outer loop, further loops, and already written bounds."""
        outer = self.add(f"FACE_OUTER_BOUND('',{loops[0]},.T.)")
        inner = [self.add(f"FACE_BOUND('',{loop},.T.)") for loop in loops[1:]]
        return self.add(f"ADVANCED_FACE('',({','.join([outer, *inner, *bounds])}),{surface},.{'T' if same_sense else 'F'}.)")

    def text(self) -> bytes:
        return "".join(self._lines).encode("ascii")


@dataclass
class Template(Entities):
    """Entities that are repeated in copies.

    In an entity's text, ``#[k]``, as returned by `add`, refers to an entity of the same copy; ``<name>`` is a column of
    texts of equal width.
    """

    entities: list[str] = field(default_factory=list)

    def add(self, entity: str) -> str:
        self.entities.append(entity)
        return f"#[{len(self.entities) - 1}]"

    def __len__(self) -> int:
        return len(self.entities)


def index_of(reference: str) -> int:
    """Index in its template of the entity that a reference names."""
    return int(reference[2:-1])


def first_name(single: int, copies: int, size: int) -> int:
    """First number for `copies` of a template of `size` entities, above `single`, such that all numbers have equal length."""
    first = 10
    # a power of ten above all single names, such that the last name is below the next power of ten
    while first <= single or first + copies * size > first * 10:
        first *= 10
    return first


def fill(template: Template, first: int, count: int, columns: Mapping[str, TextArray]) -> Iterator[bytes]:
    """The text of `count` copies of a template, in pieces.

    first: Number of the first entity of the first copy; see `first_name`.
    columns (count,): Values of each ``<name>``, without trailing NUL bytes: see `reals`.
    """
    size, of_name = len(template), len(str(first))
    # `row` is the text of one copy with gaps, for each of which a structured dtype has a field
    row, fields, formats, offsets = bytearray(), [], [], []
    for k, entity in enumerate(template.entities):
        # line ends are optional between tokens; one per eight entities saves bytes and keeps lines readable
        line = f"#[{k}]={entity};" + ("\n" if k % 8 == 7 or k == size - 1 else "")
        end = 0
        for match in _PLACE.finditer(line):
            row += line[end : match.start()].encode("ascii")
            end = match.end()
            if match[1] is not None:
                row += b"#"
            width = of_name if match[1] is not None else columns[match[2]].dtype.itemsize
            fields.append((match[1], match[2]))
            formats.append(f"V{width}")
            offsets.append(len(row))
            row += bytes(width)
        row += line[end:].encode("ascii")
    keys = [str(i) for i in range(len(fields))]
    row_type = np.dtype({"names": keys, "formats": formats, "offsets": offsets, "itemsize": len(row)})
    for start in range(0, count, _ROWS_AT_ONCE):
        stop = min(start + _ROWS_AT_ONCE, count)
        # copied as a whole, then filled gap by gap; a block of 512 rows has some 2 MB, which fit in the cache
        rows = np.empty(stop - start, dtype=f"V{len(row)}")
        rows[:] = np.void(bytes(row))
        cells = rows.view(row_type)
        # digits as (rows * size, of_name) bytes, viewed as one opaque value per name
        numbers = np.ascontiguousarray(digits(np.arange(first + start * size, first + stop * size), of_name))
        names = numbers.view(f"V{of_name}").reshape(-1, size)
        for key, (local, column), format_ in zip(keys, fields, formats, strict=True):
            cells[key] = names[:, int(local)] if local is not None else columns[column][start:stop].view(format_)
        yield rows.tobytes()


def reals(values: FloatArray, decimals: int = DECIMALS) -> TextArray:
    """Numbers as texts of equal width, padded with spaces on the left; same shape as `values`."""
    # as integers in picometres, with a range of 9,000 km in 64 bits
    scaled = np.rint(np.asarray(values, dtype=np.float64) * 10.0**decimals).astype(np.int64)
    negative = scaled.ravel() < 0
    size = np.abs(scaled).ravel()
    # digits before the point of the largest value, at least the 0 of 0.5
    whole = max(len(str(int(size.max(initial=0)))) - decimals, 1)
    lead = whole + (1 if negative.any() else 0)
    written = digits(size, whole + decimals)
    out = np.full((len(size), lead + 1 + decimals), ord(" "), dtype=np.uint8)
    out[:, lead - whole : lead] = written[:, :whole]
    out[:, lead] = ord(".")
    out[:, lead + 1 :] = written[:, whole:]
    # leading zeros become spaces, and a minus is put before the first digit
    leading = np.cumprod(written[:, : whole - 1] == ord("0"), axis=1).sum(axis=1)
    column = np.arange(lead)
    first = lead - whole + leading
    out[:, :lead][column < first[:, None]] = ord(" ")
    out[np.flatnonzero(negative), first[negative] - 1] = ord("-")
    width = out.shape[1]
    return out.view(f"S{width}").reshape(scaled.shape)


# Entities of every file


def header(name: str, date: datetime) -> bytes:
    """HEADER section and the start of DATA."""
    return (
        "ISO-10303-21;\nHEADER;\n"
        "FILE_DESCRIPTION((''),'2;1');\n"
        f"FILE_NAME({string(name)},'{date:%Y-%m-%dT%H:%M:%S}',(''),(''),'tactape-fab','tactape-fab','');\n"
        f"FILE_SCHEMA(('{SCHEMA}'));\n"
        "ENDSEC;\nDATA;\n"
    ).encode("ascii")


TRAILER = b"ENDSEC;\nEND-ISO-10303-21;\n"


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """Entities shared by all shapes of a file: application contexts, units (mm, rad) and their uncertainty."""

    product: str
    definition: str
    geometry: str


def context(w: Writer) -> Context:
    application = w.add("APPLICATION_CONTEXT('core data for automotive mechanical design processes')")
    w.add(f"APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,{application})")
    product = w.add(f"PRODUCT_CONTEXT('',{application},'mechanical')")
    definition = w.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{application},'design')")
    length = w.add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
    angle = w.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    solid = w.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    # readers may merge points nearer than this, which is far above the last decimal and far below any edge of a texture
    uncertainty = w.add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-06),{length},'distance_accuracy_value','')")
    geometry = w.add(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(3)"
        f"GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({uncertainty}))"
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle},{solid}))"
        "REPRESENTATION_CONTEXT('',''))"
    )
    return Context(product=product, definition=definition, geometry=geometry)


def product(w: Writer, shared: Context, name: str) -> tuple[str, str]:
    """Add a product; returns the names of its PRODUCT_DEFINITION and PRODUCT_DEFINITION_SHAPE."""
    made = w.add(f"PRODUCT({string(name)},{string(name)},'',({shared.product}))")
    w.add(f"PRODUCT_RELATED_PRODUCT_CATEGORY('part',$,({made}))")
    formation = w.add(f"PRODUCT_DEFINITION_FORMATION('','',{made})")
    definition = w.add(f"PRODUCT_DEFINITION('design','',{formation},{shared.definition})")
    return definition, w.add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")


def coloured(w: Writer, shared: Context, solid: str, rgb: Rgb) -> None:
    """Give a solid a colour (ISO 10303-46)."""
    # each entity wraps the previous one: colour, area, surface, side, usage, style, and the styled solid
    colour = w.add(f"COLOUR_RGB('',{','.join(real(v) for v in rgb)})")
    area = w.add(f"FILL_AREA_STYLE_COLOUR('',{colour})")
    filled = w.add(f"FILL_AREA_STYLE('',({area}))")
    fill_area = w.add(f"SURFACE_STYLE_FILL_AREA({filled})")
    side = w.add(f"SURFACE_SIDE_STYLE('',({fill_area}))")
    usage = w.add(f"SURFACE_STYLE_USAGE(.BOTH.,{side})")
    style = w.add(f"PRESENTATION_STYLE_ASSIGNMENT(({usage}))")
    item = w.add(f"STYLED_ITEM('',({style}),{solid})")
    w.add(f"MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',({item}),{shared.geometry})")


def names(first: int, indices: npt.NDArray[np.int64]) -> str:
    """Comma-separated names of entities first + index."""
    return number_rows("#%d,", first + indices).decode("ascii").rstrip(",")


def wrapped_names(parts: Sequence[str]) -> str:
    """A long list of names, broken into lines."""
    return "\n".join(_LINE_OF_NAMES.findall(",".join(part for part in parts if part)))
