"""Tops of the parts -> the plane that they are in: a second-order surface fitted to their depths, less the gel's own crown.

A depth map says how far the gel has moved. Where it touches a part's top that is as far as the tape goes in, less its own
undeformed surface, which is highest in the image's centre: a flat tape is seen as a plane less the crown. So the slopes sought
are those in the image's centre, and the curvature says whether the tape is flat.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

import numpy as np

from tactape_fab.sense.decode.contact.bent import Bend, bend_of
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
FLAT_CHI2 = 11.3
"""Squared distance of three curvatures and a gain beyond which a tape is not flat: 99 % with 3 degrees of freedom."""
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
LEAST_ERROR_MM = 0.0015
CORRELATED = 1.5
"""The gel correlates the errors of tops: variances are so many times those of independent tops."""
SLOPE_FLOOR, SLOPE_SHARE = 2.0e-4, 0.01
"""Systematic standard errors of the slopes, which the scatter of tops does not show: 0.01 degree, and a share of the slope."""
_CURVATURES = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
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
    """The second-order surface's terms at points; (n, 2) to (n, 6)."""
    (x, y), found = gel_mm.T, np.empty((len(gel_mm), 6))
    found[:, 0], found[:, 1], found[:, 2], found[:, 3], found[:, 4], found[:, 5] = 1.0, x, y, x * x / 2, y * y / 2, x * y
    return found


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
    if (weights > 0.0).sum() < LEAST_TOPS:
        return None
    # second derivatives by uu, vv and uv of a cap of these radii; depths of a flat tape have minus the gain times them
    crown = np.zeros(3) if crown_mm is None else np.array([1 / crown_mm[0], 1 / crown_mm[1], 0.0])
    found = _surface(gel_mm, tops_mm, weights, -GAIN * crown)
    if found is None:
        return None
    shown, variance = found
    flat = None if crown_mm is None else _flat(shown, variance, crown)
    if flat is not None:
        at, covariance = flat
    else:
        # a bent tape does not observe the gain: it is the prior's, independent of the slopes
        at, covariance = np.append(shown[:3], GAIN), np.zeros((4, 4))
        covariance[:3, :3], covariance[3, 3] = variance[:3, :3], GAIN_SIGMA**2
    gain = float(at[3])
    rise = at[:3] / gain
    # rise = shown / gain: d rise / d shown = 1 / gain, d rise / d gain = -rise / gain
    rates = np.column_stack([np.eye(3), -rise]) / gain
    of_rise = rates @ covariance @ rates.T
    # the slope is read at the image's centre: with the gel's apex elsewhere it is off by the curvature times that distance
    apex = 0.0 if crown_mm is not None else APEX_MM * float(np.abs(shown[3:]).max())
    middle_mm = weights @ gel_mm / weights.sum()
    bend, known = None, crown_mm is not None
    if flat is None:
        bend, known = _bend(shown, variance, crown, middle_mm, hypot(GAIN_SIGMA / GAIN, unit_error))
    if bend is not None:
        # beyond the contact the tops follow a circle, not the fitted parabola
        rise = np.append(terms(middle_mm[None])[0] @ shown / gain + bend.height_mm(middle_mm), bend.slope)
        changes = np.array([other.slope - bend.slope for other in bend.unsure])
        of_rise[1:, 1:] = changes.T @ changes
    elif flat is None and crown_mm is not None:
        # a film is not bent about both axes, so its slope may as well be that of the contact's middle
        uu, vv, uv = shown[3:] / gain + crown
        apex = float(np.linalg.norm(np.array([[uu, uv], [uv, vv]]) @ middle_mm))
    of_rise[1:, 1:] += np.eye(2) * (SLOPE_FLOOR**2 + apex**2) + np.diag(SLOPE_SHARE * rise[1:]) ** 2
    if not (np.isfinite(rise).all() and np.isfinite(of_rise).all()):
        return None
    return Plane(
        rise=rise,
        covariance=of_rise,
        gain=gain,
        flat=flat is not None,
        shown=shown,
        shown_variance=variance,
        bend=bend,
        known=known,
    )


