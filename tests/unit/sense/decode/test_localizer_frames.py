"""Localizer: frames of any sensor, and the refusal of invalid frames and invalid dots at every entry point."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tactape_fab import Localizer, TapeSpec
from tactape_fab.base.errors import FrameError
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import ElasticContact, Scene, SensorProfile, load_sensor, simulate
from tactape_fab.texture.frames import FloatArray
from tests.contacts import POSE, TAPE, R, dots, is_near

# Contacts over the board's edge


@pytest.mark.parametrize(
    ("options", "poses"),
    [
        ({}, [((40.0, -0.5), 34.0), ((12.0, -0.4), 60.0), ((30.0, 36.4), -110.0)]),
        ({"part": "block"}, [((41.0, -0.5), 4.0), ((18.0, 0.0), 112.0), ((0.4, 35.1), 32.0), ((45.0, 37.3), 20.0)]),
    ],
    ids=["film", "solid"],
)
def test_the_edge_of_the_board_hides_no_place(options: dict[str, Any], poses: list[tuple[tuple[float, float], float]]) -> None:
    tape = examine(TapeSpec(sector=7, size_mm=(60.0, 40.0), **options)).tape
    localizer = Localizer([tape])
    for position_mm, theta_deg in poses:
        fix = localizer.locate(simulate(tape, position_mm, theta_deg))
        assert fix.located and is_near(fix, position_mm, theta_deg, mm=0.05, deg=0.5), (position_mm, fix.reason)


def test_parts_that_lie_across_are_another_place() -> None:
    """The first two columns of sector 0 of the de Bruijn code were its first two rows, a quarter turn away, with p_false 1e-5."""
    tape = examine(TapeSpec(sector=0, code="debruijn-4x4", part="r0402", pitch_mm=1.2, size_mm=(60.0, 40.0), tag="none")).tape
    strip = Scene(contact="strip", texture_mm=0.1495, cylinder_radius_mm=24.57, contact_turn_deg=159.18)
    localizer, pose = Localizer([tape], world="closed"), ((-2.0368, 8.6656), -66.3759)
    fixes = [localizer.locate(simulate(tape, *pose, scene=strip, seed=seed)) for seed in range(6)]
    assert not any(fix.located for fix in fixes)
    assert any("the parts lie across" in (fix.reason or "") for fix in fixes)


def test_parts_soldered_a_quarter_turn_off_are_told_and_located_as_they_lie() -> None:
    made = replace(TAPE, part=replace(TAPE.part, rotation_deg=135.0))
    frame = simulate(made, *POSE, seed=1)
    fix = Localizer([TAPE]).locate(frame)
    assert not fix.located and fix.reason is not None and fix.reason.endswith("make the kit with a rotation of 135 deg")
    assert is_near(Localizer([made]).locate(frame), *POSE, mm=0.01, deg=0.1)


# Sensors


@pytest.mark.parametrize("rotate90", [0, 1, 2, 3])
@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("sign", [1, -1])
def test_frames_of_a_sensor_become_upright(rotate90: int, mirror: bool, sign: int) -> None:
    sensor = replace(load_sensor("gelsight-mini"), rotate90=rotate90, mirror=mirror, sign=sign)
    frame = simulate(TAPE, POSE[0], POSE[1], sensor=sensor)
    assert frame.shape == sensor.frame_shape
    fix = Localizer([TAPE], sensor).locate(frame)
    assert fix.located and is_near(fix, *POSE, mm=0.02, deg=0.3)


@pytest.mark.parametrize(
    "change",
    [{"px_per_mm": (16.0, 14.5)}, {"px_per_mm": (15.0, 16.5)}, {"width_px": 400, "height_px": 300, "px_per_mm": (20.0, 20.0)}],
)
def test_pixels_of_any_size(change: dict[str, Any]) -> None:
    sensor = replace(load_sensor("gelsight-mini"), **change)
    fix = Localizer([TAPE], sensor).locate(simulate(TAPE, POSE[0], POSE[1], sensor=sensor))
    assert fix.located and is_near(fix, *POSE, mm=0.02, deg=0.3)


@pytest.mark.parametrize("down_mm", [-25.0, 25.0])
def test_noise_above_a_contact_hides_no_dot_of_it(down_mm: float) -> None:
    sensor = replace(load_sensor("gelsight-mini"), width_px=640, height_px=480, px_per_mm=(7.0, 7.0))
    scene = Scene(contact_offset_mm=(0.0, down_mm), contact_mm=(11.0, 9.0))
    position_mm = (50.0, 22.0 - down_mm)
    fix = Localizer([TAPE], sensor).locate(simulate(TAPE, position_mm, 0.0, sensor=sensor, scene=scene))
    assert fix.located and is_near(fix, position_mm, 0.0, mm=0.2, deg=0.5), fix.reason


@pytest.mark.parametrize("name", ["digit", "generic"])
def test_sensors_that_come_with_the_package(name: str) -> None:
    sensor = load_sensor(name)
    fix = Localizer([TAPE], name).locate(simulate(TAPE, POSE[0], POSE[1], sensor=sensor, contact_mm=(9.0, 9.0)))
    assert fix.located and is_near(fix, *POSE, mm=0.03, deg=0.5)


def test_the_scale_of_the_frame_is_told(localizer: Localizer) -> None:
    xy = dots(px_per_mm=16.8)
    fix = localizer.locate_dots(xy)
    assert fix.located and fix.px_per_mm == pytest.approx(16.8, rel=1e-3)
    assert is_near(fix, *POSE, mm=1e-3)
    fixed = Localizer([TAPE], fixed_scale=True).locate_dots(dots())
    assert fixed.located and fixed.px_per_mm == pytest.approx(R, rel=1e-12)


def test_dots_outside_the_mask_are_not_looked_at(depth: npt.NDArray[np.float32]) -> None:
    mask = np.zeros((240, 320), dtype=np.bool_)
    mask[:, 160:] = True
    sensor: SensorProfile = replace(load_sensor("gelsight-mini"), mask=mask)
    whole, half = Localizer([TAPE]).locate(depth), Localizer([TAPE], sensor).locate(depth)
    assert 0.3 * whole.n_dots < half.n_dots < 0.7 * whole.n_dots


# Bad frames


def test_holes_are_filled(localizer: Localizer, depth: npt.NDArray[np.float32]) -> None:
    rng = np.random.default_rng(3)
    frame = depth.copy()
    frame[rng.random(frame.shape) < 0.005] = np.nan
    frame[:20, :30] = np.inf
    fix = localizer.locate(frame)
    assert not fix.located or is_near(fix, *POSE, mm=0.1, deg=2.0)
    frame = depth.copy()
    frame[:20, :30] = np.nan
    frame[200:, 300:] = -np.inf
    assert is_near(localizer.locate(frame), *POSE, mm=0.02, deg=0.3)


@pytest.mark.parametrize("factor", [1e10, 1e40, 1e-12, 1e-40])
def test_depths_that_have_to_be_scaled_say_nothing_of_the_contact(localizer: Localizer, factor: float) -> None:
    depth = simulate(TAPE, *POSE, seed=4).astype(np.float64)
    usual, fix = localizer.locate(depth), localizer.locate(depth * factor)
    assert usual.contact is not None and usual.tilt_deg is not None and usual.indentation_mm is not None
    assert fix.located and is_near(fix, *POSE, mm=0.02, deg=0.3)
    assert (fix.contact, fix.tilt_deg, fix.indentation_mm, fix.force_n) == (None, None, None, None)


@pytest.mark.parametrize("background", [1e7, 1e10])
@pytest.mark.parametrize("holes", [False, True])
def test_a_large_background_hides_no_texture(
    localizer: Localizer, depth: npt.NDArray[np.float32], background: float, holes: bool
) -> None:
    """Of types with more digits than single precision."""
    frame = depth.astype(np.float64) + background
    whole = np.rint(1000.0 * depth).astype(np.int64) + int(background)
    if holes:
        frame[:20, :30], frame[200:, 300:] = np.nan, np.inf
    for given in (frame, whole):
        fix = localizer.locate(given)
        assert is_near(fix, *POSE, mm=0.02, deg=0.3)
        assert fix.indentation_mm is None


@pytest.mark.parametrize("factor", [1e10, 1e-12])
def test_depths_that_have_to_be_scaled_have_the_unit_of_their_dots(factor: float) -> None:
    """The slope of such a frame is not one in mm per mm."""
    depth = simulate(TAPE, *POSE, seed=4, elastic=ElasticContact(force_n=2.0, tilt_deg=(1.0, 2.0))).astype(np.float64)
    localizer = Localizer([TAPE])
    usual, found = localizer.locate(depth), localizer.locate(depth * factor)
    assert usual.position_mm is not None and usual.theta_deg is not None and found.tilt_deg is None
    assert is_near(found, usual.position_mm, usual.theta_deg, mm=0.001, deg=0.01)


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, -np.inf, 1e38, -3.0])
def test_a_frame_of_one_value_has_no_dots(localizer: Localizer, value: float) -> None:
    fix = localizer.locate(np.full((240, 320), value, dtype=np.float32))
    assert (fix.status, fix.located, fix.n_dots, fix.reason) == ("none", False, 0, "no dots")


@pytest.mark.parametrize(
    "frame",
    [
        np.zeros((320, 240)), np.zeros((240, 320, 1)), np.zeros(7), np.zeros((0, 0)), 5.0, None, "depth",
        np.zeros((240, 320), dtype=complex), np.full((240, 320), "x"), np.zeros((240, 320), dtype="datetime64[s]"),
        [[1.0, 2.0], [3.0]], np.full((240, 320), None), {"depth": 1},
    ],
)  # fmt: skip
def test_what_is_no_depth_map_is_refused(localizer: Localizer, frame: Any) -> None:
    with pytest.raises(FrameError) as caught:
        localizer.locate(frame)
    assert len(str(caught.value)) > 20


@pytest.mark.parametrize("shape", [(5, 240, 320), (240, 320, 1), (76800,)])
def test_several_frames_at_a_time_are_refused_as_such(localizer: Localizer, shape: tuple[int, ...]) -> None:
    with pytest.raises(FrameError) as caught:
        localizer.locate(np.zeros(shape, dtype=np.float32))
    assert str(caught.value) == f"the frame has shape {shape}; give one depth map at a time (h, w)"


@pytest.mark.parametrize(
    ("xy", "weights"),
    [
        (np.zeros((3, 3)), None), (np.zeros(4), None), (np.zeros((4, 2)), np.zeros(3)), (np.full((4, 2), np.nan), None),
        (np.zeros((4, 2)), [1, 1, np.inf, 1]), (np.zeros((4, 2)), [1, 1, -1, 1]), (np.full((8, 2), 1e308), np.ones((8, 1))),
    ],
)  # fmt: skip
def test_what_are_no_dots_is_refused(localizer: Localizer, xy: Any, weights: Any) -> None:
    with pytest.raises(FrameError):
        localizer.locate_dots(xy, weights)


@pytest.mark.parametrize("xy", ["dots", [[1, 2], [3]], np.zeros((4, 2), dtype=complex)])
def test_dots_that_are_no_numbers_are_refused(localizer: Localizer, xy: Any) -> None:
    with pytest.raises(FrameError):
        localizer.locate_dots(xy)


@pytest.mark.parametrize(
    "xy",
    [np.zeros((50, 2)), np.full((50, 2), 1e200), np.arange(4000.0).reshape(2000, 2) * 7, np.eye(2).repeat(20, axis=0) * 1e12],
)
def test_absurd_dots_have_an_answer(localizer: Localizer, xy: FloatArray) -> None:
    assert not localizer.locate_dots(xy).located
    assert not localizer.locate_dots(xy, np.zeros(len(xy))).located
