"""Alignment of patches with a template: made-up parts whose shift, turn, gain and noise are known."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tactape_fab.sense.inspect.align import Nuisance, Template, _correlated_samples, gradients, learn_template, step
from tactape_fab.sense.inspect.patches import Samples, patch_grid
from tactape_fab.texture.frames import FloatArray

GRID = patch_grid(0.6, 0.4, 40.0)
RNG = np.random.default_rng(5)
E_MM, TURN = RNG.uniform(-0.003, 0.003, (200, 2)), RNG.uniform(-0.02, 0.02, 200)
GAIN, OFFSET = RNG.uniform(0.97, 1.03, 200), RNG.uniform(-0.05, 0.05, (200, 2))
NOISE = 0.05
USED = np.abs(GRID.a_mm) < 0.5


def looks(a_mm: FloatArray, b_mm: FloatArray) -> FloatArray:
    """A part of 0.6 x 0.3 mm with soft edges, in two channels of opposite sign."""
    along, across = np.exp(-((a_mm / 0.3) ** 4)), np.exp(-((b_mm / 0.15) ** 4))
    return np.stack([along * across, 1.0 - 0.5 * along * across * (1.0 + 0.5 * a_mm)], axis=-2)


TRUE = looks(GRID.a_mm, GRID.b_mm)
TEMPLATE = Template(value=TRUE, sigma=np.full(TRUE.shape, NOISE), used=USED, tail=np.ones(TRUE.shape))


def patches(turn: FloatArray, noise: FloatArray) -> Samples:
    """Parts at `E_MM`, turned, with their own contrast and brightness."""
    a, b = GRID.a_mm - E_MM[:, :1], GRID.b_mm - E_MM[:, 1:]
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    seen = looks(c * a + s * b, c * b - s * a)
    middle = TRUE[:, USED].mean(axis=1)[:, None]
    return np.asarray(middle + GAIN[:, None, None] * (seen - middle) + OFFSET[:, :, None] + noise, dtype=np.float32)


def white() -> FloatArray:
    return np.random.default_rng(1).normal(0.0, NOISE, (200, *TRUE.shape))


@pytest.mark.parametrize("turns", [False, True])
@pytest.mark.parametrize("robust", [False, True])
def test_shift_turn_and_gain_are_found_as_exactly_as_is_said(turns: bool, robust: bool) -> None:
    found = step(patches(TURN * turns, white()), TEMPLATE, GRID, turns=turns, robust=robust)
    off = (found.move[:, :2] - E_MM) / found.sigma_mm
    assert np.sqrt((off**2).mean(axis=0)) == pytest.approx([1.0, 1.0], abs=0.15)
    assert found.sigma_mm.max() < 0.0015
    assert found.gain == pytest.approx(GAIN, abs=0.03)
    assert found.misfit == pytest.approx(np.ones(200), abs=0.1) and found.nuisance.shape == (0,)
    assert found.move[:, 2] == pytest.approx(TURN * turns, abs=0.015)
    assert np.std(found.move[:, 2] - TURN * turns) < 0.005
    assert np.median(found.scatter[:, USED]) == pytest.approx(NOISE, rel=0.05)
    assert (found.scatter[:, ~USED] == NOISE).all()


def alike(noise: FloatArray, axis: int, correlation: float) -> FloatArray:
    """Noise of which each sample along an axis is so much of the one before, plus its own."""
    out = noise.reshape(-1, 2, *GRID.shape)
    for before, here in pairwise(np.moveaxis(out, axis, 0)):
        here[:] = correlation * before + (1.0 - correlation**2) ** 0.5 * here
    return out.reshape(-1, *TRUE.shape)


def test_errors_of_noise_that_is_alike_nearby_are_larger_than_of_white_noise() -> None:
    """A scanner's neighbouring pixels err alike: the same scatter of samples says less."""
    noise = NOISE * alike(alike(white() / NOISE, -1, 0.5), -2, 0.5)
    found = step(patches(TURN * 0, noise), TEMPLATE, GRID, turns=False)
    off = (found.move[:, :2] - E_MM) / found.sigma_mm
    assert np.sqrt((off**2).mean(axis=0)) == pytest.approx([0.9, 0.9], abs=0.25)
    assert np.median(found.sigma_mm) > 2.0 * np.median(step(patches(TURN * 0, white()), TEMPLATE, GRID, turns=False).sigma_mm)


def test_patches_of_twice_the_noise_err_by_twice_as_much() -> None:
    """Of a hundred; whatever the scatter of the template says."""
    one, two = (step(patches(TURN * 0, k * white())[:100], TEMPLATE, GRID, turns=False) for k in (1.0, 2.0))
    assert np.median(two.sigma_mm / one.sigma_mm, axis=0) == pytest.approx([2.0, 2.0], rel=0.05)
    assert two.misfit == pytest.approx(2.0 * one.misfit, rel=0.1)


