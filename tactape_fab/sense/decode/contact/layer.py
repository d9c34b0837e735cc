"""Depth of a gel's surface -> the force on it, by the elasticity of a layer that is bonded to a stiff base.

Nothing here is tuned on forces. The deflection u of the layer is linear in the pressure p on it, u = A p, with the layer's
response A from its thickness, Young's modulus and Poisson's ratio (K. L. Johnson, Contact Mechanics, 1985, section 5.8). Where
the gel is pressed in, p is believed to be normal, of mean zero and of a wide standard deviation; the frame's zero is another such
unknown. Then force and zero given u are their conditional means (Gaussian process regression).
"""

from __future__ import annotations

from functools import lru_cache
from math import sqrt

import numpy as np

from tactape_fab.base.jit import kernel
from tactape_fab.sense.geometry import Gel
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

POISSON = 0.485
"""Poisson's ratio of a gel whose profile has none: silicone, nearly incompressible."""
PRESSURE = 8.0
"""Prior standard deviation of the pressure per mm of indentation, over Young's modulus; forces hardly depend on it."""
ERROR_MM = 0.003
"""Error of a cell's mean depth: a photometric sensor's noise, and parts that stand anywhere within a cell."""
SHARE = 0.05
"""Relative error of the force by effects that the layer model leaves out: slopes that saturate, large strains, a crown."""
_MIRRORS = 2
"""Multiples of the grid's frequency on each side that cells' means still show."""


@lru_cache(maxsize=4)
def _rates(
    size: tuple[int, int],
    cell_mm: tuple[float, float],
    thickness_mm: float,
    modulus_mpa: float,
    poisson: float,
    valid: bytes | None,
) -> tuple[FloatArray, FloatArray]:
    """The depths of known cells by force on each cell, and by the frame's zero; and products of any two of these.

    valid: Of the array of cells whose depth is known; None: all.
    Returns rates (n + 1, k): Mean deflection of each of k known cells, mm, by 1 N on each of n cells; then by a zero of 1 mm.
    Returns products (n + 1, n + 1): Sums over the known cells.
    """
    rates = np.vstack([_response(size, cell_mm, thickness_mm, modulus_mpa, poisson), np.ones(size[0] * size[1])])
    if valid is not None:
        rates = rates[:, np.frombuffer(valid, dtype=np.bool_)]
    return np.ascontiguousarray(rates), rates @ rates.T


def _response(
    size: tuple[int, int], cell_mm: tuple[float, float], thickness_mm: float, modulus_mpa: float, poisson: float
) -> FloatArray:
    """Mean deflection of each cell by a force of 1 N on each other; shape (n, n), mm/N, with cells row by row."""
    # a DFT is periodic: the grid is larger by four thicknesses, where 6e-4 of the response to a force on 1 mm^2 is left
    reach = [n + int(np.ceil(4 * thickness_mm / cell)) for n, cell in zip(size[::-1], cell_mm, strict=True)]  # u, v
    count = [1 << int(2 * n - 1).bit_length() for n in reach]
    spectrum = np.zeros((count[1], count[0]))
    of_u, of_v = (2 * np.pi * np.fft.fftfreq(n, cell) for n, cell in zip(count, cell_mm, strict=True))
    for i in range(-_MIRRORS, _MIRRORS + 1):
        for j in range(-_MIRRORS, _MIRRORS + 1):
            u, v = of_u + 2 * np.pi * i / cell_mm[0], of_v + 2 * np.pi * j / cell_mm[1]
            # a uniform pressure on a cell and the mean over a cell have a sinc each along an axis. np.sinc(x) is sin(pi x) /
            # (pi x)
            window = np.sinc(v * cell_mm[1] / (2 * np.pi))[:, None] ** 2 * np.sinc(u * cell_mm[0] / (2 * np.pi)) ** 2
            spectrum += window * _compliance(np.hypot(u, v[:, None]), thickness_mm, modulus_mpa, poisson)
    # u = 1 / (2 pi)^2 integral of C(k) window d^2k for 1 N: with the DFT's steps of 2 pi / (N cell) its mean over N^2 entries,
    # over the cell's area. Frequencies beyond the grid's fold back onto it, which the mirrors add up
    point = np.fft.ifft2(spectrum).real / (cell_mm[0] * cell_mm[1])
    # the response depends on the difference of places alone; negative ones are at the end of the periodic table
    row, column = np.divmod(np.arange(size[0] * size[1]), size[1])
    return np.asarray(point[row[:, None] - row, column[:, None] - column])


