"""Geometry of an element over a cylinder: feet of domes, and volumes, exact or to machine precision."""

from __future__ import annotations

from itertools import pairwise
from math import pi

import numpy as np

from tactape_fab.solids.elements import sphere_radius_mm
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart

_BISECTIONS = 60
_GAUSS_POINTS = 40
_TURN_POINTS = 128
_WIDER = 1.5


def _surface_mm(t_mm: FloatArray, radius_mm: float) -> FloatArray:
    """Height of a cylinder under its tangent plane's z = 0, at a tangential offset."""
    # the cross section is a circle of radius R whose top touches the tangent plane: z = sqrt(R^2 - t^2) - R, never above 0
    return np.sqrt(radius_mm**2 - t_mm**2) - radius_mm


def dome_height_mm(part: TapePart, r_mm: FloatArray) -> FloatArray:
    """Height of a dome over its tangent plane at a distance from its middle; goes on downward outside its flat foot."""
    foot_mm, height_mm = part.body_mm[0] / 2, part.body_mm[2]
    if part.top_mm is None:
        sphere_mm = sphere_radius_mm(part)
        # the sphere's centre is at height h - rho, so z = h - rho + sqrt(rho^2 - r^2); past the equator the root is kept at 0
        return np.sqrt(np.maximum(sphere_mm**2 - r_mm**2, 0.0)) + height_mm - sphere_mm
    # the flank falls by h from the top's radius to the foot's, and goes on below the flat foot with that slope
    slope = height_mm / (foot_mm - part.top_mm / 2)
    return np.minimum(height_mm, (foot_mm - r_mm) * slope)


def _widest_foot_mm(part: TapePart) -> float:
    """The farthest from a dome's middle at which its foot is looked for: its sphere's equator, or half as far again."""
    wider_mm = _WIDER * part.body_mm[0] / 2
    return wider_mm if part.top_mm is not None else min(wider_mm, sphere_radius_mm(part))


def meets_cylinder(part: TapePart, radius_mm: float) -> bool:
    """Whether a dome comes down to a cylinder of this radius all round, before its sides would lean inward."""
    widest_mm = _widest_foot_mm(part)
    if widest_mm >= radius_mm:
        return False
    # the surface falls fastest along the tangent (t = r): a dome that reaches it there does so in every direction
    return bool(dome_height_mm(part, np.array([widest_mm]))[0] < _surface_mm(np.array([widest_mm]), radius_mm)[0])


def foot_radius_mm(part: TapePart, radius_mm: float, direction_rad: FloatArray) -> FloatArray:
    """Distance from a dome's middle at which it meets a cylinder, for directions counted from the tangent."""
    # only the tangential part t = r cos(direction) of a step leads down the cylinder, its part along the axis stays level
    c = np.cos(direction_rad)
    # at the flat foot's radius the dome is at 0 and the surface at 0 or below, at the widest it is the other way round
    # 60 halvings of half a foot are finer than double precision
    low = np.full_like(c, part.body_mm[0] / 2)
    high = np.full_like(c, _widest_foot_mm(part))
    for _ in range(_BISECTIONS):  # bisection: the difference falls steadily
        middle = (low + high) / 2
        above = dome_height_mm(part, middle) > _surface_mm(middle * c, radius_mm)
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return (low + high) / 2


def foot_loop_mm(part: TapePart, radius_mm: float, points: int) -> FloatArray:
    """A dome's foot on a cylinder; shape (points, 3): tangential, along the cylinder, distance from its axis."""
    angle = np.arange(points, dtype=np.float64) * (2 * pi / points)
    r = foot_radius_mm(part, radius_mm, angle)
    t = r * np.cos(angle)
    return np.stack([t, r * np.sin(angle), np.sqrt(radius_mm**2 - t**2)], axis=1)


def wrapped_volume_mm3(part: TapePart, radius_mm: float, rotation_deg: float) -> float:
    """Volume of an element between a cylinder and itself, by Gauss quadrature.

    rotation_deg: Of the element about its normal, from the direction that runs round the cylinder.
    """
    # 40 points integrate polynomials of degree 79 exactly; both heights are smooth over each piece below
    x, weight = np.polynomial.legendre.leggauss(_GAUSS_POINTS)
    length_mm, width_mm, height_mm = part.body_mm
    if part.shape == "block":
        c, s = np.cos(np.radians(rotation_deg)), np.sin(np.radians(rotation_deg))
        # over the block's own rectangle: du dv = (L / 2)(W / 2) dx dy, hence L W / 4 below
        u, v = np.meshgrid(x * length_mm / 2, x * width_mm / 2, indexing="ij")
        # t of the point (u, v) of a block that is turned by the angle whose cosine and sine are c and s
        rise = height_mm - _surface_mm(u * c - v * s, radius_mm)
        return float(np.einsum("i,j,ij->", weight, weight, rise)) * length_mm * width_mm / 4
    # round the dome the integrand is smooth and periodic: equal weights converge faster than any power of their number
    angle = np.arange(_TURN_POINTS, dtype=np.float64) * (2 * pi / _TURN_POINTS)
    outer = foot_radius_mm(part, radius_mm, angle)
    total = 0.0
    # a truncated cone has a kink at the rim of its top: Gauss points must not straddle it
    edge = [] if part.top_mm is None else [np.full_like(outer, part.top_mm / 2)]
    for low, high in pairwise([np.zeros_like(outer), *edge, outer]):
        r = (low + high)[:, None] / 2 + (high - low)[:, None] / 2 * x
        rise = dome_height_mm(part, r) - _surface_mm(r * np.cos(angle)[:, None], radius_mm)
        # dV = rise r dr dphi
        total += float(((rise * r) @ weight * (high - low) / 2).sum()) * 2 * pi / _TURN_POINTS
    return total
