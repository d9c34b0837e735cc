"""The printed tag, fitted to the pixels of a picture: its pose, with blur, ink that has run, and the light that is best for each.

Poses are rotation matrices (3, 3) and translations (3,), mm, of the tag in the camera's frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, hypot, pi, sqrt
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import FrameError
from tactape_fab.base.libraries import library
from tactape_fab.sense.objects.tag_view import rays_of
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tag import CODE_CELLS, SIDE_CELLS, tag_cells

_PX_PER_CELL = 16
_PAD_CELLS = 2
_RING_SHARE = 0.5
"""Fraction of the light ring that is used: beyond it may be film, or the label."""
_BLUR_PX = 0.7
_MOST_STEPS, _LONGEST_STEP_CELLS = 25, 0.5
_MOST_TURNS, _LONGEST_TURN_RAD = 100, 0.2
"""Steps of the picture's fit and of a pose's: right ones take 3 to 25, and 2 to 24."""
_LEAST_PIXELS, _MOST_PIXELS = 60, 1_000_000
_MOST_COLUMNS = 30_000
"""OpenCV's remap counts columns in 16 bits."""
_ENOUGH = 1e-3
"""Iteration ends where a step gains less than this share of a pixel's noise, which moves by a thirtieth of what is uncertain."""
_CERTAIN = 4.0
"""Standard deviations by which a border that lies beside its place does so for certain."""
_PART = 0.02
"""Difference of the logarithm of the blur, and of growth in cells, by which slopes are taken."""
_MOST_BLEED = 0.3
"""Largest growth or shrinkage of light areas, in cells."""

