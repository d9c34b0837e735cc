"""A tape as a rigid body for simulators: mesh with texture coordinates, convex collision shapes, mass and inertia.

Everything is in the kit's frame (board frame; for an embossed part that of the part's file) and in SI units: m, kg.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, pi, radians

import numpy as np

from tactape_fab.base.libraries import library
from tactape_fab.solids.elements import element_volume_mm3
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mesh.sheet import texture_mesh
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.wrap import Wrap, unwrapped, wrap_of
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape

FILM_KG_M3 = 1420.0
"""Density of polyimide (DuPont, data sheet of Kapton HN)."""
CHIP_KG_M3 = 3900.0
"""Density of 96 % alumina, the material of chip resistors: 0.16 mg for an 0201."""
PRINTED_KG_M3 = 1200.0
"""Density of printed parts: cured resins and plastics have 1100 to 1250."""
_MOST_SLICE_RAD = pi / 18
_M = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """A collision box: centre and half sides, m, and rotation as a vector: axis times angle in rad."""

    centre: tuple[float, float, float]
    half: tuple[float, float, float]
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """A frame on a flat body: origin, m, and angle of its x axis from the body's; its z axis points into the tape."""

    name: str
    origin: tuple[float, float, float]
    turn_rad: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """A rigid body.

    mesh: Visual mesh, mm.
    uv (v, 2): Texture coordinates of its vertices: (0, 0) is the board's lower left corner, (1, 1) its upper right one.
    boxes: Collision shapes, which together form the base without elements.
    hull: Collision shape in place of boxes.
    centre (3,): Centre of mass.
    inertia (3, 3): Inertia about it, along the body's axes.
    """

    name: str
    mesh: Mesh
    uv: FloatArray | None
    boxes: Sequence[Box]
    hull: Mesh | None
    mass: float
    centre: FloatArray
    inertia: FloatArray
    frames: Sequence[Frame] = ()


def tape_body(tape: Tape, form: SolidForm | None) -> Body:
    """A tape as a body: a film with its parts, or a texture of solid elements (`form`), flat or on a cylinder."""
    shape = SolidForm(base_mm=tape.board.thickness_mm) if form is None else form
    mesh = texture_mesh(tape, shape)
    board = unwrapped(mesh.vertices_mm, tape, shape)
    wrap = None if shape.cylinder is None else wrap_of(tape, shape, shape.cylinder)
    boxes = [_film_box(tape, shape.base_mm)] if wrap is None else _slices(wrap, shape.base_mm)
    mass, centre, inertia = _film_mass(tape) if form is None else solid_mass(mesh, PRINTED_KG_M3)
    return Body(
        name=tape.name,
        mesh=mesh,
        uv=np.clip(board[:, :2] / tape.board.size_mm, 0.0, 1.0),
        boxes=boxes,
        hull=None,
        mass=mass,
        centre=centre,
        inertia=inertia,
        frames=_frames(tape) if wrap is None else (),
    )


def part_body(name: str, mesh: Mesh) -> Body:
    """A texture on the user's own part as a body, with its convex hull for collisions and the density of a printed part."""
    hull = library("trimesh", "a part's convex hull").Trimesh(mesh.vertices_mm, mesh.faces, process=False).convex_hull
    mass, centre, inertia = solid_mass(mesh, PRINTED_KG_M3)
    around = Mesh(vertices_mm=np.asarray(hull.vertices, dtype=np.float64), faces=np.asarray(hull.faces, dtype=np.int64))
    return Body(name=name, mesh=mesh, uv=None, boxes=(), hull=around, mass=mass, centre=centre, inertia=inertia)


def _film_box(tape: Tape, base_mm: float) -> Box:
    width, height = (_M * side for side in tape.board.size_mm)
    return Box(centre=(width / 2, height / 2, -_M * base_mm / 2), half=(width / 2, height / 2, _M * base_mm / 2))


