"""A tag's pose from all its edges: a detector's pose from four corners, refined on the picture itself.

Corners of a small tag are found to some tenths of a pixel, and blur moves them inwards; far from the tag that error grows.
Here the printed tag is fitted to every pixel of it, with blur, brightness and contrast of the picture, which may fall across it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, hypot, sqrt

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import FrameError
from tactape_fab.base.libraries import library
from tactape_fab.sense.objects.tag_view import camera_arrays, camera_to_texture, rays_of, tag_of, tag_side_mm
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tag import CODE_CELLS, SIDE_CELLS, tag_cells
from tactape_fab.texture.tape import Tape

_PX_PER_CELL = 16
_PAD_CELLS = 2
_RING_SHARE = 0.5
"""Fraction of the light ring that is used: beyond it may be film, or the label."""
_BLUR_PX = 0.7
_MOST_STEPS, _LONGEST_STEP = 40, 100.0
"""Steps, and the longest: a tenth of a radian, a hundredth of the distance. With a fifth of it and half as many steps 5 of 20
tags of 1.2 to 2.5 px per cell were still 0.3 to 0.6 cells off."""
_SMOOTHING_CELLS = 0.12
"""First smoothing of a large tag's image (standard deviation): unsmoothed edges have no gradient until they nearly meet."""
_LEAST_PIXELS, _MOST_PIXELS = 60, 1_000_000
_MOST_COLUMNS = 30_000
"""OpenCV's remap counts columns in 16 bits."""
_ENOUGH = 0.02
"""Iteration ends when the pose moves by less than this fraction of a milliradian and of 1e-4 of the distance."""
_COARSE_CELLS = 0.4
"""Smoothing of the first look from a start that does not lead to the tag: edges half a cell apart still meet."""
_DISTANCES = tuple(1.06**k for k in range(-5, 6))
"""Distances that are tried then, 0.75 to 1.34 of the start's: a side that is that of the light ring, 10 cells for 8, is 1.25."""
_MOST_MOVED_CELLS = 0.5
"""Farthest that a corner moves by the fit without another fit, to the pixels of the tag where it is then."""
_LEAST_FIT = 0.85
"""Least correlation: poses that came to rest beside the tag had 0.82 and less, right ones 0.86 in noise of 2 levels at a contrast
of 15."""
_LEAST_AGREEMENT = 0.985
"""Least correlation without noise. Right poses had 0.992 and more in noise, low contrast, uneven light, JPEG's and a camera's own
sharpening, 0.986 with a blur of half a cell; with a tenth of one side covered, 7 to 20 degrees off, they had 0.91 to 0.994. Of
25 pictures with all of these faults at once 3 right poses are refused, at tilts of 40 to 58 degrees."""
_MOST_OFF = 0.2
"""Largest mean difference of a spot of two by two cells from the printed tag, as a fraction of the contrast: 0.11 at right poses
in noise of a tenth of it, 0.21 and more at 58 of 59 wrong ones of partly covered tags."""
_MOST_BLEED = 0.3
"""Largest growth or shrinkage of light areas, in cells."""

GrayImage = npt.NDArray[np.uint8]
_F32 = npt.NDArray[np.float32]
_Start = tuple[FloatArray, FloatArray]
"""Initial rotation and translation of a tag."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TagPose:
    """Pose of a tag in the camera's frame.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        Rotation of the tag in the camera's frame.
    translation_mm : ndarray, shape (3,)
        Position of its centre there, mm.
    fit : float
        Correlation of the picture with the printed tag at this pose, in the best even or uneven light; 1 is perfect.
    blur_px : float
        Standard deviation of the picture's blur.
    """

    rotation: FloatArray
    translation_mm: FloatArray
    fit: float
    blur_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """Pixels of the tag: their rays (n, 3) and grey levels (n,); pixels per cell; standard deviation of their smoothing.

    ``light`` (n, 3) is 1 and each pixel's place, -1 to 1: brightness and contrast of uneven light, to first order.
    """

    rays: FloatArray
    levels: FloatArray
    light: FloatArray
    px_per_cell: float
    smoothed_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _View:
    """A picture, its camera, and the tag that is looked for in it."""

    picture: GrayImage
    matrix: FloatArray
    lens: FloatArray | None
    tag_id: int
    cell_mm: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fitted:
    """A pose, and by how many cells light areas have grown in the picture."""

    pose: TagPose
    grown_cells: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Checked:
    """A pose, its correlation without the picture's noise, and how far its worst spot is off, as a fraction of the contrast."""

    pose: TagPose
    agreement: float
    worst: float

    @property
    def shown(self) -> bool:
        """Whether the picture shows the tag at this pose, all of it."""
        return self.agreement >= _LEAST_AGREEMENT and self.pose.fit >= _LEAST_FIT and self.worst <= _MOST_OFF


