"""A tape in an elastic gel: the tape's rigid surface, the deformed surface of the gel, and the measured depth map.

The sensor looks along its axis, without perspective. Where the tape is tilted or curved, the texture's plane is that of the
parts' tops: the image centre sees the texture point S there, and parts are where their tops are seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tactape_fab.sense.geometry import Gel
from tactape_fab.sense.simulation.contact import contact_local, pixels_mm
from tactape_fab.sense.simulation.elastic_contact import ElasticContact
from tactape_fab.sense.simulation.elastic_layer import Layer, press_rigid, response
from tactape_fab.sense.simulation.gel import FloatImage, relief_of
from tactape_fab.sense.simulation.parts import Parts
from tactape_fab.sense.simulation.pixel_coverage import add_quads
from tactape_fab.sense.simulation.smoothing import gaussian_kernel, smooth
from tactape_fab.sense.simulation.view import View
from tactape_fab.texture.frames import FloatArray

_EDGE_MM = 0.03
"""Radius of a part's upper edges, mm: chip resistors, seen under a microscope."""
_TERRACES = 3
"""Steps that the rounding of an edge is drawn with; it is half a pixel wide."""
_COVERED = 2 / 3
"""A pixel counts as fully covered by a part from this share of its area on: depths over a tape are then within 3 % of those at
128 px/mm, and within 7 % with mean heights of pixels (0201 at 16 px/mm, 0.3 to 4 N)."""
_QUANTUM_MM = np.float32(2.0**-20)
"""Depth is rounded to this, 1 nm, as Fourier transforms may differ in their last bits."""
_DEEPEST_MM = 100.0
THICKNESS_MM, MODULUS_KPA = 4.0, 275.0
"""Thickness and Young's modulus if neither the contact nor the sensor's profile gives them: about those of a GelSight Mini."""
_MARKER_MM, _MARKER_PITCH_MM = 0.5, 2.0
"""Diameter and pitch of the dots that are printed on a dotted gel, mm."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Imprint:
    """A tape pressed into the gel.

    depth (h, w): Canonical depth map without noise, mm.
    pressure_mpa (h, w)
    gap_mm (h, w): Between the tape and the gel; 0 in the contact, up to the solver's tolerance.
    contact_px (2,): Centre of pressure.
    """

    depth: FloatImage
    pressure_mpa: FloatArray
    gap_mm: FloatArray
    contact_px: FloatArray

    def touched(self, at_px: FloatArray) -> FloatArray:
        """Fraction of the 3 x 3 pixels about points that the gel presses on; 0 for points outside the image."""
        h, w = self.pressure_mpa.shape
        touching = np.pad(self.pressure_mpa > 0.0, 1).astype(np.float64)
        share = np.add.reduce([touching[i : i + h, j : j + w] for i in range(3) for j in range(3)]) / 9
        u, v = np.rint(at_px).astype(np.int64).T
        inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
        return np.where(inside, share[np.clip(v, 0, h - 1), np.clip(u, 0, w - 1)], 0.0)


def imprint_of(
    view: View,
    parts: Parts,
    parts_mm: FloatArray,
    bumps_mm: FloatArray,
    bump_sizes: FloatArray,
    start_mpa: FloatArray | None = None,
) -> Imprint:
    """Press the parts in view into the gel of the view's sensor, as `Scene.elastic` says.

    parts, parts_mm, bumps_mm, bump_sizes: As in `relief_of`; with places in view that the gel may have displaced.
    start_mpa (h, w): Pressure to start from: that of a smaller force on the same parts.
    """
    elastic, (u, v) = view.scene.elastic, view.px_per_mm
    assert elastic is not None
    shape = (view.profile.height_px, view.profile.width_px)
    at_mm = pixels_mm(shape, view.camera)
    # a sphere near its top: the gel's surface falls by r^2 / 2 R
    crown_mm = (at_mm**2 / (2 * np.asarray(elastic.crown_mm))).sum(axis=-1)
    surface_mm = _surface_mm(view, elastic, at_mm, _relief_mm(view, parts, parts_mm, bumps_mm, bump_sizes))
    of_gel = response(shape, (u, v), _layer(elastic, view.profile.gel))
    # N times px/mm2: the solver's force is the sum of the pixels' pressures
    pressed = press_rigid(crown_mm - surface_mm, elastic.force_n * u * v, of_gel, start_mpa)
    depth = _measured(pressed.deflection_mm.astype(np.float32), (u, v), at_mm, elastic)
    depth = np.rint(depth / _QUANTUM_MM) * _QUANTUM_MM
    weight = pressed.pressure_mpa / pressed.pressure_mpa.sum()
    centre = np.array([weight.sum(axis=0) @ np.arange(shape[1]), weight.sum(axis=1) @ np.arange(shape[0])])
    return Imprint(depth=depth, pressure_mpa=pressed.pressure_mpa, gap_mm=pressed.gap_mm, contact_px=centre)


def _layer(elastic: ElasticContact, gel: Gel) -> Layer:
    """The layer of a contact; what it leaves open is the sensor's, or the default."""
    thickness_mm = elastic.thickness_mm or gel.thickness_mm or THICKNESS_MM
    return Layer(thickness_mm, (elastic.modulus_kpa or gel.modulus_kpa or MODULUS_KPA) / 1000, elastic.poisson)


