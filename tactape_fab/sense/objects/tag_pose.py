"""A tag's pose from all its edges: a detector's pose from four corners, refined on the picture itself.

Corners of a small tag are found to some tenths of a pixel, and blur moves them inwards; far from the tag that error grows.
Here the printed tag is fitted to every pixel of it, with blur, brightness and contrast of the picture, which may fall across it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import FrameError
from tactape_fab.base.given_value import NO_ARRAY
from tactape_fab.base.libraries import library
from tactape_fab.sense.objects.tag_fit import (
    Pose,
    Seen,
    View,
    correlation,
    fit_at,
    fitted,
    hits,
    pixels,
    posed,
    residual,
    to_cells_of,
)
from tactape_fab.sense.objects.tag_view import TAG_CELLS, camera_arrays, camera_to_texture, rays_of, tag_of, tag_side_mm
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tag import SIDE_CELLS
from tactape_fab.texture.tape import Tape

_SMOOTHING_CELLS = 0.12
"""First smoothing of a large tag's image (standard deviation): unsmoothed edges have no gradient until they nearly meet."""
_COARSE_CELLS = 0.4
"""Smoothing of the first look from a start that does not lead to the tag: edges half a cell apart still meet."""
_DISTANCES = tuple(1.06**k for k in range(-5, 6))
"""Distances that are tried then, 0.75 to 1.34 of the start's: a side that is that of the light ring, 10 cells for 8, is 1.25."""
_MOST_MOVED_CELLS = 0.5
"""Farthest that a corner moves by the fit without another fit, to the pixels of the tag where it is then."""
_LEAST_LOOK = 0.5
"""Correlation below which nothing is fitted: a tag has 0.94 and more at the best of `_DISTANCES`, what is none 0.33 and less."""
_LEAST_FIT = 0.85
"""Least correlation: poses that came to rest beside the tag had 0.82 and less, right ones 0.86 in noise of 2 levels at a contrast
of 15."""
_LEAST_AGREEMENT = 0.985
"""Least correlation without noise. Right poses had 0.992 and more in noise, low contrast, uneven light, JPEG's and a camera's own
sharpening, 0.986 with a blur of half a cell; with a tenth of one side covered, 7 to 20 degrees off, they had 0.91 to 0.994. Of
25 pictures with all of these faults at once 1 right pose is refused."""
_MOST_OFF = 0.2
"""Largest mean difference of a spot of two by two cells from the printed tag, as a fraction of the contrast: 0.11 at right poses
in noise of a tenth of it, 0.21 and more at 58 of 59 wrong ones of partly covered tags."""
_MOST_BORDER_CELLS = 0.08
"""Most that half a side of the border lies beside its place: 0.067 at 344 of 345 right poses in blur, noise, uneven light, JPEG;
more at 147 of 150 tags of which 0.07 to 0.1 was covered along a side by something as light as the ring, which were up to 75
degrees off; the other three were within 2."""
_SAME_RAD = 0.01
"""Fits of both tilts that end nearer to each other have found the same pose."""


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
    p_mirrored : float
        Probability that the tag is tilted the other way: seen from afar, both tilts look alike. By the likelihood of the pixels,
        at most 0.5.
    """

    rotation: FloatArray
    translation_mm: FloatArray
    fit: float
    blur_px: float
    p_mirrored: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted(TagPose):
    """A pose, by how many cells light areas have grown there, and how far the border fits.

    border_cells: Most that a side of the border lies further in or out than the other edges say.
    """

    grown_cells: float
    border_cells: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Checked:
    """A pose, its correlation without the picture's noise, and how far its worst spot is off, as a fraction of the contrast."""

    pose: Fitted
    agreement: float
    worst: float

    @property
    def shown(self) -> bool:
        """Whether the picture shows the tag at this pose, all of it."""
        like = self.agreement >= _LEAST_AGREEMENT and self.pose.fit >= _LEAST_FIT
        return like and self.worst <= _MOST_OFF and self.pose.border_cells <= _MOST_BORDER_CELLS


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
    except NO_ARRAY as error:
        raise FrameError(f"the picture is no array: {error}; give (h, w) gray levels, uint8") from error
    if picture.ndim != 2 or picture.dtype != np.uint8:
        raise FrameError(
            f"a picture of shape {picture.shape} and type {picture.dtype} is invalid; give (h, w) gray levels, uint8"
        )
    view = View(picture=picture, matrix=matrix, lens=lens, tag_id=tag.id, cell_mm=tag.cell_mm)
    best = _found(view, _starts(turn, shift, tag_side_mm(tape), matrix, lens), tag_side_mm(tape))
    if not best.shown:
        found = f"correlation {best.pose.fit:.3f}, at least {_LEAST_FIT:g}; without noise {best.agreement:.3f}, at least "
        found += (
            f"{_LEAST_AGREEMENT:g}; worst spot off by {best.worst:.0%} of the contrast, at most {_MOST_OFF:.0%}; border off by "
        )
        found += f"{max(best.pose.border_cells, 0.0):.2f} cells, at most {_MOST_BORDER_CELLS:g}"
        raise FrameError(
            f"the picture does not show all of tag {tag.id} there ({found}); give a picture in which nothing covers it, and the "
            "detector's own pose of this tag, in mm, with x right and y down on it as AprilTag has them"
        )
    pose = best.pose
    return TagPose(
        rotation=pose.rotation,
        translation_mm=pose.translation_mm,
        fit=pose.fit,
        blur_px=pose.blur_px,
        p_mirrored=pose.p_mirrored,
    )


