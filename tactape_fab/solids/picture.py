"""Offscreen pictures of meshes: orthographic, with depth buffer and soft light from the upper left, on white."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import RenderError
from tactape_fab.base.picture_file import encoded_png
from tactape_fab.solids.mesh.triangles import Mesh, face_normals
from tactape_fab.texture.frames import FloatArray, IntArray

Image = npt.NDArray[np.uint8]

MOST_PX = 6000
_SAMPLES = 2
"""Samples along each axis of a pixel."""
_SAMPLES_AT_ONCE = 500_000
_NEAREST = 2**31 - 1
_LIGHT = (-0.45, 0.60, 0.66)
"""Direction to the light in the picture's frame: x right, y up, z towards the viewer."""
_AMBIENT, _FRONTAL, _DIRECT = 0.40, 0.14, 0.60
_SHADOW, _SHADOW_STEPS = 0.75, 24
"""Fraction of the direct light that a shadow removes, and length of shadows in pixels."""
_CREASE_COS, _CREASE_SHADE = 0.80, 0.60
_SPAN_SLACK = 1e-9


def shaded(
    mesh: Mesh,
    *,
    direction: tuple[float, float, float],
    up: tuple[float, float, float],
    width_px: int,
    rgb: tuple[float, float, float] = (0.78, 0.80, 0.83),
    margin: float = 0.03,
) -> Image:
    """Draw a mesh.

    mesh: A closed mesh, of which the outside is drawn.
    direction: From the object towards the viewer, in the mesh's frame.
    up: The picture's up direction in the mesh's frame; not parallel to `direction`.
    width_px: Width; the height follows from the object's extent. If that would exceed MOST_PX the picture is narrower.
    rgb: Colour of the surface in full light, each from 0 to 1.
    margin: White border, as a fraction of the longer side.
    Returns (height, width, 3): Red, green, blue.
    Raises RenderError when the mesh is empty or has no extent, or the view has no direction.
    """
    import cv2

    frame = view_frame(direction, up)
    points = mesh.vertices_mm @ frame.T
    if len(mesh.faces) == 0 or not np.isfinite(points).all():
        raise RenderError("the mesh to draw is empty or not finite")
    low, high = points.min(axis=0), points.max(axis=0)
    border = margin * float((high - low)[:2].max())
    extent = (high - low)[:2] + 2 * border
    if min(extent) <= 0.0:
        raise RenderError("the mesh to draw has no extent")
    px_per_mm = min(width_px, MOST_PX, MOST_PX * extent[0] / extent[1]) / extent[0] * _SAMPLES
    # the product may lie just above MOST_PX
    size = [min(ceil(v * px_per_mm / _SAMPLES), MOST_PX) * _SAMPLES for v in extent]
    screen = np.empty_like(points)
    # half a sample less, so that sample (i, j) is at the integers i and j
    screen[:, 0] = (points[:, 0] - low[0] + border) * px_per_mm - 0.5
    screen[:, 1] = (high[1] + border - points[:, 1]) * px_per_mm - 0.5
    screen[:, 2] = points[:, 2] * px_per_mm
    corners = screen[mesh.faces]
    normals = face_normals(points[mesh.faces])
    seen = _nearest_faces(corners, np.flatnonzero(normals[:, 2] > 1e-6), (size[1], size[0]))
    small = (size[0] // _SAMPLES, size[1] // _SAMPLES)
    hidden = _hidden(np.ascontiguousarray(seen.depth[::_SAMPLES, ::_SAMPLES]), _SAMPLES)
    # face -1, the background, gets the appended last entry, no light
    around, direct = (np.append(part, np.float32(0.0))[seen.face] for part in _lambert(normals))
    # shadows affect the direct light only, which vanishes where a round surface turns away, as do the steps of its own shadow
    picture = around + direct * (1.0 - _SHADOW * cv2.resize(hidden, seen.face.shape[::-1], interpolation=cv2.INTER_LINEAR))
    _darken_creases(picture, seen, normals)
    light = cv2.resize(picture, small, interpolation=cv2.INTER_AREA)
    cover = cv2.resize((seen.face >= 0).astype(np.float32), small, interpolation=cv2.INTER_AREA)
    # white for the fraction of the pixel's samples without a face
    colour = light[..., None] * np.asarray(rgb, dtype=np.float32) + (1.0 - cover)[..., None]
    return np.asarray(np.rint(np.clip(colour, 0.0, 1.0) * 255), dtype=np.uint8)


def png_bytes(image: Image) -> bytes:
    """The picture as a PNG file. Raises RenderError when it cannot be encoded."""
    import cv2

    return encoded_png(np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, 3])


