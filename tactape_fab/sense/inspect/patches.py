"""Pieces of a scan around parts, brought into each part's own axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tactape_fab.base.libraries import library
from tactape_fab.sense.inspect.scan_files import Picture
from tactape_fab.sense.inspect.warp import Warp
from tactape_fab.texture.frames import FloatArray

Samples = npt.NDArray[np.float32]

_MOST_ROWS = 30_000
"""OpenCV's remap counts rows in 16 bits."""
FINEST_PX_PER_MM = 60.0
"""Samples are no nearer than this: the optics of a scanner do not resolve more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PatchGrid:
    """Points in a part's axes: a along it, b across it, mm; both of shape (m,), in rows of b."""

    a_mm: FloatArray
    b_mm: FloatArray
    shape: tuple[int, int]
    step_mm: float

    @property
    def count(self) -> int:
        return len(self.a_mm)


def patch_grid(half_a_mm: float, half_b_mm: float, px_per_mm: float) -> PatchGrid:
    """A grid as fine as the scan's pixels, symmetric about the part's centre."""
    step = 1.0 / min(px_per_mm, FINEST_PX_PER_MM)
    na, nb = int(half_a_mm / step), int(half_b_mm / step)
    a, b = np.meshgrid(np.arange(-na, na + 1) * step, np.arange(-nb, nb + 1) * step)
    return PatchGrid(a_mm=a.ravel(), b_mm=b.ravel(), shape=a.shape, step_mm=step)


def sample(picture: Picture, warp: Warp, centre_mm: FloatArray, turn_deg: npt.ArrayLike, grid: PatchGrid) -> Samples:
    """The scan at a grid around each centre.

    picture (h, w, 3)
    centre_mm (n, 2): Board frame.
    turn_deg (n,): Of a's axis against board x, counter-clockwise.
    Returns (n, m, 3): Black outside the scan.
    """
    cv2 = library("cv2", "inspecting a scan")
    n = len(centre_mm)
    turn = np.broadcast_to(np.radians(np.asarray(turn_deg, dtype=np.float64)), (n,))
    c, s = np.cos(turn), np.sin(turn)
    # a warp hardly bends within a patch: its linear part there serves all points
    along = warp.jacobian(centre_mm) @ np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)  # (n, 2, 2)
    steps = np.concatenate([along, warp.smooth(centre_mm)[..., None]], axis=2).astype(np.float32)
    points = np.stack([grid.a_mm, grid.b_mm, np.ones(grid.count)]).astype(np.float32)
    shifts = [(line.axis, line.of_pixels(picture.shape[1 - line.axis]).T.copy()) for line in warp.lines]
    out = np.empty((n, grid.count, 3), dtype=np.float32)
    # so many patches at a time, one below the other
    rows = max(1, _MOST_ROWS // grid.shape[0])
    for start in range(0, n, rows):
        chunk = slice(start, min(start + rows, n))
        px = [steps[chunk, k] @ points for k in range(2)]
        for axis, of_pixels in shifts:
            # the line that a sample lies in, and then its shift: see `LineShift.of_pixels`
            nearest = np.rint(px[axis]).astype(np.int32)
            px = [px[k] + of_pixels[k].take(nearest, mode="clip") for k in range(2)]
        u, v = (side.reshape(-1, grid.shape[1]) for side in px)
        out[chunk] = cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderValue=(0, 0, 0)).reshape(-1, grid.count, 3)
    return out
