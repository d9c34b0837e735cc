"""Extraction of one tape's content from a panel's files, in the form of the tape's own files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tactape_fab.kit.read.gerber_file import GerberContent
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.frames import BoolArray, FloatArray
from tactape_fab.texture.panel_manifest import PlacedTape
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.layers.board import PART_DATA
from tactape_fab.verify.layers.lands import PLACE_TOLERANCE_MM


@dataclass(frozen=True, slots=True, kw_only=True)
class OnPanel:
    """A kit's tape and its place on the panel."""

    tape: Tape
    place: PlacedTape

    @property
    def first(self) -> int:
        """Index of its first part among all parts of the panel."""
        return self.place.first_number - 1

    @property
    def offset(self) -> FloatArray:
        """Place of the tape's board origin in the panel's frame, mm; shape (2,)."""
        return np.array(self.place.offset_mm)

    @property
    def turned(self) -> bool:
        """Whether the tape lies turned by 90 degrees."""
        return self.place.rotation_deg != 0.0

    def turned_back(self, xy_mm: FloatArray) -> FloatArray:
        """Vectors from the panel's frame in the tape's board frame."""
        # a tape is unturned, or turned by 90 deg counter-clockwise, whose inverse is (x, y) -> (y, -x)
        return np.stack([xy_mm[..., 1], -xy_mm[..., 0]], axis=-1) if self.turned else xy_mm

    def on_board(self, xy_mm: FloatArray) -> FloatArray:
        """Points from the panel's frame in the tape's board frame."""
        return self.turned_back(xy_mm - self.offset)

    def on_panel(self, xy_mm: FloatArray) -> FloatArray:
        """Points from the tape's board frame in the panel's frame."""
        placed: FloatArray = np.stack([-xy_mm[..., 1], xy_mm[..., 0]], axis=-1) if self.turned else xy_mm
        return placed + self.offset


def inside(xy_mm: FloatArray, on: OnPanel) -> BoolArray:
    """Mask of the points on a tape's board; shape (n,)."""
    local = on.on_board(xy_mm)
    high = np.array(on.tape.board.size_mm) + PLACE_TOLERANCE_MM
    return np.asarray(((local >= -PLACE_TOLERANCE_MM) & (local <= high)).all(axis=-1))


def whole(shapes: Sequence[FloatArray], on: OnPanel) -> list[int]:
    """Indices of the shapes that are entirely on a tape's board."""
    return [i for i, shape in enumerate(shapes) if inside(shape, on).all()]


def of_tape(content: GerberContent, on: OnPanel) -> GerberContent:
    """Content of a layer on one tape, in the tape's board frame and with the tape's designators."""
    keep = np.flatnonzero(inside(content.flash_xy_mm, on))
    # only the apertures that this tape uses, renumbered
    used, aperture = np.unique(content.flash_aperture[keep], return_inverse=True)
    strokes = whole(content.strokes_mm, on)
    return replace(
        content,
        flash_xy_mm=on.on_board(content.flash_xy_mm[keep]),
        flash_aperture=aperture.astype(np.int64),
        aperture_outlines_mm=tuple(on.turned_back(content.aperture_outlines_mm[i]) for i in used),
        aperture_functions=tuple(content.aperture_functions[i] for i in used),
        flash_component=tuple(_renumbered(content.flash_component[i], on) for i in keep),
        flash_pin=tuple(content.flash_pin[i] for i in keep),
        areas_mm=tuple(on.on_board(content.areas_mm[i]) for i in whole(content.areas_mm, on)),
        strokes_mm=tuple(on.on_board(content.strokes_mm[i]) for i in strokes),
        stroke_width_mm=content.stroke_width_mm[strokes],
    )


def _renumbered(name: str, on: OnPanel) -> str:
    """The tape's designator for a designator of the panel."""
    return f"R{int(name[1:]) - on.first}" if name[:1] == "R" and name[1:].isdecimal() else name


def part_data_of_tape(data: bytes, on: OnPanel) -> bytes:
    """Attributes of one tape's parts in the component layer: those in force at its start, and those set within it."""
    start, end = (data.find(b"%%TO.C,R%d*%%" % number) for number in (on.first + 1, on.first + on.tape.part_count + 1))
    # an attribute is in force until it is set again or deleted, so later tapes have only the changes
    standing = dict(PART_DATA.findall(data[: max(start, 0)]))
    before = b"".join(b"%%TO.C%s,%s*%%\n" % (name, _turned_back(name, value, on)) for name, value in standing.items())
    until = len(data) if end < 0 else max(data.rfind(b"%TD.P*%", 0, end), start)  # the rest concerns the next tape
    return before + data[max(start, 0) : until]


def _turned_back(name: bytes, value: bytes, on: OnPanel) -> bytes:
    """The tape's rotation for a rotation on the panel; other attributes are unchanged."""
    if name != b"Rot" or not on.turned:
        return value
    own_deg = on.tape.part.rotation_deg
    # compared as text, as six digits are written and adding the turn may round the last one
    if value == b"%g" % ((own_deg + on.place.rotation_deg) % 360.0):
        return b"%g" % own_deg
    return b"%g" % ((float(value) - on.place.rotation_deg) % 360.0) if re.fullmatch(rb"\d{1,3}(\.\d{1,6})?", value) else value


def rows_of_tape(cpl: CplContent, on: OnPanel) -> CplContent:
    """Rows of one tape in the panel's pick-and-place file, in its board frame, with its own designators and rotations."""
    rows = slice(on.first, on.first + on.tape.part_count)
    return replace(
        cpl,
        lines=cpl.lines[rows],
        designators=tuple(_renumbered(name, on) for name in cpl.designators[rows]),
        xy_mm=on.on_board(cpl.xy_mm[rows]),
        sides=cpl.sides[rows],
        rotation_deg=(cpl.rotation_deg[rows] - on.place.rotation_deg) % 360.0,
        texts={content: cells[rows] for content, cells in cpl.texts.items()},
    )
