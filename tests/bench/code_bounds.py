"""Delsarte's linear-programming bound: the most bits in which so many binary words of a length can all differ."""

from __future__ import annotations

from fractions import Fraction
from math import comb

import numpy as np
from scipy.optimize import linprog


def largest_code(length: int, distance: int) -> float:
    """Upper bound on the number of words of `length` bits of which any two differ in at least `distance` (Delsarte, 1973).

    With K_k the Krawtchouk polynomials, f(i) = 1 + sum of f_k K_k(i), all f_k >= 0 and f(i) <= 0 for i >= distance, there are at
    most f(0) words. A solver finds f; what it leaves above 0 is then taken off f in exact arithmetic, so that the bound holds.
    """
    weights, orders = range(distance, length + 1), range(1, length + 1)
    values = [[Fraction(_krawtchouk(length, k, i), comb(length, k)) for k in orders] for i in weights]
    rows = np.array([[float(value) for value in row] for row in values])
    found = linprog(np.ones(length), A_ub=rows, b_ub=-np.ones(len(rows)), bounds=(0.0, None))
    if not found.success:
        raise ArithmeticError(f"no bound for {length} bits and distance {distance}: {found.message}")
    f = [Fraction(float(one)) for one in found.x]  # f_k C(n, k)
    above = max(Fraction(0), *(1 + sum(one * value for one, value in zip(f, row, strict=True)) for row in values))
    if above >= 1:
        raise ArithmeticError(f"no bound for {length} bits and distance {distance}: the solver's answer is off by {float(above)}")
    return float((1 + sum(f) - above) / (1 - above))


def most_distance(length: int, words: int) -> int:
    """Most bits in which so many words of `length` bits can all differ, by that bound."""
    distance = length
    while distance > 0 and largest_code(length, distance) < words:
        distance -= 1
    return distance


def _krawtchouk(n: int, k: int, i: int) -> int:
    return sum((-1) ** j * comb(i, j) * comb(n - i, k - j) for j in range(k + 1))
