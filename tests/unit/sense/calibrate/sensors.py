"""A sensor that is not as its profile says, and presses of it on a tape, simulated once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from tactape_fab import Tape
from tactape_fab.sense import Scene, SensorProfile, load_sensor, simulate
from tactape_fab.sense.calibrate.presses import Frame, Press
from tactape_fab.sense.geometry import Geometry
from tactape_fab.texture.frames import FloatArray
from tests.tapes import tape_at

TAPE = tape_at(7, (62, 32))
STOCK = load_sensor("gelsight-mini")
TRUE = replace(STOCK, px_per_mm=(15.0, 15.0), geometry=Geometry(aspect=0.03, shear=0.01, k1=0.03))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Presses:
    """Frames and their poses: x mm, y mm, theta deg."""

    frames: list[Frame]
    poses: FloatArray


@cache
def presses(count: int = 10, seed: int = 1, reach_mm: tuple[float, float] = (5.0, 3.5), first_theta: float = 20.0) -> Presses:
    """Presses of `TRUE`, the first one at `first_theta`: the contact is in each quarter by turns, up to `reach_mm` off."""
    return pressed(TRUE, count, seed, reach_mm, first_theta)


def presses_on(tape: Tape) -> Presses:
    """Ten presses of `TRUE` on some tape."""
    return pressed(TRUE, 10, 1, (5.0, 3.5), 20.0, tape=tape)


def pressed(
    sensor: SensorProfile,
    count: int,
    seed: int,
    reach_mm: tuple[float, float],
    first_theta: float,
    *,
    tape: Tape = TAPE,
    alike: bool = False,
    **options: float,
) -> Presses:
    """Presses of a sensor, with further options of the scene."""
    rng = np.random.default_rng(seed)
    frames, poses = [], []
    for k in range(count):
        u, v = rng.uniform(0.2, 1.0, 2) * reach_mm * ((-1, -1), (1, -1), (1, 1), (-1, 1))[k % 4]
        scene = Scene(contact_offset_mm=(float(u), float(v)), contact_mm=(9.0, 8.0)).changed(options)
        x, y = rng.uniform((20.0, 15.0), (70.0, 33.0)).tolist()
        theta = first_theta if k == 0 or alike else float(rng.uniform(-180.0, 180.0))
        frames.append(simulate(tape, (x, y), theta, sensor=sensor, scene=scene, seed=100 * seed + k))
        poses.append((x, y, theta))
    return Presses(frames=frames, poses=np.array(poses))


def off_mm(press: Press, pose: FloatArray) -> FloatArray:
    """Where dots of `TRUE` are seen less where a pose has their parts, on the gel, (n, 2)."""
    theta = np.radians(pose[2])
    turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    on_gel = TRUE.camera.from_px(press.seen_px) - TRUE.camera.from_px(TRUE.centre_px) + press.rim_mm
    off: FloatArray = on_gel - (press.texture_mm - pose[:2]) @ turn.T
    return off