Pose = tuple[FloatArray, FloatArray]
"""Rotation (3, 3) and translation (3,), mm."""
_S = TypeVar("_S")
GrayImage = npt.NDArray[np.uint8]
_F32 = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """Pixels of the tag: their rays (n, 3) and grey levels (n,); pixels per cell; standard deviation of their smoothing.

    ``light`` (n, 3) is 1 and each pixel's place, -1 to 1: brightness and contrast of uneven light, to first order.
    """

    rays: FloatArray
    levels: FloatArray
    light: FloatArray
    px_per_cell: float
    smoothed_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A picture, its camera, and the tag that is looked for in it."""

    picture: GrayImage
    matrix: FloatArray
    lens: FloatArray | None
    tag_id: int
    cell_mm: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flat:
    """Where the rays of a picture meet the tag's plane, held to no pose: both tilts of it look nearly so.

    to_cells (3, 3): From rays to cells from the tag's centre, homogeneous.
    unit (3, 3): From rays to places of -1 to 1, in which the eight numbers of ``to_cells`` are of one size.
    information (8, 8): How the sum of squares grows with these numbers.
    squares: Sum of squares of the residuals.
    blur_cells, grown_cells: Blur of the smoothed picture, and by how many cells light areas have grown.
    border_cells: By how many cells, for certain, half a side of the border lies further in or out than all other edges say.
    """

    to_cells: FloatArray
    unit: FloatArray
    information: FloatArray
    squares: float
    blur_cells: float
    grown_cells: float
    border_cells: float


def pixels(view: View, rotation: FloatArray, translation_mm: FloatArray, smoothing_cells: float) -> Seen:
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
        # pixels a deviation apart have all that is left: of a wave of two of them it leaves e^(-pi^2 / 2), a hundredth
        thin = max(int(smoothed_px), 1)
        u, v = u[(u % thin == 0) & (v % thin == 0)], v[(u % thin == 0) & (v % thin == 0)]
    return Seen(
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


@lru_cache(maxsize=4)
def _blurred(tag_id: int, ln_blur_cells: float, grown_cells: float) -> _F32:
    """The printed tag as a camera blurs it."""
    cv2 = library("cv2", "fitting a tag to a picture")

    # a pixel at distance d of a straight edge is covered by d + 0.5, from 0 to 1
    light = np.clip((_printed(tag_id) + np.float32(grown_cells)) * _PX_PER_CELL + 0.5, 0.0, 1.0)
    return np.asarray(cv2.GaussianBlur(light, (0, 0), float(np.exp(ln_blur_cells)) * _PX_PER_CELL), dtype=np.float32)


@lru_cache(maxsize=4)
def _slopes(tag_id: int, ln_blur_cells: float, grown_cells: float) -> tuple[_F32, ...]:
    """The blurred tag; by how much it rises per cell to the right, per cell down, with ln of the blur and per cell of growth."""
    tag = _blurred(tag_id, ln_blur_cells, grown_cells)
    down, right = np.gradient(tag, 1.0 / _PX_PER_CELL)
    wider = (_blurred(tag_id, ln_blur_cells + _PART, grown_cells) - tag) / np.float32(_PART)
    further = (_blurred(tag_id, ln_blur_cells, grown_cells + _PART) - tag) / np.float32(_PART)
    return tag, np.asarray(right), np.asarray(down), wider, further


def _drawn(cells: FloatArray, pictures: tuple[_F32, ...]) -> FloatArray:
    """Values of pictures of the printed tag at places of it (n, 2), in cells from its centre; shape (pictures, n)."""
    cv2 = library("cv2", "fitting a tag to a picture")

    # integers at the centres of the printed picture's pixels
    at = ((cells + SIDE_CELLS / 2 + _PAD_CELLS) * _PX_PER_CELL - 0.5).astype(np.float32)
    lots = np.array_split(at, len(at) // _MOST_COLUMNS + 1)
    found = [[np.ravel(cv2.remap(one, lot[None, :, 0], lot[None, :, 1], cv2.INTER_LINEAR)) for lot in lots] for one in pictures]
    return np.asarray([np.concatenate(parts) for parts in found], dtype=np.float64)


def residual(
    seen: Seen, view: View, to_cells: FloatArray, blur_cells: float, grown_cells: float
) -> tuple[FloatArray, FloatArray]:
    """Residuals of the grey levels, in the best light; and the contrast, with its slopes (3,)."""
    (shape,) = _drawn(hits(seen, to_cells), (_blurred(view.tag_id, float(np.log(blur_cells)), grown_cells),))
    # brightness, contrast and their slopes are linear: for each pose the best ones are put in at once (variable projection)
    design = np.hstack([seen.light, seen.light * shape[:, None]])
    best = least_squares(design, seen.levels)
    return seen.levels - design @ best, best[3:]


def least_squares(design: FloatArray, levels: FloatArray) -> FloatArray:
    # by the normal equations, whose columns are of one size: a tenth of the time of an SVD of all pixels
    return np.asarray(np.linalg.lstsq(design.T @ design, design.T @ levels, rcond=1e-12)[0])


def first_blur_cells(seen: Seen) -> float:
    """The blur that a fit begins with."""
    return hypot(_BLUR_PX, seen.smoothed_px) / seen.px_per_cell


def fit_at(seen: Seen, view: View, rotation: FloatArray, translation_mm: FloatArray) -> float:
    """Correlation of the picture with the printed tag at a given pose."""
    to_cells = to_cells_of(rotation, translation_mm, view.cell_mm)
    return correlation(seen, *residual(seen, view, to_cells, first_blur_cells(seen), 0.0))


def correlation(seen: Seen, off: FloatArray, contrast: FloatArray) -> float:
    """Correlation of grey levels with the tag, apart from what a slope of brightness explains; 0 where light areas are darker."""
    flat = seen.levels - seen.light @ least_squares(seen.light, seen.levels)
    whole = float(flat @ flat)
    if not (whole > 0.0 and (seen.light @ contrast).min() > 0.0):
        return 0.0
    return sqrt(max(1.0 - float(off @ off) / whole, 0.0))


def to_cells_of(rotation: FloatArray, translation_mm: FloatArray, cell_mm: float) -> FloatArray:
    """From rays to cells from the tag's centre where they meet its plane, homogeneous (3, 3)."""
    return np.linalg.inv(np.column_stack([cell_mm * rotation[:, :2], translation_mm]))


