"""Tapes that are bent about one axis, as round a cylinder: the circle of their tops, and the film unrolled."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import atan2, cos, hypot, pi, sin, sqrt

import numpy as np

from tactape_fab.texture.frames import FloatArray

ROUND = 0.3
"""Smaller curvature over the larger, below which a surface counts as bent about one axis: a gel without its profile's crown shows
1/113 mm along a cylinder's axis. Contacts of the imprint model, which are domes, have 0.5 and more."""
MOST_SINE = 0.95
"""Largest sine of the slope, 72 degrees, at which positions on a flank are computed."""
ASKEW = 0.0005
"""Second derivative of the tops by u and v, 1/mm, up to which it says nothing: of flat contacts of 7x7 mm and more the root mean
square is at most 0.00045, and 0.00007 in elastic gels."""
_NO_SIGMA = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class Bend:
    """How a tape that is bent about one axis lies under the image: its tops are on a circle across the axis.

    across (2,): Unit vector across the axis, along image u and v.
    sine: Sine of the slope along it in the image's centre, positive where the tape rises towards the sensor.
    curvature: By how much the slope's angle grows along the arc, 1/mm: -1 / radius round a cylinder.
    along: Slope along the axis.
    middle_mm: Position of the contact's middle from the image's centre, across the axis.
    angle_sigma, curvature_sigma, along_sigma: Standard deviations of the slope's angle in the middle, rad, of the curvature, and
        of the slope along the axis.
    """

    across: FloatArray
    sine: float
    curvature: float
    along: float
    middle_mm: float
    angle_sigma: float
    curvature_sigma: float
    along_sigma: float

    @cached_property
    def circles(self) -> FloatArray:
        """Sine, curvature and slope along the axis; (4, 3).

        As they are, and where the angle in the middle, the curvature, or the slope along the axis is off by a standard deviation.
        """
        at_middle = self.sine + self.curvature * self.middle_mm
        curved = self.curvature + self.curvature_sigma
        turned = at_middle + self.angle_sigma * sqrt(max(1.0 - at_middle**2, 0.0))
        return np.array(
            [
                [self.sine, self.curvature, self.along],
                [turned - self.curvature * self.middle_mm, self.curvature, self.along],
                [at_middle - curved * self.middle_mm, curved, self.along],
                [self.sine, self.curvature, self.along + self.along_sigma],
            ]
        )

    @property
    def on_flank(self) -> bool:
        """Whether the image's centre may be beyond the flank, so that no place is under it."""
        sines = self.circles[:, 0].tolist()
        return not abs(self.sine) + hypot(*(sine - self.sine for sine in sines[1:])) <= MOST_SINE

    def under_centre(self, middle_mm: FloatArray) -> FloatArray:
        """Height in the image's centre minus that in the contact's middle, which is at `middle_mm` (2,), and slopes there.

        Returns: mm, and slopes along u and v, for each of `circles`; (4, 3).
        """
        (c, s), (u, v), found = self.across.tolist(), middle_mm.tolist(), []
        aside_mm = v * c - u * s
        for sine, curvature, along in self.circles.tolist():
            at_middle = sine + curvature * self.middle_mm
            # d height / d arc is the sine and d angle / d arc the curvature: heights differ as the cosines do
            higher = (sqrt(max(1.0 - at_middle**2, 0.0)) - sqrt(max(1.0 - sine**2, 0.0))) / curvature
            steep = sine / sqrt(max(1.0 - sine**2, 1.0 - MOST_SINE**2))
            found.append([higher - along * aside_mm, steep * c - along * s, steep * s + along * c])
        return np.array(found)

    def of_gain(self, gain_error: float) -> FloatArray:
        """How far that error of `bend_of` moves angle, curvature and slope along the axis, over their deviations; (3,)."""
        sine = self.sine + self.curvature * self.middle_mm
        # a steeper arc is longer: of f'' / (1 + f'^2)^(3/2) both change
        curved = self.curvature * (1.0 - 3.0 * sine * sine)
        moved = (sine * sqrt(max(1.0 - sine * sine, 0.0)), curved, self.along)
        sigmas = (self.angle_sigma, self.curvature_sigma, self.along_sigma)
        return gain_error * np.array([one / max(sigma, _NO_SIGMA) for one, sigma in zip(moved, sigmas, strict=True)])

    @property
    def _sideways(self) -> FloatArray:
        """Unit vector along the axis."""
        return np.array([-self.across[1], self.across[0]])

    def unrolled(self, seen_mm: FloatArray, part_mm: float, error_mm: float) -> FloatArray:
        """Positions on the flattened film, from the image's centre, of tops seen along the sensor's axis.

        seen_mm (n, 2): Likewise from the image's centre.
        part_mm: Height of the tops over the film.
        Returns: (5, n, 2), for each of `circles`, and for tops that are higher by `error_mm`.
        """
        across, along = seen_mm @ self.across, seen_mm @ self._sideways
        sines, curvatures, leans = self.circles[[0, 1, 2, 3, 0]].T[:, :, None]
        sines_at = np.empty((5, len(seen_mm) + 1))  # the last column is the image's centre
        sines_at[:, :-1], sines_at[:, -1:] = sines + curvatures * across, sines
        angles = np.arcsin(np.minimum(np.maximum(sines_at, -MOST_SINE), MOST_SINE))
        # arcs of the tops, and by how much the film's are longer or shorter
        longer = 1.0 + np.array([[part_mm], [part_mm], [part_mm], [part_mm], [part_mm + error_mm]]) * curvatures
        arcs, lengths = (angles[:, :-1] - angles[:, -1:]) / curvatures * longer, np.sqrt(1.0 + leans**2) * along
        return np.asarray(arcs[:, :, None] * self.across + lengths[:, :, None] * self._sideways)


