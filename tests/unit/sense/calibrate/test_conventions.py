"""Poses of a flange that were written by another convention, at presses that hardly turn, where they fit nearly as well."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactape_fab.sense.calibrate import conventions
from tactape_fab.sense.calibrate.conventions import (
    MEANT,
    _adjoints,
    _cross,
    _inverted,
    _misfits,
    _step,
    better_convention,
    fitted_all,
)
from tactape_fab.sense.calibrate.misfits import SIGMAS, matrix_of, on_tape, turned_starts
from tactape_fab.texture.frames import FloatArray

BOTH = np.array([5.0, -3.0, 80.0, 0.1, -0.2, 0.5, 400.0, 100.0, 20.0, 0.05, 0.1, -1.2])
ORIGIN = np.array([3.0, 50.0])


def poses_of(turn_rad: float, errors: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Eight presses that turn by so much at most, and poses of the flange with the errors of an arm and a gel."""
    rng = np.random.default_rng(3)
    poses = np.column_stack([rng.uniform((15.0, 10.0), (78.0, 38.0), (8, 2)), 0.7 + rng.uniform(-turn_rad, turn_rad, 8)])
    off = errors * rng.standard_normal((8, 6)) * (0.03, 0.03, 0.1, 0.01, 0.01, 0.001)
    arm = matrix_of(BOTH[6:]) @ on_tape(poses, ORIGIN) @ matrix_of(off) @ np.linalg.inv(matrix_of(BOTH[:6]))
    return poses, arm


def turned(arm: FloatArray, turns: Rotation) -> FloatArray:
    out = arm.copy()
    out[:, :3, :3] = turns.as_matrix()
    return out


def wrong(arm: FloatArray, how: str) -> FloatArray:
    """Poses as a mistake writes them: named by what they were meant as."""
    turns = Rotation.from_matrix(arm[:, :3, :3])
    x, y, z, w = turns.as_quat().T
    if "inverse" in how:
        return np.asarray(np.linalg.inv(arm))
    if "alone inverted" in how:
        return turned(arm, turns.inv())
    if "qx,qy,qz,qw" in how:  # scipy's order, and the file's first column is qw
        return turned(arm, Rotation.from_quat(np.stack([y, z, w, x], axis=1)))
    if "qw first that were read" in how:
        return turned(arm, Rotation.from_quat(np.stack([w, x, y, z], axis=1)))
    if "rotation vectors" in how:
        return turned(arm, Rotation.from_euler(how[-3:], turns.as_rotvec()))
    if "in m" in how:
        out = arm.copy()
        out[:, :3, 3] /= 1000.0
        return out
    _, meant, made = (part[:3] for part in how.split("about "))
    return turned(arm, Rotation.from_euler(made, turns.as_euler(meant)))


@pytest.mark.parametrize("how", MEANT)
def test_a_wrong_convention_is_named_where_presses_hardly_turn(how: str) -> None:
    """Turned by 3 deg at most: of x, y less than 1 mm is left over, and less than 6 deg, by every one but that in metres."""
    poses, arm = poses_of(0.05)
    found = better_convention(wrong(arm, how), poses, ORIGIN, BOTH)
    assert found is not None and found.left[:2].max() < 0.06 < found.as_read[:2].max()
    # orders of angles may be each other's: fixed axes are moving ones in the other order
    assert found.words == how or ("angles" in how and "angles" in found.words)


@pytest.mark.parametrize("how", MEANT)
def test_poses_taken_as_they_were_meant_are_the_arm_s(how: str) -> None:
    """However its flange is turned: with the tool down, the middle one of three angles is more than a quarter turn."""
    rng = np.random.default_rng(8)
    turns = Rotation.random(300, rng).as_rotvec()
    # beyond, two rotation vectors have the same three angles, and either may be meant
    turns = turns[np.abs(turns).sum(axis=1) < 1.49 * np.pi]
    arm = matrix_of(np.column_stack([rng.uniform(-500.0, 500.0, turns.shape), turns]))
    assert len(arm) > 200 and MEANT[how](wrong(arm, how)) == pytest.approx(arm, abs=1e-6)


@pytest.mark.parametrize("turn_rad", [0.0, 0.002, 0.05, 3.0])
@pytest.mark.parametrize("errors", [0.0, 1.0, 5.0])
def test_right_poses_are_read_as_they_are(turn_rad: float, errors: float) -> None:
    poses, arm = poses_of(turn_rad, errors)
    assert better_convention(arm, poses, ORIGIN, BOTH) is None


def test_poses_that_do_not_turn_tell_no_convention() -> None:
    poses, arm = poses_of(0.0)
    assert better_convention(wrong(arm, "inverse"), poses, ORIGIN, BOTH) is None


def test_exact_poses_leave_nothing_over() -> None:
    poses, arm = poses_of(3.0, 0.0)
    left = fitted_all(arm[None], on_tape(poses, ORIGIN), turned_starts())
    assert left.shape == (1, 12, 6) and left.sum(axis=-1).min() < 1e-6


def test_of_flat_presses_sensor_and_tape_are_as_near_as_can_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """They leave open how far both are along their axes: a step goes to the least distances, from where nothing else is to do."""
    monkeypatch.setattr(conventions, "FAR_MM", 100.0)
    poses, arm = poses_of(3.0, 0.0)
    inverse = _inverted(on_tape(poses, ORIGIN))
    both, sigmas = (matrix_of(BOTH[None, :6]), matrix_of(BOTH[None, 6:])), SIGMAS[None]
    off, left, before = _misfits(arm[None], inverse, *both, sigmas)
    step = _step(off, left, *both, sigmas, np.zeros(1), _adjoints(inverse))
    sensor, tape = both[0] @ matrix_of(step[:, :6]), both[1] @ matrix_of(step[:, 6:])
    cost = _misfits(arm[None], inverse, sensor, tape, sigmas)[2]
    # as far along the sensor's axis as along the tape's, of which one looks into it
    assert sensor[0, :3, 3] @ sensor[0, :3, 2] == pytest.approx(tape[0, :3, 3] @ tape[0, :3, 2], abs=0.5)
    assert np.abs(step[0, [2, 8]]).min() > 5.0 and cost < before
    for apart_mm in (-2.0, 2.0):
        along = matrix_of(np.array([[0.0, 0.0, z, 0.0, 0.0, 0.0] for z in (apart_mm, -apart_mm)]))
        assert cost < _misfits(arm[None], inverse, sensor @ along[0], tape @ along[1], sigmas)[2]


def test_a_cross_product_is_a_matrix() -> None:
    a, b = np.array([1.0, 2.0, 3.0]), np.array([-2.0, 0.5, 4.0])
    assert _cross(a) @ b == pytest.approx(np.cross(a, b))
