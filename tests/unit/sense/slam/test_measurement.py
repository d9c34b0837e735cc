"""Answers as measurements of a pose graph: order, frame and units of the error, against samples and against GTSAM itself."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab import Localization, Localizer, SpecError, TapedObject
from tactape_fab.sense import Mount, measure_pose, simulate
from tactape_fab.sense.decode.result import state_of, surface_of
from tactape_fab.sense.decode.space import image_pose
from tactape_fab.sense.objects.rigid import from_rpy
from tactape_fab.sense.objects.taped_object import TapeOnObject
from tactape_fab.sense.slam.measurement import PoseMeasurement, square_root
from tests.contacts import TAPE

gtsam = pytest.importorskip("gtsam", reason='gtsam is not installed: pip install "tactape-fab[slam]"')
SAMPLES = 4000
TURN = from_rpy((0.0, 0.0, 40.0)) @ from_rpy((30.0, -20.0, 0.0))
PLANE = Mount(surface="plane", rotation=TURN, position_mm=np.array([5.0, 60.0, -7.0]))
ROUND = Mount(surface="cylinder", rotation=TURN, position_mm=np.array([5.0, 60.0, -7.0]), top_mm=16.0, true_mm=15.9)
FRAMES = [("board", None), ("texture", None), ("object", PLANE), ("object", ROUND)]


@cache
def real_fix() -> Localization:
    """An answer with its tilt: five degrees, so that the sensor's axis is not the tape's normal."""
    depth = simulate(TAPE, (40.3, 22.1), 37.0, contact="pad", tilt_mm_per_mm=(0.03, -0.02), seed=3)
    fix = Localizer([TAPE], world="closed").locate(depth)
    assert fix.located and fix.tilt_deg is not None
    return fix


def placed(mount: Mount | None) -> Any:
    return None if mount is None else TapedObject(name="cup", tapes=(TapeOnObject(kit=Path("kit"), tape=TAPE, mount=mount),))


def sampled_errors(fix: Localization, frame: str, on: Any, spread: float, rng: np.random.Generator) -> np.ndarray:
    """GTSAM's error of a factor whose true pose is drawn from the answer's own state and covariance, ``spread`` times as wide."""
    state, surface = state_of(fix), surface_of(fix, frame, on)
    assert state is not None and state[1] is not None and surface is not None
    covariance = np.where(np.isfinite(state[1]), state[1], 0.0)
    draws = rng.multivariate_normal(state[0], spread**2 * covariance, SAMPLES, method="eigh")
    measured = gtsam.Pose3(image_pose(surface, state[0]))
    return np.array([measured.localCoordinates(gtsam.Pose3(image_pose(surface, draw))) for draw in draws]) / spread


@pytest.mark.parametrize(("frame", "mount"), FRAMES)
def test_the_information_is_that_of_samples_in_gtsam_s_own_coordinates(frame: str, mount: Mount | None) -> None:
    fix, on = real_fix(), placed(mount)
    found = measure_pose(fix, frame, on=on)
    assert found is not None
    errors = sampled_errors(fix, frame, on, 0.1, np.random.default_rng(1))
    errors[:, 3:] *= 1e-3  # the samples are in mm
    white = errors @ square_root(found.information).T
    known = np.abs(square_root(found.information)).max(axis=1) > 0
    assert known.sum() == 5  # all but the place along the sensor's axis
    assert np.cov(white[:, known].T) == pytest.approx(np.eye(5), abs=5 * np.sqrt(2 / SAMPLES))


def test_in_another_order_it_would_not_be() -> None:
    """The test above fails for an error that has shifts first, or is in the frame's own axes."""
    found = measure_pose(real_fix(), "object", on=placed(PLANE))
    assert found is not None
    errors = sampled_errors(real_fix(), "object", placed(PLANE), 0.1, np.random.default_rng(1))
    errors[:, 3:] *= 1e-3
    for wrong in (errors[:, [3, 4, 5, 0, 1, 2]], errors @ np.kron(np.eye(2), found.pose[:3, :3].T)):
        white = wrong @ square_root(found.information).T
        assert np.abs(white.var(axis=0)).max() > 1.5


