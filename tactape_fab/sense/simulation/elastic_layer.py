"""Frictionless contact of a rigid surface with an elastic layer bonded to a rigid base: pressure and deflection on a grid.

Conjugate gradients for contact of Polonsky and Keer (Wear 231, 1999), the layer's response by Fourier transform; its inverse as a
preconditioner takes 15 rounds instead of 100 where the film touches. Linear elasticity; no friction, no adhesion. Nothing here
knows tapes or sensors.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from tactape_fab.sense.simulation.noise import _fast_length
from tactape_fab.texture.frames import FloatArray

_REACH = 4.0
"""Grids are padded by so many thicknesses of the layer: a point's response there is 3e-3 of that at a quarter of one."""
_MOST_PADDING = 3
_TOLERANCE = 3e-5
"""Change of pressure in a round, relative to the force, at which it ends."""
_MOST_ROUNDS = 500
_ENTRY = 0.3
"""Initial pressure of an overlapping pixel that enters the contact, over the pressure that would lift it alone."""


class Layer(NamedTuple):
    """An elastic layer: thickness in mm, Young's modulus in N/mm2, Poisson's ratio."""

    thickness_mm: float
    modulus_mpa: float
    poisson: float


class Response(NamedTuple):
    """Deflection of a layer under pressure on a grid.

    `size` is the padded (rows, columns), `spectrum` the compliance at its frequencies, `own` the deflection of a pixel under unit
    pressure on itself alone, mm3/N; `stiffness` is 1 / compliance at the frequencies of the grid without padding.
    """

    size: tuple[int, int]
    spectrum: FloatArray
    own: float
    stiffness: FloatArray


class Pressed(NamedTuple):
    """A solved contact: pressure in N/mm2, deflection and gap in mm, each (h, w)."""

    pressure_mpa: FloatArray
    deflection_mm: FloatArray
    gap_mm: FloatArray


def compliance(wavenumber_per_mm: npt.ArrayLike, layer: Layer) -> FloatArray:
    """Deflection of a layer's surface over a pressure wave of an angular wavenumber, mm3/N.

    u / p = 2 / (E* k) [kappa (1 - e^2) - 4 a e] / [kappa (1 + e^2) + e (1 + kappa^2 + 4 a^2)] with a = k h, e = exp(-2 a),
    kappa = 3 - 4 nu; towards k = 0 it is that of the layer in uniaxial strain, h (1 + nu)(1 - 2 nu) / (E (1 - nu)).
    """
    h, modulus, nu = layer
    k = np.asarray(wavenumber_per_mm, dtype=np.float64)
    uniform = h * (1 + nu) * (1 - 2 * nu) / (modulus * (1 - nu))
    a = np.maximum(k * h, 1e-3)  # below, digits cancel, and it is the limit to 1e-5 (nu = 0.485)
    e, kappa = np.exp(-2 * a), 3 - 4 * nu
    share = (kappa * (1 - e * e) - 4 * a * e) / (kappa * (1 + e * e) + e * (1 + kappa**2 + 4 * a * a))
    return np.where(k * h < 1e-3, uniform, 2 * h * (1 - nu**2) / (modulus * a) * share)


@lru_cache(maxsize=2)
def response(shape: tuple[int, int], px_per_mm: tuple[float, float], layer: Layer) -> Response:
    """The response of a layer on a grid of `shape` pixels, with px/mm along columns (u) and rows (v).

    The grid is padded by four thicknesses, at most by three times its size, so that its periodic images do not matter.
    """
    # a transform's deflection is periodic: what leaves the grid on one side comes in on the other
    most = (min(_REACH * layer.thickness_mm * px_per_mm[1 - i], _MOST_PADDING * shape[i]) for i in range(2))
    rows, columns = (_fast_length(n + int(np.ceil(pad))) for n, pad in zip(shape, most, strict=True))
    spectrum = _compliances((rows, columns), px_per_mm, layer)
    # unit pressure on one pixel has the spectrum 1 everywhere, so that this is the response's own value there
    own = float(np.fft.irfft2(spectrum, (rows, columns))[0, 0])
    return Response(size=(rows, columns), spectrum=spectrum, own=own, stiffness=1 / _compliances(shape, px_per_mm, layer))


