"""Checks of a kit's STEP files as text, without a CAD kernel: units, solids, shells, and numbers of entities.

Entities are counted before a kernel reads a file, as a small one can keep it busy for hours.
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from itertools import islice

import numpy as np

from tactape_fab.base.fields import named, shown_path
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.step.assembly import assembly_step
from tactape_fab.solids.step.solid import solid_step
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import WrittenFile

_LONGEST_HEADER = 2_000
_MORE = 1.5
"""Factor on the number of entities of a kind that this version writes, up to which another version may have written a file."""
_SPARE = 50
_COLOUR = re.compile(rb"COLOUR_RGB\('',[\d.,]{1,60}\)")
_KEYWORD = re.compile(rb"(?<![A-Za-z0-9_])([A-Za-z]\w*)\s*\(")
_DATE, _RGB = datetime(1980, 1, 1, tzinfo=timezone.utc), (0.0, 0.0, 0.0)

MOST_UNCERTAINTY_MM, MOST_OF_PART_MM = 1e-5, 0.1
"""Largest uncertainty of points: in a kit, which states 1e-6 mm, and for the user's part, for which OCCT states its mean
tolerance."""
_UNITS = {
    b"(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))",
    b"(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))",
    b"(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())",
}
_UNCERTAINTY = re.compile(rb"UNCERTAINTY_MEASURE_WITH_UNIT\(LENGTH_MEASURE\((\d{1,9}\.\d{0,30}(?:E[+-]?\d{1,3})?)\),")
_ASSIGNED = re.compile(rb"_ASSIGNED_CONTEXT\(\(([#\d,]+)\)\)")
_LONGEST = 1_000
"""Bytes of an entity that are examined; those about units and representations are shorter."""
_AT_ONCE, _ROOM = 1 << 20, bytes(32)
_MOST_DIGITS = 9
"""Most digits of an entity's name: so many fit in 32 bits, and no file of a kit has so many entities."""
_SHELL, _FACE, _BOUND, _LOOP, _USE = 1, 2, 4, 8, 16
_KINDS = {
    # bytes 6 to 13 of a keyword, as the first eight of ADVANCED_FACE are those of other kinds as well
    int.from_bytes(part, "little"): np.uint8(kind)
    for part, kind in {
        **{b"D_SHELL(": _SHELL, b"CED_FACE": _FACE, b"BOUND(''": _BOUND},
        **{b"OUTER_BO": _BOUND, b"LOOP('',": _LOOP, b"TED_EDGE": _USE},
    }.items()
}


@dataclass(frozen=True, slots=True, kw_only=True)
class StepText:
    """The data section of a STEP file, without colours.

    digest: Its SHA-256.
    count: Number of entities by kind.
    plain: Whether it follows a short header, has no comments, and is of ASCII: OCCT passes over other bytes, and others may not.
    """

    digest: bytes
    count: Counter[bytes]
    plain: bool


def step_text(data: bytes) -> StepText:
    """The data section of a STEP file (ISO 10303-21), not parsed."""
    header, _, body = data.partition(b"\nDATA;\n")
    return StepText(
        # colours are not part of the shape, and not known here
        digest=hashlib.sha256(_COLOUR.sub(b"", body)).digest(),
        count=Counter(word.upper() for word in _KEYWORD.findall(body)),
        plain=len(header) < _LONGEST_HEADER and b"/*" not in data and data.isascii(),
    )


def written_steps(tape: Tape, form: SolidForm, files: Mapping[str, WrittenFile]) -> dict[str, StepText]:
    """The STEP files in `files` as this version writes them for the tape, by role."""
    title = f"{tape.name} mould" if form.negative else tape.name
    steps = {"step-solid": step_text(solid_step(tape, form, name=title, date=_DATE, rgb=_RGB))}
    if "step-assembly" in files:
        steps["step-assembly"] = step_text(assembly_step(tape, name=tape.name, date=_DATE, board_rgb=_RGB, part_rgb=_RGB))
    return steps


def foreign_entities(found: StepText, own: StepText) -> str | None:
    """Problem of a STEP file that no version would write for this tape; None if a CAD kernel may read it."""
    if not found.plain:
        return "it has comments, a long header, or a character beyond ASCII"
    # kinds that this version does not write have no entry, so none is allowed
    most = {kind: _MORE * count + _SPARE for kind, count in own.count.items()}
    many = [f"{count} of {kind.decode()[:60]}" for kind, count in found.count.items() if count > most.get(kind, 0)]
    return f"it holds entities that such a tape has no use for: {named(many)}" if many else None


def step_problems(data: bytes, most_mm: float = MOST_UNCERTAINTY_MM) -> list[str]:
    """Problems of a STEP file that do not depend on the tape: its end, comments, units, uncertainty, and solids."""
    whole = data.startswith(b"ISO-10303-21;") and data[-64:].rstrip().endswith(b"END-ISO-10303-21;")  # avoids a large copy
    problems = [] if whole else ["it is no whole ISO 10303-21 file"]
    # the patterns below would match in comments; searching one byte is eight times as fast as two
    if b"/" in data and b"/*" in data:
        problems.append("it has a comment")
    return problems or [*islice(_unit_problems(data, most_mm), 3)]