def _bend(
    shown: FloatArray, variance: FloatArray, crown: FloatArray, middle_mm: FloatArray, gain_error: float
) -> tuple[Bend | None, bool]:
    """The bend of a tape that is not flat, by the surface that the frame shows, and whether by the profile's crown.

    gain_error: Standard deviation of slopes and curvatures as a share.
    """
    slopes, curvatures = shown[1:3] / GAIN, shown[3:] / GAIN
    of_surface = variance[1:, 1:] / GAIN**2
    least = FILM + 2.0 * float(np.sqrt(of_surface.diagonal()[2:].max()))
    found, known = None, bool(crown.any())
    if known:
        found = bend_of(np.append(slopes, curvatures + crown), of_surface, gain_error, middle_mm, least)
    if found is None and (level := level_of(curvatures)) is not None:
        known, of_surface = False, of_surface + np.diag([0.0, 0.0, ROUNDNESS**2, ROUNDNESS**2, 0.0])
        round_crown = np.array([level, level, 0.0])
        found = bend_of(np.append(slopes, curvatures + round_crown), of_surface, gain_error, middle_mm, least)
    return (None if found is not None and abs(found.curvature) <= CROWN_ERROR else found), known


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


def _surface(
    gel_mm: FloatArray, tops_mm: FloatArray, weights: FloatArray, curvature: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """The second-order surface and its covariance: robust, with a wide prior on the curvatures."""
    rows, believed = terms(gel_mm), np.array([0.0, 0.0, 0.0, *curvature])
    kept, error, seen = weights, 0.005, weights > 0.0
    middle = int(np.count_nonzero(seen)) // 2
    for _ in range(ROUNDS):
        # over the tops' variance, as are all rows: the inverse below has to be multiplied by it
        prior = (error / BENT_SIGMA) ** 2 * _CURVATURES
        weighted = rows.T * kept
        try:
            inverse = np.asarray(np.linalg.inv(weighted @ rows + prior))
        except np.linalg.LinAlgError:
            return None
        shown = inverse @ (weighted @ tops_mm + prior @ believed)
        off = tops_mm - rows @ shown
        # the median of an absolute normal variable is 0.674 sigma; numpy's function takes ten times as long for a few values
        far = np.sort(np.abs(off[seen]))
        error = max(float(far[middle] + far[~middle]) / 2.0 / 0.674, LEAST_ERROR_MM)
        kept = weights / (1.0 + (off / (FAR * error)) ** 2) ** 2
    return shown, inverse * (error**2 * CORRELATED)


def _flat(shown: FloatArray, variance: FloatArray, crown: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Height and slopes as shown, and the gain, of a flat tape; with their covariance. None where the tape is bent."""
    loose = variance + FLAT_TOLERANCE**2 * _CURVATURES
    known = np.asarray(np.linalg.inv(loose))
    # from (height, slopes, gain) to the six numbers shown: three as they are, three as the gain times the crown
    to_shown = np.zeros((6, 4))
    to_shown[0, 0] = to_shown[1, 1] = to_shown[2, 2] = 1.0
    to_shown[3:, 3] = -crown
    normal, right = to_shown.T @ known @ to_shown, to_shown.T @ known @ shown
    normal[3, 3] += GAIN_SIGMA**-2
    right[3] += GAIN_SIGMA**-2 * GAIN
    covariance = np.asarray(np.linalg.inv(normal))
    at = covariance @ right
    off = shown - to_shown @ at
    # six numbers and the gain's prior, less four unknowns: 3 degrees of freedom
    chi2 = float(off @ known @ off) + ((float(at[3]) - GAIN) / GAIN_SIGMA) ** 2
    return (at, covariance) if chi2 <= FLAT_CHI2 else None