def _compliance(wavenumber: FloatArray, thickness_mm: float, modulus_mpa: float, poisson: float) -> FloatArray:
    """Deflection of the layer's surface over a pressure wave on it, mm3/N.

    It is 4 (1 - nu^2) / (E k) (kappa sinh 2a - 2a) / (2 kappa cosh 2a + 1 + kappa^2 + 4 a^2), with a = k h and kappa = 3 - 4 nu.
    """
    a = np.clip(wavenumber * thickness_mm, 1e-3, 20.0)  # from 20 on it is that of a half-space
    kappa = 3.0 - 4.0 * poisson
    # for large a the whole tends to 2 (1 - nu^2) / (E k), the half-space; for a -> 0 to h (1 + nu) (1 - 2 nu) / (E (1 - nu)), a
    # layer under uniform pressure
    share = (2 * kappa * np.sinh(2 * a) - 4 * a) / (2 * kappa * np.cosh(2 * a) + 1 + kappa**2 + 4 * a * a)
    return 2 * (1 - poisson**2) / (modulus_mpa * np.maximum(wavenumber, 1e-3 / thickness_mm)) * share


def force_on(
    depth_mm: FloatArray,
    cell_mm: tuple[float, float],
    touched: BoolArray,
    gel: Gel,
    zero_mm: float,
    valid: BoolArray | None = None,
) -> tuple[tuple[float, float], tuple[float, float]]:
    """The force on a gel, and the frame's zero, each with its standard deviation; N and mm.

    depth_mm (h, w): Mean depth of each cell of the frame.
    cell_mm: Size of a cell along u and v.
    touched (h, w): Cells on which the tape may press.
    gel: With thickness and modulus.
    zero_mm: Standard deviation of the depth that a gel would have which nothing touches, about 0.
    valid (h, w): Cells whose depth is known.
    """
    assert gel.thickness_mm is not None and gel.modulus_kpa is not None
    known_cells = slice(None) if valid is None else valid.ravel()
    depth, modulus_mpa = depth_mm.ravel().astype(np.float64, copy=False), gel.modulus_kpa / 1000.0
    # the zero is not known yet: the fifth percentile is near it while a twentieth of the frame is not touched
    # (`np.quantile` would take a fifth of the whole)
    ordered = np.sort(depth[known_cells])
    low = np.interp(0.05 * (len(ordered) - 1), np.arange(len(ordered)), ordered)
    pressed = np.maximum(depth - low, 0.0) * touched.ravel()
    if valid is not None:
        pressed = np.where(valid.ravel(), pressed, pressed[known_cells].mean() * touched.ravel())
    there = np.flatnonzero(pressed)
    # unknowns over their standard deviations: the forces on the cells there, and the zero
    sigmas = np.append(PRESSURE * modulus_mpa * cell_mm[0] * cell_mm[1] * pressed[there], zero_mm)
    poisson = POISSON if gel.poisson is None else gel.poisson
    size = (depth_mm.shape[0], depth_mm.shape[1])
    rates, products = _rates(size, cell_mm, gel.thickness_mm, modulus_mpa, poisson, None if valid is None else valid.tobytes())
    work, unknowns = np.empty((len(sigmas) + 3, len(sigmas))), np.append(there, len(depth))
    factor(products, rates, depth[known_cells], unknowns, sigmas, ERROR_MM, work)
    # rows of L^-1 times the sums that are asked for, and times R^T d: their products are means and variances
    force, zero = (work[-3:-1] @ work[-1]).tolist()
    variances = (work[-3:-1] ** 2).sum(axis=1).tolist()
    return (force, sqrt(variances[0] + (SHARE * force) ** 2)), (zero, sqrt(variances[1]))


@kernel(fastmath=True)
def factor(
    products: FloatArray,
    rates: FloatArray,
    depth: FloatArray,
    unknowns: IntArray,
    sigmas: FloatArray,
    error: float,
    work: FloatArray,
) -> None:
    """Factor the normal matrix of the unknowns, and solve with its factor for the sum of all forces, the zero, and the depths.

    depth = rates z + noise, all over their standard deviations: the posterior of z is N(K^-1 R^T d, K^-1) with K = R^T R + 1.
    Rows below K become L^-1 times what they are, by the recurrence of Cholesky's L itself. numpy's product and solver would give
    this to several threads, and on a busy machine such a one waits for the others, which takes far longer.

    products, rates: From `_rates`.
    depth (k,), mm
    unknowns (m,): Rows of them that are asked for; the last is the zero.
    sigmas (m,): Standard deviations of the unknowns before the frame.
    error: That of a depth, mm.
    work (m + 3, m): L, and below it three rows: the sums, each m, and R^T d.
    """
    m = len(unknowns)
    for i in range(m):
        row, right = unknowns[i], 0.0
        for j in range(i + 1):
            work[i, j] = sigmas[i] * sigmas[j] / (error * error) * products[row, unknowns[j]]
        work[i, i] += 1.0
        for k in range(len(depth)):
            right += rates[row, k] * depth[k]
        work[m, i], work[m + 1, i], work[m + 2, i] = sigmas[i], 0.0, sigmas[i] / (error * error) * right
    work[m, m - 1], work[m + 1, m - 1] = 0.0, sigmas[m - 1]
    for i in range(m + 3):
        for j in range(min(i + 1, m)):
            rest = work[i, j]
            for k in range(j):
                rest -= work[i, k] * work[j, k]
            work[i, j] = np.sqrt(rest) if i == j else rest / work[j, j]
