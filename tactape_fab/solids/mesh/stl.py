"""Reader of binary STL, with checks that the mesh is one closed body that faces outward; without a mesh library."""

from __future__ import annotations

from collections.abc import Iterator
from io import SEEK_END
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import TactapeError
from tactape_fab.solids.mesh.triangles import STL_TRIANGLE, Mesh
from tactape_fab.texture.frames import IntArray

_HEADER_BYTES, _TRIANGLE_BYTES = 84, 50
_PIECE_TRIANGLES = 100_000
"""Triangles that are read at once, which bounds the memory."""
MOST_TRIANGLES = 20_000_000
_JOINED_MM = 1e-6
"""Many programs, such as trimesh (1e-8), merge vertices nearer than a nanometre, and so read another mesh."""
_THIN = 1e-4
"""Area of a triangle relative to the product of two sides, below which rounding to float32 may change its normal."""
_SAME_WAY = 0.99
"""Least cosine between a triangle's stored normal and that of its corners; float32 causes 1e-3 rad if it is not thin."""


class MeshError(TactapeError):
    """A mesh file that cannot be read."""


def read_stl(data: bytes) -> Mesh:
    """A binary STL with equal corners merged into vertices.

    Raises MeshError if the data is not binary STL, is too large, or has coordinates that are NaN or infinite.
    """
    corners = stl_corners(data).reshape(-1, 3)
    vertices, faces = _merged(corners + np.float32(0.0))  # -0 becomes 0
    return Mesh(vertices_mm=vertices.astype(np.float64), faces=faces.reshape(-1, 3))


def stl_corners(data: bytes) -> npt.NDArray[np.float32]:
    """Corners of every triangle of a binary STL, as a view of its bytes; shape (f, 3, 3).

    Raises MeshError as `read_stl` does.
    """
    _check_size(data[:_HEADER_BYTES], len(data))
    return _finite_corners(data, _HEADER_BYTES)


def stl_corner_pieces(stream: BinaryIO) -> Iterator[npt.NDArray[np.float32]]:
    """Corners of every triangle of a file, in pieces of shape (k, 3, 3)."""
    size = stream.seek(0, SEEK_END)
    stream.seek(0)
    _check_size(stream.read(_HEADER_BYTES), size)
    while data := stream.read(_PIECE_TRIANGLES * _TRIANGLE_BYTES):
        yield _finite_corners(data)


def _check_size(header: bytes, size: int) -> None:
    if size < _HEADER_BYTES:
        raise MeshError(f"{size} bytes are too few for a binary STL")
    # binary STL: 80 bytes of free text, the number of triangles in 4, then 50 each (normal, three corners, 2 bytes of attributes)
    count = int.from_bytes(header[80:84], "little")
    if size != _HEADER_BYTES + count * _TRIANGLE_BYTES or not 0 < count <= MOST_TRIANGLES:
        raise MeshError(f"its header announces {count} triangles, its {size} bytes do not fit them")


def _finite_corners(data: bytes, offset: int = 0) -> npt.NDArray[np.float32]:
    corners: npt.NDArray[np.float32] = np.frombuffer(data, dtype=STL_TRIANGLE, offset=offset)["corners"]
    if not np.isfinite(corners).all():
        raise MeshError("it holds coordinates that are not finite numbers")
    return corners


