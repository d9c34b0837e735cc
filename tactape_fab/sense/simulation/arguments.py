"""Arguments of the simulator, judged before anything is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError, refuse, tried
from tactape_fab.base.fields import Fields
from tactape_fab.base.given_value import NO_ARRAY, unmasked
from tactape_fab.sense.sensors import MOST_FRAMES, SensorProfile, as_sensor
from tactape_fab.sense.simulation.scene import Scene, as_scene
from tactape_fab.texture.board import LEAST_BEND_THICKNESSES
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape, refuse_no_tape


def profile_and_scene(
    tape: object, sensor: object, scene: object, options: Mapping[str, Any] | None = None
) -> tuple[SensorProfile, Scene]:
    """The sensor profile and the scene of a caller's arguments.

    Raises SpecError with every problem of them and of the tape, such as a film that does not bend so far.
    """
    problems: list[Problem] = []
    tried(lambda: refuse_no_tape(tape), problems)
    profile = tried(lambda: as_sensor(sensor), problems)
    meant = tried(lambda: as_scene(scene).changed(options or {}), problems)
    if meant is not None and meant.contact == "strip" and isinstance(tape, Tape):
        ways = "leave the tape flat", "give {:g} mm or more"
        problems += bend_problems(tape, meant.cylinder_radius_mm, "scene.cylinder_radius_mm", *ways)
    if profile is None or meant is None or problems:
        raise SpecError(problems)
    return profile, meant


def bend_problems(tape: Tape, radius_mm: float, key: str, without: str, least: str) -> list[Problem]:
    """The problem of a cylinder round which no film is bent; printed elements are made round it.

    without, least: Remedies of a rigid board and of a radius that is too small, the second one with a place for the least radius.
    """
    if tape.board.flexible is False:
        return [Problem(key, f"{key} = {radius_mm:g} mm contradicts the rigid board of {tape.name}; {without}")]
    thick_mm = tape.board.thickness_mm
    least_mm = ceil(LEAST_BEND_THICKNESSES * thick_mm * 1000 - 1e-6) / 1000
    if tape.board.flexible is None or radius_mm >= least_mm:
        return []
    of = f"{LEAST_BEND_THICKNESSES:g} times the {thick_mm:g} mm of its film, which bears no more"
    return [Problem(key, f"{key} = {radius_mm:g} mm is below {least_mm:g} mm, {of}; {least.format(least_mm)}")]


def edge_problems(edge: object, poses: object, name: str = "poses") -> list[Problem]:
    """Problems of `edge`: it is no bool, or `poses` are given too, which `name` names in the message."""
    table = Fields({"edge": edge})
    if table.flag("edge") and poses is not None:
        table.problem("edge", f"edge = True spreads poses, and poses are given; leave it out, or {name}")
    return table.problems


def checked_seed(seed: int) -> int:
    """A user's seed. Raises SpecError if it is no whole number from 0 to 2^64 - 1."""
    table = Fields({"seed": seed})
    whole = table.integer("seed", low=0, high=2**64 - 1)
    refuse(table.problems)
    return whole


def check_count(count: int) -> None:
    """Raises SpecError if a user's number of frames is no whole number from 1 to `MOST_FRAMES`."""
    table = Fields({"count": count})
    table.integer("count", low=1, high=MOST_FRAMES)
    refuse(table.problems)


def checked_poses(poses: npt.ArrayLike, count: int) -> FloatArray:
    """A user's poses (x mm, y mm, texture frame, theta deg); shape (count, 3). Raises SpecError for another shape."""
    check_count(count)
    try:
        rows = np.array(unmasked(poses), dtype=np.float64)
    except NO_ARRAY as error:
        raise SpecError(Problem("poses", f"poses is no array of numbers: {error}; give (x mm, y mm, theta deg) rows")) from error
    if rows.shape != (count, 3):
        raise SpecError(Problem("poses", f"poses has shape {rows.shape}, not ({count}, 3); give (x mm, y mm, theta deg) rows"))
    return rows
