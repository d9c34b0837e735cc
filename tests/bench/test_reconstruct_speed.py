"""Time of turning an image into a depth map, beside the same written down in numpy and scipy, in the same run.

TACTAPE_BENCH_ABSOLUTE=1 asserts milliseconds as well. Times are of the processor, all threads together; numpy's products are so
small that it takes one thread for them, which is faster here than several that wait for each other.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from time import process_time

import numpy as np
from pytest_benchmark.fixture import BenchmarkFixture
from scipy import fft

from tactape_fab.sense import make_reconstruction
from tactape_fab.sense.raw.reconstruct import make_network
from tests.bench.measure import run, show
from tests.raw_images import MOST_AT_ONCE, Image, Layers, angles, features, random_layers

SIZE = (240, 320)
SIZES_OF_GELSIGHT_MINI = (5, 32, 32, 32, 2)
MOST_MS = 8.0
MOST_RATIO = 0.6
ROUNDS = 40


def plainly(image: Image, untouched: np.ndarray, layers: Layers) -> np.ndarray:
    """The same as `Reconstruction.depth`, at 16 px/mm."""
    h, w = image.shape[:2]
    rows = features(image).reshape(-1, MOST_AT_ONCE, 5)
    slopes = untouched - np.tan(angles(rows, layers)).reshape(-1, 2).T.reshape(2, h, w)
    u_steps, v_steps = (slopes[0, :, 1:] + slopes[0, :, :-1]) / 32.0, (slopes[1, 1:] + slopes[1, :-1]) / 32.0
    divergence = np.diff(u_steps, axis=1, prepend=0.0, append=0.0) + np.diff(v_steps, axis=0, prepend=0.0, append=0.0)
    spectrum = fft.dctn(divergence, norm="ortho")
    v, u = np.ogrid[:h, :w]
    eigenvalue = 4.0 * np.sin(np.pi * v / (2 * h)) ** 2 + 4.0 * np.sin(np.pi * u / (2 * w)) ** 2
    eigenvalue[0, 0] = np.inf
    return np.asarray(fft.idctn(spectrum / -eigenvalue, norm="ortho"))


def least_ms(function: Callable[[], object], rounds: int) -> float:
    times = []
    for _ in range(rounds):
        start = process_time()
        function()
        times.append(process_time() - start)
    return 1e3 * min(times)


def test_an_image_becomes_a_depth_map_in_time(benchmark: BenchmarkFixture) -> None:
    layers, rng = random_layers(SIZES_OF_GELSIGHT_MINI), np.random.default_rng(1)
    background, image = (rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8) for _ in range(2))
    reconstruction = make_reconstruction(background, make_network(layers), (16.0, 16.0))
    np.testing.assert_allclose(reconstruction.depth(image), plainly(image, reconstruction.untouched, layers), atol=1e-4)
    run(benchmark, lambda: reconstruction.depth(image), rounds=3)
    ours = least_ms(lambda: reconstruction.depth(image), ROUNDS)
    plain = least_ms(lambda: plainly(image, reconstruction.untouched, layers), ROUNDS // 4)
    show("reconstruct 320x240", ours, "ms", f"<= {MOST_MS:g}")
    show("the same in numpy and scipy", plain, "ms")
    show("ratio", ours / plain, "", f"<= {MOST_RATIO:g}")
    assert ours <= MOST_RATIO * plain
    if os.environ.get("TACTAPE_BENCH_ABSOLUTE") == "1":
        assert ours <= MOST_MS
