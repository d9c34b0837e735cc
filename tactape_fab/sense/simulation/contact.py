"""Contact area of the gel, depth of the texture's imprint in it, and background of the contact's own shape.

Points are (..., 2) in mm from the image centre, right and down.
"""

from __future__ import annotations

from functools import lru_cache
from math import cos, pi, radians, sin

import numpy as np
import numpy.typing as npt

from tactape_fab.sense.simulation.scene import Scene
from tactape_fab.sense.simulation.true_camera import TrueCamera
from tactape_fab.texture.frames import FloatArray

FloatImage = npt.NDArray[np.float32]


def contact_local(scene: Scene, at_mm: FloatArray) -> FloatArray:
    """Points relative to the contact's centre, along and across its axis; shape (..., 2), mm."""
    c, s = cos(radians(scene.contact_turn_deg)), sin(radians(scene.contact_turn_deg))
    local: FloatArray = (at_mm - np.asarray(scene.contact_offset_mm)) @ np.array([[c, s], [-s, c]])
    return local


def inside_mm(scene: Scene, at_mm: FloatArray) -> FloatArray:
    """Distance of points from the contact's outline, mm, positive inside; for an ellipse along the ray from its centre."""
    local = contact_local(scene, at_mm)
    if scene.contact == "pad":
        return np.full(local.shape[:-1], np.inf)
    if scene.contact == "strip":
        return scene.strip_half_mm - np.abs(local[..., 1])
    # at relative distance r / R along a ray the outline is R - r = r (R / r - 1) away; in the middle that is 0 times infinity
    ellipse: FloatArray = np.hypot(local[..., 0], local[..., 1]) * (1 / np.maximum(_relative(scene, local), 1e-9) - 1)
    return np.where(_relative(scene, local) < 1e-6, min(scene.contact_mm) / 2, ellipse)


def imprint(scene: Scene, at_mm: FloatArray) -> FloatArray:
    """Fraction of the texture's height that is imprinted at points: 1 inside, 0 outside, 0.5 on the outline."""
    inside = inside_mm(scene, at_mm)
    if scene.roll_off_mm == 0.0:
        return np.where(inside >= 0.0, 1.0, 0.0)
    t = np.clip(0.5 + inside / scene.roll_off_mm, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def inwards(scene: Scene, at_mm: FloatArray) -> FloatArray:
    """Unit vectors at points, directed away from the nearest outline, or zero without one; shape (..., 2)."""
    if scene.contact == "pad":
        return np.zeros(at_mm.shape)
    steps = 1e-3 * np.eye(2)
    # central differences: the distance's slope points inwards
    slope = np.stack([inside_mm(scene, at_mm + step) - inside_mm(scene, at_mm - step) for step in steps], axis=-1)
    return slope / np.maximum(np.hypot(slope[..., 0], slope[..., 1]), 1e-12)[..., None]


@lru_cache(maxsize=4)
def contact_images(scene: Scene, shape: tuple[int, int], camera: TrueCamera) -> tuple[FloatImage, FloatImage]:
    """Imprint and background (mm) of every pixel, read-only; cached for the scenes used last."""
    at_mm = pixels_mm(shape, camera)
    background = _background(scene, at_mm) + at_mm @ np.asarray(scene.tilt_mm_per_mm)
    images = imprint(scene, at_mm).astype(np.float32), background.astype(np.float32)
    for image in images:
        image.setflags(write=False)
    return images


def pixels_mm(shape: tuple[int, int], camera: TrueCamera) -> FloatArray:
    """Place that every pixel's centre sees, from that of the image centre; shape (height, width, 2), mm."""
    u, v = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    return camera.from_px(np.stack([u, v], axis=-1).astype(np.float64))


def contact_outline_mm(scene: Scene, half_field_mm: FloatArray) -> FloatArray:
    """Points around the part of the contact that the sensor sees; shape (k, 2), mm from the image centre.

    For a strip these are its corners. Points of an ellipse outside the field are moved to its border; for a strip that is
    fully outside only the centre remains.
    """
    corners: FloatArray = half_field_mm * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    if scene.contact == "pad":
        return corners
    c, s = cos(radians(scene.contact_turn_deg)), sin(radians(scene.contact_turn_deg))
    to_view, offset = np.array([[c, -s], [s, c]]), np.asarray(scene.contact_offset_mm)
    covered = corners[inside_mm(scene, corners) >= 0.0]
    if scene.contact == "ellipse":
        turn = np.linspace(0.0, 2 * pi, 48, endpoint=False)
        ellipse = (np.stack([np.cos(turn), np.sin(turn)], axis=-1) * scene.contact_mm / 2) @ to_view + offset
        return np.concatenate([np.clip(ellipse, -half_field_mm, half_field_mm), covered])
    reach = float(np.hypot(*half_field_mm) + np.hypot(*offset))
    outline = covered
    for side in (-scene.strip_half_mm, scene.strip_half_mm):
        line = np.stack(np.broadcast_arrays(np.linspace(-reach, reach, 401), side), axis=-1) @ to_view + offset
        seen = line[(np.abs(line) <= half_field_mm + 1e-9).all(axis=1)]
        outline = np.concatenate([outline, seen[:1], seen[-1:]])
    return outline if len(outline) else offset[None]


def _relative(scene: Scene, local_mm: FloatArray) -> FloatArray:
    """Distance from the contact's centre over that of the outline in the same direction."""
    if scene.contact == "pad":
        return np.zeros(local_mm.shape[:-1])
    if scene.contact == "strip":
        return np.abs(local_mm[..., 1]) / scene.strip_half_mm
    scaled = local_mm / scene.contact_mm * 2
    return np.hypot(scaled[..., 0], scaled[..., 1])


def _background(scene: Scene, at_mm: FloatArray) -> FloatArray:
    """A parabola to the contact's outline, where half its height is left (Hertz), and an exponential of equal slope outside.

    Under a strip the parabola has the cylinder's curvature.
    """
    # with rho = x / half the parabola falls by peak x^2 / (2 half^2), which is the cylinder's x^2 / 2 R for peak = half^2 / R
    peak_mm = scene.strip_half_mm**2 / scene.cylinder_radius_mm if scene.contact == "strip" else scene.dome_mm
    rho = _relative(scene, contact_local(scene, at_mm))
    # at rho = 1 both are 1/2, with slope -1
    shape = np.where(rho < 1.0, 1 - rho**2 / 2, np.exp(-2 * (np.maximum(rho, 1.0) - 1)) / 2)
    return peak_mm * shape
