"""Tops of the parts -> the plane that they are in: a second-order surface fitted to their depths, less the gel's own crown.

A depth map says how far the gel has moved. Where it touches a part's top that is as far as the tape goes in, less its own
undeformed surface, which is highest in the image's centre: a flat tape is seen as a plane less the crown. So the slopes sought
are those in the image's centre, and the curvature says whether the tape is flat.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, isfinite, sqrt

import numpy as np

from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.contact.bent import Bend, bend_of
from tactape_fab.sense.decode.dots.clip import clip
from tactape_fab.sense.decode.dots.kth import median
from tactape_fab.sense.decode.grid.second_order import add_point, solve
from tactape_fab.texture.frames import FloatArray

LEAST_TOPS = 8
"""Six numbers are fitted."""
GAIN, GAIN_SIGMA = 0.95, 0.05
"""Share of slopes that sensors measure, a prior: a depth network that saturates at slopes of 1.2 loses 2 to 11 %
of tilts and curvatures between the steep edges of parts (elastic simulator, 0.5 to 10 N); one that does not loses nothing."""
BENT_SIGMA = 0.1
"""Prior standard deviation of a tape's curvature, 1/mm."""
FLAT_TOLERANCE = 0.0004
"""Curvature, 1/mm, by which tops of a flat tape may differ from the crown; it is 1/2500 mm."""
_TOLERANCE = FLAT_TOLERANCE**2 * np.eye(3)
FLAT_CHI2 = 11.3
"""Squared distance of three curvatures from the crown's beyond which a tape is not flat: 99 % with 3 degrees of freedom."""
FILM = 0.002
"""Curvature, 1/mm, below which there is none: contacts of the elastic simulator show 0.0003 beside the crown's, those of the
imprint model, which are domes, 0.005 and more."""
CROWN_ERROR = 0.004
"""Curvature, 1/mm, by which a gel's crown may differ from its profile's: radii of 113 mm may be 78 to 206. Tops that are bent by
less may be those of a flat tape. A tape round a cylinder of 250 mm is foreshortened by 1e-4 at most."""
MOST_CROWN = 0.01
"""Curvature, 1/mm, of tops up to which they may be those of a flat tape under the crown of a gel that is not known."""
DOME, DOME_BENDS = 0.5, (0.001, 0.003)
"""Prior probability that tops which are bent are those of a flat tape under a dome, as contacts of the imprint model are; and the
curvatures along the axis, 1/mm, between which it grows to that: on ellipses of 20x8 mm it is 0.0033, round cylinders 0."""
WIDE, NOT_WIDE = 0.012, 0.018
"""Curvatures, 1/mm, between which that probability falls to 0 where the profile's crown is left out: on ellipses of 14x9 mm,
oblique in the image, what remains beside it is a bend of 0.008, and there is no crown in that model."""
LEAST_BEND = 0.005
"""Curvature, 1/mm, from which a tape is looked at for a bend. Oblique in the image and full of dots, angles are 0.03 degrees off
round 130 mm, 2.3 standard deviations, where that is left out, and 0.07 round 50 mm, as tops are 1/200 further apart than the
film (elastic simulator, 8 N). Round 200 mm a film is foreshortened by 2e-4."""
ROUNDNESS = 0.002
"""Standard deviation of the difference of an unknown crown's two curvatures, 1/mm: 1/189 and 1/113 differ by 0.0036."""
ROUNDS, FAR = 3, 2.5
"""Rounds of the robust fit, and the errors at which its weight has fallen to a quarter (Geman and McClure)."""
FIRST_ERROR_MM, LEAST_ERROR_MM = 0.005, 0.0015
"""Standard deviation of a top in the first round, and the least in those after it."""
CORRELATED = 1.5
"""The gel correlates the errors of tops: variances are so many times those of independent tops."""
SLOPE_FLOOR, SLOPE_SHARE = 2.0e-4, 0.01
"""Systematic standard errors of the slopes, which the scatter of tops does not show: 0.01 degree, and a share of the slope."""
APEX_MM = 1.0
"""How far the gel's highest point may be from the image's centre where the sensor's profile has no crown."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plane:
    """The plane of the parts' tops, towards the sensor, over the gel's undeformed surface at the image's centre.

    rise (3,): Height in the image's centre, mm, and slopes along image u and v.
    covariance (3, 3): Without the error of the frame's zero.
    gain: Measured over true height or slope.
    flat: Whether the tops' curvature is that of the gel's crown.
    shown (6,): The fitted surface as the frame shows it: height, slopes, and second derivatives by uu, vv and uv.
    shown_variance (6, 6)
    bend: Of a tape that is bent about one axis; None of any other.
    known: Whether the crown is the profile's, and not one that leaves a tape bent about one axis: so may a dome's tops be.
    """

    rise: FloatArray
    covariance: FloatArray
    gain: float
    flat: bool
    shown: FloatArray
    shown_variance: FloatArray
    bend: Bend | None
    known: bool


def terms(gel_mm: FloatArray) -> FloatArray:
    """The second-order surface's terms at a point; (2,) to (6,)."""
    x, y = gel_mm.tolist()
    return np.array([1.0, x, y, x * x / 2, y * y / 2, x * y])


