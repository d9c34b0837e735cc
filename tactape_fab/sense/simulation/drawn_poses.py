"""Poses of a sensor that cover a tape evenly, or the outline of its texture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tactape_fab.base.errors import SpecError
from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.sense.simulation.arguments import check_count, checked_seed, edge_problems, profile_and_scene
from tactape_fab.sense.simulation.contact import contact_outline_mm
from tactape_fab.sense.simulation.scene import Scene
from tactape_fab.sense.simulation.view import make_view
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape

_OVERHANG = (-0.2, 0.9)
_GOLDEN = 1.2207440846057596  # the real root of x**4 = x + 1: its powers spread points in three dimensions evenly
_RECURRENCE = np.array([1 / _GOLDEN, 1 / _GOLDEN**2, 1 / _GOLDEN**3])


def draw_poses(
    tape: Tape,
    count: int,
    seed: int = 0,
    sensor: str | Path | SensorProfile = DEFAULT_SENSOR,
    scene: Scene | None = None,
    *,
    edge: bool = False,
) -> FloatArray:
    """Poses that cover a tape evenly: an additive recurrence in position and angle, shifted by the seed.

    Parameters
    ----------
    tape, sensor, scene
        As in `simulate`.
    count, seed : int
        Pose k is the same whatever `count` is.
    edge : bool
        False: the contact lies fully over the grid if the grid is large enough; else its centre is over the grid's.
        True: the contact's centre is near the grid's outline, from 0.9 of its half width inside to 0.2 outside.

    Returns
    -------
    ndarray, shape (count, 3)
        x mm, y mm (texture frame), theta deg in (-180, 180].

    Raises
    ------
    SpecError
        For an invalid tape, count, seed, sensor, scene or edge.
    """
    profile, scene = profile_and_scene(tape, sensor, scene)
    if problems := edge_problems(edge, None):
        raise SpecError(problems)
    check_count(count)
    shift = np.random.Generator(np.random.PCG64(np.random.SeedSequence(checked_seed(seed), spawn_key=(0, 2)))).random(3)
    # Roberts' additive recurrence: frame k needs none of those before it
    share = (shift + np.outer(np.arange(1, count + 1), _RECURRENCE)) % 1.0
    theta_deg = 180.0 - 360.0 * share[:, 2]
    view = make_view(tape, (0.0, 0.0), 0.0, profile, scene)
    c, s = np.cos(np.radians(theta_deg)), np.sin(np.radians(theta_deg))
    turn = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)  # for rows of points: points @ turn
    # the contact's outline about the image centre in texture directions, of every pose; (n, k, 2)
    outline = contact_outline_mm(scene, view.half_field_mm) @ turn
    grid_mm = np.array([tape.columns - 1, tape.rows - 1]) * tape.pitch_mm
    if edge:
        centre = _overhanging(share[:, :2], np.abs(outline).max(axis=1), grid_mm)
        position = centre - (np.asarray(scene.contact_offset_mm) @ turn)
    else:
        # position + outline within 0 ... grid
        low, high = -outline.min(axis=1), grid_mm - outline.max(axis=1)
        middle = (low + high) / 2
        low, high = np.minimum(low, middle), np.maximum(high, middle)
        narrow = grid_mm < outline.max(axis=1) - outline.min(axis=1)
        position = np.where(narrow, middle, low + (high - low) * share[:, :2])
    return np.column_stack([position, theta_deg])


def _overhanging(share: FloatArray, half_mm: FloatArray, grid_mm: FloatArray) -> FloatArray:
    """Contact centres around the grid's outline; shape (n, 2), mm in the texture frame."""
    width, height = grid_mm
    # way around the grid: along the top, down the right, back along the bottom, up the left
    along = share[:, 0] * 2 * (width + height)
    side = np.searchsorted(np.cumsum([width, height, width]), along, side="right")
    at = along - np.concatenate([[0.0], np.cumsum([width, height, width])])[side]
    inward = _OVERHANG[0] + (_OVERHANG[1] - _OVERHANG[0]) * share[:, 1]
    inset = inward * np.where(side % 2 == 0, half_mm[:, 1], half_mm[:, 0])
    x = np.choose(side, [at, width - inset, width - at, inset])
    y = np.choose(side, [inset, at, height - inset, height - at])
    return np.stack([x, y], axis=-1)
