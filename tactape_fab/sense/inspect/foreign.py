"""Objects on the film between the parts."""

from __future__ import annotations

import numpy as np

from tactape_fab.base.libraries import library
from tactape_fab.sense.inspect.blobs import film_difference
from tactape_fab.sense.inspect.colours import Palette
from tactape_fab.sense.inspect.scan_files import Picture
from tactape_fab.sense.inspect.warp import Warp
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape

LEAST_MM = 0.12
"""Least diameter of an object that is listed; dust is smaller."""
_PX_PER_MM = 20.0
_LEAST_LEVEL = 45.0
"""Difference from the film, of 255; copper under the coverlay makes 35."""
_SHARE = 0.3
_FIELD_MM = 0.5
_SHADOW_MM = 0.12
"""Width that a body and its shadow cover around it."""
_LAND = (1.30, 1.35)
"""Half the size of the box that a part with its lands and opening may cover, over the body's length and width."""


def find_foreign(
    picture: Picture, warp: Warp, tape: Tape, palette: Palette, placed_mm: FloatArray, turn_deg: FloatArray
) -> FloatArray:
    """Objects in the field between lands that differ from the film: x, y, diameter of the same area (board frame, mm); (k, 3).

    `placed_mm` (n, 2) and `turn_deg` (n,) are the measured places and turns of parts, which may be beside their lands.
    Holes and everything outside the field, such as the legend, do not count. What lies on a part shows in the part's own fit.
    """
    cv2 = library("cv2", "inspecting a scan")
    differs, shrink = film_difference(picture, warp.px_per_mm, _PX_PER_MM)
    # in proportion to the contrast of the scan, beyond the least that copper shows
    level = max(_LEAST_LEVEL, _SHARE * float(np.abs(palette.body - palette.film).max()))
    mask = (differs > level).astype(np.uint8) * _field(warp, tape, differs.shape, shrink, placed_mm, turn_deg)
    per_mm = warp.px_per_mm * shrink
    count, _, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8)
    area_mm2 = stats[1:count, cv2.CC_STAT_AREA] / per_mm**2
    diameter = np.sqrt(4 * area_mm2 / np.pi)
    big = diameter >= LEAST_MM
    if not big.any():
        return np.zeros((0, 3))
    at = warp.to_board((centres[1:count][big] + 0.5) / shrink - 0.5)
    return np.column_stack([at, diameter[big]])


def _field(warp: Warp, tape: Tape, shape: tuple[int, int], shrink: float, placed_mm: FloatArray, turn_deg: FloatArray) -> Picture:
    """1 where film should be bare: the field less parts with their lands, and holes."""
    cv2 = library("cv2", "inspecting a scan")
    sites = tape.part_xy_mm()
    low, high = sites.min(axis=0) - _FIELD_MM, sites.max(axis=0) + _FIELD_MM
    corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])])

    def px(board_mm: FloatArray) -> FloatArray:
        flat = warp.to_px(board_mm.reshape(-1, 2))
        return np.asarray(np.rint(((flat + 0.5) * shrink - 0.5) * 16).astype(np.int32).reshape(*board_mm.shape[:-1], 2))

    # polygons in sixteenths of a pixel (shift = 4)
    out = np.zeros(shape, np.uint8)
    cv2.fillPoly(out, [px(corners)], 1, cv2.LINE_8, 4)
    body = np.array(tape.part.body_mm[:2])
    lands = _boxes(sites, np.full(len(sites), tape.part.rotation_deg), np.array(_LAND) * body)
    bodies = _boxes(placed_mm, tape.part.rotation_deg + turn_deg, body / 2 + _SHADOW_MM)
    for polygon in px(np.concatenate([lands, bodies])):
        cv2.fillConvexPoly(out, polygon, 0, cv2.LINE_8, 4)
    for x, y, d in tape.board.holes:
        angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=1) * (d / 2 + 0.2) + (x, y)
        cv2.fillPoly(out, [px(circle)], 0, cv2.LINE_8, 4)
    return out


def _boxes(centre_mm: FloatArray, turn_deg: FloatArray, half_mm: FloatArray) -> FloatArray:
    """Corners of turned rectangles; (n, 4, 2)."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half_mm
    axes = np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2)
    return np.asarray(corners @ axes + centre_mm[:, None])
