"""Poses over tilted tapes, flat and round cylinders: matrices by geometry, covariances by drawing."""

from __future__ import annotations

from dataclasses import replace
from math import cos, degrees, inf, radians, tan
from pathlib import Path

import numpy as np
import pytest

from tactape_fab import Localization, SpecError, TapedObject
from tactape_fab.sense import Mount
from tactape_fab.sense.decode.result import state_of
from tactape_fab.sense.decode.space import Surface, image_pose, pose_covariance, texture_plane
from tactape_fab.sense.objects.mount import texture_surface
from tactape_fab.sense.objects.rigid import from_rpy
from tactape_fab.sense.objects.taped_object import TapeOnObject
from tests.contacts import TAPE
from tests.unit.sense.decode.contact.test_contact import frame_of, located

STATE = np.array([20.0, 12.0, radians(30.0), tan(radians(3.0)), tan(radians(-2.0)), 0.3])
ROUND = Mount(
    surface="cylinder", rotation=from_rpy((20, -35, 50)), position_mm=np.array([3.0, -4.0, 5.0]), top_mm=16.2, true_mm=16.1
)
SURFACES = {"texture": texture_plane, "round": texture_surface(ROUND, TAPE)}
BOX = TapedObject(name="pipe", tapes=(TapeOnObject(kit=Path("kit"), tape=TAPE, mount=ROUND),))


@pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES)
def test_it_is_a_rotation_and_its_inclination_is_the_tilt(surface: Surface) -> None:
    pose = image_pose(surface, STATE)
    assert pose[:3, :3] @ pose[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    into = surface(STATE[:2])[1][:, 2]  # the tape's normal, into it
    assert into @ pose[:3, 2] == pytest.approx(1 / np.sqrt(1 + STATE[3] ** 2 + STATE[4] ** 2))
    point = surface(STATE[:2])[0]
    assert pose[:3, 3] == pytest.approx(point + STATE[5] * pose[:3, 2])


def test_the_tape_rises_towards_the_sensor_where_the_tilt_is_positive() -> None:
    """Points of the tape's plane, as the image's frame has them, are in the plane z = 0 of the texture."""
    pose = image_pose(texture_plane, np.array([*STATE[:5], 0.0]))
    for u, v in [(1.0, 0.0), (0.0, 1.0), (-2.0, 3.0)]:
        on_tape = pose @ (u, v, -(STATE[3] * u + STATE[4] * v), 1.0)
        assert on_tape[2] == pytest.approx(0.0, abs=1e-12)
        ahead = on_tape[:2] - STATE[:2]  # seen foreshortened, so farther on the tape; the turn is theta's but for second order
        c, s = cos(STATE[2]), np.sin(STATE[2])
        assert ahead == pytest.approx(np.array([(c, s), (-s, c)]) @ (u, v), abs=0.006 * np.hypot(u, v))


@pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES)
def test_the_covariance_is_that_of_poses_drawn(surface: Surface) -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(6, 6)) * (0.004, 0.006, 0.002, 0.001, 0.0015, 0.005)
    covariance = root.T @ root / 6
    here, drawn = image_pose(surface, STATE), []
    for state in rng.multivariate_normal(STATE, covariance, 4000):
        there = image_pose(surface, state)
        turn = there[:3, :3] @ here[:3, :3].T
        drawn.append([*(there[:3, 3] - here[:3, 3]), turn[2, 1], turn[0, 2], turn[1, 0]])
    sample = np.cov(np.array(drawn).T)
    found = pose_covariance(surface, STATE, covariance)
    scale = np.sqrt(np.diag(found))
    assert found / np.outer(scale, scale) == pytest.approx(sample / np.outer(scale, scale), abs=0.1)
    assert found == pytest.approx(found.T) and (np.linalg.eigvalsh(found / np.outer(scale, scale)) > -1e-9).all()


def test_what_is_unknown_has_no_covariances() -> None:
    covariance = np.diag([0.004, 0.006, 0.002, inf, inf, 0.005]) ** 2
    found = pose_covariance(texture_plane, np.array([*STATE[:3], 0.0, 0.0, 0.0]), covariance)
    lost = np.isinf(np.diag(found))
    assert lost.any() and not lost.all() and (found[lost] == np.diag(np.diag(found))[lost]).all() and (found == found.T).all()


