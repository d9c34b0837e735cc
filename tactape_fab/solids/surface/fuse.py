"""A mesh and the elements of a texture as one mesh: one boolean of manifold3d, and the proof that it did what it should."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactape_fab.base.errors import Problem, SpecError, TactapeError
from tactape_fab.solids.elements import closed_element, element_rings_mm, element_volume_mm3, foot_area_mm2
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.surface.charts import connected, nearest
from tactape_fab.solids.surface.patch import SINK_MM
from tactape_fab.solids.surface.place import LaidOut
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.shapes import area_mm2

Progress = Callable[[str, int, int], None]
"""Told what is being done, how many of how many are done."""

_VOLUME_ERROR, _MOST_MOVED = 1e-6, 2e-6
_GRID_MM = 2.0**-19
"""Vertices lie on a grid of 2 nm, or on float32's own where that is coarser: no two are so near that a reader joins them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fused:
    """The embossed solid as a mesh.

    mesh: Its coordinates are float32's, so that it is the same in an STL; vertices and triangles in a fixed order.
    bodies: Shells: 1 for a simple solid; more where the user's solid had several, or hollows.
    """

    mesh: Mesh
    bodies: int
    volume_mm3: float
    host_volume_mm3: float


def fuse_mesh(host: Mesh, laid: LaidOut, progress: Progress = lambda *_: None, *, chord_error_mm: float = 0.0) -> Fused:
    """Fuse elements with a closed mesh.

    host: From `closed_mesh`.
    chord_error_mm: How far the mesh may lie from the surface that the texture was laid out on.
    Raises SpecError when the mesh is refused by the boolean engine, or elements come out at the other side of a thin wall.
    Raises TactapeError when the result is not the solid that it should be.
    """
    import manifold3d as m3

    count = laid.tape.part_count
    progress("fusing", 0, count)
    base = _manifold(host)
    if base.status() != m3.Error.NoError or base.is_empty():
        raise SpecError(f"SURFACE is refused by the boolean engine ({base.status().name}); repair it and export it again")
    elements = _elements(laid)
    bodies = len(base.decompose())
    # composed without a boolean: elements that overlap are refused before (`collisions`)
    above = m3.Manifold.compose(elements) - base
    _refuse_poking_out(above, laid, chord_error_mm)
    size = float(np.ptp(host.vertices_mm, axis=0).max())
    # one solid for each element: as one mesh, elements that overlap give a wrong solid, watertight and of two or three bodies
    union = m3.Manifold.batch_boolean([base, *elements], m3.OpType.Add)
    # a valid, watertight result is no proof: a union has the volume of the part and of what stands out of it
    got, expected = float(union.volume()), float(base.volume() + above.volume())
    if abs(got - expected) > _VOLUME_ERROR * expected:
        raise TactapeError(f"the fused solid has {got:.4f} mm3 instead of {expected:.4f} mm3; {_REPORT}")
    mesh = _settled(union.simplify(_MOST_MOVED * size))
    # the engine keeps short edges where surfaces of different origin meet; a manifold made anew has no such origins
    mesh = _settled(_manifold(mesh).simplify(_MOST_MOVED * size))
    result = _manifold(mesh)
    # rounding to the grid can make a thin place touch itself, so the rounded mesh is what is judged
    if result.status() != m3.Error.NoError or len(result.decompose()) != bodies:
        raise TactapeError(f"the fused solid falls into {len(result.decompose())} bodies instead of {bodies}; {_REPORT}")
    # simplifying and rounding move the surface by so much at most; where faces cover each other whole parts get lost
    moved_mm = 4 * _MOST_MOVED * size + float(np.spacing(np.float32(np.abs(host.vertices_mm).max())))
    if abs(mesh.volume_mm3 - expected) > moved_mm * float(result.surface_area()):
        raise TactapeError(f"the simplified solid has {mesh.volume_mm3:.4f} mm3 instead of {expected:.4f} mm3; {_REPORT}")
    progress("fusing", count, count)
    return Fused(mesh=mesh, bodies=bodies, volume_mm3=mesh.volume_mm3, host_volume_mm3=float(base.volume()))


_REPORT = "move the texture a little, or give a finer mesh"


def _manifold(mesh: Mesh) -> Any:
    import manifold3d as m3

    points = np.ascontiguousarray(mesh.vertices_mm, dtype=np.float64)
    return m3.Manifold(m3.Mesh64(vert_properties=points, tri_verts=np.ascontiguousarray(mesh.faces, dtype=np.uint64)))


