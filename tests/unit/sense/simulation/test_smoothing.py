"""Smoothing of images: the definition, and the same bits whether it is compiled or not."""

from __future__ import annotations

import subprocess
import sys
from typing import Literal

import numpy as np
import pytest
from scipy import ndimage

from tactape_fab.sense.simulation.compiled_smoothing import along_rows, down_columns
from tactape_fab.sense.simulation.smoothing import _BLOCK, FloatImage, _along_rows, _down_columns, smooth


def bell(taps: int) -> FloatImage:
    values = np.exp(-(np.linspace(-2.5, 2.5, taps) ** 2) / 2)
    return np.asarray(values / values.sum(), dtype=np.float32)


def image_of(shape: tuple[int, int]) -> FloatImage:
    return np.random.default_rng(3).normal(size=shape).astype(np.float32)


@pytest.mark.parametrize("beyond", ["edge", "constant"])
@pytest.mark.parametrize(("across", "down"), [(1, 7), (5, 3), (15, 15), (29, 9)])
@pytest.mark.parametrize("shape", [(1, 1), (_BLOCK + 5, 40), (2 * _BLOCK, 17)])
def test_it_is_a_correlation(shape: tuple[int, int], across: int, down: int, beyond: Literal["edge", "constant"]) -> None:
    image = image_of(shape)
    mode = "nearest" if beyond == "edge" else "constant"
    rows = ndimage.correlate1d(image.astype(np.float64), bell(across), axis=1, mode=mode)
    expected = ndimage.correlate1d(rows, bell(down), axis=0, mode=mode)
    assert smooth(image, bell(across), bell(down), beyond) == pytest.approx(expected, abs=2e-6)


@pytest.mark.parametrize("taps", [1, 3, 7, 15, 29])
def test_compiled_and_plain_stages_give_the_same_bits(taps: int) -> None:
    image = image_of((70, 50 + taps))
    plain, compiled = (np.empty((70, 51), dtype=np.float32) for _ in range(2))
    _along_rows(image, bell(taps), plain)
    along_rows(image, bell(taps), compiled)
    assert np.array_equal(plain, compiled)
    image = image_of((50 + taps, 70))
    plain, compiled = (np.empty((51, 70), dtype=np.float32) for _ in range(2))
    _down_columns(image, bell(taps), plain)
    down_columns(image, bell(taps), compiled)
    assert np.array_equal(plain, compiled)


def test_simulating_loads_no_compiler() -> None:
    code = (
        "import sys; from tactape_fab import Tape; from tactape_fab.sense import Scene, simulate; "
        "import tactape_fab.sense.simulation.smoothing; print('numba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True).stdout == "False\n"
