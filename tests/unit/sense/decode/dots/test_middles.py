"""Middles of long bodies between the edges of their tops: under a pressure, at a rim, and where no edge is sharp."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest

from tactape_fab import Localizer, Tape, TapeSpec
from tactape_fab.kit.plan import plan
from tactape_fab.kit.profiles import load_fab, load_part
from tactape_fab.sense import ElasticContact, Scene, SensorProfile, iterate_frames, load_sensor
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.dots.middles import BLUNT, LEAST_LENGTH_MM, SHARP, STEPS, edges_at, has_edges, middles
from tactape_fab.texture.frames import FloatArray
from tests.contacts import TAPE

R = 16.0
LONG = replace(TAPE.part, body_mm=(1.0, 0.5, 0.35))
SIDE_PX = 200
Image = npt.NDArray[np.float32]


def edge(at_mm: FloatArray, width_mm: float) -> FloatArray:
    """A fall from 1 to 0 about 0; `width_mm` is its height over its steepest slope."""
    return np.asarray(0.5 - 0.5 * np.tanh(2.0 * at_mm / width_mm))


def bodies(centres_px: FloatArray, phi: float, width_mm: float, gradient: float = 0.0, aspect: float = 1.0) -> Image:
    """Tops of `LONG`, at places in square pixels and an angle, higher by `gradient` per mm along them."""
    v, u = np.mgrid[: round(SIDE_PX / aspect), :SIDE_PX]
    image = np.zeros(u.shape)
    for x, y in centres_px:
        off_u, off_v = (u - x) / R, (v * aspect - y) / R
        along, across = off_u * np.cos(phi) + off_v * np.sin(phi), off_v * np.cos(phi) - off_u * np.sin(phi)
        top = edge(np.abs(along) - 0.5, width_mm) * edge(np.abs(across) - 0.25, width_mm)
        image += 0.2 * top * (1.0 + gradient * along)
    return image.astype(np.float32)


CENTRES = np.array([(x, y) for x in (40.3, 80.1, 120.6, 160.2) for y in (50.4, 101.2, 149.7)])


def seen(maxima_px: FloatArray, phi: float, aspect: float = 1.0) -> Dots:
    n = len(maxima_px)
    elongation = np.tile([-0.4 * np.cos(2.0 * phi), -0.4 * np.sin(2.0 * phi)], (n, 1))
    elongation += np.random.default_rng(0).normal(0.0, 0.05, elongation.shape)
    ones = np.ones(n)
    return Dots(xy_px=maxima_px, weights=ones, trust=ones, elongation=elongation, seen_px=maxima_px / (1.0, aspect))


@pytest.mark.parametrize("phi", [0.2, 1.3, -0.7])
@pytest.mark.parametrize("aspect", [1.0, 1.25])
def test_middles_are_where_the_bodies_are(phi: float, aspect: float) -> None:
    """Whatever the maxima are off by along and across, and however the tops slope."""
    rng = np.random.default_rng(3)
    off_mm = rng.uniform((-0.3, -0.1), (0.3, 0.1), CENTRES.shape)
    axes = np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]])
    maxima_px = CENTRES + R * off_mm @ axes
    found = middles(seen(maxima_px, phi, aspect), bodies(CENTRES, phi, 0.2, 0.4, aspect), LONG, R, aspect)
    assert found is not None and found[1] == 1.0
    assert np.abs(maxima_px + found[0] - CENTRES).max() < 0.015 * R


def test_a_top_that_the_gel_leaves_early_is_as_long_as_the_others() -> None:
    """The outer part of a body at the rim is not touched: its middle is half a length from the edge that the others are at."""
    image = bodies(CENTRES, 0.0, 0.2)
    cut_px = CENTRES[-1, 0] - 0.05 * R
    image[int(CENTRES[-1, 1] - 12) :, int(cut_px) :] *= edge((np.arange(int(cut_px), SIDE_PX) - cut_px) / R, 0.25)
    maxima_px = CENTRES.copy()
    maxima_px[-1, 0] -= 0.25 * R
    found = middles(seen(maxima_px, 0.0), image, LONG, R, 1.0)
    assert found is not None
    assert np.abs(maxima_px + found[0] - CENTRES)[-1].max() < 0.03 * R


def test_middles_count_as_far_as_tops_are_sharp() -> None:
    shares = []
    for width_mm in np.arange(0.2, 0.6, 0.02):
        found = middles(seen(CENTRES, 0.4), bodies(CENTRES, 0.4, float(width_mm)), LONG, R, 1.0)
        shares.append(0.0 if found is None else found[1])
    assert shares[0] == 1.0 and shares[-1] == 0.0 and (np.diff(shares) <= 0.0).all()
    assert any(0.0 < share < 1.0 for share in shares)
    # the fall's height over its slope is its width, and tops that sharp count wholly
    assert (np.array(shares)[np.arange(0.2, 0.6, 0.02) < SHARP - 0.05] == 1.0).all()
    assert (np.array(shares)[np.arange(0.2, 0.6, 0.02) > BLUNT + 0.05] == 0.0).all()


def test_there_are_none_of_dots_without_a_direction_or_too_few() -> None:
    image, dots = bodies(CENTRES, 0.4, 0.2), seen(CENTRES, 0.4)
    assert dots.elongation is not None and middles(dots, image, LONG, R, 1.0) is not None
    anyhow = np.random.default_rng(5).normal(0.0, 0.3, dots.elongation.shape)
    assert middles(replace(dots, elongation=anyhow), image, LONG, R, 1.0) is None
    assert middles(replace(dots, elongation=None), image, LONG, R, 1.0) is None
    assert middles(replace(dots, weights=0.5 * dots.weights), image, LONG, R, 1.0) is None
    # across, bodies are half as long as they should be along
    assert middles(replace(dots, elongation=-dots.elongation), image, LONG, R, 1.0) is None


def test_only_long_bodies_of_some_length_have_edges() -> None:
    assert has_edges(LONG) and has_edges(TAPE.part) and not has_edges(None)
    assert not has_edges(replace(LONG, body_mm=(0.5, 0.5, 0.3)))
    assert not has_edges(replace(LONG, body_mm=(LEAST_LENGTH_MM - 0.01, 0.2, 0.1)))
    assert middles(seen(CENTRES, 0.4), bodies(CENTRES, 0.4, 0.2), None, R, 1.0) is None


def test_a_line_that_leaves_the_image_goes_on_as_it_ends() -> None:
    """No edge is beyond the border, and nothing is read there."""
    corner = np.array([(0.0, 0.0), (SIDE_PX - 1.0, 0.0), (0.0, SIDE_PX - 1.0), (SIDE_PX - 1.0, SIDE_PX - 1.0), (3.0, 90.0)])
    image = bodies(corner, 0.0, 0.2)
    near, far, rises, falls, height = edges_at(image, corner, np.array([R, 0.0]), np.array([0.0, 0.1 * R]))
    assert np.isfinite([near, far, rises, falls, height]).all()
    assert np.abs(far[[0, 2]] - 0.5).max() < 0.03 and np.abs(near[[1, 3]] + 0.5).max() < 0.03
    assert np.abs(rises[[0, 2]]).max() < 1e-3 and np.abs(falls[[1, 3]]).max() < 1e-3


def test_edges_are_found_between_samples() -> None:
    """Of a ramp as wide as a smooth step: places to a hundredth of a side, slopes and heights as drawn, in thirds of the unit."""
    at_px, v, side = np.arange(5.0, 6.0, 0.1), 60, 20.0
    for before_px, after_px in zip(90.0 - at_px, 90.0 + at_px + 0.37, strict=True):
        u = np.arange(SIDE_PX) / side
        row = 0.3 * edge(before_px / side - u, 0.3) * edge(u - after_px / side, 0.3) + 0.05 * u
        image = np.tile(row, (120, 1)).astype(np.float32)
        side_px, aside_px = np.array([side, 0.0]), np.array([0.0, 2.0])
        near, far, rises, falls, height = edges_at(image, np.array([[90.0, v]]), side_px, aside_px)[:, 0]
        assert (near, far) == pytest.approx(((before_px - 90.0) / side, (after_px - 90.0) / side), abs=0.006)
        # a difference over two steps on each side, less what pixels round off
        slope = 0.3 * np.tanh(2.0 * (2.0 / STEPS) / 0.3) / (4.0 / STEPS)
        assert rises / 3.0 == pytest.approx(slope + 0.05, rel=0.05) and falls / 3.0 == pytest.approx(slope - 0.05, rel=0.05)
        assert height / 3.0 == pytest.approx(0.3, abs=0.02)


def test_a_border_is_as_if_the_image_were_padded() -> None:
    places = np.array([(2.0, 90.0), (SIDE_PX - 3.0, 91.0), (90.0, 1.5), (89.0, SIDE_PX - 2.5)])
    image = bodies(places, 0.6, 0.3)
    side_px, aside_px, pad = R * np.array([np.cos(0.6), np.sin(0.6)]), 0.1 * R * np.array([-np.sin(0.6), np.cos(0.6)]), 40
    padded = edges_at(np.pad(image, pad, mode="edge"), places + pad, side_px, aside_px)
    assert np.allclose(edges_at(image, places, side_px, aside_px), padded, rtol=0.01, atol=0.003)


@cache
def tape_of_0402() -> tuple[Tape, SensorProfile]:
    """W 2, Delta 0.4, seen by a square image of 340 px at 21 px/mm: maxima are off by half of Delta there."""
    spec = TapeSpec(sector=7, pitch_mm=2.0, displacement_mm=0.4, size_mm=(110, 60))
    sensor = replace(load_sensor("gelsight-mini"), name="square", width_px=340, height_px=340, px_per_mm=(21.0, 21.0))
    return plan(spec, load_fab("generic-fpc"), load_part("r0402")), sensor


@pytest.mark.parametrize("force_n", [0.5, 2.0])
def test_tapes_of_long_parts_are_located_in_an_elastic_gel(force_n: float) -> None:
    """By maxima 7 and 6 of 24 were."""
    tape, sensor = tape_of_0402()
    localizer, errors = Localizer([tape], sensor), []
    for frame in iterate_frames(
        tape, 8, 1, sensor=sensor, scene=Scene(elastic=ElasticContact(force_n=force_n), slope_noise=0.032)
    ):
        fix = localizer.locate(frame.depth)
        assert fix.located and fix.position_mm is not None, fix.reason
        errors.append(np.hypot(*(np.array(fix.position_mm) - frame.position_mm)))
    assert np.sqrt(np.mean(np.square(errors))) < 0.006


def test_a_sharp_gel_moves_no_pose_of_a_tilted_tape() -> None:
    """By maxima, whose draw was taken off as expected, positions were off by 8 um rms an axis at 2 degrees and 0.5 N."""
    localizer, off = Localizer([TAPE], "gelsight-mini"), []
    scene = Scene(elastic=ElasticContact(force_n=0.5, tilt_deg=(2.0, 0.0)), slope_noise=0.032)
    for frame in iterate_frames(TAPE, 8, 5, scene=scene):
        fix = localizer.locate(frame.depth)
        assert fix.located and fix.position_mm is not None, fix.reason
        off.append(np.array(fix.position_mm) - frame.position_mm)
    assert np.sqrt(np.mean(np.square(off))) < 0.005