def view_frame(direction: tuple[float, float, float], up: tuple[float, float, float]) -> FloatArray:
    """Right, up and towards the viewer as the rows of a rotation; shape (3, 3).

    Raises RenderError if one of both is zero or they are parallel.
    """
    towards = np.asarray(direction, dtype=np.float64)
    right = np.cross(np.asarray(up, dtype=np.float64), towards)
    if not (np.linalg.norm(right) > 1e-12):
        raise RenderError(f"a view from {direction} with {up} up is invalid; give two directions that are not parallel")
    towards = towards / np.linalg.norm(towards)
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(towards, right), towards])


def _lambert(normals: FloatArray) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Light of every face: ambient, and direct."""
    light = np.asarray(_LIGHT) / np.linalg.norm(_LIGHT)
    around, direct = _AMBIENT + _FRONTAL * normals[:, 2], _DIRECT * np.maximum(normals @ light, 0.0)
    return around.astype(np.float32), direct.astype(np.float32)


# Depth buffer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """Visible face at each sample (its index, -1 for none) and its depth in samples towards the viewer."""

    face: IntArray
    depth: npt.NDArray[np.float32]


def _nearest_faces(corners: FloatArray, facing: IntArray, shape: tuple[int, int]) -> _Seen:
    """Depth buffer of the triangles `facing` the viewer, for the spans of all scan lines at once.

    Each sample has depth and face in one integer, so that the nearest face is the maximum.
    """
    # depth in the upper 31 bits, so that the number is positive, and the face's index in the lower 32; 0 is no face
    low, high = float(corners[..., 2].min()), float(corners[..., 2].max())
    steps = (_NEAREST - 2) / max(high - low, 1e-12)
    buffer = np.zeros(shape[0] * shape[1], dtype=np.int64)
    for faces, first_row, rows in _pieces(corners, facing, shape):
        line, row = _repeat_ranges(first_row, rows)
        triangle = corners[faces]
        begin, counts = _spans(triangle, line, row, shape[1])
        slope_x, slope_y, level = _planes(triangle)
        # linear in the flat index of a sample, row * width + column; the constant contains the row's part
        slope = (slope_x * steps)[line]
        at_zero = ((level[line] + slope_y[line] * row - low) * steps) - slope * (row * shape[1])
        span, pixel = _repeat_ranges(row * shape[1] + begin, counts)
        step = np.clip(at_zero[span] + slope[span] * pixel, 0, _NEAREST - 2).astype(np.int64) + 1
        step <<= 32
        step |= faces[line][span]
        np.maximum.at(buffer, pixel, step)
    near = (buffer >> 32).reshape(shape)
    face = np.where(near > 0, (buffer & 0xFFFFFFFF).reshape(shape), -1)
    return _Seen(face=face, depth=np.asarray(np.maximum(near - 1, 0) / steps, dtype=np.float32))


def _pieces(corners: FloatArray, facing: IntArray, shape: tuple[int, int]) -> Iterator[tuple[IntArray, IntArray, IntArray]]:
    """The faces with first row and number of rows, in pieces of bounded size."""
    y = corners[facing, :, 1]
    first = np.maximum(np.ceil(y.min(axis=1) - _SPAN_SLACK), 0).astype(np.int64)
    last = np.minimum(np.floor(y.max(axis=1) + _SPAN_SLACK), shape[0] - 1).astype(np.int64)
    rows = np.maximum(last - first + 1, 0)
    # about half the samples of a triangle's bounding box
    samples = rows * (np.ptp(corners[facing, :, 0], axis=1) + 2) / 2
    piece = (np.cumsum(samples) // _SAMPLES_AT_ONCE).astype(np.int64)
    for i in np.split(np.arange(len(facing)), np.flatnonzero(np.diff(piece)) + 1):
        yield facing[i], first[i], rows[i]


def _repeat_ranges(first: IntArray, counts: IntArray) -> tuple[IntArray, IntArray]:
    """Index of every item, repeated `counts` times, and numbers from its `first` on."""
    index = np.repeat(np.arange(len(counts)), counts)
    return index, np.arange(len(index)) + (first - np.cumsum(counts) + counts)[index]


def _spans(triangle: FloatArray, line: IntArray, row: IntArray, width: int) -> tuple[IntArray, IntArray]:
    """First column and number of columns of each scan line inside its triangle."""
    left, right = np.full(len(line), np.inf), np.full(len(line), -np.inf)
    for i in range(3):
        a, b = triangle[:, i, :2], triangle[:, i - 1, :2]
        fall = b[:, 1] - a[:, 1]
        # horizontal edges cross no scan line; the two others bound it
        per_row = 1.0 / np.where(fall == 0.0, np.inf, fall)
        along = (row - a[line, 1]) * per_row[line]
        crossing = a[line, 0] + along * (b[:, 0] - a[:, 0])[line]
        # with slack a sample on the edge of two triangles belongs to both, without it possibly to neither
        on_edge = (fall != 0.0)[line] & (along >= -_SPAN_SLACK) & (along <= 1 + _SPAN_SLACK)
        np.minimum(left, crossing, out=left, where=on_edge)
        np.maximum(right, crossing, out=right, where=on_edge)
    begin = np.ceil(np.clip(left, 0, width) - _SPAN_SLACK)
    end = np.floor(np.clip(right, -1, width - 1) + _SPAN_SLACK)
    return begin.astype(np.int64), np.maximum(end - begin + 1, 0).astype(np.int64)


def _planes(triangle: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Depth of each triangle as slope_x * x + slope_y * y + level."""
    a, b, c = np.moveaxis(triangle, 1, 0)
    normal = np.cross(b - a, c - a)
    # n . (p - a) = 0 solved for z; the caller leaves out faces seen edge-on, with n_z near 0
    slope_x, slope_y = -normal[:, 0] / normal[:, 2], -normal[:, 1] / normal[:, 2]
    return slope_x, slope_y, a[:, 2] - slope_x * a[:, 0] - slope_y * a[:, 1]


