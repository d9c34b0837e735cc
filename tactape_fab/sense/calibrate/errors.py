"""Errors of dots: their own, the rim's, and the gel's smooth displacement, estimated by restricted maximum likelihood."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dposv, dpotrf, dtrtrs
from scipy.optimize import minimize

from tactape_fab.sense.calibrate.presses import Press
from tactape_fab.sense.decode.grid.beliefs import rim_mm2
from tactape_fab.texture.frames import FloatArray

START_MM = 0.01
LEAST_MM = 0.0005
"""Least error of a full dot: where the rim's variance explains all residuals, as of middles between edges, none is likeliest."""
STARTS = ((0.03, 3.0), (0.1, 6.0))
"""Initial values of a gel's displacement and its correlation length, mm, for the maximisation of the likelihood."""
CORRELATIONS_MM = (1.0, 20.0)
LEAST_GAIN = 3.0
"""Least gain in log likelihood for which a displacement of the gel is kept."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Errors of a dot's centre along one axis.

    dot_mm: Standard deviation of a full dot.
    gel_mm, correlation_mm: Root mean square of the gel's smooth displacement, and the standard deviation of the Gaussian that
        correlates it.
    """

    dot_mm: float = 0.015
    gel_mm: float = 0.0
    correlation_mm: float = 4.0


def covariance(press: Press, errors: Errors, apart_mm2: FloatArray | None = None) -> FloatArray:
    """Covariance of the dots of a press along an axis; shape (n, n), mm^2. The model is that of `decode.grid.posterior`.

    apart_mm2: Squared distances of the dots, if already computed.
    """
    own = errors.dot_mm**2 / np.sqrt(press.weights) + rim_mm2(press.weights, press.by_edges)
    if errors.gel_mm == 0.0:
        return np.diag(own)
    apart_mm2 = _apart_mm2(press) if apart_mm2 is None else apart_mm2
    out: FloatArray = errors.gel_mm**2 * np.exp(apart_mm2 / (-2.0 * errors.correlation_mm**2))
    out.flat[:: len(own) + 1] += own
    return out


def _apart_mm2(press: Press) -> FloatArray:
    """Squared distances of the dots; shape (n, n)."""
    # distances on the tape: the gel lies on it, and a turn changes none
    apart = press.texture_mm[:, None] - press.texture_mm
    return np.asarray((apart**2).sum(axis=2))


def whitening(press: Press, errors: Errors) -> FloatArray:
    """Matrix that makes the errors of a press along an axis independent, of variance 1; shape (n, n)."""
    # V = L L^T, so that L^-1 e has the covariance L^-1 V L^-T = I
    lower = np.linalg.cholesky(covariance(press, errors))
    return np.asarray(solve_triangular(lower, np.eye(len(lower)), lower=True))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Design:
    """A press at the solution of an adjustment: residuals, and Jacobians by the shared and by its own unknowns."""

    press: Press
    residual_mm: FloatArray
    shared: FloatArray
    own: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Errors of dots, and the standard deviations of the ln of each; infinite for the gel's if no displacement is seen."""

    errors: Errors
    sigma_ln_gel: float
    sigma_ln_correlation: float


def estimate_errors(designs: Sequence[Design], precision: FloatArray, own_precision: FloatArray) -> Estimate:
    """Errors of the dots by restricted maximum likelihood (Harville, JASA 72 (1977) 320): poses and camera are marginalised.

    precision (k, k): Prior precision of the shared unknowns.
    own_precision (4, 4): Prior precision of a press's own unknowns.
    Returns: Without displacement of the gel unless it raises the log likelihood by `LEAST_GAIN`.
    """
    rows = [_rows_of(design) for design in designs]

    def cost(z: FloatArray) -> float:
        return _minus_ln_likelihood(rows, _errors_of(z), precision, own_precision)

    # the errors at the start are as good as any: the likelihood of a variance alone has one maximum
    still = minimize(cost, np.array([np.log(START_MM)]), method="Nelder-Mead", options={"xatol": 0.01, "fatol": 0.01})
    best, best_cost = None, still.fun - LEAST_GAIN
    for gel_mm, correlation_mm in STARTS:
        begin = np.array([float(still.x[0]), np.log(gel_mm), np.log(correlation_mm)])
        # ln of the dots' error down and of the gel's figures up: part of the scatter goes from one to the other
        simplex = begin + np.concatenate([np.zeros((1, 3)), np.diag([-0.2, 0.5, 0.3])])
        moved = minimize(cost, begin, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.02, "initial_simplex": simplex})
        if moved.fun < best_cost:
            best, best_cost = moved.x, moved.fun
    if best is None:
        return Estimate(errors=_errors_of(still.x), sigma_ln_gel=inf, sigma_ln_correlation=inf)
    spread = _spread(cost, best)
    return Estimate(errors=_errors_of(best), sigma_ln_gel=spread[1], sigma_ln_correlation=spread[2])


