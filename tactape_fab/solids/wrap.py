"""Map from board points to the finished solid: flat or on a cylinder, and turned over for a mould.

Working frame of a cylinder: a along the board axis that becomes arc length, b along the cylinder, z up; right-handed.
The board's middle line stays in place; the cylinder's axis is below it at z = -R.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tactape_fab.solids.forms import Cylinder, SolidForm
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.tape import Tape

_SWAP = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
"""From the working frame to the board frame, if y is wrapped: (a, b) = (y, -x)."""
_TURN_OVER = np.diag((-1.0, 1.0, -1.0))
"""180 degrees about board y, so that a mould's cavities face up."""


def world(form: SolidForm) -> FloatArray:
    """Rotation from the texture's frame to the file's; shape (3, 3), columns are the images of x, y, z."""
    return _TURN_OVER if form.negative else np.eye(3)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wrap:
    """A board wrapped on a cylinder.

    length_mm: Length of the board along a.
    b_mm: Ends of the board along the cylinder.
    turn (3, 3): Rotation from the working frame to the file's frame.
    from_board (2, 2): Rotation from board (x, y) to (a, b).
    part: The tape's element, with its rotation relative to a.
    """

    cylinder: Cylinder
    radius_mm: float
    length_mm: float
    b_mm: tuple[float, float]
    turn: FloatArray
    from_board: FloatArray
    part: TapePart

    @property
    def ends_rad(self) -> tuple[float, float]:
        """Angles of the board's two ends."""
        return -self.length_mm / 2 / self.radius_mm, self.length_mm / 2 / self.radius_mm

    def angle_rad(self, a_mm: FloatArray | float) -> FloatArray:
        """Angle about the cylinder's axis, from the board's middle line."""
        return (np.asarray(a_mm, dtype=np.float64) - self.length_mm / 2) / self.radius_mm

    def point(self, angle_rad: FloatArray | float, b_mm: FloatArray | float, radius_mm: FloatArray | float) -> FloatArray:
        """Points in the file's frame, given by angle, coordinate along and distance from the axis; shape (..., 3)."""
        angle, b, r = np.broadcast_arrays(angle_rad, b_mm, radius_mm)
        # the axis is at a = length / 2 and z = -R; angle 0 is straight up, so that r = R gives z = 0 on the middle line
        working = np.stack([self.length_mm / 2 + r * np.sin(angle), b, r * np.cos(angle) - self.radius_mm], axis=-1)
        return working @ self.turn.T

    def frames(self, angle_rad: FloatArray | float) -> FloatArray:
        """Tangent, axis direction and normal at angles, in the file's frame; shape (..., 3, 3), last axis x, y, z."""
        angle = np.asarray(angle_rad, dtype=np.float64)
        zero, one = np.zeros_like(angle), np.ones_like(angle)
        # d/d angle of (sin, 0, cos) is the tangent, so that tangent x axis = normal: right-handed, as board x, y, z
        tangent = np.stack([np.cos(angle), zero, -np.sin(angle)], axis=-1)
        normal = np.stack([np.sin(angle), zero, np.cos(angle)], axis=-1)
        return np.stack([tangent, np.stack([zero, one, zero], axis=-1), normal], axis=-2) @ self.turn.T


def wrap_of(tape: Tape, form: SolidForm, cylinder: Cylinder) -> Wrap:
    """The cylinder of a tape's solid."""
    width_mm, height_mm = tape.board.size_mm
    around_x = cylinder.around == "x"
    return Wrap(
        cylinder=cylinder,
        radius_mm=cylinder.radius_mm,
        length_mm=width_mm if around_x else height_mm,
        b_mm=(0.0, height_mm) if around_x else (-width_mm, 0.0),
        turn=world(form) @ (np.eye(3) if around_x else _SWAP),
        from_board=np.eye(2) if around_x else _SWAP[:2, :2].T,
        part=tape.part if around_x else replace(tape.part, rotation_deg=tape.part.rotation_deg - 90.0),
    )


def unwrapped(points_mm: FloatArray, tape: Tape, form: SolidForm) -> FloatArray:
    """Board coordinates and height above the surface of a solid's points; shape (n, 3), mm.

    On a cylinder x or y is the arc length at z = 0.
    """
    # row vectors times the rotation are its inverse applied to column vectors
    points = points_mm @ world(form)
    if form.cylinder is None:
        return points
    wrap = wrap_of(tape, form, form.cylinder)
    working = points_mm @ wrap.turn
    # (across, up) = r (sin, cos) of the angle, hence the order of arctan2's arguments
    across, up = working[:, 0] - wrap.length_mm / 2, working[:, 2] + wrap.radius_mm
    arc_mm = wrap.length_mm / 2 + np.arctan2(across, up) * wrap.radius_mm
    board = np.stack([arc_mm, working[:, 1]], axis=1) @ wrap.from_board
    return np.column_stack([board, np.hypot(across, up) - wrap.radius_mm])
