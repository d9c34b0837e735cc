"""Simulated frames: what each sensor delivers, many frames and their truth, parts of a CPL, dots, other textures, bad input."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tactape_fab import Kit, Tape
from tactape_fab.base.errors import SpecError
from tactape_fab.base.templates import profile_names
from tactape_fab.sense import Parts, Scene, draw_poses, iterate_frames, load_sensor, parts_from_cpl, simulate, simulate_frames
from tactape_fab.sense.simulation.contact import imprint
from tactape_fab.sense.simulation.dot_errors import DotErrors, dots_of
from tactape_fab.sense.simulation.gel import delivered
from tactape_fab.sense.simulation.parts import parts_of
from tactape_fab.texture.frames import FloatArray
from tactape_fab.verify.trip.visible_parts import ERROR_FREE
from tests.bench.impostors import other_surface, plain_grid, random_bumps, random_symbols

CENTRE = np.array([159.5, 119.5])


# --- sensors ---------------------------------------------------------------------------------------------------------

UPRIGHT = np.array([[1, 2, 3], [4, 5, 6]], dtype=np.float32)
AS_DELIVERED = {
    (False, 0): [[1, 2, 3], [4, 5, 6]],
    (False, 1): [[4, 1], [5, 2], [6, 3]],
    (False, 2): [[6, 5, 4], [3, 2, 1]],
    (False, 3): [[3, 6], [2, 5], [1, 4]],
    (True, 0): [[3, 2, 1], [6, 5, 4]],
    (True, 1): [[1, 4], [2, 5], [3, 6]],
    (True, 2): [[4, 5, 6], [1, 2, 3]],
    (True, 3): [[6, 3], [5, 2], [4, 1]],
}


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("mirror", "rotate90"), list(AS_DELIVERED))
def test_frames_are_what_the_sensor_delivers(tape: Tape, mirror: bool, rotate90: int, sign: int) -> None:
    sensor = replace(load_sensor("generic"), mirror=mirror, rotate90=rotate90, sign=sign)
    small = replace(sensor, width_px=3, height_px=2)
    raw = delivered(UPRIGHT, small)
    assert (raw == sign * np.array(AS_DELIVERED[mirror, rotate90])).all()
    assert (small.canonical(raw) == UPRIGHT).all()
    frame = simulate(tape, (40.0, 20.0), 25.0, sensor=sensor)
    assert frame.shape == sensor.frame_shape == ((320, 240) if rotate90 % 2 else (240, 320))
    assert frame.flags.c_contiguous
    assert (sensor.canonical(frame) == simulate(tape, (40.0, 20.0), 25.0, sensor="generic")).all()


def test_depth_comes_in_the_sensors_unit_and_not_from_blind_pixels(tape: Tape) -> None:
    mask = np.ones((240, 320), dtype=bool)
    mask[:, :20] = False
    sensor = replace(load_sensor("generic"), depth_unit_mm=0.001, mask=mask)
    mm, um = (simulate(tape, (40.0, 20.0), 25.0, sensor=s) for s in ("generic", sensor))
    assert um[:, 20:] == pytest.approx(mm[:, 20:] * 1000, rel=1e-5)
    assert not um[:, :20].any()


@pytest.mark.parametrize("name", ["gelsight-mini", "digit", "generic"])
def test_every_sensor_sees_a_tape(tape: Tape, name: str) -> None:
    sensor = load_sensor(name)
    frame = next(iterate_frames(tape, 1, sensor=sensor))
    assert frame.depth.shape == sensor.frame_shape
    assert np.isfinite(frame.depth).all()
    assert 25 < (frame.dots_imprint >= 0.5).sum() < 45


# --- many frames -----------------------------------------------------------------------------------------------------


def test_equal_seeds_give_equal_frames_whatever_their_number(tape: Tape) -> None:
    scene = Scene(missing=0.1, bumps=3, placement_mm=0.02)
    few, more = simulate_frames(tape, 3, 11, scene=scene), simulate_frames(tape, 5, 11, scene=scene)
    assert (few.depth == more.depth[:3]).all()
    assert (few.position_mm == more.position_mm[:3]).all()
    assert (few.dots_px[2] == more.dots_px[2]).all()
    assert few.depth.shape == (3, 240, 320)
    assert not np.array_equal(few.depth, simulate_frames(tape, 3, 12, scene=scene).depth)
    assert (simulate(tape, (1.0, 2.0), 3.0, seed=4) == simulate(tape, (1.0, 2.0), 3.0, seed=4)).all()
    assert (simulate(tape, (1.0, 2.0), 3.0, seed=4) != simulate(tape, (1.0, 2.0), 3.0, seed=5)).any()


def test_parts_from_the_written_cpl_are_the_tapes_own(small_kit: Kit) -> None:
    tape = Tape.load(small_kit.path)
    (cpl,) = small_kit.path.glob("assembly/*-cpl.csv")
    parts = parts_from_cpl(cpl)
    assert parts.xy_mm == pytest.approx(tape.part_xy_mm(), abs=5e-5)
    assert set(parts.rotation_deg) == {45.0}
    at = ((tape.columns - 1) * 0.75, (tape.rows - 1) * 0.75)
    assert simulate(tape, at, 10.0, parts=parts) == pytest.approx(simulate(tape, at, 10.0), abs=1e-4)
    shifted = cpl.read_bytes().replace(b",45\r\n", b",30\r\n")
    assert set(parts_from_cpl(shifted).rotation_deg) == {30.0}


HEADER = b"Designator,Mid X,Mid Y,Layer,Rotation\r\n"


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "cpl is empty"),
        (b"R1\r\n", "no column Designator, Mid X, Mid Y, Layer, Rotation"),
        (HEADER, "names no part"),
        (b"Designator,Mid X,Layer\r\nR1,1,Top\r\n", "no column Mid Y, Rotation"),
        (HEADER + b"R1,1,2,Top\r\n", "line 2: it has 4 cells where the header has 5"),
        (HEADER + b"R1,1,x,Top,45\r\n", "line 2: Mid Y = 'x' is not a number"),
        (HEADER + b"R1,nan,2,Top,45\r\n", "Mid X = 'nan'"),
        (HEADER + b"R1,1e9,2,Top,45\r\n", "from -10000 to 10000 mm"),
        (HEADER + b"R1,1,2,Bottom,45\r\n", "'R1' is on layer 'Bottom'"),
        (HEADER + b"R1,1,2,Top,45\r\nR1,2,2,Top,45\r\n", "line 3: designator 'R1' is empty or stands twice"),
        (HEADER + b",1,2,Top,45\r\n", "designator '' is empty"),
        (b"\xff\xfe\x00", "not UTF-8"),
        (HEADER + b'"R1,1,2,Top,45\r\n', "no CSV"),
        (HEADER + b"R1," + b"1" * 200_000 + b",2,Top,45\r\n", "no CSV"),
    ],
)
def test_a_broken_cpl_is_refused_in_words(data: bytes, words: str) -> None:
    with pytest.raises(SpecError, match="cpl") as error:
        parts_from_cpl(data)
    assert words in str(error.value)


def test_a_cpl_names_many_problems_at_once_and_no_more_than_twenty() -> None:
    with pytest.raises(SpecError) as error:
        parts_from_cpl(HEADER + b"".join(b"R%d,x,2,Top,45\r\n" % i for i in range(500)))
    assert len(error.value.problems) == 20
    with pytest.raises(SpecError, match="cannot be opened"):
        parts_from_cpl("no-such-file.csv")


# --- dots without pictures, and other textures -----------------------------------------------------------------------


def test_dots_err_as_said(tape: Tape) -> None:
    errors = DotErrors(sigma_px=0.3, rim_pull_px=0.0, outliers=0.0, lost=0.1, least_imprint=0.99, false_dots=2.0)
    rng = np.random.default_rng(1)
    drawn = [dots_of(tape, pose, None, rng, errors) for pose in draw_poses(tape, 300)]
    real = [d.part >= 0 for d in drawn]
    off = np.concatenate([(d.xy_px - d.true_px)[r] for d, r in zip(drawn, real, strict=True)])
    assert off.std(axis=0) == pytest.approx([0.3, 0.3], rel=0.05)
    assert np.mean([(~r).sum() for r in real]) == pytest.approx(2.0, abs=0.3)
    whole = [dots_of(tape, pose, None, rng, replace(errors, lost=0.0)) for pose in draw_poses(tape, 300)]
    assert sum(map(np.sum, real)) / sum((d.part >= 0).sum() for d in whole) == pytest.approx(0.9, abs=0.02)
    wild = [dots_of(tape, pose, None, rng, replace(errors, outliers=0.2)) for pose in draw_poses(tape, 300)]
    far = np.concatenate([np.abs(d.xy_px - d.true_px)[d.part >= 0].max(axis=1) for d in wild]) > 1.5
    assert far.mean() == pytest.approx(0.2 * (1 - (1.5 / 6) ** 2), rel=0.15)


def test_dots_are_where_frames_have_them(tape: Tape) -> None:
    for frame in iterate_frames(tape, 5, 4):
        dots = dots_of(tape, (*frame.position_mm, frame.theta_deg), Scene(), 1, ERROR_FREE)
        felt = frame.dots_imprint >= 0.5
        assert (dots.part == frame.dots_part[felt]).all()
        assert dots.xy_px == pytest.approx(frame.dots_px[felt])
        assert dots.weights == pytest.approx(frame.dots_imprint[felt])


def test_dots_at_the_rim_are_drawn_inwards(tape: Tape) -> None:
    errors = DotErrors(sigma_px=0.0, rim_sigma_px=0.0, outliers=0.0, false_dots=0.0)
    for scene in (Scene(contact_offset_mm=(1.0, 0.0)), Scene(contact="strip", strip_width_mm=6.0, contact_turn_deg=90.0)):
        for pose in draw_poses(tape, 20, scene=scene):
            dots = dots_of(tape, pose, scene, 1, errors)
            pull, out = dots.xy_px - dots.true_px, (dots.true_px - CENTRE) / 16 - scene.contact_offset_mm
            share = imprint(scene, (dots.true_px - CENTRE) / 16)
            assert np.hypot(*pull.T) == pytest.approx(2.4 * (1 - share) ** 0.75, abs=1e-6)
            assert (pull[:, 0] * out[:, 0] <= 1e-9).all()
            if scene.contact == "strip":
                assert np.abs(pull[:, 1]).max() < 1e-9


def near_cells(tape: Tape, parts: Parts) -> FloatArray:
    """Displacement of every part from its own grid point, texture frame, in units of delta."""
    x0, y0 = tape.board.texture_origin_mm
    texture = (parts.xy_mm - (x0, y0)) * (1, -1)
    return np.asarray((texture - tape.cells() * 1.5) / 0.25)


def test_other_textures_are_what_their_names_say(tape: Tape) -> None:
    assert np.abs(near_cells(tape, plain_grid(tape))).max() < 1e-9
    moved = near_cells(tape, random_symbols(tape, 1))
    directions, counts = np.unique(np.rint(moved), axis=0, return_counts=True)
    assert directions.tolist() == [[-1, 0], [0, -1], [0, 1], [1, 0]]
    assert counts == pytest.approx(np.full(4, tape.part_count / 4), rel=0.15)
    assert 0.2 < (np.abs(moved - near_cells(tape, parts_of(tape))).max(axis=1) < 1e-6).mean() < 0.3
    assert not np.array_equal(random_symbols(tape, 1).xy_mm, random_symbols(tape, 2).xy_mm)
    bumps = random_bumps(tape, 1)
    assert bumps.xy_mm.shape == (tape.part_count, 2)
    apart = np.hypot(*(bumps.xy_mm[:, None] - bumps.xy_mm[None]).transpose(2, 0, 1))
    np.fill_diagonal(apart, 9.0)
    assert (apart.min(axis=1) < 0.9).mean() < 0.1
    assert (bumps.xy_mm == random_bumps(tape, 1).xy_mm).all()


def test_other_surfaces_have_no_dots(tape: Tape) -> None:
    quiet = Scene(noise=0.0, tilt_mm_per_mm=(0.0, 0.0))
    assert not other_surface("blank", scene=quiet).any()
    ball = other_surface("ball", scene=quiet).astype(np.float64)
    assert np.abs(np.diff(ball, 2, axis=0)).max() < 0.001
    assert ball.max() == pytest.approx(0.3, abs=1e-3)
    ridges = other_surface("ridges", scene=quiet, seed=1).astype(np.float64) - ball
    assert 0.05 < ridges.max() < 0.13
    assert not np.array_equal(other_surface("ridges", seed=1), other_surface("ridges", seed=2))
    with pytest.raises(SpecError, match="is none of: blank, ball, ridges"):
        other_surface("wood")  # type: ignore[arg-type]


# --- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda t: simulate(t, (np.nan, 2.0), 0.0), "position_mm[0] = nan mm is not a finite number"),
        (lambda t: simulate(t, (0.0, 1e9), 0.0), "position_mm[1] = 1e+09 mm exceeds 100000 mm"),
        (lambda t: simulate(t, (1.0,), 0.0), "position_mm = (1.0,) is not 2 numbers"),
        (lambda t: dots_of(t, (1.0, 2.0)), "position_mm = [1.0] is not 2 numbers"),
        (lambda t: simulate(t, (0.0, 1.0), float("inf")), "theta_deg = inf deg is not a finite number"),
        (lambda t: simulate(t, (0.0, 1.0), 0.0, sensor="nosuch"), f"is none of: {', '.join(profile_names('sensors'))}"),
        (lambda t: simulate(t, (0.0, 1.0), 0.0, misssing=0.1), "did you mean 'missing'?"),
        (lambda t: simulate(t, (0.0, 1.0), 0.0, missing=1.5), "scene.missing = 1.5 exceeds 1"),
        (lambda t: simulate(t, (0.0, 1.0), 0.0, contact="square"), "is none of: ellipse, strip, pad"),
        (lambda t: simulate(t, (0.0, 1.0), 0.0, contact_mm=(0.0, 5.0)), "below 0.1 mm"),
        (lambda t: simulate(t, (0.0, 1.0), 0.0, bumps=-1), "outside 0 to 1000"),
        (lambda t: simulate(t, (0.0, 1.0), 0.0, seed=-1), "seed = -1 is outside"),
        (lambda t: simulate(t, (0.0, 1.0), 0.0, parts=[[1.0]]), "parts has shape (1, 1)"),
        (lambda t: simulate(t, (0.0, 1.0), 0.0, parts=[[1.0, np.inf]]), "not finite"),
        (lambda t: simulate(t, (0.0, 1.0), 0.0, parts="R1"), "no array of numbers"),
        (lambda t: simulate_frames(t, 0), "count = 0 is outside 1 to 1000000"),
        (lambda t: simulate_frames(t, 2, poses=[[0.0, 0.0, 0.0]]), "poses has shape (1, 3), not (2, 3)"),
        (lambda t: DotErrors(lost=2.0), "errors.lost = 2 exceeds 1"),
    ],
)
def test_bad_input_is_refused_in_words(tape: Tape, call: Callable[[Tape], object], words: str) -> None:
    with pytest.raises(SpecError) as error:
        call(tape)
    assert words in str(error.value)


def test_a_scene_names_all_its_problems() -> None:
    with pytest.raises(SpecError) as error:
        Scene(missing=-1.0, noise=float("nan"), roll_off_mm="wide")  # type: ignore[arg-type]
    assert [p.key for p in error.value.problems] == ["scene.roll_off_mm", "scene.noise", "scene.missing"]


def test_far_off_the_tape_there_is_nothing_but_noise(tape: Tape) -> None:
    quiet = Scene(contact="pad", dome_mm=0.0, tilt_mm_per_mm=(0.0, 0.0), noise=0.0)
    frame = next(iterate_frames(tape, 1, scene=quiet, poses=[(5000.0, -300.0, 10.0)]))
    assert len(frame.dots_px) == 0
    assert np.ptp(frame.depth) < 1e-6


def test_importing_the_simulator_loads_no_library_of_weight() -> None:
    heavy = ("cv2", "scipy", "shapely", "build123d", "trimesh", "click", "tactape_fab.sense.decode", "tactape_fab.kit")
    code = f"import sys, tactape_fab.sense.simulation; print([m for m in {heavy!r} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True).stdout.strip() == "[]"