def unsure_turn(askew: float, part_mm: float) -> float:
    """Standard deviation of the turn, rad, by a bend too slight to be told from a dome or from another crown.

    Tops h over a film of curvatures K are spread by the share h K, a symmetric matrix: nothing turns. The fit takes it for aspect
    and shear of a camera that keeps the image's rows, and so turns the tape by h K_uv: round 260 mm, 45 degrees to the rows, by
    0.02 degrees, four times the standard deviation where 10 N fill the image with dots. Under a dome there is no such spread.

    askew: Second derivative of the tops by u and v, 1/mm.
    part_mm: h.
    """
    return part_mm * sqrt(max(askew**2 - ASKEW**2, 0.0))


def bend_of(
    surface: FloatArray, variance: FloatArray, gain_error: float, middle_mm: FloatArray, least_curvature: float
) -> Bend | None:
    """The bend of a second-order surface; None of one that is flat, or bent about both axes.

    surface (5,): Slopes in the image's centre, then second derivatives by uu, vv and uv.
    variance (5, 5)
    gain_error: Standard deviation of all of them together, as a share.
    middle_mm (2,): Middle of the contact, where it is right.
    least_curvature: Below it there is none, 1/mm.
    """
    uu, vv, uv = surface[2:].tolist()
    # principal curvatures are (u + v) / 2 +- hypot((u - v) / 2, uv), Mohr's circle; the axis of the larger is turned by half the
    # angle of ((u - v) / 2, uv)
    mean, half = (uu + vv) / 2, hypot((uu - vv) / 2, uv)
    least, most = abs(abs(mean) - half), mean + (half if mean >= 0.0 else -half)
    if least >= max(least_curvature, ROUND * abs(most)) or abs(most) <= 1e-6:
        return None
    turn = 0.5 * atan2(2 * uv, uu - vv) + (0.0 if mean >= 0.0 else pi / 2)
    c, s = cos(turn), sin(turn)
    across = np.array([c, s])
    at = float(across @ middle_mm)
    # rows of the derivatives of the slope across the axis in the middle, of the curvature across, and of the slope along
    x, y = middle_mm.tolist()
    rows = np.array(
        [[c, s, c * x, s * y, c * y + s * x], [0.0, 0.0, c * c, s * s, 2 * c * s], [-s, c, -s * x, c * y, c * x - s * y]]
    )
    slope, curvature, along = (rows @ surface).tolist()
    slope_error, curvature_error, along_error = np.sqrt((rows @ variance @ rows.T).diagonal()).tolist()
    # the circle that has this slope and second derivative there: its curvature is f'' / (1 + f'^2)^(3/2)
    lengths = sqrt(1.0 + slope * slope)
    curvature, curvature_error = curvature / lengths**3, hypot(curvature_error, gain_error * curvature) / lengths**3
    return Bend(
        across=across,
        sine=slope / lengths - curvature * at,
        curvature=curvature,
        along=along,
        middle_mm=at,
        angle_sigma=hypot(slope_error, gain_error * slope) / lengths**2,
        curvature_sigma=curvature_error,
        along_sigma=hypot(along_error, gain_error * along),
    )
