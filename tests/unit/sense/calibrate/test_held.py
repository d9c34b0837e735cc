"""Frames of one press that is held: told from presses anew by where they are, which dots they show, and how these err."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab.sense.calibrate.errors import Errors
from tactape_fab.sense.calibrate.held import ALIKE, SAME_MM, SAME_RAD, held_frames, held_remark
from tactape_fab.sense.calibrate.presses import Press
from tactape_fab.texture.frames import FloatArray

PARTS = np.array([(x, y) for y in range(4) for x in range(5)], dtype=float) * 1.5
ERRORS = np.random.default_rng(2).normal(0.0, 0.03, (20, 2))


def press(frame: int, dots: slice = slice(0, 20), tape: str = "t") -> Press:
    at, none = PARTS[dots], np.zeros((len(PARTS[dots]), 2))
    n = len(at)
    return Press(
        frame=frame,
        tape=tape,
        seen_px=at,
        rim_mm=none,
        texture_mm=at,
        weights=np.ones(n),
        interior=np.ones(n, dtype=bool),
        pushed=none,
        pulled=none,
        position_mm=(0.0, 0.0),
        theta_rad=0.0,
    )


def bundle(poses: list[tuple[float, float, float]], left: list[FloatArray], gel_mm: float = 0.05) -> Any:
    return SimpleNamespace(
        poses=np.array([(*pose, 0.0) for pose in poses]), residual_mm=tuple(left), errors=Errors(gel_mm=gel_mm)
    )


HERE = (10.0, 5.0, 3.13)


@pytest.mark.parametrize(
    ("other", "same"),
    [
        (HERE, True),
        ((10.0 + 0.99 * SAME_MM, 5.0, 3.13), True),
        ((10.0, 5.0 + 1.01 * SAME_MM, 3.13), False),
        ((10.0, 5.0, 3.13 - 0.99 * SAME_RAD), True),
        ((10.0, 5.0, 3.13 - 1.01 * SAME_RAD), False),
        ((10.0, 5.0, -3.13), True),  # 1.3 deg on, beyond the half turn
    ],
)
def test_frames_of_one_press_are_at_one_place_and_turn(other: tuple[float, float, float], same: bool) -> None:
    found = held_frames([press(3), press(7)], bundle([HERE, other], [ERRORS, ERRORS]))
    assert found == ({7: 3} if same else {})


@pytest.mark.parametrize(
    ("gel_mm", "share", "same"), [(0.05, 0.9, True), (0.05, 0.3, False), (0.05, -0.9, False), (0.0, 0.3, True), (0.0, -0.9, True)]
)
def test_a_gel_that_is_displaced_otherwise_was_pressed_anew(gel_mm: float, share: float, same: bool) -> None:
    """Errors of a share that is the same; where no displacement is seen they tell nothing."""
    own = np.random.default_rng(5).normal(0.0, 0.03, ERRORS.shape)
    own -= ERRORS * (own * ERRORS).sum() / (ERRORS**2).sum()
    own *= np.sqrt((ERRORS**2).sum() / (own**2).sum())
    other = share * ERRORS + np.sqrt(1.0 - share**2) * own
    assert (share > ALIKE) == (gel_mm > 0.0 and same)
    assert bool(held_frames([press(0), press(1)], bundle([HERE, HERE], [ERRORS, other], gel_mm))) == same


def test_a_sensor_that_rolls_to_other_dots_presses_anew() -> None:
    """Its pose on the tape is the same; parts are told by their places, whatever their order."""
    for first, same in ((5, True), (6, False)):
        dots = slice(first, first + 10)
        frames, left = [press(0, slice(0, 10)), press(1, dots)], [ERRORS[:10], ERRORS[dots]]
        assert bool(held_frames(frames, bundle([HERE, HERE], left))) == same


def test_presses_of_two_tapes_are_two() -> None:
    assert held_frames([press(0), press(1, tape="u")], bundle([HERE, HERE], [ERRORS, ERRORS])) == {}


def test_the_frame_with_most_dots_stays_and_before_it_one_with_a_pose_of_the_arm() -> None:
    frames = [press(0, slice(0, 12)), press(1), press(2), press(3, slice(0, 15))]
    of = bundle([HERE] * 4, [ERRORS[:12], ERRORS, ERRORS, ERRORS[:15]])
    assert held_frames(frames, of) == {0: 1, 2: 1, 3: 1}
    assert held_frames(frames, of, {0, 3}) == {0: 3, 1: 3, 2: 3}


def test_frames_that_show_a_press_again_are_counted() -> None:
    assert held_remark({}) == []
    assert held_remark({4: 2})[0].startswith("1 frame shows the press of another again (frame 4 that of frame 2)")
    assert held_remark({4: 2, 5: 9})[0].startswith("2 frames show the presses of others again (frame 4 that of frame 2)")
