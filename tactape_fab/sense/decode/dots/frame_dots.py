"""Dots of one frame by a sensor's profile; for adjustments of many frames, in undistorted square pixels."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
import numpy.typing as npt

from tactape_fab.sense.decode.dots.detect import Dots, detect
from tactape_fab.sense.decode.dots.elongation import square_pixels
from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.dots.inputs import canonical_frame
from tactape_fab.sense.decode.dots.middles import middles
from tactape_fab.sense.decode.dots.rim import chosen, settled
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape


def frame_dots(image: Image, sensor: SensorProfile) -> Dots:
    """Dots of a canonical depth map that lie within the sensor's mask."""
    dots = detect(image, sqrt(sensor.px_per_mm[0] * sensor.px_per_mm[1]))
    if sensor.mask is None:
        return dots
    # a top by the border can be found half a pixel beyond it
    u, v = np.rint(dots.xy_px).astype(np.int64).T
    h, w = sensor.mask.shape
    return chosen(dots, sensor.mask[np.clip(v, 0, h - 1), np.clip(u, 0, w - 1)])


def detected(frame: npt.ArrayLike, sensor: SensorProfile) -> Dots:
    """Dots of a raw frame, undistorted by `squared`; `seen_px` keeps their positions in the canonical image."""
    dots = frame_dots(canonical_frame(frame, sensor), sensor)
    return replace(dots, xy_px=squared(dots.xy_px, sensor), seen_px=dots.xy_px)


def contact_dots(frame: npt.ArrayLike, sensor: SensorProfile, tape: Tape) -> Dots:
    """Dots of a raw frame of a tape, as `Localizer` has them: those at the rim put back, those of sharp tops at middles.

    Returns: Those of the decoder's answer, in its order; `xy_px` as `squared` has them. `seen_px` are at middles, too, as far as
        `by_edges` says: these are seen, and the rim's correction is computed.
    """
    image, scale, camera = canonical_frame(frame, sensor), sensor.px_per_mm[0], sensor.camera
    raw, aspect = frame_dots(image, sensor), float(camera.matrix[0, 0] / camera.matrix[1, 1])
    elongation = square_pixels(raw.elongation, aspect)
    raw = replace(raw, xy_px=squared(raw.xy_px, sensor), elongation=elongation, seen_px=raw.xy_px)
    dots = settled(raw, tape.pitch_mm * scale, tape.displacement_mm / tape.pitch_mm)
    found = middles(dots, image, tape.part, scale, aspect)
    if found is None or dots.seen_px is None:
        return dots
    offset_px, share = found
    middle_px = dots.seen_px + offset_px / (1.0, aspect)
    return replace(
        dots,
        xy_px=dots.xy_px + share * (squared(middle_px, sensor) - dots.xy_px),
        seen_px=dots.seen_px + share * (middle_px - dots.seen_px),
        by_edges=share,
    )


def squared(seen_px: FloatArray, sensor: SensorProfile) -> FloatArray:
    """Undistorted positions from the image centre, in square pixels of the profile's px/mm along u."""
    camera = sensor.camera
    # dots in mm, then at one px/mm along both axes: the decoder's grid has square cells
    on_gel: FloatArray = camera.from_px(seen_px) - camera.from_px(sensor.centre_px)
    return on_gel * sensor.px_per_mm[0]
