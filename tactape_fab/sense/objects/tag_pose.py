"""A tag's pose from all its edges: a detector's pose from four corners, refined on the picture itself.

Corners of a small tag are found to some tenths of a pixel, and blur moves them inwards; far from the tag that error grows.
Here the printed tag is fitted to every pixel of it, with brightness, contrast and blur of the picture.
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
_MOST_STEPS = 20
_SMOOTHING_CELLS = 0.12
"""First smoothing of a large tag's image (standard deviation): unsmoothed edges have no gradient until they nearly meet."""
_LEAST_PIXELS, _MOST_PIXELS = 60, 1_000_000
_MOST_COLUMNS = 30_000
"""OpenCV's remap counts columns in 16 bits."""
_ENOUGH = 0.02
"""Iteration ends when the pose moves by less than this fraction of a milliradian and of 1e-4 of the distance."""
_LEAST_FIT = 0.5
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
        Correlation of the picture with the printed tag at this pose; 1 is perfect.
    blur_px : float
        Standard deviation of the picture's blur.
    """

    rotation: FloatArray
    translation_mm: FloatArray
    fit: float
    blur_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """Pixels of the tag: their rays (n, 3) and grey levels (n,); pixels per cell; standard deviation of their smoothing."""

    rays: FloatArray
    levels: FloatArray
    px_per_cell: float
    smoothed_px: float


def refine_tag_pose(
    tape: Tape,
    image: npt.ArrayLike,
    rotation: npt.ArrayLike,
    translation_mm: npt.ArrayLike,
    camera_matrix: npt.ArrayLike,
    distortion: npt.ArrayLike | None = None,
) -> TagPose:
    """Refine a detector's pose, and correct it if the detector chose the mirrored tilt.

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
        If the picture is invalid, or does not show the tag there.
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
    views: list[tuple[float, _Seen, list[_Start]]] = []
    for starts in _starts(turn, shift, tag_side_mm(tape), matrix, lens):
        try:
            seen = _pixels(picture, *starts[0], matrix, lens, tag.cell_mm)
        except FrameError as error:
            refused = error
            continue
        views.append((max(_fit_at(seen, tag.id, tag.cell_mm, *start) for start in starts), seen, starts))
    if not views:
        raise refused
    _, seen, starts = max(views, key=lambda view: view[0])
    best = max((_fitted(seen, tag.id, tag.cell_mm, *start) for start in starts), key=lambda pose: pose.fit)
    # border and ring are the same for every tag and turn: only the cells inside tell them apart
    fit = min(best.fit, _fit_at(seen, tag.id, tag.cell_mm, best.rotation, best.translation_mm, of_cells=True))
    if not fit >= _LEAST_FIT:
        raise FrameError(
            f"the picture does not show tag {tag.id} there (correlation {fit:.2f}); give the detector's own pose of this tag, in "
            "mm, with x right and y down on it as AprilTag has them"
        )
    return best


def _starts(
    rotation: FloatArray, translation_mm: FloatArray, side_mm: float, matrix: FloatArray, lens: FloatArray | None
) -> list[list[_Start]]:
    """The pose itself, and the other one with a similar image of a small square; both again for a detector without the lens."""
    half = side_mm / 2
    square = np.array([(-half, half, 0.0), (half, half, 0.0), (half, -half, 0.0), (-half, -half, 0.0)])
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