def hits(seen: Seen, to_cells: FloatArray) -> FloatArray:
    """Where the pixels' rays meet the tag's plane, in cells from its centre (n, 2)."""
    hit = seen.rays @ to_cells.T
    return np.asarray(hit[:, :2] / hit[:, 2:])


def _look(seen: Seen, view: View, places: FloatArray, values: FloatArray, borders: bool = False) -> tuple[FloatArray, FloatArray]:
    """Residuals in the best light; their slopes by `values`, and on request by how far in each half of a side of the border lies.

    places (n, 3): Of pixels, -1 to 1, and 1.
    values (10,): Eight of the matrix from them to cells, whose last is 1; ln of the blur in cells; growth of light areas, cells.
    """
    matrix = np.append(values[:8], 1.0).reshape(3, 3)
    hit = places @ matrix.T
    x, y = cells = hit[:, :2].T / hit[:, 2]
    shape, right, down, wider, further = _drawn(cells.T, _slopes(view.tag_id, float(values[8]), float(values[9])))
    design = np.hstack([seen.light, seen.light * shape[:, None]])
    best = least_squares(design, seen.levels)
    ahead = places / hit[:, 2:]
    rise = [right[:, None] * ahead, down[:, None] * ahead, -(right * x + down * y)[:, None] * ahead[:, :2], wider[:, None]]
    rise.append(further[:, None])
    if borders:
        # an edge that moves in by so much of a cell adds a line of light as wide, blurred
        blur, half = float(np.exp(values[8])), CODE_CELLS / 2
        for along, across in ((y, x), (y, -x), (x, y), (x, -y)):
            line = np.exp(-0.5 * ((across - half) / blur) ** 2) / (blur * sqrt(2 * pi)) * (np.abs(along) < half)
            rise.append(line[:, None] * np.column_stack([along < 0.0, along >= 0.0]))
    slopes = (seen.light @ best[3:])[:, None] * np.hstack(rise)
    # the light follows: what of a slope it can make up for goes out (Kaufman, 1975)
    return seen.levels - design @ best, design @ least_squares(design, slopes) - slopes


def _descended(
    look: Callable[[_S], tuple[FloatArray, FloatArray]], move: Callable[[_S, FloatArray], _S], at: _S, steps: int, count: int
) -> _S:
    """Where a sum of squares is least, by Levenberg-Marquardt; `count` numbers share it where it is noise alone."""
    (off, slopes), damping = look(at), 1e-3
    for _ in range(steps):
        before = float(off @ off)
        # Marquardt's damping is relative to each unknown's own curvature
        size = np.sqrt((slopes * slopes).sum(axis=0)) + 1e-12
        scaled = slopes / size
        step = -np.linalg.solve(scaled.T @ scaled + (damping + 1e-12) * np.eye(len(size)), scaled.T @ off) / size
        moved = move(at, step)
        new, new_slopes = look(moved)
        gain = before - float(new @ new)
        if not gain > 0.0:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        at, off, slopes, damping = moved, new, new_slopes, max(damping / 10.0, 1e-9)
        if gain < _ENOUGH * before / count:
            break
    return at


