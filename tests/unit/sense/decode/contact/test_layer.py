"""The force on a gel from its surface alone, by the elasticity of a layer."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NoReturn

import numpy as np
import pytest

from tactape_fab.sense.decode.contact import layer
from tactape_fab.sense.decode.contact.layer import force_on
from tactape_fab.sense.geometry import Gel
from tactape_fab.sense.simulation.elastic_layer import Layer, compliance, deflection, press_rigid
from tactape_fab.sense.simulation.elastic_layer import response as response_of
from tactape_fab.texture.frames import FloatArray

GEL = Gel(thickness_mm=4.0, modulus_kpa=275.0, poisson=0.485, crown_mm=None)


def ball(force_n: float, gel: Gel = GEL, at_mm: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """A stiff ball of 60 mm radius pressed into a layer by the simulator's own solver; cells of 1 mm from 4 pixels a mm."""
    assert gel.modulus_kpa is not None and gel.thickness_mm is not None
    v, u = np.mgrid[:60, :80]
    x, y = (u - 39.5) / 4 - at_mm[0], (v - 29.5) / 4 - at_mm[1]
    of = response_of((60, 80), (4.0, 4.0), Layer(gel.thickness_mm, gel.modulus_kpa / 1000, 0.485))
    pressed = press_rigid((x**2 + y**2) / 120, force_n * 16, of)
    return np.asarray(pressed.deflection_mm.reshape(15, 4, 20, 4).mean(axis=(1, 3)))


def pressed_at(depth_mm: FloatArray) -> Any:
    return depth_mm > 0.03 * depth_mm.max()


@pytest.mark.parametrize("force_n", [0.5, 2.0, 8.0])
@pytest.mark.parametrize("gel", [GEL, replace(GEL, modulus_kpa=600.0), replace(GEL, thickness_mm=2.0)])
@pytest.mark.parametrize("zero_mm", [0.0, 0.07])
def test_a_force_is_found_by_the_layer_s_elasticity_alone(force_n: float, gel: Gel, zero_mm: float) -> None:
    """Also where the depth of an untouched gel is not known to be zero."""
    depth = ball(force_n, gel, (2.0, -1.0))
    (found, sigma), (zero, zero_sigma) = force_on(depth + zero_mm, (1.0, 1.0), pressed_at(depth), gel, 0.2 if zero_mm else 0.0005)
    assert found == pytest.approx(force_n, rel=0.1)
    assert abs(found - force_n) < 4 * sigma
    assert abs(zero - zero_mm) < 4 * zero_sigma + 0.005


@pytest.mark.parametrize("masked", [False, True])
def test_force_and_zero_are_those_of_numpy_s_solver(masked: bool) -> None:
    """By the formula of their docstring, with a matrix of all that is known and of all unknowns."""
    rng = np.random.default_rng(5)
    depth = ball(3.0) + rng.normal(0.05, 0.003, (15, 20))
    touched, valid = depth > 0.08, rng.random(depth.shape) > 0.1
    known = valid.ravel() if masked else np.ones(depth.size, dtype=bool)
    pressed = np.maximum(depth.ravel() - np.quantile(depth.ravel()[known], 0.05), 0.0) * touched.ravel()
    pressed = np.where(known, pressed, pressed[known].mean() * touched.ravel())
    sigmas = np.append(8.0 * 0.275 * pressed, 0.2)
    response = layer._response(depth.shape, (1.0, 1.0), 4.0, 0.275, 0.485)
    rates = (np.column_stack([response, np.ones(depth.size)]) * sigmas)[known] / layer.ERROR_MM
    sums = np.array([[*sigmas[:-1], 0.0], [*np.zeros(depth.size), sigmas[-1]]])
    covariance = np.linalg.inv(rates.T @ rates + np.eye(len(sigmas)))
    expected = sums @ covariance @ rates.T @ (depth.ravel()[known] / layer.ERROR_MM)
    deviation = np.sqrt(np.diag(sums @ covariance @ sums.T))
    (force, sigma), (zero, zero_sigma) = force_on(depth, (1.0, 1.0), touched, GEL, 0.2, valid if masked else None)
    assert [force, zero, zero_sigma] == pytest.approx([*expected, deviation[1]], rel=1e-9)
    assert sigma == pytest.approx(np.hypot(deviation[0], layer.SHARE * force), rel=1e-9)