def _relief_mm(view: View, parts: Parts, parts_mm: FloatArray, bumps_mm: FloatArray, bump_sizes: FloatArray) -> FloatArray:
    """Height of the tape over its film, in full, with rounded edges of blocks; shape (h, w), mm."""
    part = view.tape.part
    in_full = replace(view, scene=replace(view.scene, texture_mm=part.body_mm[2], dome_mm=_DEEPEST_MM))
    if part.shape == "dome":
        return relief_of(in_full, parts, parts_mm, bumps_mm, bump_sizes)
    image = relief_of(in_full, parts.taken(np.empty(0, dtype=np.int64)), np.empty((0, 2)), bumps_mm, bump_sizes)
    length_mm, width_mm, height_mm = part.body_mm
    edge_mm = min(_EDGE_MM, height_mm, width_mm / 2)
    # a quarter circle of radius e at the height t e above its foot lies e (1 - sqrt(1 - t^2)) inside the block's side
    levels = (np.arange(_TERRACES) + 0.5) / _TERRACES
    insets_mm = [0.0, *(edge_mm * (1 - np.sqrt(1 - levels**2)))]
    steps_mm = [height_mm - edge_mm, *[edge_mm / _TERRACES] * _TERRACES]
    blocks = np.zeros_like(image)
    # a part's corners are displaced by the gel as much as its centre
    moved_mm = (parts_mm - view.from_board(parts.xy_mm))[:, None]
    for inset_mm, step_mm in zip(insets_mm, steps_mm, strict=True):
        corners_mm = _corners_mm(parts, length_mm - 2 * inset_mm, width_mm - 2 * inset_mm)
        add_quads(blocks, view.to_px(view.from_board(corners_mm) + moved_mm), step_mm)
    return image + np.minimum(blocks / _COVERED, height_mm)


def _corners_mm(parts: Parts, length_mm: float, width_mm: float) -> FloatArray:
    """Corners of blocks; shape (n, 4, 2), mm in the board frame."""
    turn = np.radians(parts.rotation_deg)[:, None]
    x, y = np.array([1, -1, -1, 1]) * length_mm / 2, np.array([1, 1, -1, -1]) * width_mm / 2
    offset = np.stack([x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)], axis=-1)
    return parts.xy_mm[:, None] + offset