def _entities(data: bytes, word: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Name and text, without white space and up to `_LONGEST`, of the entities that contain a word."""
    end = 0
    while (at := data.find(word, end)) >= 0:
        start, end = data.rfind(b";", end, at) + 1, data.find(b";", at)
        name, _, text = b"".join(data[start : min(end, start + _LONGEST)].split()).partition(b"=")
        yield name, text


def _unit_problems(data: bytes, most_mm: float) -> Iterator[str]:
    """Problems of units, of the contexts with units, and of the representations of solids in these."""
    known, contexts = dict[bytes, bytes](), dict[bytes, list[bytes]]()
    for name, text in _entities(data, b"UNIT"):
        if (found := _UNCERTAINTY.match(text)) is not None:
            known[name] = b""
            if not float(found[1]) <= most_mm:
                yield f"its points are uncertain by {float(found[1]):g} mm, more than {most_mm:g} mm"
        elif b"GLOBAL_UNIT_ASSIGNED_CONTEXT(" in text:
            contexts[name] = b",".join(_ASSIGNED.findall(text)).split(b",")
        elif text in _UNITS:
            known[name] = text
        elif b"_UNIT(" in text:
            yield f"a unit of it is no millimetre, radian or steradian: {shown_path(text.decode('ascii', 'replace'))}"
    right = {name for name, units in contexts.items() if {known.get(unit) for unit in units} == {b"", *_UNITS}}
    solids, shown, used = list[bytes](), Counter[bytes](), set[bytes]()
    for name, text in _entities(data, b"BREP"):
        if text.startswith((b"MANIFOLD_SOLID_BREP(", b"BREP_WITH_VOIDS(")):
            solids.append(name)
        elif text.startswith(b"ADVANCED_BREP_SHAPE_REPRESENTATION("):
            *items, context = re.findall(rb"#\d+", text) or [b""]
            shown.update(items)
            used.add(context)
    if len(right) != len(contexts) or not used <= right:
        yield "it has shapes whose units are not the millimetre, radian and steradian"
    if not solids or any(shown[solid] != 1 for solid in solids):
        yield "its solids are not each shown once by an ADVANCED_BREP_SHAPE_REPRESENTATION"


def shell_problems(data: bytes) -> Iterator[str]:
    """Problems of closed shells: each bound must be referenced once, and each edge used once in each direction."""
    own, named_by, uses, turned = [], [], [], False
    start = max(data.find(b"\nDATA;\n"), 0)
    while start < len(data):
        end = data.find(b";", start + _AT_ONCE) + 1 or len(data)
        # preceded by a dummy entity, so that every name is in an entity
        chunk = b"".join((b"#0=", _ROOM, data[start:end], _ROOM))
        start, text = end, np.frombuffer(chunk, dtype=np.uint8)
        after = np.flatnonzero(text == ord("#")) + 1
        names, digits = np.zeros(len(after), dtype=np.int32), np.ones(len(after), dtype=bool)
        for _ in range(_MOST_DIGITS):
            digit = text[after] - np.uint8(ord("0"))
            digits &= digit < 10
            names = np.where(digits, names * np.int32(10) + digit, names)
            after += digits
            if not digits.any():
                break
        defined = text[after] == ord("=")
        words = np.ndarray(len(chunk) - 8, dtype="<u8", buffer=chunk, strides=(1,))[after[defined] + 6]
        kinds = sum((words == word) * kind for word, kind in _KINDS.items())
        kind = np.asarray(kinds)[np.cumsum(defined) - 1]
        # only names of entities of these kinds, and references in them
        kept = np.flatnonzero(kind)
        kind, names, after, defined = kind[kept], names[kept], after[kept], defined[kept]
        forward, logical = text[after + 2] == ord("T"), text[after + 1] == ord(".")
        own.append(names[defined & (kind != _SHELL)])
        # in a face the reference before its sense is that of its surface
        named_by.append(names[~defined & (kind != _USE) & ~((kind == _FACE) & logical)])
        use = ~defined & (kind == _USE)
        uses.append(2 * names[use].astype(np.int64) + forward[use])
        turned |= bool((~defined & (kind == _BOUND) & ~forward).any())
    if not np.array_equal(np.sort(np.concatenate(own)), np.sort(np.concatenate(named_by))):
        yield "a face, bound, loop or use of an edge is not named once in its shell"
    both = np.sort(np.concatenate(uses))
    there, back = both[::2], both[1::2]
    if len(there) != len(back) or (there % 2).any() or (back - there != 1).any():
        yield "an edge is not used once in each direction"
    if turned:
        yield "a bound is turned round"
