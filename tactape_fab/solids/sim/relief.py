"""Height of a tape's elements over its base as an image: a heightfield, and its normal map."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from math import ceil, sqrt

import numpy as np
import numpy.typing as npt

from tactape_fab.solids.elements import reach_mm
from tactape_fab.solids.rise import dome_height_mm
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.shapes import rotate
from tactape_fab.texture.tape import Tape

FINEST_PX_PER_MM = 40
_MOST_PX = 16_000_000
LEVELS = 65_535

Image16 = npt.NDArray[np.uint16]
Image8 = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Relief:
    """Heights over the base, as an image of the whole board.

    height (h, w): mm; row 0 is at the upper edge (largest board y), columns are along board x. The value is that at the pixel's
        centre: pixel (u, v) is at board ((u + 0.5) / px_per_mm, size_y - (v + 0.5) / px_per_mm).
    top_mm: Height of an element.
    """

    height: npt.NDArray[np.float32]
    px_per_mm: float
    top_mm: float

    def levels(self) -> Image16:
        """Heights as 16-bit levels: 0 is the base, 65535 the top of an element."""
        return np.asarray(np.rint(self.height * (LEVELS / self.top_mm)).astype(np.uint16))

    def normals(self) -> Image8:
        """Normal map: red along board x, green along board y, blue out of the tape (convention of OpenGL and glTF)."""
        # central differences: (z[i+1] - z[i-1]) / (2 / px_per_mm); the normal of z(x, y) is along (-dz/dx, -dz/dy, 1)
        step = 0.5 * self.px_per_mm
        x = np.zeros_like(self.height)
        y = np.zeros_like(self.height)
        x[:, 1:-1] = (self.height[:, :-2] - self.height[:, 2:]) * step
        y[1:-1] = (self.height[2:] - self.height[:-2]) * step  # rows count downward, y points up
        length = np.sqrt(x * x + y * y + 1)
        return np.rint(127.5 + 127.5 * np.stack([x / length, y / length, 1 / length], axis=2)).astype(np.uint8)


def relief_of(tape: Tape, most_px: int = _MOST_PX) -> Relief:
    """Heights of a tape's elements; coarser than 25 micrometres per pixel if the tape has more than 100 cm2."""
    width_mm, height_mm = tape.board.size_mm
    px_per_mm = min(float(FINEST_PX_PER_MM), sqrt(most_px / (width_mm * height_mm)))
    shape = ceil(height_mm * px_per_mm), ceil(width_mm * px_per_mm)
    height = np.zeros(shape, dtype=np.float32)
    for v, u, offset_mm in stamps(tape, px_per_mm, shape):
        rise = element_height_mm(tape.part, offset_mm)
        # only pixels of the element, as its stamp may extend to a neighbour
        height[v[rise > 0], u[rise > 0]] = rise[rise > 0]
    return Relief(height=height, px_per_mm=px_per_mm, top_mm=tape.part.body_mm[2])


def stamps(
    tape: Tape, px_per_mm: float, shape: tuple[int, int]
) -> list[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], FloatArray]]:
    """Pixels around the elements of a tape: rows v, columns u, and offsets from each element's centre, mm (k, n, 2)."""
    reach = max(reach_mm(tape.part))
    # one pixel more, as the stamp is centred at a pixel, not at the element
    half = ceil(reach * px_per_mm) + 1
    span = np.arange(-half, half + 1)
    dv, du = (axis.ravel() for axis in np.meshgrid(span, span, indexing="ij"))
    out = []
    xy = tape.part_xy_mm()
    for some in np.array_split(xy, max(1, len(xy) * len(du) // 4_000_000)):
        place = np.stack([some[:, 0] * px_per_mm, (tape.board.size_mm[1] - some[:, 1]) * px_per_mm], axis=1) - 0.5
        near = np.rint(place).astype(np.int64)
        u, v = near[:, :1] + du, near[:, 1:] + dv
        # v counts downward, board y points up
        offset = np.stack([u - place[:, :1], place[:, 1:] - v], axis=2) / px_per_mm
        inside = (u >= 0) & (v >= 0) & (u < shape[1]) & (v < shape[0])
        out.append((v[inside], u[inside], offset[inside]))
    return out


def element_height_mm(part: TapePart, offset_mm: FloatArray) -> FloatArray:
    """Height of an element over the base at an offset from its centre, (..., 2) along board x and y; 0 beside it."""
    length_mm, width_mm, height_mm = part.body_mm
    if part.shape == "block":
        turned = np.abs(rotate(offset_mm, -part.rotation_deg))
        return np.where((turned <= np.array([length_mm, width_mm]) / 2).all(axis=-1), height_mm, 0.0)
    r = np.hypot(offset_mm[..., 0], offset_mm[..., 1])
    return np.where(r <= length_mm / 2, np.maximum(dome_height_mm(part, r), 0.0), 0.0)


def png_bytes(image: Image8 | Image16, px_per_m: int | None = None) -> bytes:
    """A PNG (W3C PNG, third edition): 16-bit gray or 8-bit RGB, with its physical pixel size if `px_per_m` is given.

    Written here because OpenCV does not write the physical pixel size (pHYs).
    """
    height, width = image.shape[:2]
    # colour types of PNG: 0 is gray, 2 is red, green and blue
    depth, colour = (16, 0) if image.ndim == 2 else (8, 2)
    # 16-bit samples are big-endian
    rows = np.ascontiguousarray(image.astype(">u2") if depth == 16 else image).view(np.uint8).reshape(height, -1)
    # filters subtract modulo 256, as uint8 does; the row above the first is 0
    above = np.concatenate([np.zeros_like(rows[:1]), rows[:-1]])
    lines = np.column_stack([np.full(height, 2, dtype=np.uint8), rows - above])  # filter 2, Up, as most rows repeat the previous
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))]
    if px_per_m is not None:
        chunks.append((b"pHYs", struct.pack(">IIB", px_per_m, px_per_m, 1)))
    chunks += [(b"IDAT", zlib.compress(lines.tobytes(), 6)), (b"IEND", b"")]
    framed = (struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(framed)
