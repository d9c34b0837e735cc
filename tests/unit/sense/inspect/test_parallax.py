"""Parallax: the growth of shifts from one point is found and taken out, whatever single parts do."""

from __future__ import annotations

import numpy as np
import pytest

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


def test_what_the_correction_may_be_off_is_said_of_each_part() -> None:
    rng = np.random.default_rng(1)
    sites, one = rng.uniform((0, 0), (40, 30), (60, 2)), np.ones(60)
    # two parts that do not count, far outside
    sites[:2] = (80.0, 15.0), (-40.0, 15.0)
    squares = np.zeros((2, 60))
    for _ in range(60):
        scatter = rng.normal(0.0, 0.05, sites.shape)
        bodies = Bodies(shift_mm=scatter, turn_deg=0 * one, sigma_mm=0.003 * one, area=one, misfit=one)
        found, _ = without_parallax(bodies, sites, np.arange(60) >= 2)
        squares += ((found.shift_mm - scatter) ** 2).mean(axis=1), found.sigma_mm**2 - 0.003**2
    off = np.hypot(*(sites - sites[2:].mean(axis=0)).T)
    for which in (off < 8.0, (off > 16.0) & (off < 30.0), off > 30.0):
        real, said = squares[:, which].mean(axis=1)
        assert real == pytest.approx(said, rel=0.3)


def test_a_growth_without_noise_is_taken_out_whole() -> None:
    sites, one = np.random.default_rng(2).uniform((0, 0), (40, 30), (30, 2)), np.ones(30)
    bodies = Bodies(shift_mm=0.002 * (sites - (7.0, 40.0)), turn_deg=0 * one, sigma_mm=0.003 * one, area=one, misfit=one)
    found, growth = without_parallax(bodies, sites, one > 0)
    assert growth == pytest.approx(0.002) and np.abs(found.shift_mm).max() < 1e-9 and found.sigma_mm == pytest.approx(0.003 * one)


def test_a_bend_is_what_no_scanner_has() -> None:
    sites = np.stack(np.meshgrid(np.arange(0.0, 40.0), np.arange(0.0, 30.0)), axis=-1).reshape(-1, 2)
    flat = affine_warp([(40.0, 1.0), (0.5, -41.0)], (10.0, 900.0), (20.0, 15.0), 20.0)
    assert bend_mm(flat, sites) < 1e-9
    carriage, slant = flat.raised(2), flat.raised(2)
    carriage.coefficients[3] = (8.0, 0.0)  # of x^2, px: 0.2 mm at the ends
    slant.coefficients[4] = (8.0, 0.0)  # of x y
    assert bend_mm(carriage, sites) < BEND_MM / 2 and bend_mm(slant, sites) > 2 * BEND_MM
