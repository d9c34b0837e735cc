"""Hand-eye: both transforms come back within their standard deviations; what poses leave open is said."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactape_fab import SpecError
from tactape_fab.sense import ArmPose, Calibration, calibrate_sensor
from tactape_fab.sense.calibrate import calibration
from tactape_fab.sense.calibrate.adjust import Bundle
from tactape_fab.sense.calibrate.conventions import Convention
from tactape_fab.sense.calibrate.hand_eye import (
    OBSERVED_MM,
    OBSERVED_RAD,
    HandEye,
    _drawn,
    _first,
    _fits,
    _inverse,
    _Joint,
    _mirrored,
    _own_motion,
    _radius_mm,
    _refuse_convention,
    _remarks,
    find_hand_eye,
)
from tactape_fab.sense.calibrate.misfits import FAR_MM, matrix_of, misfits, on_tape
from tactape_fab.sense.calibrate.presses import Press
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape
from tests.thorough import costly, only_thorough, slow
from tests.unit.sense.calibrate.sensors import STOCK, TAPE, presses

ON_FLANGE = matrix_of(np.array([5.0, -3.0, 80.0, *Rotation.from_euler("xyz", [2, -3, 30], degrees=True).as_rotvec()]))
IN_BASE = matrix_of(np.array([400.0, 100.0, 20.0, *Rotation.from_euler("xyz", [1, 2, -70], degrees=True).as_rotvec()]))


def arm_poses(poses: FloatArray, tilt_rad: float = 0.01, seed: int = 5) -> list[ArmPose]:
    """Poses of the flange that see the presses, with the errors of an arm and a gel."""
    rng = np.random.default_rng(seed)
    seen = on_tape(np.column_stack([poses[:, :2], np.radians(poses[:, 2])]), np.array(TAPE.board.texture_origin_mm))
    off = rng.standard_normal((len(poses), 6)) * (0.03, 0.03, 0.1, tilt_rad, tilt_rad, 0.001)
    made = [IN_BASE @ p @ matrix_of(e) @ np.linalg.inv(ON_FLANGE) for p, e in zip(seen, off, strict=True)]
    return [ArmPose(frame=k, flange_to_base=m) for k, m in enumerate(made)]


@cache
def solved_from() -> tuple[Calibration, tuple[Bundle, Sequence[Press], Sequence[Tape]]]:
    """A calibration with poses of the arm, and what the solve for these was given beside them."""
    made, given = presses(), list[tuple[Bundle, Sequence[Press], Sequence[Tape]]]()

    def find(bundle: Bundle, seen: Sequence[Press], tapes: Sequence[Tape], poses: Sequence[ArmPose]) -> HandEye:
        given.append((bundle, seen, tapes))
        return find_hand_eye(bundle, seen, tapes, poses)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "find_hand_eye", find)
        found = calibrate_sensor(made.frames, [TAPE], STOCK, known_theta=(0, 20.0), arm_poses=arm_poses(made.poses))
    return found, given[0]


def solved() -> Calibration:
    return solved_from()[0]


def solved_again(poses: Sequence[ArmPose]) -> HandEye:
    """Of other poses beside the same presses, whose adjustment takes longer than all else."""
    return find_hand_eye(*solved_from()[1], poses)


def test_both_transforms_are_found() -> None:
    found = solved().hand_eye
    assert found is not None and found.tape == TAPE.name and found.frames == tuple(range(10))
    sigma = np.sqrt(np.diag(found.covariance))
    for answer, truth, said in ((found.sensor_to_flange, ON_FLANGE, sigma[:6]), (found.tape_to_base, IN_BASE, sigma[6:])):
        off = np.linalg.inv(truth) @ answer
        turned = Rotation.from_matrix(off[:3, :3]).as_rotvec()
        assert (np.abs(np.concatenate([off[:3, 3], turned])) < 4.5 * said).all()
        assert (said[[0, 1]] < 0.3).all() and said[5] < 0.008
    assert found.left[0] < 0.08 and 0.03 < found.left[2] < 0.3


def test_the_mapping_says_its_format_and_is_whole() -> None:
    found = solved()
    assert found.hand_eye is not None
    said = found.hand_eye.to_mapping()
    assert said["format"] == "tactape-hand-eye/1" and np.shape(said["covariance"]) == (12, 12)
    assert found.to_mapping()["hand_eye"]["tape"] == TAPE.name


def test_how_flange_and_base_are_named_does_not_change_the_covariance() -> None:
    poses = arm_poses(presses().poses, 0.05)
    flange = matrix_of(np.array([10.0, 20.0, 30.0, *Rotation.from_euler("xyz", [90, 20, 100], degrees=True).as_rotvec()]))
    base = matrix_of(np.array([-100.0, 50.0, 30.0, *Rotation.from_euler("xyz", [170, 20, -40], degrees=True).as_rotvec()]))
    other = [ArmPose(frame=p.frame, flange_to_base=base @ p.flange_to_base @ np.linalg.inv(flange)) for p in poses]
    found, again = solved_again(poses), solved_again(other)
    assert again.sensor_to_flange == pytest.approx(flange @ found.sensor_to_flange, abs=1e-3)
    # in the sensor's own frame and the tape's own: both are where they were
    sigma = np.sqrt(np.diag(found.covariance))
    assert (again.covariance - found.covariance) / np.outer(sigma, sigma) == pytest.approx(0.0, abs=0.01)


def test_a_tape_that_is_not_flat_is_named() -> None:
    assert not any("not flat" in remark for remark in solved_again(arm_poses(presses().poses, 0.05)).remarks)
    (remark,) = solved_again(arm_poses(presses().poses, 0.2)).remarks
    assert "deg (rms), as on a tape that is not flat" in remark


@pytest.mark.parametrize("radius_mm", [200.0, -200.0, None])
def test_a_tape_that_is_gently_round_is_named(radius_mm: float | None) -> None:
    """The reach was off by up to four standard deviations at 200 mm, and nothing said so."""
    along = presses().poses[:, 0] - presses().poses[:, 0].mean()
    # from each place on the flat tape to that on the round one, in the board's frame
    angles = np.zeros_like(along) if radius_mm is None else along / radius_mm
    poses = []
    for pose, at, angle in zip(arm_poses(presses().poses), along, angles, strict=True):
        moved = [radius_mm * np.sin(angle) - at, 0.0, radius_mm * (np.cos(angle) - 1.0)] if radius_mm else [0.0, 0.0, 0.0]
        there = np.array(TAPE.board.texture_origin_mm)[0] + presses().poses[:, 0].mean() + at
        at_place = matrix_of(np.array([there, 0.0, 0.0, 0.0, 0.0, 0.0]))
        bent = matrix_of(np.array([*moved, 0.0, 0.0, 0.0])) @ at_place @ matrix_of(np.array([0.0, 0.0, 0.0, 0.0, angle, 0.0]))
        on_it = IN_BASE @ bent @ np.linalg.inv(at_place) @ np.linalg.inv(IN_BASE)
        poses.append(replace(pose, flange_to_base=on_it @ pose.flange_to_base))
    said = [float(re.findall(r"radius of some (\S+) mm", remark)[0]) for remark in solved_again(poses).remarks]
    assert said == ([] if radius_mm is None else [pytest.approx(200.0, rel=0.15)])


def test_a_flange_that_never_tilts_leaves_the_reach_open() -> None:
    found = solved_again(arm_poses(presses().poses, 0.0))
    assert any("how far the sensor reaches out" in remark for remark in found.remarks)
    off = np.linalg.inv(ON_FLANGE) @ found.sensor_to_flange
    assert np.abs(off[:2, 3]).max() < 0.2


@slow
@pytest.mark.parametrize("tilt_rad", [0.0, 0.0015])
def test_tilts_that_are_the_arm_s_own_errors_do_not_tell_the_reach(tilt_rad: float) -> None:
    """They draw it to the flange, by all of its 80 mm or some of them, and leave nothing over."""
    squares = []
    for seed in range(4):
        rng, made = np.random.default_rng(100 + seed), arm_poses(presses().poses, tilt_rad, seed)
        errors = [matrix_of(np.array([0.0, 0.0, 0.0, *rng.normal(0.0, np.radians(made[0].sigma_deg), 3)])) for _ in made]
        found = solved_again([replace(p, flange_to_base=p.flange_to_base @ e) for p, e in zip(made, errors, strict=True)])
        off_mm = (np.linalg.inv(ON_FLANGE) @ found.sensor_to_flange)[2, 3]
        squares.append(off_mm**2 / found.covariance[2, 2])
    assert np.mean(squares) < 2.5


def test_errors_of_arm_and_gel_are_told_by_what_the_unknowns_leave_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two transforms take twelve of all rows, not alike of each kind: what a kind has left, and two less, says its variance."""
    solved_from()  # once, before solves are looked at
    solves, solved_once = [], _Joint.solved

    def solve(joint: _Joint, z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        solves.append((joint.sigmas, solved_once(joint, z)))
        return solves[-1][1]

    monkeypatch.setattr(_Joint, "solved", solve)
    solved_again(arm_poses(presses().poses)[:7])
    for (_, (_, left, freedom, _)), (sigmas, _) in pairwise(solves):
        assert freedom.sum() == pytest.approx(6 * 7 - 12, abs=0.5)  # x, y and turn of a press are known far better
        assert (freedom < 6.5).all() and freedom.min() < 4.5
        assert sigmas == pytest.approx(np.sqrt((left**2).sum(axis=0) / np.maximum(freedom - 2.0, 1.0)))


@only_thorough
@pytest.mark.parametrize("count", [6, 7, 10])
def test_both_transforms_are_off_as_far_as_is_said(count: int) -> None:
    squares = []
    for seed in range(16):
        found = solved_again(arm_poses(presses().poses, seed=seed)[:count])
        off = []
        for answer, truth in ((found.sensor_to_flange, ON_FLANGE), (found.tape_to_base, IN_BASE)):
            change = np.linalg.inv(truth) @ answer
            off += [*change[:3, 3], *Rotation.from_matrix(change[:3, :3]).as_rotvec()]
        squares.append(float(np.array(off) @ np.linalg.solve(found.covariance, np.array(off))) / 12)
    assert 0.6 < np.mean(squares) < 1.5


@pytest.mark.parametrize("name", [TAPE.name, "another"])
def test_a_texture_that_lies_elsewhere_on_another_board_is_refused(name: str) -> None:
    bundle, seen, tapes = solved_from()[1]
    x, y = TAPE.board.texture_origin_mm
    other = replace(TAPE, name=name, board=replace(TAPE.board, texture_origin_mm=(x + 5.0, y)))
    poses = arm_poses(presses().poses)
    with pytest.raises(SpecError, match="give only that one"):
        find_hand_eye(bundle, seen, [*tapes, other], poses)
    assert find_hand_eye(bundle, seen, [*tapes, replace(TAPE, name=name)], poses).tape == TAPE.name


def test_few_poses_are_refused() -> None:
    """Five were taken: squared errors were several times those of the covariance."""
    with pytest.raises(SpecError, match="5 of 10 presses have a pose of the flange, and 6 on one flat tape are needed"):
        solved_again(arm_poses(presses().poses)[:5])
    assert solved_again(arm_poses(presses().poses)[:6]).frames == tuple(range(6))


@costly
@pytest.mark.parametrize("wrong", ["in metres", "of other frames"])
def test_poses_that_do_not_fit_the_presses_are_refused(wrong: str) -> None:
    poses = arm_poses(presses().poses)
    matrices = [pose.flange_to_base.copy() for pose in poses]
    if wrong == "in metres":
        for matrix in matrices:
            matrix[:3, 3] /= 1000.0
    else:
        matrices = matrices[3:] + matrices[:3]
    said = (
        r"and taken with x, y, z in m 0\.0\d+ mm along it"
        if wrong == "in metres"
        else "more than 1 mm along it, 3 mm of height or"
    )
    with pytest.raises(SpecError, match=rf"do not fit the presses: .* are left over on the tape \(rms\), {said}"):
        changed = [ArmPose(frame=pose.frame, flange_to_base=matrix) for pose, matrix in zip(poses, matrices, strict=True)]
        solved_again(changed)


def test_poses_whose_heights_are_of_no_plane_are_refused() -> None:
    """As those of another convention have them, where x, y and turns are as exact as of right ones."""
    for height_mm, fits in ((2.5, True), (4.0, False)):
        poses = []
        for pose, sign in zip(arm_poses(presses().poses), np.resize((1.0, -1.0, -1.0, 1.0, 1.0), 10), strict=True):
            up = matrix_of(np.array([0.0, 0.0, sign * height_mm, 0.0, 0.0, 0.0]))
            poses.append(replace(pose, flange_to_base=pose.flange_to_base @ ON_FLANGE @ up @ np.linalg.inv(ON_FLANGE)))
        if fits:
            assert 1.5 < solved_again(poses).left[2] < 3.0
        else:
            with pytest.raises(SpecError, match=r"3\.\d mm of height .* are left over .*, 3 mm of height or .* on a plane"):
                solved_again(poses)


@pytest.mark.parametrize(
    ("left", "fits"),
    [
        ((1.0, 1.0, 3.0, 9.0, 9.0, 0.1), True),
        ((1.01, 0.0, 0.0, 0.0, 0.0, 0.0), False),
        ((0.0, 1.01, 0.0, 0.0, 0.0, 0.0), False),
        ((0.0, 0.0, 3.01, 0.0, 0.0, 0.0), False),
        ((0.0, 0.0, 0.0, 0.0, 0.0, 0.101), False),
    ],
)
def test_another_convention_counts_if_it_fits(left: tuple[float, ...], fits: bool) -> None:
    assert _fits(np.array(left)) == fits
    other = Convention(words="upside down", as_read=np.array([0.2, 0.5, 1.5, 0.0, 0.0, 0.05]), left=np.array(left))
    _refuse_convention(None)
    if not fits:
        _refuse_convention(other)
        return
    with pytest.raises(
        SpecError, match=r"0\.5 mm along it, 1\.5 mm of height and 2\.9 deg are .* taken upside down 1 mm along it, 3 mm"
    ):
        _refuse_convention(other)


def test_poses_of_another_convention_that_fit_are_refused_with_its_name() -> None:
    poses = [replace(p, flange_to_base=np.asarray(np.linalg.inv(p.flange_to_base))) for p in arm_poses(presses().poses)]
    with pytest.raises(SpecError, match="taken as the base in the flange, the inverse 0"):
        solved_again(poses)


@costly
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_poses_of_a_mirrored_base_are_named(axis: int) -> None:
    """They fit as exactly as the true ones: only that the sensor looks back to the flange gives them away."""
    mirror = np.diag([-1.0 if k == axis else 1.0 for k in range(4)])
    poses = arm_poses(presses().poses, 0.05)
    found, mirrored = (
        solved_again([replace(p, flange_to_base=by @ p.flange_to_base @ by) for p in poses]) for by in (np.eye(4), mirror)
    )
    assert mirrored.left == pytest.approx(found.left, rel=0.01)
    said = [[remark for remark in one.remarks if "right-handed" in remark] for one in (found, mirrored)]
    assert said[0] == [] and len(said[1]) == 1 and "80 mm beyond the tape" in said[1][0]


def test_a_tape_that_faces_down_is_named_where_the_reach_is_open() -> None:
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    poses = arm_poses(presses().poses, 0.0)
    assert not any("right-handed" in remark for remark in solved_again(poses).remarks)
    mirrored = solved_again([replace(p, flange_to_base=mirror @ p.flange_to_base @ mirror) for p in poses])
    assert sum("the tape faces down in the base" in remark for remark in mirrored.remarks) == 1


def off_by(frame: int, *motion: float) -> list[ArmPose]:
    """Poses of the arm, that of a frame moved in the sensor's frame: mm and rad."""
    poses = arm_poses(presses().poses)
    moved = poses[frame].flange_to_base @ ON_FLANGE @ matrix_of(np.array(motion)) @ np.linalg.inv(ON_FLANGE)
    return [replace(p, flange_to_base=moved) if p.frame == frame else p for p in poses]


@costly
@pytest.mark.parametrize("motion", [(2.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.1)])
def test_a_pose_that_all_others_contradict_is_left_out_and_named(motion: tuple[float, ...]) -> None:
    found = solved_again(off_by(4, *motion))
    assert found.frames == (0, 1, 2, 3, 5, 6, 7, 8, 9)
    assert sum("the pose of frame 4 is left out" in remark for remark in found.remarks) == 1
    assert found.left[:2].max() < 0.08


def test_a_pose_tilted_too_far_does_not_say_how_far_the_sensor_reaches() -> None:
    """It decides that, as others hardly tilt, and so it is they that do not fit."""
    poses = arm_poses(presses().poses)
    tilt = matrix_of(np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0]))
    found = solved_again([replace(p, flange_to_base=p.flange_to_base @ tilt) if p.frame == 4 else p for p in poses])
    assert 4 not in found.frames
    off_mm = (np.linalg.inv(ON_FLANGE) @ found.sensor_to_flange)[2, 3]
    assert abs(off_mm) < 4.0 * np.sqrt(found.covariance[2, 2]) < 10.0


