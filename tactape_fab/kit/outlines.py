"""Outlines of one part on the film; they are rotated once, then only translated."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi

import numpy as np

from tactape_fab.kit.profiles import FabProfile, LandPattern, PartProfile
from tactape_fab.texture.frames import FloatArray, snap_mm
from tactape_fab.texture.shapes import placed_outline, rotate

_END_POINTS = 32
FOOT_POINTS = 128
"""Number of vertices of a dome's foot: within 0.1 um of a circle of 0.6 mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PartOutlines:
    """Outlines of one rotated part about its centre, as written and measured (mm); each of shape (k, 2).

    ``pad`` and ``paste`` are one land's outline about its own centre; ``pad_xy`` and ``paste_xy``, shape (2, 2), are
    the centres of lands 1 and 2. ``opening`` is the coverlay opening: the bounding box of both pads plus the expansion.
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
        """Vertices of both pads about the part's centre, mm; shape (2 k, 2)."""
        return (self.pad_xy[:, None] + self.pad).reshape(-1, 2)


def part_outlines(part: PartProfile, fab: FabProfile, rotation_deg: float) -> PartOutlines:
    """Outlines of a part, turned by `rotation_deg` counter-clockwise, with the fab's coverlay opening."""

    def box(size_mm: tuple[float, float], wider_mm: float = 0.0) -> FloatArray:
        # each outline is rotated and snapped once, so that its copies differ only by shifts of whole nanometres, as in the files
        return placed_outline((size_mm[0] + wider_mm, size_mm[1] + wider_mm), 0.0, rotation_deg)

    def land(pattern: LandPattern) -> FloatArray:
        return placed_outline(pattern.size_mm, pattern.corner_radius_mm, rotation_deg)

    def centres(pattern: LandPattern) -> FloatArray:
        return snap_mm(rotate([(-pattern.offset_mm, 0.0), (pattern.offset_mm, 0.0)], rotation_deg))

    opening = opening_size_mm(part, fab)
    return PartOutlines(
        body=box(part.body_mm[:2]),
        largest_body=box(part.body_mm[:2], part.body_tolerance_mm),
        courtyard=box(part.courtyard_mm),
        pad=land(part.pads),
        pad_xy=centres(part.pads),
        paste=land(part.paste),
        paste_xy=centres(part.paste),
        opening=box(opening),
        opening_size_mm=opening,
    )


def opening_size_mm(part: PartProfile, fab: FabProfile) -> tuple[float, float]:
    """Length and width of a part's coverlay opening, mm: the box of both pads with the expansion on each side."""
    length_mm, width_mm = part.lands_mm
    return length_mm + 2 * fab.coverlay_expansion_mm, width_mm + 2 * fab.coverlay_expansion_mm


def spur_tips(opening_size: tuple[float, float], fab: FabProfile, rotation_deg: float) -> FloatArray:
    """Centres of the round ends of a part's two spurs about the part's centre, mm; shape (2, 2). The spurs extend under the
    coverlay by the profile's overlap.
    """
    # the copper ends one overlap beyond the opening's edge; the centre of its round end is half a web before that
    tip_mm = opening_size[0] / 2 + fab.anchor.overlap_mm - fab.anchor.web_mm / 2
    return snap_mm(rotate([(-tip_mm, 0.0), (tip_mm, 0.0)], rotation_deg))


def copper_outline(outlines: PartOutlines, fab: FabProfile, rotation_deg: float, *, anchored: bool) -> FloatArray:
    """Points whose convex hull contains a part's copper about its centre: pads, and spurs if any, mm; shape (k, 2)."""
    if not anchored:
        return outlines.pads
    angle = np.arange(_END_POINTS) * (2 * pi / _END_POINTS)
    # corners on a circle of r / cos(pi / n) make the sides tangents of the circle of r, so the polygon contains the round end
    round_end = fab.anchor.web_mm / 2 / cos(pi / _END_POINTS) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    tips = spur_tips(outlines.opening_size_mm, fab, rotation_deg)
    return np.concatenate([outlines.pads, (tips[:, None] + round_end).reshape(-1, 2)])


def element_outline(shape: str, body_mm: tuple[float, float, float], rotation_deg: float) -> FloatArray:
    """Foot outline of a solid element about its centre, counter-clockwise, not closed, mm; shape (k, 2)."""
    if shape == "block":
        return placed_outline(body_mm[:2], 0.0, rotation_deg)
    angle = np.arange(FOOT_POINTS) * (2 * pi / FOOT_POINTS)
    return snap_mm(body_mm[0] / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
