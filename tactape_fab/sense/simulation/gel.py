"""Frame of a sensor from the relief under its gel: smoothing, background, noise, orientation."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.sense.simulation.contact import contact_images, contact_outline_mm
from tactape_fab.sense.simulation.noise import add_noise
from tactape_fab.sense.simulation.parts import Parts
from tactape_fab.sense.simulation.pixel_coverage import add_domes, add_quads
from tactape_fab.sense.simulation.scene import Scene, blur_of
from tactape_fab.sense.simulation.smoothing import gaussian_kernel, smooth
from tactape_fab.sense.simulation.true_camera import true_camera
from tactape_fab.sense.simulation.view import View
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.shapes import inset_mm

FloatImage = npt.NDArray[np.float32]

BUMP_FOOT_MM = (0.30, 0.70)
"""Least and largest diameter of a spurious bump, mm."""
BUMP_HEIGHT = (0.5, 1.2)
"""Least and largest height of a spurious bump, as a fraction of the texture's."""


def relief_of(view: View, parts: Parts, at_mm: FloatArray, bumps_mm: FloatArray, bump_sizes: FloatArray) -> FloatArray:
    """Height of the surface under the gel over the top of the film; shape (h, w), mm.

    parts: Parts in view.
    at_mm (n, 2): Their centres in view: mm from the image centre, right and down.
    bumps_mm (k, 2): Centres of spurious bumps, mm from the image centre.
    bump_sizes (k, 2): Their diameters in mm, and heights as a fraction of the texture's.
    """
    image = np.zeros((view.profile.height_px, view.profile.width_px))
    centres_px = view.to_px(at_mm)
    part, texture_mm = view.tape.part, view.scene.texture_mm
    if part.shape == "dome":
        foot = np.full(len(centres_px), part.body_mm[0] / 2)
        top = np.full(len(centres_px), (part.top_mm or 0.0) / 2)
        cap = None if part.top_mm is not None else part.body_mm[2]
        add_domes(image, centres_px, view.px_per_mm, foot, top, np.full(len(foot), texture_mm), cap)
    else:
        add_quads(image, centres_px[:, None] + view.camera.offsets_px(at_mm, _corners_mm(view, parts.rotation_deg)), texture_mm)
    _add_bumps(image, view, bumps_mm, bump_sizes)
    if view.tape.surface is None:
        _cut_film(image, view)
    return image


def _corners_mm(view: View, rotation_deg: FloatArray) -> FloatArray:
    """Corners of blocks from their centres in view; shape (n, 4, 2), mm."""
    length_mm, width_mm = view.tape.part.body_mm[:2]
    rotation = np.radians(rotation_deg)
    along_board = np.stack([np.cos(rotation), np.sin(rotation)], axis=-1)
    across_board = np.stack([-np.sin(rotation), np.cos(rotation)], axis=-1)
    # board y is up, the texture's is down
    flip = np.array([1.0, -1.0])
    along = (along_board * flip) @ view.turn * length_mm / 2
    across = (across_board * flip) @ view.turn * width_mm / 2
    return np.stack([along + across, across - along, -along - across, along - across], axis=1)


def _add_bumps(image: FloatArray, view: View, bumps_mm: FloatArray, sizes: FloatArray) -> None:
    """Cones with a flat top of half their width."""
    foot = sizes[:, 0] / 2
    add_domes(image, view.to_px(bumps_mm), view.px_per_mm, foot, foot / 2, sizes[:, 1] * view.scene.texture_mm, None)


def _cut_film(image: FloatArray, view: View) -> None:
    """Lower the relief outside the tape's outline by the tape's thickness, at most by the gel's reach `Scene.dome_mm`.

    A pixel's fraction outside is that of a straight edge.
    """
    board, profile = view.tape.board, view.profile
    outline_px = view.to_px(contact_outline_mm(view.scene, view.half_field_mm))
    margin_px = view.scene.roll_off_mm / 2 * np.asarray(view.px_per_mm) + 1
    low = np.maximum(outline_px.min(axis=0) - margin_px, -0.5)
    high = np.minimum(outline_px.max(axis=0) + margin_px, 2 * profile.centre_px + 0.5)
    corners_px = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    corners = view.to_board(view.from_px(corners_px))
    mean_scale = float(np.sqrt(np.prod(view.px_per_mm)))
    # the outline is convex: with all corners of the contact a pixel inside it, no edge is in view
    if inset_mm(corners, board.size_mm, board.corner_radius_mm).min() > 1 / mean_scale:
        return
    first, last = np.floor(low + 0.5).astype(np.int64), np.ceil(high + 0.5).astype(np.int64)
    u, v = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]))
    at = view.to_board(view.from_px(np.stack([u, v], axis=-1).astype(np.float64)))
    # a straight edge at distance d px from a pixel's centre leaves 0.5 - d of it outside, exactly where it runs along the pixels
    beyond = np.clip(0.5 - inset_mm(at, board.size_mm, board.corner_radius_mm) * mean_scale, 0.0, 1.0)
    image[first[1] : last[1], first[0] : last[0]] -= min(board.thickness_mm, view.scene.dome_mm) * beyond


def press(relief_mm: FloatArray, profile: SensorProfile, scene: Scene, rng: np.random.Generator) -> FloatImage:
    """The depth map that a sensor delivers of a relief pressed into its gel; shape `profile.frame_shape`."""
    camera = true_camera(profile, scene)
    imprint, background = contact_images(scene, (profile.height_px, profile.width_px), camera)
    sigma_u_px, sigma_v_px = (blur_of(scene, profile.gel) * scale for scale in camera.px_per_mm)
    depth = _smooth(relief_mm.astype(np.float32) * imprint, sigma_u_px, sigma_v_px)
    depth += background
    return sensed(depth, profile, scene, rng)


def sensed(depth_mm: FloatImage, profile: SensorProfile, scene: Scene, rng: np.random.Generator) -> FloatImage:
    """A canonical depth map with the sensor's noise, which is added in place, as the sensor delivers it."""
    add_noise(depth_mm, profile, scene, rng)
    return delivered(depth_mm, profile)


def delivered(depth_mm: FloatImage, profile: SensorProfile) -> FloatImage:
    """The canonical image as the sensor delivers it: unit, blind pixels, orientation."""
    image = depth_mm if profile.depth_unit_mm is None else depth_mm / np.float32(profile.depth_unit_mm)
    if profile.mask is not None:
        image = np.where(profile.mask, image, np.float32(0.0))
    turned = np.rot90(image, -profile.rotate90)
    flipped = turned[:, ::-1] if profile.mirror else turned
    return np.ascontiguousarray(flipped if profile.sign > 0 else -flipped, dtype=np.float32)


def _smooth(image: FloatImage, sigma_u_px: float, sigma_v_px: float) -> FloatImage:
    if min(sigma_u_px, sigma_v_px) < 0.05:
        return image
    return smooth(image, gaussian_kernel(sigma_u_px), gaussian_kernel(sigma_v_px), "edge")
