"""Elastic contact against Hertz, Dimitriadis and a layer in uniaxial strain, and the picture of a tape by where its parts are."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import cos, pi, radians, sin, sqrt, tan
from typing import Any

import numpy as np
import pytest

from tactape_fab import Localizer, Tape
from tactape_fab.base.errors import SpecError
from tactape_fab.sense import (
    ElasticContact,
    Frame,
    Scene,
    SensorProfile,
    draw_poses,
    iterate_frames,
    load_sensor,
    simulate,
    simulate_forces,
)
from tactape_fab.sense.geometry import Gel
from tactape_fab.sense.simulation.dot_errors import dots_of
from tactape_fab.sense.simulation.draw import placed
from tactape_fab.sense.simulation.elastic import Imprint, imprint_of, integrated
from tactape_fab.sense.simulation.elastic_layer import Layer, compliance, deflection, press_rigid, response
from tactape_fab.sense.simulation.parts import as_parts
from tactape_fab.sense.simulation.view import make_view
from tactape_fab.texture.frames import FloatArray

PLAIN: dict[str, Any] = {"blur_mm": 0.0, "slope_limit": None}
"""The gel's surface itself."""
POSE = (40.0, 20.0, 25.0)


def small_sensor(px_per_mm: float, size_mm: tuple[float, float] = (6.0, 5.0)) -> SensorProfile:
    width, height = (round(side * px_per_mm) for side in size_mm)
    return replace(load_sensor("generic"), px_per_mm=(px_per_mm,) * 2, width_px=width, height_px=height)


def pressed(tape: Tape, sensor: SensorProfile, **options: Any) -> Frame:
    scene = Scene(elastic=ElasticContact(**{**PLAIN, **options}), noise=0.0)
    return next(iterate_frames(tape, 1, 0, sensor, scene, poses=[POSE]))


def imprint(tape: Tape, sensor: SensorProfile, elastic: ElasticContact) -> tuple[Imprint, FloatArray]:
    """The gel at `POSE`, and the true places of the parts in view, px."""
    view = make_view(tape, POSE[:2], POSE[2], sensor, Scene(elastic=elastic))
    _, seen, at_mm, *bumps, _ = placed(view, as_parts(tape, None), np.random.SeedSequence(0))
    return imprint_of(view, seen, at_mm, *bumps), view.to_px(at_mm)


# The layer


def ball(radius_mm: float, field_mm: float, px_per_mm: float) -> FloatArray:
    """Distance of a sphere from a plane that it touches in the middle of the field."""
    at = (np.arange(round(field_mm * px_per_mm)) + 0.5) / px_per_mm - field_mm / 2
    return np.asarray(radius_mm - np.sqrt(radius_mm**2 - at**2 - at[:, None] ** 2))


def test_a_ball_on_a_thick_layer_is_that_of_hertz() -> None:
    layer, radius, force, scale = Layer(40.0, 0.275, 0.485), 8.0, 0.013, 32.0
    modulus = 0.275 / (1 - 0.485**2)
    contact = (3 * force * radius / (4 * modulus)) ** (1 / 3)
    found = press_rigid(ball(radius, 4.0, scale), force * scale**2, response((128, 128), (scale, scale), layer))
    pressure = found.pressure_mpa
    assert sqrt((pressure > 0).sum() / pi) / scale == pytest.approx(contact, rel=0.02)
    assert pressure.sum() / scale**2 == pytest.approx(force, rel=1e-9)
    assert pressure.max() == pytest.approx(3 * force / (2 * pi * contact**2), rel=0.02)
    squares = ((np.indices((128, 128)) - 63.5) ** 2).sum(axis=0) / (scale * contact) ** 2
    hertz = pressure.max() * np.sqrt(np.maximum(1 - squares, 0.0))
    assert np.abs(pressure - hertz)[np.abs(squares - 1) > 0.2].max() < 0.02 * pressure.max()


