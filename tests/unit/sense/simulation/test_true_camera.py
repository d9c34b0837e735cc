"""The camera of a simulated sensor: aspect, shear, lens and centre, with the scene's errors, and what is drawn by it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tactape_fab import Tape
from tactape_fab.sense import Frame, Scene, SensorProfile, iterate_frames, load_sensor
from tactape_fab.sense.geometry import Geometry
from tactape_fab.sense.simulation.contact import contact_images, imprint
from tactape_fab.sense.simulation.true_camera import true_camera
from tactape_fab.sense.simulation.view import make_view
from tactape_fab.texture.frames import FloatArray

MINI = load_sensor("gelsight-mini")
BARE: dict[str, Any] = {
    "contact": "pad",
    "roll_off_mm": 0.0,
    "elastomer_mm": 0.0,
    "dome_mm": 0.0,
    "tilt_mm_per_mm": (0.0, 0.0),
    "noise": 0.0,
}
BENT: dict[str, Any] = {"aspect_error": 0.05, "shear_error": -0.03, "k1_error": 0.04, "scale_error": 0.01}


def one_frame(tape: Tape, sensor: SensorProfile = MINI, parts: Any = None, **options: Any) -> Frame:
    return next(iterate_frames(tape, 1, 3, sensor, Scene(**options), poses=[(40.0, 20.0, 25.0)], parts=parts))


def seen_at(q_mm: FloatArray) -> FloatArray:
    """Pixels of points of `BENT` on a GelSight Mini, written down from the model's formula."""
    x, y = 16.0 * 1.01 * np.moveaxis(q_mm, -1, 0)
    straight = np.stack([1.025 * x - 0.03 * y, 0.975 * y], axis=-1)
    squares = (straight**2).sum(axis=-1, keepdims=True) / (159.5**2 + 119.5**2)
    return np.asarray((159.5, 119.5) + straight * (1 + 0.04 * squares))


def in_view(tape: Tape, board_mm: FloatArray) -> FloatArray:
    """Board points from the image centre at (40, 20) mm, 25 degrees, by SPEC: T = S + [[cos, sin], [-sin, cos]] q."""
    x0, y0 = tape.board.texture_origin_mm
    texture = np.stack([board_mm[..., 0] - x0, y0 - board_mm[..., 1]], axis=-1)
    c, s = np.cos(np.radians(25.0)), np.sin(np.radians(25.0))
    return np.asarray((texture - (40.0, 20.0)) @ np.array([[c, s], [-s, c]]))


def test_no_error_is_a_plain_scale_to_the_last_bit() -> None:
    points = np.random.default_rng(1).uniform(-12.0, 12.0, (200, 2))
    for sensor, error in ((MINI, 0.0), (replace(MINI, px_per_mm=(15.77, 12.3)), 0.031)):
        camera = true_camera(sensor, Scene(scale_error=error))
        x, y = sensor.px_per_mm
        scale = (x * (1 + error), y * (1 + error))
        px = points * scale + sensor.centre_px
        np.testing.assert_array_equal(camera.to_px(points), px)
        np.testing.assert_array_equal(camera.from_px(px), (px - sensor.centre_px) / scale)
        np.testing.assert_array_equal(camera.offsets_px(points, points[:, None]), points[:, None] * scale)
        np.testing.assert_array_equal(camera.half_field_mm, np.array([320, 240]) / scale / 2)


def test_parts_are_seen_by_the_model_s_formula(tape: Tape) -> None:
    frame = one_frame(tape, **BARE, **BENT)
    expected = seen_at(in_view(tape, tape.part_xy_mm()[frame.dots_part]))
    np.testing.assert_allclose(frame.dots_px, expected, atol=1e-9)
    assert len(frame.dots_px) > 80
    plain = one_frame(tape, **BARE)
    assert np.abs(frame.dots_px[:10] - plain.dots_px[np.isin(plain.dots_part, frame.dots_part)][:10]).max() > 3.0