def fitted(seen: Seen, view: View, rotation: FloatArray, translation_mm: FloatArray) -> Flat:
    """The printed tag as the picture has it, from one start: anything flat, whose eight numbers are nearly linear in the picture.

    Poses are not: they lie along a narrow bent valley, in which 7 of 23 tags of 4 mm were 4 to 12 degrees off after 40 steps.
    """
    middle, half = (seen.rays.max(axis=0) + seen.rays.min(axis=0)) / 2, np.ptp(seen.rays, axis=0)[:2].max() / 2
    unit = np.array([(1 / half, 0.0, -middle[0] / half), (0.0, 1 / half, -middle[1] / half), (0.0, 0.0, 1.0)])
    places = seen.rays @ unit.T
    matrix = to_cells_of(rotation, translation_mm, view.cell_mm) @ np.linalg.inv(unit)
    low, high = np.log(hypot(0.2, seen.smoothed_px) / seen.px_per_cell), np.log(2.0)

    def move(at: FloatArray, step: FloatArray) -> FloatArray:
        moved = at + step * (_LONGEST_STEP_CELLS / max(float(np.abs(step[:8]).max()), _LONGEST_STEP_CELLS))
        moved[8], moved[9] = np.clip(moved[8], low, high), np.clip(moved[9], -_MOST_BLEED, _MOST_BLEED)
        return moved

    start = np.array([*(matrix / matrix[2, 2]).ravel()[:8], np.log(first_blur_cells(seen)), 0.0])
    values = _descended(lambda at: _look(seen, view, places, at), move, start, _MOST_STEPS, len(places))
    off, slopes = _look(seen, view, places, values, borders=True)
    normal = slopes.T @ slopes
    size = np.sqrt(np.diag(normal)) + 1e-12
    covariance = np.linalg.pinv(normal / np.outer(size, size), hermitian=True) / np.outer(size, size)
    step = -covariance @ slopes.T @ off
    left = off + slopes @ step
    error = np.sqrt(np.diag(covariance) * float(left @ left) / len(left))
    # what blur and growth can make up for is not known of the plane
    with_light = np.linalg.lstsq(normal[8:10, 8:10], normal[8:10, :8], rcond=1e-12)[0]
    return Flat(
        to_cells=np.append(values[:8], 1.0).reshape(3, 3) @ unit,
        unit=unit,
        information=normal[:8, :8] - normal[:8, 8:10] @ with_light,
        squares=float(off @ off),
        blur_cells=float(np.exp(values[8])),
        grown_cells=float(values[9]),
        border_cells=float((np.abs(step) - _CERTAIN * error)[10:].max()),
    )


def posed(flat: Flat, count: int, cell_mm: float, rotation: FloatArray, translation_mm: FloatArray) -> tuple[Pose, float]:
    """The pose that is most like what is seen, from one start, and its sum of squares of `count` pixels."""
    cv2 = library("cv2", "fitting a tag to a picture")

    weights, axes = np.linalg.eigh(flat.information)
    root = (axes * np.sqrt(np.maximum(weights, 0.0))).T
    back = np.linalg.inv(flat.unit)

    def numbers(matrix: FloatArray) -> FloatArray:
        return np.asarray((matrix / matrix[2, 2]).ravel()[:8])

    wanted = numbers(flat.to_cells @ back)
    noise = sqrt(flat.squares)

    def look(at: Pose) -> tuple[FloatArray, FloatArray]:
        turn, shift = at
        whole = to_cells_of(turn, shift, cell_mm)
        matrix = whole @ back
        # d A^-1 = -A^-1 dA A^-1, of a turn of the tag's axes about each of the camera's and of a shift in units of the distance
        rates = np.zeros((6, 3, 3))
        rates[:3, :, :2] = cell_mm * np.cross(np.eye(3)[:, None], turn[:, :2].T).transpose(0, 2, 1)
        rates[3:, :, 2] = np.eye(3) * shift[2]
        changes = -whole @ rates @ matrix
        slopes = (changes - matrix * changes[:, 2:, 2:] / matrix[2, 2]) / matrix[2, 2]
        off = root @ (numbers(matrix) - wanted)
        # what no pose can take off stands with it, so that a gain is measured by the noise of the pixels
        return np.append(off, noise), np.vstack([root @ slopes.reshape(6, 9)[:, :8].T, np.zeros(6)])

    def move(at: Pose, step: FloatArray) -> Pose:
        step = step * (_LONGEST_TURN_RAD / max(float(np.abs(step).max()), _LONGEST_TURN_RAD))
        return np.asarray(cv2.Rodrigues(step[:3])[0]) @ at[0], at[1] + step[3:] * at[1][2]

    pose = _descended(look, move, (rotation, translation_mm), _MOST_TURNS, count)
    off, _ = look(pose)
    return pose, float(off @ off)
