"""Warps: inverses, derivatives, and shifts of lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense.inspect.film import refined, symmetry_offset
from tactape_fab.sense.inspect.patches import patch_grid
from tactape_fab.sense.inspect.warp import LineShift, Warp, affine_warp, fitted

LINEAR = np.array([(47.0, 1.0), (0.5, -46.5)])
RNG = np.random.default_rng(3)
BOARD = RNG.uniform((0, 0), (100, 50), (1500, 2))


def bent() -> Warp:
    warp = affine_warp(LINEAR, (30.0, 2400.0), (50.0, 25.0), 50.0).raised(3)
    coefficients = warp.coefficients.copy()
    coefficients[3:] += RNG.normal(0, 3, (7, 2))
    return replace(warp, coefficients=coefficients)


def test_to_board_is_the_inverse_of_to_px() -> None:
    flat = affine_warp(LINEAR, (30.0, 2400.0), (50.0, 25.0), 50.0)
    jitter = LineShift(axis=1, start_px=0.0, step_px=100.0, value_px=RNG.normal(0.0, 0.5, (26, 2)))
    for warp in (flat, replace(flat, lines=(jitter,)), bent(), replace(bent(), lines=(jitter,))):
        np.testing.assert_allclose(warp.to_board(warp.to_px(BOARD)), BOARD, atol=1e-9)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_shift_of_lines_is_linear_between_knots_and_stays_beyond_them(axis: int) -> None:
    value_px = np.array([(0.5, -1.0), (1.0, 2.0), (-0.25, 0.0), (3.0, 1.0)])
    shift = LineShift(axis=axis, start_px=5.0, step_px=10.0, value_px=value_px)
    expected = np.stack([np.interp(np.arange(60.0), 5.0 + 10.0 * np.arange(4), of) for of in value_px.T], axis=1)
    np.testing.assert_allclose(shift.of_pixels(60), expected, atol=1e-5)
    px = np.full((60, 2), 17.0)
    px[:, axis] = np.arange(60.0)
    np.testing.assert_allclose(shift.at(px), expected, atol=1e-5)


def test_the_jacobian_is_the_derivative() -> None:
    warp, h = bent(), 1e-5
    for axis in range(2):
        by = np.eye(2)[axis] * h
        np.testing.assert_allclose(
            warp.jacobian(BOARD)[..., axis], (warp.smooth(BOARD + by) - warp.smooth(BOARD - by)) / (2 * h), atol=1e-5
        )


def test_an_affine_warp_is_what_it_says_and_knows_a_mirror() -> None:
    warp = affine_warp(LINEAR, (30.0, 2400.0), (50.0, 25.0), 50.0)
    np.testing.assert_allclose(warp.smooth(BOARD), BOARD @ LINEAR.T + (30.0, 2400.0), atol=1e-9)
    assert not warp.mirrored and warp.raised(1) is warp and warp.raised(3).raised(2).order == 3
    assert warp.px_per_mm == pytest.approx(np.sqrt(47.0 * 46.5 + 0.5))
    assert warp.raised(2).px_per_mm == pytest.approx(warp.px_per_mm)
    assert affine_warp(LINEAR * (1, -1), (0, 0), (50, 25), 50.0).mirrored


def test_a_fit_ignores_points_that_are_elsewhere() -> None:
    true = bent()
    px = true.to_px(BOARD)
    px[::10] += 15.0
    found, away = fitted(true, BOARD, px, gate_px=15.0, rounds=12)
    assert np.abs(found.to_px(BOARD) - true.to_px(BOARD)).max() < 0.3
    assert np.median(away[::10]) > 15.0
    # points without any error are met exactly, wherever the fit begins
    exact, away = fitted(replace(true, coefficients=0.0 * true.coefficients), BOARD, true.to_px(BOARD), gate_px=15.0, rounds=2)
    np.testing.assert_allclose(exact.coefficients, true.coefficients, atol=1e-6)
    assert away.max() < 1e-6


def test_shifts_of_lines_are_found_and_do_not_follow_noise() -> None:
    flat = affine_warp(LINEAR, (30.0, 2400.0), (50.0, 25.0), 50.0)
    px = flat.to_px(BOARD)
    wave = np.stack([0.2 * np.sin(px[:, 1] / 60.0), 0.5 * np.cos(px[:, 1] / 90.0)], axis=1)
    found, left = refined(flat, BOARD, px + wave + RNG.normal(0, 0.05, px.shape))
    assert np.sqrt(((found.to_px(BOARD) - px - wave) ** 2).mean()) < 0.04
    assert np.sqrt((left**2).mean()) < 0.06


def test_the_centre_of_symmetry_is_that_of_the_edges_whatever_their_contrast() -> None:
    grid = patch_grid(0.5, 0.3, 50.0)
    for offset in ((0.013, -0.021), (-0.034, 0.007)):
        a, b = grid.a_mm - offset[0], grid.b_mm - offset[1]
        box = 1 / (1 + np.exp((np.maximum(np.abs(a) - 0.25, np.abs(b) - 0.12)) / 0.01))
        lit = box * (1.0 + 0.6 * a) - 0.2 * np.exp(-(((b + 0.2) / 0.08) ** 2))
        np.testing.assert_allclose(symmetry_offset(lit, grid, np.ones(grid.count, dtype=bool)), offset, atol=0.003)
