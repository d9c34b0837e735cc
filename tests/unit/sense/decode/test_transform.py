"""The pose as a matrix and its covariance, against the signs of the contract: every frame's own, and rotations from matrices."""

from __future__ import annotations

from dataclasses import replace
from math import cos, inf, radians, sin

import numpy as np
import pytest

from tactape_fab import Localization, SpecError, Tape, texture_to_board
from tactape_fab.sense import Mount, sensor_on_object
from tests.contacts import TAPE

COVARIANCE = np.array([(4e-4, 1e-4, -2e-5), (1e-4, 9e-4, 3e-5), (-2e-5, 3e-5, 1e-5)])
PX_PER_MM = 16.0
P0 = np.array([159.5, 119.5])
POSES = [((20.0, 12.0), 30.0), ((3.2, -1.5), -101.0), ((0.0, 0.0), 180.0)]


def fix_at(position_mm: tuple[float, float], theta_deg: float, tape: Tape = TAPE) -> Localization:
    x, y = texture_to_board(position_mm, tape.board.texture_origin_mm).tolist()
    return Localization(
        status="solid",
        located=True,
        tape=tape.name,
        position_mm=position_mm,
        theta_deg=theta_deg,
        board_mm=(x, y),
        covariance=COVARIANCE,
    )


def texture_of_pixel(p: np.ndarray, position_mm: tuple[float, float], theta_deg: float) -> np.ndarray:
    """The contract's T = S + (1/R) [[cos, sin], [-sin, cos]] (p - p0)."""
    c, s = cos(radians(theta_deg)), sin(radians(theta_deg))
    seen: np.ndarray = np.array(position_mm) + np.array([(c, s), (-s, c)]) @ (p - P0) / PX_PER_MM
    return seen


def matrix_of(fix: Localization, frame: str) -> np.ndarray:
    matrix = fix.transform(frame)
    assert matrix is not None and matrix.shape == (4, 4)
    return matrix


@pytest.mark.parametrize(("position_mm", "theta_deg"), POSES)
@pytest.mark.parametrize("frame", ["texture", "board"])
def test_a_pixel_is_where_the_contract_has_it(frame: str, position_mm: tuple[float, float], theta_deg: float) -> None:
    matrix = matrix_of(fix_at(position_mm, theta_deg), frame)
    for pixel in np.array([P0, (175.5, 119.5), (159.5, 135.5), (3.0, 200.0)]):
        there = texture_of_pixel(pixel, position_mm, theta_deg)
        if frame == "board":
            there = texture_to_board(there, TAPE.board.texture_origin_mm)
        assert matrix @ (*(pixel - P0) / PX_PER_MM, 0.0, 1.0) == pytest.approx([*there, 0.0, 1.0], abs=1e-12)


def test_the_worked_example_of_the_contract() -> None:
    matrix = matrix_of(fix_at((20.0, 12.0), 30.0), "texture")
    assert matrix @ (1.0, 0.0, 0.0, 1.0) == pytest.approx((20 + cos(radians(30)), 12 - sin(radians(30)), 0.0, 1.0))


@pytest.mark.parametrize("frame", ["texture", "board"])
@pytest.mark.parametrize("theta_deg", [0.0, 30.0, -150.0])
def test_it_is_a_rotation_whose_last_axis_points_into_the_tape(frame: str, theta_deg: float) -> None:
    turn = matrix_of(fix_at((1.0, 2.0), theta_deg), frame)[:3, :3]
    assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    assert turn[:, 2].tolist() == [0.0, 0.0, -1.0 if frame == "board" else 1.0]


def test_the_frames_differ_by_what_lies_between_them() -> None:
    fix = fix_at((20.0, 12.0), 30.0)
    between = np.diag([1.0, -1.0, -1.0, 1.0])
    between[:2, 3] = TAPE.board.texture_origin_mm
    assert matrix_of(fix, "board") == pytest.approx(between @ matrix_of(fix, "texture"), abs=1e-12)


