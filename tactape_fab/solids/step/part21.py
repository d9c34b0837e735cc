"""STEP files as text (ISO 10303-21): single entities, and templates of entities repeated by the thousand in numpy.

Rows of a template have a fixed width, so that a whole block of them is filled column by column without a Python loop:
instance names all have as many digits, and coordinates are padded with spaces (which ISO 10303-21 allows between tokens).
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
"""Decimals of coordinates: a tape's volume is then exact to 1e-9 (six decimals: 3e-8)."""
SCHEMA = "AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }"
_ROWS_AT_ONCE = 512
MOST_OF_FRAME = 100
"""Entities of a product besides its faces and copies."""
_LINE_OF_NAMES = re.compile(r"(?:#\d+,?){1,12}")
_PLACE = re.compile(r"#\[(\d+)\]|<(\w+)>")


@lru_cache(maxsize=1 << 12)
def real(value: float) -> str:
    """A number as ISO 10303-21 wants it: with a point, without an exponent."""
    # three decimals more than `reals`: single entities hold directions and radii that thousands of copies refer to
    text = f"{value:.12f}".rstrip("0")
    return "0." if text in ("-0.", "0.") else text


def triple(values: Sequence[float] | FloatArray) -> str:
    """Three numbers in parentheses."""
    return "(" + ",".join(real(float(v)) for v in values) + ")"


def string(text: str) -> str:
    """A string literal: apostrophes and backslashes doubled (ISO 10303-21, 6.4.3), what is not ASCII replaced."""
    plain = text.encode("ascii", "replace").decode("ascii")
    return "'" + plain.replace("\\", "\\\\").replace("'", "''") + "'"


Step = tuple[str, bool]
"""An edge, and whether it is followed from its start to its end."""


def reversed_steps(steps: Sequence[Step]) -> list[Step]:
    """The same loop the other way round, as a mould has it."""
    return [(edge, not forward) for edge, forward in reversed(steps)]


class Entities(ABC):
    """Entities that are written alike one by one and in a template."""

    @abstractmethod
    def add(self, entity: str) -> str:
        """Append an entity; its name."""

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
    """Single entities in a row, each named by the next number."""

    def __init__(self, first: int = 1) -> None:
        self.next = first
        self._lines: list[str] = []

    def add(self, entity: str) -> str:
        """Append an entity; its name, such as ``#12``."""
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
        """A face of its outer loop, further loops, and bounds that exist already."""
        outer = self.add(f"FACE_OUTER_BOUND('',{loops[0]},.T.)")
        inner = [self.add(f"FACE_BOUND('',{loop},.T.)") for loop in loops[1:]]
        return self.add(f"ADVANCED_FACE('',({','.join([outer, *inner, *bounds])}),{surface},.{'T' if same_sense else 'F'}.)")

    def text(self) -> bytes:
        return "".join(self._lines).encode("ascii")


@dataclass
class Template(Entities):
    """Entities of one thing that is repeated.

    Inside an entity's text, ``#[k]`` is what `add` returned: an entity of the same copy; ``<name>`` is a column of
    texts that are all as wide.
    """

    entities: list[str] = field(default_factory=list)

    def add(self, entity: str) -> str:
        self.entities.append(entity)
        return f"#[{len(self.entities) - 1}]"

    def __len__(self) -> int:
        return len(self.entities)


def index_of(reference: str) -> int:
    """Which entity of its template a reference names."""
    return int(reference[2:-1])


def first_name(single: int, copies: int, size: int) -> int:
    """A first number for `copies` of a template of `size` entities, beyond `single` ones, so that all have as many digits."""
    first = 10
    # a power of ten above all single names; the last name must stay below the next one, or it has a digit more
    while first <= single or first + copies * size > first * 10:
        first *= 10
    return first


def fill(template: Template, first: int, count: int, columns: Mapping[str, TextArray]) -> Iterator[bytes]:
    """The text of `count` copies of a template, in pieces.

    first: Number of the first entity of the first copy; see `first_name`.
    columns (count,): Values of each ``<name>``, without trailing NUL bytes: see `reals`.
    """
    size, of_name = len(template), len(str(first))
    # `row` is the text of one copy with gaps; a structured type over the same bytes has a field for each gap
    row, fields, formats, offsets = bytearray(), [], [], []
    for k, entity in enumerate(template.entities):
        # line ends mean nothing between tokens: one for eight entities saves bytes and keeps lines readable
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
        # copied whole, then gap by gap; 512 rows of a block are some 2 MB, which stay in the cache meanwhile
        rows = np.empty(stop - start, dtype=f"V{len(row)}")
        rows[:] = np.void(bytes(row))
        cells = rows.view(row_type)
        # digits as (rows * size, of_name) bytes, seen as one opaque value for each name
        numbers = np.ascontiguousarray(digits(np.arange(first + start * size, first + stop * size), of_name))
        names = numbers.view(f"V{of_name}").reshape(-1, size)
        for key, (local, column), format_ in zip(keys, fields, formats, strict=True):
            cells[key] = names[:, int(local)] if local is not None else columns[column][start:stop].view(format_)
        yield rows.tobytes()


def reals(values: FloatArray, decimals: int = DECIMALS) -> TextArray:
    """Numbers as texts of one width, padded with spaces on the left; same shape as `values`."""
    # whole picometres: 64 bits hold 9,000 km of them
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
    # leading zeros become spaces, a minus is before the first digit
    leading = np.cumprod(written[:, : whole - 1] == ord("0"), axis=1).sum(axis=1)
    column = np.arange(lead)
    first = lead - whole + leading
    out[:, :lead][column < first[:, None]] = ord(" ")
    out[np.flatnonzero(negative), first[negative] - 1] = ord("-")
    width = out.shape[1]
    return out.view(f"S{width}").reshape(scaled.shape)


# What every file has


def header(name: str, date: datetime, tool: str) -> bytes:
    """HEADER section and the start of DATA."""
    return (
        "ISO-10303-21;\nHEADER;\n"
        "FILE_DESCRIPTION((''),'2;1');\n"
        f"FILE_NAME({string(name)},'{date:%Y-%m-%dT%H:%M:%S}',(''),(''),{string(tool)},{string(tool)},'');\n"
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
    # readers may take points nearer than this for one: far above the last decimal, far below any edge of a texture
    uncertainty = w.add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-06),{length},'distance_accuracy_value','')")
    geometry = w.add(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(3)"
        f"GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({uncertainty}))"
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle},{solid}))"
        "REPRESENTATION_CONTEXT('',''))"
    )
    return Context(product=product, definition=definition, geometry=geometry)


def product(w: Writer, shared: Context, name: str) -> tuple[str, str]:
    """A product; names of its PRODUCT_DEFINITION and PRODUCT_DEFINITION_SHAPE."""
    made = w.add(f"PRODUCT({string(name)},{string(name)},'',({shared.product}))")
    w.add(f"PRODUCT_RELATED_PRODUCT_CATEGORY('part',$,({made}))")
    formation = w.add(f"PRODUCT_DEFINITION_FORMATION('','',{made})")
    definition = w.add(f"PRODUCT_DEFINITION('design','',{formation},{shared.definition})")
    return definition, w.add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")


def coloured(w: Writer, shared: Context, solid: str, rgb: Rgb) -> None:
    """Give a solid a colour (ISO 10303-46)."""
    # each entity only wraps the one before: colour, area, surface, side, usage, style, and the solid that has it
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
    """A long list of names in lines of bearable length."""
    return "\n".join(_LINE_OF_NAMES.findall(",".join(part for part in parts if part)))
