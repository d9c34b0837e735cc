"""Dots -> better dots: the relief that a box leaves in the gel, fitted to the pixels around each of them.

The noise of a photometric stereo sensor is white in the slopes, so its depth falls as 1/f (power 1/f^2): least squares of the
differences between neighbouring pixels, |dz/du|^2 + |dz/dv|^2 summed, weigh every frequency as its noise asks for,
since 4 sin^2(k_u / 2) + 4 sin^2(k_v / 2) is both the weight and one over the spectrum. Height and background of each
dot are linear and fitted along with it; what is left of a dot is its centre, to be handed to `grid.pose.fit_pose`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from math import hypot, log, sqrt

import numpy as np

from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.pixels.patch_kernel import STEPS, differences, fit_patches, patch_buffers, smoothed_body
from tactape_fab.sense.geometry import USUAL_BLUR_MM, Camera
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import BoolArray, FloatArray
from tactape_fab.texture.part import TapePart

BOX = "block"
FINE_PX_PER_MM = 12.0
"""Finer images are averaged down to no less than this; a blur of 0.1 mm is 1.2 px there."""
HALF_MM = 0.55
"""Half the side of the patch around a dot: a part of 0.6 x 0.3 mm with its blur. A pixel less at 16 px/mm, 8 of them, makes
places of 7x7 mm 3 % less exact and takes 3 % less of a frame's time."""
BLUR_STEP, MOST_BLUR_STEPS = 1.2, 6
BLURS_MM = tuple(USUAL_BLUR_MM * BLUR_STEP**k for k in range(-MOST_BLUR_STEPS, MOST_BLUR_STEPS + 1))
"""Standard deviations of the gel's blur that are told apart, mm; the usual one is tried first. At a blur that is wrong by 30 %
the error is 4 to 10 % larger."""
BLUR_NEAR, BLUR_PATCHES, BLUR_STEPS = 0.25, 8, 6
"""The blur is kept if it is off by less than this (ln), as it is also fitted to each dot; dots that another blur is estimated
from, and largest number of steps for it."""
AGAIN_MM = 0.025
"""A dot that moves farther is fitted once more from its new place: the fit is linear for small moves alone."""
AGAIN_HEIGHT = 0.9
"""Dots lower than this over the median, mostly those at the rim, are not fitted again: they weigh too little to matter."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelFit:
    """The constants of a fit, which do not depend on the frame.

    factor: Pixels of the canonical image along a side of a pixel that is looked at.
    scale_px_per_mm: Of those, along u and v.
    centre_mm (2,): The image centre on the gel, from the camera's.
    half_px: Half a patch, without its middle.
    offsets_px (2 half_px + 1,): Of a patch's pixels from its middle.
    basis (5, m): In the order of `differences`: differences of backgrounds of first and second order, orthonormal.
    usable (h, w): Pixels around which a whole patch has depth.
    blur_mm: Standard deviation of the gel's blur; None: estimated from the frame.
    variance: Of the noise of a slope, as a difference of pixels in the frame's unit; None where it is not known.
    """

    factor: int
    scale_px_per_mm: tuple[float, float]
    camera: Camera
    centre_mm: FloatArray
    half_px: int
    offsets_px: Image
    basis: Image
    usable: BoolArray
    blur_mm: float | None
    variance: float | None

    @property
    def freedom(self) -> float:
        """Expected sum of a patch's squared residual differences, over the variance of a slope.

        Both differences of a pixel have that variance together; height, position and background take eight degrees of freedom.
        The blur, which all dots share, takes none.
        """
        # side (side - 1) differences along u and as many along v. White slopes of variance s^2 have s^2 for each component and
        # pixel; the depth is integrated from their part without curl, which is half of it on the mean: s^2 for both components
        # together
        side = len(self.offsets_px)
        return side * (side - 1.0) - 8.0

    def to_px(self, gel_mm: FloatArray) -> FloatArray:
        """Points on the gel, mm right and down of the image centre, to pixels of the averaged image; (n, 2)."""
        return (self.camera.to_px(gel_mm + self.centre_mm) - (self.factor - 1) / 2) / self.factor

    def from_px(self, at_px: FloatArray) -> FloatArray:
        """The inverse of `to_px`."""
        return self.camera.from_px(at_px * self.factor + (self.factor - 1) / 2) - self.centre_mm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Patches:
    """Fitted dots.

    moved_mm (n, 2): From where each was looked for, along its body's length and width.
    height (n,): In the frame's unit.
    imprint (n,): Height if the blur of all dots is that of the fit; what noise does to it is a third of what it does to `height`.
    spread_mm2 (n, 2, 2): Covariance of `moved_mm` where the slopes' variance is 1.
    more_mm2, more_variance (n,): Half the blur's variance less that of the fit, and how much one knows of it.
    left (n,): Squared residual differences.
    misfit (n,): Their share of the squared differences without the background's.
    """

    moved_mm: FloatArray
    height: FloatArray
    imprint: FloatArray
    spread_mm2: FloatArray
    more_mm2: FloatArray
    more_variance: FloatArray
    left: FloatArray
    misfit: FloatArray

    def taken(self, which: BoolArray) -> Patches:
        """The selected dots."""
        return Patches(**{field.name: getattr(self, field.name)[which] for field in fields(self)})


def pixel_fit(sensor: SensorProfile) -> PixelFit:
    """Prepare the fit for a sensor."""
    scale = sqrt(sensor.px_per_mm[0] * sensor.px_per_mm[1])
    slope, unit = sensor.slope_noise, sensor.depth_unit_mm
    factor = max(int(scale / FINE_PX_PER_MM), 1)
    half = max(round(HALF_MM * scale / factor), 3)
    offsets = np.arange(-half, half + 1, dtype=np.float32)
    # from -1 to 1, so that backgrounds of both orders are of one size and single precision holds their products
    u, v = np.meshgrid(offsets / half, offsets / half)
    # u.size - 1 differences row by row, with 0 at the ends of rows, and u.size - len(u) downwards; a constant background has
    # none
    smooth = np.empty((5, 2 * u.size - 1 - len(u)), dtype=np.float32)
    for background, out in zip((u, v, u * u, u * v, v * v), smooth, strict=True):
        differences(background.ravel(), len(u), out)
    return PixelFit(
        factor=factor,
        scale_px_per_mm=(sensor.px_per_mm[0] / factor, sensor.px_per_mm[1] / factor),
        camera=sensor.camera,
        centre_mm=sensor.camera.from_px(sensor.centre_px),
        half_px=half,
        offsets_px=offsets,
        # an orthonormal basis: the squared projection of a column on the backgrounds is the sum of its squared products with them
        basis=np.ascontiguousarray(np.linalg.qr(smooth.T.astype(np.float64))[0].T, dtype=np.float32),
        usable=_usable(sensor, factor, half),
        blur_mm=sensor.gel.blur_mm,
        # a slope times a pixel, 1 / scale mm, in the frame's unit. Means over blocks of factor^2 pixels have slopes less noisy
        # by the factor, over pixels wider by it: their differences have the same variance
        variance=None if not slope or unit is None else (slope / scale / unit) ** 2,
    )


def unknown_relief(part: TapePart | None) -> str | None:
    """Why the relief of a part cannot be modelled; None if it can."""
    if part is None or part.shape != BOX:
        return "the parts are no boxes of known size"
    if max(part.body_mm[:2]) > 2.0 * HALF_MM:
        return f"parts of {max(part.body_mm[:2]):g} mm are larger than the {2.0 * HALF_MM:g} mm that are looked at"
    return None


def rehearse_patches(fit: PixelFit, parts: Iterable[TapePart]) -> None:
    """Make the tables of some parts now."""
    flat = np.zeros((len(fit.offsets_px), len(fit.offsets_px)), dtype=np.float32)
    to_body = np.diag(1.0 / np.array(fit.scale_px_per_mm))
    for part in {part.body_mm: part for part in parts if unknown_relief(part) is None}.values():
        for blur_mm in BLURS_MM if fit.blur_mm is None else (fit.blur_mm,):
            fitted(fit, flat, np.full((1, 2), float(fit.half_px)), to_body, part, blur_mm)


def _usable(sensor: SensorProfile, factor: int, half: int) -> BoolArray:
    """Pixels, averaged over `factor`, around which so many on each side are in the image and carry depth."""
    h, w = sensor.height_px // factor, sensor.width_px // factor
    depth = np.zeros((h + 2 * half, w + 2 * half), dtype=np.int64)  # none beyond the image
    if sensor.mask is None:
        depth[half : half + h, half : half + w] = 1
    else:
        blocks = sensor.mask[: h * factor, : w * factor].reshape(h, factor, w, factor)
        depth[half : half + h, half : half + w] = blocks.all(axis=(1, 3))
    # a summed-area table: four entries count the pixels with depth of any rectangle
    sums = np.pad(depth, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    side = 2 * half + 1
    count = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    return np.asarray(count == side * side)


def has_patch(fit: PixelFit, at_px: FloatArray) -> BoolArray:
    """Whether all pixels around places can be used."""
    h, w = fit.usable.shape
    at = np.rint(at_px)
    # places may lie off the image: clipped they are an index, and no longer equal to what was asked for
    nearest = np.minimum(np.maximum(at, 0.0), (w - 1.0, h - 1.0))
    u, v = nearest.astype(np.int64).T
    return np.asarray((nearest == at).all(axis=1) & fit.usable[v, u])


def median(values: FloatArray) -> float:
    """Upper median; numpy's takes five times as long for a few values."""
    return float(np.sort(values)[len(values) // 2])


def settled_patches(
    fit: PixelFit, image: Image, at_px: FloatArray, to_body: FloatArray, part: TapePart
) -> tuple[Patches, FloatArray]:
    """Dots fitted under the gel's blur, those that moved far once more; and their centres, px."""
    blur_mm = USUAL_BLUR_MM if fit.blur_mm is None else fit.blur_mm
    found = fitted(fit, image, at_px, to_body, part, blur_mm)
    if fit.blur_mm is None:
        wanted_mm, few = _wanted_blur_mm(blur_mm, found), at_px[:BLUR_PATCHES]
        # each fit is linear in half the blur's variance, so a blur that is far off takes several steps
        if abs(log(wanted_mm / blur_mm)) > BLUR_NEAR:
            for _ in range(BLUR_STEPS):
                again = fitted(fit, image, few, to_body, part, wanted_mm, at_px)
                blur_mm, wanted_mm = wanted_mm, _wanted_blur_mm(wanted_mm, again)
                if abs(log(wanted_mm / blur_mm)) <= BLUR_NEAR:
                    break
            found = fitted(fit, image, at_px, to_body, part, blur_mm)
    (a, b), (c, d) = to_body.tolist()
    to_px = np.array([[d, -c], [-b, a]]) / (a * d - b * c)  # the inverse, for rows
    centres = at_px + found.moved_mm @ to_px
    far = (np.hypot(found.moved_mm[:, 0], found.moved_mm[:, 1]) > AGAIN_MM) & (found.height > AGAIN_HEIGHT * median(found.height))
    which = far.nonzero()[0]
    if len(which):
        which = which[has_patch(fit, centres[which])]
    if len(which):
        again = fitted(fit, image, centres[which], to_body, part, blur_mm, centres)
        centres[which] += again.moved_mm @ to_px
        for name in ("height", "imprint", "spread_mm2", "left", "misfit"):
            getattr(found, name)[which] = getattr(again, name)
    return found, centres


def _wanted_blur_mm(blur_mm: float, found: Patches) -> float:
    """The blur of `BLURS_MM` that a fit under another one asks for, half to twice that."""
    # a mean weighted by 1 / variance; what is no bump has no blur
    weight = (found.height > 0.0) / found.more_variance
    if 2 * np.count_nonzero(weight) > len(weight):
        # `more_mm2` is half the variance that is missing
        square = blur_mm**2 + 2.0 * float(weight @ found.more_mm2) / max(float(weight.sum()), 1e-300)
    else:  # what is much sharper looks like a negative height and a blur that makes up for it
        square = 0.0
    square = min(max(square, blur_mm**2 / 4.0), blur_mm**2 * 4.0)
    # the nearest blur of the geometric series: tables are kept for these alone
    steps = round(log(max(square, 1e-300) / USUAL_BLUR_MM**2) / (2.0 * log(BLUR_STEP)))
    return BLURS_MM[min(max(steps, -MOST_BLUR_STEPS), MOST_BLUR_STEPS) + MOST_BLUR_STEPS]


def fitted(
    fit: PixelFit,
    image: Image,
    at_px: FloatArray,
    to_body: FloatArray,
    part: TapePart,
    blur_mm: float,
    around_px: FloatArray | None = None,
) -> Patches:
    """Centre and height of each dot by linear least squares of the differences between neighbouring pixels.

    image (h, w)
    at_px (n, 2): Where dots are looked for; a whole patch around each is in the image.
    to_body (2, 2): Pixels right and down to mm along the bodies' length and width.
    part: A block.
    blur_mm: Standard deviation of the Gaussian that the gel smooths it by.
    around_px (k, 2): All dots, where `at_px` are some of them: one up to `NEXT_MM` off belongs to the relief, but does not move.
    """
    base, side = np.rint(at_px).astype(np.int64), len(fit.offsets_px)
    # a pixel is the mean over its area, which is as a blur of 1/12 px^2
    blur = hypot(blur_mm, 1.0 / sqrt(12.0) / fit.scale_px_per_mm[0])
    body = smoothed_body(part.body_mm, blur, side, STEPS * max(fit.scale_px_per_mm), to_body)
    around = (at_px if around_px is None else around_px).astype(np.float32)
    out = np.empty((12, len(base)))
    fit_patches(
        image, base, (at_px - base).astype(np.float32), around, body, fit.basis, side, patch_buffers(fit.basis, side), out
    )
    return Patches(
        moved_mm=out[0:2].T,
        height=out[2],
        imprint=out[3],
        spread_mm2=out[4:8].T.reshape(-1, 2, 2),
        more_mm2=out[8],
        more_variance=out[9],
        left=out[10],
        misfit=out[11],
    )
