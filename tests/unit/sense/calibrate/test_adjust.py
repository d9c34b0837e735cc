"""Rows of the adjustment against plain formulas and differences, with oblong pixels and a lens off the middle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from tactape_fab.sense.calibrate import camera
from tactape_fab.sense.calibrate.adjust import (
    LEAST_AGREEING,
    SYSTEMATIC,
    Bundle,
    Problem,
    agreeing,
    expected,
    pattern_of,
    problem_of,
    rows_of,
    solve,
    start,
)
from tactape_fab.sense.calibrate.errors import Errors, whitening
from tactape_fab.sense.calibrate.posedness import corner_sigma_um
from tactape_fab.sense.calibrate.presses import Press
from tactape_fab.sense.decode.grid.beliefs import PULL, PULL_SIGMA, PUSH_SIGMA_MM
from tactape_fab.sense.decode.rule import AGREE_SIGMAS
from tactape_fab.sense.geometry import Geometry
from tactape_fab.texture.frames import FloatArray
from tests.unit.sense.calibrate.sensors import STOCK

GEOMETRY = Geometry(aspect=0.03, shear=-0.02, k1=-0.04, center_px=(170.0, 110.0))
OBLONG = replace(STOCK, px_per_mm=(16.0, 8.0), geometry=GEOMETRY)
PUSH_MM, POSE = 0.03, np.array([3.0, -2.0, 2.8, 0.1])
VALUES = camera.parameters(OBLONG)


def press() -> Press:
    rng = np.random.default_rng(1)
    return Press(
        frame=0,
        tape="",
        seen_px=rng.uniform(0.0, 200.0, (9, 2)),
        rim_mm=rng.normal(0.0, 0.1, (9, 2)),
        texture_mm=POSE[:2] + rng.uniform(-7.0, 7.0, (9, 2)),
        weights=np.ones(9),
        interior=np.ones(9, dtype=bool),
        pushed=rng.normal(0.0, 0.1, (9, 2)),
        pulled=rng.normal(0.0, 0.1, (9, 2)),
        position_mm=(0.0, 0.0),
        theta_rad=0.0,
    )


def on_gel_mm(one: Press) -> FloatArray:
    """Where dots are expected, dot by dot."""
    (x, y, theta, pull), out = POSE, []
    for at, pushed, pulled, rim in zip(one.texture_mm, one.pushed, one.pulled, one.rim_mm, strict=True):
        dx, dy = at - (x, y)
        q = np.array([np.cos(theta) * dx - np.sin(theta) * dy, np.sin(theta) * dx + np.cos(theta) * dy])
        out.append(q + PUSH_MM * pushed - pull * pulled - rim)
    return np.array(out)


def test_residuals_are_millimetres_along_both_axes() -> None:
    one, model = press(), OBLONG.camera
    middle = model.from_px(OBLONG.centre_px)
    # dots that are seen 1 um from where they are expected, on the gel
    off = 1e-3 * np.random.default_rng(2).standard_normal((9, 2))
    seen = replace(one, seen_px=model.to_px(on_gel_mm(one) + middle + off))
    residual, _, _ = expected(seen, camera.seen_by(OBLONG, VALUES), PUSH_MM, POSE)
    # but for aspect, shear and lens, some per cent
    assert residual == pytest.approx(off, abs=3e-4)


def test_derivatives_are_those_of_the_residuals() -> None:
    one, scale = press(), np.array(camera.seen_by(OBLONG, VALUES).scale)

    def px(z: FloatArray) -> FloatArray:
        """Residuals, px: the scale that divides them is held."""
        seen = camera.seen_by(OBLONG, z[:6])
        return expected(one, seen, float(z[6]), z[7:])[0] * seen.scale

    at, step = np.array([*VALUES, PUSH_MM, *POSE]), 1e-6
    _, shared, own = expected(one, camera.seen_by(OBLONG, VALUES), PUSH_MM, POSE)
    by = [(px(at + d) - px(at - d)) / (2 * step) / scale for d in step * np.eye(len(at))]
    assert np.concatenate([shared, own], axis=2) == pytest.approx(np.stack(by, axis=2), abs=1e-6)


def test_the_camera_s_error_at_the_corners_is_in_micrometres_along_both_axes() -> None:
    sensor = replace(OBLONG, geometry=Geometry())
    none = np.empty(0)
    bundle = Bundle(
        sensor=sensor,
        values=camera.parameters(sensor),
        covariance=np.diag([0.0, 1e-6, 0.0, 0.0, 0.0, 0.0]),
        free=none > 0.0,
        push_mm=0.0,
        poses=none,
        poses_alone=none,
        poses_anew=none,
        residual_mm=(),
        errors=Errors(),
    )
    # an aspect of 1e-3 moves the corner by half of that of its place, out along u and in along v
    u_mm, v_mm = sensor.centre_px / sensor.px_per_mm
    assert corner_sigma_um(bundle) == pytest.approx(0.5 * np.hypot(u_mm, v_mm) / np.sqrt(2.0))


TRUE_VALUES = np.add(VALUES, (0.1, 0.004, -0.003, 0.006, 2.0, -1.5))
ERRORS = Errors(dot_mm=0.006, gel_mm=0.01, correlation_mm=3.0)


def many_presses(count: int = 7, noise_mm: float = 0.006) -> tuple[list[Press], FloatArray]:
    """Presses of a camera that is a little off its profile, without images, and their poses with the pull of each."""
    rng, seen = np.random.default_rng(3), camera.seen_by(OBLONG, TRUE_VALUES)
    grid = 1.5 * np.array([(c, r) for r in range(-3, 4) for c in range(-3, 4)])
    presses, poses = [], []
    for k in range(count):
        x, y, theta, pull = *rng.uniform(20.0, 40.0, 2), rng.uniform(-3.0, 3.0), PULL + rng.normal(0.0, 0.3) * PULL_SIGMA
        corner = np.multiply((3.0, 2.5), ((-1, -1), (1, -1), (1, 1), (-1, 1))[k % 4])
        c, s = np.cos(theta), np.sin(theta)
        # texture points whose places on the gel are the grid about a corner
        texture = (grid + corner) @ np.array([[c, -s], [s, c]]) + (x, y)  # rows times R^T: R q
        n = len(texture)
        pushed, pulled, rim = rng.normal(0.0, 0.1, (3, n, 2))
        at = grid + corner + PUSH_MM * pushed - pull * pulled - rim
        px = seen.to_px(at + rng.normal(0.0, noise_mm, at.shape))[0]
        presses.append(
            Press(
                frame=k,
                tape="t",
                seen_px=px,
                rim_mm=rim,
                texture_mm=texture,
                weights=np.where(np.arange(n) % 5, 1.0, 0.3),
                interior=np.ones(n, dtype=bool),
                pushed=pushed,
                pulled=pulled,
                position_mm=(x + 0.02, y - 0.03),
                theta_rad=theta + 0.004,
            )
        )
        poses.append((x, y, theta, pull))
    return presses, np.array(poses)


def derivative(problem: Problem, z: FloatArray) -> FloatArray:
    """Of the whitened residuals by all unknowns, a full matrix, by differences."""
    white = [whitening(one, problem.errors) for one in problem.presses]
    step = 1e-6 * np.eye(len(z))
    return np.stack([(rows_of(problem, white, z + d)[0] - rows_of(problem, white, z - d)[0]) / 2e-6 for d in step], axis=1)


def test_entries_of_the_derivative_stand_in_their_rows_and_columns() -> None:
    presses, _ = many_presses(3)
    problem = problem_of(presses, OBLONG, ERRORS)
    z = start(problem)
    white = [whitening(one, ERRORS) for one in presses]
    residuals, entries = rows_of(problem, white, z)
    columns, ends = pattern_of([len(one.weights) for one in presses], len(z))
    full = csr_matrix((entries, columns, ends), shape=(len(residuals), len(z))).toarray()
    # that the divisor of the residuals is an unknown, too, is left out
    by = derivative(problem, z)
    assert np.abs(np.delete(full - by, 0, axis=1)).max() < 1e-3 * np.abs(by).max()
    assert np.abs(full - by)[:, 0].max() < 0.2 * np.abs(by[:, 0]).max()
    # of the seven shared unknowns and of the pulls there are priors, of places and turns none
    assert (np.count_nonzero(full[:10], axis=1) == 1).all()
    assert np.nonzero(full[:10])[1].tolist() == [0, 1, 2, 3, 4, 5, 6, 10, 14, 18]
    assert 1.0 / full[:10].max(axis=1) == pytest.approx([*problem.prior_sigmas, PUSH_SIGMA_MM, *[PULL_SIGMA] * 3])
    assert problem.prior_sigmas.tolist() == [1.0, 0.1, 0.1, 0.1, 0.05 * 320, 0.05 * 320]


def test_a_camera_and_poses_are_found_as_far_as_is_said() -> None:
    presses, poses = many_presses()
    problem = problem_of(presses, OBLONG, ERRORS)
    found = solve(problem)
    off = (found.values - TRUE_VALUES) / np.sqrt(found.covariance.diagonal())
    assert np.abs(off).max() < 3.5 and np.sqrt(found.covariance.diagonal())[0] < 0.1
    assert camera.parameters(found.sensor) == pytest.approx(found.values)
    apart = found.poses - poses
    sigmas = np.sqrt(found.poses_anew.diagonal(axis1=1, axis2=2))
    assert np.abs(apart[:, :3] / sigmas[:, :3]).max() < 4.0 and np.abs(apart[:, :2]).max() < 0.02
    assert found.rms_mm == pytest.approx(0.006, rel=0.3)
    assert found.rms_mm == pytest.approx(np.sqrt(np.mean(np.concatenate(found.residual_mm) ** 2)))


@pytest.mark.parametrize("held", [(), ("k1",), ("k1", "shear")])
def test_covariances_are_those_of_the_full_system(held: tuple[str, ...]) -> None:
    """Of all unknowns at once, inverted; a camera from the other presses is one from a system without this press."""
    presses, _ = many_presses(5)
    free = np.array([name not in held for name in camera.NAMES])
    problem = problem_of(presses, OBLONG, ERRORS, free)
    found = solve(problem)
    z = np.concatenate([found.values, [found.push_mm], found.poses.ravel()])
    by = derivative(problem, z)
    kept = np.concatenate([free, np.ones(len(z) - 6, dtype=bool)])
    whole = np.zeros((len(z), len(z)))
    whole[np.ix_(kept, kept)] = np.linalg.inv((by.T @ by)[np.ix_(kept, kept)])
    expected_covariance = whole[:6, :6] + np.diag(np.where(free, SYSTEMATIC, 0.0) ** 2)
    scale = np.sqrt(np.where(free, found.covariance.diagonal(), 1.0))
    more = (found.covariance - expected_covariance) / np.outer(scale, scale)
    if held:
        assert np.abs(more).max() < 0.02 and (found.values == camera.parameters(OBLONG))[~free].all()
    else:
        # an error that looks like k1 is of one kind: it adds a matrix of rank 1 that makes k1 less sure
        values = np.linalg.eigvalsh(more)
        assert more[3, 3] > 0.01 and values[-1] > 0.01 and np.abs(values[:-1]).max() < 0.02
    rows = 7 + 5 + 2 * np.cumsum([0, *(len(one.weights) for one in presses)])
    for k in range(5):
        own = np.arange(7 + 4 * k, 11 + 4 * k)
        of_press = np.concatenate([[7 + k], np.arange(rows[k], rows[k + 1])])
        alone = np.linalg.inv(by[np.ix_(of_press, own)].T @ by[np.ix_(of_press, own)])
        assert found.poses_alone[k] == pytest.approx(
            alone, rel=0.02, abs=0.01 * np.sqrt(np.outer(alone.diagonal(), alone.diagonal())).min()
        )
        others = np.setdiff1d(np.arange(len(by)), of_press)
        rest = np.setdiff1d(np.flatnonzero(kept), own)
        shared = np.flatnonzero(kept[:7])
        camera_alone = np.linalg.inv(by[np.ix_(others, rest)].T @ by[np.ix_(others, rest)])[: len(shared), : len(shared)]
        lean = alone @ by[np.ix_(of_press, own)].T @ by[np.ix_(of_press, shared)]
        anew = alone + lean @ camera_alone @ lean.T
        spread = np.sqrt(anew.diagonal())
        assert np.abs((found.poses_anew[k] - anew) / np.outer(spread, spread)).max() < 0.02


def test_k1_stays_open_where_the_gel_is_displaced_however_many_presses() -> None:
    """What presses have alike, as the draw of a rim, they keep: four times as many once had half the standard deviation of k1."""
    moved = Errors(dot_mm=0.003, gel_mm=0.06, correlation_mm=4.0)
    few, many = (solve(problem_of(many_presses(n)[0], OBLONG, moved)).covariance[3, 3] for n in (7, 28))
    assert 0.5 < many / few < 1.0


def test_dots_that_do_not_agree_are_left_out_and_presses_of_few_dots() -> None:
    presses, _ = many_presses(4)
    problem = problem_of(presses, OBLONG, ERRORS)
    found = solve(problem)
    # two dots that are off by half more than what is let pass of a whole one: the first is light, and passes
    off_mm = found.residual_mm[1]
    limit_mm = AGREE_SIGMAS * np.median(np.hypot(*off_mm.T)) / 1.177
    spoilt = presses[1].seen_px.copy()
    for dot in (5, 7):
        spoilt[dot] += ((1.5 * limit_mm, 0.0) - off_mm[dot]) * camera.seen_by(OBLONG, found.values).scale
    few = presses[2].taken(np.arange(LEAST_AGREEING - 1))
    kept = agreeing([presses[0], replace(presses[1], seen_px=spoilt), few, presses[3]], found, problem)
    assert [one.frame for one in kept] == [0, 1, 3]
    there = (kept[1].texture_mm[:, None] == presses[1].texture_mm).all(axis=2).any(axis=0)
    assert there[5] and not there[7] and np.count_nonzero(~there) <= 3
    assert kept[0].position_mm == pytest.approx(found.poses[0, :2]) and kept[0].theta_rad == pytest.approx(found.poses[0, 2])
    # as many as tell something
    best = np.hypot(*found.residual_mm[2].T).argsort()[:LEAST_AGREEING]
    assert len(agreeing([presses[2].taken(best)], replace(found, poses=found.poses[2:3]), problem)) == 1