def _found(view: View, starts: list[Pose], side_mm: float) -> _Checked:
    """The best pose from the starts, and where it does not show the tag from those nearer and farther away, too.

    A single fit finds the tag from a start up to 5 % too near or too far, edges of its rim being half a cell off beyond.
    """
    first: _Checked | None = None
    try:
        first = _from_starts(view, starts, side_mm)
        # what is like the tag as it is there is not so from elsewhere, covered or not
        if first.shown or first.pose.fit >= _LEAST_FIT:
            return first
    except FrameError as error:
        refused = error
    nearer_and_farther = [(turn, factor * shift) for turn, shift in starts for factor in _DISTANCES]
    try:
        look, seen, start = _likeliest(view, nearer_and_farther, _COARSE_CELLS)
        if look < _LEAST_LOOK:
            raise FrameError("the picture does not show the tag nearer or farther away, either")
        coarse = _best(view, seen, start)
        second = _from_starts(view, [(coarse.rotation, coarse.translation_mm)], side_mm)
    except FrameError:
        if first is None:
            raise refused from None
        return first
    return max(filter(None, (first, second)), key=lambda found: (found.shown, found.agreement))


def _from_starts(view: View, starts: list[Pose], side_mm: float) -> _Checked:
    """The best pose from the likeliest start. Raises FrameError if the picture does not show the whole tag there."""
    _, seen, start = _likeliest(view, starts, _SMOOTHING_CELLS)
    found = _best(view, seen, start)
    there = found.rotation, found.translation_mm
    # pixels are those of the start: of 40 tags up to 3 cells beside it two were fitted to a part, 38 and 69 degrees off
    if found.fit > 0.0 and _moved_cells(view, side_mm, start, there) > _MOST_MOVED_CELLS:
        found = _best(view, pixels(view, *there, _SMOOTHING_CELLS), there)
    return _checked(view, found)


def _moved_cells(view: View, side_mm: float, before: Pose, after: Pose) -> float:
    """How far a tag's corners have moved in the picture, in its cells."""
    places = [_square(side_mm) @ turn.T + shift for turn, shift in (before, after)]
    moved = places[0][:, :2] / places[0][:, 2:] - places[1][:, :2] / places[1][:, 2:]
    return float(np.hypot(moved[:, 0], moved[:, 1]).max() * after[1][2] / view.cell_mm)


def _square(side_mm: float) -> FloatArray:
    half = side_mm / 2
    return np.array([(-half, half, 0.0), (half, half, 0.0), (half, -half, 0.0), (-half, -half, 0.0)])


def _likeliest(view: View, starts: list[Pose], smoothing_cells: float) -> tuple[float, Seen, Pose]:
    """The start at which the picture is most like the tag: correlation there, and pixels. Raises FrameError if none has any."""
    looks: list[tuple[float, Seen, Pose]] = []
    for start in starts:
        try:
            seen = pixels(view, *start, smoothing_cells)
        except FrameError as error:
            refused = error
            continue
        looks.append((fit_at(seen, view, *start), seen, start))
    if not looks:
        raise refused
    return max(looks, key=lambda look: look[0])


