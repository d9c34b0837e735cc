"""Pull and push of neighbours: in adjustments of many frames as in the fit of one."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.sense.decode.grid.drawn_dots import drawn
from tactape_fab.sense.decode.grid.posterior import PUSH_LEAN, _drawn, lean_of
from tests.tapes import tape_at


@pytest.mark.parametrize("lean", [(0.0, 0.0), (0.25, 0.0), (-0.1, 0.2)])
def test_adjustments_and_the_fit_of_one_frame_have_the_same_model(lean: tuple[float, float]) -> None:
    rng = np.random.default_rng(5)
    nodes = np.stack(np.meshgrid(np.arange(6) * 1.5, np.arange(5) * 1.5), axis=-1).reshape(-1, 2)
    texture_mm = nodes + 0.25 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])[rng.integers(4, size=len(nodes))]
    weights, theta = rng.uniform(0.4, 1.0, len(nodes)), 0.7
    middle = texture_mm.mean(axis=0)
    c, s = np.cos(theta), np.sin(theta)
    # of the kernel's caller: the parts' direction as the image shows it
    lean_u = lean[0] * np.cos(2 * theta) - lean[1] * np.sin(2 * theta)
    lean_v = lean[0] * np.sin(2 * theta) + lean[1] * np.cos(2 * theta)
    target, out = np.empty((2, len(nodes))), np.empty((2, 2, len(nodes)))
    _drawn(nodes, texture_mm, weights, c, s, *middle, lean_u, lean_v, target, out)
    pushed, pulled = drawn(texture_mm, weights, theta, lean)
    assert np.allclose(pushed, out[0].T, rtol=0, atol=1e-12)
    assert np.allclose(pulled, out[1].T, rtol=0, atol=1e-12)
    assert np.abs(pushed).max() > 0.1 and np.abs(pulled).max() > 0.01


def test_a_long_part_pushes_farther_along_itself() -> None:
    """Two 0201 beside each other along their length, and the same pair across it, by what the profile of the part says."""
    part = tape_at(7, (5, 5)).part
    lean = lean_of(part)
    assert np.isclose(np.hypot(*lean), PUSH_LEAN * (part.body_mm[0] - part.body_mm[1]) / (part.body_mm[0] + part.body_mm[1]))
    angle = np.arctan2(lean[1], lean[0]) / 2  # of the parts' axis, texture frame
    along, across = (np.array([np.cos(a), np.sin(a)]) for a in (angle, angle + np.pi / 2))
    both = [np.abs(drawn(np.array([-d, d]) / 2, np.ones(2), 0.3, lean)[0]).max() for d in (along, across)]
    plain = [np.abs(drawn(np.array([-d, d]) / 2, np.ones(2), 0.3, (0.0, 0.0))[0]).max() for d in (along, across)]
    ratio = np.array(both) / plain
    assert np.allclose(ratio, [1 + np.hypot(*lean), 1 - np.hypot(*lean)])