@costly
@pytest.mark.parametrize("frames", [(7, 6), (5, 0)])
def test_two_poses_that_hide_each_other_are_left_out(frames: tuple[int, int]) -> None:
    """The flange's frame was turned at both, by 4 deg as of a loose tool: with them the reach is 40 mm off and more."""
    turn = matrix_of(np.array([0.0, 0.0, 0.0, 0.06, -0.03, 0.0]))
    poses = [
        replace(p, flange_to_base=p.flange_to_base @ turn) if p.frame in frames else p for p in arm_poses(presses().poses, 0.05)
    ]
    found = solved_again(poses)
    assert found.frames == tuple(k for k in range(10) if k not in frames)
    off_mm = (np.linalg.inv(ON_FLANGE) @ found.sensor_to_flange)[2, 3]
    assert abs(off_mm) < 4.0 * np.sqrt(found.covariance[2, 2]) < 4.0


def test_a_press_that_was_tilted_on_purpose_is_kept() -> None:
    """How a press is tilted is not in its pose on the tape: a single tilted one says how far the sensor reaches."""
    assert solved_again(off_by(4, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0)).frames == tuple(range(10))


# By hand


def test_a_normal_matrix_is_inverted_or_named_as_singular() -> None:
    rates = np.random.default_rng(3).normal(size=(30, 5)) * (1e3, 1.0, 1e-3, 1.0, 1.0)
    assert _inverse(rates.T @ rates) == pytest.approx(np.linalg.inv(rates.T @ rates), rel=1e-6)
    rates[:, 3] = rates[:, 4]
    with pytest.raises(SpecError, match="they are all the same, or nearly; give the pose at each"):
        _inverse(rates.T @ rates)
    nearly = np.diag([1.0, 1.0]) + (1.0 - 1e-12) * (1.0 - np.eye(2))
    assert np.diag(_inverse(nearly)) == pytest.approx(5e11, rel=1e-3)