class NoProduct(np.ndarray):
    """An array that numpy multiplies with no other, nor solves for."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        assert ufunc is not np.matmul
        return getattr(ufunc, method)(*map(np.asarray, inputs), **options)

    def __array_function__(self, *_: Any) -> NoReturn:
        raise AssertionError


def test_no_product_of_a_force_is_left_to_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """BLAS gives large ones to several, each of which waits for the others: long on a busy machine."""
    depth, rates, kernel = ball(2.0), layer._rates, layer.factor
    expected = force_on(depth, (1.0, 1.0), pressed_at(depth), GEL, 0.0005)
    monkeypatch.setattr(layer, "_rates", lambda *of: [array.view(NoProduct) for array in rates(*of)])
    monkeypatch.setattr(layer, "factor", lambda *given: kernel(*map(np.asarray, given[:-2]), *given[-2:]))
    assert force_on(depth, (1.0, 1.0), pressed_at(depth), GEL, 0.0005) == expected


def test_force_is_proportional_to_modulus() -> None:
    depth = ball(2.0)
    one, two = (
        force_on(depth, (1.0, 1.0), pressed_at(depth), replace(GEL, modulus_kpa=kpa), 0.0005)[0][0] for kpa in (275.0, 550.0)
    )
    assert two == pytest.approx(2 * one, rel=1e-6)


def test_nothing_pressed_is_no_force() -> None:
    (found, sigma), _ = force_on(np.zeros((15, 20)), (1.0, 1.0), np.ones((15, 20), dtype=bool), GEL, 0.001)
    assert (found, sigma) == (0.0, 0.0)


def test_waves_deflect_the_layer_as_in_the_simulator() -> None:
    """Which has the formula in a form of its own; without a wave it is that of uniaxial strain."""
    waves = np.array([0.0, 1e-3, 0.05, 0.2, 0.5, 1.0, 2.0, 10.0, 100.0])
    for thickness_mm, poisson in ((4.0, 0.485), (1.5, 0.3)):
        expected = compliance(waves, Layer(thickness_mm, 0.275, poisson))
        assert layer._compliance(waves, thickness_mm, 0.275, poisson) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("cell_mm", [(1.0, 0.8), (0.8, 1.25)])
def test_a_force_on_a_cell_deflects_all_as_in_the_simulator(cell_mm: tuple[float, float]) -> None:
    """With 20 x 20 of its pixels a cell; forces of a cell are spread over it, and deflections are its mean."""
    rows, columns, fine, at = 6, 7, 20, (2, 3)
    of = response_of((rows * fine, columns * fine), (fine / cell_mm[0], fine / cell_mm[1]), Layer(4.0, 0.275, 0.485))
    pressure_mpa = np.zeros((rows * fine, columns * fine))
    pressure_mpa[at[0] * fine : (at[0] + 1) * fine, at[1] * fine : (at[1] + 1) * fine] = 1.0 / (cell_mm[0] * cell_mm[1])
    expected = deflection(pressure_mpa, of).reshape(rows, fine, columns, fine).mean(axis=(1, 3))
    found = layer._response((rows, columns), cell_mm, 4.0, 0.275, 0.485)[at[0] * columns + at[1]].reshape(rows, columns)
    assert np.abs(found - expected).max() < 0.01 * expected.max()


def test_a_gel_without_poisson_s_ratio_is_nearly_incompressible() -> None:
    depth = ball(2.0)
    one, two = (force_on(depth, (1.0, 1.0), pressed_at(depth), replace(GEL, poisson=nu), 0.0005) for nu in (None, 0.485))
    assert one == two