@pytest.mark.parametrize(("frame", "mount"), FRAMES)
@pytest.mark.parametrize("origin", ["tape", "gel"])
def test_the_pose_is_that_of_transform_in_metres(frame: str, mount: Mount | None, origin: str) -> None:
    on = placed(mount)
    found, expected = measure_pose(real_fix(), frame, on=on, origin=origin), real_fix().transform(frame, on=on, origin=origin)
    assert found is not None and expected is not None
    assert found.pose[:3, :3] == pytest.approx(expected[:3, :3], abs=1e-12)
    assert 1000 * found.pose[:3, 3] == pytest.approx(expected[:3, 3], abs=1e-9)


def test_a_flat_contact_tells_three_of_six() -> None:
    found = measure_pose(replace(real_fix(), contact=None), "object", on=placed(PLANE))
    assert found is not None
    assert np.linalg.matrix_rank(square_root(found.information), tol=1e-6) == 3
    assert np.abs(found.information[np.ix_([0, 1, 5], [0, 1, 5])]).max() < 1e-9 * found.information.max()


def test_the_covariance_of_a_flat_contact_is_the_answer_s_own() -> None:
    fix = replace(real_fix(), contact=None)
    found = measure_pose(fix, "texture")
    assert found is not None and fix.covariance is not None and fix.theta_deg is not None
    known = [3, 4, 2]
    covariance = np.linalg.inv(found.information[np.ix_(known, known)])
    turn = np.eye(3)  # from the texture's axes to the sensor's, in which theta turns the other way about z
    c, s = np.cos(radians(fix.theta_deg)), np.sin(radians(fix.theta_deg))
    turn[:2, :2], turn[2, 2] = 1e-3 * np.array([(c, -s), (s, c)]), -1.0
    assert covariance == pytest.approx(turn @ fix.covariance @ turn.T, rel=1e-5, abs=1e-15)


def test_with_the_gel_s_surface_all_six_are_known() -> None:
    found = measure_pose(real_fix(), origin="gel")
    assert found is not None
    assert np.linalg.eigvalsh(found.information).min() > 0


def test_a_factor_s_error_is_that_of_the_information() -> None:
    found = measure_pose(real_fix())
    assert found is not None
    step = np.array([1e-3, -2e-3, 3e-3, 2e-5, -1e-5, 4e-5])
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3())
    values.insert(1, gtsam.Pose3(found.pose).retract(step))
    for factor in (found.prior_factor(1), found.between_factor(0, 1)):
        assert factor.error(values) == pytest.approx(0.5 * step @ found.information @ step, rel=1e-6)


def test_in_the_world_the_error_is_the_same_and_the_pose_moved() -> None:
    at = np.eye(4)
    at[:3, :3], at[:3, 3] = TURN, (0.1, 0.2, 0.3)
    here, there = measure_pose(real_fix()), measure_pose(real_fix(), at=at)
    assert here is not None and there is not None
    assert there.pose == pytest.approx(at @ here.pose)
    assert (there.information == here.information).all()


@pytest.mark.parametrize("at", [np.eye(3), np.diag([1.0, 1.0, -1.0, 1.0]), 2 * np.eye(4), np.full((4, 4), np.nan)])
def test_what_is_no_pose_is_refused(at: np.ndarray) -> None:
    with pytest.raises(SpecError, match="4 x 4 matrix of a rotation"):
        measure_pose(real_fix(), at=at)


def test_what_is_no_answer_is_refused() -> None:
    with pytest.raises(SpecError, match=r"Localizer\.locate returns"):
        measure_pose(None)  # type: ignore[arg-type]


def test_nothing_is_measured_where_nothing_is_known() -> None:
    fix = real_fix()
    assert measure_pose(Localization(status="none", located=False)) is None
    assert measure_pose(replace(fix, covariance=None)) is None
    assert measure_pose(replace(fix, board_mm=None)) is None
    assert measure_pose(replace(fix, contact=None), origin="gel") is None


# g2o


