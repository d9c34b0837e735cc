"""Ways to open the coverlay, and the least legal pitch of each for any arrangement of symbols, in closed form.

All openings are one rotated box at different places. Two of them are at least L apart if and only if the shift between them
is outside a box of twice their size, offset outward by L with round corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from math import ceil

import numpy as np
import shapely

from tactape_fab.kit.outlines import opening_size_mm
from tactape_fab.kit.plan import TOLERANCE_MM
from tactape_fab.kit.profiles import COVERLAY_MODES, CoverlayMode, FabProfile, PartProfile
from tactape_fab.texture.board import Board
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray, snap_mm, texture_to_board
from tactape_fab.texture.shapes import inset_mm, outline_corner_points, rotate, rounded_rectangle

_REACH = 3
"""Largest grid distance of neighbours that can be the nearest ones."""
_LEAST_STEP_MM = 0.001
_SIGNS = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
"""Signs of the corners of a box about its centre."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mode:
    """A way to open the coverlay, or to anchor pads under it.

    ``least_pitch_mm`` is the least pitch at which it is legal at this displacement, for any symbols; 0 if it is legal at any
    pitch, None if at no pitch. ``reason`` describes what decides it.
    """

    name: str
    legal: bool
    least_pitch_mm: float | None
    reason: str


@cache
def _neighbour_shifts(directions: int) -> tuple[FloatArray, FloatArray]:
    """Grid steps to neighbours and differences of displacement, in all combinations; shapes (m, 2), board frame, unit lengths."""
    span = np.arange(-_REACH, _REACH + 1)
    # each step with both signs, since a box that is off the centre is not symmetric
    steps = np.array([(c, r) for c in span for r in span if c or r], dtype=np.float64)
    differences = (DIRECTIONS_XY[:directions, None] - DIRECTIONS_XY[:directions]).reshape(-1, 2)
    # 16 pairs of four symbols have 9 distinct differences
    apart = np.array(sorted(set(map(tuple, differences.tolist()))))
    found = (
        texture_to_board(np.repeat(steps, len(apart), axis=0), (0.0, 0.0)),
        texture_to_board(np.tile(apart, (len(steps), 1)), (0.0, 0.0)),
    )
    for shifts in found:
        shifts.setflags(write=False)
    return found


def worst_box_gap_mm(
    size_mm: tuple[float, float], rotation_deg: float, pitch_mm: float, displacement_mm: float, directions: int = 4
) -> float:
    """Least gap between equal turned boxes on neighbouring grid points over all pairs of symbols; negative in an overlap."""
    steps, apart = _neighbour_shifts(directions)
    # signed distance of a shift from the Minkowski difference of two equal boxes, which is a box of half sides `size`: with |x| -
    # length and |y| - width in the box's axes, outside it is the norm of the positive parts, inside the larger of the two
    beyond = np.abs(rotate(steps * pitch_mm + apart * displacement_mm, -rotation_deg)) - size_mm
    outside = np.hypot(*np.maximum(beyond, 0.0).T)
    return float((outside + np.minimum(beyond.max(axis=1), 0.0)).min())


@lru_cache(maxsize=4096)
def least_pitch_mm(
    half_mm: tuple[float, float],
    radius_mm: float,
    rotation_deg: float,
    displacement_mm: float,
    centre_mm: tuple[float, float] = (0.0, 0.0),
    *,
    directions: int = 4,
) -> float:
    """Least pitch, mm, above which no shift of a neighbour lies in a rounded box, over all pairs of symbols.

    half_mm: Half the sides of the box along and across the part, before the offset.
    radius_mm: Outward offset of the box, and the radius of its corners.
    centre_mm: Its centre, along and across the part.
    directions: Number of displacement directions.
    """
    steps, apart = _neighbour_shifts(directions)
    # At pitch t a neighbour's shift is e + t d: d the grid step along and across the part, e the difference of displacements in
    # mm, relative to the box's centre. The box is convex, so the line leaves it once: the largest t on its boundary is the pitch
    # from which on this shift is legal, and the maximum over all lines is the tape's
    d = rotate(steps, -rotation_deg)
    e = rotate(apart * displacement_mm, -rotation_deg) - centre_mm
    a, b = half_mm
    # a step along a side has d = 0 there and never meets that side (inf, or NaN on it); a line past a corner has a negative root
    with np.errstate(divide="ignore", invalid="ignore"):
        exits = _through_sides(d, e, a, b, radius_mm), _through_sides(d[:, ::-1], e[:, ::-1], b, a, radius_mm)
        return max(0.0, *exits, _through_corners(d, e, half_mm, radius_mm))


def _through_sides(d: FloatArray, e: FloatArray, a: float, b: float, radius_mm: float) -> float:
    """Largest pitch t at which a line e + t d meets one of the straight sides at +-(a + radius); -inf if none does."""
    # both sides for all lines; shape (2, m)
    t = (np.array([a + radius_mm, -a - radius_mm])[:, None] - e[:, 0]) / d[:, 0]
    met = np.isfinite(t) & (np.abs(e[:, 1] + t * d[:, 1]) <= b + 1e-12)
    return float(np.max(t, where=met, initial=-np.inf))


