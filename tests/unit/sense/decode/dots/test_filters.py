"""Tops of an image refined by the quadric about each, and ridges beside troughs, on surfaces made by hand."""

from __future__ import annotations

from math import cos, radians, sin
from typing import NamedTuple

import numpy as np
import pytest

from tactape_fab.sense.decode.dots.filters import STEP_TROUGH, Image, _centres, ordinary_value
from tactape_fab.texture.frames import FloatArray

ALONG, ACROSS = 6.0, 4.0


class Tops(NamedTuple):
    """Of `_centres`; the number of deep troughs last."""

    xy: FloatArray
    height: FloatArray
    elongation: FloatArray
    trough: FloatArray
    deep: int


def centres(high: FloatArray, at: tuple[int, int], coarse: int = 1, along: float = ALONG, across: float = ACROSS) -> Tops:
    """The top near a pixel (v, u)."""
    found = Tops(np.empty((1, 2)), np.empty(1), np.empty((1, 2)), np.empty(1), 0)
    image: Image = np.ascontiguousarray(high, dtype=np.float32)
    pixels = np.array([at], dtype=np.int64)
    return found._replace(deep=int(_centres(image, pixels, coarse, along, across, *found[:4])))


def quadric(top: tuple[float, float], height: float, hxx: float, hyy: float, hxy: float) -> FloatArray:
    """An image of 30 x 40 px whose values are a quadric about its top (u, v)."""
    v, u = np.mgrid[:30, :40]
    u, v = u - top[0], v - top[1]
    return np.asarray(height + (hxx * u * u + hyy * v * v) / 2 + hxy * u * v)


@pytest.mark.parametrize("coarse", [1, 2, 3])
@pytest.mark.parametrize(("du", "dv"), [(0.0, 0.0), (0.3, -0.4), (-0.45, 0.2)])
@pytest.mark.parametrize(("hxx", "hyy", "hxy"), [(-0.2, -0.2, 0.0), (-0.3, -0.2, 0.08), (-0.2, -0.35, -0.1)])
def test_a_quadric_s_top_is_found_exactly(du: float, dv: float, hxx: float, hyy: float, hxy: float, coarse: int) -> None:
    """A block of so many px has its middle half of one less beyond its first; the elongation is over the sum of curvatures."""
    found = centres(quadric((12 + du, 9 + dv), 5.0, hxx, hyy, hxy), (9, 12), coarse)
    middle = (coarse - 1) / 2
    assert found.xy[0] == pytest.approx([(12 + du) * coarse + middle, (9 + dv) * coarse + middle], abs=1e-4)
    assert found.height[0] == pytest.approx(5.0, abs=1e-5)
    assert found.elongation[0] == pytest.approx([(hxx - hyy) / (hxx + hyy), 2 * hxy / (hxx + hyy)], abs=1e-4)
    assert (found.trough[0], found.deep) == (0.0, 0)


@pytest.mark.parametrize(("hxx", "hyy", "hxy", "du"), [(-0.2, 0.1, 0.0, 0.2), (-0.2, -0.2, 0.3, 0.2), (-0.2, -0.2, 0.0, 1.2)])
def test_where_the_quadric_has_no_top_nearby_the_pixel_is_its_own(hxx: float, hyy: float, hxy: float, du: float) -> None:
    """On a saddle, which has no elongation either, and where a round top is more than a pixel off."""
    high = quadric((12 + du, 9.0), 5.0, hxx, hyy, hxy)
    found = centres(high, (9, 12))
    assert found.xy[0].tolist() == [12.0, 9.0] and found.height[0] == pytest.approx(high[9, 12])
    assert found.elongation[0] == pytest.approx([0.0, 0.0], abs=1e-5)


def ridge(angle_deg: float, trough: float, length: float = 99.0) -> FloatArray:
    """A ridge of the height 1 through (20, 15), so long to either side, along cos, sin of an angle; a trough 4 px beside it."""
    v, u = np.mgrid[:30, :40]
    u, v = u - 20.0, v - 15.0
    across, along = (
        v * cos(radians(angle_deg)) - u * sin(radians(angle_deg)),
        u * cos(radians(angle_deg)) + v * sin(radians(angle_deg)),
    )
    shape = (1 + trough) * np.exp(-(across**2) / (2 * 1.2**2)) - trough
    return np.asarray(np.where(np.abs(along) < length, shape, 0.0))


@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 45.0, 70.0, 90.0, 110.0, 135.0, 160.0])
def test_a_ridge_that_goes_on_has_the_trough_beside_it(angle_deg: float) -> None:
    """Whichever way it runs; a shallow one is none of a step, and a ridge that ends on either side none of it at all."""
    deep, shallow = (centres(ridge(angle_deg, trough), (15, 20)) for trough in (0.8, 0.4))
    assert deep.trough[0] == pytest.approx(0.8, abs=0.03) and deep.deep == 1 and STEP_TROUGH < 0.7
    assert shallow.trough[0] == pytest.approx(0.4, abs=0.03) and shallow.deep == 0
    short = centres(ridge(angle_deg, 0.8, length=4.0), (15, 20))
    assert (short.trough[0], short.deep) == (0.0, 0)
    c, s = cos(radians(angle_deg)), sin(radians(angle_deg))
    for end in (1.0, -1.0):
        one_sided = ridge(angle_deg, 0.8)
        v, u = np.mgrid[:30, :40]
        one_sided[end * ((u - 20) * c + (v - 15) * s) > 4.0] = 0.0
        assert centres(one_sided, (15, 20)).trough[0] == 0.0


def test_a_trough_on_one_side_counts() -> None:
    """As a step has it: the deeper of both."""
    for side in (1.0, -1.0):
        high = ridge(0.0, 0.8)
        v, _ = np.mgrid[:30, :40]
        high[side * (v - 15) > 2] = -0.2
        assert centres(high, (15, 20)).trough[0] == pytest.approx(0.8, abs=0.03)


@pytest.mark.parametrize("shape", [(40, 80), (37, 53), (4, 4)])
def test_the_level_of_an_image_is_the_median_of_nine_pixels(shape: tuple[int, int]) -> None:
    """At quarters of its sides; all others may be anything."""
    image = np.full(shape, 99.0, dtype=np.float32)
    rows, columns = ([k * side // 4 for k in (1, 2, 3)] for side in shape)
    image[np.ix_(rows, columns)] = np.random.default_rng(1).permutation(9).reshape(3, 3)
    assert getattr(ordinary_value, "py_func", ordinary_value)(image, np.empty(9, dtype=np.float32)) == 4.0
