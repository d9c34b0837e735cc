"""object.toml: how tapes lie on an object, what is refused, and fixes in the object's frame."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from math import cos, pi, radians, sin
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest
from click.testing import CliRunner

from tactape_fab import Kit, Localization, Tape, TapeSpec, make_kit, read_object
from tactape_fab.base.errors import SpecError
from tactape_fab.cli import main
from tactape_fab.cli.options import named_object
from tactape_fab.sense.geometry import from_quaternion
from tactape_fab.sense.objects.mount import Mount, sensor_on_object, to_object
from tactape_fab.sense.objects.rigid import fit_rigid, from_rpy, to_quaternion
from tactape_fab.sense.objects.tag_view import tag_corners_mm
from tactape_fab.sense.objects.taped_object import refuse_ambiguous
from tactape_fab.solids.forms import Cylinder, SolidForm
from tactape_fab.solids.wrap import unwrapped
from tactape_fab.texture.frames import FloatArray

PLANE = Mount(surface="plane", rotation=from_rpy((10, 20, 30)), position_mm=np.array([5.0, -3.0, 40.0]))


def cylinder(around: str) -> Mount:
    turn, at = from_rpy((40, -20, 70)), np.array([1.0, 2.0, 3.0])
    return Mount(surface="cylinder", rotation=turn, position_mm=at, top_mm=16.11, true_mm=16.055, around=around)  # type: ignore[arg-type]


# Rotations


def test_roll_pitch_yaw_are_urdf_s() -> None:
    assert from_rpy((90, 0, 0)) @ [0, 1, 0] == pytest.approx([0, 0, 1])
    assert from_rpy((0, 90, 0)) @ [0, 0, 1] == pytest.approx([1, 0, 0])
    assert from_rpy((0, 0, 90)) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    # x first, then z about the fixed axis: y goes to z, and stays there
    assert from_rpy((90, 0, 90)) @ [0, 1, 0] == pytest.approx([0, 0, 1])
    c, s = cos(radians(30)), sin(radians(30))
    assert from_rpy((0, 0, 30.0)) == pytest.approx(np.array([(c, -s, 0), (s, c, 0), (0, 0, 1)]))


@pytest.mark.parametrize("rpy", [(0, 0, 0), (180, 0, 0), (0, 180, 0), (0, 0, 180), (10, -70, 130), (-120, 40, 179)])
def test_quaternions_are_those_of_their_matrices(rpy: tuple[float, float, float]) -> None:
    rotation = from_rpy(rpy)
    quaternion = to_quaternion(rotation)
    assert quaternion[3] >= 0.0 and np.linalg.norm(quaternion) == pytest.approx(1.0)
    assert from_quaternion(quaternion) == pytest.approx(rotation, abs=1e-12)
    assert from_quaternion((0, 0, sin(radians(15)), cos(radians(15)))) == pytest.approx(from_rpy((0, 0, 30.0)))


def test_a_fit_finds_the_motion_and_no_mirror() -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(4, 3))
    turn, shift = from_rpy((30, 60, -100)), np.array([1.0, 2.0, 3.0])
    found, moved, rms = fit_rigid(points, points @ turn.T + shift)
    assert found == pytest.approx(turn) and moved == pytest.approx(shift) and rms == pytest.approx(0.0, abs=1e-12)
    found, _, rms = fit_rigid(points, points * (1, 1, -1))
    assert np.linalg.det(found) == pytest.approx(1.0) and rms > 0.1


# Surfaces


def test_a_cylinder_is_gone_round_as_seen_from_outside() -> None:
    still = Mount(surface="cylinder", rotation=np.eye(3), position_mm=np.zeros(3), top_mm=10.0, true_mm=10.0, around="x")
    quarter = 10.0 * pi / 2
    points, axes = to_object(still, [(0, 0), (quarter, 7), (2 * quarter, 0)])
    assert points == pytest.approx(np.array([(10, 0, 0), (0, 10, 7), (-10, 0, 0)]))
    assert axes[0] == pytest.approx(np.array([(0, 0, 1), (1, 0, 0), (0, 1, 0)]))  # x goes round, y is up, out is x
    points, axes = to_object(replace(still, around="y"), [(0, 0), (7, quarter)])
    assert points == pytest.approx(np.array([(10, 0, 0), (0, 10, -7)]))
    assert axes[1] == pytest.approx(np.array([(0, -1, 0), (0, 0, 1), (-1, 0, 0)]))


@pytest.mark.parametrize("mount", [PLANE, cylinder("x"), cylinder("y")], ids=["plane", "round x", "round y"])
def test_axes_are_the_directions_in_which_points_move(mount: Mount) -> None:
    at, step = np.array([(12.0, 30.0), (70.0, 4.0)]), 1e-5
    points, axes = to_object(mount, at)
    stretch = mount.top_mm / mount.true_mm if mount.surface == "cylinder" else 1.0
    for axis in range(2):
        moved = (to_object(mount, at + step * np.eye(2)[axis])[0] - points) / step
        long = stretch if mount.around == "xy"[axis] else 1.0
        assert moved == pytest.approx(long * axes[:, :, axis], abs=1e-5)
    assert np.linalg.det(axes) == pytest.approx(np.ones(2))  # right-handed: board x, board y, out


def test_a_pixel_is_where_the_sensor_s_pose_has_it(small_kit: Kit) -> None:
    tape, position, theta_deg = small_kit.tape, np.array([6.0, 9.0]), 33.0
    there = sensor_on_object("box", PLANE, tape, position, theta_deg)
    offset = np.array([2.0, -1.0])  # mm in the image: right and up
    c, s = cos(radians(theta_deg)), sin(radians(theta_deg))
    texture = position + np.array([[c, s], [-s, c]]) @ offset  # the contract's pose
    x0, y0 = tape.board.texture_origin_mm
    (seen,), _ = to_object(PLANE, [(x0 + texture[0], y0 - texture[1])])
    by_pose = np.array(there.position_mm) + from_quaternion(there.rotation) @ [*offset, 0.0]
    assert by_pose == pytest.approx(seen)
    into = from_quaternion(there.rotation)[:, 2]
    assert into == pytest.approx(-PLANE.rotation[:, 2])


# Files


def write(folder: Path, kit: Kit, entry: str, more: str = "") -> Path:
    path = folder / "box.toml"
    path.write_text(f'name = "box"\n\n[[tapes]]\nkit = "{kit.path}"\n{entry}\n{more}', encoding="utf-8")
    return path


FLAT = 'surface = "plane"\nposition_mm = [1, 2, 3]\nrpy_deg = [0, 0, 90]'


def test_a_plane_by_its_cad_values(small_kit: Kit, tmp_path: Path) -> None:
    thing = read_object(write(tmp_path, small_kit, FLAT))
    (entry,) = thing.tapes
    assert (thing.name, entry.tape.name, entry.misfit_mm) == ("box", small_kit.tape.name, None)
    assert to_object(entry.mount, [(10, 0)])[0][0] == pytest.approx([1, 12, 3])
    half = 'surface = "plane"\nposition_mm = [1, 2, 3]\nquaternion_xyzw = [0, 0, 0.70710678, 0.70710678]'
    same = read_object(write(tmp_path, small_kit, half)).tapes[0]
    assert same.mount.rotation == pytest.approx(entry.mount.rotation, abs=1e-7)


def test_film_and_adhesive_make_a_cylinder_larger(small_kit: Kit, tmp_path: Path) -> None:
    entry = 'surface = "cylinder"\nradius_mm = 16\nunder_mm = 0.13\naround = "x"\nposition_mm = [0, 0, 0]\nrpy_deg = [0, 0, 0]'
    mount = read_object(write(tmp_path, small_kit, entry)).tapes[0].mount
    assert [mount.top_mm, mount.true_mm] == pytest.approx([16.24, 16.185])


@pytest.mark.parametrize("around", ["x", "y"])
def test_a_print_round_a_cylinder_lies_as_its_model_does(around: Literal["x", "y"], tmp_path: Path) -> None:
    form = {"cylinder_mm": 20.0, "around": around}
    kit = make_kit(TapeSpec(sector=7, part="block", size_mm=(26.0, 24.0), **form), tmp_path / "round", verify=False)  # type: ignore[arg-type]
    mount = read_object(write(tmp_path, kit, FLAT)).tapes[0].mount
    board_mm = np.array([(0.0, 0.0), (4.0, 21.0), (13.0, 12.0), (26.0, 24.0)])
    in_model, axes = to_object(mount, board_mm)
    by_cad = (in_model - (1, 2, 3)) @ from_rpy((0, 0, 90))
    shape = SolidForm(cylinder=Cylinder(radius_mm=20.0, around=around))
    assert unwrapped(by_cad, kit.tape, shape) == pytest.approx(np.column_stack([board_mm, np.zeros(4)]), abs=1e-9)
    assert axes[2] == pytest.approx(from_rpy((0, 0, 90)))
    film = f'surface = "cylinder"\nradius_mm = 20\naround = "{around}"\nposition_mm = [0, 0, 0]\nrpy_deg = [0, 0, 0]'
    with pytest.raises(SpecError, match=r"printed round a cylinder of 20 mm already.*give surface = 'plane'"):
        read_object(write(tmp_path, kit, film))


ROUND = 'surface = "cylinder"\nunder_mm = 0.1\nposition_mm = [0, 0, 0]\nrpy_deg = [0, 0, 0]\n'


@pytest.mark.parametrize("around", ["x", "y"])
def test_a_film_longer_than_the_way_round_is_refused(around: str, small_kit: Kit, tmp_path: Path) -> None:
    board = replace(small_kit.tape.board, size_mm=(31.0, 20.0) if around == "x" else (20.0, 31.0))
    entry: Any = SimpleNamespace(path=small_kit.path, tape=replace(small_kit.tape, board=board))
    # metres typed; and a radius whose 20 mm go round where 31 mm do not: 2 pi (4.775 + 0.1 + 0.055) mm are 30.98 mm
    for radius, says in (("0.016", "or more$"), ("4.775", f"or more, or around = '{'yx'[around == 'y']}' if the side of 20 mm")):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("tactape_fab.sense.objects.taped_object.read_registered", lambda _: [entry])
            with pytest.raises(SpecError) as caught:
                read_object(write(tmp_path, small_kit, f'{ROUND}around = "{around}"\nradius_mm = {radius}'))
            (problem,) = caught.value.problems
            assert problem.key.endswith("tapes[0].radius_mm") and f"radius_mm = {radius} mm: " in problem.message
            assert f"the tape is 31 mm along board {around}; give the object's radius in mm, 4.779 mm or more" in problem.message
            assert re.search(says, problem.message)
            # what is told, typed; and a micrometre less
            (told,) = read_object(write(tmp_path, small_kit, f'{ROUND}around = "{around}"\nradius_mm = 4.779')).tapes
            assert 31.0 <= 2 * pi * told.mount.true_mm < 31.0 + 2 * pi * 0.001
            with pytest.raises(SpecError, match=r"= 4\.778 mm: the way round is 30\.995 mm at"):
                read_object(write(tmp_path, small_kit, f'{ROUND}around = "{around}"\nradius_mm = 4.778'))


@pytest.mark.parametrize("surface", ["plane", "cylinder"])
def test_measured_corners_place_a_tape(small_kit: Kit, tmp_path: Path, surface: str) -> None:
    mount = PLANE if surface == "plane" else replace(cylinder("y"), top_mm=16.11, true_mm=16.055)
    corners = to_object(mount, tag_corners_mm(small_kit.tape))[0]
    shape = 'surface = "plane"' if surface == "plane" else 'surface = "cylinder"\nradius_mm = 16\naround = "y"'
    entry = read_object(write(tmp_path, small_kit, f"{shape}\ntag_corners_mm = {corners.tolist()}")).tapes[0]
    assert entry.misfit_mm == pytest.approx(0.0, abs=1e-6)
    assert to_object(entry.mount, [(20, 15)])[0] == pytest.approx(to_object(mount, [(20, 15)])[0], abs=1e-6)


def test_errors_of_measured_corners_are_in_a_pose_s_covariance(small_kit: Kit, tmp_path: Path) -> None:
    """A tenth of a millimetre in the corners of a tag of 4 mm is more than that away from it, and was in no covariance."""
    rng, squares, tape = np.random.default_rng(2), [], small_kit.tape
    fix, at_mm = on_tape(tape, (6.0, 9.0)), sensor_on_object("box", PLANE, tape, (6.0, 9.0), 33.0).position_mm
    true = to_object(PLANE, tag_corners_mm(tape))[0]
    for _ in range(60):
        corners = true + rng.normal(0.0, 0.05, (4, 3))
        thing = read_object(write(tmp_path, small_kit, f'surface = "plane"\ntag_corners_mm = {corners.tolist()}'))
        there = thing.locate(fix)
        assert there is not None and there.covariance is not None
        assert fix.covariance6("object", on=thing) == pytest.approx(there.covariance)
        error = np.subtract(there.position_mm, at_mm)
        squares.append(error @ np.linalg.solve(there.covariance[:3, :3], error) / 3)
    assert 0.4 < np.mean(squares) < 1.8


def on_tape(tape: Tape, position_mm: tuple[float, float]) -> Localization:
    index = (tape.origin[0] + 3, tape.origin[1] + 4)
    named: dict[str, Any] = {"tape": tape.name, "sector": tape.sector, "index": index, "cell": (3, 4)}
    covariance = np.diag([0.001, 0.001, 0.001]) ** 2
    return Localization(status="solid", located=True, position_mm=position_mm, theta_deg=33.0, covariance=covariance, **named)


@pytest.mark.parametrize("printed", [False, True])
def test_a_mount_s_own_errors_turn_about_its_given_position(printed: bool, small_kit: Kit, tmp_path: Path) -> None:
    kit = small_kit
    if printed:
        spec = TapeSpec(sector=7, part="block", size_mm=(26.0, 24.0), cylinder_mm=20.0)
        kit = make_kit(spec, tmp_path / "round", verify=False)
    fix = on_tape(kit.tape, (6.0, 9.0))
    exact = read_object(write(tmp_path, kit, FLAT)).locate(fix)
    there = read_object(write(tmp_path, kit, f"{FLAT}\nsigma_mm = 0.2\nsigma_deg = 1.0")).locate(fix)
    assert exact is not None and there is not None and exact.covariance is not None and there.covariance is not None
    added = there.covariance[:3, :3] - exact.covariance[:3, :3]
    arm = np.subtract(there.position_mm, (1.0, 2.0, 3.0))
    # turns of one size about all axes move a point along both directions across its arm
    expected = 0.2**2 * np.eye(3) + radians(1.0) ** 2 * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    assert added == pytest.approx(expected, abs=1e-9)
    infinite = np.isinf(exact.covariance.diagonal())
    assert (np.isinf(there.covariance.diagonal()) == infinite).all() and not there.covariance[infinite][:, ~infinite].any()


def test_corners_in_metres_or_out_of_order_are_no_tag(small_kit: Kit, tmp_path: Path) -> None:
    corners: FloatArray = to_object(PLANE, tag_corners_mm(small_kit.tape))[0]
    for wrong in (corners / 1000, corners[[0, 2, 1, 3]]):
        with pytest.raises(SpecError, match=r"off those of a tag of 4 mm.*lower left corner, counter-clockwise"):
            read_object(write(tmp_path, small_kit, f'surface = "plane"\ntag_corners_mm = {wrong.tolist()}'))


@pytest.mark.parametrize(
    ("order", "says"),
    [
        ([0, 1, 2, 3], "the film faces (0.00, 0.00, 1.00), its x runs along (1.00, 0.00, 0.00)"),
        ([0, 3, 2, 1], "the film faces (0.00, 0.00, -1.00), its x runs along (0.00, 1.00, 0.00)"),
        ([3, 2, 1, 0], "the film faces (0.00, 0.00, -1.00), its x runs along (1.00, 0.00, 0.00)"),
        ([3, 0, 1, 2], "the film faces (0.00, 0.00, 1.00), its x runs along (0.00, -1.00, 0.00)"),
    ],
    ids=["as asked for", "clockwise", "as OpenCV has them", "from the upper left"],
)
def test_how_a_film_lies_by_its_corners_is_said(
    small_kit: Kit, tmp_path: Path, capsys: pytest.CaptureFixture[str], order: list[int], says: str
) -> None:
    """Corners of a square fit in any order round it: from the upper left, clockwise, as OpenCV has them, inside out."""
    corners = np.column_stack([tag_corners_mm(small_kit.tape), np.zeros(4)])[order]
    path = write(tmp_path, small_kit, f'surface = "plane"\ntag_corners_mm = {corners.tolist()}')
    named_object(str(path), {})
    assert f"fit within 0.000 mm (rms); {says}" in capsys.readouterr().err


def test_the_length_of_a_quaternion_that_is_refused_is_not_said(small_kit: Kit, tmp_path: Path) -> None:
    """Of one of length 2 it was said that it had length 0."""
    path = write(tmp_path, small_kit, 'surface = "plane"\nposition_mm = [1, 2, 3]\nquaternion_xyzw = [2, 0, 0, 0]')
    with pytest.raises(SpecError) as refused:
        read_object(path)
    assert [problem.message.split("; ")[0].split("].", 1)[1] for problem in refused.value.problems] == [
        "quaternion_xyzw[0] = 2 exceeds 1.01"
    ]


def test_all_that_is_wrong_is_said_together(small_kit: Kit, tmp_path: Path) -> None:
    entry = 'surface = "plane"\nradius_mm = 3\nposition_mm = [1, 2]\nrpy_deg = [0, 0, nan]\ncolour = 1'
    more = (
        '[[tapes]]\nkit = "nowhere"\nsurface = "ball"\n'
        '[[tapes]]\nsurface = "cylinder"\nradius_mm = -1\nunder_mm = 100.1\nquaternion_xyzw = [1, 1, 0, 0]\n'
        '[[tapes]]\nsurface = "cylinder"\nradius_mm = 10001\nunder_mm = -1\n'
        "position_mm = [10001, 0, 0]\nrpy_deg = [0, 0, 360.1]\n"
        "sigma_mm = 10.1\nsigma_deg = -1\n"
        "[[tapes]]\ntag_corners_mm = [[0, 0, 10001], [0, 1, nan], [1, 1]]\nposition_mm = [0, 0, 0]\nsigma_mm = 0.1\n[tape]"
    )
    with pytest.raises(SpecError) as caught:
        read_object(write(tmp_path, small_kit, entry, more))
    said = str(caught.value)
    for words in (
        "tapes[0].colour is not a known key",
        "tapes[0].radius_mm is of a cylinder",
        "tapes[0].position_mm = [1, 2] is not 3 numbers",
        "tapes[0].rpy_deg[2] = nan deg is not a finite number",
        "tapes[1].surface = 'ball' is none of",
        "nowhere",
        "tapes[1].rpy_deg or quaternion_xyzw or tag_corners_mm says how the film lies, but given is none",
        "tapes[2].kit is missing",
        "tapes[2].radius_mm = -1 mm is not above 0",
        "tapes[2].around is missing",
        "quaternion_xyzw has length 1.414",
        "box.toml: tape is not a known key",
        "tapes[2].under_mm = 100.1 mm exceeds 100",
        "tapes[3].radius_mm = 10001 mm exceeds 10000",
        "tapes[3].under_mm = -1 mm is below 0",
        "tapes[3].position_mm[0] = 10001 mm exceeds 10000",
        "tapes[3].rpy_deg[2] = 360.1 deg exceeds 360",
        "tapes[3].sigma_mm = 10.1 mm exceeds 10",
        "tapes[3].sigma_deg = -1 deg is below 0",
        "tapes[4].sigma_mm is of a pose that is given; tag_corners_mm tell their error themselves: leave it out",
        "tapes[4].tag_corners_mm[0][2] = 10001 mm exceeds 10000",
        "tapes[4].tag_corners_mm[1][2] = nan mm is not a finite number",
        "tapes[4].tag_corners_mm[2] = [1, 1] is not 3 numbers",
        "tag_corners_mm has 3 corners; give 4",
        "position_mm and tag_corners_mm both say where the film is",
    ):
        assert words in said, said


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name = 'a'\ntapes = 3", "tapes = 3 is not a list"),
        ("name = 'a'\n[tapes]\nkit = 'k'", "tapes = {'kit': 'k'} is not a list; give a [[tapes]] for each tape on the object"),
        ("name = 'a'", "tapes is missing; give a [[tapes]] for each tape on the object"),
        ("name = 'a'\ntapes = [3]", "tapes[0] = 3 is not a table"),
        ("name = 'a'\ntapes = []", "tapes is empty"),
        (f"name = '{101 * 'a'}'\ntapes = []", "has 101 characters; give at most 100 characters in quotes"),
        ("tapes = []", "name is missing"),
        ("name = [", "is not TOML"),
        ("name = 'a'\n[[tapes]]\nkit = 3\nsurface = 'plane'", "kit = 3 is not a text"),
        (
            "name = 'a'\n[[tapes]]\nkit = ''\nsurface = 'plane'",
            "kit = '' has a form that cannot be used; give the folder of a kit",
        ),
        ("name = 'a'\n[[tapes]]\nkit = \"a\\u0000b\"\nsurface = 'plane'\nposition_mm = [0, 0, 0]\nrpy_deg = [0, 0, 0]", "kit"),
    ],
)
def test_a_file_that_is_none_is_refused(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "box.toml").write_text(text, encoding="utf-8")
    with pytest.raises(SpecError) as caught:
        read_object(tmp_path / "box.toml")
    assert words in str(caught.value)


def test_one_texture_in_two_places_is_refused(small_kit: Kit, tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="same texture, which no touch tells apart"):
        read_object(write(tmp_path, small_kit, FLAT, f'[[tapes]]\nkit = "{small_kit.path}"\n{FLAT}'))


def test_a_tape_beside_an_object_with_the_texture_of_one_on_it_is_refused(small_kit: Kit, tmp_path: Path) -> None:
    thing, tape = read_object(write(tmp_path, small_kit, FLAT)), small_kit.tape
    refuse_ambiguous(thing, [tape, tape])  # the kit on it, given again
    for other in (replace(tape, name="another"), replace(tape, board=replace(tape.board, texture_origin_mm=(9.0, 9.0)))):
        with pytest.raises(SpecError, match="which is on the object, and no touch tells them apart; use another sector"):
            refuse_ambiguous(thing, [tape, other])


@pytest.fixture(scope="module")
def namesake(small_kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> Kit:
    """A kit of another code, with the name, the sector and the origin of the small one."""
    tape = small_kit.tape
    spec = TapeSpec(
        sector=tape.sector, code="debruijn-4x4", origin=tape.origin, name=tape.name, size_mm=tape.board.size_mm, models=False
    )
    return make_kit(spec, tmp_path_factory.mktemp("namesake") / "kit", verify=False)


def test_tapes_that_answers_name_alike_are_refused(small_kit: Kit, namesake: Kit, frames: Path, tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="have the same name, sector and origin, by which an answer names its tape"):
        read_object(write(tmp_path, small_kit, FLAT, f'[[tapes]]\nkit = "{namesake.path}"\n{FLAT}'))
    command = ["decode", str(frames), "--object", str(write(tmp_path, small_kit, FLAT)), "--tape", str(namesake.path)]
    run = CliRunner().invoke(main, command)
    assert run.exit_code == 2 and "on the object, but another texture; make it" in run.stderr


def test_fixes_of_other_tapes_or_of_none_have_no_place(small_kit: Kit, tmp_path: Path) -> None:
    thing, tape = read_object(write(tmp_path, small_kit, FLAT)), small_kit.tape
    index = (tape.origin[0] + 3, tape.origin[1] + 4)
    fix = Localization(
        status="solid",
        located=True,
        tape=tape.name,
        sector=tape.sector,
        position_mm=(1.0, 2.0),
        theta_deg=0.0,
        cell=(3, 4),
        index=index,
    )
    there = thing.locate(fix)
    x0, y0 = tape.board.texture_origin_mm
    assert there is not None and there.position_mm == pytest.approx((1 - (y0 - 2.0), 2 + (x0 + 1.0), 3))
    assert thing.locate(replace(fix, sector=tape.sector + 1)) is None
    assert thing.locate(replace(fix, tape="another")) is None
    assert thing.locate(replace(fix, index=(index[0] + 1, index[1]))) is None
    assert thing.locate(replace(fix, located=False)) is None
    assert thing.locate(replace(fix, position_mm=None)) is None


# decode


@pytest.fixture(scope="module")
def frames(small_kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("frames") / "frames.npz"
    run = CliRunner().invoke(main, ["simulate", str(small_kit.path), "-o", str(path), "--count", "2", "--contact", "9x9"])
    assert run.exit_code == 0, run.output
    return path


def test_decode_registers_the_tapes_of_an_object_and_answers_in_its_frame(small_kit: Kit, frames: Path, tmp_path: Path) -> None:
    corners = to_object(PLANE, tag_corners_mm(small_kit.tape))[0]
    path = write(tmp_path, small_kit, f'surface = "plane"\ntag_corners_mm = {corners.tolist()}')
    run = CliRunner().invoke(main, ["decode", str(frames), "--object", str(path), "--json"])
    assert run.exit_code == 0, run.output
    assert "the tag's corners fit within 0.000 mm (rms)" in run.stderr
    answers = [json.loads(line) for line in run.stdout.splitlines()]
    assert len(answers) == 2 and all(answer["located"] for answer in answers)
    for answer in answers:
        assert answer["object"] == "box"
        assert answer["object_mm"] == pytest.approx(to_object(PLANE, [answer["board_mm"]])[0][0].tolist(), abs=1e-6)
        assert np.linalg.norm(answer["object_rotation"]) == pytest.approx(1.0)
    table = CliRunner().invoke(main, ["decode", str(frames), "--object", str(path)]).stdout.splitlines()
    assert table[0].endswith("on object: x, y, z mm")
    assert table[1].endswith(", ".join(f"{v:.3f}" for v in answers[0]["object_mm"]))


def test_watch_answers_in_the_frame_of_an_object_as_decode_does(small_kit: Kit, frames: Path, tmp_path: Path) -> None:
    path, keys = write(tmp_path, small_kit, FLAT), ("frame", "located", "object", "object_mm", "object_rotation")
    found = []
    for command in (["decode", str(frames)], ["watch", str(frames), "--rate", "max"]):
        run = CliRunner().invoke(main, [*command, "--object", str(path), "--json"])
        assert run.exit_code == 0, run.output
        found.append([{key: json.loads(line)[key] for key in keys} for line in run.stdout.splitlines()])
    assert found[0] == found[1] and all(answer["object_mm"] is not None for answer in found[0])
    refused = CliRunner().invoke(main, ["watch", str(frames), "--object", str(path), "--w", "1.5"])
    assert refused.exit_code == 2 and "--w and --object are given" in refused.stderr


def test_the_log_of_watch_has_the_objects_frame(small_kit: Kit, frames: Path, tmp_path: Path) -> None:
    reader = pytest.importorskip("rosbags.highlevel")
    log, path = tmp_path / "touch.mcap", write(tmp_path, small_kit, FLAT)
    line = ["watch", str(frames), "--rate", "10", "--no-drop", "--object", str(path), "--mcap", str(log), "--json"]
    run = CliRunner().invoke(main, line)
    assert run.exit_code == 0, run.output
    with reader.AnyReader([log]) as bag:
        logged = [bag.deserialize(data, c.msgtype).data for c, _, data in bag.messages() if c.topic == "/tactape/fix"]
    assert [json.loads(text) for text in logged] == [json.loads(line) for line in run.stdout.splitlines()]
    assert json.loads(logged[0])["object"] == "box"


def test_answers_beside_an_object_are_null(small_kit: Kit, frames: Path, tmp_path: Path) -> None:
    np.savez(tmp_path / "noise.npz", depth=np.random.default_rng(1).normal(size=(240, 320)).astype(np.float32))
    run = CliRunner().invoke(
        main, ["decode", str(tmp_path / "noise.npz"), "--object", str(write(tmp_path, small_kit, FLAT)), "--json"]
    )
    (answer,) = [json.loads(line) for line in run.stdout.splitlines()]
    assert (answer["located"], answer["object"], answer["object_mm"], answer["object_rotation"]) == (False, None, None, None)


def test_decode_says_what_is_wrong_with_an_object(small_kit: Kit, frames: Path, tmp_path: Path) -> None:
    (tmp_path / "box.toml").write_text("name = 'a'\ntapes = []", encoding="utf-8")
    run = CliRunner().invoke(main, ["decode", str(frames), "--object", str(tmp_path / "box.toml")])
    beside = CliRunner().invoke(main, ["decode", str(frames), "--object", str(write(tmp_path, small_kit, FLAT)), "--w", "1.5"])
    assert beside.exit_code == 2 and "--w and --object are given, but an object's kits say all of it" in beside.stderr
    assert run.exit_code == 2 and "tapes is empty; give a [[tapes]] for each tape on the object" in run.stderr


def test_a_part_of_its_own_is_refused_with_what_to_give_instead(
    small_kit: Kit, frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    surface: Any = object()
    entry = SimpleNamespace(path=small_kit.path, tape=replace(small_kit.tape, surface=surface))
    monkeypatch.setattr("tactape_fab.sense.objects.taped_object.read_registered", lambda _: [entry])
    run = CliRunner().invoke(main, ["decode", str(frames), "--object", str(write(tmp_path, small_kit, FLAT))])
    assert "stands on a part of its own, not on a film; give a kit of a film\n" in run.stderr
