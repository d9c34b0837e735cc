"""The undistorted image with square pixels, in which the decoder measures: a sensor's dots converted to it, and refined."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from tactape_fab.base.libraries import library
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.dots.elongation import square_pixels
from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.dots.frame_dots import frame_dots
from tactape_fab.sense.decode.dots.middles import middles
from tactape_fab.sense.decode.dots.subpixel import sharp_tops
from tactape_fab.sense.decode.grid.long_parts import drawn_px
from tactape_fab.sense.geometry import Camera
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SquareImage:
    """The image of a perfect camera of the profile's px/mm along u: square pixels, no shear, no distortion.

    aspect: Factor on v that makes the sensor's pixels square.
    straight: Whether that factor is all there is to it.
    centre_px: Of the image, in square pixels.
    detection_px_per_mm: At which dots are detected: between those along u and v.
    """

    sensor: SensorProfile
    camera: Camera
    aspect: float
    straight: bool
    px_per_mm: float
    centre_px: FloatArray
    detection_px_per_mm: float

    def places(self, xy_px: FloatArray) -> FloatArray:
        """Positions in the canonical image, shape (n, 2), converted to square pixels."""
        if self.straight:
            out: FloatArray = xy_px * (1.0, self.aspect)
        else:
            # the profile's camera undone, then a perfect one: places on the gel times px/mm, the image centre kept
            on_gel = self.camera.from_px(xy_px) - self.camera.from_px(self.sensor.centre_px)
            out = on_gel * self.px_per_mm + self.centre_px
        return out

    def image(self, image: Image) -> Image:
        """A canonical depth map resampled for the perfect camera, with the same centre.

        Raises MissingLibraryError without OpenCV, where there is something to change.
        """
        if self.straight and self.aspect == 1.0:
            return image
        cv2 = library("cv2", 'method "paper"')
        if self.straight:
            return np.asarray(cv2.resize(image, None, fx=1.0, fy=self.aspect, interpolation=cv2.INTER_LINEAR), dtype=np.float32)
        # the way back of `places`, from each pixel of the perfect image
        half = np.array([self.sensor.width_px - 1, round((self.sensor.height_px - 1) * self.aspect)]) / 2
        v, u = np.mgrid[: 2 * half[1] + 1, : 2 * half[0] + 1]
        on_gel = (np.stack([u, v], axis=-1) - half) / self.px_per_mm + self.camera.from_px(self.sensor.centre_px)
        seen_px = self.camera.to_px(on_gel).astype(np.float32)
        # pixels beyond the frame are as its border: a step there would be a ridge
        return np.asarray(cv2.remap(image, seen_px, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32)

    def dots(self, image: Image) -> Dots:
        """Dots of a canonical depth map within the sensor's mask, in square pixels."""
        dots = frame_dots(image, self.sensor)
        if self.aspect != 1.0 or not self.straight:
            elongation = square_pixels(dots.elongation, self.aspect)
            dots = replace(dots, xy_px=self.places(dots.xy_px), elongation=elongation, seen_px=dots.xy_px)
        return dots

    def at_middles(self, dots: Dots, image: Image, part: TapePart | None) -> Dots:
        """Dots of long bodies at their middles, as far as edges show them; `dots.middles`.

        dots: In square pixels, with `seen_px`.
        image (h, w): The canonical depth map that they were detected in.
        part: The tapes' part; None if they differ.
        """
        found = middles(dots, image, part, self.px_per_mm, self.aspect)
        if found is None or dots.seen_px is None:
            return dots
        offset_px, share = found
        return replace(dots, xy_px=dots.xy_px + share * (self.places(dots.seen_px) + offset_px - dots.xy_px), by_edges=share)

    def shifts(
        self, part: TapePart | None, high: Image, seen_px: FloatArray, offset_px: FloatArray, texture_mm: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        """Corrections of the detected positions (n, 2), square pixels, heights of the dots (n,), and `Drawn.covariance`.

        part: The tapes' part; None if they differ.
        high: The band-passed depth map, `Dots.high`.
        seen_px, offset_px, texture_mm (n, 2): Where each was detected, in pixels of the canonical image; the rest as
            `grid.long_parts.drawn_px` takes it.
        """
        shift_px, heights = sharp_tops(high, self.detection_px_per_mm, seen_px)
        if self.aspect != 1.0:
            # shifts are a tenth of a pixel: that shear and distortion turn them by some per cent is left out
            shift_px = shift_px * (1.0, self.aspect)
        if part is None:
            return shift_px, heights, None
        drawn = drawn_px(part, heights, offset_px, texture_mm, self.px_per_mm)
        return (shift_px, heights, None) if drawn is None else (shift_px - drawn.shift_px, heights, drawn.covariance)


def square_image(sensor: SensorProfile) -> SquareImage:
    """The square image of a sensor."""
    camera, geometry = sensor.camera, sensor.geometry
    aspect = float(camera.matrix[0, 0] / camera.matrix[1, 1])
    return SquareImage(
        sensor=sensor,
        camera=camera,
        aspect=aspect,
        straight=(geometry.shear, geometry.k1, geometry.aspect) == (0.0, 0.0, 0.0),
        px_per_mm=sensor.px_per_mm[0],
        centre_px=sensor.centre_px * np.array([1.0, aspect]),
        detection_px_per_mm=sqrt(sensor.px_per_mm[0] * sensor.px_per_mm[1]),
    )
