"""What decoding does fast, beside the plain computation that OpenCV or numpy makes of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from tactape_fab.sense import load_sensor
from tactape_fab.sense.decode.dots.detect import band_pass, detect
from tactape_fab.sense.decode.dots.filters import Image, _trough, averaged, local_tops, ordinary_value
from tactape_fab.sense.decode.dots.inputs import canonical_frame
from tactape_fab.sense.decode.grid.lattice import ANGLES, scan_power

DEPTH = np.random.default_rng(0).random((240, 320)).astype(np.float32)


def read_only(depth: Image) -> Image:
    return np.frombuffer(depth.tobytes(), dtype=np.float32).reshape(depth.shape)


def unaligned(depth: Image) -> Image:
    return np.frombuffer(bytearray(b"-" + depth.tobytes()), dtype=np.uint8)[1:].view(np.float32).reshape(depth.shape)


@pytest.mark.parametrize(
    "laid_out",
    [
        np.copy, read_only, unaligned, np.asfortranarray, lambda d: d.astype(np.float64), lambda d: d.astype(">f4"),
        lambda d: np.repeat(d, 2, axis=1)[:, ::2], lambda d: d[::-1].copy()[::-1], lambda d: d.tolist(),
    ],
)  # fmt: skip
def test_however_a_frame_lies_in_memory_it_becomes_the_same_image(laid_out: Callable[[Image], Any]) -> None:
    frame = laid_out(DEPTH)
    image = canonical_frame(frame, load_sensor("gelsight-mini"))
    assert np.array_equal(image, DEPTH)
    assert image.dtype == np.dtype("=f4") and image.flags.carray  # any other kind would be compiled for when it comes
    assert np.array_equal(frame, DEPTH)


@pytest.mark.parametrize("hole", [np.nan, np.inf, -np.inf])
def test_holes_are_filled_and_the_frame_stays_as_it_was(hole: float) -> None:
    frame = DEPTH.copy()
    frame[3:9, 20:40] = hole
    given = frame.copy()
    image = canonical_frame(frame, load_sensor("gelsight-mini"))
    known = np.isfinite(given)
    assert np.array_equal(frame, given, equal_nan=True)
    assert np.array_equal(image[known], DEPTH[known])
    assert (image[~known] > DEPTH.min()).all() and (image[~known] < DEPTH.max()).all()


def test_what_is_masked_is_a_hole() -> None:
    holes = DEPTH.copy()
    holes[3:9, 20:40] = np.nan
    wild = np.where(np.isnan(holes), 7.0, DEPTH)
    image = canonical_frame(np.ma.masked_array(wild, np.isnan(holes)), load_sensor("gelsight-mini"))
    assert np.array_equal(image, canonical_frame(holes, load_sensor("gelsight-mini")))
    whole = np.ma.masked_array((DEPTH * 1000).astype(np.int32), np.isnan(holes))
    holes = np.where(np.isnan(holes), np.nan, whole.data)
    assert np.array_equal(
        canonical_frame(whole, load_sensor("gelsight-mini")), canonical_frame(holes, load_sensor("gelsight-mini"))
    )


@pytest.mark.parametrize("scale", [1e308, 1e300, 1e-300, 1e37, 1e39, 1e-38, 1e-44])
def test_any_scale_of_double_precision_keeps_the_picture(scale: float) -> None:
    frame = DEPTH.astype(np.float64) * scale
    frame[5, 5] = np.nan
    image = canonical_frame(frame, load_sensor("gelsight-mini")).astype(np.float64)
    keep = np.isfinite(frame)
    assert np.corrcoef(image[keep], DEPTH[keep])[0, 1] > 1 - 1e-9


def test_a_value_too_large_for_single_precision_is_a_hole() -> None:
    frame = DEPTH.astype(np.float64)
    frame[5, 5] = 1e300
    image = canonical_frame(frame, load_sensor("gelsight-mini"))
    assert image[5, 5] == pytest.approx(np.mean([DEPTH[5, 4], DEPTH[5, 6], DEPTH[4, 5], DEPTH[6, 5]]), abs=1e-3)
    assert np.array_equal(image[6:], DEPTH[6:])


@pytest.mark.parametrize("count", [1, 5, 28, 61])
def test_the_power_scanned_is_that_of_plain_sums(count: int) -> None:
    rng = np.random.default_rng(count)
    xy, weights = rng.uniform(-150, 150, (count, 2)), rng.uniform(0.0, 1.0, count)
    angles = np.arange(ANGLES) * (np.pi / 2) / ANGLES
    axes = np.stack([np.cos(angles), np.sin(angles)]), np.stack([-np.sin(angles), np.cos(angles)])
    for pitch in (9.0, 24.0, 61.7):
        expected = sum(np.abs(weights @ np.exp(2j * np.pi / pitch * (xy @ axis))) ** 2 for axis in axes)
        power = np.empty(ANGLES)
        scan_power(xy, weights, pitch, np.empty((4, 2 * ANGLES)), power)
        assert power == pytest.approx(expected, abs=1e-9 * count**2)


@pytest.mark.parametrize("shape", [(1, 1), (2, 5), (3, 16), (40, 1), (17, 24)])
def test_tiny_images_have_an_answer(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(1).random(shape).astype(np.float32)
    for px_per_mm in (7.0, 16.0, 1000.0):
        dots = detect(image, px_per_mm)
        assert np.isfinite(dots.xy_px).all() and np.isfinite(dots.trust).all()


@pytest.mark.parametrize("factor", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("shape", [(240, 320), (61, 83)])
def test_blocks_are_averaged_as_by_area(factor: int, shape: tuple[int, int]) -> None:
    depth = np.random.default_rng(factor).random(shape).astype(np.float32) + np.float32(3.0)
    h, w = shape[0] // factor, shape[1] // factor
    whole = np.ascontiguousarray(depth[: h * factor, : w * factor])
    expected = cv2.resize(whole, (w, h), interpolation=cv2.INTER_AREA)
    found = averaged(depth, factor)
    assert found.dtype == np.float32 and found.shape == (h, w)
    assert np.abs(found + ordinary_value.py_func(depth, np.empty(9, dtype=np.float32)) - expected).max() < 2e-6
    assert np.abs(found).max() < 1.0


@pytest.mark.parametrize("px_per_mm", [1.0, 6.5, 7.25, 8.0, 16.0])
@pytest.mark.parametrize("shape", [(120, 160), (37, 53), (9, 30), (2, 3), (1, 8)])
def test_the_band_pass_is_a_gaussian_less_a_box(px_per_mm: float, shape: tuple[int, int]) -> None:
    depth = np.random.default_rng(3).normal(0.0, 1.0, shape).astype(np.float32)
    side = 2 * round(1.5625 * px_per_mm / 2) + 1
    expected = cv2.GaussianBlur(depth, (0, 0), 0.125 * px_per_mm) - cv2.blur(depth, (side, side))
    assert np.abs(band_pass(depth, px_per_mm) - expected).max() < 3e-6


@pytest.mark.parametrize("reach", [1, 2, 5])
@pytest.mark.parametrize("shape", [(120, 160), (37, 53), (3, 3), (2, 9)])
def test_tops_are_what_a_dilation_leaves_as_it_is(reach: int, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(reach)
    image = (np.rint(rng.normal(0.0, 4.0, shape)) / 4).astype(np.float32)  # with many equal pixels
    highest = cv2.dilate(image, np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8))
    inner = np.zeros(shape, dtype=np.bool_)
    inner[1:-1, 1:-1] = True
    expected: list[tuple[int, int]] = []
    for v, u in np.argwhere((image == highest) & (image > 0) & inner).tolist():
        if all(max(abs(v - y), abs(u - x)) > reach for y, x in expected):  # of equal ones the first
            expected.append((v, u))
    assert local_tops(image, np.zeros_like(image), reach).tolist() == [list(pixel) for pixel in expected]


def test_a_top_of_equal_pixels_is_one_top() -> None:
    image = np.zeros((20, 30), dtype=np.float32)
    image[8, 11:14] = image[9, 11] = 1.0
    assert local_tops(image, image, 2).tolist() == [[8, 11]]


@pytest.mark.parametrize("v", range(1, 5))
def test_a_trough_is_the_same_from_either_border(v: int) -> None:
    """A sample beyond a border is none, whichever border it is: turned by 180 degrees an image has the same troughs."""
    rng = np.random.default_rng(v)
    high = rng.uniform(-1.0, 0.0, (12, 20)).astype(np.float32)
    high[v, 8] = 1.0
    turned = np.ascontiguousarray(high[::-1, ::-1])
    # compiled it is called by other kernels alone
    of, found = getattr(_trough, "py_func", _trough), []
    for angle in rng.uniform(0.0, np.pi, 50).tolist():
        du, dv = np.cos(angle), np.sin(angle)
        # ahead and behind there are only holes, so the ridge has no length: all samples beside it count
        found.append(of(high, v, 8, du, dv, 100.0, 3.2))
        assert found[-1] == of(turned, 11 - v, 11, -du, -dv, 100.0, 3.2)
    assert max(found) > 0.0
