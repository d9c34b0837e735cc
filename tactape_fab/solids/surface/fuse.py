"""Union of a mesh and the elements of a texture by a boolean of manifold3d, with checks of the result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactape_fab.base.errors import Problem, SpecError, TactapeError
from tactape_fab.base.fields import counted
from tactape_fab.solids.elements import closed_element, element_rings_mm, element_volume_mm3, foot_area_mm2
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.surface.charts import connected, nearest
from tactape_fab.solids.surface.patch import SINK_MM
from tactape_fab.solids.surface.place import LaidOut
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.shapes import area_mm2

Progress = Callable[[str, int, int], None]
"""Called with the name of the step, the amount done and the total."""

_VOLUME_ERROR, _MOST_MOVED = 1e-6, 2e-6
_GRID_MM = 2.0**-19
"""Grid of the vertices, 2 nm, or that of float32 where it is coarser, so that readers do not merge any two."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fused:
    """The embossed solid as a mesh.

    mesh: Coordinates are exact in float32, so that an STL has the same mesh; vertices and triangles are in a canonical order.
    bodies: Number of shells: 1 for a simple solid, more if the user's solid had several, or cavities.
    """

    mesh: Mesh
    bodies: int
    volume_mm3: float
    host_volume_mm3: float


def fuse_mesh(host: Mesh, laid: LaidOut, progress: Progress = lambda *_: None, *, chord_error_mm: float = 0.0) -> Fused:
    """Fuse elements with a closed mesh.

    host: From `closed_mesh`.
    chord_error_mm: Largest distance of the mesh from the surface on which the texture was laid out.
    Raises SpecError if the boolean engine refuses the mesh, or elements pass through a thin wall.
    Raises TactapeError if the result is not the expected solid.
    """
    import manifold3d as m3

    count = laid.tape.part_count
    progress("fusing", 0, count)
    base = _manifold(host)
    if base.status() != m3.Error.NoError or base.is_empty():
        raise SpecError(f"SURFACE is refused by the boolean engine ({base.status().name}); repair it and export it again")
    elements = _elements(laid)
    bodies = len(base.decompose())
    # composed without a boolean, as overlapping elements were refused before (`collisions`)
    above = m3.Manifold.compose(elements) - base
    _refuse_poking_out(above, laid, chord_error_mm)
    size = float(np.ptp(host.vertices_mm, axis=0).max())
    # one solid per element: with all elements as one mesh, overlapping ones gave a wrong but watertight solid
    union = m3.Manifold.batch_boolean([base, *elements], m3.OpType.Add)
    # a valid, watertight result may be wrong: its volume must be that of the part plus that of the elements outside it
    got, expected = float(union.volume()), float(base.volume() + above.volume())
    if abs(got - expected) > _VOLUME_ERROR * expected:
        raise TactapeError(f"the fused solid has {got:.4f} mm3 instead of {expected:.4f} mm3; {_REPORT}")
    mesh = _settled(union.simplify(_MOST_MOVED * size))
    # the engine keeps short edges between surfaces of different origin, which a new manifold does not have
    mesh = _settled(_manifold(mesh).simplify(_MOST_MOVED * size))
    result = _manifold(mesh)
    # the rounded mesh is checked, as rounding to the grid can make a thin wall touch itself
    if result.status() != m3.Error.NoError or len(result.decompose()) != bodies:
        found = counted(len(result.decompose()), "body", "bodies")
        raise TactapeError(f"the fused solid has {found} instead of {bodies}; {_REPORT}")
    # the most by which simplifying and rounding move the surface; with coincident faces whole parts may be lost
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
    """Every element as a closed solid of the boolean engine, extended below the surface."""
    frames = laid.elements
    axes = np.stack([frames.x_axis, frames.y_axis, frames.normal], axis=1)
    solids = []
    for points, turn, sink in zip(frames.points_mm, axes, laid.sink_mm, strict=True):
        vertices, faces = closed_element(laid.tape.part, float(sink))
        # rows of `turn` are the axes of the element's frame, so row vectors times it are in model coordinates
        solids.append(_manifold(Mesh(vertices_mm=vertices @ turn + points, faces=faces)))
    return solids


def _facet_loss_mm3(part: TapePart) -> float:
    """Volume above the foot by which an element's mesh is smaller than its exact shape, mm^3."""
    rings = element_rings_mm(part)
    vertices, faces = closed_element(part, SINK_MM)
    buried_mm3 = area_mm2(rings[0, :, :2]) * SINK_MM
    # because of the chords of a dome; 0 for a block. The buried part has straight sides
    return element_volume_mm3(part) - (Mesh(vertices_mm=vertices, faces=faces).volume_mm3 - buried_mm3)


def _pieces(solid: Any) -> tuple[FloatArray, FloatArray]:
    """Volumes and middles of the pieces of a manifold; shapes (n,), (n, 3). decompose() takes quadratic time in their number."""
    raw = solid.to_mesh64()
    points = np.asarray(raw.vert_properties, dtype=np.float64)[:, :3]
    faces = np.asarray(raw.tri_verts, dtype=np.int64)
    count, label = connected(faces.ravel(), np.roll(faces, 1, axis=1).ravel(), len(points))
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, label, points)
    np.maximum.at(high, label, points)
    middles: FloatArray = (low + high) / 2
    # about each piece's middle, to avoid cancellation: a piece of 0.05 mm3 may be hundreds of millimetres from the origin
    a, b, c = np.moveaxis((points - middles[label])[faces], 1, 0)
    volumes = np.bincount(label[faces[:, 0]], weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6, minlength=count)
    return np.asarray(volumes, dtype=np.float64), middles


def _refuse_poking_out(above: Any, laid: LaidOut, chord_error_mm: float) -> None:
    """Check that each element is outside the surface as a single piece of the expected volume. Raises SpecError."""
    volumes, middles = _pieces(above)
    tops = laid.elements.points_mm + laid.elements.normal * (laid.tape.part.body_mm[2] / 2)
    # a piece belongs to the element whose middle is nearest; an element that is cut through by a surface has several pieces
    _, owner = nearest(tops, middles)
    total = np.bincount(owner, weights=volumes, minlength=len(tops))
    number = np.bincount(owner, minlength=len(tops))
    expected = laid.volume_mm3 - _facet_loss_mm3(laid.tape.part)
    # the chord error may shift the mesh below the whole foot
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
    """A manifold as a mesh with float32 coordinates on a grid, in an order that depends only on the geometry."""
    raw = solid.to_mesh64()
    points = np.asarray(raw.vert_properties, dtype=np.float64)[:, :3] / _GRID_MM
    # the grid's step is a power of two, so products are exact; near the origin it is coarser than that of float32
    points = (points.round() * _GRID_MM).astype(np.float32).astype(np.float64) + 0.0
    faces = np.asarray(raw.tri_verts, dtype=np.int64)
    unique, place = np.unique(points, axis=0, return_inverse=True)
    faces = place.reshape(-1)[faces]
    # a triangle with two equal corners has no area, and its neighbours share the edge without it
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    first = faces.argmin(axis=1)
    # each triangle starts at its lowest vertex, then all are sorted, so that equal meshes are equal bytes
    faces = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    faces = faces[np.lexsort(faces.T[::-1])]
    used, faces = np.unique(faces, return_inverse=True)
    return Mesh(vertices_mm=unique[used], faces=faces.reshape(-1, 3))
