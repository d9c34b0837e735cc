"""The fit of a grid against its definition in complex numbers: directions, starts, low and doubtful dots, and its likelihood."""

from __future__ import annotations

from cmath import rect
from math import log, pi, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from tactape_fab.sense.decode.grid.fit import FEW_DOTS, SMALL_SIGMA, STARTS, Fit, fit_grid, posteriors
from tactape_fab.sense.decode.rule import GOOD_WEIGHT, MOST_SIGMA, OUTLIER_SHARE, WRONG_SHARE, sigma_of, squared_errors
from tactape_fab.texture.frames import FloatArray, IntArray

Complex = npt.NDArray[np.complex128]

PITCH, SHIFT, ANGLE = 24.0, 1.0 / 6.0, 0.3


def points(columns: int, rows: int) -> Complex:
    """Grid points about a contact's middle, in pitches."""
    k, row = np.meshgrid(np.arange(columns) - columns // 2, np.arange(rows) - rows // 2)
    return np.asarray((k + 1j * row).ravel())


def places(directions: int) -> Complex:
    """Displacements from a grid point, in pitches, from the first axis on towards the second."""
    return np.asarray(SHIFT * np.exp(2j * pi * np.arange(directions) / directions))


class Dots(NamedTuple):
    """Dots from their centroid, px, with heights and trust, and where the grid's origin is."""

    xy: Complex
    weights: FloatArray
    trust: FloatArray
    origin: complex


def dots_of(at: Complex, weights: FloatArray | None = None, trust: FloatArray | None = None) -> Dots:
    """Dots at grid coordinates, whole ones where nothing else is said."""
    one, xy = np.ones(len(at)), at * rect(PITCH, ANGLE)
    return Dots(xy - xy.mean(), one if weights is None else weights, one if trust is None else trust, complex(-xy.mean()))


def fitted(dots: Dots, directions: int, *, turn: float = 0.0, off: complex = 0.0, free: bool = True, pitch: float = PITCH) -> Fit:
    """The fit from a start that is off by an angle (rad) and by a share of the pitch along its axes."""
    phase = 2 * pi * (dots.origin / rect(pitch, ANGLE + turn) + off)
    xy = np.stack([dots.xy.real, dots.xy.imag], axis=1)
    return fit_grid(xy, dots.weights, dots.trust, ANGLE + turn, pitch, phase.real, phase.imag, SHIFT, free, directions)


def mixture(dots: Dots, grid: complex, origin: complex, directions: int, free: bool) -> tuple[complex, complex, float, float]:
    """Expectation maximisation of directions and outliers, six steps, the last of which leaves the grid as it is."""
    sigma, value, (xy, weights, trust, _) = MOST_SIGMA, 0.0, dots
    for step in range(6):
        z = (xy - origin) / grid
        node = np.rint(z.real) + 1j * np.rint(z.imag)
        variance, part = squared_errors(weights, sigma), trust * (1 - OUTLIER_SHARE)
        squares = np.abs((z - node)[:, None] - places(directions)) ** 2
        density = (part / (2 * pi * variance * directions))[:, None] * np.exp(-0.5 * squares / variance[:, None])
        every = density.sum(axis=1) + 1 - part
        fits, value = density.sum(axis=1) / every, float(np.log(every).sum())
        good = weights >= GOOD_WEIGHT
        if step > 0:
            sigma = sigma_of(float(((density * squares).sum(axis=1) / every)[good].sum()), float(fits[good].sum()))
        if step < 5:
            share, ideal = fits / variance, node + density @ places(directions) / density.sum(axis=1)
            middle, centre = share @ ideal / share.sum(), share @ xy / share.sum()
            moved = share @ (np.conj(ideal - middle) * (xy - centre)) / (share @ np.abs(ideal - middle) ** 2)
            grid = moved if free else moved * abs(grid) / abs(moved)
            origin = centre - grid * middle
    return grid, origin, sigma, value


def displaced(seed: int, columns: int, rows: int, directions: int, sigma: float) -> Complex:
    """Grid coordinates of parts, each in one of the directions, off by normal errors."""
    rng, at = np.random.default_rng(seed), points(columns, rows)
    symbols, errors = rng.integers(0, directions, len(at)), rng.normal(size=(len(at), 2)) @ (1, 1j)
    return np.asarray(at + places(directions)[symbols] + sigma * errors)


def usual_and_low_dots(seed: int, columns: int, rows: int, directions: int, sigma: float) -> Dots:
    """Displaced dots, of which every third is low and every fourth doubtful."""
    each = np.arange(columns * rows)
    low = np.random.default_rng(seed).uniform(0.3, 0.75, len(each))
    weights, trust = np.where(each % 3 == 0, low, GOOD_WEIGHT), np.where(each % 4 == 0, 0.6, 1.0)
    return dots_of(displaced(seed, columns, rows, directions, sigma), weights, trust)


@pytest.mark.parametrize("directions", [4, 8])
@pytest.mark.parametrize("free", [True, False])
def test_many_dots_are_fitted_from_the_first_start_alone(directions: int, free: bool) -> None:
    for seed in range(4):
        dots = usual_and_low_dots(seed, 8, 7, directions, 0.02)
        assert dots.trust.sum() > FEW_DOTS
        # far from the right grid other starts are likelier, and not tried
        turn, off, pitch = 0.05 * seed, 0.05 * seed * (1 - 1j), 1.02 * PITCH
        fit = fitted(dots, directions, turn=turn, off=off, free=free, pitch=pitch)
        begun = rect(pitch, ANGLE + turn)
        grid, origin, sigma, value = mixture(dots, begun, dots.origin + off * begun, directions, free)
        assert fit.grid == pytest.approx([grid.real, grid.imag, origin.real, origin.imag], abs=1e-6)
        assert (fit.sigma, fit.value) == pytest.approx((sigma, value), rel=1e-6)


@pytest.mark.parametrize("free", [True, False])
def test_of_few_dots_the_likeliest_start_is_taken(free: bool) -> None:
    taken = set()
    for seed in range(10):
        dots = usual_and_low_dots(seed, 3, 3, 4, 0.04)
        fits = []
        for turn, scale, a, b in [(0.0, 0.0, 0.0, 0.0), *STARTS.tolist()]:
            begun = rect(PITCH * (1 + scale if free else 1), ANGLE + 0.07 + turn)
            # phases are in pitches along the axes of each start
            at = (dots.origin / rect(PITCH, ANGLE + 0.07) + 0.09 * (1 - 1j) + a + 1j * b) * begun
            fits.append(mixture(dots, begun, at, 4, free))
        if fits[0][2] < SMALL_SIGMA:  # it may be as expected, and then it is the only one
            continue
        best = max(range(len(fits)), key=lambda k: fits[k][3])
        taken.add(best)
        fit = fitted(dots, 4, turn=0.07, off=0.09 * (1 - 1j), free=free)
        grid, origin, sigma, value = fits[best]
        assert (fit.sigma, fit.value) == pytest.approx((sigma, value), rel=1e-6)
        assert fit.grid == pytest.approx([grid.real, grid.imag, origin.real, origin.imag], abs=1e-6)
    assert len(taken) > 2


def test_eight_directions_give_the_grid_and_their_symbols() -> None:
    symbols = np.random.default_rng(5).integers(0, 8, 42)
    dots = dots_of(points(7, 6) + places(8)[symbols])
    fit = fitted(dots, 8, turn=0.02, off=0.03 + 0.03j)
    grid = rect(PITCH, ANGLE)
    assert fit.grid == pytest.approx([grid.real, grid.imag, dots.origin.real, dots.origin.imag], abs=1e-6)
    assert (fit.nodes @ (1, 1j) == points(7, 6)).all()
    # entry k is the distance from the place of direction k, the dot's own being 0
    assert fit.squares == pytest.approx(np.abs(places(8)[symbols][:, None] - places(8)) ** 2, abs=1e-9)
    q = posteriors(fit.nodes, fit.squares, dots.weights, dots.trust, fit.sigma)
    assert (q.argmax(axis=1) == symbols).all() and q.sum(axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("directions", [4, 8])
def test_a_fit_is_as_expected_where_it_is_likely_and_its_sigma_small(directions: int) -> None:
    """A part stands at one place, of an equal share; d^2 / 2 variance has the mean 1 and the standard deviation 1."""
    said = set()
    for seed in range(40):
        at, trust = displaced(seed, 6, 5, directions, 0.012 + 0.004 * (seed % 3)), np.ones(30)
        # a dot that is no part, as seems likely; in every second contact another, that seems to be one
        at[7], trust[7] = 1.4 + 0.45j, 0.3
        at[16] += (seed % 2) * (0.2 - 0.3j)
        fit = fitted(dots_of(at, trust=trust), directions)
        part = np.log(1 / (directions * 2 * pi * fit.sigma**2)) - 1
        least = 29 * part + log(0.7) - sqrt(30)
        assert fit.expected == (fit.value > least and fit.sigma < SMALL_SIGMA)
        said.add((fit.value > least, fit.sigma < SMALL_SIGMA))
    assert len(said) == 4


@pytest.mark.parametrize(
    ("weights", "trust", "counts"),
    [((1.0, 0.9), (0.5, 1.0), 1), ((1.0, 0.4), (1.0, 1.0), 0), ((0.5, 1.0), (1.0, 0.5), 0), ((0.8, 0.8), (0.9, 0.9), 0)],
)
def test_of_two_dots_at_a_grid_point_the_higher_and_surer_counts(
    weights: tuple[float, float], trust: tuple[float, float], counts: int
) -> None:
    """By height times trust; of equals the first. The other is an outlier, whose symbol is any."""
    squares: FloatArray = np.array([[0.0, 0.05, 0.1, 0.05]] * 2)
    nodes: IntArray = np.array([(2, 1), (2, 1)])
    q = posteriors(nodes, squares, np.array(weights), np.array(trust), 0.02)
    assert q[1 - counts] == pytest.approx([0.25] * 4) and 0.9 < q[counts, 0] <= 1 - 0.75 * WRONG_SHARE
