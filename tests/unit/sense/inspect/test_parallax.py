"""Parallax: the growth of shifts from one point is found and taken out, whatever single parts do."""

from __future__ import annotations

import numpy as np

from tactape_fab.sense.inspect.bodies import Bodies
from tactape_fab.sense.inspect.parallax import BEND_MM, bend_mm, without_parallax
from tactape_fab.sense.inspect.warp import affine_warp


def test_growth_and_mean_are_taken_out_and_their_errors_are_said() -> None:
    rng = np.random.default_rng(0)
    sites = rng.uniform((0, 0), (40, 30), (400, 2))
    scatter = rng.normal(0.0, 0.05, sites.shape)
    seen = scatter + 0.0009 * (sites - (25.0, 12.0)) + (0.01, -0.02)
    seen[:5] += 0.6
    one = np.ones(len(sites))
    bodies = Bodies(shift_mm=seen, turn_deg=0 * one, sigma_mm=0.003 * one, area=one, misfit=one)
    found, growth = without_parallax(bodies, sites, one > 0)
    assert abs(growth - 0.0009) < 0.0003
    error = (found.shift_mm - scatter)[5:]
    assert np.abs(error).max() < 0.012
    # what is left is the sample's own mean and growth: within what sigma_mm grew by
    assert (error**2).mean() < 4.0 * (found.sigma_mm**2 - bodies.sigma_mm**2).mean()


def test_a_bend_is_what_no_scanner_has() -> None:
    sites = np.stack(np.meshgrid(np.arange(0.0, 40.0), np.arange(0.0, 30.0)), axis=-1).reshape(-1, 2)
    flat = affine_warp([(40.0, 1.0), (0.5, -41.0)], (10.0, 900.0), (20.0, 15.0), 20.0)
    assert bend_mm(flat, sites) < 1e-9
    carriage, slant = flat.raised(2), flat.raised(2)
    carriage.coefficients[3] = (8.0, 0.0)  # of x^2, px: 0.2 mm at the ends
    slant.coefficients[4] = (8.0, 0.0)  # of x y
    assert bend_mm(carriage, sites) < BEND_MM / 2 and bend_mm(slant, sites) > 2 * BEND_MM
