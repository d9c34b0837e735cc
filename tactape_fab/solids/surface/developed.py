"""Exact development of planes, cylinders and cones into the plane, and its inverse; vectorised, without a CAD kernel."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin, tan
from typing import Literal, NamedTuple

import numpy as np

from tactape_fab.solids.surface.charts import Frames
from tactape_fab.texture.frames import FloatArray

Kind = Literal["plane", "cylinder", "cone"]


class Places(NamedTuple):
    """Places on a surface: parameters, shape (n, 2); in model coordinates, shape (n, 3), points, images of the two flat axes, and
    normals, which point away from the surface's axis.
    """

    uv: FloatArray
    points_mm: FloatArray
    first: FloatArray
    second: FloatArray
    normal: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Developable:
    """A developable surface in the parametrisation of OCCT, in which v is a length along the surface.

    kind {"plane", "cylinder", "cone"}
    origin_mm (3,)
    axes (3, 3): x, y and the axis z of the surface as rows.
    radius_mm: Radius of a cylinder, or of a cone at its origin.
    half_angle_rad: Half angle of a cone, whose radius is ``radius_mm + v sin(half_angle_rad)``.
    """

    kind: Kind
    origin_mm: FloatArray
    axes: FloatArray
    radius_mm: float = 0.0
    half_angle_rad: float = 0.0

    def parameters(self, points_mm: FloatArray) -> FloatArray:
        """Parameters (u, v) of points on the surface; shape (n, 2)."""
        x, y, z = np.moveaxis((points_mm - self.origin_mm) @ self.axes.T, 1, 0)
        if self.kind == "plane":
            return np.stack([x, y], axis=1)
        v = z / cos(self.half_angle_rad) if self.kind == "cone" else z
        # v of a cone is measured along its generatrix, not along its axis: z = v cos(half angle), as in OCCT's gp_Cone
        return np.stack([np.arctan2(y, x), v], axis=1)

    def roll(self, uv: FloatArray, flat_mm: FloatArray) -> Places:
        """Move along geodesics from places at `uv` by `flat_mm`, each (n, 2).

        The flat axes at a place are x and y of a plane, around and along the axis of a cylinder, away from the apex and
        around the axis of a cone.
        """
        if self.kind == "plane":
            return self._on_plane(uv, flat_mm)
        if self.kind == "cylinder":
            return self._on_cylinder(uv, flat_mm)
        return self._on_cone(uv, flat_mm)

    def heights(self, frames: Frames, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Height of the surface over the tangent planes of places on it, at points of these planes; each (n, k)."""
        if self.kind == "plane":
            return np.zeros(x_mm.shape)
        start = (frames.points_mm - self.origin_mm) @ self.axes.T
        x, y, z = (axes @ self.axes.T for axes in (frames.x_axis, frames.y_axis, frames.normal))
        point = start[:, None] + x_mm[:, :, None] * x[:, None] + y_mm[:, :, None] * y[:, None]
        # along the normal n from a point p the surface satisfies X^2 + Y^2 = (R + t Z)^2, that is a h^2 + 2 b h + c = 0
        slope = tan(self.half_angle_rad)
        radius, turned = self.radius_mm + slope * point[:, :, 2], slope * z[:, None, 2]
        a = (z[:, None, :2] ** 2).sum(axis=2) - turned**2
        b = (point[:, :, :2] * z[:, None, :2]).sum(axis=2) - radius * turned
        c = (point[:, :, :2] ** 2).sum(axis=2) - radius**2
        # the root near 0, without cancellation
        return np.asarray(-c / (b + np.copysign(np.sqrt(np.maximum(b**2 - a * c, 0.0)), b)))

    def _on_plane(self, uv: FloatArray, flat_mm: FloatArray) -> Places:
        end = uv + flat_mm
        points = self.origin_mm + end @ self.axes[:2]
        x, y, z = (np.broadcast_to(axis, points.shape) for axis in self.axes)
        return Places(end, points, x, y, z)

    def _around(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radial and circumferential directions."""
        c, s = np.cos(u)[:, None], np.sin(u)[:, None]
        return c * self.axes[0] + s * self.axes[1], c * self.axes[1] - s * self.axes[0]

    def _on_cylinder(self, uv: FloatArray, flat_mm: FloatArray) -> Places:
        # an arc of length s is an angle of s / R; along the axis lengths are unchanged
        end = uv + flat_mm / (self.radius_mm, 1.0)
        away, around = self._around(end[:, 0])
        points = self.origin_mm + self.radius_mm * away + end[:, 1:] * self.axes[2]
        return Places(end, points, around, np.broadcast_to(self.axes[2], points.shape), away)

    def _on_cone(self, uv: FloatArray, flat_mm: FloatArray) -> Places:
        sine, cosine = sin(self.half_angle_rad), cos(self.half_angle_rad)
        # a cone develops into a sector with slant length L = radius / sin from the apex and angle u sin, of the half angle
        narrow = abs(sine)
        start_mm = (self.radius_mm + uv[:, 1] * sine) / narrow
        # the flat step begins at (L, 0) of the sector; polar coordinates of its end give the slant length and the turn there
        reach, side = start_mm + flat_mm[:, 0], flat_mm[:, 1]
        slant, turn = np.hypot(reach, side), np.arctan2(side, reach)
        # back on the cone: radius = slant sin, and radius = radius_mm + v sin
        u, v = uv[:, 0] + turn / narrow, (slant * narrow - self.radius_mm) / sine
        away, around = self._around(u)
        points = self.origin_mm + (slant * narrow)[:, None] * away + (v * cosine)[:, None] * self.axes[2]
        # along the generatrix away from the apex, which is below if the half angle is positive
        down = narrow * away + np.sign(sine) * cosine * self.axes[2]
        c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
        # perpendicular to the generatrix (sine, cosine) in the plane of (away, axis)
        normal = cosine * away - sine * self.axes[2]
        # flat x and y in polar coordinates at the angle `turn`: e_x = c e_r - s e_phi, e_y = s e_r + c e_phi
        return Places(np.stack([u, v], axis=1), points, c * down - s * around, s * down + c * around, normal)
