"""Layers of the map from the bottom up: shapes of the written files with their colours (board frame, mm)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactape_fab.kit.read.gerber_file import GerberShapes
from tactape_fab.kit.read.readback import read_drill
from tactape_fab.kit.read.written_gerber import read_shapes
from tactape_fab.kit.render.colours import (
    BACKING_COLOURS,
    BASE_FILM,
    BODY,
    COVERLAY_COLOURS,
    GOLD,
    LEGEND_COLOURS,
    TERMINAL,
    TEXTURE,
)
from tactape_fab.kit.render.preview import body_outline, stamps, terminals_of
from tactape_fab.report.arrays import packed, packed_paths
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.shapes import placed_outline, rotate, rounded_rectangle
from tactape_fab.texture.tape import Tape

PASTE = "#aab2bd"
ELEMENT = "#59616b"
EDGE = "#6b4a12"
CUT = ""
"""In place of a colour: the shape is cut out of everything below it."""

TITLES: Mapping[str, str] = {
    "profile": "Film and outline",
    "adhesive-bottom": "Adhesive, below",
    "stiffener-bottom": "Stiffener, below",
    "coverlay-top": "Coverlay",
    "copper-top": "Copper",
    "paste-top": "Paste",
    "legend-top": "Legend",
    "bodies": "Bodies",
    "drill-npth": "Holes and slots",
}
"""Layers that can be switched, in the order of their switches."""
HIDDEN = ("paste-top",)
"""Layers that are hidden at the start."""

Stamp = tuple[FloatArray, FloatArray | None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shapes:
    """Shapes of one layer and colour: outlines repeated at places (None for every part), polygons, lines of one width."""

    layer: str
    fill: str | None = None
    stroke: str | None = None
    stroke_mm: float = 0.0
    stamps: Sequence[Stamp] = ()
    polygons: Sequence[FloatArray] = ()
    lines: Sequence[FloatArray] = ()

    def to_mapping(self) -> dict[str, Any]:
        """Data for the page's script."""
        return {
            "layer": self.layer,
            "fill": self.fill,
            "stroke": self.stroke,
            "stroke_mm": self.stroke_mm,
            "stamps": [
                {"outline": packed(outline, "<f4"), "xy": None if xy is None else packed(xy, "<f4")}
                for outline, xy in self.stamps
            ],
            "polygons": packed_paths(self.polygons),
            "lines": packed_paths(self.lines),
        }


def layer_switches(shapes: Sequence[Shapes], titles: Mapping[str, str] = TITLES) -> list[dict[str, Any]]:
    """Switches for the layers that have shapes, for the page's script."""
    layers = {shape.layer for shape in shapes}
    return [{"id": layer, "title": titles[layer], "shown": layer not in HIDDEN} for layer in TITLES if layer in layers]


def film_shapes(files: Mapping[str, bytes], cpl: CplContent, colours: Mapping[str, Any]) -> Iterator[Shapes]:
    """A film from its lowest layer up, from its Gerber files, drill file and CPL.

    files: Bytes by role.
    cpl: The content of the CPL.
    colours: The manifest's ``fab``, with the colours of coverlay and legend.
    """
    outline, *slots = read_shapes(files["profile"]).strokes_mm
    film, edge = COVERLAY_COLOURS[str(colours["coverlay_colour"])]
    openings, copper = read_shapes(files["coverlay-top"]), read_shapes(files["copper-top"])
    # the adhesive, by which the tape sticks to an object, is the lowest layer
    for role in ("adhesive-bottom", "stiffener-bottom"):
        if role in files:
            areas = read_shapes(files[role]).areas_mm
            yield Shapes(layer=role, fill=BACKING_COLOURS[role], stroke=BACKING_COLOURS[role], stroke_mm=0.6, polygons=areas)
    yield Shapes(layer="profile", fill=BASE_FILM, polygons=[outline])
    yield Shapes(layer="coverlay-top", fill=film, polygons=[outline])
    yield from _lines("copper-top", edge, copper)
    yield Shapes(layer="coverlay-top", fill=BASE_FILM, stamps=stamps(openings), polygons=openings.areas_mm)
    yield Shapes(layer="copper-top", fill=GOLD, stamps=stamps(copper))
    paste = read_shapes(files["paste-top"])
    yield Shapes(layer="paste-top", fill=PASTE, stamps=stamps(paste), polygons=paste.areas_mm)
    if "legend-top" in files:
        legend, ink = read_shapes(files["legend-top"]), LEGEND_COLOURS[str(colours["legend_colour"])]
        yield Shapes(layer="legend-top", fill=ink, polygons=legend.areas_mm)
        yield from _lines("legend-top", ink, legend)
    body = body_outline(files["components-top"])
    yield Shapes(layer="bodies", fill=BODY, stamps=list(_turned(body, cpl)))
    yield Shapes(layer="bodies", fill=TERMINAL, stamps=[s for end in terminals_of(body) for s in _turned(end, cpl)])
    holes = read_drill(files["drill-npth"]) if "drill-npth" in files else np.empty((0, 3))
    cuts = [*(_circle((x, y), d / 2) for x, y, d in holes), *slots]
    if cuts:
        yield Shapes(layer="drill-npth", fill=CUT, stroke=EDGE, stroke_mm=0.05, polygons=cuts)
    yield Shapes(layer="profile", stroke=EDGE, stroke_mm=0.1, polygons=[outline])


def solid_shapes(tape: Tape) -> Iterator[Shapes]:
    """A texture of solid elements: its base and the elements' feet, from the manifest."""
    board, part = tape.board, tape.part
    middle = np.array(board.size_mm) / 2
    outline = rounded_rectangle(board.size_mm, board.corner_radius_mm) + middle
    if part.shape == "block":
        foot = placed_outline((part.body_mm[0], part.body_mm[1]), 0.0, part.rotation_deg)
    else:
        foot = _circle((0.0, 0.0), part.body_mm[0] / 2)
    yield Shapes(layer="profile", fill=TEXTURE, polygons=[outline])
    yield Shapes(layer="bodies", fill="#f4f6f8", stroke=ELEMENT, stroke_mm=0.03, stamps=[(foot, None)])
    if board.holes:
        cuts = [_circle((x, y), d / 2) for x, y, d in board.holes]
        yield Shapes(layer="drill-npth", fill=CUT, stroke=ELEMENT, stroke_mm=0.05, polygons=cuts)
    yield Shapes(layer="profile", stroke=ELEMENT, stroke_mm=0.1, polygons=[outline])


def _lines(layer: str, colour: str, content: GerberShapes) -> Iterator[Shapes]:
    """Lines of a layer, grouped by width."""
    for width_mm in sorted(set(content.stroke_width_mm.tolist())):
        drawn = [content.strokes_mm[i] for i in np.flatnonzero(content.stroke_width_mm == width_mm)]
        yield Shapes(layer=layer, stroke=colour, stroke_mm=width_mm, lines=drawn)


def _turned(outline: FloatArray, cpl: CplContent) -> Iterator[Stamp]:
    """An outline at every part, turned by the rotation in its CPL row."""
    # one stamp if all parts have the same rotation, so that their places are sent once
    angles = sorted(set(cpl.rotation_deg.tolist()))
    for angle in angles:
        yield rotate(outline, angle), None if len(angles) == 1 else cpl.xy_mm[cpl.rotation_deg == angle]


def _circle(centre_mm: tuple[float, float], radius_mm: float) -> FloatArray:
    angle = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    return np.asarray(centre_mm) + radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1)
