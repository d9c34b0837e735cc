"""How a tape lies against the gel, from a located frame: tilt, indentation, force. Computed when it is asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, hypot, inf, isfinite, sqrt
from typing import NamedTuple

import numpy as np

from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.contact.bent import Bend, unsure_turn
from tactape_fab.sense.decode.contact.layer import force_on
from tactape_fab.sense.decode.contact.plane import CROWN_ERROR, LEAST_BEND, MOST_CROWN, Plane, dome_of, fit_plane, level_of, terms
from tactape_fab.sense.decode.dots.detect import coarseness
from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.grid.second_order import add_point, solve
from tactape_fab.sense.geometry import Camera, Gel
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import BoolArray, FloatArray

TOP_MM = 0.06
"""Depths are means over so much on every side of a top: less than a part is wide."""
CELL_MM = 1.0
MOST_CELLS = 900
REACH = 1.65
"""Pitches from a dot within which the tape may press on the gel."""
ZERO_MM = 0.0005
"""Standard deviation of a frame's zero, the depth where nothing touches; and, as a share of the depths' span, how far from zero
their mean is at least where a frame has a zero at all: integrated slopes alone have the mean zero."""
NO_ZERO, UNKNOWN_ZERO_MM = 1e-4, 0.2
INDENTATION_SHARE = 0.02
"""Error of an indentation as a share: parts' tops are blurred."""
TOP_SHARE, TOP_SIGMA = 0.45, 0.4
"""Height of a whole dot after the decoder's filter over that of its part, and by how much that is wrong as a share. With 0.5 to
20 N in random gels it is 0.49 for 0201, 0.46 for 01005 and 0.33 for 0402, nine in ten within a factor of 1.5 to 2."""
SLOPE_SIGMA = 0.1
"""Least error of a slope as a share: a crown that is another than the profile's is taken for what the sensor makes of slopes."""
USUAL_CROWN_MM = (150.0, 150.0)
"""Radii of a gel that the sensor's profile does not have, for `off_mm` alone."""
SURE = 5.0
"""Number of standard deviations at which a hypothesis is rejected."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ContactView:
    """A sensor's profile as far as it tells how a tape lies against its gel; made once.

    unit_mm: Millimetres in one unit of a frame.
    rough: Whether that is estimated from the dots' heights, so that slopes are right to `TOP_SIGMA` of them.
    centre_px (2,)
    bent: The camera, unless px/mm are all of it.
    last_px (2,): The last pixel along u and v.
    off_mm: How far from the image's centre the middle of the dots is at least where a flat tape is tilted.
    margin: Pixels that a top reaches to.
    factor, blocks: Pixels along a cell of the coarse frame, and blocks of the image that dots are detected in.
    valid (h, w): Cells of it that the sensor's mask leaves whole; None: all.
    """

    unit_mm: float
    px_per_mm: tuple[float, float]
    centre_px: FloatArray
    bent: Camera | None
    last_px: FloatArray
    off_mm: tuple[float, float]
    margin: int
    factor: int
    blocks: int
    valid: BoolArray | None
    gel: Gel
    rough: bool

    @property
    def elastic(self) -> bool:
        """Whether a force can be told: the gel's thickness and modulus are known."""
        return self.gel.thickness_mm is not None and self.gel.modulus_kpa is not None

    def in_mm(self, heights: FloatArray, body_mm: float) -> ContactView | None:
        """The same in millimetres: where that is rough, by the unit in which whole dots have the height of such parts, if any.

        heights (n,): Of the dots, in the frame's unit.
        """
        if not self.rough:
            return self
        top = float(np.sort(heights)[3 * len(heights) // 4])
        if not 0.0 < top < inf:
            return None
        # the profile's crown is in millimetres, and these are right to 40 %: what is along a cylinder's axis tells it instead
        return replace(self, unit_mm=TOP_SHARE * body_mm / top, gel=replace(self.gel, crown_mm=None))

    def on_gel(self, seen_px: FloatArray) -> FloatArray:
        """Positions of pixels on the gel, right and down of the image centre; (n, 2), px to mm."""
        if self.bent is not None:
            return self.bent.from_px(seen_px) - self.bent.from_px(self.centre_px)
        return (seen_px - self.centre_px) / self.px_per_mm

    def from_border_mm(self, seen_px: FloatArray) -> FloatArray:
        """How far pixels are from the image's border; (n, 2) to (n,)."""
        return np.asarray((np.minimum(seen_px, self.last_px - seen_px) / self.px_per_mm).min(axis=1))


def contact_view(sensor: SensorProfile) -> ContactView:
    """The view of a sensor; it is rough where the profile has no unit."""
    geometry, scale, crown_mm = sensor.geometry, min(sensor.px_per_mm), sensor.gel.crown_mm or USUAL_CROWN_MM
    straight = (geometry.aspect, geometry.shear, geometry.k1) == (0.0, 0.0, 0.0)
    margin = max(round(TOP_MM * scale), 1)
    # n cells have n x n responses, and as many products of them (`layer.force_on`): of 900 they are 13 MB
    least = sqrt(sensor.width_px * sensor.height_px / MOST_CELLS)
    block = coarseness(sqrt(sensor.px_per_mm[0] * sensor.px_per_mm[1]))
    blocks = max(round(CELL_MM * scale / block), ceil(least / block))
    factor = blocks * block
    return ContactView(
        unit_mm=sensor.depth_unit_mm or 1.0,
        rough=sensor.depth_unit_mm is None,
        px_per_mm=sensor.px_per_mm,
        centre_px=sensor.centre_px,
        bent=None if straight else sensor.camera,
        last_px=np.array([sensor.width_px - 1.0, sensor.height_px - 1.0]),
        # a cap of radius R falls as x / R at x from its top: a tape of slope s touches it s R from the centre
        off_mm=(LEAST_OFF * crown_mm[0], LEAST_OFF * crown_mm[1]),
        margin=margin,
        factor=factor,
        blocks=blocks,
        valid=None if sensor.mask is None else _whole(sensor.mask, factor),
        gel=sensor.gel,
    )


def _whole(mask: BoolArray, factor: int) -> BoolArray:
    """Cells of which all pixels are in a mask."""
    h, w = mask.shape[0] // factor, mask.shape[1] // factor
    return np.asarray(mask[: h * factor, : w * factor].reshape(h, factor, w, factor).all(axis=(1, 3)))


class Lie(NamedTuple):
    """How a tape lies under the image that is tilted or bent.

    slope (2,): Rise towards the sensor along image u and v, in the image's centre.
    unsure: Standard deviation of its length as a share.
    bend: Of a tape that is bent about one axis.
    film: Whether the tops are flat or bent about one axis, as those of a film: it is tilted or bent then, whatever else.
    dome: Prior probability that tops with a bend are those of a flat tape under a dome.
    """

    slope: FloatArray
    unsure: float
    bend: Bend | None
    film: bool
    dome: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactSurface:
    """A located frame at its dots, and its coarse depths: some kilobytes.

    dots_px (k, 2): The dots on the tape, as detected.
    agree (k,)
    off_mm: From the image's centre to the mean of the dots that agree.
    heights (k,): Weights of the dots: about 1 inside the contact, and less at its rim.
    tops (k,): Means of the pixels about each dot, in the frame's unit.
    coarse (h, w): Mean of each cell, in the frame's unit.
    curvatures (3,): Second derivatives of the tops by uu, vv and uv, in that unit per px^2.
    """

    view: ContactView
    pitch_mm: float
    dots_px: FloatArray
    agree: BoolArray
    off_mm: tuple[float, float]
    heights: FloatArray
    tops: FloatArray
    coarse: FloatArray
    curvatures: FloatArray

    @cached_property
    def _tops(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Agreeing dots with all the pixels about them: places on the gel (n, 2), depths (n,), both mm, and weights (n,)."""
        at, margin = np.rint(self.dots_px), self.view.margin
        whole = self.agree & ((at >= margin) & (at <= self.view.last_px - margin)).all(axis=1)
        tops_mm = self.tops[whole] * self.view.unit_mm
        # weights are inverse variances: a dot's height over a whole one's is as 1 / error, so squared
        return self.view.on_gel(self.dots_px[whole]), tops_mm, np.minimum(self.heights[whole], 1.0) ** 2

    @cached_property
    def _fitted(self) -> Plane | None:
        """The plane of the tops, if their depths are millimetres."""
        return fit_plane(*self._tops, self.view.gel.crown_mm, TOP_SIGMA if self.view.rough else 0.0)

    @cached_property
    def plane(self) -> Plane | None:
        """The plane of the tops; None where it is steeper than any contact, so that depths are no millimetres."""
        return None if self._steep else self._fitted

    @property
    def _steep(self) -> bool:
        return self._fitted is not None and hypot(*self._fitted.rise[1:]) > MOST_SLOPE

    def lie(self) -> Lie | None:
        """Slope and bend of a tape that is tilted by 0.75 to 30 degrees, a film by 0.25, or bent; None of others.

        A gel with a crown touches a tape in the image's centre, unless it is tilted: dots about it need no fit, unless they are
        round a cylinder.
        """
        least = self.view.off_mm
        if abs(self.off_mm[0]) < least[0] and abs(self.off_mm[1]) < least[1] and not self._maybe_bent():
            return None
        plane = self._fitted
        if plane is None:
            return None
        least_slope = LEAST_OFF if plane.flat else LEAST_SLOPE
        if plane.bend is None and (self._steep or hypot(*plane.rise[1:]) <= least_slope):
            return None
        crown_mm = self.view.gel.crown_mm
        film = plane.flat or (plane.bend is not None and plane.known) or self._under_another_crown(plane)
        if crown_mm is None and plane.bend is None and not film:
            return None
        slope = plane.rise[1:]
        # of the slope's length, as that is what foreshortens
        unsure = sqrt(float(slope @ plane.covariance[1:, 1:] @ slope)) / max(float(slope @ slope), LEAST_SLOPE**2)
        unsure = max(unsure, TOP_SIGMA if self.view.rough else SLOPE_SIGMA)
        return Lie(slope=slope, unsure=unsure, bend=plane.bend, film=film, dome=dome_of(plane))

    def _under_another_crown(self, plane: Plane) -> bool:
        """Whether the tops' curvature is that of a flat tape under a crown that the profile does not have, or has not quite."""
        crown_mm = self.view.gel.crown_mm
        if crown_mm is None:
            most = MOST_CROWN * (1.0 + TOP_SIGMA) if self.view.rough else MOST_CROWN
            return bool(np.abs(plane.shown[3:]).max() <= most)
        crown = (1.0 / crown_mm[0], 1.0 / crown_mm[1], 0.0)
        return bool(np.abs(plane.shown[3:] / plane.gain + crown).max() <= CROWN_ERROR)

    @cached_property
    def _curvatures_mm(self) -> FloatArray:
        """Second derivatives of the tops, 1/mm, by a quick fit."""
        (u, v), unit_mm = self.view.px_per_mm, self.view.unit_mm
        return self.curvatures * (unit_mm * u * u, unit_mm * v * v, unit_mm * u * v)

    def unsure_turn(self, part_mm: float) -> float:
        """Standard deviation of the turn of a tape that is taken for flat and may be bent, rad; part_mm: height of its parts."""
        return unsure_turn(float(self._curvatures_mm[2]), part_mm)

    def _maybe_bent(self) -> bool:
        """Whether the tops' curvature may be that of a tape round a cylinder, by a quick fit."""
        crown_mm, curvatures = self.view.gel.crown_mm, self._curvatures_mm
        if level_of(curvatures) is not None:
            return True
        if crown_mm is None:
            return False
        uu, vv, uv = (curvatures + np.array([1.0 / crown_mm[0], 1.0 / crown_mm[1], 0.0])).tolist()
        mean, half = abs(uu + vv) / 2.0, hypot((uu - vv) / 2.0, uv)
        return bool(mean + half > LEAST_BEND and mean - half < ONE_SIDED * (mean + half))

    @cached_property
    def force(self) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
        """Force, N, and the frame's zero, mm, each with its standard deviation; None where it is not known.

        Neither is known where the tops would not be in the gel, or the gel would pull: the frame has another zero, or unit.
        """
        if self._steep:
            return None, None
        force, zero = self._by_layer
        if zero is None or self.plane is None:
            return force, zero
        deep_mm, deviation_mm = self._below(self.plane, zero)
        within = -SURE * deviation_mm <= deep_mm <= (self.view.gel.thickness_mm or inf)
        if not within or (force is not None and force[0] < -SURE * force[1]):
            return None, None
        return force, zero

    @cached_property
    def _by_layer(self) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
        """The force and the zero, without checks of plausibility."""
        depth, gel = self.coarse * self.view.unit_mm, self.view.gel
        if depth.size == 0 or not np.isfinite(depth).all():
            return None, None
        shown = depth if self.view.valid is None else depth[self.view.valid]
        if shown.size == 0:
            return None, None
        has_zero = abs(float(shown.mean())) > NO_ZERO * float(shown.max() - shown.min())
        if not self.view.elastic:
            return None, ((0.0, ZERO_MM) if has_zero else None)
        cell_mm = (self.view.factor / self.view.px_per_mm[0], self.view.factor / self.view.px_per_mm[1])
        zero_mm = ZERO_MM if has_zero else UNKNOWN_ZERO_MM
        force, zero = force_on(depth, cell_mm, self._touched(), gel, zero_mm, self.view.valid)
        # depths in another unit may be so large that the deviations before the frame are lost beside them
        return (force, zero) if isfinite(sum(force + zero)) else (None, None)

    def _touched(self) -> BoolArray:
        """Cells of the coarse frame near a dot."""
        # middles of cells, where integers are pixel centres
        v, u = (np.indices(self.coarse.shape) + 0.5) * self.view.factor - 0.5
        cells, dots = self.view.on_gel(np.column_stack([u.ravel(), v.ravel()])), self.view.on_gel(self.dots_px)
        squares = sum((cells[:, k, None] - dots[:, k]) ** 2 for k in range(2))
        return np.asarray((np.min(squares, axis=1) < (REACH * self.pitch_mm) ** 2).reshape(self.coarse.shape))

    @cached_property
    def tilt(self) -> tuple[FloatArray, FloatArray] | None:
        """Angles by which the tape rises towards the sensor along image u and v, (2,) rad, and their covariance, (2, 2) rad^2."""
        if self.plane is None:
            return None
        slopes = self.plane.rise[1:]
        # d arctan(s) / ds
        rates = np.diag(1.0 / (1.0 + slopes**2))
        return np.arctan(slopes), rates @ self.plane.covariance[1:, 1:] @ rates

    @cached_property
    def indentation(self) -> tuple[float, float] | None:
        """How deep the tops are in the gel in the middle of the contact, and the standard deviation, mm."""
        plane, zero = self.plane, self.force[1]
        return None if plane is None or zero is None else self._below(plane, zero)

    def _below(self, plane: Plane, zero: tuple[float, float]) -> tuple[float, float]:
        """The indentation over a frame's zero, and its standard deviation; mm."""
        gel_mm, _, weights = self._tops
        # the surface's terms at the weighted middle of the tops: a height there is a product with the fitted coefficients
        row = terms((weights @ gel_mm) / weights.sum())
        found = (float(row @ plane.shown) - zero[0]) / plane.gain
        variance = float(row @ plane.shown_variance @ row) + zero[1] ** 2
        return found, sqrt(variance + (INDENTATION_SHARE * found) ** 2)

    @cached_property
    def ahead(self) -> tuple[float, float] | None:
        """How far the gel's undeformed surface is beyond the tops, in the image's centre along the sensor's axis; its deviation.

        Both in mm; negative where the tape does not reach the gel there.
        """
        plane, zero = self.plane, self.force[1]
        if plane is None or zero is None:
            return None
        found = float(plane.rise[0]) - zero[0] / plane.gain
        return found, sqrt(float(plane.covariance[0, 0]) + zero[1] ** 2 + (INDENTATION_SHARE * found) ** 2)


LEAST_SLOPE = 0.0131
"""Slope, 0.75 degrees, below which a contact counts as flat: what a tilt takes doubles the time of a frame."""
MOST_SLOPE = 0.58
"""Slope, 30 degrees, above which depths are no millimetres: a frame in another unit has a place all the same."""
ONE_SIDED = 0.5
"""The most curvature along the axis of a bent tape, over that across it, in the quick fit."""
LEAST_OFF = 0.0044
"""Share of the crown's radius by which the middle of the dots is at least off the image's centre then. A tape of slope s touches
the gel s times the radius off; where forces are small the middle is as far, at 10 N, where the image is full of dots, a third."""


def contact_surface(
    view: ContactView, image: Image, small: Image, dots_px: FloatArray, agree: BoolArray, heights: FloatArray, pitch_mm: float
) -> ContactSurface:
    """Take what `ContactSurface` needs out of a frame, and compute nothing.

    image (h, w): Canonical.
    small: The same as dots are detected in it, `Dots.small`.
    dots_px, agree, heights, pitch_mm: As in `ContactSurface`.
    """
    tops, coarse = np.empty(len(dots_px)), np.empty((image.shape[0] // view.factor, image.shape[1] // view.factor))
    line, normal = np.empty(small.shape[1]), np.zeros((7, 7))
    u, v = taken(image, small, dots_px, agree, heights, view.margin, view.blocks, tops, coarse, line, normal)
    return ContactSurface(
        view=view,
        pitch_mm=pitch_mm,
        dots_px=dots_px,
        agree=agree,
        off_mm=((u - view.centre_px[0]) / view.px_per_mm[0], (v - view.centre_px[1]) / view.px_per_mm[1]),
        heights=heights,
        tops=tops,
        coarse=coarse,
        curvatures=normal[3:6, 6],
    )


@kernel(fastmath={"reassoc", "contract"})
def taken(
    image: Image,
    small: Image,
    dots_px: FloatArray,
    agree: BoolArray,
    heights: FloatArray,
    margin: int,
    blocks: int,
    tops: FloatArray,
    coarse: FloatArray,
    line: FloatArray,
    normal: FloatArray,
) -> tuple[float, float]:
    """Fill in the mean of the pixels about each dot, or of the nearest that are whole, and the means of cells of `blocks` blocks.

    Returns the mean of the dots that agree; `line` is a work buffer, and so is `normal` (7, 7), zero before, which has the second
    derivatives of their tops by uu, vv and uv in [3:6, 6] after.
    """
    h, w = image.shape
    # `small` is less a value of the image, so that few digits are lost: by it the first block differs
    factor, zero = h // small.shape[0], 0.0
    for j in range(factor * factor):
        zero += image[j // factor, j % factor]
    zero = zero / (factor * factor) - small[0, 0]
    for row in range(len(coarse)):
        for u in range(len(line)):
            line[u] = small[row * blocks, u]
        for j in range(1, blocks):
            for u in range(len(line)):
                line[u] += small[row * blocks + j, u]
        for column in range(coarse.shape[1]):
            total = 0.0
            for j in range(column * blocks, (column + 1) * blocks):
                total += line[j]
            coarse[row, column] = total / (blocks * blocks) + zero
    across = 2 * margin + 1
    u_sum = v_sum = count = 0.0
    for k in range(len(dots_px)):
        u = min(max(round(dots_px[k, 0]), margin), w - 1 - margin)
        v = min(max(round(dots_px[k, 1]), margin), h - 1 - margin)
        total = 0.0
        for j in range(across * across):
            total += image[v - margin + j // across, u - margin + j % across]
        tops[k] = total / (across * across)
        if agree[k]:
            u_sum += dots_px[k, 0]
            v_sum += dots_px[k, 1]
            count += 1.0
    if count == 0.0:
        return np.inf, np.inf
    u_mean, v_mean = u_sum / count, v_sum / count
    for k in range(len(dots_px)):
        if agree[k]:
            add_point(dots_px[k, 0] - u_mean, dots_px[k, 1] - v_mean, tops[k], min(heights[k], 1.0) ** 2, normal)
    for i in range(6):
        # a ridge, as dots may be few or in a line
        normal[i, i] = normal[i, i] * (1.0 + 1e-9) + 1e-9
    solve(normal)
    return u_mean, v_mean