def refine_tag_pose(
    tape: Tape,
    image: npt.ArrayLike,
    rotation: npt.ArrayLike,
    translation_mm: npt.ArrayLike,
    camera_matrix: npt.ArrayLike,
    distortion: npt.ArrayLike | None = None,
) -> TagPose:
    """Refine a detector's pose, and correct it if the detector chose the mirrored tilt or a distance up to a quarter off.

    Parameters
    ----------
    tape : Tape
        Tape with the detected tag.
    image : array_like of uint8, shape (h, w)
        The detector's picture, gray.
    rotation : array_like, shape (3, 3)
        Of the tag in the camera's frame, as detectors give it (``pose_R``), whether they know the lens or not.
    translation_mm : array_like, shape (3,) or (3, 1)
        Of the tag's centre there (``pose_t``), mm.
    camera_matrix : array_like, shape (3, 3)
        [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], px.
    distortion : array_like, optional
        As OpenCV's calibration gives it.

    Returns
    -------
    TagPose

    Raises
    ------
    SpecError
        If the tape has no tag, or the pose is invalid.
    FrameError
        If the picture is invalid, or does not show the tag there, all of it.
    """
    tag = tag_of(tape)
    camera_to_texture(tape, rotation, translation_mm)
    turn, shift = np.asarray(rotation, dtype=np.float64), np.asarray(translation_mm, dtype=np.float64).ravel()
    matrix, lens = camera_arrays(camera_matrix, distortion)
    try:
        picture = np.asarray(image)
    except ValueError as error:
        raise FrameError("the picture's rows have several lengths; give (h, w) gray levels, uint8") from error
    if picture.ndim != 2 or picture.dtype != np.uint8:
        raise FrameError(
            f"a picture of shape {picture.shape} and type {picture.dtype} is invalid; give (h, w) gray levels, uint8"
        )
    view = _View(picture=picture, matrix=matrix, lens=lens, tag_id=tag.id, cell_mm=tag.cell_mm)
    best = _found(view, _starts(turn, shift, tag_side_mm(tape), matrix, lens), tag_side_mm(tape))
    if not best.shown:
        message = (
            f"the picture does not show all of tag {tag.id} there (correlation {best.pose.fit:.3f}, at least {_LEAST_FIT:g}; "
        )
        message += (
            f"without noise {best.agreement:.3f}, at least {_LEAST_AGREEMENT:g}; worst spot off by {best.worst:.0%} of the "
        )
        message += (
            f"contrast, at most {_MOST_OFF:.0%}); give a picture in which nothing covers it, and the detector's own pose of "
        )
        message += "this tag, in mm, with x right and y down on it as AprilTag has them"
        raise FrameError(message)
    return best.pose


def _found(view: _View, groups: list[list[_Start]], side_mm: float) -> _Checked:
    """The best pose from the starts, and where it does not show the tag from those nearer and farther away, too.

    A single fit finds the tag from a start up to 5 % too near or too far, edges of its rim being half a cell off beyond.
    """
    first: _Checked | None = None
    try:
        first = _from_starts(view, groups, side_mm)
        if first.shown:
            return first
    except FrameError as error:
        refused = error
    wider = [[(turn, factor * shift) for turn, shift in starts] for starts in groups for factor in _DISTANCES]
    try:
        coarse = _best(view, *_likeliest(view, wider, _COARSE_CELLS)).pose
        if coarse.fit < _LEAST_FIT:
            raise FrameError("the picture does not show the tag nearer or farther away, either")
        second = _from_starts(view, _starts(coarse.rotation, coarse.translation_mm, side_mm, view.matrix, None), side_mm)
    except FrameError:
        if first is None:
            raise refused from None
        return first
    return max(filter(None, (first, second)), key=lambda found: (found.shown, found.agreement))


