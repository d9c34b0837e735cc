"""Normal equations of a survey against one dense matrix of all unknowns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation

from tactape_fab.sense.survey.bend import Bend
from tactape_fab.sense.survey.normal_equations import NormalEquations
from tactape_fab.sense.survey.residuals import Rows
from tactape_fab.sense.survey.robot_frame import RobotFrame
from tactape_fab.texture.frames import FloatArray
from tests.surveyed import by_robot, contact_of


def test_a_step_solves_all_equations_at_once() -> None:
    """Parts, camera, poses, bend and a robot's frame in one matrix, by numpy; one pose is far off and has Huber's weight."""
    rng = np.random.default_rng(2)
    nominal_mm = np.array([(0.0, 0.0), (2.6, 2.6), *rng.uniform(0.0, 2.6, (4, 2)), (6.0, 6.0)])
    part, contact, parts, contacts = np.tile(np.arange(7), 4), np.repeat(np.arange(4), 7), 7, 4
    none = np.zeros((28, 2))
    rows = Rows(part=part, contact=contact, seen_px=none, own=none[:, 0], rim_mm2=none[:, 0], pushed=none, pulled=none)
    left, by_turn = rng.normal(size=(2, 28, 2))
    by_common, weight, before = rng.normal(size=(28, 2, 6)), rng.uniform(1.0, 9.0, 28), rng.uniform(0.2, 0.9, 7)
    sigmas, towards_common, towards_mm = rng.uniform(0.3, 2.0, 6), rng.normal(size=6), rng.normal(size=(7, 2))
    poses = rng.normal(size=(4, 3))
    none_seen = [contact_of(k, part[:0], none[:0], poses[k]) for k in range(4)]
    robot = by_robot(poses + rng.normal(0.0, 0.01, (4, 3)), np.array([5.0, 2.0, 3.0]), (0.2, 20.0))
    robot = [replace(robot[1], x_mm=robot[1].x_mm + 3.0), *robot[2:]]  # none of the first contact
    frame = RobotFrame(robot, none_seen, poses)
    bend = Bend(nominal_mm, held=True)
    bend.move(rng.normal(size=9), np.ones(9))

    def left_by_robot(unknown: FloatArray) -> FloatArray:
        """Of poses (3, 3) and the frame (3,)."""
        moved, at = unknown[:9].reshape(3, 3), unknown[9:]
        turn = Rotation.from_euler("z", at[2]).as_matrix()[:2, :2]
        given = np.array([(p.x_mm, p.y_mm, np.radians(p.theta_deg)) for p in robot])
        off = moved[:, 2] + at[2] - given[:, 2]
        return np.column_stack([at[:2] + moved[:, :2] * (1, -1) @ turn.T - given[:, :2], np.angle(np.exp(1j * off))]).ravel()

    here = np.array([*poses[1:].ravel(), *frame.at])
    by_frame, off = approx_fprime(here, left_by_robot), left_by_robot(here)
    robot_sigma = np.tile([0.2, 0.2, np.radians(20.0)], 3)
    robot_weight = np.minimum(1.0, 2.0 / np.abs(off / robot_sigma)) / robot_sigma**2
    assert (robot_weight < 0.9 / robot_sigma**2).any()

    # unknowns: camera 6, poses 12, bend 9, frame 3, parts 14 (x and y of each); rows: right side, weight, derivatives
    equations: list[tuple[float, float, FloatArray]] = []

    def row(value: float, weight: float, *terms: tuple[int, float]) -> None:
        line = np.zeros(44)
        for at, rate in terms:
            line[at] += rate
        equations.append((value, weight, line))

    for i, (p, k) in enumerate(zip(part.tolist(), contact.tolist(), strict=True)):
        for axis in (0, 1):
            seen = (6 + 3 * k + axis, 1.0), (8 + 3 * k, by_turn[i, axis]), (30 + 2 * p + axis, -1.0)
            row(-left[i, axis], weight[i], *enumerate(by_common[i, axis].tolist()), *seen)
    for k in range(6):
        row(towards_common[k], sigmas[k] ** -2, (k, 1.0))
    for p in range(7):
        for axis in (0, 1):
            modes = ((18 + m, -bend.modes[m, axis * 7 + p]) for m in range(9))
            row(towards_mm[p, axis], before[p] ** -2, (30 + 2 * p + axis, 1.0), *modes)
    for m in range(9):
        row(-bend.amplitude_mm[m], bend.sigma_mm**-2, (18 + m, 1.0))
    for value, by_weight, line in zip(off, robot_weight, by_frame, strict=True):
        row(-value, by_weight, *enumerate(line[:9].tolist(), 9), *enumerate(line[9:].tolist(), 27))
    root = np.sqrt([w for _, w, _ in equations])
    matrix = np.array([line for *_, line in equations]) * root[:, None]
    step = np.linalg.lstsq(matrix, root * [value for value, *_ in equations], rcond=None)[0]
    covariance = np.linalg.inv(matrix.T @ matrix)

    own = np.bincount(part, weight, parts) + before**-2
    normal = NormalEquations(rows, weight, own, left, by_turn, by_common, contacts, parts)
    towards = towards_mm / before[:, None] ** 2
    normal.bent(bend, before**-2, towards)
    found, moved = normal.solved(towards_common / sigmas**2, sigmas, towards, frame, poses)
    assert found == pytest.approx(step[:30], abs=1e-5) and moved.ravel() == pytest.approx(step[30:], abs=1e-5)
    assert normal.variances(slice(18, 27)) == pytest.approx(covariance.diagonal()[18:27], rel=1e-4)
    sigma, drift, common_sigma = normal.sigmas(nominal_mm)
    of_parts = covariance.diagonal()[30:].reshape(7, 2)
    assert sigma**2 == pytest.approx(of_parts.mean(axis=1), rel=1e-4)
    assert common_sigma**2 == pytest.approx(covariance.diagonal()[:6], rel=1e-4)
    # neighbours: six parts together, one alone, 5 mm from the next; what each errs by itself is no drift
    squares = []
    for group in [range(6)] * 6 + [range(6, 7)]:
        for axis in (0, 1):
            of = [30 + 2 * p + axis for p in group]
            squares.append(covariance[np.ix_(of, of)].mean() - sum(1.0 / own[p] for p in group) / len(group) ** 2)
    assert drift**2 == pytest.approx(np.mean(squares), rel=1e-4)
