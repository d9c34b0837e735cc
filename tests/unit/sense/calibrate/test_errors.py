"""Errors of dots: their covariance and likelihood by plain formulas, and what is found of drawn ones."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from tactape_fab.sense.calibrate import errors as errors_module
from tactape_fab.sense.calibrate.errors import (
    CORRELATIONS_MM,
    LEAST_MM,
    Design,
    Errors,
    _errors_of,
    _minus_ln_likelihood,
    _rows_of,
    _spread,
    covariance,
    estimate_errors,
    whitening,
)
from tactape_fab.sense.calibrate.presses import Press
from tactape_fab.sense.decode.grid.beliefs import RIM_AT_EDGES, RIM_MM
from tactape_fab.texture.frames import FloatArray

GRID_MM = 1.5 * np.array([(c, r) for r in range(5) for c in range(6)], dtype=float)
OWN_PRECISION = np.diag([0.0, 0.0, 0.0, 4.0])


def press_of(rng: np.random.Generator, low: float = 0.5) -> Press:
    n = len(GRID_MM)
    none = np.zeros((n, 2))
    return Press(
        frame=0,
        tape="t",
        seen_px=none,
        rim_mm=none,
        texture_mm=GRID_MM,
        weights=rng.uniform(low, 1.0, n),
        interior=np.ones(n, dtype=bool),
        pushed=none,
        pulled=none,
        position_mm=(0.0, 0.0),
        theta_rad=0.0,
    )


def design_of(rng: np.random.Generator, errors: Errors, low: float = 0.5) -> Design:
    """A press whose residuals have these errors; its own unknowns move and turn it, the shared one stretches it."""
    press, n = press_of(rng, low), len(GRID_MM)
    middle = GRID_MM - GRID_MM.mean(axis=0)
    own, shared = np.zeros((n, 2, 4)), np.zeros((n, 2, 2))
    own[:, 0, 0] = own[:, 1, 1] = 1.0
    own[:, :, 2] = middle[:, ::-1] * (-1.0, 1.0)
    own[:, :, 3] = rng.normal(0.0, 0.05, (n, 2))
    shared[:, :, 0], shared[:, 0, 1] = middle, middle[:, 1]
    residual = np.linalg.cholesky(covariance(press, errors)) @ rng.standard_normal((n, 2))
    return Design(press=press, residual_mm=residual, shared=shared, own=own)


@pytest.mark.parametrize("by_edges", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("errors", [Errors(dot_mm=0.02), Errors(dot_mm=0.01, gel_mm=0.05, correlation_mm=2.0)])
def test_a_covariance_is_that_of_the_formulas(errors: Errors, by_edges: float) -> None:
    press = replace(press_of(np.random.default_rng(1)), by_edges=by_edges)
    of_rim = (1.0 - by_edges) + RIM_AT_EDGES * by_edges
    found = covariance(press, errors)
    for i, a in enumerate(GRID_MM):
        for j, b in enumerate(GRID_MM):
            want = errors.gel_mm**2 * np.exp(-((a - b) @ (a - b)) / (2.0 * errors.correlation_mm**2))
            if i == j:
                weight = press.weights[i]
                want += errors.dot_mm**2 / weight**0.5 + (of_rim * RIM_MM * (1.0 - weight) ** 0.875) ** 2
            assert found[i, j] == pytest.approx(want, rel=1e-12, abs=1e-18)
    white = whitening(press, errors)
    assert white @ found @ white.T == pytest.approx(np.eye(len(found)), abs=1e-9)


def test_dots_that_err_less_than_their_rim_says_still_err() -> None:
    rng = np.random.default_rng(4)
    designs = [design_of(rng, Errors(dot_mm=0.0), low=0.5) for _ in range(6)]
    designs = [replace(design, residual_mm=0.2 * design.residual_mm) for design in designs]
    assert estimate_errors(designs, np.eye(2), OWN_PRECISION).errors == Errors(dot_mm=LEAST_MM)


def ln_likelihood(designs: list[Design], errors: Errors, precision: FloatArray) -> float:
    """Restricted, of all rows at once, up to a constant: -2 ln L is the sum of three terms."""
    k, m = len(precision), len(designs)
    rows, left, blocks = [], [], []
    for i, design in enumerate(designs):
        own = np.zeros((2 * len(GRID_MM), 4 * m))
        own[:, 4 * i : 4 * i + 4] = design.own.transpose(1, 0, 2).reshape(-1, 4)
        rows.append(np.concatenate([design.shared.transpose(1, 0, 2).reshape(-1, k), own], axis=1))
        left.append(design.residual_mm.T.ravel())
        blocks += [covariance(design.press, errors)] * 2
    a, r = np.concatenate(rows), np.concatenate(left)
    v = np.zeros((len(a), len(a)))
    at = 0
    for block in blocks:
        v[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    prior = np.zeros((k + 4 * m, k + 4 * m))
    prior[:k, :k] = precision
    for i in range(m):
        prior[k + 4 * i : k + 4 * i + 4, k + 4 * i : k + 4 * i + 4] = OWN_PRECISION
    inverse = np.linalg.inv(v)
    normal, right = a.T @ inverse @ a + prior, a.T @ inverse @ r
    total = np.linalg.slogdet(v)[1] + np.linalg.slogdet(normal)[1] + r @ inverse @ r - right @ np.linalg.solve(normal, right)
    return float(-total / 2.0)


def test_a_likelihood_is_that_of_all_rows_at_once() -> None:
    rng, precision = np.random.default_rng(2), np.diag([9.0, 25.0])
    errors = Errors(dot_mm=0.01, gel_mm=0.03, correlation_mm=3.0)
    designs = [design_of(rng, errors) for _ in range(3)]
    for other in (errors, Errors(dot_mm=0.02), replace(errors, gel_mm=0.1), replace(errors, correlation_mm=6.0)):
        found = _minus_ln_likelihood([_rows_of(design) for design in designs], other, precision, OWN_PRECISION)
        assert -found == pytest.approx(ln_likelihood(designs, other, precision), rel=1e-9)
    # a press whose own unknowns its dots leave open says nothing
    open_one = replace(designs[0], own=np.zeros_like(designs[0].own))
    assert _minus_ln_likelihood([_rows_of(open_one)], errors, precision, OWN_PRECISION) == inf


@pytest.mark.parametrize("true", [Errors(dot_mm=0.008, gel_mm=0.04, correlation_mm=3.0), Errors(dot_mm=0.012)])
def test_errors_that_were_drawn_are_found(true: Errors) -> None:
    rng = np.random.default_rng(3)
    found = estimate_errors([design_of(rng, true, 0.9) for _ in range(8)], np.diag([1.0, 1.0]), OWN_PRECISION)
    assert found.errors.dot_mm == pytest.approx(true.dot_mm, rel=0.15)
    if true.gel_mm == 0.0:
        # a displacement that is not there raises the likelihood by little
        assert (found.errors.gel_mm, found.sigma_ln_gel, found.sigma_ln_correlation) == (0.0, inf, inf)
    else:
        assert abs(np.log(found.errors.gel_mm / true.gel_mm)) < 3.0 * found.sigma_ln_gel < 1.5
        assert abs(np.log(found.errors.correlation_mm / true.correlation_mm)) < 3.0 * found.sigma_ln_correlation < 1.5


def test_spreads_of_the_gel_are_those_of_its_values(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, true = np.random.default_rng(3), Errors(dot_mm=0.008, gel_mm=0.04, correlation_mm=3.0)
    monkeypatch.setattr(errors_module, "_spread", lambda *_: [0.1, 0.2, 0.3])
    found = estimate_errors([design_of(rng, true, 0.9) for _ in range(4)], np.diag([1.0, 1.0]), OWN_PRECISION)
    assert (found.sigma_ln_gel, found.sigma_ln_correlation) == (0.2, 0.3)


def test_values_are_logarithms_within_what_can_be_seen() -> None:
    still = _errors_of(np.log([0.02]))
    assert still.dot_mm == pytest.approx(0.02) and still.gel_mm == 0.0
    found = _errors_of(np.log([0.02, 0.3, 5.0]))
    assert (found.dot_mm, found.gel_mm, found.correlation_mm) == pytest.approx((0.02, 0.3, 5.0))
    assert _errors_of(np.log([0.02, 3.0, 0.1])).gel_mm == 1.0
    assert [_errors_of(np.log([0.02, 0.3, c])).correlation_mm for c in (0.1, 99.0)] == [*CORRELATIONS_MM]


def test_a_spread_is_that_of_the_curvature() -> None:
    curve = np.array([[4.0, 1.0, 0.0], [1.0, 9.0, 0.5], [0.0, 0.5, 2.0]])
    at = np.array([0.3, -1.0, 2.0])
    found = _spread(lambda z: float((z - at) @ curve @ (z - at) / 2.0), at)
    assert found == pytest.approx(np.sqrt(np.linalg.inv(curve).diagonal()))
    assert _spread(lambda z: float(z[0] ** 2), np.zeros(2)) == [inf, inf]
    assert _spread(lambda z: float(z[0] ** 2 / 2.0 - z[1] ** 2), np.zeros(2)) == pytest.approx([1.0, inf])
