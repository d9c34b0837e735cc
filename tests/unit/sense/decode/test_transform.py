"""The pose as a matrix and its covariance, against the signs of the contract: every frame's own, and rotations from matrices."""

from __future__ import annotations

from dataclasses import replace
from math import cos, inf, radians, sin
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab import Localization, SpecError, Tape, texture_to_board
from tactape_fab.sense import LocatedDots, Mount, sensor_on_object
from tactape_fab.sense.decode.result import SOLID_DOTS, state_of, status_of, surface_of
from tactape_fab.sense.decode.space import Surface, pose_covariance, texture_plane
from tactape_fab.texture.frames import FloatArray
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


# What a contact says, put together by hand: every number is another

RISE = np.array([0.7, 0.02, -0.03])
OF_RISE = np.array([(4e-4, 1e-5, 2e-5), (1e-5, 9e-6, 3e-6), (2e-5, 3e-6, 16e-6)])
TILT = (np.array([radians(3.0), radians(-2.0)]), np.array([(5e-6, 1e-6), (1e-6, 7e-6)]))


def pressed(**said: object) -> Any:
    """A contact that says so much; nothing else."""
    nothing: dict[str, object] = {"plane": None, "tilt": None, "indentation": None, "force": (None, None), "ahead": None}
    return SimpleNamespace(**nothing | said)


PLANE = SimpleNamespace(rise=RISE, covariance=OF_RISE)
TOUCHED = replace(fix_at((20.0, 12.0), 30.0), contact=pressed(plane=PLANE, ahead=(0.31, 0.05)))


def test_what_a_contact_says_has_its_own_names() -> None:
    contact = pressed(tilt=TILT, indentation=(0.12, 0.01), force=((4.5, 0.6), (0.9, 0.8)))
    fix = replace(fix_at((20.0, 12.0), 30.0), contact=contact)
    assert fix.tilt_deg == pytest.approx((3.0, -2.0)) and fix.tilt_covariance is TILT[1]
    assert (fix.indentation_mm, fix.indentation_sigma_mm, fix.force_n, fix.force_sigma_n) == (0.12, 0.01, 4.5, 0.6)
    told = fix.to_mapping()
    assert told["tilt_deg"] == pytest.approx((3.0, -2.0)) and told["tilt_covariance"] == TILT[1].tolist()
    names = ("indentation_mm", "indentation_sigma_mm", "force_n", "force_sigma_n")
    assert [told[name] for name in names] == [0.12, 0.01, 4.5, 0.6] and "contact" not in told


@pytest.mark.parametrize("contact", [None, pressed()], ids=["no contact", "a contact that says nothing"])
def test_what_no_contact_says_is_none(contact: Any) -> None:
    fix = replace(fix_at((20.0, 12.0), 30.0), contact=contact)
    assert (fix.tilt_deg, fix.tilt_covariance) == (None, None)
    assert (fix.indentation_mm, fix.indentation_sigma_mm, fix.force_n, fix.force_sigma_n) == (None, None, None, None)
    assert fix.transform(origin="gel") is None and fix.covariance6(origin="gel") is None


def test_a_mapping_has_what_dots_say_if_it_is_asked_for() -> None:
    array = np.arange(6.0).reshape(3, 2)
    flags = np.array([True, False, True])
    said = LocatedDots(uv_px=array, cell=array.astype(np.int64) + 1, symbol=array + 2.0, residual_mm=array + 3.0, inlier=flags)
    fix = replace(fix_at((20.0, 12.0), 30.0), dots=said)
    assert "dots" not in fix.to_mapping()
    assert fix.to_mapping(dots=True) == {
        **fix.to_mapping(),
        "dots": {
            "uv_px": [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]],
            "cell": [[1, 2], [3, 4], [5, 6]],
            "symbol": [[2.0, 3.0], [4.0, 5.0], [6.0, 7.0]],
            "residual_mm": [[3.0, 4.0], [5.0, 6.0], [7.0, 8.0]],
            "inlier": [True, False, True],
        },
    }
    assert replace(fix, dots=None).to_mapping(dots=True)["dots"] is None