def _compliances(size: tuple[int, int], px_per_mm: tuple[float, float], layer: Layer) -> FloatArray:
    """Compliance at the frequencies of `rfft2` of a grid."""
    along_u = 2 * np.pi * np.fft.rfftfreq(size[1], 1 / px_per_mm[0])
    along_v = 2 * np.pi * np.fft.fftfreq(size[0], 1 / px_per_mm[1])
    return compliance(np.hypot(along_u, along_v[:, None]), layer)


def deflection(pressure_mpa: FloatArray, of: Response) -> FloatArray:
    """Deflection of the surface under a pressure; shape (h, w), mm."""
    h, w = pressure_mpa.shape
    # axis by axis: rows of the padding are zero before the first transform, and are not asked for after the last
    waves = np.fft.fft(np.fft.rfft(pressure_mpa, of.size[1], axis=1), of.size[0], axis=0)
    waves *= of.spectrum
    return np.fft.irfft(np.fft.ifft(waves, axis=0)[:h], of.size[1], axis=1)[:, :w]


def press_rigid(shape_mm: FloatArray, force: float, of: Response, start_mpa: FloatArray | None = None) -> Pressed:
    """Press a rigid surface against the layer with a force.

    shape_mm (h, w): Distance of the rigid surface from the undeformed layer, up to a constant.
    force: N times pixels per mm2: the sum of all pixels' pressures.
    start_mpa (h, w): Pressure to start from, such as that of a smaller force; a uniform one when left out.
    Returns: Its gap is zero where there is pressure, and nowhere negative, up to the tolerance.
    """
    pressure = np.full(shape_mm.shape, force / shape_mm.size) if start_mpa is None else start_mpa * (force / start_mpa.sum())
    along, last, conjugate = np.zeros_like(pressure), 1.0, False
    change, rounds = np.inf, 0
    while change > _TOLERANCE and rounds < _MOST_ROUNDS:
        # how far the rigid surface goes in is unknown, and the force is given: it is the mean gap in the contact that must be
        # taken off
        touching = (pressure > 0.0).astype(np.float64)
        count = touching.sum()
        gap = deflection(pressure, of) + shape_mm
        gap -= _product(gap, touching) / count
        residual = gap * touching
        rise = _stiffened(residual, of) * touching
        # of sum zero in the contact, so that a step changes no force; what masks and cuts change after that is scaled away
        rise -= touching * (rise.sum() / count)
        squares = _product(residual, rise)
        # Fletcher and Reeves' factor; a pixel that has left the contact has no part in the direction
        along *= touching * (squares / last) if conjugate else 0.0
        along += rise
        answer = deflection(along, of)
        # the energy along the line is a parabola: its slope is residual . along, its curvature along . K along
        bend = _product(answer, along)
        step = _product(residual, along) / bend if bend > 0.0 else 0.0
        new = np.maximum(pressure - step * along, 0.0)
        # no pressure and yet overlapping: the pixel enters, and as the contact is another then, directions are no longer
        # conjugate
        overlap = (new <= 0.0) & (gap < 0.0)
        conjugate, last = squares > 0.0 and not overlap.any(), squares
        new -= gap * overlap * (_ENTRY / of.own)
        new *= force / new.sum()
        change, pressure, rounds = float(np.abs(new - pressure).sum()) / force, new, rounds + 1
    # zero where there is pressure: on the mean with the pressure as weight
    bent = deflection(pressure, of)
    gap = bent + shape_mm
    return Pressed(pressure, bent, gap - _product(gap, pressure) / force)


def _stiffened(gap_mm: FloatArray, of: Response) -> FloatArray:
    """Preconditioner: the pressure that would close a gap if the layer were periodic and in contact everywhere."""
    return np.fft.irfft2(np.fft.rfft2(gap_mm) * of.stiffness, gap_mm.shape)


def _product(a: FloatArray, b: FloatArray) -> float:
    """The sum of products, in one thread."""
    return float(np.einsum("ij,ij", a, b))
