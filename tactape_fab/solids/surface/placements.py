"""Placements file: places of a texture's elements on a surface, as CSV; the reader checks every value."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass

import numpy as np

from tactape_fab.base.errors import TactapeError
from tactape_fab.solids.surface.place import LaidOut
from tactape_fab.texture.frames import FloatArray, IntArray

COLUMNS = (
    *("Designator", "Column", "Row", "X", "Y", "Z", "Grid X", "Grid Y", "Grid Z"),
    *("Axis X", "Axis Y", "Axis Z", "Normal X", "Normal Y", "Normal Z"),
)
"""Columns: an element's middle on the surface and its grid point (mm), its board x axis and outward normal (unit vectors)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placed:
    """The rows of a placements file: model coordinates, mm.

    cells (n, 2): Column and row.
    points_mm, grid_mm, x_axis, normal (n, 3)
    """

    designators: tuple[str, ...]
    cells: IntArray
    points_mm: FloatArray
    grid_mm: FloatArray
    x_axis: FloatArray
    normal: FloatArray


class PlacementsError(TactapeError):
    """A placements file that cannot be read."""


def placements_csv(laid: LaidOut) -> bytes:
    """The placements of a texture: mm with 6 decimals, directions with 9."""
    # rounded, then + 0.0, as "%.6f" would write a tiny negative number as -0.000000
    places = np.round(np.hstack([laid.elements.points_mm, laid.grid.points_mm]), 6) + 0.0
    directions = np.round(np.hstack([laid.elements.x_axis, laid.elements.normal]), 9) + 0.0
    text = io.StringIO(newline="")
    text.write(",".join(COLUMNS) + "\r\n")
    row = "%s,%d,%d," + ",".join(["%.6f"] * 6 + ["%.9f"] * 6) + "\r\n"
    values = (laid.tape.designators(), laid.tape.cells().tolist(), places.tolist(), directions.tolist())
    for name, cell, place, direction in zip(*values, strict=True):
        text.write(row % (name, *cell, *place, *direction))
    return text.getvalue().encode("ascii")


def read_placements(data: bytes, count: int) -> Placed:
    """Read a placements file of `count` elements.

    Raises PlacementsError if columns, number of rows or values are wrong.
    """
    try:
        rows = list(csv.reader(io.StringIO(data.decode("ascii"), newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise PlacementsError(f"it is no CSV file: {error}") from error
    if not rows or tuple(rows[0]) != COLUMNS:
        raise PlacementsError(f"its columns are not {', '.join(COLUMNS)}")
    if len(rows) - 1 != count:
        raise PlacementsError(f"it has {len(rows) - 1} rows for {count} elements")
    if any(len(row) != len(COLUMNS) for row in rows):
        raise PlacementsError("a row has too few or too many values")
    try:
        cells = np.array([row[1:3] for row in rows[1:]], dtype=np.int64).reshape(-1, 2)
        numbers = np.array([row[3:] for row in rows[1:]], dtype=np.float64).reshape(-1, 12)
    except (ValueError, OverflowError) as error:
        raise PlacementsError(f"a value is not a number: {error}") from error
    if not np.isfinite(numbers).all() or np.abs(numbers).max(initial=0) > 1e6:
        raise PlacementsError("a value is not finite or beyond 1 km")
    points, grid, x_axis, normal = (numbers[:, i : i + 3] for i in (0, 3, 6, 9))
    return Placed(
        designators=tuple(row[0] for row in rows[1:]), cells=cells, points_mm=points, grid_mm=grid, x_axis=x_axis, normal=normal
    )
