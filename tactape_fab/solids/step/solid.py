"""One fused solid of base and elements as STEP AP214 text (B-rep), without a CAD kernel or boolean operations.

Elements never cross the border of their grid cell, so the topology is known beforehand: a manifold solid (ISO 10303-42), in
which every edge is shared by exactly two faces.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from itertools import groupby, pairwise
from math import cos, sin

import numpy as np

from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.step.cylinder import CylinderBase
from tactape_fab.solids.step.element_faces import ElementText, flat_element
from tactape_fab.solids.step.mark_faces import MarkedBase, entities_of_mark
from tactape_fab.solids.step.part21 import (
    MOST_OF_FRAME,
    TRAILER,
    Rgb,
    Writer,
    coloured,
    context,
    fill,
    first_name,
    header,
    names,
    product,
    real,
    wrapped_names,
)
from tactape_fab.solids.step.tiles import Arc, MapEdge, top_map
from tactape_fab.solids.step.wrapped_element_faces import cylinder_element
from tactape_fab.solids.wrap import world, wrap_of
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.tape import Tape


def solid_step(tape: Tape, form: SolidForm, *, name: str, date: datetime, rgb: Rgb) -> bytes:
    """STEP file of a tape's solid; see `solid_step_chunks`."""
    return b"".join(solid_step_chunks(tape, form, name=name, date=date, rgb=rgb))