@pytest.mark.parametrize(
    ("theta_deg", "u", "v"), [(0.0, (1, 0), (0, -1)), (90.0, (0, 1), (1, 0)), (30.0, (0.866, 0.5), (0.5, -0.866))]
)
def test_a_sensor_on_the_tape_looks_into_it(theta_deg: float, u: tuple[float, float], v: tuple[float, float]) -> None:
    """Turned counter-clockwise seen from above, on a board whose y axis is up where that of the texture is down."""
    there = on_tape(np.array([10.0, 4.0, np.radians(theta_deg)]), np.array([3.0, 50.0]))
    expected = np.array([[u[0], v[0], 0.0, 13.0], [u[1], v[1], 0.0, 46.0], [0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    assert there == pytest.approx(expected, abs=1e-3)


BOTH = np.array([5.0, -3.0, 80.0, 0.1, -0.2, 0.5, 400.0, 100.0, 20.0, 0.05, 0.1, -1.2])
SEEN = np.array(
    [[10.0, 4.0, 0.3], [40.0, 30.0, -2.0], [70.0, 12.0, 1.4], [25.0, 22.0, 3.0], [55.0, 8.0, -0.7], [33.0, 41.0, 2.2]]
)
ORIGIN = np.array([3.0, 50.0])


def flanges(off: FloatArray, both: FloatArray = BOTH) -> FloatArray:
    """Poses of the flange at which the sensor is off by some motions from where it is seen, in its own frame."""
    there = on_tape(SEEN[: len(off)], ORIGIN) @ matrix_of(off)
    return np.asarray(matrix_of(both[6:]) @ there @ np.linalg.inv(matrix_of(both[:6])))


def test_misfits_are_motions_in_the_sensor_s_frame() -> None:
    off = np.array([[0.1, -0.2, 0.3, 0.01, 0.02, -0.03], [0.0] * 6, [1.0, 2.0, 3.0, 0.3, -0.2, 0.4]])
    assert misfits(flanges(off), SEEN[:3], ORIGIN, BOTH) == pytest.approx(off, abs=1e-9)
    several = misfits(flanges(off), np.stack([SEEN[:3], SEEN[:3]]), ORIGIN, np.stack([BOTH, BOTH]))
    assert several == pytest.approx(np.stack([off, off]), abs=1e-9)


@pytest.mark.parametrize("turn", [(0.1, -0.2, 0.5), (3.0, 0.5, 0.0), (0.0, 0.0, 0.0)])
def test_small_changes_of_a_transform_are_motions_in_its_own_frame(turn: tuple[float, float, float]) -> None:
    values = np.array([5.0, -3.0, 80.0, *turn])
    motion = _own_motion(values)
    for change in 1e-5 * np.array([[1, 0, 0, 0, 0, 0], [0, 2, 1, 0, 0, 0], [0, 0, 0, 1, 0, 0], [1, -1, 2, 1, 2, -3]]):
        moved = np.linalg.inv(matrix_of(values)) @ matrix_of(values + change)
        assert moved == pytest.approx(matrix_of(motion @ change), abs=1e-8)


@pytest.mark.parametrize("flip", [0.0, np.pi])
def test_both_transforms_are_found_roughly_from_any_start(flip: float) -> None:
    """Tilted presses leave nothing open; the search may end whole turns away, which is the same turn."""
    off = np.zeros((6, 6))
    off[:, 3:5] = np.array([[0.2, 0.0], [0.0, 0.2], [-0.2, 0.1], [0.1, -0.2], [-0.1, -0.1], [0.15, 0.15]])
    both = BOTH.copy()
    both[3:6] = Rotation.from_matrix(matrix_of(BOTH[:6])[:3, :3] @ Rotation.from_rotvec([flip, 0.0, 0.0]).as_matrix()).as_rotvec()
    found = _first(flanges(off, both), SEEN, ORIGIN)
    assert matrix_of(found[:6]) == pytest.approx(matrix_of(both[:6]), abs=4.0)
    assert Rotation.from_matrix(matrix_of(found[:6])[:3, :3] @ matrix_of(both[:6])[:3, :3].T).magnitude() < 0.1
    assert np.linalg.norm(found[3:6]) <= np.pi + 1e-9 and np.linalg.norm(found[9:12]) <= np.pi + 1e-9


@pytest.mark.parametrize(
    ("arm_rad", "drawn_mm"),
    # shares 2 arm^2 / (2 0.02^2) of 0, 1/4, 0.49 and 1/2
    [(0.0, 0.0), (0.01, 80.0 / 3.0), (0.014, 80.0 * 0.49 / 0.51), (0.0142, FAR_MM)],
)
def test_the_reach_is_drawn_by_the_arm_s_share_of_the_tilts(arm_rad: float, drawn_mm: float) -> None:
    left = np.array([9.0, 9.0, 9.0, 0.02, 0.02, 9.0])
    for turn in ((0.0, 0.0, 0.0), (np.pi, 0.0, 0.0), (0.0, 0.4, 0.0)):
        place = matrix_of(np.array([0.0, 0.0, 0.0, *turn]))[:3, :3] @ (4.0, 5.0, 80.0)
        found = _drawn(matrix_of(np.array([*place, *turn])), left, np.full(7, arm_rad))
        along = np.zeros(12)
        along[[2, 8]] = drawn_mm, -drawn_mm
        assert found == pytest.approx(np.outer(along, along), rel=1e-6)


def placed(reach_mm: float, down: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """A sensor that looks away from the flange, which is so far behind it, and a tape whose normal has such a z in the base."""
    sensor, tape = np.eye(4), np.eye(4)
    sensor[:3, 3], tape[2, 2] = (4.0, 5.0, reach_mm), down
    return sensor, tape


@pytest.mark.parametrize(
    ("reach_mm", "down", "sigma_mm", "words"),
    [
        (80.0, 1.0, 0.1, None),
        (
            -80.0,
            1.0,
            0.1,
            "the flange is 80 mm beyond the tape, on the side to which the sensor looks; .* unless the sensor does",
        ),
        (-9.9, 1.0, 0.1, None),
        (-10.1, 1.0, 0.1, "the flange is 10 mm beyond"),
        (-29.0, 1.0, 10.0, None),
        (-31.0, 1.0, 10.0, "the flange is 31 mm beyond"),
        (80.0, -0.69, 6.0, None),
        (80.0, -0.71, 6.0, "the tape faces down in the base, against its z axis; .* unless it does"),
        (80.0, -1.0, 4.9, None),
    ],
)
def test_a_mirrored_base_is_named_by_where_the_flange_is(
    reach_mm: float, down: float, sigma_mm: float, words: str | None
) -> None:
    covariance = np.diag([9.0, 9.0, sigma_mm**2, *[9.0] * 9])
    remarks = _mirrored(*placed(reach_mm, down), covariance)
    assert len(remarks) == (words is not None)
    assert words is None or re.search(words, remarks[0])


@pytest.mark.parametrize(("across", "radius_mm"), [((1.0, 0.0), 200.0), ((0.0, 1.0), -150.0), ((0.6, 0.8), 300.0), (None, None)])
def test_tilts_that_grow_with_the_place_are_those_of_a_radius(
    across: tuple[float, float] | None, radius_mm: float | None
) -> None:
    rng = np.random.default_rng(4)
    poses = np.column_stack([rng.uniform((0.0, 0.0), (90.0, 45.0), (30, 2)), rng.uniform(-3.0, 3.0, 30)])
    noise = 0.002 * rng.standard_normal((30, 2))
    left = np.zeros((30, 6))
    for k, (x, y, theta) in enumerate(poses):
        turn = np.array([0.01, -0.02, 0.0])  # all alike: the board's own tilt
        if across is not None and radius_mm is not None:
            s = across[0] * (x - 45.0) - across[1] * (y - 22.0)  # along the bend, on the board, whose y is up
            turn = turn + np.array([-across[1], across[0], 0.0]) * s / radius_mm
        own = on_tape(np.array([x, y, theta]), np.zeros(3))[:3, :3].T @ turn
        left[k, 3:5] = own[:2] + noise[k]
    found = _radius_mm(poses, left)
    assert found is None if radius_mm is None else found == pytest.approx(abs(radius_mm), rel=0.05)


@pytest.mark.parametrize(
    ("at", "sigma", "words"),
    [
        (0, OBSERVED_MM, None),
        (1, OBSERVED_MM * 1.01, "where the sensor is on the flange is open: turn the sensor between presses"),
        (2, OBSERVED_MM, None),
        (2, OBSERVED_MM * 1.01, "how far the sensor reaches out from the flange is open"),
        (5, OBSERVED_RAD, None),
        (5, OBSERVED_RAD * 1.01, "where the sensor is on the flange is open"),
        (3, 1.0, None),
    ],
)
def test_what_poses_leave_open_is_said(at: int, sigma: float, words: str | None) -> None:
    sigmas = np.full(12, 0.01)
    sigmas[at] = sigma
    remarks = _remarks(np.diag(sigmas**2), np.zeros(6), None)
    assert len(remarks) == (words is not None) and all(words in remark for remark in remarks if words)


@pytest.mark.parametrize(
    ("tilts_rad", "radius_mm", "words"),
    [
        ((0.1, 0.1), None, None),
        ((0.02, 0.11), None, "tilted by 6.3 deg (rms), as on a tape that is not flat"),
        ((0.11, 0.02), 200.0, "tilted by 6.3 deg (rms), as on a tape that is not flat"),
        ((0.1, 0.1), 199.7, "as on a tape bent with a radius of some 200 mm"),
    ],
)
def test_tilts_of_a_tape_that_is_not_flat_are_said(
    tilts_rad: tuple[float, float], radius_mm: float | None, words: str | None
) -> None:
    remarks = _remarks(np.diag(np.full(12, 1e-4)), np.array([9.0, 9.0, 9.0, *tilts_rad, 9.0]), radius_mm)
    assert len(remarks) == (words is not None) and all(words in remark for remark in remarks if words)


def test_standard_deviations_of_the_answer_are_those_of_its_covariance() -> None:
    sigma = np.arange(1.0, 13.0)
    made = HandEye(
        sensor_to_flange=ON_FLANGE,
        tape_to_base=IN_BASE,
        covariance=np.diag(sigma**2),
        tape="t",
        frames=(1, 2),
        left=np.ones(6),
        remarks=("r",),
    )
    said = made.to_mapping()
    assert said["sensor_to_flange_sigma"] == sigma[:6].tolist() and said["tape_to_base_sigma"] == sigma[6:].tolist()
    assert np.array_equal(said["sensor_to_flange"], ON_FLANGE) and np.array_equal(said["tape_to_base"], IN_BASE)
    assert (said["tape"], said["frames"], said["left"], said["remarks"]) == ("t", [1, 2], [1.0] * 6, ["r"])
