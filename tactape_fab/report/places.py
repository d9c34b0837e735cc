"""Places of the parts, with their grid points and symbols."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tactape_fab.report.arrays import packed
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray, IntArray, SymbolArray, board_to_texture
from tactape_fab.texture.tape import Tape

if TYPE_CHECKING:
    from tactape_fab.solids.surface.placements import Placed


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Places:
    """Parts in the order of the list they were read from.

    xy_mm (n, 2): Board frame.
    cells (n, 2): Column and row.
    symbols (n,)
    rotation_deg (n,): Counter-clockwise.
    on_part: Place of each element on the user's own part, for a texture on one.
    tapes (n,): On a panel, the index of each part's tape.
    """

    designators: Sequence[str]
    xy_mm: FloatArray
    cells: IntArray
    symbols: SymbolArray
    rotation_deg: FloatArray
    on_part: Placed | None = None
    tapes: npt.NDArray[np.uint16] | None = None

    def to_mapping(self) -> dict[str, Any]:
        """Mapping for the page's script, arrays packed as base64 text."""
        return {
            "designators": "\n".join(self.designators),
            "xy_mm": packed(self.xy_mm, "<f8"),
            "cells": packed(self.cells, "<i4"),
            "symbols": packed(self.symbols, "u1"),
            "rotation_deg": packed(self.rotation_deg, "<f4"),
            "tapes": None if self.tapes is None else packed(self.tapes, "<u2"),
            "model_mm": None if self.on_part is None else packed(self.on_part.points_mm, "<f8"),
        }


def measured_places(tape: Tape, designators: Sequence[str], xy_mm: FloatArray, rotation_deg: FloatArray) -> Places:
    """Parts from a list of places; of the tape only the grid is used, not the symbols."""
    texture_mm = board_to_texture(xy_mm, tape.board.texture_origin_mm)
    # the nearest grid point, as displacements are below half a pitch
    cells = np.rint(texture_mm / tape.pitch_mm).astype(np.int64)
    # the symbol whose unit displacement has the largest scalar product with the part's, so the least angle (paper, Eq. 10)
    symbols = ((texture_mm - cells * tape.pitch_mm) @ DIRECTIONS_XY[: tape.directions].T).argmax(axis=1).astype(np.uint8)
    return Places(designators=designators, xy_mm=xy_mm, cells=cells, symbols=symbols, rotation_deg=rotation_deg)


def nominal_places(tape: Tape, on_part: Placed | None) -> Places:
    """Elements at the tape's nominal places, or at those of a placements file, if there is one."""
    cells = tape.cells()
    return Places(
        designators=tape.designators() if on_part is None else on_part.designators,
        xy_mm=tape.part_xy_mm(),
        cells=cells,
        symbols=tape.symbols[cells[:, 1], cells[:, 0]],
        rotation_deg=np.full(len(cells), tape.part.rotation_deg),
        on_part=on_part,
    )
