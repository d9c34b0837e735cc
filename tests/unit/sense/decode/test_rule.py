"""The decision rule: read without the compiler, copied nowhere, and the same in the compiled kernels."""

from __future__ import annotations

import ast
import subprocess
import sys
from itertools import product
from math import log
from pathlib import Path

import numpy as np
import pytest

import tactape_fab
from tactape_fab.sense.decode import rule
from tactape_fab.sense.decode.grid import fit
from tactape_fab.texture import part
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray

PACKAGE = Path(tactape_fab.__file__).parent
COMMON = {"LEAST", "MOST", "USUAL", "MAX", "SHARE", "SHARES", "MM"}
"""Words of names that do not say what a constant is."""


def test_the_rule_is_read_without_the_compiler() -> None:
    code = "import sys, tactape_fab.sense.decode.rule, tactape_fab.advise.model; print('numba' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
    assert run.stdout.strip() == "False"


# No copies


def constants(source: str) -> list[tuple[str, tuple[float, ...]]]:
    """Names and values of the numbers, and tuples of numbers, that a module assigns to names."""
    found: list[tuple[str, tuple[float, ...]]] = []
    for node in ast.parse(source).body:
        if not isinstance(node, ast.Assign) or not isinstance(node.value, ast.Constant | ast.Tuple):
            continue
        (target,) = node.targets
        values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
        numbers = [value.value for value in values if isinstance(value, ast.Constant) and isinstance(value.value, int | float)]
        if len(numbers) < len(values):
            continue
        if isinstance(target, ast.Tuple):
            found += [(ast.unparse(name), (number,)) for name, number in zip(target.elts, numbers, strict=True)]
        else:
            found.append((ast.unparse(target), tuple(numbers)))
    return found


def copies(source: str) -> list[tuple[str, str]]:
    """Constants of a module and those of the rule that share a value, and a word of their names."""
    own = constants(Path(rule.__file__).read_text(encoding="utf-8"))
    return [
        (name, of_rule)
        for (name, values), (of_rule, known) in product(constants(source), own)
        if set(values) & set(known) and (set(name.split("_")) & set(of_rule.split("_"))) - COMMON - {""}
    ]


def test_a_copy_is_seen() -> None:
    old = "LEAST_SIGMA, MOST_SIGMA = 0.012, 0.06\n_KAPPA = 30\nBEST_GRID = 0.9\nDOME_TOLERANCE = 0.06\nRIM_MM = 0.25\n"
    assert [name for name, _ in copies(old)] == ["LEAST_SIGMA", "MOST_SIGMA", "_KAPPA", "BEST_GRID"]


@pytest.mark.parametrize("package", ["advise", "verify", "sense/decode"])
def test_no_constant_of_the_rule_is_copied(package: str) -> None:
    files = [path for path in sorted((PACKAGE / package).rglob("*.py")) if path.name != "rule.py"]
    assert files
    assert {path.name: found for path in files if (found := copies(path.read_text(encoding="utf-8")))} == {}, (
        "(name, name in the rule) have one value: import the rule's; name another quantity of that value without its words"
    )


# The kernels


@pytest.mark.parametrize("around", [[2, 3, 1, 0], [2, 6, 3, 7, 1, 5, 0, 4]], ids=["four directions", "eight directions"])
def test_dots_say_the_same_to_the_kernels(around: list[int]) -> None:
    rng, n = np.random.default_rng(2), 200
    weights, trust, sigma = rng.uniform(0.05, 1.3, n), rng.uniform(0.05, 1.0, n), 0.02
    nodes = np.column_stack([np.arange(n), np.zeros(n, dtype=np.int64)])
    places = DIRECTIONS_XY[around] / 6.0
    squares = ((rng.normal(0.0, 0.1, (n, 1, 2)) - places) ** 2).sum(axis=2)
    expected = rule.posteriors(squares.T, rule.squared_errors(weights, sigma), trust).T
    np.testing.assert_allclose(fit.posteriors(nodes, squares, weights, trust, sigma), expected, rtol=1e-9)