def _elements(laid: LaidOut) -> list[Any]:
    """Every element as a closed solid of the boolean engine, its sides down to below the surface."""
    frames = laid.elements
    axes = np.stack([frames.x_axis, frames.y_axis, frames.normal], axis=1)
    solids = []
    for points, turn, sink in zip(frames.points_mm, axes, laid.sink_mm, strict=True):
        vertices, faces = closed_element(laid.tape.part, float(sink))
        # rows of `turn` are the directions of the element's frame: local rows times it are model coordinates
        solids.append(_manifold(Mesh(vertices_mm=vertices @ turn + points, faces=faces)))
    return solids


def _facet_loss_mm3(part: TapePart) -> float:
    """Volume above the foot that an element's mesh lacks relative to its exact shape, mm^3."""
    rings = element_rings_mm(part)
    vertices, faces = closed_element(part, SINK_MM)
    buried_mm3 = area_mm2(rings[0, :, :2]) * SINK_MM
    # chords of a dome's circles and meridians; 0 of a block. The buried part has straight sides
    return element_volume_mm3(part) - (Mesh(vertices_mm=vertices, faces=faces).volume_mm3 - buried_mm3)


def _pieces(solid: Any) -> tuple[FloatArray, FloatArray]:
    """Volumes and middles of the pieces of a manifold; shapes (n,), (n, 3). Its own decompose() is quadratic in them."""
    raw = solid.to_mesh64()
    points = np.asarray(raw.vert_properties, dtype=np.float64)[:, :3]
    faces = np.asarray(raw.tri_verts, dtype=np.int64)
    count, label = connected(faces.ravel(), np.roll(faces, 1, axis=1).ravel(), len(points))
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, label, points)
    np.maximum.at(high, label, points)
    middles: FloatArray = (low + high) / 2
    # about each piece's own middle: a piece of 0.05 mm3 may lie hundreds of millimetres from the origin
    a, b, c = np.moveaxis((points - middles[label])[faces], 1, 0)
    volumes = np.bincount(label[faces[:, 0]], weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6, minlength=count)
    return np.asarray(volumes, dtype=np.float64), middles


def _refuse_poking_out(above: Any, laid: LaidOut, chord_error_mm: float) -> None:
    """Each element must show above the surface as one piece of the volume that it has there."""
    volumes, middles = _pieces(above)
    tops = laid.elements.points_mm + laid.elements.normal * (laid.tape.part.body_mm[2] / 2)
    # a piece is an element's whose half height is nearest; pieces of an element that a surface cuts through count as several
    _, owner = nearest(tops, middles)
    total = np.bincount(owner, weights=volumes, minlength=len(tops))
    number = np.bincount(owner, minlength=len(tops))
    expected = laid.volume_mm3 - _facet_loss_mm3(laid.tape.part)
    # a mesh within the chord error of the face shifts the surface under the whole foot by so much
    allowed = laid.volume_error_mm3 + foot_area_mm2(laid.tape.part) * chord_error_mm
    wrong = (number != 1) | (np.abs(total - expected) > allowed)
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        column, row = laid.tape.cells()[i]
        message = (
            f"{int(wrong.sum())} elements do not stand whole on the surface, the first at column {column}, row {row}: "
            f"{total[i]:.5f} mm3 of it show in {number[i]} pieces, not {expected[i]:.5f} mm3 in one; "
            f"the wall is thinner than the {laid.sink_mm[i]:.3f} mm that a foot reaches into it, or the surface is too rough; "
            "use another place or a thicker wall"
        )
        raise SpecError(Problem("surface", message))


def _settled(solid: Any) -> Mesh:
    """A manifold as a mesh on a grid of float32's coordinates, in an order that its geometry alone decides."""
    raw = solid.to_mesh64()
    points = np.asarray(raw.vert_properties, dtype=np.float64)[:, :3] / _GRID_MM
    # the grid's step is a power of two: products with it are exact, and near the origin it is coarser than float32's own
    points = (points.round() * _GRID_MM).astype(np.float32).astype(np.float64) + 0.0
    faces = np.asarray(raw.tri_verts, dtype=np.int64)
    unique, place = np.unique(points, axis=0, return_inverse=True)
    faces = place.reshape(-1)[faces]
    # a triangle two of whose corners became one has no area, and its neighbours meet without it
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    first = faces.argmin(axis=1)
    # each triangle from its least vertex on, then all sorted: the same mesh is the same bytes
    faces = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    faces = faces[np.lexsort(faces.T[::-1])]
    used, faces = np.unique(faces, return_inverse=True)
    return Mesh(vertices_mm=unique[used], faces=faces.reshape(-1, 3))
