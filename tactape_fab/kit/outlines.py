"""The outlines of one part as it stands on the film: turned once, then only moved."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from tactape_fab.profiles import FabProfile, LandPattern, PartProfile
from tactape_fab.texture.frames import FloatArray, snap_mm
from tactape_fab.texture.shapes import placed_outline, rotate

FOOT_POINTS = 128
"""Vertices of a dome's foot: within 0.1 um of a circle of 0.6 mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PartOutlines:
    """Outlines of one turned part about its centre, as written and measured (mm); each of shape (k, 2).

    ``pad`` and ``paste`` are one land's outline about its own centre; ``pad_xy`` and ``paste_xy``, shape (2, 2), are
    the centres of lands 1 and 2. ``opening`` is the coverlay opening: the box round both pads and the expansion.
    """

    body: FloatArray
    largest_body: FloatArray
    courtyard: FloatArray
    pad: FloatArray
    pad_xy: FloatArray
    paste: FloatArray
    paste_xy: FloatArray
    opening: FloatArray
    opening_size_mm: tuple[float, float]

    @property
    def pads(self) -> FloatArray:
        """Vertices of both pads about the part's centre; shape (2 k, 2)."""
        return (self.pad_xy[:, None] + self.pad).reshape(-1, 2)


def part_outlines(part: PartProfile, fab: FabProfile, rotation_deg: float) -> PartOutlines:
    """Turn a part's outlines by `rotation_deg` counter-clockwise and add the fab's coverlay opening."""

    def box(size_mm: tuple[float, float], wider_mm: float = 0.0) -> FloatArray:
        return placed_outline((size_mm[0] + wider_mm, size_mm[1] + wider_mm), 0.0, rotation_deg)

    def land(pattern: LandPattern) -> FloatArray:
        return placed_outline(pattern.size_mm, pattern.corner_radius_mm, rotation_deg)

    def centres(pattern: LandPattern) -> FloatArray:
        return snap_mm(rotate([(-pattern.offset_mm, 0.0), (pattern.offset_mm, 0.0)], rotation_deg))

    pair_mm = (2 * part.pads.offset_mm + part.pads.size_mm[0], part.pads.size_mm[1])
    wider_mm = 2 * fab.coverlay_expansion_mm
    return PartOutlines(
        body=box(part.body_mm[:2]),
        largest_body=box(part.body_mm[:2], part.body_tolerance_mm),
        courtyard=box(part.courtyard_mm),
        pad=land(part.pads),
        pad_xy=centres(part.pads),
        paste=land(part.paste),
        paste_xy=centres(part.paste),
        opening=box(pair_mm, wider_mm),
        opening_size_mm=(pair_mm[0] + wider_mm, pair_mm[1] + wider_mm),
    )


def element_outline(shape: str, body_mm: tuple[float, float, float], rotation_deg: float) -> FloatArray:
    """Foot of a solid element about its centre, counter-clockwise, not closed; shape (k, 2)."""
    if shape == "block":
        return placed_outline(body_mm[:2], 0.0, rotation_deg)
    angle = np.arange(FOOT_POINTS) * (2 * pi / FOOT_POINTS)
    return snap_mm(body_mm[0] / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