def test_round_a_cylinder_a_place_that_is_unsure_is_a_direction_that_is() -> None:
    """An error along the circumference turns the pose about the cylinder's axis, by itself over the radius."""
    state, covariance = np.array([20.0, 12.0, 0.0, 0.0, 0.0, 0.0]), np.diag([0.01**2, 0, 0, 0, 0, 0])
    found = pose_covariance(texture_surface(ROUND, TAPE), state, covariance)
    axis = ROUND.rotation[:, 2]
    assert axis @ found[3:, 3:] @ axis == pytest.approx((0.01 / ROUND.true_mm) ** 2, rel=1e-3)
    assert np.trace(found[:3, :3]) == pytest.approx((0.01 * ROUND.top_mm / ROUND.true_mm) ** 2, rel=1e-3)
    assert np.trace(found[3:, 3:]) == pytest.approx((0.01 / ROUND.true_mm) ** 2, rel=1e-3)


def tilted(tilt_deg: tuple[float, float] = (3.0, -2.0)) -> Localization:
    return located(frame_of(2.0, tilt_deg=tilt_deg))


@pytest.mark.parametrize("frame", ["texture", "board"])
def test_a_located_frame_s_pose_has_its_tilt(frame: str) -> None:
    fix = tilted()
    pose, covariance = fix.transform(frame), fix.covariance6(frame)
    assert pose is not None and covariance is not None and fix.tilt_deg is not None
    incline = degrees(np.arccos(abs(pose[2, 2])))
    assert incline == pytest.approx(np.hypot(3.0, 2.0), abs=0.2)
    assert pose[:2, 3] == pytest.approx(fix.position_mm if frame == "texture" else fix.board_mm)
    assert pose[2, 3] == 0.0 and covariance[2, 2] == inf
    rest = np.delete(np.delete(covariance, 2, 0), 2, 1)
    assert np.isfinite(rest).all() and (np.linalg.eigvalsh(rest) > 0).all()
    assert 0.001 < degrees(np.sqrt(covariance[3, 3])) < 0.3


def test_the_gel_s_surface_is_a_sensor_s_own_origin() -> None:
    fix = tilted()
    tape, gel, covariance = fix.transform("board"), fix.transform("board", origin="gel"), fix.covariance6("board", origin="gel")
    assert tape is not None and gel is not None and covariance is not None and fix.contact is not None
    ahead = fix.contact.ahead
    assert ahead is not None and gel[:3, 3] - tape[:3, 3] == pytest.approx(ahead[0] * tape[:3, 2])
    assert np.isfinite(covariance).all() and (np.linalg.eigvalsh(covariance) > 0).all()
    bare = replace(fix, contact=None)
    assert bare.transform("board", origin="gel") is None and bare.covariance6("board", origin="gel") is None


def test_an_object_s_frame_is_that_of_its_mount() -> None:
    fix = tilted()
    pose, covariance, there = fix.transform("object", on=BOX), fix.covariance6("object", on=BOX), BOX.locate(fix)
    assert pose is not None and covariance is not None and there is not None and there.covariance is not None
    assert there.transform() == pytest.approx(pose) and there.covariance == pytest.approx(covariance)
    state = state_of(fix)
    assert state is not None
    assert pose == pytest.approx(image_pose(texture_surface(ROUND, TAPE), state[0]))
    assert np.isfinite(covariance).all()
    outward = pose[:3, 3] - ROUND.position_mm
    outward -= (outward @ ROUND.rotation[:, 2]) * ROUND.rotation[:, 2]
    assert np.linalg.norm(outward) == pytest.approx(ROUND.top_mm)
    elsewhere = replace(fix, sector=9)
    assert elsewhere.transform("object", on=BOX) is None and elsewhere.covariance6("object", on=BOX) is None


def test_turns_that_nothing_shows_stay_unknown_on_an_object() -> None:
    fix = replace(tilted(), contact=None)
    covariance = fix.covariance6("object", on=BOX)
    assert covariance is not None and np.isfinite(np.diag(covariance)[:3]).all()
    assert np.diag(covariance)[3:].tolist() == [inf, inf, inf] and not np.isnan(covariance).any()


def test_frames_objects_and_origins_that_do_not_fit_are_refused() -> None:
    fix = tilted()
    with pytest.raises(SpecError, match=r"on=read_object\(FILE\)"):
        fix.transform("object")
    with pytest.raises(SpecError, match="on is for frame = 'object', not 'board'"):
        fix.covariance6("board", on=BOX)
    with pytest.raises(SpecError, match="origin = 'lens' is neither 'tape' nor 'gel'"):
        fix.transform("board", origin="lens")