def _pixels(
    image: GrayImage,
    rotation: FloatArray,
    translation_mm: FloatArray,
    matrix: FloatArray,
    lens: FloatArray | None,
    cell_mm: float,
) -> _Seen:
    """The pixels within the middle of the tag's light ring."""
    cv2 = library("cv2", "fitting a tag to a picture")

    half = (CODE_CELLS / 2 + _RING_SHARE) * cell_mm
    square = np.array([(-half, -half, 0.0), (half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0)])
    corners, _ = cv2.projectPoints(square, cv2.Rodrigues(rotation)[0], translation_mm, matrix, lens)
    outline = np.reshape(corners, (-1, 2))
    height, width = image.shape
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
    pixels = np.stack([u + u0, v + v0], axis=1).astype(np.float64)
    px_per_cell = sqrt(len(u)) / (2 * half / cell_mm)
    # a small tag's picture is blurred enough by itself
    smoothed_px = max(_SMOOTHING_CELLS * px_per_cell - _BLUR_PX / 2, 0.0)
    # a Gaussian of four deviations, so that its own border does not come in
    margin = ceil(4 * smoothed_px)
    left, top = max(u0 - margin, 0), max(v0 - margin, 0)
    shown = image[top : v1 + margin, left : u1 + margin].astype(np.float32)
    if smoothed_px > 0.0:
        shown = np.asarray(cv2.GaussianBlur(shown, (0, 0), smoothed_px), dtype=np.float32)
    return _Seen(
        rays=rays_of(pixels, matrix, lens),
        levels=shown[v + v0 - top, u + u0 - left].astype(np.float64),
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


def _residual(
    seen: _Seen, tag_id: int, cell_mm: float, rotation: FloatArray, values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residuals of the grey levels at a pose, with the best brightness and contrast; and the model image.

    ``values`` are a small turn (3), the translation (3), ln of the blur in cells, and by how many cells light areas have grown
    (ink that has run).
    """
    cv2 = library("cv2", "fitting a tag to a picture")

    turn = np.asarray(cv2.Rodrigues(values[:3])[0]) @ rotation
    hit = _hits(seen, turn, values[3:6])
    # mm from the tag's centre to pixels of the printed picture, integers at pixel centres
    at = ((hit / cell_mm + SIDE_CELLS / 2 + _PAD_CELLS) * _PX_PER_CELL - 0.5).astype(np.float32)
    # a pixel at distance d of a straight edge is covered by d + 0.5, from 0 to 1
    light = np.clip((_printed(tag_id) + np.float32(values[7])) * _PX_PER_CELL + 0.5, 0.0, 1.0)
    blurred = cv2.GaussianBlur(light, (0, 0), float(np.exp(values[6])) * _PX_PER_CELL)
    lots = np.array_split(at, len(at) // _MOST_COLUMNS + 1)
    seen_there = [np.ravel(cv2.remap(blurred, lot[None, :, 0], lot[None, :, 1], cv2.INTER_LINEAR)) for lot in lots]
    shape = np.concatenate(seen_there).astype(np.float64)
    design = np.column_stack([shape, np.ones(len(shape))])
    # brightness and contrast are linear: for each pose the best ones are put in at once (variable projection)
    return seen.levels - design @ np.linalg.lstsq(design, seen.levels, rcond=None)[0], shape


def _first(seen: _Seen, translation_mm: FloatArray) -> FloatArray:
    """Initial values for `_residual`."""
    return np.array([0.0, 0.0, 0.0, *translation_mm, np.log(hypot(_BLUR_PX, seen.smoothed_px) / seen.px_per_cell), 0.0])


def _fit_at(
    seen: _Seen, tag_id: int, cell_mm: float, rotation: FloatArray, translation_mm: FloatArray, *, of_cells: bool = False
) -> float:
    """Correlation of the picture with the printed tag at a given pose; ``of_cells``: only within the black border."""
    shape = _residual(seen, tag_id, cell_mm, rotation, _first(seen, translation_mm))[1]
    half_mm = (CODE_CELLS - 2) / 2 * cell_mm
    used = (np.abs(_hits(seen, rotation, translation_mm)) < half_mm).all(axis=1) if of_cells else np.s_[:]
    return _correlation(seen.levels[used], shape[used])


def _correlation(levels: FloatArray, shape: FloatArray) -> float:
    spread = float(shape.std() * levels.std()) if len(levels) else 0.0
    return float(np.mean((shape - shape.mean()) * (levels - levels.mean()))) / spread if spread > 0.0 else 0.0


def _hits(seen: _Seen, rotation: FloatArray, translation_mm: FloatArray) -> FloatArray:
    """Intersections of the pixels' rays with the tag's plane, mm from its centre (n, 2)."""
    # rays in the tag's frame: X = R^T (s ray - t), which meets z = 0 at s = -start_z / ahead_z
    ahead, start = seen.rays @ rotation, -rotation.T @ translation_mm
    return np.asarray(start[:2] - (start[2] / ahead[:, 2])[:, None] * ahead[:, :2])


def _fitted(seen: _Seen, tag_id: int, cell_mm: float, rotation: FloatArray, translation_mm: FloatArray) -> TagPose:
    """The pose by Levenberg-Marquardt from one start."""
    cv2 = library("cv2", "fitting a tag to a picture")

    # steps of differences, and the unit of `step`: mrad, 1e-4 of the distance, ln of the blur, cells
    scale = np.array([1e-3] * 3 + [1e-4 * float(translation_mm[2])] * 3 + [0.05, 0.02])
    values = _first(seen, translation_mm)
    low, high = np.log(hypot(0.2, seen.smoothed_px) / seen.px_per_cell), np.log(2.0)
    (off, shape), damping = _residual(seen, tag_id, cell_mm, rotation, values), 1e-3
    for _ in range(_MOST_STEPS):
        steps = np.diag(scale)
        slopes = np.stack(
            [
                (
                    _residual(seen, tag_id, cell_mm, rotation, values + s)[0]
                    - _residual(seen, tag_id, cell_mm, rotation, values - s)[0]
                )
                / 2
                for s in steps
            ],
            axis=1,
        )
        normal = slopes.T @ slopes
        # Marquardt's damping is relative to each unknown's own curvature
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-12 * np.eye(8), slopes.T @ off)
        moved = values + np.clip(step, -20.0, 20.0) * scale
        moved[6], moved[7] = np.clip(moved[6], low, high), np.clip(moved[7], -_MOST_BLEED, _MOST_BLEED)
        new, new_shape = _residual(seen, tag_id, cell_mm, rotation, moved)
        if not float(new @ new) < float(off @ off):
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        values, off, shape, damping = moved, new, new_shape, max(damping / 5.0, 1e-9)
        if np.abs(step[:6]).max() < _ENOUGH:
            break
    return TagPose(
        rotation=np.asarray(cv2.Rodrigues(values[:3])[0]) @ rotation,
        translation_mm=values[3:6].copy(),
        fit=_correlation(seen.levels, shape),
        blur_px=sqrt(max((float(np.exp(values[6])) * seen.px_per_cell) ** 2 - seen.smoothed_px**2, 0.0)),
    )
