"""Adjustment of a survey: its rows against differences, with oblong pixels, and drawn contacts with their true places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation

from tactape_fab import SpecError
from tactape_fab.sense import load_sensor
from tactape_fab.sense.survey.adjust import Prior, _Arm, _Normal, _residuals, _Rows, adjust
from tactape_fab.sense.survey.bend import Bend
from tactape_fab.sense.survey.contacts import Contact
from tactape_fab.sense.survey.poses import RobotPose
from tactape_fab.texture.frames import FloatArray, IntArray

SENSOR = replace(load_sensor("gelsight-mini"), px_per_mm=(16.0, 8.0))
NOMINAL_MM = 1.5 * np.array([(c, r) for r in range(9) for c in range(14)])
DOT_MM = 0.006


def drawn(rng: np.random.Generator, shift_mm: FloatArray, count: int) -> tuple[list[Contact], FloatArray]:
    """Contacts of a small tape whose dots err by 6 um along each axis, and their true poses."""
    contacts, poses = [], np.column_stack([rng.uniform((2.0, 2.0), (18.0, 10.0), (count, 2)), rng.uniform(-np.pi, np.pi, count)])
    for k, (x, y, theta) in enumerate(poses.tolist()):
        part = np.flatnonzero(np.hypot(*(NOMINAL_MM - (x, y)).T) < 4.5)
        c, s = np.cos(theta), np.sin(theta)
        # q = R(theta)^T (T - S), seen on the gel with an error
        gel_mm = (NOMINAL_MM[part] + shift_mm[part] - (x, y)) @ np.array([[c, s], [-s, c]])
        contacts.append(contact_of(k, part, gel_mm + rng.normal(0.0, DOT_MM, gel_mm.shape), poses[k] + rng.normal(0.0, 0.003, 3)))
    return contacts, poses


def contact_of(frame: int, part: IntArray, gel_mm: FloatArray, start: FloatArray) -> Contact:
    none = np.zeros_like(gel_mm)
    return Contact(
        frame=frame,
        part=part,
        seen_px=SENSOR.camera.to_px(gel_mm + SENSOR.camera.from_px(SENSOR.centre_px)),
        own=np.ones(len(part)),
        rim_mm2=np.zeros(len(part)),
        pushed=none,
        pulled=none,
        start=start,
        expected=np.zeros(0, dtype=np.int64),
    )


def by_robot(poses: FloatArray, frame: FloatArray, sigma: tuple[float, float] = (0.01, 0.1)) -> list[RobotPose]:
    """Poses in a frame at x mm, y mm, turned by rad; texture y is down, the robot's up."""
    turn = Rotation.from_euler("z", frame[2]).as_matrix()[:2, :2]
    xy_mm = frame[:2] + poses[:, :2] * (1, -1) @ turn.T
    deg = np.degrees(poses[:, 2] + frame[2])
    return [
        RobotPose(frame=k, x_mm=x, y_mm=y, theta_deg=theta, sigma_mm=sigma[0], sigma_deg=sigma[1])
        for k, (x, y, theta) in enumerate(np.column_stack([xy_mm, deg]).tolist())
    ]


def test_derivatives_are_those_of_the_residuals() -> None:
    """Of dots that are seen where they are modelled."""
    rng = np.random.default_rng(1)
    part, contact = np.arange(12), np.repeat([0, 1, 2], 4)
    seen_px, (pushed, pulled) = rng.uniform(0.0, 230.0, (12, 2)), rng.normal(size=(2, 12, 2))
    rows = _Rows(part=part, seen_px=seen_px, own=np.ones(12), rim_mm2=np.zeros(12), pushed=pushed, pulled=pulled, contact=contact)
    common, poses = np.array([0.0, 0.0, 0.0, 0.0, 0.03, 0.1]), np.array([(1.0, 2.0, 0.3), (-4.0, 0.5, 3.1), (0.0, 0.0, -1.6)])
    places_mm = _residuals(rows, SENSOR, common, poses, np.zeros((12, 2)))[0]

    def left(common: FloatArray, turn: float) -> FloatArray:
        return _residuals(rows, SENSOR, common, np.add(poses, (0.0, 0.0, turn)), places_mm)[0]

    step = 1e-6
    none, by_turn, by_common = _residuals(rows, SENSOR, common, poses, places_mm)
    assert none == pytest.approx(np.zeros((12, 2)), abs=1e-12)
    by = [(left(common + d, 0.0) - left(common - d, 0.0)) / (2 * step) for d in step * np.eye(6)]
    assert by_common == pytest.approx(np.stack(by, axis=2), abs=1e-6)
    assert by_turn == pytest.approx((left(common, step) - left(common, -step)) / (2 * step), abs=1e-6)


