"""The fab drawing's outline, slots, holes, field, tag and label as DXF, to lay under a fab's or a robot's own CAD."""

from __future__ import annotations

import io
from collections.abc import Iterable
from typing import Any

import numpy as np

from tactape_fab.base.libraries import library
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.film.drawing import Drawing
from tactape_fab.kit.order_facts import Box, OrderFacts
from tactape_fab.texture.frames import FloatArray

LAYERS = {"OUTLINE": 7, "SLOTS": 7, "HOLES": 1, "FIELD": 5, "NUMBER": 3, "TAG": 8, "LABEL": 8}
"""Layers and their colours of the AutoCAD colour index; NUMBER is where a fab may print its own."""
_MILLIMETRES, _VERSION = 4, "R2010"  # $INSUNITS, and the oldest format with it that all programs of today write


def render_fab_dxf(facts: OrderFacts, drawing: Drawing) -> tuple[Artifact]:
    """Layers of a tape or a panel in the board frame, mm; the same bytes every time."""
    ezdxf = library("ezdxf", "the DXF drawing")
    stream, fixed = io.StringIO(), ezdxf.options.write_fixed_meta_data_for_testing
    ezdxf.options.write_fixed_meta_data_for_testing = True  # else it writes the time and random identifiers
    try:
        document = ezdxf.new(_VERSION, units=_MILLIMETRES)
        _draw(document, facts, drawing)
        for name in sorted(document.entitydb.dxf_types_in_use()):  # it would enter them in the order of a set
            document.classes.add_class(name)
        document.write(stream)
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = fixed
    data = stream.getvalue().encode(document.output_encoding)
    return (Artifact(role="fab-dxf", path=f"{drawing.name}-drawing.dxf", data=data),)


def _draw(document: Any, facts: OrderFacts, drawing: Drawing) -> None:
    for layer, colour in LAYERS.items():
        document.layers.add(layer, color=colour)
    space = document.modelspace()

    def draw(layer: str, lines_mm: Iterable[FloatArray], *, closed: bool = True) -> None:
        for line in lines_mm:
            points = np.asarray(line).round(6).tolist()
            if closed and points[0] == points[-1]:
                points.pop()
            space.add_lwpolyline(points, close=closed, dxfattribs={"layer": layer})

    draw("OUTLINE", [drawing.outline_mm])
    draw("SLOTS", drawing.slots_mm)
    for x, y, diameter in drawing.holes:
        space.add_circle((x, y), diameter / 2, dxfattribs={"layer": "HOLES"})
    draw("FIELD", [_corners(field) for field, _ in facts.fields_mm])
    draw("NUMBER", [_corners(area) for _, area in facts.fields_mm if area is not None])
    draw("TAG", drawing.legend.areas_mm)
    draw("LABEL", drawing.legend.strokes_mm, closed=False)


def _corners(box: Box) -> FloatArray:
    left, low, right, high = box
    return np.array([(left, low), (right, low), (right, high), (left, high)])
