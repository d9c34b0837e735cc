"""Entities of one element of a STEP solid, as templates: block, spherical cap, truncated cone, on a plane.

Every element has faces of its own, and one bound in the top face (its foot, clockwise there). `flip` reverses all loops
and normals, for a mould.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import atan

import numpy as np

from tactape_fab.solids.elements import block_corners_mm, sphere_radius_mm
from tactape_fab.solids.step.part21 import Step, Template, TextArray, Writer, index_of, real, reals, reversed_steps
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.shapes import outlines_at


@dataclass(frozen=True, slots=True, kw_only=True)
class ElementText:
    """A template, with the indices that the base refers to.

    ``bound`` is the index of the FACE_BOUND of its foot in the top face, ``faces`` are those of its own faces;
    ``columns`` has the texts of every copy.
    """

    template: Template
    bound: int
    faces: tuple[int, ...]
    columns: Mapping[str, TextArray]


class ElementTemplate(Template):
    """A template with vertices, edges, loops and faces, which are reversed for a mould."""

    def __init__(self, *, flip: bool) -> None:
        super().__init__()
        self.flip = flip

    def point(self, *xyz: str) -> str:
        return self.add(f"CARTESIAN_POINT('',({','.join(xyz)}))")

    def vertex(self, point: str) -> str:
        return self.add(f"VERTEX_POINT('',{point})")

    def line_edge(self, start: str, end: str, point: str, vector: str) -> str:
        return self.edge(start, end, self.add(f"LINE('',{point},{vector})"))

    def bound(self, steps: Sequence[Step]) -> str:
        """A bound of steps that are counter-clockwise seen from outside the element."""
        # a FACE_BOUND is valid as a hole of a tile and as the only loop of a face, so no FACE_OUTER_BOUND is needed
        return self.add(f"FACE_BOUND('',{self.loop(reversed_steps(steps) if self.flip else steps)},.T.)")

    def face(self, steps: Sequence[Step], surface: str, *, same_sense: bool = True) -> int:
        """A face of one loop on a surface whose normal points out of the element, or into it without `same_sense`."""
        bound = self.bound(steps)
        # for a mould `turn` rotates the surfaces, and `flip` puts the material on their other side
        return index_of(self.add(f"ADVANCED_FACE('',({bound}),{surface},.{'T' if same_sense != self.flip else 'F'}.)"))


def prism_faces(
    t: ElementTemplate, foot: Sequence[str], top: Sequence[str], rise: Sequence[str], sides: Sequence[str], top_surface: str
) -> tuple[int, tuple[int, ...]]:
    """Bound and faces of a block, from its edges (foot and top counter-clockwise from above, rise upward) and surfaces."""
    count = len(foot)
    # as a hole of the top face the foot is clockwise, with the base's material on the left
    bound = t.bound([(edge, False) for edge in reversed(foot)])
    faces = [
        t.face([(foot[i], True), (rise[(i + 1) % count], True), (top[i], False), (rise[i], False)], sides[i])
        for i in range(count)
    ]
    return index_of(bound), (*faces, t.face([(edge, True) for edge in top], top_surface))


def flat_element(w: Writer, part: TapePart, centres_mm: FloatArray, turn: FloatArray, *, flip: bool) -> ElementText:
    """The element of a flat solid; entities that all copies share are written to `w`.

    centres_mm (n, 2): In the board frame.
    turn (3, 3): From the board frame to the file's: the identity, or for a mould the half turn about board y.
    """
    if part.shape == "block":
        return _flat_block(w, part, centres_mm, turn, flip=flip)
    return _flat_dome(w, part, centres_mm, turn, flip=flip)


def _flat_block(w: Writer, part: TapePart, centres_mm: FloatArray, turn: FloatArray, *, flip: bool) -> ElementText:
    corners = block_corners_mm(part)
    along = np.column_stack([np.roll(corners, -1, axis=0) - corners, np.zeros(4)])
    along = along / np.linalg.norm(along, axis=1, keepdims=True) @ turn.T
    up = turn @ (0.0, 0.0, 1.0)
    up_name, along_names = w.direction(up), [w.direction(d) for d in along]
    vectors = [w.add(f"VECTOR('',{d},1.)") for d in along_names]
    up_vector = w.add(f"VECTOR('',{up_name},1.)")
    # any point of the plane suffices; this one is above the origin
    top_mm = turn @ (0.0, 0.0, part.body_mm[2])
    top_plane = w.add(f"PLANE('',{w.axes(w.point(top_mm), up_name, along_names[0])})")

    t = ElementTemplate(flip=flip)
    points = [[t.point(f"<x{k}>", f"<y{k}>", z) for k in range(4)] for z in ("0.", real(top_mm[2]))]
    foot, top = [[t.vertex(p) for p in level] for level in points]
    foot_edges, top_edges = [
        [t.line_edge(level[k], level[(k + 1) % 4], points[i][k], vectors[k]) for k in range(4)]
        for i, level in enumerate((foot, top))
    ]
    rise = [t.line_edge(foot[k], top[k], points[0][k], up_vector) for k in range(4)]
    # the outward normal of a side is the direction of the previous side
    sides = [t.add(f"PLANE('',{t.axes(points[0][k], along_names[k - 1], up_name)})") for k in range(4)]
    bound, faces = prism_faces(t, foot_edges, top_edges, rise, sides, top_plane)
    xy = outlines_at(centres_mm, corners)
    texts_x, texts_y = reals(xy[..., 0] * turn[0, 0]), reals(xy[..., 1])
    # the half turn about y negates x and z: z is in the template, x is negated here
    columns = {f"x{k}": texts_x[:, k] for k in range(4)} | {f"y{k}": texts_y[:, k] for k in range(4)}
    return ElementText(template=t, bound=bound, faces=faces, columns=columns)


def _flat_dome(w: Writer, part: TapePart, centres_mm: FloatArray, turn: FloatArray, *, flip: bool) -> ElementText:
    """A spherical cap or a truncated cone, with a seam up to the cap's pole or the cone's top."""
    foot_mm, height_mm = part.body_mm[0] / 2, part.body_mm[2]
    up, east = w.direction(turn[:, 2]), w.direction(turn[:, 0])
    down, south = w.direction(-turn[:, 2]), w.direction(-turn[:, 1])

    def z(value_mm: float) -> str:
        return real(turn[2, 2] * value_mm)

    t = ElementTemplate(flip=flip)
    rim = t.point("<e>", "<y>", "0.")
    start = t.vertex(rim)
    circle = t.add(f"CIRCLE('',{t.axes(t.point('<x>', '<y>', '0.'), up, east)},{real(foot_mm)})")
    foot = t.edge(start, start, circle)
    bound = index_of(t.bound([(foot, False)]))
    if part.top_mm is None:
        sphere_mm = sphere_radius_mm(part)
        centre = t.point("<x>", "<y>", z(height_mm - sphere_mm))
        # the circle's y is axis x ref = south x east = up, so its angle increases from the foot's east point to the pole
        meridian = t.add(f"CIRCLE('',{t.axes(centre, south, east)},{real(sphere_mm)})")
        seam = t.edge(start, t.vertex(t.point("<x>", "<y>", z(height_mm))), meridian)
        sphere = t.add(f"SPHERICAL_SURFACE('',{t.axes(centre, up, east)},{real(sphere_mm)})")
        # up the seam and down again, as kernels require a seam on a closed surface, and a vertex at the pole
        faces: tuple[int, ...] = (t.face([(foot, True), (seam, True), (seam, False)], sphere),)
    else:
        top_mm = part.top_mm / 2
        slant = np.array([top_mm - foot_mm, 0.0, height_mm]) @ turn.T
        vector = w.add(f"VECTOR('',{w.direction(slant / np.linalg.norm(slant))},1.)")
        top_vertex = t.vertex(t.point("<t>", "<y>", z(height_mm)))
        middle = t.point("<x>", "<y>", z(height_mm))
        rim_axes = t.axes(middle, up, east)
        top = t.edge(top_vertex, top_vertex, t.add(f"CIRCLE('',{rim_axes},{real(top_mm)})"))
        seam = t.line_edge(start, top_vertex, rim, vector)
        angle = real(atan((foot_mm - top_mm) / height_mm))
        # the axis points down, in which direction the cone widens from the top's radius at its origin
        cone = t.add(f"CONICAL_SURFACE('',{t.axes(middle, down, east)},{real(top_mm)},{angle})")
        side = t.face([(foot, True), (seam, True), (top, False), (seam, False)], cone)
        faces = (side, t.face([(top, True)], t.add(f"PLANE('',{rim_axes})")))
    x, y = (centres_mm * (turn[0, 0], 1.0)).T
    columns = {"x": reals(x), "y": reals(y), "e": reals(x + turn[0, 0] * foot_mm)}
    if part.top_mm is not None:
        columns["t"] = reals(x + turn[0, 0] * part.top_mm / 2)
    return ElementText(template=t, bound=bound, faces=faces, columns=columns)