def _slices(wrap: Wrap, base_mm: float) -> list[Box]:
    """A cylinder's wall as boxes that are tangent to its outside at their middles."""
    first, last = (-pi, pi) if wrap.cylinder.shell == "whole" else wrap.ends_rad
    # at most ten degrees: corners of a box protrude by R (1 / cos 5 deg - 1), 0.4 % of the radius
    count = ceil((last - first) / _MOST_SLICE_RAD)
    step, along = (last - first) / count, wrap.turn[:, 1]
    # tangents at the middles of two neighbours meet at R tan(step / 2), so that the outer faces join without a gap
    half = _M * np.array([wrap.radius_mm * np.tan(step / 2), (wrap.b_mm[1] - wrap.b_mm[0]) / 2, base_mm / 2])
    boxes = []
    for angle in first + step * (np.arange(count) + 0.5):
        centre = _M * wrap.point(angle, sum(wrap.b_mm) / 2, wrap.radius_mm - base_mm / 2)
        sides = np.abs(wrap.turn) @ half  # the unrotated box is parallel to the file's axes
        # rotation about the cylinder's axis in the file's frame, from the middle line
        turn = along * angle
        x, y, z = centre.tolist()
        boxes.append(Box(centre=(x, y, z), half=(sides[0], sides[1], sides[2]), turn=(turn[0], turn[1], turn[2])))
    return boxes


def _film_mass(tape: Tape) -> tuple[float, FloatArray, FloatArray]:
    """Mass, centre of mass and inertia of a film as a box with its parts as point masses."""
    size = _M * np.array([*tape.board.size_mm, tape.board.thickness_mm])
    # corners and holes are ignored: corners of 1 mm are 0.02 % of a board of 100 x 50 mm
    film = FILM_KG_M3 * float(size.prod())
    middle = size * (0.5, 0.5, -0.5)
    part = CHIP_KG_M3 * element_volume_mm3(tape.part) * _M**3
    points = _M * np.column_stack([tape.part_xy_mm(), np.full(tape.part_count, tape.part.body_mm[2] / 2)])
    mass = film + part * len(points)
    centre = (film * middle + part * points.sum(axis=0)) / mass
    # inertia of a box: m (b^2 + c^2) / 12 about the axis along a
    own = film * np.diag(float(size @ size) - size * size) / 12
    return mass, centre, own + _steiner(film, (middle - centre)[None]) + _steiner(part, points - centre)


def _steiner(mass: float, offsets: FloatArray) -> FloatArray:
    """Inertia of equal point masses at offsets, (n, 3)."""
    second = offsets.T @ offsets
    # sum of m (r^2 1 - r r^T)
    return np.asarray(mass * (np.trace(second) * np.eye(3) - second))


def solid_mass(mesh: Mesh, density: float) -> tuple[float, FloatArray, FloatArray]:
    """Mass, centre of mass, and inertia about it, of the solid inside a closed mesh, in kg and m, as a sum of tetrahedra.

    Tonon, "Explicit exact formulas for the 3-D tetrahedron inertia tensor", J. Math. Stat. 1 (2005) 8-11.
    """
    corners = _M * mesh.corners_mm
    middle = corners.reshape(-1, 3).mean(axis=0)
    # the tetrahedra have their fourth corner at the middle, as signed volumes would lose digits by cancellation otherwise
    corners = corners - middle
    volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    sums = corners.sum(axis=1)
    volume = float(volumes.sum())
    # the centroid of a tetrahedron is the mean of its four corners, one of which is the origin
    centre = volumes @ sums / 4 / volume
    # integral of x x^T over a tetrahedron of volume V: V / 20 (s s^T + sum of c c^T), s the sum of its corners c
    second = np.einsum("i,ij,ik->jk", volumes, sums, sums) + np.einsum("i,inj,ink->jk", volumes, corners, corners)
    # moved from the middle of the vertices to the centre of mass (Steiner)
    second = second / 20 - volume * np.outer(centre, centre)
    return density * volume, middle + centre, density * (np.trace(second) * np.eye(3) - second)


def _frames(tape: Tape) -> list[Frame]:
    """The texture frame, and the tag's frame by AprilRobotics' convention: x right, y down on the upright tag."""
    x, y = tape.board.texture_origin_mm
    frames = [Frame(name="texture", origin=(_M * x, _M * y, 0.0))]
    if tape.tag is not None:
        x, y = tape.tag.center_mm
        frames.append(Frame(name="tag", origin=(_M * x, _M * y, 0.0), turn_rad=radians(tape.tag.rotation_deg)))
    return frames
