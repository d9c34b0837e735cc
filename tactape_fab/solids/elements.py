"""The solid elements (block, spherical cap, truncated cone) as loops in the part's own frame.

A part's frame: origin at the part's centre on the surface, x and y along board x and y, z along the surface's normal.
"""

from __future__ import annotations

from math import acos, asin, ceil, cos, pi, radians, sin, sqrt

import numpy as np

from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.shapes import rotate

CHORD_ERROR_MM = 0.015
"""Largest distance of a mesh's chords from a dome's circles, mm: a third of a printer's layer."""
_LEAST_POINTS, _LEAST_RINGS = 12, 3


def dome_points(part: TapePart) -> int:
    """Number of vertices of a dome's foot in a mesh, a multiple of four for fourfold symmetry."""
    # sagitta of a chord of n on a circle of radius D / 2: D / 2 (1 - cos(pi / n)) <= e gives n >= pi / acos(1 - 2 e / D)
    half_turn = acos(max(1 - 2 * CHORD_ERROR_MM / part.body_mm[0], 0.0))
    return max(_LEAST_POINTS, 4 * ceil(pi / half_turn / 4))


def dome_rings(part: TapePart) -> int:
    """Number of rings of a spherical cap in a mesh, with the foot, without the apex."""
    sphere_mm = sphere_radius_mm(part)
    # as above along a meridian of the sphere: rings cap / n apart have chords of half angle cap / 2n
    half_step = acos(max(1 - CHORD_ERROR_MM / sphere_mm, 0.0))
    return max(_LEAST_RINGS, ceil(_cap_rad(part) / half_step / 2))


def _cap_rad(part: TapePart) -> float:
    """Angle at the sphere's centre between the top of a cap and its foot."""
    # a cap is lower than its foot's radius (`read_part`), so less than a hemisphere, and the arc sine is unique
    return asin(min(part.body_mm[0] / 2 / sphere_radius_mm(part), 1.0))


def sphere_radius_mm(part: TapePart) -> float:
    """Radius of a cap's sphere, from the diameter of its foot and its height."""
    foot_mm, height_mm = part.body_mm[0] / 2, part.body_mm[2]
    # Pythagoras: rho^2 = f^2 + (rho - h)^2
    return (foot_mm**2 + height_mm**2) / (2 * height_mm)


def reach_mm(part: TapePart) -> tuple[float, float]:
    """Largest |x| and |y| of the rotated element about its centre, mm."""
    if part.shape == "dome":
        return part.body_mm[0] / 2, part.body_mm[0] / 2
    c, s = abs(cos(radians(part.rotation_deg))), abs(sin(radians(part.rotation_deg)))
    length_mm, width_mm = part.body_mm[:2]
    return (length_mm * c + width_mm * s) / 2, (length_mm * s + width_mm * c) / 2


def block_corners_mm(part: TapePart) -> FloatArray:
    """Corners of a block's foot in the part's frame, counter-clockwise from the lower left; shape (4, 2)."""
    half = np.array(part.body_mm[:2]) / 2
    return rotate(half * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]), part.rotation_deg)


def element_rings_mm(part: TapePart) -> FloatArray:
    """An element as closed loops from foot to top, all with as many points, counter-clockwise seen from above.

    The top ring of a block or truncated cone bounds a flat face; that of a spherical cap is closed by an apex.

    Returns (rings, points, 3): In the part's frame; the foot is at z = 0.
    """
    length_mm, _, height_mm = part.body_mm
    if part.shape == "block":
        corners = block_corners_mm(part)
        return np.stack([np.c_[corners, np.zeros(4)], np.c_[corners, np.full(4, height_mm)]])
    angle = np.arange(count := dome_points(part)) * (2 * pi / count)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if part.top_mm is not None:
        radii, heights = np.array([length_mm, part.top_mm]) / 2, np.array([0.0, height_mm])
    else:
        sphere_mm = sphere_radius_mm(part)
        polar = _cap_rad(part) * (1 - np.arange(count := dome_rings(part)) / count)
        radii, heights = sphere_mm * np.sin(polar), sphere_mm * np.cos(polar) + height_mm - sphere_mm
        # exactly 0, where rounding of the sines leaves some 1e-17 mm
        heights[0] = 0.0
    rings = radii[:, None, None] * circle
    return np.concatenate([rings, np.broadcast_to(heights[:, None, None], (*rings.shape[:2], 1))], axis=2)


def has_apex(part: TapePart) -> bool:
    """Whether the element ends in a point above its top ring."""
    return part.shape == "dome" and part.top_mm is None


def ring_faces(rings: int, points: int) -> IntArray:
    """Triangles between loops of equal length, outside to the right of each loop; indices ring * points + point."""
    ring, point = np.meshgrid(np.arange(rings - 1), np.arange(points), indexing="ij")
    a = (ring * points + point).ravel()
    b = (ring * points + (point + 1) % points).ravel()
    return np.concatenate([np.stack([a, b, b + points], axis=1), np.stack([a, b + points, a + points], axis=1)])


def cap_faces(first: int, points: int, apex: int | None) -> IntArray:
    """Triangles that close a convex loop of `points` vertices from index `first`, through an apex where there is one."""
    if apex is None:
        i = np.arange(1, points - 1)
        return np.stack([np.full_like(i, first), first + i, first + i + 1], axis=1)
    i = np.arange(points)
    return np.stack([first + i, first + (i + 1) % points, np.full(points, apex)], axis=1)


def closed_element(part: TapePart, sink_mm: float) -> tuple[FloatArray, IntArray]:
    """One element as a closed mesh that extends `sink_mm` below its foot, for a boolean union with a surface.

    Returns vertices (v, 3): In the part's frame, mm.
    Returns faces (f, 3): Counter-clockwise seen from outside.
    """
    rings = element_rings_mm(part)
    buried = rings[:1] - (0.0, 0.0, sink_mm)
    loops = np.concatenate([buried, rings])
    count, points = loops.shape[:2]
    vertices = loops.reshape(-1, 3)
    apex = None
    if has_apex(part):
        apex = len(vertices)
        vertices = np.vstack([vertices, (0.0, 0.0, part.body_mm[2])])
    # the floor faces down, so its loop is reversed
    bottom = cap_faces(0, points, None)[:, ::-1]
    faces = np.concatenate([bottom, ring_faces(count, points), cap_faces((count - 1) * points, points, apex)])
    return vertices, faces


def element_volume_mm3(part: TapePart) -> float:
    """Exact volume above a flat surface."""
    length_mm, width_mm, height_mm = part.body_mm
    if part.shape == "block":
        return length_mm * width_mm * height_mm
    foot_mm = length_mm / 2
    if part.top_mm is not None:
        top_mm = part.top_mm / 2
        return pi * height_mm / 3 * (foot_mm**2 + foot_mm * top_mm + top_mm**2)
    # for a spherical cap: the integral of pi (rho^2 - z^2) from z = rho - h to rho
    return pi * height_mm / 6 * (3 * foot_mm**2 + height_mm**2)


def foot_area_mm2(part: TapePart) -> float:
    """Area that an element covers on a flat surface."""
    length_mm, width_mm, _ = part.body_mm
    return pi * length_mm**2 / 4 if part.shape == "dome" else length_mm * width_mm


def narrowest_mm(part: TapePart) -> float:
    """The element's narrowest width: that of its flat top if it has one, else that of its foot."""
    if part.top_mm is not None:
        return part.top_mm
    return min(part.body_mm[:2])


def mean_radius_mm(part: TapePart) -> float:
    """Radius of a disc as large as the element's foot."""
    return sqrt(foot_area_mm2(part) / pi)