def _errors_of(z: FloatArray) -> Errors:
    dot_mm = max(float(np.exp(z[0])), LEAST_MM)
    if len(z) == 1:
        return Errors(dot_mm=dot_mm)
    # a gel moves 1 mm at most; a correlation length below the dots' pitch, or beyond the field, is not observable
    correlation_mm = float(np.clip(np.exp(z[2]), *CORRELATIONS_MM))
    return Errors(dot_mm=dot_mm, gel_mm=float(np.exp(min(z[1], 0.0))), correlation_mm=correlation_mm)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Rows:
    """Parts of a likelihood that do not depend on the errors, of one press.

    apart_mm2: Squared distances of its dots; shape (n, n).
    columns: Jacobian by its own and by the shared unknowns, and residuals, along both axes; shape (n, 2 m).
    """

    press: Press
    apart_mm2: FloatArray
    columns: FloatArray


def _rows_of(design: Design) -> _Rows:
    columns = np.concatenate([design.own, design.shared, design.residual_mm[:, :, None]], axis=2)
    return _Rows(press=design.press, apart_mm2=_apart_mm2(design.press), columns=columns.reshape(len(columns), -1))


def _minus_ln_likelihood(presses: Sequence[_Rows], errors: Errors, precision: FloatArray, own_precision: FloatArray) -> float:
    """Minus ln of the restricted likelihood, up to a constant; presses are eliminated one by one."""
    # -2 ln L = ln |V| + ln |A^T V^-1 A| + r^T V^-1 r - (A^T V^-1 r)^T (A^T V^-1 A)^-1 (A^T V^-1 r), A the derivatives with those
    # of the priors: as if the residuals were fitted anew for each V, and less what the unknowns take of them
    count, total = len(own_precision), 0.0
    # derivatives by the shared unknowns, and what is left in the last row and column, without what a press's own take of them
    reduced = np.zeros((len(precision) + 1, len(precision) + 1))
    reduced[:-1, :-1] = precision
    for each in presses:
        # LAPACK called directly: numpy's checks take as long as the computation
        lower = dpotrf(covariance(each.press, errors, each.apart_mm2), lower=1, clean=0)[0]
        total += 4.0 * float(np.log(lower.diagonal()).sum())  # ln of both determinants
        # rows are dots and axes, the last column holds the residuals
        white = dtrtrs(lower, each.columns, lower=1)[0].reshape(2 * len(lower), -1)
        products = white.T @ white
        factor, lean, failed = dposv(products[:count, :count] + own_precision, products[:count, count:], lower=1)
        # not positive definite: a press's own unknowns are open, and no minimum is there
        if failed:
            return inf
        total += 2.0 * float(np.log(factor.diagonal()).sum())
        reduced += products[count:, count:] - products[count:, :count] @ lean
    normal, right = reduced[:-1, :-1], reduced[:-1, -1]
    total += float(reduced[-1, -1] + np.linalg.slogdet(normal)[1] - right @ np.linalg.solve(normal, right))
    return total / 2.0


def _spread(cost: Callable[[FloatArray], float], at: FloatArray) -> list[float]:
    """Standard deviations from the Hessian of minus a log likelihood, by finite differences."""
    steps = 0.1 * np.eye(len(at))
    curve = np.empty((len(at), len(at)))
    for i in range(len(at)):
        for j in range(len(at)):
            signs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
            # (f++ - f+- - f-+ + f--) / 4 h^2 for h = 0.1; with i = j it is the second difference over 2 h
            curve[i, j] = sum(p * q * cost(at + p * steps[i] + q * steps[j]) for p, q in signs) / 0.04
    try:
        variances = np.linalg.inv(curve).diagonal()
    except np.linalg.LinAlgError:
        return [inf] * len(at)
    return [float(np.sqrt(v)) if v > 0.0 else inf for v in variances]
