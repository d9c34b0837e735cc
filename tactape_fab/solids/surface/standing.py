"""Exact volumes of elements on a plane, a cylinder or a cone; vectorised, without a CAD kernel."""

from __future__ import annotations

from math import pi, radians

import numpy as np

from tactape_fab.solids.elements import sphere_radius_mm
from tactape_fab.solids.surface.charts import Frames
from tactape_fab.solids.surface.developed import Developable
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart

_NODES = 8
_DIRECTIONS = 32
_HALVINGS = 44


def standing_mm3(part: TapePart, surface: Developable, frames: Frames, sink_mm: float) -> FloatArray:
    """Volume of each element outside its surface, with the flank extended below the foot; shape (n,).

    sink_mm: Depth of the elements below the tangent plane; the surface intersects all of them above that.
    """
    if part.shape == "block":
        return _blocks_mm3(part, surface, frames)
    return _domes_mm3(part, surface, frames, sink_mm)


def _blocks_mm3(part: TapePart, surface: Developable, frames: Frames) -> FloatArray:
    length, width, height = part.body_mm
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    along, across = (a.ravel() for a in np.meshgrid(length / 2 * node, width / 2 * node, indexing="ij"))
    c, s = np.cos(radians(part.rotation_deg)), np.sin(radians(part.rotation_deg))
    shape = (len(frames.points_mm), _NODES**2)
    x, y = (np.broadcast_to(a, shape) for a in (c * along - s * across, s * along + c * across))
    # sides are vertical, so the surface's mean height over the tangent plane is subtracted from the block's
    mean_mm = surface.heights(frames, x, y) @ np.outer(weight, weight).ravel() / 4
    return length * width * (height - mean_mm)


def _domes_mm3(part: TapePart, surface: Developable, frames: Frames, sink_mm: float) -> FloatArray:
    foot_mm, height_mm = part.body_mm[0] / 2, part.body_mm[2]
    top_mm = 0.0 if part.top_mm is None else part.top_mm / 2
    if part.top_mm is None:
        ball_mm = rim_mm = sphere_radius_mm(part)
        middle_mm = height_mm - ball_mm
    else:
        ball_mm, middle_mm, rim_mm = 0.0, 0.0, foot_mm + (foot_mm - top_mm) / height_mm * sink_mm

    def flank_mm(radius: FloatArray) -> FloatArray:
        """Height of the flank at distances from the element's axis."""
        if part.top_mm is None:
            return np.asarray(middle_mm + np.sqrt(np.maximum(ball_mm**2 - radius**2, 0.0)))
        return height_mm * (foot_mm - radius) / (foot_mm - top_mm)

    def below_flank_mm2(radius: FloatArray) -> FloatArray:
        """Integral of height times radius, over the distance from the element's axis."""
        if part.top_mm is None:
            return middle_mm * radius**2 / 2 + (ball_mm**3 - np.maximum(ball_mm**2 - radius**2, 0.0) ** 1.5) / 3
        slope, out = height_mm / (foot_mm - top_mm), radius**2 - top_mm**2
        return height_mm * top_mm**2 / 2 + slope * (foot_mm * out / 2 - (radius**3 - top_mm**3) / 3)

    angle = np.arange(_DIRECTIONS) * (2 * pi / _DIRECTIONS)
    c, s = np.cos(angle), np.sin(angle)
    count = len(frames.points_mm)
    low, high = np.full((count, _DIRECTIONS), top_mm), np.full((count, _DIRECTIONS), rim_mm)
    # the flank falls outward faster than the surface, so there is one intersection, or none above the rim
    for _ in range(_HALVINGS):
        radius = (low + high) / 2
        outside = flank_mm(radius) > surface.heights(frames, radius * c, radius * s)
        low, high = np.where(outside, radius, low), np.where(outside, high, radius)
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    area = below_flank_mm2(low)
    for at, share in zip((node + 1) / 2, weight / 2, strict=True):
        area -= share * low * surface.heights(frames, at * low * c, at * low * s) * at * low
    return np.asarray(area.mean(axis=1) * 2 * pi)