@pytest.mark.parametrize("thickness_mm", [2.0, 4.0])
def test_a_ball_on_a_thin_layer_is_that_of_dimitriadis(thickness_mm: float) -> None:
    """Biophysical Journal 82, 2002: a sphere on a bonded incompressible layer, series in sqrt(R depth) / h."""
    modulus, radius, force, scale = 0.275, 4.0, 0.02, 32.0
    of = response((128, 128), (scale, scale), Layer(thickness_mm, modulus, 0.4999))
    found = press_rigid(ball(radius, 4.0, scale), force * scale**2, of)
    depth = float(found.deflection_mm[63:65, 63:65].mean())
    chi = sqrt(radius * depth) / thickness_mm
    assert 0.05 < chi < 0.3
    series = 1 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3 + 0.0975 * chi**4
    assert 16 / 9 * modulus * sqrt(radius) * depth**1.5 * series == pytest.approx(force, rel=0.03)


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.485, 0.4999])
def test_an_even_pressure_squeezes_the_layer_in_uniaxial_strain(poisson: float) -> None:
    layer = Layer(0.2, 0.275, poisson)
    uniaxial = 0.2 * (1 + poisson) * (1 - 2 * poisson) / (0.275 * (1 - poisson))
    assert compliance(0.0, layer) == pytest.approx(uniaxial, rel=1e-12)
    assert compliance(0.02, layer) == pytest.approx(uniaxial, rel=1e-4 / (1 - 2 * poisson))
    if poisson < 0.49:  # near incompressible, edges reach further than this field
        middle = deflection(np.full((160, 160), 0.01), response((160, 160), (16.0, 16.0), layer))[70:90, 70:90]
        np.testing.assert_allclose(middle, 0.01 * uniaxial, rtol=1e-3)
    half_space = 2 * (1 - poisson**2) / (0.275 * 500.0)
    assert compliance(500.0, layer) == pytest.approx(half_space, rel=1e-6)


def test_periodic_images_do_not_matter() -> None:
    layer, force = Layer(4.0, 0.275, 0.485), np.zeros((80, 96))
    force[60:80, 70:96] = 0.01
    wide = np.zeros((400, 480))
    wide[:80, :96] = force
    near, far = (deflection(p, response(p.shape, (8.0, 8.0), layer))[:80, :96] for p in (force, wide))
    assert np.abs(near - far).max() < 0.005 * near.max()


# The contact


@pytest.mark.parametrize("options", [{"force_n": 0.5}, {"force_n": 10.0, "tilt_deg": (2.0, -1.0)}, {"cylinder_radius_mm": 12.0}])
def test_pressure_and_gap_exclude_each_other(tape: Tape, options: dict[str, Any]) -> None:
    elastic = ElasticContact(**PLAIN, **options)
    found, _ = imprint(tape, small_sensor(16.0), elastic)
    assert found.pressure_mpa.sum() / 16**2 == pytest.approx(elastic.force_n, rel=1e-9)
    assert found.pressure_mpa.min() == 0.0
    assert found.gap_mm.min() > -3e-4
    assert np.abs(found.gap_mm[found.pressure_mpa > 0]).max() < 3e-4
    bent = deflection(found.pressure_mpa, response(found.depth.shape, (16.0, 16.0), Layer(4.0, 0.275, 0.485)))
    np.testing.assert_allclose(found.depth, bent, atol=1e-6)


def test_a_finer_grid_gives_the_same_surface(tape: Tape) -> None:
    coarse, fine = (pressed(tape, small_sensor(scale), force_n=1.0).depth for scale in (16.0, 32.0))
    halved = fine.reshape(80, 2, 96, 2).mean(axis=(1, 3))
    inside = (slice(4, -4), slice(4, -4))
    gain, _ = np.polyfit(halved[inside].ravel(), coarse[inside].ravel(), 1)
    assert coarse.max() > 0.15
    assert gain == pytest.approx(1.0, abs=0.03)
    assert (coarse - halved)[inside].std() < 0.006


def test_rising_forces_are_those_solved_alone(tape: Tape) -> None:
    sensor, scene = small_sensor(16.0), Scene(elastic=ElasticContact(tilt_deg=(1.0, 2.0)), bumps=1, missing=0.05)
    together = simulate_forces(tape, POSE[:2], POSE[2], (0.3, 1.0, 4.0), sensor=sensor, scene=scene, seed=5)
    for depth, force in zip(together, (0.3, 1.0, 4.0), strict=True):
        elastic = ElasticContact(tilt_deg=(1.0, 2.0), force_n=force)
        alone = simulate(tape, POSE[:2], POSE[2], sensor=sensor, scene=scene, seed=5, elastic=elastic)
        assert np.abs(depth - alone).max() < 3e-4
    assert np.all([b.max() > a.max() + 0.05 for a, b in pairwise(together)])


def test_a_stiffer_or_thinner_gel_gives_way_less(tape: Tape) -> None:
    sensor = small_sensor(16.0)
    deepest = pressed(tape, sensor).depth.max()
    assert pressed(tape, sensor, modulus_kpa=550.0).depth.max() < 0.9 * deepest
    assert pressed(tape, sensor, thickness_mm=1.0).depth.max() < 0.9 * deepest
    told = replace(sensor, gel=Gel(thickness_mm=1.0, modulus_kpa=550.0))
    explicit = pressed(tape, sensor, thickness_mm=1.0, modulus_kpa=550.0).depth
    np.testing.assert_array_equal(pressed(tape, told).depth, explicit)


