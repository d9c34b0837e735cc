"""Contacts, poses and camera -> how far each dot is from where it is modelled, and the derivatives; see `adjust`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactape_fab.sense.decode.grid.beliefs import PULL, PULL_SIGMA, PUSH_MM, PUSH_SIGMA_MM, beliefs_of
from tactape_fab.sense.geometry import Camera
from tactape_fab.sense.geometry import camera as camera_of
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.sense.survey.contacts import Contact, SeenDots
from tactape_fab.texture.frames import FloatArray, IntArray

COMMON = ("px_per_mm", "aspect", "shear", "k1", "push", "pull")
"""Unknowns common to all contacts: ln of the scale, corrections of the profile's camera, push (mm at 1 mm), pull."""
HUBER = 2.0
"""Residual, in standard deviations, from which on a dot, or a pose of a robot, weighs less."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows(SeenDots):
    """All dots of all contacts: contact (m,), and part (m,) among those touched."""

    contact: IntArray


def rows_of(contacts: Sequence[Contact]) -> tuple[IntArray, Rows]:
    """Parts that contacts show, ascending, and the dots of all of them."""
    touched, part = np.unique(np.concatenate([c.part for c in contacts]), return_inverse=True)
    others = ("seen_px", "own", "rim_mm2", "pushed", "pulled")
    return touched, Rows(
        contact=np.repeat(np.arange(len(contacts)), [len(c.part) for c in contacts]),
        part=part,
        **{name: np.concatenate([getattr(c, name) for c in contacts]) for name in others},
    )


def huber(apart: FloatArray) -> FloatArray:
    """Huber's weight of residuals in standard deviations: it falls as 1 / |r| from `HUBER` on, for a pull of constant force."""
    return np.minimum(1.0, HUBER / np.maximum(apart, 1e-9))


def common_prior(sensor: SensorProfile) -> tuple[FloatArray, FloatArray]:
    """Prior means and standard deviations of `COMMON`, as in the decoder."""
    sigmas = np.maximum(beliefs_of(sensor, fixed_scale=False).sigmas, 1e-9)
    return np.array([0.0, 0.0, 0.0, 0.0, PUSH_MM, PULL]), np.array([*sigmas, PUSH_SIGMA_MM, PULL_SIGMA])


def residuals(
    rows: Rows, sensor: SensorProfile, common: FloatArray, poses: FloatArray, places_mm: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Seen minus modelled positions (m, 2), texture frame; their derivatives by theta (m, 2) and `COMMON` (m, 2, 6)."""
    camera = _camera(sensor, common)
    centre = camera.from_px(sensor.centre_px)
    push, pull = common[4:].tolist()
    drawn = pull * rows.pulled - push * rows.pushed
    x, y, theta = poses[rows.contact].T
    c, s = np.cos(theta), np.sin(theta)
    turn = np.stack([np.stack([c, s], 1), np.stack([-s, c], 1)], 1)  # R(theta) (paper, Eq. 12)
    turned = np.einsum("mij,mj->mi", turn, camera.from_px(rows.seen_px) - centre + drawn)
    modelled = places_mm[rows.part] - np.stack([x, y], 1)
    # where a dot is modelled, not where it is seen: a seen place has the dot's own error in it, which is smaller under a larger
    # scale, so that each dot more would ask for a larger one
    rates = _rates(np.einsum("mji,mj->mi", turn, modelled) - drawn, centre, rows, sensor, camera)
    # dR / dtheta q = (-s q_x + c q_y, -c q_x - s q_y): R q with its components swapped and one negated
    by_theta = np.stack([turned[:, 1], -turned[:, 0]], 1)
    return turned - modelled, by_theta, np.einsum("mij,kmj->mik", turn, rates)


def _camera(sensor: SensorProfile, common: FloatArray) -> Camera:
    """The sensor's camera, changed by `COMMON`."""
    scale, aspect, shear, k1 = common[:4].tolist()
    g = sensor.geometry
    changed = type(g)(aspect=g.aspect + aspect, shear=g.shear + shear, k1=g.k1 + k1, center_px=g.center_px)
    u, v = sensor.px_per_mm
    stretch = float(np.exp(scale))
    return camera_of((u * stretch, v * stretch), (sensor.width_px, sensor.height_px), changed)


def _rates(q: FloatArray, centre: FloatArray, rows: Rows, sensor: SensorProfile, camera: Camera) -> FloatArray:
    """Derivatives by `COMMON` of the dots' positions q (m, 2) on the gel, from the image centre; (6, m, 2)."""
    from_centre = q + centre
    rates = np.zeros((len(COMMON), *q.shape))
    # q = M^-1 (straightened px), to first order in aspect, shear and k1 about the profile: a Gauss-Newton step only needs the
    # direction, residuals are exact
    rates[0] = -q
    rates[1, :, 0], rates[1, :, 1] = -0.5 * q[:, 0], 0.5 * q[:, 1]
    rates[2, :, 0] = -q[:, 1]
    # squared distances from the lens' centre in corner radii; pixels may be oblong
    square, of_centre = (
        ((at * sensor.px_per_mm / camera.corner_px) ** 2).sum(axis=-1, keepdims=True) for at in (from_centre, centre)
    )
    rates[3] = -from_centre * square + centre * of_centre
    rates[4], rates[5] = -rows.pushed, rows.pulled
    return rates