def _from_starts(view: _View, groups: list[list[_Start]], side_mm: float) -> _Checked:
    """The best pose from the likeliest starts. Raises FrameError if the picture does not show the whole tag there."""
    seen, starts = _likeliest(view, groups, _SMOOTHING_CELLS)
    found = _best(view, seen, starts)
    turn, shift = found.pose.rotation, found.pose.translation_mm
    # pixels are those of the start: of 40 tags up to 3 cells beside it two were fitted to a part, 38 and 69 degrees off
    if _moved_cells(view, side_mm, starts[0], (turn, shift)) > _MOST_MOVED_CELLS:
        found = _best(view, *_likeliest(view, _starts(turn, shift, side_mm, view.matrix, None), _SMOOTHING_CELLS))
    return _checked(view, found)


def _moved_cells(view: _View, side_mm: float, before: _Start, after: _Start) -> float:
    """How far a tag's corners have moved in the picture, in its cells."""
    places = [_square(side_mm) @ turn.T + shift for turn, shift in (before, after)]
    moved = places[0][:, :2] / places[0][:, 2:] - places[1][:, :2] / places[1][:, 2:]
    return float(np.hypot(moved[:, 0], moved[:, 1]).max() * after[1][2] / view.cell_mm)


def _square(side_mm: float) -> FloatArray:
    half = side_mm / 2
    return np.array([(-half, half, 0.0), (half, half, 0.0), (half, -half, 0.0), (-half, -half, 0.0)])


def _likeliest(view: _View, groups: list[list[_Start]], smoothing_cells: float) -> tuple[_Seen, list[_Start]]:
    """The group of starts at which the picture is most like the tag, with its pixels. Raises FrameError if none has any."""
    looks: list[tuple[float, _Seen, list[_Start]]] = []
    for starts in groups:
        try:
            seen = _pixels(view, *starts[0], smoothing_cells)
        except FrameError as error:
            refused = error
            continue
        looks.append((max(_fit_at(seen, view, *start) for start in starts), seen, starts))
    if not looks:
        raise refused
    return max(looks, key=lambda look: look[0])[1:]


def _best(view: _View, seen: _Seen, starts: list[_Start]) -> _Fitted:
    return max((_fitted(seen, view, *start) for start in starts), key=lambda found: found.pose.fit)


def _starts(
    rotation: FloatArray, translation_mm: FloatArray, side_mm: float, matrix: FloatArray, lens: FloatArray | None
) -> list[list[_Start]]:
    """The pose itself, and the other one with a similar image of a small square; both again for a detector without the lens."""
    square = _square(side_mm)
    points = square @ rotation.T + translation_mm
    if not (points[:, 2] > 0.0).all():
        raise FrameError("the tag is not wholly in front of the camera; give the detector's own pose")
    seen = points[:, :2] / points[:, 2:]
    tilts = _tilts(square, seen)
    apart = [np.abs(turn - rotation).max() for turn, _ in tilts]
    starts = [[(rotation, translation_mm), tilts[int(np.argmax(apart))]]]
    if lens is not None:
        # AprilTag's pose is that of a pinhole camera: its corners are where the picture has them, seen through the lens
        starts.append(_tilts(square, rays_of(seen * matrix[[0, 1], [0, 1]] + matrix[:2, 2], matrix, lens)[:, :2]))
    return starts


