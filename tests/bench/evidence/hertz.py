"""A rigid body pressed on a soft layer that is bonded to a rigid base: which patch touches, how deep, at what pressure.

Linear elasticity without friction or adhesion, the surfaces smooth paraboloids (Hertz), the layer as thick as it is: a thin,
nearly incompressible one touches over a smaller patch than a half-space, for it cannot give way sideways.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, pi, sqrt

import numpy as np
import numpy.typing as npt

from tactape_fab.texture.frames import FloatArray

Mask = npt.NDArray[np.bool_]
STEPS, DONE = 400, 1e-5


@dataclass(frozen=True, slots=True, kw_only=True)
class Gel:
    """The layer.

    Attributes
    ----------
    young_mpa, poisson : float
    thickness_mm : float
    radii_mm : (float, float)
        Radii of its own crown along x and y; inf where it is flat.
    face_mm : (float, float)
        What of it can touch, along x and y.
    """

    young_mpa: float
    poisson: float
    thickness_mm: float
    radii_mm: tuple[float, float] = (inf, inf)
    face_mm: tuple[float, float] = (inf, inf)

    @property
    def plane_mpa(self) -> float:
        """The modulus E / (1 - nu²) of contact with a rigid body."""
        return self.young_mpa / (1.0 - self.poisson**2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Patch:
    """What touches: an ellipse, where the gel's face does not cut it off.

    Attributes
    ----------
    axes_mm : (float, float)
        Both axes, along x and y, of the ellipse with the patch's second moments.
    depth_mm : float
        How far the body has come from the first touch.
    pressure_mpa : float
        Mean over the patch.
    """

    axes_mm: tuple[float, float]
    depth_mm: float
    pressure_mpa: float


def compliance(kh: FloatArray, poisson: float) -> FloatArray:
    """What a bonded layer gives way to a pressure wave, as a share of what a half-space would.

    Plane strain, no shear at the surface, no displacement at the base; `kh` is the wave number times the thickness. It tends
    to 1 for short waves, to that of a side-ways clamped column for long ones.
    """
    k = 3.0 - 4.0 * poisson
    fade = np.exp(-2.0 * kh)
    share: FloatArray = (2 * k * (1 - fade**2) - 8 * kh * fade) / (2 * k * (1 + fade**2) + 2 * fade * (1 + k * k + 4 * kh**2))
    return share


def press(force_n: float, radii_mm: Sequence[float], gel: Gel, *, half_mm: float = 14.0, cells: int = 128) -> Patch:
    """The patch of a body of these radii (inf: flat) along x and y.

    Parameters
    ----------
    half_mm : float
        Half the side of the square that is looked at, which must hold the patch.
    cells : int
        Its cells along each side.

    Notes
    -----
    Pressures that are nowhere below zero and leave no overlap, by conjugate gradients (Polonsky and Keer, Wear 231, 1999),
    convolutions by FFT on twice the square.
    """
    step_mm = 2 * half_mm / cells
    at = (np.arange(cells) + 0.5) * step_mm - half_mm
    x, y = np.meshgrid(at, at)
    curvature = [1 / body + 1 / own for body, own in zip(radii_mm, gel.radii_mm, strict=True)]
    gap = (curvature[0] * x**2 + curvature[1] * y**2) / 2
    face = (np.abs(x) <= gel.face_mm[0] / 2) & (np.abs(y) <= gel.face_mm[1] / 2)
    pressure, depth_mm = _pressure(force_n / step_mm**2, gap, face, _response(gel, cells, step_mm))
    touching = pressure > 0.0
    axes = (4 * sqrt((x[touching] ** 2).mean()), 4 * sqrt((y[touching] ** 2).mean()))
    return Patch(axes_mm=axes, depth_mm=depth_mm, pressure_mpa=force_n / (touching.sum() * step_mm**2))


def _response(gel: Gel, cells: int, step_mm: float) -> FloatArray:
    """Displacement over pressure, mm/MPa, by wave number, for `rfft2` of twice the square."""
    across = 2 * pi * np.fft.rfftfreq(2 * cells, step_mm)
    down = 2 * pi * np.fft.fftfreq(2 * cells, step_mm)
    wave = np.hypot(*np.meshgrid(across, down))
    wave[0, 0] = 1e-6 / gel.thickness_mm
    response: FloatArray = 2.0 / gel.plane_mpa * compliance(wave * gel.thickness_mm, gel.poisson) / wave
    return response


def _pressure(whole: float, gap: FloatArray, face: Mask, response: FloatArray) -> tuple[FloatArray, float]:
    """Pressure in each cell, their sum given, and the approach."""
    cells = len(gap)

    def sunk(pressure: FloatArray) -> FloatArray:
        spread = np.fft.rfft2(pressure, (2 * cells, 2 * cells)) * response
        back: FloatArray = np.fft.irfft2(spread, (2 * cells, 2 * cells))[:cells, :cells]
        return back

    pressure = face * (whole / face.sum())
    direction, before, restart, approach = np.zeros_like(pressure), 1.0, True, 0.0
    for _ in range(STEPS):
        level, touching = sunk(pressure) + gap, pressure > 0.0
        approach = float(level[touching].mean())
        rest = level - approach
        square = float((rest[touching] ** 2).sum())
        direction = np.where(touching, rest + (0.0 if restart else square / before) * direction, 0.0)
        before, change = square, sunk(direction)
        change -= change[touching].mean()
        length = float((rest * direction)[touching].sum() / (change * direction)[touching].sum())
        new = np.maximum(pressure - length * direction, 0.0)
        overlap = (new == 0.0) & (rest < 0.0) & face
        new[overlap] -= length * rest[overlap]
        restart = bool(overlap.any())
        new *= whole / new.sum()
        moved, pressure = float(np.abs(new - pressure).sum()), new
        if moved < DONE * whole:
            break
    return pressure, approach


def punch_depth_mm(force_n: float, area_mm2: float, gel: Gel) -> float:
    """How far a small flat punch sinks in: a circular one of the same area on a half-space, F = 2 a E* d (Boussinesq)."""
    return force_n / (2.0 * sqrt(area_mm2 / pi) * gel.plane_mpa)
