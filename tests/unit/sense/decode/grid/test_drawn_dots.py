"""Pull and push of neighbours: in adjustments of many frames as in the fit of one."""

from __future__ import annotations

import numpy as np

from tactape_fab.sense.decode.grid.beliefs import LEAST_APART_MM, MOST_APART_MM
from tactape_fab.sense.decode.grid.drawn_dots import drawn
from tactape_fab.sense.decode.grid.posterior import _drawn

FAR_AWAY = [(90.0, 0.0), (0.0, 90.0), (90.0, 90.0), (-90.0, 0.0)]
APART_MM = np.array([0.99, 1.01, 0.99, 1.01]) * np.repeat([LEAST_APART_MM, MOST_APART_MM], 2)


def test_adjustments_and_the_fit_of_one_frame_have_the_same_model() -> None:
    rng = np.random.default_rng(3)
    texture_mm = np.stack(np.meshgrid(np.arange(6) * 1.5, np.arange(5) * 1.5), axis=-1).reshape(-1, 2)
    texture_mm = texture_mm + rng.uniform(-0.25, 0.25, texture_mm.shape)
    # dots that are just too near to push each other, and just not, and likewise too far, away from all others
    pairs = [(at, (at[0], at[1] + apart)) for at, apart in zip(FAR_AWAY, APART_MM, strict=True)]
    texture_mm = np.concatenate([texture_mm, np.reshape(pairs, (-1, 2))])
    weights, theta = rng.uniform(0.2, 1.0, len(texture_mm)), 0.7
    weights[30:] = 0.6
    target, out = np.empty((2, len(texture_mm))), np.empty((2, 2, len(texture_mm)))
    middle = texture_mm.mean(axis=0).tolist()
    _drawn(texture_mm, texture_mm, weights, np.cos(theta), np.sin(theta), *middle, 0.0, 0.0, target, out)
    pushed, pulled = drawn(texture_mm, weights, theta, 0.0)
    assert np.allclose(pushed, out[0].T, rtol=0, atol=1e-12)
    assert np.allclose(pulled, out[1].T, rtol=0, atol=1e-12)
    assert np.abs(pushed[:30]).max() > 0.1 and np.abs(pulled).max() > 0.01
    # what moves maxima moves middles between edges as far as these do not count
    for by_edges, whole in zip((0.25, 1.0), (0.75, 0.0), strict=True):
        less = drawn(texture_mm, weights, theta, by_edges)
        assert np.allclose(less[0], whole * pushed) and np.allclose(less[1], whole * pulled)
    assert (np.abs(pushed[30::2]).max(axis=1) > 0.0).tolist() == [False, True, True, False]
