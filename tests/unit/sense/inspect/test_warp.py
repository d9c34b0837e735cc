"""Warps: inverses, derivatives, and shifts of lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tactape_fab.sense.inspect.film import refined, symmetry_offset
from tactape_fab.sense.inspect.patches import patch_grid
from tactape_fab.sense.inspect.warp import Warp, affine_warp, fitted

LINEAR = np.array([(47.0, 1.0), (0.5, -46.5)])
RNG = np.random.default_rng(3)
BOARD = RNG.uniform((0, 0), (100, 50), (1500, 2))


def bent() -> Warp:
    warp = affine_warp(LINEAR, (30.0, 2400.0), (50.0, 25.0), 50.0).raised(3)
    coefficients = warp.coefficients.copy()
    coefficients[3:] += RNG.normal(0, 3, (7, 2))
    return replace(warp, coefficients=coefficients)


def test_to_board_is_the_inverse_of_to_px() -> None:
    warp = bent()
    np.testing.assert_allclose(warp.to_board(warp.to_px(BOARD)), BOARD, atol=1e-9)


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
    assert not warp.mirrored
    assert affine_warp(LINEAR * (1, -1), (0, 0), (50, 25), 50.0).mirrored


def test_a_fit_ignores_points_that_are_elsewhere() -> None:
    true = bent()
    px = true.to_px(BOARD)
    px[::10] += 15.0
    found, away = fitted(true, BOARD, px, gate_px=15.0, rounds=12)
    assert np.abs(found.to_px(BOARD) - true.to_px(BOARD)).max() < 0.3
    assert np.median(away[::10]) > 15.0


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