def test_samples_that_one_part_in_six_shows_otherwise_do_not_tell_a_good_part() -> None:
    """Where ends differ in length, good parts were said to be covered: the median deviation of such samples is that of noise."""
    odd, some = np.arange(200) % 6 == 0, USED & (np.abs(GRID.a_mm - 0.18) < 0.03)
    noise = white()
    noise += 8.0 * NOISE * (odd[:, None, None] & some)
    first = step(patches(TURN * 0, noise), TEMPLATE, GRID, turns=False)
    assert (first.tail >= 1.0).all() and (first.tail[:, ~USED] == 1.0).all()
    assert np.median(first.tail[:, some]) > 3.0 and np.median(first.tail[:, USED & ~some]) < 1.3
    assert np.median(first.scatter[:, some]) == pytest.approx(1.25 * NOISE, rel=0.1)  # the median of five in six
    then = step(patches(TURN * 0, noise), replace(TEMPLATE, tail=first.tail), GRID, turns=False)
    assert np.median(first.misfit[odd]) > 1.7 and np.median(then.misfit[odd]) < 1.3
    assert then.move == pytest.approx(first.move)


@pytest.mark.parametrize(("axis", "correlation"), [(-1, 0.5), (-2, 0.5), (-1, 0.0)])
def test_samples_along_an_axis_count_by_their_correlation(axis: int, correlation: float) -> None:
    """(1 + r) / (1 - r) samples make a free one."""
    left = TEMPLATE.flat(alike(white() / NOISE, axis, correlation))
    assert _correlated_samples(left, TEMPLATE, GRID, 2) == pytest.approx((1 + correlation) / (1 - correlation), rel=0.08)
    assert _correlated_samples(0.0 * left, TEMPLATE, GRID, 2) == 1.0


def test_glare_on_a_part_moves_it_only_if_all_samples_count() -> None:
    noise = white()
    noise[:, :, (np.abs(GRID.a_mm - 0.25) < 0.06) & (np.abs(GRID.b_mm) < 0.06)] += 1.5
    seen = patches(TURN * 0, noise)
    robust, plain = (step(seen, TEMPLATE, GRID, turns=False, robust=robust).move[:, :2] - E_MM for robust in (True, False))
    assert np.abs(np.median(robust, axis=0)).max() < 0.001
    assert abs(np.median(plain[:, 0])) > 0.003


def test_a_mode_in_which_parts_differ_is_told_from_their_shift() -> None:
    """Some parts are longer than others at one end: without the mode they seem to be elsewhere."""
    mode = np.stack([np.exp(-(((GRID.a_mm - 0.3) / 0.05) ** 2) - (GRID.b_mm / 0.12) ** 2), 0.0 * GRID.a_mm])
    strength = np.random.default_rng(2).normal(0.0, 0.3, 200)
    seen = patches(TURN * 0, white() + strength[:, None, None] * mode)
    with_mode = step(seen, TEMPLATE, GRID, turns=False, nuisance=Nuisance(pictures=mode[None], sigma=np.array([0.3])))
    without = step(seen, TEMPLATE, GRID, turns=False)
    assert np.std(with_mode.move[:, 0] - E_MM[:, 0]) < 0.4 * np.std(without.move[:, 0] - E_MM[:, 0])
    assert with_mode.nuisance == pytest.approx([0.3], rel=0.15)
    assert with_mode.move[:, 1] == pytest.approx(without.move[:, 1], abs=1e-3)
    # one that hardly differs among parts by what is known before is as good as none
    held = step(seen, TEMPLATE, GRID, turns=False, nuisance=Nuisance(pictures=mode[None], sigma=np.array([0.01])))
    assert np.std(held.move[:, 0] - E_MM[:, 0]) > 0.7 * np.std(without.move[:, 0] - E_MM[:, 0])


def test_a_template_is_the_median_and_its_scatter_has_a_floor() -> None:
    noise = white()
    noise[:20] += 5.0  # of 200
    seen = np.asarray(TRUE + noise, dtype=np.float32)
    found = learn_template(seen, USED)
    assert found.value == pytest.approx(TRUE, abs=0.05)
    assert np.median(found.sigma) == pytest.approx(NOISE, rel=0.2)
    seen[:, :, 0], seen[:, :, 1] = 0.3, np.linspace(-1, 1, 200)[:, None]
    assert found.sigma.min() > 0.35 * NOISE
    floored = learn_template(seen, USED)
    assert floored.sigma[:, 0] == pytest.approx(max(0.35 * np.median(floored.sigma[:, USED]), 0.02), abs=1e-3)
    assert floored.sigma[:, 1] == pytest.approx(1.4826 * 0.5, rel=0.01)
    assert (learn_template(0 * seen, USED).sigma == pytest.approx(0.02)) and replace(found, used=~USED).flat(TRUE).shape == (
        2 * (~USED).sum(),
    )


def test_gradients_are_per_mm_along_and_across() -> None:
    da, db = gradients(np.stack([2.0 * GRID.a_mm + 3.0 * GRID.b_mm, -GRID.a_mm]), GRID)
    assert da == pytest.approx(np.repeat([[2.0], [-1.0]], GRID.count, axis=1))
    assert db == pytest.approx(np.repeat([[3.0], [0.0]], GRID.count, axis=1))
