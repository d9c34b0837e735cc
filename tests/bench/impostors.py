"""Textures that are no tape of ours, for measuring false accepts: parts in other places, and other surfaces."""

from __future__ import annotations

from typing import Literal

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown
from tactape_fab.sense import Parts, Scene, SensorProfile
from tactape_fab.sense.sensors import as_sensor
from tactape_fab.sense.simulation.arguments import checked_seed
from tactape_fab.sense.simulation.contact import pixels_mm
from tactape_fab.sense.simulation.gel import FloatImage, press
from tactape_fab.sense.simulation.scene import DEFAULT_SCENE
from tactape_fab.sense.simulation.true_camera import true_camera
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray, texture_to_board
from tactape_fab.texture.tape import Tape

Surface = Literal["blank", "ball", "ridges"]
SURFACES = ("blank", "ball", "ridges")
RIDGE_PITCH_MM = (0.6, 3.0)
"""Least and largest distance of ridges."""
BUMPS_APART = 0.6
"""Least distance of random bumps, as a share of the pitch."""


def plain_grid(tape: Tape) -> Parts:
    """The tape's parts on their grid points, none displaced: a grid that carries no code."""
    return _parts(tape, tape.cells().astype(np.float64) * tape.pitch_mm)


def random_symbols(tape: Tape, seed: int = 0) -> Parts:
    """The tape's parts, each displaced in a direction of its own at random."""
    cells = tape.cells()
    symbols = _generator(seed).integers(0, tape.directions, len(cells))
    return _parts(tape, cells * tape.pitch_mm + tape.displacement_mm * DIRECTIONS_XY[symbols])


def random_bumps(tape: Tape, seed: int = 0) -> Parts:
    """As many parts as the tape has, scattered over its field, turned at random, kept apart where there is room."""
    from scipy.spatial import cKDTree

    rng = _generator(seed)
    count, spacing_mm = tape.part_count, BUMPS_APART * tape.pitch_mm
    field_mm = np.array([tape.columns - 1, tape.rows - 1]) * tape.pitch_mm
    points = rng.random((count, 2)) * field_mm
    for _ in range(30):
        pairs = cKDTree(points).query_pairs(spacing_mm, output_type="ndarray")
        if not len(pairs):
            break
        close = np.unique(pairs[:, 1])
        points[close] = rng.random((len(close), 2)) * field_mm
    parts = _parts(tape, points)
    return Parts(xy_mm=parts.xy_mm, rotation_deg=rng.uniform(-180.0, 180.0, count))


def other_surface(
    kind: Surface, *, sensor: str | SensorProfile = "gelsight-mini", scene: Scene | None = None, seed: int = 0
) -> FloatImage:
    """The depth map of a surface without parts.

    Parameters
    ----------
    kind : {"blank", "ball", "ridges"}
        Nothing but noise and tilt; a smooth ball; parallel waves as high as the texture, their pitch, direction and phase
        drawn from the seed.
    sensor, scene, seed
        As in `simulate`.

    Returns
    -------
    ndarray of float32, shape `sensor.frame_shape`

    Raises
    ------
    SpecError
        For another kind.
    """
    if kind not in SURFACES:
        raise SpecError(Problem("kind", f"kind = {shown(kind)} is none of: {', '.join(SURFACES)}; give one of them"))
    profile, scene, rng = as_sensor(sensor), scene or DEFAULT_SCENE, _generator(seed)
    relief = np.zeros((profile.height_px, profile.width_px))
    if kind == "blank":
        scene = scene.changed({"contact": "pad", "dome_mm": 0.0})
    elif kind == "ridges":
        turn, phase, pitch_mm = rng.uniform(0.0, np.pi), rng.uniform(0.0, 2 * np.pi), rng.uniform(*RIDGE_PITCH_MM)
        along = pixels_mm(relief.shape, true_camera(profile, DEFAULT_SCENE)) @ np.array([np.cos(turn), np.sin(turn)])
        relief += scene.texture_mm * (0.5 + 0.5 * np.sin(2 * np.pi * along / pitch_mm + phase))
    return press(relief, profile, scene, rng)


def _parts(tape: Tape, texture_mm: FloatArray) -> Parts:
    xy_mm = texture_to_board(texture_mm, tape.board.texture_origin_mm)
    return Parts(xy_mm=xy_mm, rotation_deg=np.full(len(xy_mm), tape.part.rotation_deg))


def _generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(checked_seed(seed))))