def read_edge(line: str) -> tuple[np.ndarray, np.ndarray]:
    """Pose and information of an EDGE_SE3:QUAT."""
    words = line.split()
    assert words[:3] == ["EDGE_SE3:QUAT", "0", "7"] and len(words) == 3 + 7 + 21
    values = np.array(words[3:], dtype=float)
    pose = np.eye(4)
    pose[:3, 3], pose[:3, :3] = values[:3], gtsam.Rot3.Quaternion(values[6], *values[3:6]).matrix()
    information = np.zeros((6, 6))
    information[np.triu_indices(6)] = values[7:]
    return pose, information + np.triu(information, 1).T


def g2o_error(measured: np.ndarray, true: np.ndarray) -> np.ndarray:
    """EdgeSE3::computeError with the first vertex at the origin: toVectorMQT(Z^-1 X), shift and vector part of the quaternion."""
    delta = np.linalg.inv(measured) @ true
    turn = gtsam.Rot3(delta[:3, :3]).toQuaternion()
    return np.array([*delta[:3, 3], turn.x(), turn.y(), turn.z()])


def test_an_edge_weighs_an_error_as_the_factor_does() -> None:
    found = measure_pose(real_fix())
    assert found is not None
    pose, information = read_edge(found.g2o_edge(0, 7))
    assert pose == pytest.approx(found.pose, abs=1e-9)
    rng = np.random.default_rng(2)
    for step in rng.normal(0, 1, (20, 6)) * ([1e-5] * 3 + [1e-6] * 3):
        error = g2o_error(found.pose, gtsam.Pose3(found.pose).retract(step).matrix())
        assert error @ information @ error == pytest.approx(step @ found.information @ step, rel=1e-3)


def test_gtsam_reads_the_edge_and_takes_the_turn_s_half_for_the_whole(tmp_path: Path) -> None:
    """What the page warns of: GTSAM's reader weighs turns four times as much as g2o does."""
    found = measure_pose(real_fix(), origin="gel")
    assert found is not None
    file = tmp_path / "graph.g2o"
    vertices = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 7 0 0 0 0 0 0 1\nFIX 0\n"
    file.write_text(f"{vertices}{found.g2o_edge(0, 7)}\n", encoding="ascii")
    factor = gtsam.readG2o(str(file), True)[0].at(0)
    assert factor.measured().matrix() == pytest.approx(found.pose, abs=1e-9)
    read = np.linalg.inv(factor.noiseModel().covariance())
    expected = found.information.copy()
    expected[:3, :3] *= 4.0
    expected[:3, 3:] *= 2.0
    expected[3:, :3] *= 2.0
    assert read == pytest.approx(expected, rel=1e-4, abs=1e-6 * expected.max())


def test_roots_of_singular_information() -> None:
    rng = np.random.default_rng(3)
    some = rng.normal(size=(4, 6)) * ([1e2] * 3 + [1e6] * 3)
    information = some.T @ some
    root = square_root(information)
    assert root.T @ root == pytest.approx(information, rel=1e-9, abs=1e-9 * information.max())
    bare = PoseMeasurement(pose=np.eye(4), information=np.zeros((6, 6)))
    assert (bare.noise_model().R() == 0).all()


@pytest.mark.parametrize("origin", ["tape", "gel"])
def test_a_mount_s_error_is_in_the_information(origin: str) -> None:
    """As the covariance in the object's frame has it, turned into the sensor's own."""
    spread = np.diag([0.2, 0.1, 0.3, 0.01, 0.02, 0.01]) ** 2
    fix, on = real_fix(), placed(replace(ROUND, covariance=spread))
    found = measure_pose(fix, "object", on=on, origin=origin)
    covariance = fix.covariance6("object", on=on, origin=origin)
    assert found is not None and covariance is not None
    turn = found.pose[:3, :3]
    # GTSAM's order, turns first, in the sensor's own axes and in metres
    own = np.zeros((6, 6))
    own[:3, 3:], own[3:, :3] = turn.T, 1e-3 * turn.T
    expected = own @ covariance @ own.T
    seen = [0, 1, 2, 3, 4] if origin == "tape" else [0, 1, 2, 3, 4, 5]  # of that origin nothing is said along the sensor's axis
    information = np.linalg.inv(expected[np.ix_(seen, seen)])
    scale = np.sqrt(np.outer(information.diagonal(), information.diagonal()))
    assert found.information[np.ix_(seen, seen)] / scale == pytest.approx(information / scale, abs=1e-6)