def _surface_mm(view: View, elastic: ElasticContact, at_mm: FloatArray, relief_mm: FloatArray) -> FloatArray:
    """Height of the tape towards the sensor, from its relief over the film: tilted, or on its cylinder; shape (h, w), mm."""
    surface = relief_mm + at_mm @ np.tan(np.radians(elastic.tilt_deg))
    if elastic.cylinder_radius_mm is None:
        return surface
    square, radius, height = contact_local(view.scene, at_mm)[..., 1] ** 2, elastic.cylinder_radius_mm, view.tape.part.body_mm[2]
    # heights over the axis: film on the radius, flat tops on the radius + the part's height; relief in between goes in proportion
    film, tops = (np.sqrt(np.maximum(r**2 - square, 0.0)) for r in (radius, radius + height))
    return surface + film - radius + relief_mm * ((tops - film) / height - 1)


def _measured(surface_mm: FloatImage, px_per_mm: tuple[float, float], at_mm: FloatArray, elastic: ElasticContact) -> FloatImage:
    """The gel's surface as a photometric sensor measures it: smoothed, its slopes cut at their limit, and integrated."""
    u, v = px_per_mm
    # a narrower Gaussian has no weight on the next pixel: exp(-200)
    if elastic.blur_mm * min(u, v) >= 0.05:
        surface_mm = smooth(surface_mm, gaussian_kernel(elastic.blur_mm * u), gaussian_kernel(elastic.blur_mm * v), "edge")
    if elastic.slope_limit is None and not elastic.markers:
        return surface_mm
    # what the sensor measures are slopes: limits and hidden places act on these, and the depth is what fits them best
    steps = [np.diff(surface_mm.astype(np.float64), axis=1), np.diff(surface_mm.astype(np.float64), axis=0)]
    if elastic.slope_limit is not None:
        steps = [np.tanh(steps[i] * px_per_mm[i] / elastic.slope_limit) * elastic.slope_limit / px_per_mm[i] for i in range(2)]
    if elastic.markers:
        hidden = _markers(at_mm)
        steps = [np.where(hidden[:, 1:] | hidden[:, :-1], 0.0, steps[0]), np.where(hidden[1:] | hidden[:-1], 0.0, steps[1])]
    found = integrated(*steps)
    found += surface_mm.mean(dtype=np.float64)
    return found.astype(np.float32)


def _markers(at_mm: FloatArray) -> npt.NDArray[np.bool_]:
    """The pixels under the dots of a dotted gel."""
    off_mm = (at_mm + _MARKER_PITCH_MM / 2) % _MARKER_PITCH_MM - _MARKER_PITCH_MM / 2
    return np.hypot(off_mm[..., 0], off_mm[..., 1]) <= _MARKER_MM / 2


def integrated(right_mm: FloatArray, down_mm: FloatArray) -> FloatArray:
    """The surface of mean zero whose differences between pixels fit the given ones best (least squares); shape (h, w).

    right_mm (h, w - 1): Difference of each pixel from the one to its left.
    down_mm (h - 1, w): Difference of each pixel from the one above.
    """
    # normal equations of the least squares: minus the Laplacian of the surface is minus the divergence of its steps, none of
    # which crosses the border
    source = np.diff(-right_mm, axis=1, prepend=0.0, append=0.0) + np.diff(-down_mm, axis=0, prepend=0.0, append=0.0)
    h, w = source.shape
    mirrored = np.block([[source, source[:, ::-1]], [source[::-1], source[::-1, ::-1]]])  # no slope across the image's border
    # eigenvalues of minus the five-point Laplacian at the waves of the mirrored picture, of periods 2 w and 2 h; the mean has
    # none
    curvature = 4 * np.sin(np.pi * np.arange(w + 1) / (2 * w)) ** 2 + 4 * np.sin(np.pi * np.arange(2 * h) / (2 * h))[:, None] ** 2
    waves = np.fft.rfft2(mirrored)
    curvature[0, 0], waves[0, 0] = 1.0, 0.0
    return np.fft.irfft2(waves / curvature, mirrored.shape)[:h, :w]