def fit_plane(
    gel_mm: FloatArray,
    tops_mm: FloatArray,
    weights: FloatArray,
    crown_mm: tuple[float, float] | None,
    unit_error: float = 0.0,
) -> Plane | None:
    """Fit the plane.

    gel_mm (n, 2): Where the tops are, right and down of the image centre.
    tops_mm (n,): Depths there.
    weights (n,): At most 1; those of dots at the contact's rim are small.
    crown_mm: Radii of the gel's undeformed surface along image u and v.
    unit_error: Standard deviation of the depths' unit as a share, as far as it moves a bent tape's places.
    Returns: None of too few tops, or of tops in a line.
    """
    if np.count_nonzero(weights > 0.0) < LEAST_TOPS:
        return None
    # second derivatives by uu, vv and uv of a cap of these radii; depths of a flat tape have minus the gain times them
    crown = np.zeros(3) if crown_mm is None else np.array([1 / crown_mm[0], 1 / crown_mm[1], 0.0])
    shown, variance = robust_surface(gel_mm, tops_mm, weights, -GAIN * crown)
    if not isfinite(variance.sum()):
        return None
    # height, slopes and gain: the gain is the prior's, independent of the tops
    at, covariance, flat = np.empty(4), np.zeros((4, 4)), False
    at[:3], at[3] = shown[:3], GAIN
    covariance[:3, :3], covariance[3, 3] = variance[:3, :3], GAIN_SIGMA**2
    if crown_mm is not None:
        # a flat tape shows minus the gain times the crown: all are conditioned on curvatures that add up to 0 with it
        off, shared = shown[3:] + GAIN * crown, np.concatenate([variance[:3, 3:], [GAIN_SIGMA**2 * crown]])
        known = _inverse(variance[3:, 3:] + _TOLERANCE + shared[3] * crown[:, None])
        flat = bool(off @ known @ off <= FLAT_CHI2)
        if flat:
            at -= shared @ known @ off
            covariance -= shared @ known @ shared.T
    gain = float(at[3])
    bend, of_profile, middle_mm = None, crown_mm is not None, weights @ gel_mm / weights.sum()
    gain_error = hypot(GAIN_SIGMA / GAIN, unit_error)
    if not flat:
        bend, of_profile = _bend(shown, variance, crown, middle_mm, gain_error)
    # the slope is read at the image's centre: with the gel's apex elsewhere it is off by the curvature times that distance
    apex = 0.0 if crown_mm is not None else APEX_MM * float(np.abs(shown[3:]).max())
    if bend is not None:
        rise, of_rise = _under_centre(bend, shown, variance, crown if of_profile else None, middle_mm, gain_error)
    else:
        rise = at[:3] / gain
        # rise = shown / gain: d rise / d shown = 1 / gain, d rise / d gain = -rise / gain
        rates = np.zeros((3, 4))
        rates[0, 0] = rates[1, 1] = rates[2, 2] = 1.0 / gain
        rates[:, 3] = -rise / gain
        of_rise = rates @ covariance @ rates.T
        if not flat and crown_mm is not None:
            # a film is not bent about both axes, so its slope may as well be that of the contact's middle
            uu, vv, uv = shown[3:] / gain + crown
            apex = float(np.linalg.norm(np.array([[uu, uv], [uv, vv]]) @ middle_mm))
    for axis in (1, 2):
        of_rise[axis, axis] += SLOPE_FLOOR**2 + apex**2 + (SLOPE_SHARE * rise[axis]) ** 2
    if not isfinite(rise.sum() + of_rise.sum()):
        return None
    return Plane(
        rise=rise,
        covariance=of_rise,
        gain=gain,
        flat=flat,
        shown=shown,
        shown_variance=variance,
        bend=bend,
        known=of_profile,
    )


