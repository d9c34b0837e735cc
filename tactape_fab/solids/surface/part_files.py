"""The user's mesh: reading of STL, OBJ, PLY or 3MF within limits, welding, and checks that it is a solid."""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from tactape_fab.base.errors import SpecError
from tactape_fab.solids.mesh.triangles import Mesh, face_normals
from tactape_fab.solids.mesh.triangles import unit as unit_vectors
from tactape_fab.solids.surface.charts import connected
from tactape_fab.solids.surface.nested import wrong_shells
from tactape_fab.solids.surface.threemf_file import FURTHEST_MM, MOST_FACES, read_3mf
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
MESH_FORMATS = ("stl", "3mf", "obj", "ply")
MOST_BYTES = 512 * 1024 * 1024
LEAST_SIZE_MM, MOST_SIZE_MM = 1.0, 5000.0
MOST_AWAY_MM = 2.0**14
"""Largest distance of a part from its origin; beyond it, coordinates of an STL (float32) are 2 um apart."""

_WELD = 1e-6
"""Distance, as a fraction of the model's size, below which corners are one vertex: the resolution of float32 in an STL."""
_LEAST_VOLUME = 1e-12
"""Least volume of a solid, as a fraction of the cube of its size; a flat mesh has less by rounding."""
_MOST_BOXES, _BOXES_EACH = 30_000_000, 200
"""Most pairs of triangles with overlapping bounding boxes, per mesh and per triangle; a fine mesh has some 20 per triangle."""
_OPPOSITE, _SLIVER = 0.999, 100.0
"""Cosine beyond which normals are opposite, and least width of overlapping triangles that are not slivers, as a multiple of the
resolution."""
_SAMPLE = 2000
"""Triangles of the sample by which the direction with fewest overlapping boxes is chosen."""
_MOST_PAIRS, _PAIRS_EACH = 200_000, 20
"""Most pairs, per mesh and per triangle, in which one triangle crosses the plane of the other."""
_MOST_NEAR = 50
"""Most corners within the resolution of an open corner, on average."""


def read_surface_mesh(data: bytes, kind: str, unit: str = "mm") -> Mesh:
    """Read a mesh file in mm, with equal corners welded; `closed_mesh` checks whether it is a solid.

    kind {"stl", "3mf", "obj", "ply"}
    unit {"mm", "cm", "m", "inch"}: Unit of the file's numbers; a 3MF states its own.
    Raises SpecError if the file is too large, cannot be read, has no triangles, or has a coordinate that is not finite.
    """
    if len(data) > MOST_BYTES:
        raise SpecError(f"SURFACE has {len(data)} bytes, more than {MOST_BYTES}; give a coarser mesh")
    if unit not in UNITS_MM:
        raise SpecError(f"unit = {unit!r} is none of: {', '.join(UNITS_MM)}; give one of them")
    if kind == "3mf":
        vertices, faces = read_3mf(data)
    else:
        vertices, faces = _read_trimesh(data, kind)
        vertices = vertices * UNITS_MM[unit]
    if len(faces) == 0:
        raise SpecError(f"SURFACE holds no triangles that can be read as {kind.upper()}; give a closed mesh of a solid")
    if len(faces) > MOST_FACES:
        raise SpecError(f"SURFACE has {len(faces)} triangles, more than {MOST_FACES}; give a coarser mesh")
    bad = int((~np.isfinite(vertices)).any(axis=1).sum())
    if bad:
        raise SpecError(f"SURFACE has {bad} vertices whose coordinates are not finite numbers; export it again")
    furthest = float(np.abs(vertices).max())
    if furthest > FURTHEST_MM:
        raise SpecError(f"SURFACE reaches {furthest:.3g} mm from its origin, more than {FURTHEST_MM:g} mm; correct its unit")
    mesh = welded(vertices, faces)
    if len(mesh.faces) == 0:
        raise SpecError("SURFACE holds no triangle with three corners apart; give a closed mesh of a solid")
    return mesh