# Where parts are seen


def middle_of_tops(found: Imprint, dots_px: FloatArray) -> FloatArray:
    """Centres of the contact with parts whose top the gel touches all over, and that stand alone, less their true places; px."""
    offsets = []
    for u, v in dots_px:
        left, top = round(u) - 6, round(v) - 6  # a window of 0.8 mm
        window = found.pressure_mpa[max(top, 0) : top + 13, max(left, 0) : left + 13] > 0
        if window.shape != (13, 13) or not window[3:10, 3:10].any() or np.concatenate([window[::12].T, window[:, ::12]]).any():
            continue
        if window.sum() > 35:
            offsets.append(np.argwhere(window).mean(axis=0)[::-1] + np.array([left - u, top - v]))
    return np.array(offsets)


@pytest.mark.parametrize(
    "options",
    [{}, {"tilt_deg": (3.0, 0.0)}, {"tilt_deg": (-2.0, 3.0)}, {"cylinder_radius_mm": 12.0}, {"cylinder_radius_mm": 40.0}],
)
def test_parts_are_felt_where_they_are_said(tape: Tape, options: dict[str, Any]) -> None:
    found, dots_px = imprint(tape, load_sensor("gelsight-mini"), ElasticContact(force_n=3.0, **options))
    off = middle_of_tops(found, dots_px)
    assert len(off) > 12
    assert np.abs(np.median(off, axis=0)).max() < 0.15
    assert np.abs(off).max() < 1.2


def truth(tape: Tape, x_mm: float, y_mm: float, **options: Any) -> FloatArray:
    """Where a part is said to be that lies x and y from S along image u and v; mm from the image centre."""
    x0, y0 = tape.board.texture_origin_mm
    view = make_view(tape, (30.0, 15.0), 0.0, load_sensor("generic"), Scene(elastic=ElasticContact(**options)))
    return np.asarray(view.from_board(np.array([x0 + 30.0 + x_mm, y0 - 15.0 - y_mm])))


def test_a_tilted_tape_is_shortened_along_its_slope(tape: Tape) -> None:
    c = cos(radians(8.0))
    assert truth(tape, 3.0, 2.0) == pytest.approx((3.0, 2.0))
    assert truth(tape, 3.0, 2.0, tilt_deg=(8.0, 0.0)) == pytest.approx((3.0 * c, 2.0))
    assert truth(tape, 3.0, 2.0, tilt_deg=(0.0, -8.0)) == pytest.approx((3.0, 2.0 * c))
    oblique = truth(tape, 3.0, 3.0, tilt_deg=(8.0, 8.0))
    assert oblique == pytest.approx(np.array([3.0, 3.0]) / sqrt(1 + 2 * tan(radians(8.0)) ** 2))


def test_on_a_cylinder_tops_are_seen_above_the_film(tape: Tape) -> None:
    assert truth(tape, 3.0, 2.0, cylinder_radius_mm=12.0) == pytest.approx((3.0, 12.23 * sin(2.0 / 12.0)))


def test_a_tilt_across_a_cylinder_moves_its_top_line(tape: Tape) -> None:
    """Film of 2 mm either way ends where the arc of the surface that the gel is pressed on is as long, by small steps."""
    slope, radius_mm = tan(radians(3.0)), 12.23
    at = np.linspace(-3.0, 3.0, 600_001)
    steps = np.sqrt(1.0 + (slope - at / np.sqrt(radius_mm**2 - at**2)) ** 2) * 12.0 / radius_mm
    arc = np.concatenate([[0.0], np.cumsum(0.5 * (steps[1:] + steps[:-1]) * np.diff(at))])
    for y_mm in (2.0, -2.0):
        expected = np.interp(arc[300_000] + y_mm, arc, at)
        seen = truth(tape, 3.0, y_mm, cylinder_radius_mm=12.0, tilt_deg=(0.0, 3.0))
        assert seen == pytest.approx((3.0, expected), abs=1e-3)  # 9 um beside it, were the top line where it is without tilt
    along = truth(tape, 3.0, 2.0, cylinder_radius_mm=12.0, tilt_deg=(8.0, 0.0))
    assert along == pytest.approx((3.0 * cos(radians(8.0)), 12.23 * sin(2.0 / 12.0)))


