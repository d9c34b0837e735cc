"""Transforms from a camera's view of the printed tag to the texture frame of tactile fixes.

The texture frame in space: x along columns and y along rows, as on the film, and z into it; z = 0 is the film's top. It is
right-handed, as is AprilRobotics' tag frame: x right and y down on the upright tag, z into it, origin at its centre.
Camera frame: x right, y down, z forward. Pixels are those of OpenCV, integer at pixel centres.
"""

from __future__ import annotations

from contextlib import suppress
from math import radians

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.given_value import NO_ARRAY, as_numbers, unmasked
from tactape_fab.base.libraries import library
from tactape_fab.texture.board import Tag
from tactape_fab.texture.frames import FloatArray, board_to_texture
from tactape_fab.texture.shapes import rotate
from tactape_fab.texture.tape import Tape, refuse_no_tape

TAG_CELLS = 8
"""Cells along the side of tag36h11 between the corners that detectors give: 6 of data and the black border."""
_STEPS, _LOT = 8, 10_000
"""Newton's steps for the ray of a pixel, and how many pixels are taken at a time: OpenCV has some thirty numbers for each."""


def tag_of(tape: Tape) -> Tag:
    """Tag of a tape. Raises SpecError if it has no tag."""
    refuse_no_tape(tape)
    if tape.tag is None:
        raise SpecError(Problem("tag", f"tape {tape.name} carries no tag; make it with tag 'strip'"))
    return tape.tag


def tag_side_mm(tape: Tape) -> float:
    """Side of a tag's black border: the size that detectors expect.

    Parameters
    ----------
    tape : Tape

    Returns
    -------
    float
        mm.

    Raises
    ------
    SpecError
        When the tape has no tag.
    """
    return TAG_CELLS * tag_of(tape).cell_mm


def tag_corners_mm(tape: Tape) -> FloatArray:
    """The corners that detectors give, in the board frame; shape (4, 2), mm.

    In their order: lower left, lower right, upper right, upper left of the upright tag.
    """
    tag = tag_of(tape)
    square = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]) * tag_side_mm(tape) / 2
    return np.asarray(rotate(square, tag.rotation_deg) + np.asarray(tag.center_mm), dtype=np.float64)


def tag_to_texture(tape: Tape) -> FloatArray:
    """Transform of points from the tag's frame, as detectors have it, to the texture frame.

    Parameters
    ----------
    tape : Tape

    Returns
    -------
    ndarray, shape (4, 4)
        Homogeneous, mm; z of both frames points into the tape.

    Raises
    ------
    SpecError
        When the tape has no tag.
    """
    tag = tag_of(tape)
    c, s = np.cos(radians(tag.rotation_deg)), np.sin(radians(tag.rotation_deg))
    out = np.eye(4)
    out[:2, :2] = [(c, s), (-s, c)]  # counter-clockwise as seen from above is clockwise where y points down
    out[:2, 3] = board_to_texture(tag.center_mm, tape.board.texture_origin_mm)
    return out