@pytest.mark.parametrize("count", [40, 200])
def test_many_contacts_of_a_small_tape_do_not_stretch_it(count: int) -> None:
    """Dots err by 6 um along each axis, and nothing else does: places are off as far as is said, however often touched."""
    squares, scales = [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        shift_mm = rng.normal(0.0, 0.05, NOMINAL_MM.shape)
        contacts, _ = drawn(rng, shift_mm, count)
        found = adjust(contacts, NOMINAL_MM, SENSOR, Prior(shift_mm=0.0 * NOMINAL_MM, sigma_mm=np.full(len(NOMINAL_MM), np.nan)))
        off = (found.shift_mm - shift_mm[found.part]) / found.sigma_mm[:, None]
        squares.append(float((off**2).mean()))
        scales.append(float(found.common[0] / found.common_sigma[0]))
        assert found.scatter_mm == pytest.approx(0.05, rel=0.15)
    assert np.mean(squares) < 2.0
    assert np.abs(scales).max() < 3.0


def test_an_inspection_tells_the_dots_errors_from_the_parts() -> None:
    """Two thirds of a part's place come from an inspection; a dot that is 0.4 mm off is left out, and counted."""
    rng = np.random.default_rng(4)
    shift_mm = rng.normal(0.0, 0.05, NOMINAL_MM.shape)
    contacts, _ = drawn(rng, shift_mm, 14)
    contacts[3].seen_px[5] += 0.4 * 16.0
    prior = Prior(shift_mm=shift_mm + rng.normal(0.0, 0.003, shift_mm.shape), sigma_mm=np.full(len(shift_mm), 0.003))
    found = adjust(contacts, NOMINAL_MM, SENSOR, prior)
    assert found.scatter_mm is None and found.left == 1.0 / sum(len(c.part) for c in contacts)
    assert found.dot_mm == pytest.approx(DOT_MM, rel=0.04)


def test_a_robot_shows_how_the_whole_tape_is_stretched() -> None:
    """By 0.5 % along x: 50 um at the ends, of which contacts alone know nothing."""
    rng = np.random.default_rng(0)
    middle_mm = NOMINAL_MM.mean(axis=0)
    shift_mm = (NOMINAL_MM - middle_mm) * (0.005, 0.0) + rng.normal(0.0, 0.01, NOMINAL_MM.shape)
    contacts, poses = drawn(rng, shift_mm, 24)
    prior = Prior(shift_mm=0.0 * NOMINAL_MM, sigma_mm=np.full(len(NOMINAL_MM), np.nan))
    found = adjust(contacts, NOMINAL_MM, SENSOR, prior, by_robot(poses, np.array([300.0, -50.0, 3.0])))
    off = found.shift_mm - shift_mm[found.part]
    slope = np.polyfit(NOMINAL_MM[found.part, 0] - middle_mm[0], found.shift_mm[:, 0], 1)[0]
    assert slope == pytest.approx(0.005, abs=5e-4)
    assert (off - off.mean(axis=0)).std() < 0.005
    assert found.scatter_mm == pytest.approx(0.01, rel=0.15)


def test_a_step_solves_all_equations_at_once() -> None:
    """Parts, camera, poses, bend and a robot's frame in one matrix, by numpy; one pose is far off and has Huber's weight."""
    rng = np.random.default_rng(2)
    nominal_mm = np.array([*rng.uniform(0.0, 2.5, (6, 2)), (12.0, 9.0)])
    part, contact, parts, contacts = np.tile(np.arange(7), 4), np.repeat(np.arange(4), 7), 7, 4
    none = np.zeros((28, 2))
    rows = _Rows(part=part, contact=contact, seen_px=none, own=none[:, 0], rim_mm2=none[:, 0], pushed=none, pulled=none)
    left, by_turn = rng.normal(size=(2, 28, 2))
    by_common, weight, before = rng.normal(size=(28, 2, 6)), rng.uniform(1.0, 9.0, 28), rng.uniform(0.2, 0.9, 7)
    sigmas, towards_common, towards_mm = rng.uniform(0.3, 2.0, 6), rng.normal(size=6), rng.normal(size=(7, 2))
    poses = rng.normal(size=(4, 3))
    none_seen = [contact_of(k, part[:0], none[:0], poses[k]) for k in range(4)]
    robot = by_robot(poses + rng.normal(0.0, 0.01, (4, 3)), np.array([5.0, 2.0, 3.0]), (0.2, 20.0))
    robot = [replace(robot[1], x_mm=robot[1].x_mm + 3.0), *robot[2:]]  # none of the first contact
    arm = _Arm(robot, none_seen, poses)
    bend = Bend(nominal_mm, held=True)
    bend.move(rng.normal(size=9), np.ones(9))

    def left_by_robot(unknown: FloatArray) -> FloatArray:
        """Of poses (3, 3) and the frame (3,)."""
        moved, at = unknown[:9].reshape(3, 3), unknown[9:]
        turn = Rotation.from_euler("z", at[2]).as_matrix()[:2, :2]
        given = np.array([(p.x_mm, p.y_mm, np.radians(p.theta_deg)) for p in robot])
        off = moved[:, 2] + at[2] - given[:, 2]
        return np.column_stack([at[:2] + moved[:, :2] * (1, -1) @ turn.T - given[:, :2], np.angle(np.exp(1j * off))]).ravel()

    here = np.array([*poses[1:].ravel(), *arm.at])
    by_arm, off = approx_fprime(here, left_by_robot), left_by_robot(here)
    arm_sigma = np.tile([0.2, 0.2, np.radians(20.0)], 3)
    arm_weight = np.minimum(1.0, 2.0 / np.abs(off / arm_sigma)) / arm_sigma**2
    assert (arm_weight < 0.9 / arm_sigma**2).any()

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
    for value, by_weight, line in zip(off, arm_weight, by_arm, strict=True):
        row(-value, by_weight, *enumerate(line[:9].tolist(), 9), *enumerate(line[9:].tolist(), 27))
    root = np.sqrt([w for _, w, _ in equations])
    matrix = np.array([line for *_, line in equations]) * root[:, None]
    step = np.linalg.lstsq(matrix, root * [value for value, *_ in equations], rcond=None)[0]
    covariance = np.linalg.inv(matrix.T @ matrix)

    own = np.bincount(part, weight, parts) + before**-2
    normal = _Normal(rows, weight, own, left, by_turn, by_common, contacts, parts)
    towards = towards_mm / before[:, None] ** 2
    normal.bent(bend, before**-2, towards)
    found, moved = normal.solved(towards_common / sigmas**2, sigmas, towards, arm, poses)
    assert found == pytest.approx(step[:30], abs=1e-5) and moved.ravel() == pytest.approx(step[30:], abs=1e-5)
    assert normal.variances(slice(18, 27)) == pytest.approx(covariance.diagonal()[18:27], rel=1e-4)
    sigma, drift, common_sigma = normal.sigmas(nominal_mm)
    of_parts = covariance.diagonal()[30:].reshape(7, 2)
    assert sigma**2 == pytest.approx(of_parts.mean(axis=1), rel=1e-4)
    assert common_sigma**2 == pytest.approx(covariance.diagonal()[:6], rel=1e-4)
    # neighbours: six parts together, one alone; what each errs by itself is no drift
    squares = []
    for group in [range(6)] * 6 + [range(6, 7)]:
        for axis in (0, 1):
            of = [30 + 2 * p + axis for p in group]
            squares.append(covariance[np.ix_(of, of)].mean() - sum(1.0 / own[p] for p in group) / len(group) ** 2)
    assert drift**2 == pytest.approx(np.mean(squares), rel=1e-4)


@pytest.mark.parametrize(
    ("moved", "sigma", "says"),
    [
        ((0.6, 0.7, 0.09), (0.1, 0.1), None),
        ((0.7, 0.8, 0.0), (0.1, 0.1), r"1\.1 mm or 0 deg off"),
        ((0.7, 0.8, 0.0), (0.4, 0.1), None),
        ((0.0, 0.0, 0.11), (0.1, 0.1), r"mm or 6\.3 deg off"),
        ((0.0, 0.0, -0.11), (0.1, 3.0), None),
    ],
)
def test_poses_of_another_frame_are_refused(moved: tuple[float, ...], sigma: tuple[float, float], says: str | None) -> None:
    """By more than 1 mm or 0.1 rad, and three standard deviations; the frame is that of all poses, across 180 deg."""
    contacts, poses = drawn(np.random.default_rng(1), 0.0 * NOMINAL_MM, 5)
    arm = _Arm(by_robot(poses, np.array([300.0, -50.0, 3.1]), sigma), contacts, poses)
    assert arm.at == pytest.approx((300.0, -50.0, 3.1))
    if says is None:
        arm.refuse_others(poses + moved)
    else:
        with pytest.raises(SpecError, match=says):
            arm.refuse_others(poses + moved)
