"""Camera model of a tactile sensor: pixels of points that lie on its gel, and how well each parameter is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tactape_fab.texture.frames import FloatArray

_NEWTON_STEPS = 4
"""Newton's steps for the radius: below 1e-9 px for k1 from -0.12 to 0.2 at the corner, from -0.05 to 0.05 within 1.5 times its
radius. Of a barrel below -4 / 27 = -0.148 nothing is seen at the corner: its image ends at 2 / 3 sqrt(-1 / (3 k1)) radii."""
MOST_BARREL = 0.12
"""Largest -k1 rho^2, rho the radius of a pixel in corner radii: up to there `_NEWTON_STEPS` are enough."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Geometry:
    """A sensor's camera beside its scale, and the standard deviation of each parameter.

    A point q (mm right and down of the centre) is seen at p = centre + (1 + k1 r^2 / r_corner^2) M q, with r = |M q| and r_corner
    half the image's diagonal, both in px, and M = [[R_u (1 + aspect / 2), R_u shear], [0, R_v (1 - aspect / 2)]] for the
    profile's px/mm (R_u, R_v). Horizontal lines stay horizontal: theta is the turn of image u.

    aspect: Stretch along u over that along v, less 1.
    shear: Shift along u for each unit along v.
    k1: Radial distortion at the image's corner; positive is pincushion.
    center_px: Centre of the distortion, canonical image; None: the image centre.
    sigma_px_per_mm: Standard deviation of the scale, px/mm; None: half the profile's `scale_tolerance`.
    sigma_aspect, sigma_shear, sigma_k1: Standard deviations of the other parameters. The defaults are those of a sensor that
        nobody calibrated.
    """

    aspect: float = 0.0
    shear: float = 0.0
    k1: float = 0.0
    center_px: tuple[float, float] | None = None
    sigma_px_per_mm: float | None = None
    sigma_aspect: float = 0.03
    sigma_shear: float = 0.02
    sigma_k1: float = 0.03


USUAL_BLUR_MM = 0.15
"""Standard deviation of the Gaussian of a gel whose profile does not know it (`Gel.blur_mm`)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gel:
    """Elastomer of a sensor; None where it is not known.

    thickness_mm: Thickness of the layer.
    modulus_kpa: Young's modulus.
    displacement_um: Smooth displacement of the gel's surface along itself under load: root mean square along each axis,
        micrometres.
    correlation_mm: Standard deviation of the Gaussian that correlates it from place to place.
    blur_mm: Standard deviation of the Gaussian by which the gel smooths what is pressed into it.
    poisson: Poisson's ratio; None: 0.485.
    crown_mm: Radii of the undeformed surface along image u and v, highest in the image's centre; 1e9 for a plane gel.
    """

    thickness_mm: float | None = None
    modulus_kpa: float | None = None
    displacement_um: float = 0.0
    correlation_mm: float = 4.0
    blur_mm: float | None = None
    poisson: float | None = None
    crown_mm: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera:
    """The camera model, evaluated for one profile.

    centre_px (2,): Centre of the distortion.
    matrix, inverse (2, 2): M, px/mm, and its inverse.
    corner_px: r_corner, half the image's diagonal.
    """

    centre_px: FloatArray
    matrix: FloatArray
    inverse: FloatArray
    k1: float
    corner_px: float

    def to_px(self, at_mm: npt.ArrayLike) -> FloatArray:
        """Pixels of points on the gel.

        at_mm (..., 2): Right and down of the centre, mm.
        Returns (..., 2): (u, v) of the canonical image, px.
        """
        straight = np.asarray(at_mm, dtype=np.float64) @ self.matrix.T
        if self.k1 == 0.0:
            return np.asarray(self.centre_px + straight)
        squares = (straight**2).sum(axis=-1, keepdims=True) / self.corner_px**2
        px: FloatArray = self.centre_px + straight * (1.0 + self.k1 * squares)
        return px

    def from_px(self, px: npt.ArrayLike) -> FloatArray:
        """Points on the gel that are seen at pixels: the inverse of `to_px`.

        px (..., 2): (u, v) of the canonical image, px.
        Returns (..., 2): Right and down of the centre, mm.
        """
        seen = np.asarray(px, dtype=np.float64) - self.centre_px
        if self.k1 != 0.0:
            radius = np.sqrt((seen**2).sum(axis=-1, keepdims=True)) / self.corner_px
            # r (1 + k1 r^2) = seen, in corner radii; it rises as long as 1 + 3 k1 r^2 > 0, and the seen radius itself is a near
            # start
            root = radius
            for _ in range(_NEWTON_STEPS):
                root = root - (root * (1.0 + self.k1 * root**2) - radius) / (1.0 + 3.0 * self.k1 * root**2)
            # distortion is along the radius: the direction stays
            seen = seen / (1.0 + self.k1 * root**2)
        return seen @ self.inverse.T


def camera(px_per_mm: tuple[float, float], size_px: tuple[int, int], geometry: Geometry) -> Camera:
    """The camera model of an image of a size (width, height) in px."""
    u, v = px_per_mm
    matrix = np.array([[u * (1 + geometry.aspect / 2), u * geometry.shear], [0.0, v * (1 - geometry.aspect / 2)]])
    # pixel centres are whole numbers
    middle = (np.array(size_px) - 1) / 2
    centre = middle if geometry.center_px is None else np.array(geometry.center_px)
    inverse = np.linalg.inv(matrix)
    return Camera(centre_px=centre, matrix=matrix, inverse=inverse, k1=geometry.k1, corner_px=float(np.hypot(*middle)))


def is_rotation(matrix: FloatArray, tolerance: float = 1e-6) -> bool:
    """Whether a matrix (3, 3) is that of a rotation, no reflection, no scale."""
    return bool(np.allclose(matrix @ matrix.T, np.eye(3), atol=tolerance) and np.linalg.det(matrix) > 0.0)


def from_quaternion(xyzw: npt.ArrayLike) -> FloatArray:
    """Rotation matrix of a quaternion (x, y, z, w) of any length except 0; shape (3, 3)."""
    x, y, z, w = np.asarray(xyzw, dtype=np.float64) / np.linalg.norm(xyzw)
    return np.array(
        [
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
        ]
    )