def _inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of a symmetric matrix (3, 3) by its cofactors, which takes less time than a call of numpy's function."""
    (a, b, c), (_, d, e), (_, _, f) = matrix.tolist()
    first, second, third = d * f - e * e, c * e - b * f, b * e - c * d
    cofactors = np.array([[first, second, third], [second, a * f - c * c, b * c - a * e], [third, b * c - a * e, a * d - b * b]])
    return np.asarray(cofactors / (a * first + b * second + c * third))


def _bend(
    shown: FloatArray, variance: FloatArray, crown: FloatArray, middle_mm: FloatArray, gain_error: float
) -> tuple[Bend | None, bool]:
    """The bend of a tape that is not flat, by the surface that the frame shows, and whether by the profile's crown.

    gain_error: Standard deviation of slopes and curvatures as a share.
    """
    surface, of_surface = shown[1:] / GAIN, variance[1:, 1:] / GAIN**2
    curvatures = surface[2:].copy()
    least = FILM + 2.0 * sqrt(max(of_surface.diagonal()[2:].tolist()))
    found, known = None, bool(crown.any())
    if known:
        surface[2:] += crown
        found = bend_of(surface, of_surface, gain_error, middle_mm, least)
    if found is None and (level := level_of(curvatures)) is not None:
        known, of_surface = False, of_surface + np.diag([0.0, 0.0, ROUNDNESS**2, ROUNDNESS**2, 0.0])
        surface[2:] = np.add(curvatures, (level, level, 0.0))
        found = bend_of(surface, of_surface, gain_error, middle_mm, least)
    return (None if found is not None and abs(found.curvature) <= CROWN_ERROR else found), known


def _under_centre(
    bend: Bend,
    shown: FloatArray,
    variance: FloatArray,
    crown: FloatArray | None,
    middle_mm: FloatArray,
    gain_error: float,
) -> tuple[FloatArray, FloatArray]:
    """`Plane.rise` of a tape that is bent, and its covariance: beyond the contact tops follow a circle, not the fitted parabola.

    crown (3,): Curvatures of the profile's crown; None of one that the tops show.
    """
    row, crown_error = terms(middle_mm), 0.0
    if crown is None:
        level = level_of(shown[3:] / GAIN) or 0.0
        crown, crown_error = np.array([level, level, 0.0]), sqrt(ROUNDNESS**2 + max(variance.diagonal()[3:].tolist()) / GAIN**2)
    # depths are over the gel's surface, which is lower in the contact's middle than in the image's centre
    at_middle_mm = float(row @ shown / GAIN + row[3:] @ crown)
    found = bend.under_centre(middle_mm)
    found[:, 0] += at_middle_mm
    changes, of_gain = found[1:] - found[0], bend.of_gain(gain_error)
    covariance = changes.T @ changes
    # height and slopes are of one circle, and err together by the tops' scatter; by the gain each for itself: in the elastic
    # simulator heights are those of a gain of 1, and curvatures of 0.9
    scattered = np.maximum(1.0 - of_gain**2, 0.0)
    covariance[0] = covariance[:, 0] = (scattered * changes[:, 0]) @ changes
    of_middle = float(row @ variance @ row) / GAIN**2 + (crown_error * hypot(row[3], row[4])) ** 2
    covariance[0, 0] += of_middle + (gain_error * at_middle_mm) ** 2 + float(((of_gain * changes[:, 0]) ** 2).sum())
    return found[0], covariance


