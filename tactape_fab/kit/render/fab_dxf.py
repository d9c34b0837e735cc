"""Outline, slots, holes, field, tag and label as DXF, as a reference for CAD of a fab or of a robot.

ASCII DXF of release 12 (group codes and entities as in Autodesk's DXF reference), which every program reads; the unit is in
$INSUNITS, which present programs read.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.film.drawing import Drawing
from tactape_fab.kit.order_facts import Box, OrderFacts
from tactape_fab.texture.frames import FloatArray

LAYERS = {"OUTLINE": 7, "SLOTS": 7, "HOLES": 1, "FIELD": 5, "NUMBER": 3, "TAG": 8, "LABEL": 8}
"""Layers, and their colours by AutoCAD colour index; NUMBER is the area where the fab may print its order number."""
_MILLIMETRES = 4  # $INSUNITS

Tags = Iterator[tuple[int, str | int]]
"""Group codes and their values."""


def render_fab_dxf(facts: OrderFacts, drawing: Drawing) -> tuple[Artifact]:
    """DXF of a tape or a panel in the board frame, mm."""
    # group codes are right-aligned in three columns, each value is on the next line
    text = "".join(f"{code:3d}\n{value}\n" for code, value in _document(facts, drawing))
    return (Artifact(role="fab-dxf", path=f"{drawing.name}-drawing.dxf", data=text.encode("ascii")),)


def _document(facts: OrderFacts, drawing: Drawing) -> Tags:
    yield from (
        (0, "SECTION"),
        (2, "HEADER"),
        (9, "$ACADVER"),
        (1, "AC1009"),
        (9, "$INSUNITS"),
        (70, _MILLIMETRES),
        (0, "ENDSEC"),
    )
    yield from ((0, "SECTION"), (2, "TABLES"), (0, "TABLE"), (2, "LAYER"), (70, len(LAYERS)))
    for layer, colour in LAYERS.items():
        yield from ((0, "LAYER"), (2, layer), (70, 0), (62, colour), (6, "CONTINUOUS"))
    yield from ((0, "ENDTAB"), (0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES"))
    yield from _polyline("OUTLINE", drawing.outline_mm)
    for slot in drawing.slots_mm:
        yield from _polyline("SLOTS", slot)
    for x, y, diameter in drawing.holes:
        yield from ((0, "CIRCLE"), (8, "HOLES"), *_point(x, y), (40, _number(diameter / 2)))
    for field, number in facts.fields_mm:
        yield from _polyline("FIELD", _corners(field))
        if number is not None:
            yield from _polyline("NUMBER", _corners(number))
    for area in drawing.legend.areas_mm:
        yield from _polyline("TAG", area)
    for stroke in drawing.legend.strokes_mm:
        yield from _polyline("LABEL", stroke, closed=False)
    yield from ((0, "ENDSEC"), (0, "EOF"))


def _polyline(layer: str, line_mm: FloatArray, *, closed: bool = True) -> Tags:
    points = np.asarray(line_mm).round(6).tolist()
    # the flag (70, 1) closes the polyline, so that a repeated vertex would be a line of length 0
    if closed and points[0] == points[-1]:
        points.pop()
    # 66: vertices follow; 10, 20, 30 of the polyline itself are a dummy point, always 0
    yield from ((0, "POLYLINE"), (8, layer), (66, 1))
    yield from _point(0.0, 0.0)
    yield 70, int(closed)
    for x, y in points:
        yield from ((0, "VERTEX"), (8, layer), *_point(x, y))
    yield from ((0, "SEQEND"), (8, layer))


def _point(x: float, y: float) -> Tags:
    yield from ((10, _number(x)), (20, _number(y)), (30, "0.0"))


def _number(value_mm: float) -> str:
    return f"{value_mm + 0.0:.6f}"  # no negative zero


def _corners(box: Box) -> FloatArray:
    left, low, right, high = box
    return np.array([(left, low), (right, low), (right, high), (left, high)])
