"""Validation of frames and dots from callers: plain arrays, or a `FrameError` that says what is invalid."""

from __future__ import annotations

from functools import lru_cache
from math import isfinite, isnan, nan, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import FrameError
from tactape_fab.base.given_value import NO_ARRAY, unmasked
from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.dots.holes import filled
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import BoolArray, FloatArray

_Signed = npt.NDArray[np.int32]
_Unsigned = npt.NDArray[np.uint32]

LARGE = 1e9
"""Depths beyond this are scaled; dots beyond it are refused."""
_SMALL = 1e-30
"""A frame whose depths are all below this is scaled: the least normal number in single precision is 1.2e-38."""
_LEAST_SPAN = 1e-5
"""If depths span a smaller share of their magnitude, their offset is taken off: single precision has steps of 6e-8 of that."""

_LEAST_MM = 0.005
"""Depths that span less are in another unit, such as metres taken for millimetres: a part presses a gel in by more."""


def canonical_frame(depth: npt.ArrayLike, sensor: SensorProfile) -> npt.NDArray[np.float32]:
    """The image that `canonical_depths` returns."""
    return canonical_depths(depth, sensor)[0]


def canonical_depths(depth: npt.ArrayLike, sensor: SensorProfile) -> tuple[npt.NDArray[np.float32], bool]:
    """A raw frame as the canonical image, and whether its depths are unscaled and plausible in the profile's unit.

    NaN, infinite and masked values, and pixels outside the sensor's mask, are filled from those beside them.
    The image may be a view of the frame: treat it as read-only.

    Raises FrameError if the frame is no array of real numbers, or not of the sensor's shape.
    """
    try:
        frame = np.asarray(unmasked(depth))
        # numpy's kinds: float, int, unsigned, bool. Complex, text and objects could be cast without an error
        if frame.dtype.kind not in "fiub":
            raise ValueError(f"dtype {frame.dtype}")
        if frame.dtype == np.float32 and frame.flags.carray:
            image = frame
        else:
            with np.errstate(over="ignore", invalid="ignore"):  # what is too large becomes a hole
                image = np.require(frame, np.float32, ("C", "A", "W"))
    except NO_ARRAY as error:
        raise FrameError(f"the frame is no array of numbers: {error}; give a depth map (h, w)") from error
    expected = sensor.frame_shape
    if image.ndim != 2:
        raise FrameError(f"the frame has shape {image.shape}; give one depth map at a time (h, w)")
    if image.shape != expected:
        raise FrameError(
            f"a frame of shape {image.shape} is none of sensor '{sensor.name}', whose frames are {expected[0]} x "
            f"{expected[1]} (h, w); give another sensor"
        )
    (low, high), as_came = span(image), True
    # a NaN fails any comparison, so a frame with holes goes through `_fitted` as well, which looks at the rest
    largest = max(abs(low), abs(high))
    if image.dtype != frame.dtype and not (_SMALL <= largest < np.inf and high - low >= _LEAST_SPAN * largest):
        unscaled, image = image, _fitted(frame, image)
        as_came = image is unscaled
        low, high = span(image)
    if sensor.mask is not None or not (isfinite(low) and isfinite(high)):
        image = filled(image, shown_pixels(sensor), sqrt(sensor.px_per_mm[0] * sensor.px_per_mm[1]))
        low, high = span(image)
    as_came = as_came and not high - low < _LEAST_MM / (sensor.depth_unit_mm or 1.0)
    # only relative heights matter: extreme ones are scaled to 0 ... 1, well within single precision
    if high == low:
        image = np.zeros_like(image)
    elif max(abs(low), abs(high)) > LARGE or high - low < 1.0 / LARGE:
        # in double precision: the difference of two large values has lost its digits in single
        image, as_came = ((image.astype(np.float64) - low) / (high - low)).astype(np.float32), False
    return np.ascontiguousarray(sensor.canonical(image)), as_came


@lru_cache(maxsize=8)
def shown_pixels(sensor: SensorProfile) -> BoolArray:
    """The sensor's mask in the raw frame's orientation, the inverse of `SensorProfile.canonical`; True inside. Read only."""
    if sensor.mask is None:
        return np.ones(sensor.frame_shape, dtype=np.bool_)
    turned = np.rot90(sensor.mask, -sensor.rotate90)
    return np.ascontiguousarray(turned[:, ::-1] if sensor.mirror else turned)


def span(image: npt.NDArray[np.float32]) -> tuple[float, float]:
    """Least and largest value; NaN if any value is NaN."""
    image, ends = np.ascontiguousarray(image), np.empty(2, dtype=np.float32)
    _find_span(image.view(np.int32), image.view(np.uint32), ends.view(np.int32), ends.view(np.uint32))
    low, high = ends.tolist()
    return (nan, nan) if isnan(low) or isnan(high) else (low, high)


@kernel()
def _find_span(signed: _Signed, unsigned: _Unsigned, out: _Signed, unsigned_out: _Unsigned) -> None:
    """Fill in the bits of the least and of the largest of some single-precision numbers, from their bits.

    Bits of IEEE 754 order as signed integers where positive, and in reverse where negative; NaN lies beyond infinity. So
    integer loops vectorise as those of floats do, and no NaN is lost.
    """
    least, largest, last = signed[0, 0], signed[0, 0], unsigned[0, 0]
    for v in range(signed.shape[0]):
        for u in range(signed.shape[1]):
            least, largest, last = min(least, signed[v, u]), max(largest, signed[v, u]), max(last, unsigned[v, u])
    out[0], out[1] = least, largest if largest >= 0 else least
    if least < 0:
        unsigned_out[0] = last


def _fitted(frame: npt.NDArray[Any], image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """A frame in single precision, shifted or scaled if that cannot hold most of its values; `image` is the plain cast.

    A few values that are too large become holes: they say nothing of the frame's scale.
    """
    known = frame[np.isfinite(frame)]
    least, most = (known.min().item(), known.max().item()) if len(known) else (0, 0)
    if 0 < most - least < _LEAST_SPAN * max(abs(least), abs(most)):
        # in the frame's own type, before single precision rounds heights away beside a large background
        frame = frame - known.min()
        with np.errstate(over="ignore", invalid="ignore"):
            image = frame.astype(np.float32)
    low, high = float(np.fmin.reduce(image, axis=None)), float(np.fmax.reduce(image, axis=None))  # of what is no NaN
    if _SMALL <= max(abs(low), abs(high)) < np.inf:
        return image
    height = np.abs(frame[np.isfinite(frame) & (frame != 0)])
    middle = len(height) // 2
    typical = float(np.partition(height, middle)[middle]) if len(height) else 1.0  # the mean of two could be infinite
    if _SMALL <= typical <= 1.0 / _SMALL or typical == 0.0:
        return image
    with np.errstate(over="ignore", invalid="ignore"):
        return (frame / typical).astype(np.float32)


def dot_numbers(values: npt.ArrayLike) -> FloatArray:
    """Values as an array of real numbers. Raises FrameError."""
    try:
        array = np.asarray(unmasked(values))
        if array.dtype.kind not in "fiub":
            raise ValueError(f"dtype {array.dtype}")
        return array.astype(np.float64)
    except NO_ARRAY as error:
        raise FrameError(f"dots are no array of numbers: {error}; give xy (n, 2) and weights (n,)") from error