def test_corners_of_parts_go_through_the_lens(tape: Tape) -> None:
    """The area of a block far from the middle is that of the quadrilateral of its corners' pixels."""
    x0, y0 = tape.board.texture_origin_mm
    for off in ((7.0, 4.0), (-6.0, -5.0), (0.0, 0.0)):
        at = np.array([x0 + 40.0 + off[0], y0 - 20.0 - off[1]])
        frame = one_frame(tape, parts=np.array([[*at, 10.0]]), **BARE, **BENT)
        along, across = 0.3 * np.array([np.cos(np.radians(10)), np.sin(np.radians(10))]), np.array([-0.0260472, 0.1477212])
        corners = seen_at(in_view(tape, at + np.array([along + across, across - along, -along - across, along - across])))
        u, v = corners.T
        area = abs((u * np.roll(v, -1) - v * np.roll(u, -1)).sum()) / 2
        assert frame.depth.sum() / 0.12 == pytest.approx(area, rel=1e-5)
        w, h = np.meshgrid(np.arange(320), np.arange(240))
        centroid = [(frame.depth * axis).sum() / frame.depth.sum() for axis in (w, h)]
        np.testing.assert_allclose(centroid, frame.dots_px[0], atol=0.01)


def test_the_scene_s_errors_add_to_the_profile_s_geometry(tape: Tape) -> None:
    told = replace(MINI, geometry=Geometry(aspect=0.03, shear=-0.03, k1=0.03))
    one = one_frame(tape, told, aspect_error=0.02, k1_error=0.01, scale_error=0.01)
    other = one_frame(tape, **BENT)
    np.testing.assert_allclose(one.dots_px, other.dots_px, atol=1e-9)
    np.testing.assert_allclose(one.depth, other.depth, atol=1e-6)


@pytest.mark.parametrize(
    "geometry", [Geometry(center_px=(170.0, 110.0)), Geometry(center_px=(170.0, 110.0), k1=-0.05, shear=0.02)]
)
def test_the_position_is_under_the_image_centre_wherever_the_lens_is(tape: Tape, geometry: Geometry) -> None:
    sensor = replace(MINI, geometry=geometry)
    view = make_view(tape, (40.0, 20.0), 25.0, sensor, Scene())
    np.testing.assert_allclose(view.to_px(np.zeros(2)), (159.5, 119.5), atol=1e-9)
    x0, y0 = tape.board.texture_origin_mm
    np.testing.assert_allclose(view.to_board(view.from_px(np.array([159.5, 119.5]))), (x0 + 40.0, y0 - 20.0), atol=1e-9)
    # two points of the image are apart on the tape by what the sensor's own camera says
    px = np.array([[30.0, 200.0], [280.0, 50.0]])
    apart = np.linalg.norm(np.subtract(*view.to_board(view.from_px(px))))
    assert apart == pytest.approx(np.linalg.norm(np.subtract(*sensor.camera.from_px(px))), abs=1e-9)


def test_pixels_and_points_are_inverse_and_the_field_holds_all_pixels() -> None:
    for sign in (1.0, -1.0):
        camera = true_camera(MINI, Scene(**{name: sign * value for name, value in BENT.items()}))
        u, v = np.meshgrid([-0.5, 0.0, 100.0, 319.5], [-0.5, 60.0, 239.5])
        px = np.stack([u, v], axis=-1)
        seen = camera.from_px(px)
        np.testing.assert_allclose(camera.to_px(seen), px, atol=1e-6)
        assert (np.abs(seen) <= camera.half_field_mm + 1e-9).all()
        assert (np.abs(seen).max(axis=(0, 1)) > camera.half_field_mm - 0.1).all()


def test_the_contact_is_placed_by_the_camera_too() -> None:
    scene = Scene(contact_offset_mm=(4.0, 2.5), contact_mm=(7.0, 6.0), **BENT)
    share, background = contact_images(scene, (240, 320), true_camera(MINI, scene))
    v, u = np.unravel_index((background - background.min()).argmax(), background.shape)
    np.testing.assert_allclose((u, v), seen_at(np.array([4.0, 2.5])), atol=8.0)  # the tilt moves the top somewhat
    points = np.array([[4.0, 2.5], [7.3, 2.5], [0.7, 2.5], [4.0, 5.4], [6.0, 4.4]])
    px = np.rint(seen_at(points)).astype(np.int64)
    np.testing.assert_allclose(share[px[:, 1], px[:, 0]], imprint(scene, points), atol=0.08)


def test_it_is_kept_for_the_scenes_used_last() -> None:
    assert true_camera(MINI, Scene(**BENT)) is true_camera(MINI, Scene(noise=2.0, **BENT))
