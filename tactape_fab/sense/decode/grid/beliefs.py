"""Priors of the camera, of the gel, and of what neighbours and a contact's rim do to a dot, as they are before a frame."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin

import numpy as np

from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart, is_long

RIM_MM = 0.09
"""Standard deviation of a dot's error by the contact's rim at a missing weight of 1; it grows with the power 7/8 of the missing
weight: 5 um at 0.04, 27 um at 0.25 and 57 um at 0.6, as measured."""
RIM_AT_EDGES = 0.5
"""Share of `RIM_MM` that a dot in the middle between the edges of its top errs by. Of 0201 and
0402 it is 0.1 to 0.3 in the elastic simulator under 0.5 to 10 N; in the imprint model with a blur of 0.06 and 0.08 mm, whose rims
are steep, 0.4 to 0.8, and up to 1 where a fifth of the weight is missing."""
USUAL_MM, USUAL_ERRORS = 0.006, 1.0
"""Prior of a full dot's standard deviation, and the number of errors that it counts as. With sensors of different noise, and
tapes of different placement, it is 5 to 100 um: so the prior is weak."""
PUSH_MM, PUSH_SIGMA_MM, PUSH_REACH_MM = 0.012, 0.01, 0.43
"""Push: shift of a dot away from a neighbour 1 mm off, by what the filter leaves of that one's flank; its prior standard
deviation; and its fall with the distance d, as d exp(-d^2 / 2 reach^2). It is 10 to 25 um for gels that blur by 0.05 to 0.25 mm.
Neighbours push each other alike, so without it the residuals would suggest a larger error than the pose has."""
PUSH_LEAN = 0.75
"""How much farther a neighbour pushes along a part than across it, half the difference over the mean, for (length - width) /
(length + width) of 1. Two 0201 that are 1 mm apart, at 45 degrees to what joins them, move each other's tops by 13.2 um along
that and by 3.2 um across, towards their lengths: 981 pairs of the default scene."""
LEAST_APART_MM, MOST_APART_MM = 0.3, 2.57
"""Dots nearer than the first do not push each other, they are one part seen twice; nor do those farther apart than the second.
Grid points of usual pitches have neither distance, so rounding does not decide on which side they are."""
PULL, PULL_SIGMA, PULL_REACH_MM = 0.2, 0.12, 2.0
"""Pull: shift of a dot at the rim inwards, per unit of missing weight and of its distance from the centroid of the dots within
about the reach, and its prior standard deviation. It corrects what `rim.settled` takes for noise, which is less where more weight
is missing: so it grows up to a missing weight of 0.15, and falls to 0 at 0.5."""
PULL_MOST, PULL_END, PULL_FALL = 0.15, 0.5, 0.43


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Beliefs:
    """Priors of a sensor's camera and gel.

    Camera parameters are corrections of the profile's, of mean 0.

    sigmas (4,): Standard deviations of ln of the scale, aspect, shear and k1; 0 where it is exact.
    corner_mm (2,): r_corner of the radial distortion over the px/mm along u and v.
    centre_mm (2,): Centre of the distortion, from the image centre.
    gel_mm, correlation_mm: Root mean square of the gel's smooth displacement along each axis, and the standard deviation of its
        Gaussian correlation.
    lean: How much farther neighbours push along parts than across, times cos and sin of twice the parts' direction on the
        texture.
    """

    sigmas: FloatArray
    corner_mm: FloatArray
    centre_mm: FloatArray
    gel_mm: float = 0.0
    correlation_mm: float = 1.0
    lean: tuple[float, float] = (0.0, 0.0)


def rim_mm(by_edges: float) -> float:
    """Standard deviation of a dot's error by the contact's rim at a missing weight of 1; `by_edges` is that of `Dots`."""
    return RIM_MM * (1.0 - (1.0 - RIM_AT_EDGES) * by_edges)


def rim_mm2(weights: FloatArray, by_edges: float) -> FloatArray:
    """Variance along an axis that the contact's rim adds to dots of some weights, shape (n,)."""
    # the power 7/8 of the missing weight, squared
    return np.asarray(rim_mm(by_edges) ** 2 * (1.0 - weights) ** 1.75)


def beliefs_of(sensor: SensorProfile, *, fixed_scale: bool, part: TapePart | None = None) -> Beliefs:
    """The beliefs of a sensor's profile.

    fixed_scale: Whether the scale is exact whatever the profile says.
    part: That of all tapes; None where it is not known.
    """
    lean = (0.0, 0.0)
    if part is not None and is_long(part.shape, part.body_mm):
        # an axis is the same after half a turn, so the direction enters as cos and sin of its double; board +y is up, texture
        # +y down
        (length, width, _), double = part.body_mm, -part.rotation_deg * pi / 90.0
        most = PUSH_LEAN * (length - width) / (length + width)
        lean = (most * cos(double), most * sin(double))
    geometry, scale, camera = sensor.geometry, np.array(sensor.px_per_mm), sensor.camera
    known = geometry.sigma_px_per_mm
    # half the tolerance is one standard deviation: a profile's tolerance is taken for two
    relative = 0.0 if fixed_scale else sensor.scale_tolerance / 2 if known is None else known / sensor.px_per_mm[0]
    return Beliefs(
        sigmas=np.array([relative, geometry.sigma_aspect, geometry.sigma_shear, geometry.sigma_k1]),
        corner_mm=camera.corner_px / scale,
        centre_mm=-camera.from_px(sensor.centre_px),
        gel_mm=sensor.gel.displacement_um / 1000,
        correlation_mm=sensor.gel.correlation_mm,
        lean=lean,
    )