def _through_corners(d: FloatArray, e: FloatArray, half_mm: tuple[float, float], radius_mm: float) -> float:
    """Largest pitch t at which a line e + t d leaves the circle of a corner, -inf if it meets none."""
    # |f + t d|^2 = radius^2 with f = e - corner: dd t^2 + 2 df t + ff = 0,
    # whose larger root is where the line leaves the circle; shapes (4, m)
    f = e - (_SIGNS * half_mm)[:, None]
    x, y = d.T
    # sums of two terms are written out, as numpy's sum over so short an axis takes three times as long
    dd, df, ff = x * x + y * y, x * f[..., 0] + y * f[..., 1], f[..., 0] ** 2 + f[..., 1] ** 2 - radius_mm**2
    t = (-df + np.sqrt(df * df - dd * ff)) / dd
    # a root on a quarter of the circle inside the box is no larger than where the line leaves the box, which is convex
    return float(np.max(t, where=np.isfinite(t), initial=-np.inf))


def whole_um_up(pitch_mm: float) -> float:
    """A pitch rounded up to whole micrometres, so that the value in a message is itself legal."""
    # rounded before ceil: 1.3490000000000002 is 1.349, and must not become 1.350
    return round(ceil(round(pitch_mm / _LEAST_STEP_MM, 3)) * _LEAST_STEP_MM, 3)


def coverlay_modes(
    fab: FabProfile, part: PartProfile, *, pitch_mm: float, displacement_mm: float, rotation_deg: float, directions: int = 4
) -> tuple[Mode, ...]:
    """Every way to open the coverlay, checked for a fab, a part and a grid."""
    size_mm = opening_size_mm(part, fab)
    bridge, least_size = fab.limits["opening-bridge"], fab.limits["opening-size"]
    # the gap of the present grid is for the message, the least pitch for the remedy; both express the same limit
    gap_mm = worst_box_gap_mm(size_mm, rotation_deg, pitch_mm, displacement_mm, directions)
    pitch = whole_um_up(least_pitch_mm(size_mm, bridge.value_mm, rotation_deg, displacement_mm, directions=directions))
    wide = bridge.level != "block" or gap_mm >= bridge.value_mm - TOLERANCE_MM
    large = least_size.level != "block" or min(size_mm) >= least_size.value_mm - TOLERANCE_MM
    modes = []
    for name in COVERLAY_MODES:
        if name not in fab.coverlay_modes:
            reason = f"{fab.name} opens its coverlay otherwise: {', '.join(fab.coverlay_modes)}"
            modes.append(Mode(name=name, legal=False, least_pitch_mm=None, reason=reason))
        elif name == "gang":
            modes.append(Mode(name=name, legal=True, least_pitch_mm=0.0, reason="no coverlay holds a pad down"))
        elif not large:
            reason = f"openings of {min(size_mm):.3f} mm are below {least_size.value_mm:.3f} mm, whatever W"
            modes.append(Mode(name=name, legal=False, least_pitch_mm=None, reason=reason))
        else:
            reason = f"bridges down to {round(gap_mm, 3) + 0.0:.3f} mm, limit {bridge.value_mm:.3f} mm"
            modes.append(Mode(name=name, legal=wide, least_pitch_mm=pitch, reason=reason))
    return tuple(modes)


def first_legal(modes: Sequence[Mode], fab: FabProfile) -> CoverlayMode:
    """The fab's first legal way; its first one if none is legal."""
    legal = {mode.name for mode in modes if mode.legal}
    return next((name for name in fab.coverlay_modes if name in legal), fab.coverlay_modes[0])


def gang_window(board: Board, parts_xy_mm: FloatArray, opening_mm: FloatArray) -> FloatArray:
    """One opening for all parts: the bounding box of their openings, clipped by the outline, which is offset inward as far as
    the openings allow.

    parts_xy_mm (n, 2)
    opening_mm (k, 2): One part's opening about its centre.
    Returns (m, 2): A convex polygon, not closed, counter-clockwise, snapped to 1 nm.
    """
    low, high = parts_xy_mm.min(axis=0) + opening_mm.min(axis=0), parts_xy_mm.max(axis=0) + opening_mm.max(axis=0)
    window = shapely.box(*low, *high)
    # at a rounded corner the box would come too near to the outline, which is therefore offset inward by the least inset of all
    # vertices; an outline with corner radius R offset by f has the corner radius R - f
    vertices_mm = parts_xy_mm[:, None] + opening_mm
    frame_mm = max(float(inset_mm(vertices_mm, board.size_mm, board.corner_radius_mm).min()), 0.0)
    radius_mm = max(board.corner_radius_mm - frame_mm, 0.0)
    size_mm = (board.size_mm[0] - 2 * frame_mm, board.size_mm[1] - 2 * frame_mm)
    inner = rounded_rectangle(size_mm, radius_mm, outline_corner_points(radius_mm)) + np.array(board.size_mm) / 2
    # the intersection of two convex shapes is a convex polygon, whose orientation GEOS does not guarantee
    ring = shapely.Polygon(inner).intersection(window).exterior
    points = snap_mm(np.array(ring.coords)[:-1])
    return points if ring.is_ccw else points[::-1]
