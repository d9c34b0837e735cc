"""simulate_forces: depth maps of one press into an elastic gel at several forces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tactape_fab.base.given_value import as_numbers
from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.sense.sensors import SensorProfile, as_sensor
from tactape_fab.sense.simulation.arguments import checked_seed
from tactape_fab.sense.simulation.draw import placed
from tactape_fab.sense.simulation.elastic import imprint_of
from tactape_fab.sense.simulation.elastic_contact import ElasticContact
from tactape_fab.sense.simulation.gel import FloatImage, sensed
from tactape_fab.sense.simulation.parts import Parts, as_parts
from tactape_fab.sense.simulation.scene import Scene, as_scene
from tactape_fab.sense.simulation.view import make_view
from tactape_fab.texture.tape import Tape, refuse_no_tape


def simulate_forces(
    tape: Tape,
    position_mm: npt.ArrayLike,
    theta_deg: float,
    forces_n: npt.ArrayLike,
    *,
    sensor: str | Path | SensorProfile = DEFAULT_SENSOR,
    scene: Scene | None = None,
    seed: int = 0,
    parts: Parts | npt.ArrayLike | None = None,
) -> FloatImage:
    """Depth maps of one press into an elastic gel, at several forces; each is solved from the one before, best in rising order.

    Parameters
    ----------
    tape, position_mm, theta_deg, sensor, parts
        As in `simulate`.
    forces_n : array_like, shape (n,)
        Normal forces, N.
    scene : Scene, optional
        With `elastic`, whose force is replaced; without it the default `ElasticContact`.
    seed : int
        Equal seeds give equal parts, and equal noise of each force.

    Returns
    -------
    ndarray of float32, shape (n, *sensor.frame_shape)
        As of `simulate` with each force, but for what the solver leaves (below 1 um).

    Raises
    ------
    SpecError
        As `simulate`.
    """
    refuse_no_tape(tape)
    profile, scene, standing = as_sensor(sensor), as_scene(scene), as_parts(tape, parts)
    forces = as_numbers(forces_n, (None,), "forces_n", "a list of forces in N").tolist()
    elastic = scene.elastic or ElasticContact()
    contacts = [replace(scene, elastic=replace(elastic, force_n=force)) for force in forces]
    depth, pressure = np.empty((len(contacts), *profile.frame_shape), dtype=np.float32), None
    for k, contact in enumerate(contacts):
        view = make_view(tape, position_mm, theta_deg, profile, contact)
        _, seen, at_mm, bumps_mm, sizes, of_noise = placed(view, standing, np.random.SeedSequence(checked_seed(seed)))
        pressed = imprint_of(view, seen, at_mm, bumps_mm, sizes, pressure)
        depth[k], pressure = sensed(pressed.depth, profile, contact, of_noise), pressed.pressure_mpa
    return depth