def camera_arrays(camera_matrix: npt.ArrayLike, distortion: npt.ArrayLike | None) -> tuple[FloatArray, FloatArray | None]:
    """A camera's matrix (3, 3) and the coefficients of its lens, None without any. Raises SpecError for an invalid matrix."""
    matrix = as_numbers(camera_matrix, (3, 3), "camera_matrix", "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    others = matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]]  # a skew, which OpenCV leaves out, and what a transposed matrix has
    if min(matrix[0, 0], matrix[1, 1]) <= 0.0 or (others != (0.0, 0.0, 0.0, 0.0, 1.0)).any():
        message = f"camera_matrix = {matrix.tolist()} is invalid; give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        raise SpecError(Problem("camera_matrix", message))
    if distortion is None:
        return matrix, None
    remedy = "4, 5, 8, 12 or 14 coefficients as OpenCV's calibration has them, or leave it out"
    lens = as_numbers(distortion, (None,), "distortion", remedy, flat=True)
    if len(lens) not in (4, 5, 8, 12, 14):
        raise SpecError(Problem("distortion", f"distortion has {len(lens)} values; give {remedy}"))
    return matrix, lens


def camera_to_texture(tape: Tape, rotation: npt.ArrayLike, translation_mm: npt.ArrayLike) -> FloatArray:
    """Transform of points from the camera's frame to the texture frame; shape (4, 4), mm.

    rotation (3, 3): Of the tag in the camera's frame, as detectors give it (``pose_R``).
    translation_mm (3,): Of its centre (``pose_t``), with the tag's size given to the detector in mm.
    Raises SpecError when the tape has no tag, or the pose is invalid.
    """
    turn = as_numbers(rotation, (3, 3), "rotation", "a finite rotation (3, 3), pose_R as the detector has it")
    shift = as_numbers(translation_mm, (3,), "translation_mm", "a finite translation (3,), pose_t in mm", flat=True)
    if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-3 or np.linalg.det(turn) < 0.0:
        raise SpecError(Problem("rotation", "rotation is no rotation matrix; give pose_R as the detector has it"))
    back = np.eye(4)
    # inverse of a rigid motion: camera to tag
    back[:3, :3], back[:3, 3] = turn.T, -turn.T @ shift
    return np.asarray(tag_to_texture(tape) @ back, dtype=np.float64)


def rays_of(pixels: FloatArray, matrix: FloatArray, lens: FloatArray | None) -> FloatArray:
    """Rays that pixels see, in the camera's frame, with z = 1; (n, 2) to (n, 3).

    OpenCV ends after five rounds, at the sides of a wide lens (k1 = -0.35) up to a pixel off: Newton's steps finish it.
    """
    cv2 = library("cv2", "projecting points")

    rays = np.ones((len(pixels), 3))
    rays[:, :2] = np.reshape(cv2.undistortPoints(pixels.reshape(-1, 1, 2), matrix, lens), (-1, 2))
    for first in range(0, len(pixels) if lens is not None else 0, _LOT):
        lot, wanted = rays[first : first + _LOT], pixels[first : first + _LOT]
        tried, least = lot.copy(), np.full(len(lot), np.inf)
        for _ in range(_STEPS):
            seen, rates = cv2.projectPoints(tried, np.zeros(3), np.zeros(3), matrix, lens)
            off = wanted - np.reshape(seen, (-1, 2))
            far = np.hypot(off[:, 0], off[:, 1])
            # where the lens folds nothing sees the pixel, and steps lead away
            nearer = far < least
            lot[nearer], least[nearer] = tried[nearer], far[nearer]
            # derivatives by a shift of the camera along x and y are those by the point
            (a, b), (c, d) = np.asarray(rates)[:, 3:5].reshape(-1, 2, 2).transpose(1, 2, 0)
            with np.errstate(all="ignore"):
                tried[:, 0] += (d * off[:, 0] - b * off[:, 1]) / (a * d - b * c)
                tried[:, 1] += (a * off[:, 1] - c * off[:, 0]) / (a * d - b * c)
    return rays


def _pairs(given: npt.ArrayLike, key: str, remedy: str) -> FloatArray:
    """Points (n, 2), or a single one. Raises SpecError for anything else."""
    with suppress(*NO_ARRAY):  # such as of rows of several lengths, which are refused below
        given = np.empty((0, 2)) if np.size(given) == 0 else unmasked(given)
        given = [given] if np.ndim(given) == 1 else given
    return as_numbers(given, (None, 2), key, remedy, finite=False)


def pixels_to_texture(
    tape: Tape,
    pixels: npt.ArrayLike,
    rotation: npt.ArrayLike,
    translation_mm: npt.ArrayLike,
    camera_matrix: npt.ArrayLike,
    distortion: npt.ArrayLike | None = None,
) -> FloatArray:
    """Intersect the rays of pixels with a flat tape.

    Parameters
    ----------
    tape : Tape
    pixels : array_like, shape (n, 2)
        (u, v), px.
    rotation : array_like, shape (3, 3)
        Of the tag in the camera's frame, as detectors give it (``pose_R``).
    translation_mm : array_like, shape (3,) or (3, 1)
        Of the tag's centre there (``pose_t``), mm.
    camera_matrix : array_like, shape (3, 3)
        [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], px.
    distortion : array_like, optional
        As OpenCV's calibration gives it.

    Returns
    -------
    ndarray, shape (n, 2)
        Texture frame, mm; NaN where a ray runs along the film or away from it.

    Raises
    ------
    SpecError
        When the tape has no tag, or the pose or the camera's matrix is invalid.
    """
    refuse_no_tape(tape)
    points = _pairs(pixels, "pixels", "(u, v) of each, px")
    camera = camera_arrays(camera_matrix, distortion)
    if len(points) == 0:
        return np.empty((0, 2))
    rays = rays_of(points, *camera)
    transform = camera_to_texture(tape, rotation, translation_mm)
    ahead = rays @ transform[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        # camera centre + way ahead, on z = 0; behind the camera it is negative
        way = -transform[2, 3] / ahead[:, 2]
        hit = transform[:2, 3] + way[:, None] * ahead[:, :2]
    return np.where((way > 0.0)[:, None] & np.isfinite(hit), hit, np.nan)


def texture_to_pixels(
    tape: Tape,
    texture_mm: npt.ArrayLike,
    rotation: npt.ArrayLike,
    translation_mm: npt.ArrayLike,
    camera_matrix: npt.ArrayLike,
    distortion: npt.ArrayLike | None = None,
) -> FloatArray:
    """Project points of a flat tape into the camera's image, the inverse of `pixels_to_texture`.

    Parameters
    ----------
    tape : Tape
    texture_mm : array_like, shape (n, 2)
        Points in the texture frame, mm.
    rotation : array_like, shape (3, 3)
        Of the tag in the camera's frame, as detectors give it (``pose_R``).
    translation_mm : array_like, shape (3,) or (3, 1)
        Of the tag's centre there (``pose_t``), mm.
    camera_matrix : array_like, shape (3, 3)
        [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], px.
    distortion : array_like, optional
        As OpenCV's calibration gives it.

    Returns
    -------
    ndarray, shape (n, 2)
        (u, v), px; NaN behind the camera.

    Raises
    ------
    SpecError
        When the tape has no tag, or the pose or the camera's matrix is invalid.
    """
    cv2 = library("cv2", "projecting points")

    xy = _pairs(texture_mm, "texture_mm", "(x, y) of each, mm")
    back = np.linalg.inv(camera_to_texture(tape, rotation, translation_mm))
    points = np.column_stack([xy, np.zeros(len(xy))]) @ back[:3, :3].T + back[:3, 3]
    camera = camera_arrays(camera_matrix, distortion)
    if len(points) == 0:
        return np.empty((0, 2))
    seen, _ = cv2.projectPoints(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), *camera)
    return np.where(points[:, 2:] > 0.0, np.reshape(seen, (-1, 2)), np.nan)
