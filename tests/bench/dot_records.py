"""What the detector makes of the contacts that false accepts are counted on: measured once, then drawn from."""

from __future__ import annotations

from functools import cache
from typing import Literal

import numpy as np

from tactape_fab import Tape
from tactape_fab.sense import Scene, draw_poses, iterate_frames
from tactape_fab.sense.decode.dots.detect import detect
from tactape_fab.texture.frames import FloatArray
from tests.bench.localization_rows import SEED, registered_tape
from tests.bench.recorded import DotRecords, record_dots

PX_PER_MM = 16.0
RECORDED, RECORDED_AT_EDGES = 300, 800
"""Frames a contact; no other measurement looks at them."""
FARTHER_OUT = 2.0
"""Pitches by which contacts that should feel few lines are moved out from where others hang over an edge."""

Edge = Literal["none", "any", "out"]
"""Contacts wholly on the tape, over its edge, or with hardly more than the outermost lines."""


@cache
def recorded(scene: Scene, edge: Edge) -> DotRecords:
    """Records of a contact."""
    tape, count = registered_tape(), RECORDED if edge == "none" else RECORDED_AT_EDGES
    poses = contact_poses(tape, count, SEED + 900, scene, edge)
    frames = iterate_frames(tape, count, SEED + 900, scene=scene, poses=poses)
    found = ((frame, detect(frame.depth, PX_PER_MM)) for frame in frames)
    return record_dots(tape, ((frame, dots.xy_px, dots.weights) for frame, dots in found), scene)


def contact_poses(tape: Tape, count: int, seed: int, scene: Scene, edge: Edge) -> FloatArray:
    """Poses (count, 3) of contacts."""
    poses = draw_poses(tape, count, seed, scene=scene, edge=edge != "none")
    if edge != "out":
        return poses
    high = np.array([tape.columns - 1, tape.rows - 1]) * tape.pitch_mm
    inside = np.column_stack([poses[:, :2], high - poses[:, :2]])
    outwards = np.array([(-1.0, 0.0), (0.0, -1.0), (1.0, 0.0), (0.0, 1.0)])[inside.argmin(axis=1)]
    shift_mm = FARTHER_OUT * tape.pitch_mm * np.random.default_rng(seed).random((count, 1))
    return np.column_stack([poses[:, :2] + outwards * shift_mm, poses[:, 2]])
