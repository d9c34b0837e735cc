"""Geometry of elements on a cylinder: feet of domes, and volumes, to machine precision."""

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
    """Height of a cylinder relative to its tangent plane at a tangential offset; negative or 0."""
    # the cross-section is a circle of radius R below the tangent plane: z = sqrt(R^2 - t^2) - R
    return np.sqrt(radius_mm**2 - t_mm**2) - radius_mm


def dome_height_mm(part: TapePart, r_mm: FloatArray) -> FloatArray:
    """Height of a dome over its tangent plane at a distance from its middle; negative beyond its foot on a plane."""
    foot_mm, height_mm = part.body_mm[0] / 2, part.body_mm[2]
    if part.top_mm is None:
        sphere_mm = sphere_radius_mm(part)
        # the sphere's centre is at height h - rho, so z = h - rho + sqrt(rho^2 - r^2); beyond the equator the root is 0
        return np.sqrt(np.maximum(sphere_mm**2 - r_mm**2, 0.0)) + height_mm - sphere_mm
    # the flank falls by h from the top's radius to the foot's, and continues with that slope
    slope = height_mm / (foot_mm - part.top_mm / 2)
    return np.minimum(height_mm, (foot_mm - r_mm) * slope)


def _widest_foot_mm(part: TapePart) -> float:
    """Search limit for the radius of a dome's foot: 1.5 times that on a plane, for a cap at most its sphere's radius."""
    wider_mm = _WIDER * part.body_mm[0] / 2
    return wider_mm if part.top_mm is not None else min(wider_mm, sphere_radius_mm(part))


def meets_cylinder(part: TapePart, radius_mm: float) -> bool:
    """Whether a dome meets a cylinder of this radius in every direction, above the equator of its sphere."""
    widest_mm = _widest_foot_mm(part)
    if widest_mm >= radius_mm:
        return False
    # the surface falls fastest along the tangent (t = r): a dome that meets it there meets it in every direction
    return bool(dome_height_mm(part, np.array([widest_mm]))[0] < _surface_mm(np.array([widest_mm]), radius_mm)[0])


def foot_radius_mm(part: TapePart, radius_mm: float, direction_rad: FloatArray) -> FloatArray:
    """Distance from a dome's middle at which it meets a cylinder, for directions relative to the tangent."""
    # the height of the cylinder depends only on the tangential offset t = r cos(direction)
    c = np.cos(direction_rad)
    # at the foot's radius on a plane the dome is above the surface, at the widest radius below; 60 bisections reach double
    # precision
    low = np.full_like(c, part.body_mm[0] / 2)
    high = np.full_like(c, _widest_foot_mm(part))
    for _ in range(_BISECTIONS):  # the difference is monotonic
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
    """Volume of an element above a cylinder, by Gauss quadrature.

    rotation_deg: Rotation of the element about its normal, from the circumferential direction.
    """
    # 40 points integrate polynomials of degree 79 exactly; both heights are smooth over each piece below
    x, weight = np.polynomial.legendre.leggauss(_GAUSS_POINTS)
    length_mm, width_mm, height_mm = part.body_mm
    if part.shape == "block":
        c, s = np.cos(np.radians(rotation_deg)), np.sin(np.radians(rotation_deg))
        # over the block's own rectangle: du dv = (L / 2)(W / 2) dx dy, hence L W / 4 below
        u, v = np.meshgrid(x * length_mm / 2, x * width_mm / 2, indexing="ij")
        # t of the point (u, v) of a block rotated by the angle with cosine c and sine s
        rise = height_mm - _surface_mm(u * c - v * s, radius_mm)
        return float(np.einsum("i,j,ij->", weight, weight, rise)) * length_mm * width_mm / 4
    # the integrand is smooth and periodic in the angle, for which the trapezoidal rule converges exponentially
    angle = np.arange(_TURN_POINTS, dtype=np.float64) * (2 * pi / _TURN_POINTS)
    outer = foot_radius_mm(part, radius_mm, angle)
    total = 0.0
    # a truncated cone has a kink at the rim of its top, where the interval of quadrature is split
    edge = [] if part.top_mm is None else [np.full_like(outer, part.top_mm / 2)]
    for low, high in pairwise([np.zeros_like(outer), *edge, outer]):
        r = (low + high)[:, None] / 2 + (high - low)[:, None] / 2 * x
        rise = dome_height_mm(part, r) - _surface_mm(r * np.cos(angle)[:, None], radius_mm)
        # dV = rise r dr dphi
        total += float(((rise * r) @ weight * (high - low) / 2).sum()) * 2 * pi / _TURN_POINTS
    return total
