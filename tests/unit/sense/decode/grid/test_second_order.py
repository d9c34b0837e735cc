"""A second-order surface is what numpy's least squares gives, and its covariance that of the unknowns."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.sense.decode.grid import posterior, second_order
from tactape_fab.texture.frames import FloatArray

# compiled, they have no entry from Python: other kernels call them
add_point, solve, eliminate = (
    getattr(one, "py_func", one) for one in (second_order.add_point, second_order.solve, posterior.eliminate)
)


def terms(x: float, y: float) -> list[float]:
    return [1.0, x, y, x**2 / 2, y**2 / 2, x * y]


@pytest.fixture
def points() -> FloatArray:
    """x, y, value and weight of twelve points; (12, 4)."""
    rng = np.random.default_rng(1)
    return np.column_stack([rng.uniform(-2.0, 2.0, (12, 2)), rng.normal(0.3, 0.1, 12), rng.uniform(0.2, 1.5, 12)])


def test_it_is_the_weighted_least_squares_surface_and_its_inverse(points: FloatArray, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(second_order, "eliminate", eliminate)
    normal = np.zeros((7, 7))
    for x, y, value, weight in points.tolist():
        add_point(x, y, value, weight, normal)
    solve(normal)
    rows, root = np.array([terms(x, y) for x, y, *_ in points]), np.sqrt(points[:, 3])
    assert normal[:6, 6] == pytest.approx(np.linalg.lstsq(root[:, None] * rows, root * points[:, 2])[0])
    assert normal[:6, :6] == pytest.approx(np.linalg.inv(rows.T @ (points[:, 3, None] * rows)))


def test_what_is_added_to_the_diagonal_and_the_right_side_is_a_prior(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one point the surface is the prior's, but for what the point says: 0.5 at x = y = 0 moves the height by half."""
    monkeypatch.setattr(second_order, "eliminate", eliminate)
    normal, believed = np.zeros((7, 7)), np.array([0.1, 0.2, -0.3, 0.4, 0.5, -0.6])
    add_point(0.0, 0.0, 0.5, 1.0, normal)
    for i in range(6):
        normal[i, i] += 1.0
        normal[i, 6] += believed[i]
    solve(normal)
    assert normal[:6, 6] == pytest.approx([0.3, *believed[1:]])
    assert normal[:6, :6] == pytest.approx(np.diag([0.5, 1.0, 1.0, 1.0, 1.0, 1.0]))