def test_what_rises_is_pressed_further_in(tape: Tape) -> None:
    sensor = load_sensor("gelsight-mini")
    flat, right, down = (pressed(tape, sensor, tilt_deg=tilt) for tilt in ((0.0, 0.0), (2.0, 0.0), (0.0, 2.0)))
    assert np.abs(flat.contact_px - sensor.centre_px).max() < 8.0
    assert right.contact_px[0] - flat.contact_px[0] > 50.0
    assert down.contact_px[1] - flat.contact_px[1] > 30.0
    assert flat.dots_imprint.min() > 0.0
    assert 60 < len(flat.dots_px) < 133


def test_the_decoder_finds_presses(tape: Tape) -> None:
    localizer, scene = Localizer([tape], sensor="gelsight-mini"), Scene(elastic=ElasticContact(force_n=2.0))
    for frame in iterate_frames(tape, 4, 3, scene=scene, poses=draw_poses(tape, 4, 3, scene=scene)):
        fix = localizer.locate(frame.depth)
        assert fix.located
        assert fix.theta_deg is not None
        assert np.hypot(*(np.asarray(fix.position_mm) - frame.position_mm)) < 0.020
        assert abs((fix.theta_deg - frame.theta_deg + 180) % 360 - 180) < 0.15


# What is measured of the surface


def test_slopes_that_fit_a_surface_give_it_back() -> None:
    surface = np.random.default_rng(1).normal(size=(23, 31))
    found = integrated(np.diff(surface, axis=1), np.diff(surface, axis=0))
    np.testing.assert_allclose(found, surface - surface.mean(), atol=1e-12)


def test_slopes_have_a_limit(tape: Tape) -> None:
    sensor = small_sensor(16.0)
    steep, limited = (pressed(tape, sensor, slope_limit=limit).depth for limit in (None, 0.4))
    assert np.abs(np.diff(steep, axis=1)).max() * 16 > 0.8
    assert np.abs(np.diff(limited, axis=1)).max() * 16 < 0.6
    assert np.corrcoef(steep.ravel(), limited.ravel())[0, 1] > 0.9
    np.testing.assert_allclose(pressed(tape, sensor, slope_limit=100.0).depth, steep, atol=2e-4)


def test_blur_takes_away_detail(tape: Tape) -> None:
    sharp, soft = (pressed(tape, small_sensor(16.0), blur_mm=blur).depth for blur in (0.0, 0.1))
    assert np.abs(np.diff(soft, axis=1)).max() < 0.8 * np.abs(np.diff(sharp, axis=1)).max()
    assert soft.mean() == pytest.approx(float(sharp.mean()), rel=0.01)


def test_markers_hide_slopes(tape: Tape) -> None:
    sensor = small_sensor(16.0, (12.0, 10.0))
    bare, dotted = (pressed(tape, sensor, markers=markers).depth for markers in (False, True))
    v, u = np.indices(bare.shape)
    off = [(at / 16.0 + 1.0) % 2.0 - 1.0 for at in (u - sensor.centre_px[0], v - sensor.centre_px[1])]
    hidden = np.hypot(*off) < 0.2
    rough = [np.abs(np.diff(depth, axis=1))[hidden[:, 1:] & hidden[:, :-1]].mean() for depth in (bare, dotted)]
    assert rough[1] < 0.5 * rough[0]
    assert np.abs(dotted - bare).max() < 0.2
    assert not np.array_equal(dotted, bare)


# What is refused and recorded


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"force_n": 0.0}, "elastic.force_n = 0"),
        ({"force_n": "hard"}, "elastic.force_n = 'hard'"),
        ({"tilt_deg": (90.0, 0.0)}, "tilt_deg"),
        ({"tilt_deg": 2.0}, "tilt_deg"),
        ({"poisson": 0.5}, "poisson = 0.5"),
        ({"thickness_mm": -1.0, "modulus_kpa": 0.0}, "modulus_kpa = 0"),
        ({"crown_mm": (1.0, 113.0)}, "crown_mm"),
        ({"markers": 1}, "markers = 1"),
    ],
)
def test_invalid_values_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(SpecError, match=words):
        ElasticContact(**options)


def test_a_scene_takes_an_elastic_contact_alone(tape: Tape) -> None:
    with pytest.raises(SpecError, match="is no ElasticContact"):
        Scene(elastic=2.0)  # type: ignore[arg-type]
    with pytest.raises(SpecError, match="iterate_frames"):
        dots_of(tape, POSE, Scene(elastic=ElasticContact()))
    assert Scene(elastic=ElasticContact()).contact == "pad"
    assert Scene(elastic=ElasticContact(cylinder_radius_mm=9.0)).cylinder_radius_mm == 9.0
    assert Scene(elastic=ElasticContact(force_n=3.0)).to_mapping()["elastic"]["force_n"] == 3.0
