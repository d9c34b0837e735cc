"""Tops of long parts under a pressure that falls across the contact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab import Localizer, TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import ElasticContact, Scene, iterate_frames
from tactape_fab.sense.decode.grid.long_parts import BEND, DRAWN, FARTHEST_MM, HEIGHT_ERROR, SLOPE, WHOLE, drawn_px
from tactape_fab.texture.frames import FloatArray
from tests.contacts import TAPE, nees

R, PART = 16.0, TAPE.part
GEL_MM = 1.5 * np.stack(np.meshgrid(np.arange(-3.0, 4.0), np.arange(-2.0, 3.0)), axis=-1).reshape(-1, 2)


def at_theta(theta_deg: float) -> FloatArray:
    """Texture points of dots on the gel (docs/frames.md)."""
    c, s = np.cos(np.radians(theta_deg)), np.sin(np.radians(theta_deg))
    return np.asarray(GEL_MM @ np.array([[c, -s], [s, c]]))


@pytest.mark.parametrize("bend", [np.zeros((2, 2)), np.array([[0.008, 0.006], [0.006, -0.004]])], ids=["even", "bent"])
@pytest.mark.parametrize("theta_deg", [0.0, 30.0, -100.0])
def test_dots_are_drawn_to_the_pressure_along_the_part(theta_deg: float, bend: FloatArray) -> None:
    """By the slope of ln of the pressure at each dot, of a surface of first or second order."""
    level = GEL_MM @ (0.02, -0.015) + ((GEL_MM @ bend) * GEL_MM).sum(axis=1) / 2.0
    slope = (0.02, -0.015) + GEL_MM @ bend
    moved = drawn_px(PART, 7.0 * np.exp(level), R * GEL_MM, at_theta(theta_deg), R)
    turn = np.radians(theta_deg - PART.rotation_deg)
    along = np.array([np.cos(turn), np.sin(turn)])
    length, width, _ = PART.body_mm
    wanted = R * DRAWN * (length**4 - width**4) * (np.outer(slope @ along, along) - slope / 2.0)
    assert moved is not None and np.abs(moved.shift_px - wanted).max() < 0.1 * np.abs(wanted).max()


@pytest.mark.parametrize("theta_deg", [25.0, -140.0])
def test_the_pressure_is_a_ridge_regression_of_whole_heights(theta_deg: float) -> None:
    """By numpy, with the priors as rows. A height at the limit is no whole one, and the texture frame may be far away."""
    rng = np.random.default_rng(int(theta_deg) % 7)
    heights = 3.0 * np.exp(GEL_MM @ (0.02, 0.01) + rng.normal(0.0, 0.05, 35))
    whole = WHOLE * np.sort(heights)[3 * 35 // 4]
    heights[4], heights[9] = whole, 0.5 * whole
    kept = heights > whole
    assert 4 not in np.flatnonzero(kept) and kept.sum() >= 20
    x, y = (GEL_MM - GEL_MM.mean(axis=0)).T
    rows = np.stack([np.ones(35), x, y, x * x / 2, y * y / 2, x * y], axis=1)
    priors = np.diag(HEIGHT_ERROR / np.array([SLOPE, SLOPE, BEND, BEND, BEND]))
    left = np.vstack([rows[kept], np.hstack([np.zeros((5, 1)), priors])])
    _, u, v, uu, vv, uv = np.linalg.lstsq(left, np.append(np.log(heights[kept] / whole), np.zeros(5)))[0]
    slope = np.stack([u + uu * x + uv * y, v + vv * y + uv * x], axis=1)
    turn = np.radians(theta_deg - PART.rotation_deg)
    along = np.array([np.cos(turn), np.sin(turn)])
    length, width, _ = PART.body_mm
    wanted = DRAWN * (length**4 - width**4) * (np.outer(slope @ along, along) - slope / 2.0)
    assert 0.001 < np.abs(wanted).max() < FARTHEST_MM / 2.0
    moved = drawn_px(PART, heights, R * GEL_MM, np.add(at_theta(theta_deg), (40.0, -25.0)), R)
    assert moved is not None and moved.shift_px == pytest.approx(R * wanted, rel=1e-6, abs=1e-9)


def test_even_heights_low_ones_and_few_move_nothing() -> None:
    texture = at_theta(20.0)
    for heights in (np.ones(35), np.zeros(35), np.where(np.arange(35) % 3 > 0, 1.0, 0.5)):
        moved = drawn_px(PART, heights, R * GEL_MM, texture, R)
        assert moved is not None and np.abs(moved.shift_px).max() < 1e-9
    moved = drawn_px(PART, np.exp(GEL_MM[:7] @ [0.04, 0.0]), R * GEL_MM[:7], texture[:7], R)
    assert moved is not None and (moved.shift_px == 0.0).all() and moved.covariance is None
    enough = drawn_px(PART, np.exp(GEL_MM[:8] @ [0.01, 0.0]), R * GEL_MM[:8], texture[:8], R)
    assert enough is not None and np.abs(enough.shift_px).max() > 1e-3
    larger = drawn_px(replace(PART, body_mm=(1.0, 0.5, 0.35)), np.ones(7), R * GEL_MM[:7], texture[:7], R)
    assert larger is not None and larger.covariance is not None and (larger.covariance == 0.0).all()
    assert drawn_px(replace(PART, body_mm=(0.4, 0.4, 0.2)), np.ones(35), R * GEL_MM, texture, R) is None


@pytest.mark.parametrize("middle_mm", [(0.3, -0.2), (2.5, -1.8)])
def test_what_heights_do_not_tell_of_larger_parts_is_in_the_covariance(middle_mm: tuple[float, float]) -> None:
    """Of 0402 whose heights err by 5 %, against lines fitted to the shifts by many such heights."""
    part, texture, rng = replace(PART, body_mm=(1.0, 0.5, 0.35), rotation_deg=20.0), at_theta(50.0), np.random.default_rng(0)
    off_px = R * np.add(GEL_MM, middle_mm)
    found = drawn_px(part, np.ones(35), off_px, texture, R)
    assert found is not None and found.covariance is not None
    rows = []
    for _ in range(400):
        drawn = drawn_px(part, np.exp(rng.normal(0.0, 0.05, 35)), off_px, texture, R)
        assert drawn is not None
        seen = (off_px - drawn.shift_px) / R
        # seen = t + (turn and stretch) gel, by least squares: where nothing is seen is the image's centre, on the gel at -t
        shift, right, down = np.linalg.lstsq(np.column_stack([np.ones(35), off_px / R]), seen, rcond=None)[0]
        rows.append([*-shift, (right[1] - down[0]) / 2.0])
    sigmas = np.sqrt(found.covariance.diagonal())
    measured, said = (covariance / np.outer(sigmas, sigmas) for covariance in (np.cov(np.transpose(rows)), found.covariance))
    assert measured == pytest.approx(said, abs=0.2)


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_poses_on_larger_parts_are_as_exact_as_said(noise: float) -> None:
    """0402 on a wide pitch: 4 standard deviations of the turn where what the heights leave open is not in the covariance."""
    tape = examine(TapeSpec(sector=3, part="r0402", pitch_mm=2.5, size_mm=(60.0, 40.0))).tape
    localizer, squares = Localizer([tape], refine="dots"), []
    for frame in iterate_frames(tape, 12, 7, scene=Scene(noise=noise)):
        fix = localizer.locate(frame.depth)
        if fix.located:
            squares.append(nees(fix, frame))
    assert len(squares) > 8 and np.mean(squares) < 1.6


def test_the_turn_of_a_light_press_is_as_exact_as_said() -> None:
    localizer = Localizer([TAPE], refine="dots")
    frames = list(iterate_frames(TAPE, 8, 9, scene=Scene(elastic=ElasticContact(force_n=1.0), slope_noise=0.032)))
    off = []
    for frame in frames:
        fix = localizer.locate(frame.depth)
        assert fix.theta_deg is not None and fix.covariance is not None
        turn = np.radians((fix.theta_deg - frame.theta_deg + 180.0) % 360.0 - 180.0)
        off.append(turn / np.sqrt(fix.covariance[2, 2]))
    assert np.sqrt(np.mean(np.square(off))) < 1.3  # 1.8 where tops are taken for the parts' middles