def _merged(points: np.ndarray) -> tuple[np.ndarray, IntArray]:
    """The distinct points, and the index of each point among them."""
    # only exactly equal points, as a writer gives a vertex equal corners; near ones are a problem that is checked below
    order = np.lexsort(points.T)
    ordered = points[order]
    first = np.ones(len(points), dtype=bool)
    first[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    number = np.empty(len(points), dtype=np.int64)
    number[order] = np.cumsum(first) - 1
    return ordered[first], number


def stl_problems(data: bytes) -> list[str]:
    """Reasons why other readers may read a binary STL differently from `read_stl`; empty if there are none.

    Some take a file that begins with "solid" for ASCII, and some orient triangles by the normals instead of the corners.
    """
    problems = ["it begins with 'solid', so that many readers take it for ASCII"] if data[:5].lower() == b"solid" else []
    triangles = np.frombuffer(data, dtype=STL_TRIANGLE, offset=_HEADER_BYTES)
    wrong = 0
    for start in range(0, len(triangles), _PIECE_TRIANGLES):
        piece = triangles[start : start + _PIECE_TRIANGLES]
        normals = piece["normal"].astype(np.float64)
        first, second, third = np.moveaxis(piece["corners"].astype(np.float64), 1, 0)
        one, other = second - first, third - first
        across = np.cross(one, other)
        area = np.sqrt(np.einsum("ij,ij->i", across, across))
        sides = np.sqrt(np.einsum("ij,ij->i", one, one) * np.einsum("ij,ij->i", other, other))
        # a zero normal leaves it to the reader
        sure = (area > _THIN * sides) & normals.any(axis=1)
        with np.errstate(invalid="ignore"):  # of infinite normals
            agree = np.einsum("ij,ij->i", across, normals) > _SAME_WAY * area
        wrong += int((~np.isfinite(normals).all(axis=1) | (sure & ~agree)).sum())
    return [*problems, *([f"{wrong} normals that are not those of their triangles' corners"] if wrong else [])]


def mesh_problems(mesh: Mesh) -> list[str]:
    """Reasons why a mesh is not one closed body; empty if it is."""
    problems = []
    faces = mesh.faces
    a, b = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    if (a == b).any():
        problems.append(f"{int((a == b).reshape(-1, 3).any(axis=1).sum())} triangles without area")
    count = len(mesh.vertices_mm)
    # closed and consistently oriented: every directed edge occurs once, and so does its opposite
    narrow = np.min_scalar_type(count * count)  # 32 bits are sorted in half the time of 64
    edge, back = (np.sort((start * count + end).astype(narrow)) for start, end in ((a, b), (b, a)))
    if (edge[1:] == edge[:-1]).any():
        _, uses = np.unique(np.minimum(a, b) * count + np.maximum(a, b), return_counts=True)
        shared = int((uses > 2).sum())
        opposite = f"{int((edge[1:] == edge[:-1]).sum())} edges whose two triangles face opposite ways"
        problems.append(f"{shared} edges between more than two triangles" if shared else opposite)
    elif not np.array_equal(edge, back):
        problems.append(f"{len(np.setdiff1d(edge, back))} edges without a second triangle: it is not watertight")
    square = ((mesh.vertices_mm[a] - mesh.vertices_mm[b]) ** 2).sum(axis=1)
    # in a closed mesh each edge belongs to two triangles
    near = int((square < _JOINED_MM**2).sum()) // 2
    if near:
        problems.append(f"{near} edges shorter than {_JOINED_MM:g} mm, whose ends other readers join")
    bodies = body_count(mesh)
    if bodies != 1:
        problems.append(f"{bodies} bodies")
    if mesh.volume_mm3 <= 0.0:
        problems.append("its triangles face inward")
    return problems


def body_count(mesh: Mesh) -> int:
    """Number of bodies, connected through vertices."""
    return int(np.count_nonzero(np.bincount(patches(mesh.faces, len(mesh.vertices_mm))[mesh.faces].ravel())))


def patches(faces: IntArray, count: int) -> IntArray:
    """Label of the connected component of each of `count` vertices, which is its lowest vertex; shape (count,)."""
    label = np.arange(count)
    while True:
        least = label[faces].min(axis=1)
        new = label.copy()
        for k in range(3):
            np.minimum.at(new, faces[:, k], least)
        # the label of a label, twice: chains of labels shorten to a quarter per round
        new = new[new]
        new = new[new]
        if np.array_equal(new, label):
            return label
        label = new
