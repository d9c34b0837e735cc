"""Dots of one frame as a sensor's profile has it."""

from __future__ import annotations

from math import sqrt

import numpy as np

from tactape_fab.sense.decode.dots.detect import Dots, detect
from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.dots.rim import chosen
from tactape_fab.sense.sensors import SensorProfile


def frame_dots(image: Image, sensor: SensorProfile) -> Dots:
    """Dots of a canonical depth map, those within the sensor's mask."""
    dots = detect(image, sqrt(sensor.px_per_mm[0] * sensor.px_per_mm[1]))
    if sensor.mask is None or len(dots.weights) == 0:
        return dots
    # a top by the border can be found half a pixel beyond it
    u, v = np.rint(dots.xy_px).astype(np.int64).T
    h, w = sensor.mask.shape
    return chosen(dots, sensor.mask[np.clip(v, 0, h - 1), np.clip(u, 0, w - 1)])