def _read_trimesh(data: bytes, kind: str) -> tuple[FloatArray, IntArray]:
    import trimesh

    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)  # its tracebacks do not help the user
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            # from bytes and without a resolver, so that materials and textures named in an OBJ are not opened
            loaded: Any = trimesh.load(
                io.BytesIO(data), file_type=kind, force="mesh", process=False, skip_materials=True, resolver=None
            )
        vertices = np.array(loaded.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.array(getattr(loaded, "faces", np.zeros((0, 3))), dtype=np.int64).reshape(-1, 3)
    except MemoryError:
        raise SpecError(f"SURFACE needs more memory than there is to be read as {kind.upper()}; give a coarser mesh") from None
    except Exception as error:  # parsers raise any exception on untrusted bytes
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise SpecError(f"SURFACE cannot be read as {kind.upper()}: {reason}; export it again, or as another format") from error
    finally:
        log.setLevel(level)
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise SpecError(f"SURFACE cannot be read as {kind.upper()}: a triangle names a vertex that is not there; export it again")
    return vertices, faces


def welded(vertices: FloatArray, faces: IntArray) -> Mesh:
    """Mesh with equal vertices merged, along open edges also nearly equal ones, and without degenerate triangles."""
    # nearly equal vertices are merged at open edges only, as a closed mesh may have details as fine as the resolution
    points, _, place = np.unique(vertices + 0.0, axis=0, return_index=True, return_inverse=True)
    mesh = _without_slits(Mesh(vertices_mm=points, faces=place.reshape(-1)[faces]))
    border = _border(mesh.faces)
    if len(border):
        grain_mm = _WELD * float(np.ptp(points, axis=0).max())
        same = np.arange(len(mesh.vertices_mm))
        same[border] = border[_clusters(mesh.vertices_mm[border], grain_mm)]
        mesh = _without_slits(Mesh(vertices_mm=mesh.vertices_mm, faces=same[mesh.faces]))
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return Mesh(vertices_mm=mesh.vertices_mm[used], faces=faces.reshape(-1, 3))


def _without_slits(mesh: Mesh) -> Mesh:
    whole = (mesh.faces != np.roll(mesh.faces, 1, axis=1)).all(axis=1)
    return Mesh(vertices_mm=mesh.vertices_mm, faces=mesh.faces[whole])


def _clusters(points: FloatArray, within_mm: float) -> IntArray:
    """For each point, the first point of its cluster, connected within a distance; shape (n,)."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    # counted first, as n points at one place have n^2 pairs
    if tree.count_neighbors(tree, within_mm) > _MOST_NEAR * len(points):
        raise SpecError(f"SURFACE has thousands of open edges within {within_mm:.3g} mm; repair it and export it again")
    a, b = tree.query_pairs(within_mm, output_type="ndarray").T
    _, label = connected(a, b, len(points))
    _, first = np.unique(label, return_index=True)
    return np.asarray(first[label].astype(np.int64))


def _edge_keys(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Keys of the directed edges of all triangles and of their opposites; shape (f * 3,) each, edge i after corner i."""
    # an edge (a, b) as one number, so that sorting and comparing need no rows
    a, b = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = int(faces.max()) + 1 if len(faces) else 1
    return a * count + b, b * count + a


def _border(faces: IntArray) -> IntArray:
    """Vertices of the open edges, which only one triangle has."""
    forward, backward = _edge_keys(faces)
    # the smaller of both keys is the same for both directions
    undirected, count = np.unique(np.minimum(forward, backward), return_counts=True)
    single = undirected[count == 1]
    vertices = int(faces.max()) + 1 if len(faces) else 1
    return np.unique(np.concatenate([single // vertices, single % vertices]))


def closed_mesh(mesh: Mesh, *, crossings: bool = True) -> Mesh:
    """The mesh, oriented outward, after checks that it is a solid; `crossings` includes self-intersections.

    Raises SpecError if edges are open, shared by more than two triangles, or by two that are inconsistently oriented, if the
        mesh intersects itself, or a shell bounds neither a body nor a cavity.
    """
    forward, backward = _edge_keys(mesh.faces)
    _, count = np.unique(np.minimum(forward, backward), return_counts=True)
    open_edges, crowded = int((count == 1).sum()), int((count > 2).sum())
    repair = "repair it in your CAD or mesh program and export it again"
    if open_edges:
        raise SpecError(f"SURFACE is not watertight: {open_edges} of its {len(count)} edges are open; {repair}")
    if crowded:
        raise SpecError(f"SURFACE is no simple solid: {crowded} edges belong to more than two triangles; {repair}")
    # every edge has two triangles here; if both traverse it in the same direction, one of them is reversed
    if len(np.unique(forward)) != len(forward):
        turned = len(forward) - len(np.unique(forward))
        raise SpecError(f"SURFACE has triangles that face opposite ways: {turned} edges are run through twice; {repair}")
    # before the sign of the volume, which for a flat mesh is arbitrary, and before folds, of which a flat mesh consists
    if abs(mesh.volume_mm3) <= _LEAST_VOLUME * float(np.ptp(mesh.vertices_mm, axis=0).max()) ** 3:
        raise SpecError("SURFACE encloses no volume: all of it is flat; give a closed mesh of a solid")
    cuts, at_mm = self_intersections(mesh) if crossings else (0, (0.0, 0.0, 0.0))
    if cuts:
        near = ", ".join(f"{v:.2f}" for v in at_mm)
        raise SpecError(
            f"SURFACE cuts itself: {cuts} pairs of triangles cross or cover each other, first near ({near}) mm; "
            "cut its faces into triangles and repair it in your CAD or mesh program, and export it again"
        )
    if mesh.volume_mm3 < 0:
        mesh = Mesh(vertices_mm=mesh.vertices_mm, faces=mesh.faces[:, ::-1])
    wrong, middle_mm = wrong_shells(mesh)
    if wrong:
        near = ", ".join(f"{v:.2f}" for v in middle_mm)
        raise SpecError(
            f"SURFACE has closed shells that face the wrong way: {wrong}, the first round ({near}) mm, a body inside another, "
            "a hollow that faces out, or a body turned inside out; remove it or turn its faces in your mesh program, and export "
            "it again"
        )
    return mesh


def refuse_wrong_size(size_mm: FloatArray, unit: str | None, texture_mm: tuple[float, float]) -> None:
    """Raise SpecError if a model is so small or large that its unit must be another one.

    size_mm (3,): Extent along x, y, z.
    unit: The assumed unit; None if the file states its own.
    texture_mm: Width and height of the texture, which may go around the model at most once.
    """
    largest = float(size_mm.max())
    reach = float(np.hypot(*texture_mm))
    shown = " x ".join(f"{v:.4g}" for v in size_mm)
    if largest > MOST_SIZE_MM:
        problem = f"SURFACE is {shown} mm, larger than {MOST_SIZE_MM:g} mm"
    elif largest < LEAST_SIZE_MM:
        problem = f"SURFACE is {shown} mm, smaller than {LEAST_SIZE_MM:g} mm"
    # the perimeter of a plane section of a convex body of diagonal D is at most pi D
    elif np.pi * np.linalg.norm(size_mm) < reach:
        problem = f"SURFACE is {shown} mm, smaller than the texture of {texture_mm[0]:.4g} x {texture_mm[1]:.4g} mm"
    else:
        return
    remedy = "correct its unit and export it again"
    if unit is not None:
        fitting = [
            name
            for name, mm in UNITS_MM.items()
            if name != unit
            and reach / np.pi < largest * mm / UNITS_MM[unit]
            and 10 < largest * mm / UNITS_MM[unit] <= MOST_SIZE_MM
        ]
        use = "if it is not, use --unit " + " or ".join(fitting) if fitting else "scale it"
        remedy = f"the file was read in {unit}; {use}"
    raise SpecError(f"{problem}; {remedy}")


def refuse_far_away(corners_mm: FloatArray) -> None:
    """Raise SpecError if a model is so far from its origin that its STL would be too coarse; corners (n, 3)."""
    furthest = float(np.abs(corners_mm).max())
    if furthest > MOST_AWAY_MM:
        raise SpecError(
            f"SURFACE reaches {furthest:.6g} mm from its origin, more than {MOST_AWAY_MM:g} mm, where an STL's coordinates are "
            "coarser than 0.001 mm; move it to its origin and export it again"
        )


def self_intersections(mesh: Mesh) -> tuple[int, tuple[float, float, float]]:
    """Number of pairs of triangles that intersect, and the place of the first (mm).

    An edge through the interior of another triangle counts, and so do coplanar triangles at a common vertex that overlap with
    opposite normals; triangles that only touch or are coplanar do not.

    Raises SpecError if so many triangles are near each other that checking all pairs would take minutes.
    """
    corners = mesh.corners_mm
    # resolution of float32 coordinates; intersections by less may be due to rounding
    tolerance = 1e-6 * float(np.ptp(mesh.vertices_mm, axis=0).max())
    normals = face_normals(corners)
    found = looked_at = 0
    first = np.zeros(3)
    for near in _box_pairs(corners, tolerance):
        folded = _folded(mesh.faces, corners, normals, near, tolerance)
        if len(folded) and not found:
            first = corners[folded[0]].mean(axis=0)
        found += len(folded)
        # an edge through a triangle's interior has its ends on both sides of its plane, which excludes most pairs
        pairs = near[:, _across(corners, normals, near, tolerance) | _across(corners, normals, near[::-1], tolerance)]
        # triangles with a common edge have no other common point, unless they are coplanar
        shared = (mesh.faces[pairs[0]][:, :, None] == mesh.faces[pairs[1]][:, None, :]).sum(axis=(1, 2))
        a, b = pairs[:, shared < 2]
        looked_at += len(a)
        if looked_at > _MOST_PAIRS + _PAIRS_EACH * len(corners):
            raise SpecError(f"SURFACE has {looked_at} and more pairs of triangles {_CROWDED}")
        crossing = np.zeros(len(a), dtype=bool)
        for one, other in ((a, b), (b, a)):
            for k in range(3):
                start, end = corners[one, k], corners[one, (k + 1) % 3]
                crossing |= _pierces(start, end, corners[other], tolerance)
        if crossing.any():
            if not found:
                first = corners[a[crossing][0]].mean(axis=0)
            found += int(crossing.sum())
    return found, (float(first[0]), float(first[1]), float(first[2]))


_CROWDED = "in one place; give a mesh of one part, with triangles of even size"


def _folded(faces: IntArray, corners: FloatArray, normals: FloatArray, pairs: IntArray, tolerance: float) -> IntArray:
    """First triangles of coplanar pairs that overlap, such as in the fan of a polygon that is not convex."""
    import shapely

    one, other = pairs[:, np.einsum("ij,ij->i", normals[pairs[0]], normals[pairs[1]]) < -_OPPOSITE]
    level = np.abs(np.einsum("nkj,nj->nk", corners[other] - corners[one, :1], normals[one])).max(axis=1) < tolerance
    common = (faces[one][:, :, None] == faces[other][:, None, :]).any(axis=(1, 2))
    one, other = one[level & common], other[level & common]
    along = unit_vectors(corners[one, 1] - corners[one, 0])
    axes = np.stack([along, np.cross(normals[one], along)], axis=2)
    flat = (shapely.polygons((corners[k] - corners[one, :1]) @ axes) for k in (one, other))
    longest = np.ptp(corners[one], axis=1).max(axis=1, initial=0.0)
    # slivers reversed by rounding are narrower
    return np.asarray(one[shapely.area(shapely.intersection(*flat)) > _SLIVER * tolerance * longest])


def _across(corners: FloatArray, normals: FloatArray, pairs: IntArray, tolerance: float) -> BoolArray:
    """Whether the second triangle of each pair has corners on both sides of the plane of the first; shape (n,)."""
    one, other = pairs
    from_plane = np.einsum("nkj,nj->nk", corners[other] - corners[one, :1], normals[one])
    return np.asarray((from_plane.min(axis=1) < -tolerance) & (from_plane.max(axis=1) > tolerance))


def _box_pairs(corners: FloatArray, tolerance: float) -> Iterator[IntArray]:
    """Pairs of triangles whose boxes overlap, in chunks: by a tree in the plane where fewest do, then in depth."""
    import shapely

    low, high = corners.min(axis=1), corners.max(axis=1)
    # counted in a sample, as the best direction depends on the shape: boxes of a flat face overlap when seen edge-on
    some = np.random.default_rng(0).permutation(len(corners))[:_SAMPLE]
    meets = (low[some, None] <= high[None, some] + tolerance).transpose(2, 0, 1)
    meets &= meets.transpose(0, 2, 1)
    depth = int(np.argmin([np.delete(meets, k, axis=0).all(axis=0).sum() for k in range(3)]))
    u, v = (k for k in range(3) if k != depth)
    boxes = shapely.box(low[:, u], low[:, v], high[:, u], high[:, v])
    tree = shapely.STRtree(boxes)
    count, start, size, most = 0, 0, 100, _MOST_BOXES + _BOXES_EACH * len(boxes)
    while start < len(boxes):
        one, other = tree.query(boxes[start : start + size])
        count += len(one)
        if count > most:
            raise SpecError(f"SURFACE has {count} and more pairs of triangles {_CROWDED}")
        one = one + start
        start += size
        size = int(np.clip(size * 250_000 // max(len(one), 1), 10, 20_000))  # for about 250,000 pairs per chunk
        keep = other > one
        one, other = one[keep], other[keep]
        keep = (low[one, depth] <= high[other, depth]) & (low[other, depth] <= high[one, depth])
        yield np.stack([one[keep], other[keep]])


def _pierces(start: FloatArray, end: FloatArray, triangle: FloatArray, tolerance: float) -> BoolArray:
    """Whether segments pass through the interior of triangles, by more than `tolerance` on both sides; shape (n,)."""
    a, b, c = triangle[:, 0], triangle[:, 1], triangle[:, 2]
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    unit = normal / np.where(area > 0, area, 1)[:, None]
    over = np.einsum("ij,ij->i", start - a, unit)
    under = np.einsum("ij,ij->i", end - a, unit)
    through = (np.minimum(over, under) < -tolerance) & (np.maximum(over, under) > tolerance) & (area > 0)
    # the height over the plane is linear from `over` to `under`, and 0 at the fraction over / (over - under)
    at = start + (end - start) * (over / np.where(through, over - under, 1))[:, None]
    for p, q in ((a, b), (b, c), (c, a)):
        # perpendicular to the side, into the triangle, as long as the side: gives the distance times that length
        inward = np.cross(unit, q - p)
        length = np.linalg.norm(inward, axis=1)
        through &= np.einsum("ij,ij->i", at - p, inward) > tolerance * length
    return np.asarray(through)