def test_the_state_has_slopes_and_the_gel_s_distance_where_the_contact_shows_them() -> None:
    flat = state_of(replace(TOUCHED, contact=None))
    assert flat is not None and flat[1] is not None
    assert flat[0].tolist() == [20.0, 12.0, radians(30.0), 0.0, 0.0, 0.0]
    assert flat[1][:3, :3] == pytest.approx(COVARIANCE)
    assert flat[1][3:, :3].tolist() == [[0.0] * 3] * 3 and flat[1][3:, 3:].tolist() == np.diag([inf, inf, 0.0]).tolist()
    tape = state_of(TOUCHED)
    assert tape is not None and tape[1] is not None
    assert tape[0].tolist() == [20.0, 12.0, radians(30.0), 0.02, -0.03, 0.0]
    assert tape[1][3:, 3:].tolist() == [[9e-6, 3e-6, 0.0], [3e-6, 16e-6, 0.0], [0.0, 0.0, 0.0]]
    gel = state_of(TOUCHED, "gel")
    assert gel is not None and gel[1] is not None
    assert gel[0].tolist() == [20.0, 12.0, radians(30.0), 0.02, -0.03, 0.31]
    assert gel[1][3:, 3:] == pytest.approx(np.array([(9e-6, 3e-6, 1e-5), (3e-6, 16e-6, 2e-5), (1e-5, 2e-5, 0.0025)]))
    assert gel[1][:3, :3] == pytest.approx(COVARIANCE) and not gel[1][3:, :3].any() and not gel[1][:3, 3:].any()


def test_there_is_no_state_without_a_pose() -> None:
    lost = (replace(TOUCHED, located=False), replace(TOUCHED, position_mm=None), replace(TOUCHED, theta_deg=None))
    for fix in lost:
        assert state_of(fix) is None and state_of(fix, "gel") is None
    assert state_of(replace(TOUCHED, contact=pressed(plane=PLANE)), "gel") is None
    assert state_of(replace(TOUCHED, contact=pressed(plane=PLANE))) is not None


def test_there_is_no_surface_of_a_tape_that_is_not_located() -> None:
    for fix in (replace(TOUCHED, located=False), replace(TOUCHED, position_mm=None)):
        assert surface_of(fix, "texture", None) is None and surface_of(fix, "board", None) is None
    assert surface_of(TOUCHED, "texture", None) is texture_plane


def test_an_object_is_asked_where_the_tape_is_and_nothing_of_it_is_certain_but_along_the_normal() -> None:
    asked = []

    class Cup:
        def surface_of(self, fix: Localization) -> Surface | None:
            asked.append(fix)
            return texture_plane

        def mount_covariance(self, fix: Localization, at_mm: FloatArray) -> FloatArray | None:
            return None

    cup = Cup()
    assert surface_of(TOUCHED, "object", cup) is texture_plane and asked == [TOUCHED]
    state = state_of(TOUCHED)
    assert state is not None and state[1] is not None
    expected = pose_covariance(texture_plane, state[0], state[1])
    assert TOUCHED.covariance6("object", on=cup) == pytest.approx(expected) and np.isfinite(expected).all()
    flat = replace(TOUCHED, contact=None)
    found = flat.covariance6("object", on=cup)
    assert found is not None and np.isfinite(np.diag(found)[:3]).all() and found[2, 2] == pytest.approx(0.0, abs=1e-12)
    assert asked == [TOUCHED, TOUCHED, flat]


@pytest.mark.parametrize("frame", ["texture", "board"])
def test_a_tilted_tape_says_nothing_of_the_sensor_s_distance_but_from_the_gel(frame: str) -> None:
    tape, gel = TOUCHED.covariance6(frame), TOUCHED.covariance6(frame, origin="gel")
    assert tape is not None and gel is not None and np.isfinite(gel).all()
    assert tape[2].tolist() == [0.0, 0.0, inf, 0.0, 0.0, 0.0] and tape[:, 2].tolist() == tape[2].tolist()
    assert gel[2, 2] == pytest.approx(0.0025, rel=0.01)
    turns = np.ix_([0, 1, 3, 4, 5], [3, 4, 5])
    assert tape[turns][2:] == pytest.approx(gel[turns][2:]) and (np.diag(tape) > 0.0).all()


def test_objects_and_origins_that_do_not_fit_are_refused() -> None:
    for path in ("box.toml", 3):
        with pytest.raises(SpecError, match=rf"on = {path!r} is no object; give read_object\(FILE\)"):
            TOUCHED.transform("object", on=path)  # type: ignore[arg-type]
    with pytest.raises(SpecError, match="on is for frame = 'object', not 'board'"):
        surface_of(TOUCHED, "board", SimpleNamespace(surface_of=lambda fix: texture_plane))
    with pytest.raises(SpecError, match="origin = 'lens' is neither 'tape' nor 'gel'"):
        TOUCHED.transform(origin="lens")


def test_a_contact_is_solid_from_sixteen_dots() -> None:
    assert [status_of(n) for n in (0, 1, SOLID_DOTS - 1, SOLID_DOTS)] == ["none", "weak", "weak", "solid"]
    assert SOLID_DOTS == 16  # paper, section III-B.2


def test_of_an_answer_only_what_is_said_is_known() -> None:
    bare = Localization(status="none", located=False)
    told = bare.to_mapping()
    assert {key: value for key, value in told.items() if value is not None} == {
        **{"status": "none", "located": False, "n_dots": 0, "n_agree": 0, "elapsed_ms": 0.0}
    }
    assert "contact" not in repr(TOUCHED).replace("contact_mm", "")  # some kilobytes of depths