@pytest.mark.parametrize("error", [0.0, 0.02, 0.2])
def test_a_fit_believes_the_errors_that_the_rule_says(error: float) -> None:
    rng = np.random.default_rng(3)
    node = np.stack(np.meshgrid(np.arange(-4, 5), np.arange(-4, 5)), axis=-1).reshape(-1, 2)
    own = node + DIRECTIONS_XY[rng.integers(0, 4, len(node))] / 6.0
    xy, ones = 24.0 * (own + rng.normal(0.0, error, own.shape)), np.ones(len(own))
    found = fit.fit_grid(xy, ones, ones, 0.0, 24.0, 0.0, 0.0, 1 / 6, False)
    off = found.squares.min(axis=1).sum()
    assert found.sigma == pytest.approx(rule.sigma_of(float(off), len(own)), rel=0.15)
    if error != 0.02:
        assert found.sigma == (rule.LEAST_SIGMA if error == 0.0 else rule.MOST_SIGMA)


# The formulas


def test_posteriors_add_up_and_doubt_remains() -> None:
    near: FloatArray = np.array([[0.0, 0.04, 0.1, 0.04], [9.0, 9.1, 9.2, 9.1]]).T
    q = rule.posteriors(near, np.full(2, 0.02**2), np.ones(2))
    assert q.sum(axis=0) == pytest.approx(1.0)
    assert q[1:, 0] == pytest.approx(rule.WRONG_SHARE / 4, rel=0.1)
    assert q[:, 1] == pytest.approx(0.25)  # of no place: an outlier


def test_the_bound_is_the_inverse_of_the_weighted_evidence() -> None:
    assert rule.bound_of(log(1e4)) == pytest.approx(1e-4)
    assert rule.bound_of(-3.0) == 1.0
    assert [rule.share_of_others(w, 0.0) for w in (0.0, 1.0, 3.0)] == [0.0, 0.5, 0.75]
    assert sum(rule.GRID_SHARES) == pytest.approx(1.0)


def test_a_contact_that_is_misread_counts_as_a_place_whose_evidence_is_one() -> None:
    # posterior odds of "misread" against the answer: MISREAD_SHARE * 1 / (w E), and 1 / (w E) is p_tape
    p_tape = rule.bound_of(log(50.0))
    assert rule.share_of_others(0.0, p_tape) == pytest.approx(rule.MISREAD_SHARE / (50.0 + rule.MISREAD_SHARE))
    assert rule.share_of_others(0.5, p_tape) > rule.share_of_others(0.5, 0.0)


@pytest.mark.parametrize("counts", [[[900.0, 100.0]] * 4, [[900.0, 0.0], [0.0, 7.0], [1.0, 1.0], [3.0, 4.0]]])
def test_places_share_all_the_weight_there_is(counts: list[list[float]]) -> None:
    turns = np.array([0.49, 0.01, 0.49, 0.01])
    ln_weights = rule.place_weights(np.array(counts), turns, 0.5)
    assert (np.array(counts) * np.exp(ln_weights)).sum(axis=1) == pytest.approx(0.5 * turns)
    assert np.isneginf(ln_weights[np.array(counts) == 0.0]).all()
    assert np.exp(ln_weights[3, 1]) * counts[3][1] == pytest.approx(rule.OVERHANG_SHARE * 0.5 * turns[3])


@pytest.mark.parametrize("ln_ratio", [-600.0, -1.0, 0.0, 1.0, 600.0])
def test_half_a_turn_is_never_told_and_no_turn_is_excluded(ln_ratio: float) -> None:
    shares = rule.turn_shares(ln_ratio)
    assert shares.sum() == pytest.approx(1.0) and (shares[:2] == shares[2:]).all()
    assert shares.min() >= (1.0 - rule.MOST_TURN_SHARE) / 2.0 * (1.0 - 1e-9)
    assert np.sign(shares[0] - shares[1]) == np.sign(ln_ratio)
    assert shares == pytest.approx(np.roll(rule.turn_shares(-ln_ratio), 1))


