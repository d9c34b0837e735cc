"""Raw frames: the span of their depths, which of them are in the profile's unit, and the mask as it lies on them."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import numpy.typing as npt
import pytest

from tactape_fab import FrameError
from tactape_fab.sense import load_sensor
from tactape_fab.sense.decode.dots.inputs import canonical_depths, dot_numbers, shown_pixels, span

EXTREME = (0.0, -0.0, 1.0, -1.0, 1e-45, -1e-45, 3.4e38, -3.4e38, np.inf, -np.inf, np.nan, -np.nan)


@pytest.mark.parametrize("sign", [None, 1.0, -1.0])
@pytest.mark.parametrize("order", ["C", "F"])
def test_span_is_that_of_numpy(sign: float | None, order: str) -> None:
    rng = np.random.default_rng(5)
    for k in range(500):
        image = rng.choice(EXTREME, (2, 3)) if k % 2 else rng.normal(rng.normal(0.0, 3.0), 1.0, (5, 4))
        image = np.array(image if sign is None else np.copysign(image, sign), dtype=np.float32, order=order)  # type: ignore[call-overload]
        with np.errstate(invalid="ignore"):
            assert np.array_equal(span(image), [image.min(), image.max()], equal_nan=True), image


SENSOR = replace(load_sensor("gelsight-mini"), width_px=8, height_px=6, depth_unit_mm=1.0)
HEIGHTS = np.random.default_rng(7).uniform(0.0, 1.0, SENSOR.frame_shape)
FEW = np.arange(HEIGHTS.size).reshape(HEIGHTS.shape) % 9 == 4


@pytest.mark.parametrize(
    ("frame", "unit_mm", "as_came"),
    [
        (HEIGHTS, 1.0, True),
        (HEIGHTS.astype(np.float32), 1.0, True),
        (np.rint(1000.0 * HEIGHTS).astype(np.uint16), 0.001, True),
        (HEIGHTS - 7.0, 1.0, True),
        # 5 um are the least relief, in the profile's own unit; without one it is mm
        (0.0051 * HEIGHTS / np.ptp(HEIGHTS), 1.0, True),
        (0.0049 * HEIGHTS / np.ptp(HEIGHTS), 1.0, False),
        (0.0049 * HEIGHTS / np.ptp(HEIGHTS), None, False),
        (0.0051e-3 * HEIGHTS / np.ptp(HEIGHTS), 1000.0, True),
        (0.0051e-3 * HEIGHTS / np.ptp(HEIGHTS), 1.0, False),
        # beyond single precision, or its steps
        (1e7 + HEIGHTS, 1.0, False),
        (1e-39 * HEIGHTS, 1.0, False),
        (1e39 * HEIGHTS, 1.0, False),
        (np.where(FEW, 1e39 * HEIGHTS, 0.0), 1.0, False),
        (4e9 * HEIGHTS, 1.0, False),
        (-4e9 * HEIGHTS, 1.0, False),
        (1e-10 * HEIGHTS, 1e9, False),
        # a few wild values are holes, and say nothing of the others
        (np.where(FEW, 1e39, HEIGHTS), 1.0, True),
        (np.where(FEW, np.nan, HEIGHTS), 1.0, True),
        (np.where(FEW, -np.inf, 1e7 + HEIGHTS), 1.0, False),
    ],
)
def test_heights_are_kept_and_those_that_were_scaled_are_not_called_mm(
    frame: npt.NDArray[np.generic], unit_mm: float | None, as_came: bool
) -> None:
    image, told = canonical_depths(frame, replace(SENSOR, depth_unit_mm=unit_mm))
    assert image.dtype == np.float32 and (image.shape, told) == (frame.shape, as_came)
    depths = frame.astype(np.float64)
    whole = np.abs(depths) < (1e38 if as_came else np.inf)
    given, found = depths[whole], image[whole].astype(np.float64)
    if as_came:
        assert found == pytest.approx(given, rel=1e-6)
    given, found = given - given.min(), found - found.min()
    assert found / found.max() == pytest.approx(given / given.max(), abs=1e-6)
    assert np.isfinite(image).all() and span(image)[1] > span(image)[0]


@pytest.mark.parametrize("value", [0.0, 3.0, -1e12, 1e-40])
def test_a_level_frame_is_zero(value: float) -> None:
    image, as_came = canonical_depths(np.full(SENSOR.frame_shape, value), SENSOR)
    assert (image == 0.0).all() and not as_came


@pytest.mark.parametrize(("mirror", "rotate90"), list(product((False, True), range(4))))
def test_a_mask_lies_on_the_raw_frame_as_on_the_canonical_one(mirror: bool, rotate90: int) -> None:
    mask = np.random.default_rng(rotate90).random((6, 8)) > 0.3
    sensor = replace(SENSOR, mask=mask, mirror=mirror, rotate90=rotate90)
    assert (sensor.canonical(shown_pixels(sensor).astype(np.float32)) == mask).all()
    assert shown_pixels(replace(sensor, mask=None)).all() and shown_pixels(sensor).shape == sensor.frame_shape


def test_dots_are_real_numbers() -> None:
    found = dot_numbers(np.ma.masked_array([1, 2], [False, True]))
    assert found.dtype == np.float64 and np.array_equal(found, [1.0, np.nan], equal_nan=True)
    for values in (["1"], [1j], [[1.0], [2.0, 3.0]], None):
        with pytest.raises(FrameError, match="dots are no array of numbers"):
            dot_numbers(values)  # type: ignore[arg-type]