def solid_step_chunks(tape: Tape, form: SolidForm, *, name: str, date: datetime, rgb: Rgb) -> Iterator[bytes]:
    """STEP file of a tape's solid, in pieces.

    tape: Gives outline, holes, and an element at every placed part.
    form: Base, mould, tiles, cylinder; `checks.form_problems` must have found nothing.
    name: Name of the product.
    date: Date in the file's header.
    rgb: Colour of the solid, each from 0 to 1.
    Yields: Board frame, mm; z = 0 is the top of the base.
    """
    w = Writer()
    shared = context(w)
    base: FlatBase | CylinderBase
    if form.cylinder is None:
        element = flat_element(w, tape.part, tape.part_xy_mm(), world(form), flip=form.negative)
        base = FlatBase(w, tape, form)
    else:
        wrap = wrap_of(tape, form, form.cylinder)
        element = cylinder_element(tape, wrap, flip=form.negative)
        base = CylinderBase(w, tape, form, wrap)
    size, count = len(element.template), tape.part_count
    # the base's faces refer to the elements' bounds before these are written, so their numbers start at an upper bound
    first = first_name(w.next + base.entities_to_come + MOST_OF_FRAME, count, size)
    faces = base.faces(element_bounds(first, element, base.tile_of_part))
    own = (first + np.arange(count)[:, None] * size + np.array(element.faces)).ravel()
    # OCCT 7.6 assembles a shell by adjacency, and is fast if each face follows an adjacent one: with the base before the
    # elements FreeCAD 0.20 takes 4.9 s for 2,178 blocks, in another order 23.8 s
    shell = w.add(f"CLOSED_SHELL('',({wrapped_names([*faces, names(0, own)])}))")
    solid = w.add(f"MANIFOLD_SOLID_BREP('',{shell})")
    axes = w.placement((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    shape = w.add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',({axes},{solid}),{shared.geometry})")
    _, definition_shape = product(w, shared, name)
    w.add(f"SHAPE_DEFINITION_REPRESENTATION({definition_shape},{shape})")
    coloured(w, shared, solid, rgb)
    assert w.next <= first
    yield header(name, date)
    yield w.text()
    yield from fill(element.template, first, count, element.columns)
    yield TRAILER


def element_bounds(first: int, element: ElementText, tile_of_part: IntArray) -> list[str]:
    """For each tile, the names of the bounds of its elements."""
    # grouped by tile, then in the order of parts; slices of one long text, as all names have equal width
    order = np.argsort(tile_of_part, kind="stable")
    bounds = first + order * len(element.template) + element.bound
    width = len(f"#{first},")  # all names have as many digits
    ends = np.cumsum([0, *np.bincount(tile_of_part)]) * width
    text = names(0, bounds) + ","
    return [text[begin : end - 1] for begin, end in pairwise(ends.tolist())]


class FlatBase(MarkedBase):
    """The base of a flat solid: edges are written by the constructor, faces once the elements have their names."""

    def __init__(self, w: Writer, tape: Tape, form: SolidForm) -> None:
        super().__init__(w, tape, form, 0.0)
        self._map, self._turn = top_map(tape, tiled=form.top == "tiles"), world(form)
        self._vertices = {i: w.vertex(self._point(xy, 0.0)) for i, xy in enumerate(self._map.vertices_mm)}
        self._edges = [self._edge(edge, self._vertices, 0.0) for edge in self._map.edges]
        self.tile_of_part = self._map.tile_of_part
        # an ORIENTED_EDGE for each step of a tile's loops; a wall below a step of a rim takes at most 28 entities
        steps = sum(len(loop) for tile in self._map.tiles for loop in tile) + 8 * sum(map(len, self._map.rims))
        self.entities_to_come = steps + 4 * len(self._map.tiles) + 20 * sum(map(len, self._map.rims)) + 50
        self.entities_to_come += entities_of_mark(self._mark)

    def _point(self, ab: Sequence[float] | FloatArray, level: float) -> FloatArray:
        return self._turn @ (*ab, level)

    def _axes(self, xy: tuple[float, float], z: float, angle_rad: float) -> str:
        """A placement about the upward axis, with its angle 0 at `angle_rad`."""
        ref = self._turn @ (cos(angle_rad), sin(angle_rad), 0.0)
        return self._w.placement(self._point(xy, z), self._turn[:, 2], ref)

    def _edge(self, edge: MapEdge, vertices: Mapping[int, str], z: float) -> str:
        start, end, arc = vertices[edge.start], vertices[edge.end], edge.arc
        if arc is None:
            a, b = (self._point(self._map.vertices_mm[v], z) for v in (edge.start, edge.end))
            return self._w.line_edge(start, end, a, b)
        circle = self._w.add(f"CIRCLE('',{self._axes(arc.centre_mm, z, arc.start_rad)},{real(arc.radius_mm)})")
        return self._w.edge(start, end, circle)

    def faces(self, bounds_of_tile: Sequence[str]) -> list[str]:
        """All faces of the base, each after an adjacent one: back, walls, tiles."""
        walls, back_loops = self._walls()
        sunk_loops, sunk = self._mark_faces(np.eye(2), same_sense=not self._flip)
        # the plane's normal is -z of the texture's frame: out of a texture, into a mould, whose base is above its cavities
        back = self._w.face([*back_loops, *sunk_loops], self._level(self._back_mm), same_sense=not self._flip)
        top = self._plane(0.0, upward=True)
        tiles = []
        for tile, loops in enumerate(self._map.tiles):
            outer, *inner = [self._loop([(self._edges[i], forward) for i, forward in loop]) for loop in loops]
            bounds = bounds_of_tile[tile] if tile < len(bounds_of_tile) else ""
            listed = [wrapped_names([bounds])] if bounds else []
            # all tiles are on one PLANE; coplanar faces that share edges form a valid shell
            tiles.append(self._w.face([outer, *inner], top, bounds=listed, same_sense=not self._flip))
        return [back, *sunk, *walls, *tiles]

    def _mark_edge(self, start: str, end: str, p: FloatArray, q: FloatArray, level: float) -> str:
        return self._w.line_edge(start, end, self._point(p, level), self._point(q, level))

    def _mark_wall(self, p: FloatArray, q: FloatArray) -> str:
        along = (q - p) / np.linalg.norm(q - p)
        normal = self._turn @ (-along[1], along[0], 0.0)
        return self._w.add(f"PLANE('',{self._w.placement(self._point(p, self._back_mm), normal, self._turn[:, 2])})")

    def _level(self, level: float) -> str:
        return self._plane(level, upward=False)

    def _plane(self, z: float, *, upward: bool) -> str:
        normal = self._turn[:, 2] if upward else -self._turn[:, 2]
        return self._w.add(f"PLANE('',{self._w.placement(self._turn @ (0.0, 0.0, z), normal, self._turn[:, 0])})")

    def _walls(self) -> tuple[list[str], list[str]]:
        """A wall below each side, corner and hole, and the loops of the back, that of the outline first."""
        walls, back_loops = [], []
        for rim in self._map.rims:
            # tile lines cut the rim of the top, not that of the back: one wall and one edge of the back per side or corner
            groups = [list(g) for _, g in groupby(rim, key=lambda step: self._map.edges[step[0]].wall)]
            corners = [self._ends(group[0])[0] for group in groups]
            lower = {v: self._w.vertex(self._point(self._map.vertices_mm[v], self._back_mm)) for v in corners}
            rises = {v: self._rise(v, lower[v]) for v in corners}
            back: list[tuple[str, bool]] = []
            for group, start, end in zip(groups, corners, [*corners[1:], corners[0]], strict=True):
                edge, forward = self._back_edge(group, start, end, lower)
                # along the rim on the back, up, against it on the top, and down: the normal is on the rim's right, outward
                steps = [(edge, forward), (rises[end], True)]
                steps += [(self._edges[i], not f) for i, f in reversed(group)]
                loop = self._loop([*steps, (rises[start], False)])
                walls.append(self._wall(group, loop))
                back.append((edge, not forward))
            back_loops.append(self._loop(back[::-1]))
        return walls, back_loops

    def _ends(self, step: tuple[int, bool]) -> tuple[int, int]:
        edge = self._map.edges[step[0]]
        return (edge.start, edge.end) if step[1] else (edge.end, edge.start)

    def _rise(self, vertex: int, lower: str) -> str:
        xy = self._map.vertices_mm[vertex]
        return self._w.line_edge(lower, self._vertices[vertex], self._point(xy, self._back_mm), self._point(xy, 0.0))

    def _back_edge(self, group: list[tuple[int, bool]], start: int, end: int, lower: dict[int, str]) -> tuple[str, bool]:
        """The edge of the back below a side or corner of a rim, and whether it has the rim's direction."""
        forward = group[0][1]
        a, b = (start, end) if forward else (end, start)
        arcs = [arc for i, _ in group if (arc := self._map.edges[i].arc) is not None]
        arc = None
        if arcs:
            first, last = (arcs[0], arcs[-1]) if forward else (arcs[-1], arcs[0])
            arc = Arc(centre_mm=first.centre_mm, radius_mm=first.radius_mm, start_rad=first.start_rad, end_rad=last.end_rad)
        edge = MapEdge(start=a, end=b, arc=arc, wall=None)
        return self._edge(edge, lower, self._back_mm), forward

    def _wall(self, group: list[tuple[int, bool]], loop: str) -> str:
        """A wall on a plane or cylinder; the material around a hole is outside the cylinder."""
        edge = self._map.edges[group[0][0]]
        if edge.arc is None:
            a, b = (np.array(self._map.vertices_mm[v]) for v in (edge.start, edge.end))
            along = (b - a) / np.linalg.norm(b - a)
            # right of an edge with the material on its left; also for a mould, for which only the loop is reversed
            normal = self._turn @ (along[1], -along[0], 0.0)
            plane = self._w.placement(self._point(a, 0.0), normal, self._turn[:, 2])
            return self._w.face([loop], self._w.add(f"PLANE('',{plane})"))
        first = min((arc.start_rad for i, _ in group if (arc := self._map.edges[i].arc) is not None))
        axes = self._axes(edge.arc.centre_mm, 0.0, first)
        surface = self._w.add(f"CYLINDRICAL_SURFACE('',{axes},{real(edge.arc.radius_mm)})")
        # the surface's normal points away from its axis: out of a rounded corner, into the material around a hole
        return self._w.face([loop], surface, same_sense=not edge.hole)