def test_limits_of_a_localizer_are_those_of_the_rule() -> None:
    limits = rule.Limits()
    assert (limits.max_p_false, limits.on_tape, limits.kappa) == (rule.MAX_P_FALSE, rule.MAX_P_FALSE, rule.KAPPA)
    assert rule.Limits(max_p_tape=0.01).on_tape == 0.01
    assert [rule.least_agreeing(good) for good in (3, 13, 40)] == [rule.LEAST_DOTS, rule.LEAST_DOTS, 20]


def test_p_place_is_known_to_a_tenth_of_what_is_allowed() -> None:
    assert rule.Limits(max_p_false=1e-3).precision == pytest.approx(1e-4)


@pytest.mark.parametrize(
    ("shape", "length_mm", "width_mm", "is_long"),
    [("block", 0.5, 0.4, True), ("block", 0.4, 0.5, True), ("block", 0.49, 0.4, False), ("dome", 0.6, 0.3, False)],
)
def test_a_body_shows_its_direction_by_its_sides_alone(shape: str, length_mm: float, width_mm: float, is_long: bool) -> None:
    assert part.is_long(shape, (length_mm, width_mm, 2.0)) is is_long
    assert part.is_long(shape, (length_mm, width_mm, 0.01)) is is_long


def test_trust_is_a_logistic_curve_over_height() -> None:
    noise, steps = 0.1, np.array([-1e9, -30.0, -1.0, 0.0, 1.0, 30.0, 1e9])
    heights = (rule.NOISE_MIDDLE + rule.NOISE_WIDTH * steps) * noise
    expected = 1.0 / (1.0 + np.exp(-np.clip(steps, -30.0, 30.0)))
    np.testing.assert_allclose(rule.trusted(heights, noise), expected, rtol=1e-6)
    assert rule.trusted(np.array([rule.MOST_MIDDLE]), 10.0) == pytest.approx(0.5)
    assert rule.trusted(np.array([1e9])) == 1.0 / (1.0 + np.exp(-30.0))
    assert rule.trusted(heights) == pytest.approx(rule.trusted(heights, rule.USUAL_NOISE))


def test_errors_of_dots_grow_as_they_are_lower() -> None:
    heights = np.array([2.0, 1.0, 0.5, rule.LEAST_WEIGHT, 0.1])
    noise, rim = 0.02 / np.array([1.0, 1.0, 0.5, rule.LEAST_WEIGHT, rule.LEAST_WEIGHT]), np.array([0.0, 0.0, 0.5, 0.75, 0.9])
    np.testing.assert_allclose(rule.squared_errors(heights, 0.02), noise**2 + (rule.RIM_ERROR * rim) ** 2)


def test_the_error_of_a_good_dot_is_a_mean_with_what_was_believed() -> None:
    belief = rule.USUAL_COUNT * rule.USUAL_SIGMA**2
    assert rule.sigma_of(belief, 0.0) == pytest.approx(min(np.sqrt(2.0) * rule.USUAL_SIGMA, rule.MOST_SIGMA))
    assert rule.sigma_of(0.02, 20.0) == pytest.approx(np.sqrt((belief + 0.02) / (rule.USUAL_COUNT + 40.0)))


def test_posteriors_are_bayes_rule() -> None:
    squares, variance, trust = np.array([[0.0], [0.001], [0.003], [0.002]]), np.array([0.001]), np.array([0.6])
    density = np.exp(-squares / (2 * variance)) / (2 * np.pi * variance)
    part = 0.6 * (1.0 - rule.OUTLIER_SHARE)
    q = (part * density / 4 + (1.0 - part) / 4) / (part * density.sum(axis=0) / 4 + 1.0 - part)
    expected = (1.0 - rule.WRONG_SHARE) * q + rule.WRONG_SHARE / 4
    np.testing.assert_allclose(rule.posteriors(squares, variance, trust), expected, rtol=1e-12)