def _best(view: View, seen: Seen, start: Pose) -> Fitted:
    """The better of both tilts at which the tag is seen nearly so."""
    flat, square, count = fitted(seen, view, *start), _square(TAG_CELLS * view.cell_mm), len(seen.levels)
    corners = np.column_stack([square[:, :2] / view.cell_mm, np.ones(4)]) @ np.linalg.inv(flat.to_cells).T
    found = [posed(flat, count, view.cell_mm, *tilt) for tilt in _tilts(square, corners[:, :2] / corners[:, 2:])]
    (pose, squares), (other, more) = sorted(found, key=lambda one: one[1])
    # the angle of a turn by its trace, 1 + 2 cos
    apart = np.arccos(np.clip((np.trace(pose[0].T @ other[0]) - 1.0) / 2.0, -1.0, 1.0))
    # a pixel's noise is normal and its size is estimated: ln L is - n / 2 ln of the sum of squares
    gain = count / 2.0 * np.log(more / squares) if squares > 0.0 else np.inf
    off, contrast = residual(seen, view, to_cells_of(*pose, view.cell_mm), flat.blur_cells, flat.grown_cells)
    return Fitted(
        rotation=pose[0],
        translation_mm=pose[1],
        fit=correlation(seen, off, contrast),
        blur_px=sqrt(max((flat.blur_cells * seen.px_per_cell) ** 2 - seen.smoothed_px**2, 0.0)),
        grown_cells=flat.grown_cells,
        border_cells=flat.border_cells,
        p_mirrored=0.0 if apart < _SAME_RAD else float(1.0 / (1.0 + np.exp(min(gain, 700.0)))),
    )


def _starts(
    rotation: FloatArray, translation_mm: FloatArray, side_mm: float, matrix: FloatArray, lens: FloatArray | None
) -> list[Pose]:
    """The pose itself, and with a lens that of a detector without it."""
    square = _square(side_mm)
    points = square @ rotation.T + translation_mm
    if not (points[:, 2] > 0.0).all():
        raise FrameError("the tag is not wholly in front of the camera; give the detector's own pose")
    starts = [(rotation, translation_mm)]
    if lens is not None:
        # AprilTag's pose is that of a pinhole camera: its corners are where the picture has them, seen through the lens
        seen = points[:, :2] / points[:, 2:] * matrix[[0, 1], [0, 1]] + matrix[:2, 2]
        starts += _tilts(square, rays_of(seen, matrix, lens)[:, :2])
    return starts


def _tilts(square: FloatArray, seen: FloatArray) -> list[Pose]:
    """Both tilts at which a square seen from afar looks nearly alike, by IPPE (Collins and Bartoli, 2014)."""
    cv2 = library("cv2", "fitting a tag to a picture")

    _, turns, shifts, _ = cv2.solvePnPGeneric(square, np.ascontiguousarray(seen), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    return [(np.asarray(cv2.Rodrigues(turn)[0]), np.ravel(shift)) for turn, shift in zip(turns, shifts, strict=True)]


def _checked(view: View, found: Fitted) -> _Checked:
    """A pose held against the pixels of the tag where it is now, as the picture has them. Raises FrameError as `pixels` does."""
    seen = pixels(view, found.rotation, found.translation_mm, 0.0)
    to_cells = to_cells_of(found.rotation, found.translation_mm, view.cell_mm)
    off, contrast = residual(seen, view, to_cells, max(found.blur_px, 0.2) / seen.px_per_cell, found.grown_cells)
    fit = correlation(seen, off, contrast)
    if fit == 0.0:
        return _Checked(pose=found, agreement=0.0, worst=1.0)
    # differences of neighbours in a row, which are next to each other: noise of the picture, where the misfit changes slowly
    steps = np.diff(off)[np.diff(seen.light[:, 2]) == 0.0]
    noise = min(float(steps @ steps) / (2 * len(steps)) / float(off @ off / len(off)), 1.0) if len(steps) else 0.0
    return _Checked(
        pose=found,
        # a large tag is smoothed for the fit, which takes out what a camera's sharpening adds to its edges
        agreement=max(sqrt(1.0 - (1.0 - fit**2) * (1.0 - noise)), found.fit),
        worst=_worst_spot(hits(seen, to_cells), off / (seen.light @ contrast)),
    )


def _worst_spot(cells: FloatArray, share: FloatArray) -> float:
    """Largest mean over a spot of two by two cells of what pixels differ from the tag: noise of single pixels goes out."""
    cell = np.floor(cells + SIDE_CELLS / 2).astype(int)
    inside = ((cell >= 0) & (cell < SIDE_CELLS)).all(axis=1)
    index = cell[inside, 0] * SIDE_CELLS + cell[inside, 1]
    tables = (np.bincount(index, weights, SIDE_CELLS**2).reshape(SIDE_CELLS, -1) for weights in (None, share[inside]))
    count, total = (t[1:, 1:] + t[1:, :-1] + t[:-1, 1:] + t[:-1, :-1] for t in tables)
    # at the rim there may be few pixels
    enough = count >= max(float(np.median(count)) / 3, 1.0)
    return float(np.abs(total[enough] / count[enough]).max()) if enough.any() else 1.0
