"""Located frames -> contacts: position and part of each dot, and the shifts by its neighbours and by the rim."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np
import numpy.typing as npt

from tactape_fab.sense.decode.dots.frame_dots import contact_dots
from tactape_fab.sense.decode.grid.beliefs import rim_mm2
from tactape_fab.sense.decode.grid.drawn_dots import drawn
from tactape_fab.sense.decode.grid.pose import LEAST_WEIGHT
from tactape_fab.sense.decode.result import Localization
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray, board_to_texture
from tactape_fab.texture.tape import Tape

LEAST_DOTS = 6
"""Fewest dots of a contact: fewer tell hardly more than its own pose."""
LEAST_NEIGHBOURS, MOST_UNSEEN = 5, 1
"""A part is expected if at least the first number of neighbouring grid points show a dot, and at most the second do not: at a
contact's rim three or more do not."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenDots:
    """Dots with their parts.

    part (n,): Index of each dot's part in designator order.
    seen_px (n, 2): Where the dots are seen, canonical image, those at the rim put back, or middles of their bodies.
    own (n,): Variance of a dot over that of a whole one: 1 / sqrt(weight).
    rim_mm2 (n,): Variance that the contact's rim adds.
    pushed, pulled (n, 2): Shift of each by neighbours and by the rim, right and down, for a push and a pull of 1; see
        `decode.grid.posterior`.
    """

    part: IntArray
    seen_px: FloatArray
    own: FloatArray
    rim_mm2: FloatArray
    pushed: FloatArray
    pulled: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contact(SeenDots):
    """A located frame of a tape, with its dots.

    frame: Its place among the frames.
    start (3,): x mm, y mm, theta rad of the decoder's answer.
    expected (k,): Parts amid the dots where none is seen.
    """

    frame: int
    start: FloatArray
    expected: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ground:
    """Index of the part on each grid point of a tape (-1: none), and the design's positions, texture frame, mm."""

    tape: Tape
    part_at: IntArray
    nominal_mm: FloatArray


def ground_of(tape: Tape) -> Ground:
    """The design of a tape, without measured positions."""
    part_at = np.full((tape.rows, tape.columns), -1)
    part_at[tape.placed] = np.arange(tape.part_count)
    return Ground(tape=tape, part_at=part_at, nominal_mm=board_to_texture(tape.part_xy_mm(), tape.board.texture_origin_mm))


def contact_of(
    frame: int, depth: npt.ArrayLike, fix: Localization, ground: Ground, sensor: SensorProfile, built_mm: FloatArray
) -> Contact | None:
    """The contact of a located frame's dots; None where they are too few.

    built_mm (n, 2): Places of parts that the answer rests on, texture frame.
    """
    assert fix.dots is not None and fix.position_mm is not None and fix.theta_deg is not None
    tape = ground.tape
    camera, scale = sensor.camera, sensor.px_per_mm[0]
    # these are in the image of a perfect camera with square pixels; afterwards dots go back to what this camera sees
    dots = contact_dots(depth, sensor, tape)
    back = dots.xy_px / scale + camera.from_px(sensor.centre_px)
    weights = np.minimum(dots.weights * dots.trust, 1.0)
    cells = fix.dots.cell
    # dots that are detected here must be those of the answer, in its order
    if len(cells) != len(weights):
        return None
    used = (cells[:, 0] >= 0) & (weights > LEAST_WEIGHT) & fix.dots.inlier
    part = ground.part_at[cells[used, 1], cells[used, 0]]
    # two dots on one part: the answer is doubtful, and either would pull the part
    if len(part) < LEAST_DOTS or len(np.unique(part)) < len(part):
        return None
    theta = radians(fix.theta_deg)
    pushed, pulled = drawn(built_mm[part], weights[used], theta, dots.by_edges)
    return Contact(
        frame=frame,
        part=part,
        seen_px=camera.to_px(back[used]),
        own=1.0 / np.sqrt(weights[used]),
        rim_mm2=rim_mm2(weights[used], dots.by_edges),
        pushed=pushed,
        pulled=pulled,
        start=np.array([*fix.position_mm, theta]),
        expected=_unseen(cells, ground),
    )


def _unseen(cells: IntArray, ground: Ground) -> IntArray:
    """Parts without a dot amid neighbours that have one."""
    # padded by one grid point on each side, so that parts at the tape's edge have eight neighbours as well
    seen = np.zeros((ground.part_at.shape[0] + 2, ground.part_at.shape[1] + 2), dtype=bool)
    on: BoolArray = cells[:, 0] >= 0
    seen[cells[on, 1] + 1, cells[on, 0] + 1] = True
    rows, columns = ground.part_at.shape
    there = np.pad(ground.part_at >= 0, 1)
    missed, shown = np.zeros((rows, columns), dtype=np.int64), np.zeros((rows, columns), dtype=np.int64)
    for dy in range(3):
        for dx in range(3):
            if (dx, dy) != (1, 1):
                window = np.s_[dy : dy + rows, dx : dx + columns]
                shown += seen[window]
                # grid points without a part cannot be missed
                missed += there[window] & ~seen[window]
    unseen = (missed <= MOST_UNSEEN) & (shown >= LEAST_NEIGHBOURS) & ~seen[1:-1, 1:-1] & (ground.part_at >= 0)
    return ground.part_at[unseen]
