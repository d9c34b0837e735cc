"""Which tape a scan shows, and where: by its AprilTag, or by its own code, then grown over the whole tape part by part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tactape_fab.base.errors import SpecError
from tactape_fab.base.libraries import library
from tactape_fab.sense.decode.localizer import Localizer
from tactape_fab.sense.inspect.blobs import Blobs
from tactape_fab.sense.inspect.scan_files import Picture
from tactape_fab.sense.inspect.warp import Warp, affine_warp, fitted
from tactape_fab.sense.objects.tag_view import tag_corners_mm
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.code import has_plane
from tactape_fab.texture.frames import BoolArray, FloatArray, texture_to_board
from tactape_fab.texture.tape import Tape

_TAG_SIDES_PX = (1600, 3200, 6400)
"""Longer side of the picture in which tags are looked for: detectors want some 40 px a tag, and are slow in large pictures."""
_CORNERS = [1, 0, 3, 2]
"""OpenCV's corners in the order of `tag_corners_mm`; its dictionary has each tag turned by 180 degrees."""
_SEED_MM = 12.0
_GROWTH = 1.5
_GATE_MM = 0.40
_NEAR_MM = 0.17
"""A blob this near to a part's nominal place agrees with it; the nearest wrong symbol is 0.35 mm away at Δ 0.25."""
LEAST_AGREEING = 0.6
_VIEW_PX_PER_MM = 16.0
_VIEW_MM = (20.0, 15.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenTag:
    """A tag in a scan: its number and corners (4, 2) in the order of `tag_corners_mm`, px."""

    number: int
    corners_px: FloatArray


def find_tags(picture: Picture) -> list[SeenTag]:
    """Tags of the family in a scan that is not mirrored."""
    cv2 = library("cv2", "inspecting a scan")
    longest = max(picture.shape[:2])
    for side in _TAG_SIDES_PX:
        shrink = min(1.0, side / longest)
        small = cv2.resize(picture, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
        for grey in (cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), np.ascontiguousarray(small[..., 0])):  # white ink on amber: blue
            dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
            settings = cv2.aruco.DetectorParameters()
            settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
            corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary, settings).detectMarkers(grey)
            if numbers is not None and len(numbers):
                found = zip(np.ravel(numbers).tolist(), corners, strict=True)
                return [
                    SeenTag(number=n, corners_px=(np.reshape(c, (4, 2))[_CORNERS].astype(np.float64) + 0.5) / shrink - 0.5)
                    for n, c in found
                ]
        if shrink == 1.0:
            break
    return []


def warp_of_tag(tape: Tape, tag: SeenTag) -> Warp:
    """The similarity that a tag says: near it, no more."""
    corners = tag_corners_mm(tape)
    flat = (corners - corners.mean(axis=0)) * (1.0, -1.0)
    seen = tag.corners_px - tag.corners_px.mean(axis=0)
    a, b = flat[:, 0] + 1j * flat[:, 1], seen[:, 0] + 1j * seen[:, 1]
    # least squares of b = turn a over complex numbers: scale and angle in one; board y is up and v down, hence the conjugate in
    # `flat`
    turn = complex(np.vdot(a, b) / np.vdot(a, a))
    linear = np.array([(turn.real, turn.imag), (turn.imag, -turn.real)])
    return affine_warp(linear, tag.corners_px.mean(axis=0) - linear @ corners.mean(axis=0), *_frame(tape))


