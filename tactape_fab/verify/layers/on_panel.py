"""Parts of a panel's files that belong to one tape, as if they were the tape's own files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tactape_fab.kit.read.gerber_file import GerberContent
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.frames import BoolArray, FloatArray
from tactape_fab.texture.panel_manifest import PlacedTape
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.layers.lands import PLACE_TOLERANCE_MM


@dataclass(frozen=True, slots=True, kw_only=True)
class OnPanel:
    """A kit's tape and its place."""

    tape: Tape
    place: PlacedTape

    @property
    def first(self) -> int:
        """Row of its first part among all parts of the panel."""
        return self.place.first_number - 1

    @property
    def offset(self) -> FloatArray:
        return np.array(self.place.offset_mm)


def inside(xy_mm: FloatArray, on: OnPanel) -> BoolArray:
    """Mask of the points on a tape's board; shape (n,)."""
    local = xy_mm - on.offset
    high = np.array(on.tape.board.size_mm) + PLACE_TOLERANCE_MM
    result: BoolArray = np.asarray(((local >= -PLACE_TOLERANCE_MM) & (local <= high)).all(axis=-1))
    return result


def whole(shapes: Sequence[FloatArray], on: OnPanel) -> list[int]:
    """Mask of the shapes on a tape's board."""
    return [i for i, shape in enumerate(shapes) if inside(shape, on).all()]


def of_tape(content: GerberContent, on: OnPanel) -> GerberContent:
    """Content of a layer on one tape, in the tape's board frame and with its designators."""
    keep = np.flatnonzero(inside(content.flash_xy_mm, on))
    used, aperture = np.unique(content.flash_aperture[keep], return_inverse=True)
    strokes = whole(content.strokes_mm, on)
    return replace(
        content,
        flash_xy_mm=content.flash_xy_mm[keep] - on.offset,
        flash_aperture=aperture.astype(np.int64),
        aperture_outlines_mm=tuple(content.aperture_outlines_mm[i] for i in used),
        aperture_functions=tuple(content.aperture_functions[i] for i in used),
        flash_component=tuple(_renumbered(content.flash_component[i], on) for i in keep),
        flash_pin=tuple(content.flash_pin[i] for i in keep),
        areas_mm=tuple(content.areas_mm[i] - on.offset for i in whole(content.areas_mm, on)),
        strokes_mm=tuple(content.strokes_mm[i] - on.offset for i in strokes),
        stroke_width_mm=content.stroke_width_mm[strokes],
    )


def _renumbered(name: str, on: OnPanel) -> str:
    """The tape's own designator for a panel's designator."""
    return f"R{int(name[1:]) - on.first}" if name[:1] == "R" and name[1:].isdecimal() else name


def rows_of_tape(cpl: CplContent, on: OnPanel) -> CplContent:
    rows = slice(on.first, on.first + on.tape.part_count)
    return replace(
        cpl,
        lines=cpl.lines[rows],
        designators=tuple(_renumbered(name, on) for name in cpl.designators[rows]),
        xy_mm=cpl.xy_mm[rows] - on.offset,
        sides=cpl.sides[rows],
        rotation_deg=cpl.rotation_deg[rows],
        texts={content: cells[rows] for content, cells in cpl.texts.items()},
    )
