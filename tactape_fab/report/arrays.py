"""Arrays for the page's script: little-endian bytes in base64."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.texture.frames import FloatArray


def packed(values: npt.ArrayLike, kind: str) -> str:
    """Numbers in row-major order as `kind`, a little-endian numpy type such as ``"<f4"``."""
    return b64encode(np.ascontiguousarray(values, dtype=np.dtype(kind)).tobytes()).decode("ascii")


def packed_paths(paths: Sequence[FloatArray]) -> dict[str, Any]:
    """Polygons or polylines, each of shape (k, 2), mm: the concatenated points, and the index at which each ends."""
    points = np.concatenate([np.empty((0, 2)), *paths])
    return {"points": packed(points, "<f4"), "ends": packed(np.cumsum([len(path) for path in paths]), "<u4")}
