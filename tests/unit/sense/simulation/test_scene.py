"""Simulated depth maps: signs and scale by hand, exact coverage, and every option of a scene by what it changes."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, radians, sin
from typing import Any

import numpy as np
import pytest
from shapely.geometry import Polygon, box

from tactape_fab import Tape
from tactape_fab.sense import Frame, Scene, iterate_frames, load_sensor, simulate
from tactape_fab.sense.simulation.contact import imprint
from tactape_fab.sense.simulation.parts import parts_of, scattered
from tactape_fab.sense.simulation.pixel_coverage import add_domes, add_quads
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart

# Nothing but bodies: what is measured in the picture is where they are.
BARE: dict[str, Any] = {
    "contact": "pad",
    "elastomer_mm": 0.0,
    "dome_mm": 0.0,
    "tilt_mm_per_mm": (0.0, 0.0),
    "noise": 0.0,
}
CENTRE = np.array([159.5, 119.5])


def board(tape: Tape, x_mm: float, y_mm: float) -> tuple[float, float]:
    """A texture point on the board, by the words of docs/frames.md."""
    x0, y0 = tape.board.texture_origin_mm
    return x0 + x_mm, y0 - y_mm


def centroid(depth: FloatArray) -> FloatArray:
    v, u = np.indices(depth.shape)
    return np.asarray(np.array([(depth * u).sum(), (depth * v).sum()]) / depth.sum())


def spread(depth: FloatArray) -> FloatArray:
    """Second moments [[uu, uv], [uv, vv]] about the centroid, px^2."""
    v, u = np.indices(depth.shape)
    off = np.stack([u, v], axis=-1) - centroid(depth)
    return np.asarray(np.einsum("ij,ijk,ijl->kl", depth, off, off) / depth.sum())


def one_frame(tape: Tape, pose: tuple[float, float, float] = (40.0, 20.0, 25.0), seed: int = 3, **options: Any) -> Frame:
    return next(iterate_frames(tape, 1, seed, scene=Scene(**options), poses=[pose]))


# --- signs and scale -------------------------------------------------------------------------------------------------


def test_the_worked_example_of_the_contract(tape: Tape) -> None:
    """S = (20, 12), 30 degrees, 16 px/mm: the pixel 16 px right of the centre sees (20 + cos 30, 12 - sin 30)."""
    part = board(tape, 20 + cos(radians(30)), 12 - sin(radians(30)))
    depth = simulate(tape, (20.0, 12.0), 30.0, parts=[part], **BARE)
    assert depth.shape == (240, 320)
    assert depth.dtype == np.float32
    assert centroid(depth.astype(np.float64)) == pytest.approx(CENTRE + np.array([16.0, 0.0]), abs=1e-4)
    assert depth.max() == pytest.approx(0.12, abs=1e-7)
    assert depth.sum() == pytest.approx(0.12 * 0.6 * 0.3 * 16 * 16, rel=1e-6)


@pytest.mark.parametrize(
    ("theta_deg", "shift_of_north"), [(0.0, (0.0, -4.0)), (90.0, (4.0, 0.0)), (180.0, (0.0, 4.0)), (-90.0, (-4.0, 0.0))]
)
def test_the_pattern_looks_turned_clockwise_by_theta(tape: Tape, theta_deg: float, shift_of_north: tuple[float, float]) -> None:
    depth = simulate(tape, (30.0, 15.0), theta_deg, parts=[board(tape, 30.0, 15.0 - 0.25)], **BARE)
    assert centroid(depth.astype(np.float64)) - CENTRE == pytest.approx(shift_of_north, abs=1e-4)


@pytest.mark.parametrize(("letter", "shift"), [("N", (0, -4)), ("S", (0, 4)), ("W", (-4, 0)), ("E", (4, 0))])
def test_symbols_lean_to_their_side(tape: Tape, letter: str, shift: tuple[int, int]) -> None:
    rows = tape.to_mapping()["symbols"]
    row = next(r for r in range(5, 20) if letter in rows[r][8:40])
    column = rows[row].index(letter, 8)
    depth = simulate(tape, (column * 1.5, row * 1.5), 0.0, **BARE).astype(np.float64)
    near = depth[110:130, 150:170]  # no neighbour reaches into it
    assert centroid(near) - 9.5 == pytest.approx(shift, abs=0.01)


def test_parts_point_up_and_right_on_an_unturned_sensor(tape: Tape) -> None:
    """45 degrees counter-clockwise seen from above: v falls as u rises along the body; turned by 45 it lies along u."""
    where = [board(tape, 20.0, 12.0)]
    upright = spread(simulate(tape, (20.0, 12.0), 0.0, parts=where, **BARE).astype(np.float64))
    assert upright[0, 1] == pytest.approx(-((0.6**2 - 0.3**2) * 16**2) / 24, rel=0.01)
    assert upright[0, 0] == pytest.approx(upright[1, 1], rel=1e-6)
    along = spread(simulate(tape, (20.0, 12.0), 45.0, parts=where, **BARE).astype(np.float64))
    assert along[0, 0] == pytest.approx((0.6 * 16) ** 2 / 12, abs=0.1)
    assert along[1, 1] == pytest.approx((0.3 * 16) ** 2 / 12, abs=0.2)


def test_each_axis_has_its_scale(tape: Tape) -> None:
    sensor = replace(load_sensor("generic"), px_per_mm=(16.0, 12.0))
    right = simulate(tape, (30.0, 15.0), 0.0, sensor=sensor, parts=[board(tape, 31.0, 15.0)], **BARE)
    down = simulate(tape, (30.0, 15.0), 0.0, sensor=sensor, parts=[board(tape, 30.0, 16.0)], **BARE)
    assert centroid(right.astype(np.float64)) - CENTRE == pytest.approx((16.0, 0.0), abs=1e-4)
    assert centroid(down.astype(np.float64)) - CENTRE == pytest.approx((0.0, 12.0), abs=1e-4)


def test_truth_is_where_the_picture_has_it(tape: Tape) -> None:
    frame = one_frame(tape, **BARE)
    assert len(frame.dots_px) > 100
    for (u, v), part in zip(frame.dots_px, frame.dots_part, strict=True):
        if not (12 < u < 307 and 12 < v < 227):
            continue
        top, left = round(v) - 8, round(u) - 8
        found = centroid(frame.depth[top : top + 17, left : left + 17].astype(np.float64)) + np.array([left, top])
        assert found == pytest.approx((u, v), abs=0.01)
        x, y = tape.part_xy_mm()[part] - np.array(board(tape, 40.0, 20.0))
        c, s = cos(radians(25)), sin(radians(25))
        assert (u - 159.5, v - 119.5) == pytest.approx((16 * (c * x + s * y), 16 * (s * x - c * y)), abs=1e-6)


# --- bodies ----------------------------------------------------------------------------------------------------------


def quads(count: int, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0, 2 * pi, count)
    turn[:4] = np.arange(4) * pi / 2
    along = np.stack([np.cos(turn), np.sin(turn)], axis=-1) * rng.uniform(0.2, 5.0, (count, 1))
    across = along[:, ::-1] * (-1.0, 1.0) * rng.uniform(0.1, 1.0, (count, 1))
    corners = np.stack([along + across, across - along, -along - across, along - across], axis=1)
    return np.asarray(corners + rng.uniform(-2, 32, (count, 1, 2)))


@pytest.mark.parametrize("reverse", [False, True])
def test_coverage_is_exact(reverse: bool) -> None:
    for corners in quads(40, 1):
        image = np.zeros((30, 31))
        add_quads(image, corners[None, ::-1] if reverse else corners[None], 1.0)
        shape = Polygon(corners)
        for v, u in np.ndindex(image.shape):
            pixel = box(u - 0.5, v - 0.5, u + 0.5, v + 0.5)
            if image[v, u] or shape.intersects(pixel):
                assert image[v, u] == pytest.approx(shape.intersection(pixel).area, abs=1e-9)


def test_coverage_of_many_at_once_is_the_sum_and_agrees_with_samples() -> None:
    corners = quads(25, 2)
    together, apart = np.zeros((30, 31)), np.zeros((30, 31))
    add_quads(together, corners, 0.5)
    for one in corners:
        add_quads(apart, one[None], 0.5)
    assert together == pytest.approx(apart, abs=1e-12)
    at = (np.arange(30 * 16) + 0.5) / 16 - 0.5
    across = (np.arange(31 * 16) + 0.5) / 16 - 0.5
    sampled = np.zeros((30, 31))
    for one in corners:
        edges = np.roll(one, -1, axis=0) - one
        inside = np.ones((len(at), len(across)), dtype=bool)
        for (x, y), (dx, dy) in zip(one, edges, strict=True):
            inside &= dx * (at[:, None] - y) - dy * (across - x) >= 0
        sampled += 0.5 * inside.reshape(30, 16, 31, 16).mean(axis=(1, 3))
    assert np.abs(together - sampled).max() < 0.02
    assert together.sum() == pytest.approx(sampled.sum(), rel=1e-3)


@pytest.mark.parametrize("top", [None, 0.2])
def test_a_dome_has_its_volume_height_and_place(top: float | None) -> None:
    image = np.zeros((60, 70))
    centre, scale, foot, height = np.array([[30.3, 25.8]]), (16.0, 16.0), 0.5, 0.2
    cap = None if top is not None else height
    add_domes(image, centre, scale, np.array([foot]), np.array([top or 0.0]), np.array([height]), cap)
    a, b = foot * 16, (top or 0.0) * 16
    volume = pi * height * (3 * a**2 + (height * 16) ** 2) / 6 if top is None else pi * height * (a * a + a * b + b * b) / 3
    assert image.sum() == pytest.approx(volume, rel=0.003)
    assert image.max() == pytest.approx(height, rel=0.01)
    assert centroid(image) == pytest.approx((30.3, 25.8), abs=0.01)


def test_a_dome_part_is_round_and_a_cone_flat(tape: Tape) -> None:
    where, dome = [board(tape, 20.0, 12.0)], TapePart(name="d", shape="dome", body_mm=(1.0, 1.0, 0.2), rotation_deg=45.0)
    cap = simulate(replace(tape, part=dome), (20.0, 12.0), 10.0, parts=where, **BARE)
    cone = simulate(replace(tape, part=replace(dome, top_mm=0.5)), (20.0, 12.0), 10.0, parts=where, **BARE)
    for depth in (cap, cone):
        moments = spread(depth.astype(np.float64))
        assert moments[0, 0] == pytest.approx(moments[1, 1], rel=0.01)
        assert abs(moments[0, 1]) < 0.05
    assert (cone > 0.1199).sum() == pytest.approx(pi * (0.25 * 16) ** 2, rel=0.25)
    assert 0.118 < cap.max() < 0.12
    assert (cap > 0.1199).sum() < 5


def test_bodies_leave_the_picture_without_a_trace_of_wrapping(tape: Tape) -> None:
    depth = simulate(tape, (30.0, 15.0), 0.0, parts=[board(tape, 40.0, 15.0), board(tape, 30.0, 22.5)], **BARE)
    assert depth[:, 310:].sum() > 1.0
    assert depth[230:].sum() > 1.0
    assert depth[:230, :310].sum() == 0.0


def test_beyond_the_outline_the_surface_falls_by_the_film(tape: Tape) -> None:
    x0 = tape.board.texture_origin_mm[0]
    depth = simulate(tape, (-x0, 20.0), 0.0, parts=np.empty((0, 2)), **{**BARE, "dome_mm": 0.3, "contact": "pad"})
    assert depth[120, 200] - depth[120, 100] == pytest.approx(0.11, abs=1e-6)
    edge = simulate(tape, (-x0 + 0.25 / 16, 20.0), 0.0, parts=np.empty((0, 2)), **{**BARE, "dome_mm": 0.3})
    assert depth[120, 200] - edge[120, 159] == pytest.approx(0.11 * 0.75, abs=1e-4)
    thick = replace(tape, board=replace(tape.board, thickness_mm=3.0))
    deep = simulate(thick, (-x0, 20.0), 0.0, parts=np.empty((0, 2)), **{**BARE, "dome_mm": 0.3})
    assert deep[120, 200] - deep[120, 100] == pytest.approx(0.3, abs=1e-6)


# --- the contact -----------------------------------------------------------------------------------------------------


def test_an_ellipse_has_its_axes_its_place_and_its_turn(tape: Tape) -> None:
    scene = Scene(contact_mm=(8.0, 4.0), contact_offset_mm=(2.0, -1.0), contact_turn_deg=30.0)
    along, across = np.array([cos(radians(30)), -sin(radians(30))]), np.array([sin(radians(30)), cos(radians(30))])
    centre = np.array([2.0, -1.0])
    on_the_outline = np.array([centre + 4 * along, centre - 4 * along, centre + 2 * across, centre - 2 * across])
    assert imprint(scene, on_the_outline) == pytest.approx([0.5] * 4)
    assert imprint(scene, centre) == 1.0
    assert imprint(scene, centre + 3.5 * along) == 1.0
    assert imprint(scene, np.stack([centre + 4.5 * along, centre + 2.5 * across])).tolist() == [0.0, 0.0]
    frame = one_frame(tape, contact_mm=(8.0, 4.0), contact_offset_mm=(2.0, -1.0))
    assert frame.contact_px.tolist() == [159.5 + 32, 119.5 - 16]


def test_contact_sizes_give_the_dots_that_fit_in(tape: Tape) -> None:
    for size in ((11.0, 9.0), (6.0, 6.0)):
        frames = iterate_frames(tape, 60, 1, scene=Scene(contact_mm=size))
        inside = np.mean([(f.dots_imprint >= 0.5).sum() for f in frames])
        assert inside == pytest.approx(pi / 4 * size[0] * size[1] / 1.5**2, rel=0.03)


def test_roll_off_is_as_wide_as_said() -> None:
    at = np.stack([np.linspace(0, 8, 801), np.zeros(801)], axis=-1)
    for width in (0.4, 2.0):
        share = imprint(Scene(roll_off_mm=width), at)
        fading = at[(share > 0) & (share < 1), 0]
        assert np.ptp(fading) == pytest.approx(width, abs=0.03)
        assert fading.mean() == pytest.approx(5.5, abs=0.02)
        assert (np.diff(share) <= 0).all()
    assert set(imprint(Scene(roll_off_mm=0.0), at)) == {0.0, 1.0}


@pytest.mark.parametrize(("radius", "width"), [(15.7, 6.14), (10.0, 4.90)])
def test_a_strip_is_as_wide_as_its_cylinder_sinks_in(tape: Tape, radius: float, width: float) -> None:
    scene = Scene(contact="strip", cylinder_radius_mm=radius, contact_turn_deg=90.0)
    assert 2 * scene.strip_half_mm == pytest.approx(width, abs=0.01)
    assert imprint(scene, np.array([(width / 2, 3.0), (-width / 2, -7.0)])) == pytest.approx([0.5, 0.5], abs=0.01)
    assert Scene(contact="strip", strip_width_mm=4.5).strip_half_mm == 2.25
    depth = simulate(tape, (40.0, 20.0), 0.0, scene=scene, parts=np.empty((0, 2)), **{**BARE, "contact": "strip", "dome_mm": 0.3})
    u = (np.arange(320) - 159.5) / 16
    near = np.abs(u) < 2
    assert depth[100, near] - depth[100].max() == pytest.approx(-(u[near] ** 2) / (2 * radius), abs=1e-3)
    assert (depth == depth[:1]).all()


def test_a_cylinder_shows_its_flanks_foreshortened(tape: Tape) -> None:
    """Tops over an arc of 2 mm on a radius of 10 mm are seen 10.23 sin(0.2) mm from the axis; along it nothing changes."""
    options = {
        **BARE,
        "contact": "strip",
        "cylinder_radius_mm": 10.0,
        "contact_turn_deg": 90.0,
        "strip_width_mm": 12.0,
        "dome_mm": 0.0,
    }
    where = [board(tape, 32.0, 12.0)]
    dots = next(iterate_frames(tape, 1, scene=Scene(**options), poses=[(30.0, 15.0, 0.0)], parts=where)).dots_px
    assert dots[0] - CENTRE == pytest.approx((16 * 10.23 * sin(0.2), -48.0), abs=1e-6)
    offset = {**options, "contact_offset_mm": (3.0, 0.0)}
    still = next(iterate_frames(tape, 1, scene=Scene(**offset), poses=[(30.0, 15.0, 0.0)], parts=[board(tape, 30.0, 15.0)]))
    assert still.dots_px[0] == pytest.approx(CENTRE, abs=1e-6)


def test_background_is_smooth_as_high_as_said_and_tilted(tape: Tape) -> None:
    options = {**BARE, "contact": "ellipse", "dome_mm": 0.3, "parts": np.empty((0, 2))}
    flat = simulate(tape, (40.0, 20.0), 0.0, **options).astype(np.float64)
    assert flat.max() == pytest.approx(0.3, abs=1e-4)
    assert flat[120, 160 + 88] == pytest.approx(0.15, abs=0.002)
    assert flat[0, 0] < 0.03
    assert np.abs(np.diff(flat, 2, axis=1)).max() < 0.001
    tilted = simulate(tape, (40.0, 20.0), 0.0, **{**options, "tilt_mm_per_mm": (0.02, -0.01)}).astype(np.float64)
    slope = (tilted - flat)[120, 319] - (tilted - flat)[120, 0], (tilted - flat)[239, 0] - (tilted - flat)[0, 0]
    assert slope == pytest.approx((0.02 * 319 / 16, -0.01 * 239 / 16), abs=1e-5)


def test_the_elastomer_widens_a_part_by_its_own_spread(tape: Tape) -> None:
    where = [board(tape, 20.0, 12.0)]
    sharp = spread(simulate(tape, (20.0, 12.0), 45.0, parts=where, **BARE).astype(np.float64))
    for sigma_mm in (0.15, 0.25):
        soft = simulate(tape, (20.0, 12.0), 45.0, parts=where, **{**BARE, "elastomer_mm": sigma_mm}).astype(np.float64)
        widened = np.diag(spread(soft) - sharp)
        assert widened == pytest.approx([(sigma_mm * 16) ** 2] * 2, rel=0.02)
        assert soft.sum() == pytest.approx(0.12 * 0.6 * 0.3 * 256, rel=1e-4)
    tall = simulate(tape, (20.0, 12.0), 45.0, parts=where, **{**BARE, "texture_mm": 0.2})
    assert tall.max() == pytest.approx(0.2)


# --- noise and defects -----------------------------------------------------------------------------------------------


def noise_of(tape: Tape, **options: Any) -> FloatArray:
    """Noise alone, mm, and enough of it to measure."""
    bare = {**BARE, "noise": 1.0, **options}
    frames = [simulate(tape, (40.0, 20.0), 0.0, seed=s, parts=np.empty((0, 2)), **bare) for s in range(20)]
    return np.stack(frames).astype(np.float64)


def test_white_noise_is_white_and_as_strong_as_said(tape: Tape) -> None:
    noise = noise_of(tape, correlated_um=0.0)
    assert noise.std() == pytest.approx(0.004, rel=0.01)
    assert abs(np.corrcoef(noise[:, :, 1:].ravel(), noise[:, :, :-1].ravel())[0, 1]) < 0.01
    assert noise_of(tape, correlated_um=0.0, white_um=7.0, noise=2.0).std() == pytest.approx(0.014, rel=0.01)


def test_correlated_noise_has_its_strength_everywhere_and_its_size(tape: Tape) -> None:
    noise = noise_of(tape, white_um=0.0)
    assert noise.std() == pytest.approx(0.010, rel=0.03)
    rim = np.concatenate([noise[:, :3].ravel(), noise[:, -3:].ravel(), noise[:, :, :3].ravel(), noise[:, :, -3:].ravel()])
    assert rim.std() == pytest.approx(0.010, rel=0.15)
    for lag in (6, 12):  # a Gaussian kernel of s px gives the correlation exp(-lag^2 / 4 s^2)
        found = np.corrcoef(noise[:, :, lag:].ravel(), noise[:, :, :-lag].ravel())[0, 1]
        assert found == pytest.approx(np.exp(-(lag**2) / (4 * 6.0**2)), abs=0.05)
    assert noise_of(tape, white_um=0.0, correlated_um=20.0, correlated_px=3.0).std() == pytest.approx(0.020, rel=0.03)


def test_noise_and_defects_do_not_change_each_other(tape: Tape) -> None:
    with_noise, without = (
        one_frame(tape, missing=0.2, placement_mm=0.05),
        one_frame(tape, missing=0.2, placement_mm=0.05, noise=0.0),
    )
    assert (with_noise.dots_px == without.dots_px).all()
    assert (with_noise.dots_part == without.dots_part).all()
    noise = with_noise.depth - without.depth
    other = one_frame(tape).depth - one_frame(tape, noise=0.0).depth
    assert np.abs(noise - other).max() < 1e-6


def test_missing_parts_are_gone_from_truth_and_picture(tape: Tape) -> None:
    whole = [f.dots_part for f in iterate_frames(tape, 60, 5)]
    left = [f.dots_part for f in iterate_frames(tape, 60, 5, scene=Scene(missing=0.3))]
    assert all(set(b) <= set(a) for a, b in zip(whole, left, strict=True))
    assert sum(map(len, left)) / sum(map(len, whole)) == pytest.approx(0.7, abs=0.03)
    everything = one_frame(tape, **{**BARE, "missing": 1.0})
    assert len(everything.dots_px) == 0
    assert not everything.depth.any()


def test_bumps_are_as_many_as_said_and_no_parts(tape: Tape) -> None:
    bare = {**BARE, "contact": "ellipse", "missing": 1.0}
    frame = one_frame(tape, **bare, bumps=1)
    assert len(frame.dots_px) == 0
    v, u = np.nonzero(frame.depth)
    assert np.hypot((u.mean() - 159.5) / 88, (v.mean() - 119.5) / 72) <= 1.05
    sums = [one_frame(tape, **bare, bumps=n, seed=9).depth.sum() for n in (0, 5, 20)]
    assert sums[0] == 0.0
    assert 2 < sums[2] / sums[1] < 8


def test_placement_and_rotation_scatter_as_said(tape: Tape) -> None:
    off = []
    for k in range(20):
        nominal, placed = one_frame(tape, seed=k, contact="pad"), one_frame(tape, seed=k, contact="pad", placement_mm=0.05)
        common, a, b = np.intersect1d(nominal.dots_part, placed.dots_part, return_indices=True)
        assert len(common) > 100
        off.append((placed.dots_px[b] - nominal.dots_px[a]) / 16)
    assert np.concatenate(off).std(axis=0) == pytest.approx([0.05, 0.05], rel=0.05)
    turned, there = scattered(parts_of(tape), Scene(rotation_deg=5.0), np.random.default_rng(1))
    assert (turned.rotation_deg - 45.0).std() == pytest.approx(5.0, rel=0.05)
    assert there.all()
    assert (turned.xy_mm == tape.part_xy_mm()).all()
    straight, crooked = one_frame(tape, **BARE), one_frame(tape, **{**BARE, "rotation_deg": 10.0})
    assert (straight.dots_px == crooked.dots_px).all()
    assert np.abs(straight.depth - crooked.depth).max() > 0.05


def test_scale_error_stretches_the_picture(tape: Tape) -> None:
    right, wide = one_frame(tape, contact="pad"), one_frame(tape, contact="pad", scale_error=0.06)
    common, a, b = np.intersect1d(right.dots_part, wide.dots_part, return_indices=True)
    assert len(common) > 100
    assert (wide.dots_px[b] - CENTRE) == pytest.approx((right.dots_px[a] - CENTRE) * 1.06)


def test_a_mirrored_tape_is_the_mirror_image(tape: Tape) -> None:
    x0 = tape.board.texture_origin_mm[0]
    right = simulate(tape, (40.0, 20.0), 25.0, **{**BARE, "contact": "ellipse"})
    mirrored = simulate(tape, (100.0 - 2 * x0 - 40.0, 20.0), -25.0, mirrored_tape=True, **{**BARE, "contact": "ellipse"})
    assert np.abs(right - mirrored[:, ::-1]).max() < 1e-6
    assert np.abs(right - mirrored).max() > 0.1


@pytest.mark.parametrize(("options", "left_um"), [({}, 1.5), ({"noise_model": "smooth"}, 7.0)])
def test_noise_after_a_mean_filter_is_that_of_the_model(tape: Tape, options: dict[str, Any], left_um: float) -> None:
    """Slopes of 0.032 leave 1.5 um after a mean filter of 25 px, as one real sensor; white 4 um and blobs of 10 um leave 7."""
    noise = noise_of(tape, **options)
    summed = noise.cumsum(axis=1).cumsum(axis=2)
    mean = (summed[:, 25:, 25:] - summed[:, :-25, 25:] - summed[:, 25:, :-25] + summed[:, :-25, :-25]) / 625
    left = noise[:, 13 : 13 + mean.shape[1], 13 : 13 + mean.shape[2]] - mean
    assert left.std() == pytest.approx(left_um / 1000, rel=0.06)


def test_the_blur_is_the_sensors_own_unless_a_scene_gives_one(tape: Tape) -> None:
    """0.15 mm was drawn for every gel, and `advise` and the decoder took the profile's: promised and drawn contacts differed."""
    mini = load_sensor("gelsight-mini")
    soft = replace(mini, gel=replace(mini.gel, blur_mm=0.3))
    drawn = ((soft, Scene()), (mini, Scene(elastomer_mm=0.3)), (soft, Scene(elastomer_mm=0.15)), (mini, Scene()))
    own, given, usual, usually = (simulate(tape, (20.0, 12.0), 45.0, sensor=sensor, scene=scene) for sensor, scene in drawn)
    np.testing.assert_array_equal(own, given)
    np.testing.assert_array_equal(usual, usually)
    assert np.abs(own - usual).max() > 0.01
