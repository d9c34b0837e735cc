"""Tapes of any grid anywhere in a code plane, for tests that need no kit."""

from __future__ import annotations

import numpy as np

from tactape_fab import Tape, default_origin
from tactape_fab.texture.board import Board
from tactape_fab.texture.code import get_plane
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.plane import encode


def tape_at(
    sector: int,
    grid: tuple[int, int],
    *,
    code: str = "microdots-4x4",
    origin: tuple[int, int] | None = None,
    name: str | None = None,
) -> Tape:
    """A tape of so many columns and rows; at the sector's default origin where none is given."""
    columns, rows = grid
    origin = default_origin(code, sector) if origin is None else origin
    return Tape(
        name=f"tape-{sector}" if name is None else name,
        sector=sector,
        code=code,
        origin=origin,
        columns=columns,
        rows=rows,
        pitch_mm=1.5,
        displacement_mm=0.25,
        symbols=encode(get_plane(code), sector, origin, (rows, columns)),
        omitted=np.zeros((0, 2), dtype=np.int64),
        board=Board(
            size_mm=(1.5 * columns + 6.0, 1.5 * rows + 6.0),
            texture_origin_mm=(3.0, 1.5 * rows + 3.0),
            corner_radius_mm=0.0,
            thickness_mm=0.11,
        ),
        part=TapePart(name="r0201", shape="block", body_mm=(0.6, 0.3, 0.23), rotation_deg=45.0),
        tag=None,
    )
