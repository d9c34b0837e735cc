"""Parts that a contact shows, and whether a file has them at the tape's places."""

from __future__ import annotations

import numpy as np

from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.sense.simulation.contact import contact_outline_mm
from tactape_fab.sense.simulation.dot_errors import DotErrors, dots_of
from tactape_fab.sense.simulation.parts import Parts
from tactape_fab.sense.simulation.scene import Scene
from tactape_fab.sense.simulation.view import make_view
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.shapes import inset_mm
from tactape_fab.texture.tape import Tape

SWALLOWED_MM = 1.0
"""Distance from the outline, mm, below which parts may have no top of their own if the contact is across the board's edge: at
0.84 to 1.0 mm half of them had none, farther away all had one."""
ERROR_FREE = DotErrors(
    sigma_px=0.0,
    rim_sigma_px=0.0,
    rim_pull_px=0.0,
    outliers=0.0,
    lost=0.0,
    least_imprint=0.5,
    false_dots=0.0,
    weight_sigma=0.0,
)
"""Errors of dots exactly at the parts inside the contact."""
_ALONE = 0.9
"""Radius around a part without others, as a fraction of the least distance of two that are displaced towards each other."""
IN_PLACE_MM = 0.01
"""Largest distance, mm, at which a part counts as in place: not much more than a decoder's error."""


def parts_shown(tape: Tape, pose: FloatArray, scene: Scene, sensor: SensorProfile) -> IntArray:
    """Mask of the parts that a contact shows: those inside its outline that the imprint of the board's edge does not hide.

    pose (3,): x mm, y mm (texture frame), theta deg.
    """
    dots = dots_of(tape, pose.tolist(), scene, 0, ERROR_FREE, sensor=sensor)
    view = make_view(tape, pose[:2], float(pose[2]), sensor, scene)
    # entirely on the board there is no edge that could hide parts
    outline, board = view.to_board(contact_outline_mm(scene, view.half_field_mm)), tape.board
    if inset_mm(outline, board.size_mm, board.corner_radius_mm).min() >= 0.0:
        return dots.part
    there = view.to_board(view.from_px(dots.xy_px))
    return dots.part[inset_mm(there, board.size_mm, board.corner_radius_mm) >= SWALLOWED_MM]


def in_place(tape: Tape, shown: IntArray, parts: Parts) -> bool:
    """Whether a file has exactly one part at the place of each visible part of the tape."""
    apart = tape.part_xy_mm()[shown][:, None] - parts.xy_mm[None]
    distance = np.hypot(apart[..., 0], apart[..., 1])
    # exactly one part within the radius, so that none is missing or duplicated, and that one in place
    alone_mm = min(tape.pitch_mm / 2, _ALONE * (tape.pitch_mm - 2 * tape.displacement_mm))
    return bool(((distance < alone_mm).sum(axis=1) == 1).all() and (distance.min(axis=1) <= IN_PLACE_MM).all())