# Edges and shadow


def _darken_creases(picture: npt.NDArray[np.float32], seen: _Seen, normals: FloatArray) -> None:
    """Draw thin darker lines at creases and at steps of depth."""
    flat, face, depth = picture.reshape(-1), seen.face.reshape(-1), seen.depth.reshape(-1)
    for step in (1, seen.face.shape[1]):
        a, b = face[:-step], face[step:]
        at = np.flatnonzero((a != b) & (np.minimum(a, b) >= 0))
        one, other = normals[a[at]], normals[b[at]]
        # depth of a plane changes by at most 1 / n_z between samples; more than three times that is a step
        rise = 1.5 + 3.0 / np.minimum(one[:, 2], other[:, 2])
        edge = (np.einsum("ij,ij->i", one, other) < _CREASE_COS) | (np.abs(depth[at] - depth[at + step]) > rise)
        flat[at[edge]] *= _CREASE_SHADE


def _hidden(depth: npt.NDArray[np.float32], samples: int) -> npt.NDArray[np.float32]:
    """Shadow mask: 1 where a nearer surface is between a pixel and the light, 0 elsewhere, softened.

    depth (height, width): Depth of one sample of each pixel, in samples, of which a pixel has `samples` along each axis.
    """
    import cv2

    across, down, rise = _LIGHT[0], -_LIGHT[1], _LIGHT[2]
    longest = max(abs(across), abs(down))
    hidden = np.zeros(depth.shape, dtype=np.float32)
    for i in range(1, _SHADOW_STEPS + 1):
        # one pixel a step along the light's longer axis; the ray rises by rise / longest pixels of depth meanwhile
        u, v = round(i * across / longest), round(i * down / longest)
        moved = cv2.warpAffine(
            depth, np.array([[1, 0, -u], [0, 1, -v]], dtype=np.float32), depth.shape[::-1], flags=cv2.INTER_NEAREST
        )
        # half a pixel more than the ray's height, so that rounding does not make a face shadow itself
        hidden = np.maximum(hidden, (moved - depth > samples * (0.5 + i * rise / longest)).astype(np.float32))
    return np.asarray(cv2.GaussianBlur(hidden, (0, 0), 0.8))
