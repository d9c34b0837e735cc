"""Camera of a sensor as a vector of parameters: the profile that it makes, pixels of points on the gel, and derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, log

import numpy as np

from tactape_fab.sense.geometry import Camera
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import FloatArray

NAMES = ("ln_scale", "aspect", "shear", "k1", "center_u", "center_v")
"""Parameters: ln of px/mm along u, then those of `Geometry`; the lens' centre is counted from the image centre, px."""
COUNT = len(NAMES)
_STEP = 1e-6


def parameters(sensor: SensorProfile) -> FloatArray:
    """The parameters of a profile."""
    geometry = sensor.geometry
    centre = np.zeros(2) if geometry.center_px is None else np.array(geometry.center_px) - sensor.centre_px
    return np.array([log(sensor.px_per_mm[0]), geometry.aspect, geometry.shear, geometry.k1, *centre])


def with_parameters(sensor: SensorProfile, values: FloatArray) -> SensorProfile:
    """A profile with other parameters; its pixels stay as oblong as they are."""
    ln_scale, aspect, shear, k1, u, v = values.tolist()
    scale, oblong = exp(ln_scale), sensor.px_per_mm[1] / sensor.px_per_mm[0]
    centre = None if u == v == 0.0 else (float(sensor.centre_px[0]) + u, float(sensor.centre_px[1]) + v)
    geometry = replace(sensor.geometry, aspect=aspect, shear=shear, k1=k1, center_px=centre)
    return replace(sensor, px_per_mm=(scale, scale * oblong), geometry=geometry)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """A camera evaluated once for all presses.

    scale: px/mm along u and v.
    middle_mm (2,): The point that the image centre sees, from the distortion's centre.
    middle_by (2, 6): Its derivative by the parameters.
    """

    camera: Camera
    scale: tuple[float, float]
    middle_mm: FloatArray
    middle_by: FloatArray

    def to_px(self, at_mm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pixels of points on the gel, right and down of the one that the image centre sees.

        at_mm (n, 2)
        Returns px (n, 2).
        Returns by_point (n, 2, 2): Derivative of pixel (rows) by point.
        Returns by_parameter (n, 2, 6).
        """
        camera, (u_per_mm, v_per_mm) = self.camera, self.scale
        at = at_mm + self.middle_mm
        straight = at @ camera.matrix.T
        square = (straight**2).sum(axis=1) / camera.corner_px**2
        px = camera.centre_px + straight * (1.0 + camera.k1 * square)[:, None]
        # px = centre + (1 + k1 |s|^2 / r^2) s with s = M q, r the corner's radius: d px / d s = (1 + k1 |s|^2 / r^2) I + 2 k1 s
        # s^T / r^2
        bend = (1.0 + camera.k1 * square)[:, None, None] * np.eye(2)
        bend = bend + (2.0 * camera.k1 / camera.corner_px**2) * straight[:, :, None] * straight[:, None, :]
        by_point = bend @ camera.matrix
        by = np.zeros((len(at), 2, COUNT))
        # first d s by the parameters of M: by ln of the scale it is s itself, as the scale multiplies both rows of M
        by[:, :, 0] = straight
        by[:, 0, 1], by[:, 1, 1] = at[:, 0] * u_per_mm / 2.0, -at[:, 1] * v_per_mm / 2.0
        by[:, 0, 2] = at[:, 1] * u_per_mm
        # k1 and the centre act behind M, and do not go through it
        by = bend @ by
        by[:, :, 3] = straight * square[:, None]
        by[:, 0, 4] = by[:, 1, 5] = 1.0
        # points are counted from the one that the image centre sees, and that one moves with the parameters as well
        return px, by_point, by + by_point @ self.middle_by


def seen_by(sensor: SensorProfile, values: FloatArray) -> Seen:
    """The camera of some parameters; the profile says its size and the shape of its pixels."""
    # by central differences: a Newton inverse lies between, and there is one point; the error is of the order of step^2
    middle_by = [
        (_middle(sensor, values + step) - _middle(sensor, values - step)) / (2 * _STEP) for step in _STEP * np.eye(COUNT)
    ]
    found = with_parameters(sensor, values)
    return Seen(
        camera=found.camera, scale=found.px_per_mm, middle_mm=_middle(sensor, values), middle_by=np.stack(middle_by, axis=1)
    )


def _middle(sensor: SensorProfile, values: FloatArray) -> FloatArray:
    """The point that the image centre sees, from the distortion's centre, mm; shape (2,)."""
    return with_parameters(sensor, values).camera.from_px(sensor.centre_px)
