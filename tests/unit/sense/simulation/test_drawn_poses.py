"""Poses that are drawn: spread over the grid, over its edge, on a tape smaller than the contact; poses that are given."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, pi, radians, sin

import numpy as np
import pytest

from tactape_fab import Kit, Tape
from tactape_fab.base.errors import SpecError
from tactape_fab.sense import Scene, draw_poses, iterate_frames, simulate_frames


def corners_of(tape: Tape) -> tuple[float, float]:
    return (tape.columns - 1) * 1.5, (tape.rows - 1) * 1.5


def test_poses_keep_the_contact_on_the_grid_and_spread_over_it(tape: Tape) -> None:
    scene = Scene(contact_offset_mm=(1.0, 2.0), contact_turn_deg=20.0)
    poses = draw_poses(tape, 400, 2, scene=scene)
    width, height = corners_of(tape)
    turn = np.linspace(0, 2 * pi, 90)
    for x, y, theta in poses:
        a, b = 5.5 * np.cos(turn), 4.5 * np.sin(turn)
        u = 1.0 + cos(radians(20)) * a + sin(radians(20)) * b
        v = 2.0 - sin(radians(20)) * a + cos(radians(20)) * b
        tx = x + cos(radians(theta)) * u + sin(radians(theta)) * v
        ty = y - sin(radians(theta)) * u + cos(radians(theta)) * v
        assert tx.min() > -0.02
        assert tx.max() < width + 0.02
        assert ty.min() > -0.02
        assert ty.max() < height + 0.02
    counts, *_ = np.histogram2d(poses[:, 0], poses[:, 2], bins=(4, 4), range=((5, width - 5), (-180, 180)))
    assert counts.min() > 14
    assert ((poses[:, 2] > -180) & (poses[:, 2] <= 180)).all()
    assert (poses == draw_poses(tape, 500, 2, scene=scene)[:400]).all()
    assert not np.array_equal(poses, draw_poses(tape, 400, 3, scene=scene))


def test_edge_poses_hang_over_all_four_sides(tape: Tape) -> None:
    poses = draw_poses(tape, 200, edge=True)
    width, height = corners_of(tape)
    to_side = np.stack([poses[:, 1], width - poses[:, 0], height - poses[:, 1], poses[:, 0]], axis=-1)
    nearest = to_side.argmin(axis=1)
    assert (np.bincount(nearest, minlength=4) > 20).all()
    assert to_side.min(axis=1).max() < 0.9 * 5.5 + 1e-9
    assert to_side.min(axis=1).min() >= -0.2 * 5.5 - 1e-9
    inside = [(f.dots_imprint >= 0.5).sum() for f in iterate_frames(tape, 40, edge=True)]
    assert np.mean(inside) < 28


def test_a_tape_smaller_than_the_contact_is_still_touched(small_kit: Kit) -> None:
    tape = Tape.load(small_kit.path)
    poses = draw_poses(tape, 20, scene=Scene(contact_mm=(30.0, 30.0)))
    assert poses[:, 0] == pytest.approx((tape.columns - 1) * 0.75)
    assert poses[:, 1] == pytest.approx((tape.rows - 1) * 0.75, abs=1.0)
    assert all(len(f.dots_px) > 40 for f in iterate_frames(tape, 3, scene=Scene(contact_mm=(30.0, 30.0))))


def test_poses_that_are_given_are_not_spread_along_the_edge(tape: Tape) -> None:
    with pytest.raises(SpecError, match=r"^edge = True spreads poses, and poses are given; leave it out, or poses$"):
        simulate_frames(tape, 1, poses=[(20.0, 12.0, 0.0)], edge=True)


@pytest.mark.parametrize("draw", [draw_poses, simulate_frames])
def test_an_array_is_no_edge(tape: Tape, draw: Callable[..., object]) -> None:
    with pytest.raises(SpecError, match=r"^edge = array\(\[ True, False\]\) is neither true nor false; give one of them$"):
        draw(tape, 2, edge=np.array([True, False]))