def test_an_object_s_is_the_board_s_through_its_mount() -> None:
    turn = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
    mount = Mount(surface="plane", rotation=turn, position_mm=np.array([5.0, 6.0, 7.0]))
    on_object = np.eye(4)
    on_object[:3, :3], on_object[:3, 3] = turn, (5.0, 6.0, 7.0)
    pose = sensor_on_object("cup", mount, TAPE, np.array([20.0, 12.0]), 30.0)
    assert pose.transform() == pytest.approx(on_object @ matrix_of(fix_at((20.0, 12.0), 30.0), "board"), abs=1e-9)


@pytest.mark.parametrize(("position_mm", "theta_deg"), POSES)
@pytest.mark.parametrize("frame", ["texture", "board"])
def test_the_covariance_is_that_of_the_matrix(frame: str, position_mm: tuple[float, float], theta_deg: float) -> None:
    """Carried over by the difference quotient of `transform` itself: where its origin and its axes go when x, y, theta do."""
    step = 1e-6
    here = matrix_of(fix_at(position_mm, theta_deg), frame)
    columns = []
    for dx, dy, dtheta in np.eye(3) * step:
        moved = fix_at((position_mm[0] + dx, position_mm[1] + dy), theta_deg + np.degrees(dtheta))
        there = matrix_of(moved, frame)
        turn = (there[:3, :3] @ here[:3, :3].T - np.eye(3)) / step  # [w]x of a small turn w about the frame's axes
        columns.append([*(there[:3, 3] - here[:3, 3]) / step, turn[2, 1], turn[0, 2], turn[1, 0]])
    jacobian = np.array(columns).T
    expected = jacobian @ COVARIANCE @ jacobian.T
    found = fix_at(position_mm, theta_deg).covariance6(frame)
    assert found is not None and found.shape == (6, 6)
    known = [0, 1, 5]
    assert found[np.ix_(known, known)] == pytest.approx(expected[np.ix_(known, known)], rel=1e-4, abs=1e-9)


def test_signs_of_the_covariance() -> None:
    board, texture = (fix_at((20.0, 12.0), 30.0).covariance6(frame) for frame in ("board", "texture"))
    assert board is not None and texture is not None
    assert (board[0, 1], board[0, 5], board[1, 5]) == (-1e-4, -2e-5, -3e-5)  # board y is up; counter-clockwise is about +z
    assert (texture[0, 1], texture[0, 5], texture[1, 5]) == (1e-4, 2e-5, -3e-5)  # the texture's z points into the tape


def test_what_a_contact_does_not_tell_is_unknown() -> None:
    found = fix_at((20.0, 12.0), 30.0).covariance6("board")
    assert found is not None
    assert np.diag(found)[2:5].tolist() == [inf, inf, inf]
    assert not np.isnan(found).any() and (found == found.T).all()


def test_nothing_is_given_where_nothing_is_known() -> None:
    fix = fix_at((20.0, 12.0), 30.0)
    assert fix.covariance is not None
    lost = Localization(status="none", located=False, reason="no dots")
    bare = replace(fix, position_mm=None, board_mm=None, plane_mm=(1.0, 2.0))
    for none in (lost, replace(fix, located=False), bare):
        assert [none.transform("texture"), none.transform("board"), none.covariance6("board")] == [None, None, None]
    on_a_part = replace(fix, board_mm=None)
    assert on_a_part.transform("texture") is not None and on_a_part.covariance6("texture") is not None
    assert on_a_part.transform("board") is None and on_a_part.covariance6("board") is None
    by_paper = replace(fix, covariance=None)
    assert by_paper.transform() is not None and by_paper.covariance6() is None


@pytest.mark.parametrize("frame", ["object", "Board", "", None])
@pytest.mark.parametrize("name", ["transform", "covariance6"])
def test_another_frame_is_refused(name: str, frame: object) -> None:
    with pytest.raises(SpecError, match=r"is neither 'board' nor 'texture'; .*read_object\(FILE\)\.locate\(fix\)\.transform\(\)"):
        getattr(fix_at((20.0, 12.0), 30.0), name)(frame)


def test_a_mapping_needs_no_frame_number() -> None:
    fix = fix_at((20.0, 12.0), 30.0)
    assert "frame" not in fix.to_mapping()
    assert fix.to_mapping(3) == {"frame": 3, **fix.to_mapping()}
    assert next(iter(fix.to_mapping(0))) == "frame"