def _frame(tape: Tape) -> tuple[FloatArray, float]:
    size = np.asarray(tape.board.size_mm)
    return size / 2, float(size.max() / 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadByCode:
    """The tape that a scan's parts encode, or the sector of one that is not among those given, and the warp near there."""

    tape: Tape | None
    sector: int | None
    near_mm: FloatArray
    warp: Warp | None


def read_code(blobs: Blobs, px_per_mm: float, tapes: Sequence[Tape], *, plane: bool = False) -> ReadByCode | None:
    """Decode the parts of a scan as if they were dots under a sensor; None where no contact-sized piece can be located.

    px_per_mm: Nearly.
    tapes: Of one pitch and displacement.
    plane: Search all sectors of the code instead, to say which tape it is.
    """
    if len(blobs.px) < 16:
        return None
    width, height = (round(_VIEW_PX_PER_MM * s) for s in _VIEW_MM)
    view = SensorProfile(
        name="scan", title="", width_px=width, height_px=height, px_per_mm=(_VIEW_PX_PER_MM,) * 2, scale_tolerance=0.05
    )
    first = tapes[0]
    if plane:
        if not has_plane(first.code):
            return None
        try:
            localizer = Localizer.from_code(first.code, first.pitch_mm, first.displacement_mm, view)
        except SpecError:
            return None
    else:
        localizer = Localizer(tapes, view)
    # the decoder's constants are for a sensor's resolution
    finer = _VIEW_PX_PER_MM / px_per_mm
    for middle in _middles(blobs.px, px_per_mm):
        dots = (blobs.px - middle) * finer + view.centre_px
        inside = (np.abs(dots - view.centre_px) < np.array([width, height]) / 2).all(axis=1)
        if inside.sum() < 16:
            continue
        fix = localizer.locate_dots(dots[inside])
        if not fix.located:
            continue
        if plane:
            return ReadByCode(tape=None, sector=fix.sector, near_mm=middle, warp=None)
        tape = next(t for t in tapes if t.name == fix.tape)
        c, s = np.cos(np.radians(fix.theta_deg or 0.0)), np.sin(np.radians(fix.theta_deg or 0.0))
        # T - S = R(theta) q / px_per_mm, solved for pixels q
        to_px = np.linalg.inv(np.array([(c, s), (-s, c)])) * (fix.px_per_mm or _VIEW_PX_PER_MM) / finer  # texture to scan
        linear = to_px @ np.diag([1.0, -1.0])
        board = texture_to_board(fix.position_mm or (0.0, 0.0), tape.board.texture_origin_mm)
        return ReadByCode(
            tape=tape, sector=tape.sector, near_mm=board, warp=affine_warp(linear, middle - linear @ board, *_frame(tape))
        )
    return None


def _middles(px: FloatArray, px_per_mm: float) -> FloatArray:
    """Places to decode at: in the middle of the parts, then around it."""
    low, high = np.percentile(px, (5, 95), axis=0)
    shares = np.array([(0.5, 0.5), (0.25, 0.5), (0.75, 0.5), (0.5, 0.2), (0.5, 0.8), (0.15, 0.2), (0.85, 0.8)])
    # percentiles, as a speck far from the tape would draw the middle away
    wanted = low + shares * (high - low)
    return np.asarray(px[cKDTree(px).query(wanted)[1]] + 0.3 * px_per_mm, dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grown:
    """The warp of a whole tape in one scan, the parts in the picture, and the share of them that are at their places."""

    warp: Warp
    inside: BoolArray
    agreeing: float


def grow(warp: Warp, near_mm: FloatArray, tape: Tape, blobs: Blobs, shape: tuple[int, int]) -> Grown | None:
    """From a warp that holds near one point to one of the whole tape; None if there are no parts to be seen there.

    The circle of parts that are fitted grows by half each time, so that every part is predicted well before it is matched.
    """
    sites = tape.part_xy_mm()
    away = np.hypot(*(sites - near_mm).T)
    tree = cKDTree(blobs.px) if len(blobs.px) else None
    gate = _GATE_MM * warp.px_per_mm
    reach = max(_SEED_MM, float(away.min()) + _SEED_MM / 2)
    if tree is None:
        return None
    while True:
        for _ in range(3):
            chosen = np.flatnonzero((away < reach) & within(warp.smooth(sites), shape))
            far, which = tree.query(warp.smooth(sites[chosen]))
            matched = far < gate
            if matched.sum() < 12:
                return None
            # higher powers only where there are parts enough, and far enough apart, to tell them
            order = 3 if reach > 60 and matched.sum() > 200 else 2 if reach > 25 and matched.sum() > 100 else 1
            warp, _ = fitted(warp.raised(order), sites[chosen][matched], blobs.px[which[matched]], gate_px=gate)
        if reach > away.max():
            break
        reach *= _GROWTH
    inside = within(warp.smooth(sites), shape)
    far, _ = tree.query(warp.smooth(sites[inside]))
    # a smaller displacement has wrong symbols nearer
    near = far < _NEAR_MM * min(1.0, tape.displacement_mm / 0.25) * warp.px_per_mm
    return Grown(warp=warp, inside=inside, agreeing=float(near.mean()) if len(near) else 0.0)


def within(px: FloatArray, shape: tuple[int, int], rim_px: float = 0.0) -> BoolArray:
    """Which pixels lie in a picture of (height, width), a rim left out."""
    size = np.array(shape[::-1])
    return np.asarray(((px >= rim_px) & (px <= size - 1 - rim_px)).all(axis=1))