def _tilts(square: FloatArray, seen: FloatArray) -> list[_Start]:
    """Both tilts at which a square seen from afar looks nearly alike, by IPPE (Collins and Bartoli, 2014)."""
    cv2 = library("cv2", "fitting a tag to a picture")

    _, turns, shifts, _ = cv2.solvePnPGeneric(square, np.ascontiguousarray(seen), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    return [(np.asarray(cv2.Rodrigues(turn)[0]), np.ravel(shift)) for turn, shift in zip(turns, shifts, strict=True)]


def _pixels(view: _View, rotation: FloatArray, translation_mm: FloatArray, smoothing_cells: float) -> _Seen:
    """The pixels within the middle of the tag's light ring."""
    cv2 = library("cv2", "fitting a tag to a picture")

    half = (CODE_CELLS / 2 + _RING_SHARE) * view.cell_mm
    square = np.array([(-half, -half, 0.0), (half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0)])
    corners, _ = cv2.projectPoints(square, cv2.Rodrigues(rotation)[0], translation_mm, view.matrix, view.lens)
    outline = np.reshape(corners, (-1, 2))
    height, width = view.picture.shape
    low, high = np.floor(outline.min(axis=0)), np.ceil(outline.max(axis=0)) + 1
    if not (np.isfinite(outline).all() and (low >= 0).all() and (high <= (width, height)).all() and translation_mm[2] > 0.0):
        raise FrameError(f"the tag is not wholly inside the picture of {width} x {height} px; give one that shows it all")
    (u0, v0), (u1, v1) = low.astype(int), high.astype(int)
    inside = np.zeros((v1 - v0, u1 - u0), dtype=np.uint8)
    # corners in sixteenths of a pixel (shift = 4)
    cv2.fillConvexPoly(inside, np.rint((outline - (u0, v0)) * 16).astype(np.int32), 1, cv2.LINE_8, 4)
    v, u = np.nonzero(inside)
    if not _LEAST_PIXELS <= len(u) <= _MOST_PIXELS:
        message = (
            f"the tag covers {len(u)} px, not {_LEAST_PIXELS} to {_MOST_PIXELS}; take the picture nearer, or from farther away"
        )
        raise FrameError(message)
    px_per_cell = sqrt(len(u)) / (2 * half / view.cell_mm)
    # a small tag's picture is blurred enough by itself
    smoothed_px = max(smoothing_cells * px_per_cell - _BLUR_PX / 2, 0.0)
    # a Gaussian of four deviations, so that its own border does not come in
    margin = ceil(4 * smoothed_px)
    left, top = max(u0 - margin, 0), max(v0 - margin, 0)
    shown = view.picture[top : v1 + margin, left : u1 + margin].astype(np.float32)
    if smoothed_px > 0.0:
        shown = np.asarray(cv2.GaussianBlur(shown, (0, 0), smoothed_px), dtype=np.float32)
        # pixels half a deviation apart have all that is left
        thin = max(int(smoothed_px / 2), 1)
        u, v = u[(u % thin == 0) & (v % thin == 0)], v[(u % thin == 0) & (v % thin == 0)]
    return _Seen(
        rays=rays_of(np.stack([u + u0, v + v0], axis=1).astype(np.float64), view.matrix, view.lens),
        levels=shown[v + v0 - top, u + u0 - left].astype(np.float64),
        light=np.column_stack([np.ones(len(u)), 2 * u / max(u1 - u0 - 1, 1) - 1, 2 * v / max(v1 - v0 - 1, 1) - 1]),
        px_per_cell=px_per_cell,
        smoothed_px=smoothed_px,
    )


@lru_cache(maxsize=2)
def _printed(tag_id: int) -> _F32:
    """Signed distance of each point of the tag into the light area, in cells; the film beyond the ring counts as dark."""
    cv2 = library("cv2", "fitting a tag to a picture")

    light = np.kron(np.pad(tag_cells(tag_id), _PAD_CELLS), np.ones((_PX_PER_CELL, _PX_PER_CELL), dtype=bool)).astype(np.uint8)
    inside, outside = (cv2.distanceTransform(area, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for area in (light, 1 - light))
    # distances are to the next pixel of the other kind, whose border lies half a pixel nearer
    return np.asarray(np.where(light, inside - 0.5, 0.5 - outside) / _PX_PER_CELL, dtype=np.float32)


def _residual(seen: _Seen, view: _View, rotation: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals of the grey levels at a pose, in the best light; and the contrast, with its slopes (3,).

    ``values`` are a small turn (3), the translation (3), ln of the blur in cells, and by how many cells light areas have grown
    (ink that has run).
    """
    cv2 = library("cv2", "fitting a tag to a picture")

    hit = _hits(seen, np.asarray(cv2.Rodrigues(values[:3])[0]) @ rotation, values[3:6])
    # mm from the tag's centre to pixels of the printed picture, integers at pixel centres
    at = ((hit / view.cell_mm + SIDE_CELLS / 2 + _PAD_CELLS) * _PX_PER_CELL - 0.5).astype(np.float32)
    # a pixel at distance d of a straight edge is covered by d + 0.5, from 0 to 1
    light = np.clip((_printed(view.tag_id) + np.float32(values[7])) * _PX_PER_CELL + 0.5, 0.0, 1.0)
    blurred = cv2.GaussianBlur(light, (0, 0), float(np.exp(values[6])) * _PX_PER_CELL)
    lots = np.array_split(at, len(at) // _MOST_COLUMNS + 1)
    seen_there = [np.ravel(cv2.remap(blurred, lot[None, :, 0], lot[None, :, 1], cv2.INTER_LINEAR)) for lot in lots]
    shape = np.concatenate(seen_there).astype(np.float64)
    # brightness, contrast and their slopes are linear: for each pose the best ones are put in at once (variable projection)
    design = np.hstack([seen.light, seen.light * shape[:, None]])
    best = _least_squares(design, seen.levels)
    return seen.levels - design @ best, best[3:]


def _least_squares(design: FloatArray, levels: FloatArray) -> FloatArray:
    # by the normal equations, whose columns are of one size: a tenth of the time of an SVD of all pixels
    return np.asarray(np.linalg.lstsq(design.T @ design, design.T @ levels, rcond=1e-12)[0])


def _first(seen: _Seen, translation_mm: FloatArray) -> FloatArray:
    """Initial values for `_residual`."""
    return np.array([0.0, 0.0, 0.0, *translation_mm, np.log(hypot(_BLUR_PX, seen.smoothed_px) / seen.px_per_cell), 0.0])


def _fit_at(seen: _Seen, view: _View, rotation: FloatArray, translation_mm: FloatArray) -> float:
    """Correlation of the picture with the printed tag at a given pose."""
    return _correlation(seen, *_residual(seen, view, rotation, _first(seen, translation_mm)))


def _correlation(seen: _Seen, off: FloatArray, contrast: FloatArray) -> float:
    """Correlation of grey levels with the tag, apart from what a slope of brightness explains; 0 where light areas are darker."""
    flat = seen.levels - seen.light @ _least_squares(seen.light, seen.levels)
    whole = float(flat @ flat)
    if not (whole > 0.0 and (seen.light @ contrast).min() > 0.0):
        return 0.0
    return sqrt(max(1.0 - float(off @ off) / whole, 0.0))


def _checked(view: _View, found: _Fitted) -> _Checked:
    """A pose held against the pixels of the tag where it is now, as the picture has them. Raises FrameError as `_pixels` does."""
    turn, shift = found.pose.rotation, found.pose.translation_mm
    seen = _pixels(view, turn, shift, 0.0)
    blur_cells = max(found.pose.blur_px, 0.2) / seen.px_per_cell
    off, contrast = _residual(seen, view, turn, np.array([0.0, 0.0, 0.0, *shift, np.log(blur_cells), found.grown_cells]))
    fit = _correlation(seen, off, contrast)
    if fit == 0.0:
        return _Checked(pose=found.pose, agreement=0.0, worst=1.0)
    # differences of neighbours in a row, which are next to each other: noise of the picture, where the misfit changes slowly
    steps = np.diff(off)[np.diff(seen.light[:, 2]) == 0.0]
    noise = min(float(steps @ steps) / (2 * len(steps)) / float(off @ off / len(off)), 1.0) if len(steps) else 0.0
    return _Checked(
        pose=found.pose,
        # a large tag is smoothed for the fit, which takes out what a camera's sharpening adds to its edges
        agreement=max(sqrt(1.0 - (1.0 - fit**2) * (1.0 - noise)), found.pose.fit),
        worst=_worst_spot(view, _hits(seen, turn, shift), off / (seen.light @ contrast)),
    )


def _worst_spot(view: _View, hit_mm: FloatArray, share: FloatArray) -> float:
    """Largest mean over a spot of two by two cells of what pixels differ from the tag: noise of single pixels goes out."""
    cell = np.floor(hit_mm / view.cell_mm + SIDE_CELLS / 2).astype(int)
    inside = ((cell >= 0) & (cell < SIDE_CELLS)).all(axis=1)
    index = cell[inside, 0] * SIDE_CELLS + cell[inside, 1]
    tables = (np.bincount(index, weights, SIDE_CELLS**2).reshape(SIDE_CELLS, -1) for weights in (None, share[inside]))
    count, total = (t[1:, 1:] + t[1:, :-1] + t[:-1, 1:] + t[:-1, :-1] for t in tables)
    # at the rim there may be few pixels
    enough = count >= max(float(np.median(count)) / 3, 1.0)
    return float(np.abs(total[enough] / count[enough]).max()) if enough.any() else 1.0


def _hits(seen: _Seen, rotation: FloatArray, translation_mm: FloatArray) -> FloatArray:
    """Intersections of the pixels' rays with the tag's plane, mm from its centre (n, 2)."""
    # rays in the tag's frame: X = R^T (s ray - t), which meets z = 0 at s = -start_z / ahead_z
    ahead, start = seen.rays @ rotation, -rotation.T @ translation_mm
    return np.asarray(start[:2] - (start[2] / ahead[:, 2])[:, None] * ahead[:, :2])


def _fitted(seen: _Seen, view: _View, rotation: FloatArray, translation_mm: FloatArray) -> _Fitted:
    """The pose by Levenberg-Marquardt from one start."""
    cv2 = library("cv2", "fitting a tag to a picture")

    # steps of differences, and the unit of `step`: mrad, 1e-4 of the distance, ln of the blur, cells
    scale = np.array([1e-3] * 3 + [1e-4 * float(translation_mm[2])] * 3 + [0.05, 0.02])
    values = _first(seen, translation_mm)
    low, high = np.log(hypot(0.2, seen.smoothed_px) / seen.px_per_cell), np.log(2.0)
    (off, contrast), damping = _residual(seen, view, rotation, values), 1e-3
    for _ in range(_MOST_STEPS):
        steps = np.diag(scale)
        slopes = np.stack(
            [
                (_residual(seen, view, rotation, values + s)[0] - _residual(seen, view, rotation, values - s)[0]) / 2
                for s in steps
            ],
            axis=1,
        )
        normal = slopes.T @ slopes
        # Marquardt's damping is relative to each unknown's own curvature
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-12 * np.eye(8), slopes.T @ off)
        moved = values + np.clip(step, -_LONGEST_STEP, _LONGEST_STEP) * scale
        moved[6], moved[7] = np.clip(moved[6], low, high), np.clip(moved[7], -_MOST_BLEED, _MOST_BLEED)
        new, new_contrast = _residual(seen, view, rotation, moved)
        if not float(new @ new) < float(off @ off):
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        values, off, contrast, damping = moved, new, new_contrast, max(damping / 5.0, 1e-9)
        if np.abs(step[:6]).max() < _ENOUGH:
            break
    turn = np.asarray(cv2.Rodrigues(values[:3])[0]) @ rotation
    pose = TagPose(
        rotation=turn,
        translation_mm=values[3:6].copy(),
        fit=_correlation(seen, off, contrast),
        blur_px=sqrt(max((float(np.exp(values[6])) * seen.px_per_cell) ** 2 - seen.smoothed_px**2, 0.0)),
    )
    return _Fitted(pose=pose, grown_cells=float(values[7]))