def level_of(curvatures: FloatArray) -> float | None:
    """Curvature of a crown that is as round along u as along v and leaves a tape that is bent about one axis; None of no crown.

    A film is not bent about two axes: what the tops show along the axis of a cylinder is the gel's crown, whatever the profile
    has.
    """
    uu, vv, uv = curvatures.tolist()
    mean, half = (uu + vv) / 2.0, hypot((uu - vv) / 2.0, uv)
    level = -(mean + half if mean < 0.0 else mean - half)
    # a wide bend is at least as large as the crown beside it: contacts of the imprint model, which are domes, have 0.005 and 0.01
    return level if 2.0 * half > LEAST_BEND and -ROUNDNESS <= level <= min(MOST_CROWN, 2.0 * half) else None


def dome_of(plane: Plane) -> float:
    """Prior probability that tops with a bend are those of a flat tape under a dome; 0 of a plane without."""
    if plane.bend is None:
        return 0.0
    if plane.known:
        return DOME * min(max((NOT_WIDE - abs(plane.bend.curvature)) / (NOT_WIDE - WIDE), 0.0), 1.0)
    level, (least, most) = level_of(plane.shown[3:] / plane.gain) or 0.0, DOME_BENDS
    return DOME * min(max((level - least) / (most - least), 0.0), 1.0)


def robust_surface(
    gel_mm: FloatArray, tops_mm: FloatArray, weights: FloatArray, believed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The second-order surface (6,), as `Plane.shown`, and its covariance: robust, with a wide prior on the curvatures.

    believed (3,): Mean of that prior, 1/mm.
    """
    normal, buffer = np.empty((7, 7)), np.empty((3, len(weights)))
    # one memory layout: numba compiles a kernel anew for each
    error_mm = _fill_robust(np.ascontiguousarray(gel_mm), tops_mm, weights, believed, buffer, normal)
    return normal[:6, 6], normal[:6, :6] * (error_mm**2 * CORRELATED)


@kernel()
def _fill_robust(
    gel_mm: FloatArray,
    tops_mm: FloatArray,
    weights: FloatArray,
    believed: FloatArray,
    buffer: FloatArray,
    normal: FloatArray,
) -> float:
    """Fill in the solved normal matrix (7, 7) of `second_order`, and return the standard deviation of a top, mm.

    `buffer` (3, n) is a work buffer.
    """
    kept, off, apart = buffer[0], buffer[1], buffer[2]
    error_mm = FIRST_ERROR_MM
    for k in range(len(weights)):
        kept[k] = weights[k]
    for _ in range(ROUNDS):
        for i in range(49):
            normal[i // 7, i % 7] = 0.0
        for k in range(len(weights)):
            add_point(gel_mm[k, 0], gel_mm[k, 1], tops_mm[k], kept[k], normal)
        # over the tops' variance, as are all rows: the inverse has to be multiplied by it
        prior = (error_mm / BENT_SIGMA) ** 2
        for i in range(3):
            normal[3 + i, 3 + i] += prior
            normal[3 + i, 6] += prior * believed[i]
        solve(normal)
        seen = 0
        for k in range(len(weights)):
            x, y = gel_mm[k, 0], gel_mm[k, 1]
            level = normal[0, 6] + normal[1, 6] * x + normal[2, 6] * y
            off[k] = tops_mm[k] - level - normal[3, 6] * x * x / 2.0 - normal[4, 6] * y * y / 2.0 - normal[5, 6] * x * y
            if weights[k] > 0.0:
                apart[seen] = abs(off[k])
                seen += 1
        # the median of an absolute normal variable is 0.674 sigma
        error_mm = clip(median(apart[:seen]) / 0.674, LEAST_ERROR_MM, np.inf)
        for k in range(len(weights)):
            kept[k] = weights[k] / (1.0 + (off[k] / (FAR * error_mm)) ** 2) ** 2
    return error_mm
