"""True camera of a simulated sensor: that of its profile, with the scene's errors of scale, aspect, shear and distortion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from tactape_fab.sense.geometry import Camera, Geometry, camera
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.sense.simulation.scene import Scene
from tactape_fab.texture.frames import FloatArray

_BORDER_POINTS = 33
"""Points along each side of the image from which the size of the field is computed, as distortion bends the sides."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrueCamera:
    """Points "in view" (mm from the one that the image centre sees, right and down) to pixels of the canonical image, and back.

    camera: The camera model, about its own centre.
    middle_px, middle_mm (2,): The image centre, and the point that it sees, from the camera's own centre.
    px_per_mm: Scale along u and v in the middle of the lens.
    half_field_mm (2,): Farthest points in view along u and v.
    """

    camera: Camera
    middle_px: FloatArray
    middle_mm: FloatArray
    px_per_mm: tuple[float, float]
    half_field_mm: FloatArray

    def to_px(self, in_view_mm: FloatArray) -> FloatArray:
        """Points in view as pixels of the canonical image; shape (..., 2), px."""
        return self.camera.to_px(in_view_mm + self.middle_mm)

    def from_px(self, px: FloatArray) -> FloatArray:
        """Points in view that pixels see; shape (..., 2), mm."""
        if _is_straight(self.camera):  # the very bits of a plain scale, which the inverse of a matrix would round otherwise
            return (px - self.middle_px) / self.px_per_mm
        return self.camera.from_px(px) - self.middle_mm

    def offsets_px(self, in_view_mm: FloatArray, offsets_mm: FloatArray) -> FloatArray:
        """Offsets on the gel (n, k, 2) from points in view (n, 2), as offsets from the points' pixels; (n, k, 2), px."""
        if self.camera.k1 == 0.0:
            return offsets_mm @ self.camera.matrix.T
        return self.to_px(in_view_mm[:, None] + offsets_mm) - self.to_px(in_view_mm)[:, None]


def true_camera(profile: SensorProfile, scene: Scene) -> TrueCamera:
    """The camera of a sensor in a scene."""
    errors = (scene.aspect_error, scene.shear_error, scene.k1_error)
    return _made(profile.px_per_mm, (profile.width_px, profile.height_px), profile.geometry, scene.scale_error, *errors)


@lru_cache(maxsize=16)
def _made(
    px_per_mm: tuple[float, float],
    size_px: tuple[int, int],
    geometry: Geometry,
    scale_error: float,
    aspect_error: float,
    shear_error: float,
    k1_error: float,
) -> TrueCamera:
    true = replace(
        geometry,
        aspect=geometry.aspect + aspect_error,
        shear=geometry.shear + shear_error,
        k1=geometry.k1 + k1_error,
    )
    model = camera((px_per_mm[0] * (1 + scale_error), px_per_mm[1] * (1 + scale_error)), size_px, true)
    middle_px = (np.array(size_px) - 1) / 2
    scale = (float(model.matrix[0, 0]), float(model.matrix[1, 1]))
    if _is_straight(model):
        middle_mm, half_field_mm = (middle_px - model.centre_px) / scale, np.array(size_px) / scale / 2
    else:
        middle_mm = model.from_px(middle_px)
        # a lens or a shear bends the field's sides, and the farthest point may be anywhere on them
        half_field_mm = np.abs(model.from_px(_border_px(size_px)) - middle_mm).max(axis=0)
    for array in (middle_px, middle_mm, half_field_mm):
        array.setflags(write=False)
    return TrueCamera(camera=model, middle_px=middle_px, middle_mm=middle_mm, px_per_mm=scale, half_field_mm=half_field_mm)


def _is_straight(model: Camera) -> bool:
    """Whether the model is only a scale along each axis."""
    return model.k1 == 0.0 and float(model.matrix[0, 1]) == 0.0


def _border_px(size_px: tuple[int, int]) -> FloatArray:
    """Points around the image, on the outer edges of its pixels."""
    side = np.linspace(0.0, 1.0, _BORDER_POINTS)
    around = [np.stack(np.broadcast_arrays(*pair), axis=-1) for pair in ((side, 0.0), (side, 1.0), (0.0, side), (1.0, side))]
    return np.concatenate(around) * size_px - 0.5
