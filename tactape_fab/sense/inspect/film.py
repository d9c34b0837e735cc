"""The film in the scan: lands and openings around every part say how the scanner distorts, line by line. Parts do not count.

What the carriage of a scanner does to a line it does to all parts and lands of that line. Their lands are fixed to the film, so
the shift of lands is the scanner's (and the film's), and what remains between a body and its lands is the placement.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.ndimage import shift
from scipy.sparse.linalg import spsolve

from tactape_fab.sense.inspect.align import Template, gradients, learn_template, step
from tactape_fab.sense.inspect.colours import Palette
from tactape_fab.sense.inspect.patches import PatchGrid, Samples, patch_grid, sample
from tactape_fab.sense.inspect.scan_files import Picture
from tactape_fab.sense.inspect.warp import LineShift, Warp, fitted
from tactape_fab.texture.frames import BoolArray, FloatArray
from tactape_fab.texture.tape import Tape

_KNOT_MM = 0.25
"""Distance of the knots of a line shift: half the height of a part, so that a part sees what its own lines do."""
_LEAST_SITES = 40
_UNREFINED_MM = 0.02
"""Scatter and common error of lands that a warp by the tag or the parts alone has, where too few lands are seen to refine it."""
_LEAST_CONTRAST = 20.0
"""Least difference of metal from film, of 255, that samples are counted in: in a grey scan both may be equally bright."""
_SMOOTH = 0.02
_FILM_PX_PER_MM = 40.0
_PASSES = 2
_CENTRINGS = 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilmFit:
    """The warp fitted to the lands.

    ``sigma_mm`` is the robust scatter of their residuals, ``common_mm`` the error of all of them together, along each axis.
    """

    warp: Warp
    sigma_mm: float
    common_mm: float = 0.0


def fit_film(picture: Picture, warp: Warp, tape: Tape, palette: Palette, inside: BoolArray) -> FilmFit:
    """Refine a warp by the lands of all parts in the picture.

    inside (n,): Parts that the picture shows whole.
    """
    length, width, _ = tape.part.body_mm
    # the body and its shadow are left out, so that a part beside its lands does not draw them
    grid = patch_grid(1.2 * length, 1.1 * width, _FILM_PX_PER_MM)
    beyond = (np.abs(grid.a_mm) > length / 2 + 0.07) | (np.abs(grid.b_mm) > width / 2 + 0.07)
    sites = tape.part_xy_mm()[inside]
    turn = np.radians(tape.part.rotation_deg)
    axes = np.array([(np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))])
    sigma_mm = 0.0
    for _ in range(_PASSES):
        channels = _channel(sample(picture, warp, sites, tape.part.rotation_deg, grid), palette)
        template = learn_template(channels, beyond)
        at, seen = (np.concatenate(both) for both in zip(*_lands(channels, template, grid, warp, sites, axes), strict=True))
        if len(at) < 2 * _LEAST_SITES:
            return FilmFit(warp=warp, sigma_mm=_UNREFINED_MM, common_mm=_UNREFINED_MM)
        warp, left = refined(warp, at, seen)
        sigma_mm = 1.4826 * float(np.median(np.abs(left))) / warp.px_per_mm
    return FilmFit(warp=shifted(warp, symmetry_offset(template.value[0], grid, beyond), axes), sigma_mm=sigma_mm)


def _lands(
    channels: Samples, template: Template, grid: PatchGrid, warp: Warp, sites: FloatArray, axes: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Lands of either end of all parts, board points, and the pixels at which they are seen.

    Each end counts by itself, at its own lines: both together see the mean of two lines that are 0.8 mm apart, and a jitter of
    1.6 mm not at all, which parts between them do see.
    """
    steep = np.square(gradients(template.value, grid)).sum(axis=(0, 1))
    for end in (-1, 1):
        here = template.used & (end * grid.a_mm > 0)
        found = step(channels, replace(template, used=here), grid, turns=False)
        moved_mm = found.move[:, :2] @ axes.T  # the land lies here, seen from where the warp has it
        good = (found.gain > 0.3) & (np.abs(moved_mm).max(axis=1) < 0.15)
        # where the samples that decide lie: the mean place along the part, weighted by the squares of the edges' steepness
        at = sites[good] + axes[:, 0] * np.average(grid.a_mm[here], weights=steep[here])
        yield at, _moved(warp, at, moved_mm[good])


def _channel(samples: Samples, palette: Palette) -> Samples:
    """The colour channel in which metal differs most from film, film at 0 and metal at 1; (n, 1, m)."""
    apart = palette.metal - palette.film
    best = int(np.argmax(np.abs(apart)))
    unit = np.copysign(max(abs(apart[best]), _LEAST_CONTRAST), apart[best])
    return ((samples[..., best] - np.float32(palette.film[best])) / np.float32(unit))[:, None]


def _moved(warp: Warp, board_mm: FloatArray, moved_mm: FloatArray) -> FloatArray:
    """Pixels of points that are displaced from the warp's by `moved_mm`."""
    return warp.to_px(board_mm) + (warp.jacobian(board_mm) @ moved_mm[..., None])[..., 0]


def shifted(warp: Warp, offset_mm: FloatArray, axes: FloatArray) -> Warp:
    """The warp moved by an offset in the parts' axes."""
    # columns are px per mm of board x and y
    linear = warp.coefficients[1:3].T / warp.half_mm
    coefficients = warp.coefficients.copy()
    coefficients[0] += linear @ (axes @ offset_mm)
    return replace(warp, coefficients=coefficients)


def refined(warp: Warp, board_mm: FloatArray, seen_px: FloatArray) -> tuple[Warp, FloatArray]:
    """The warp refitted to points seen at pixels: polynomial, then shifts of lines and columns; and residuals, px, (n, 2)."""
    gate = 0.1 * warp.px_per_mm
    bare = replace(warp, lines=())
    # polynomial first: what is smooth over the whole scan is no jitter of lines
    bare, _ = fitted(bare, board_mm, seen_px, gate_px=gate)
    lines: list[LineShift] = []
    left = seen_px - bare.smooth(board_mm)
    # from the residuals first the part that depends on v, a shift of lines, then that of columns
    for axis in (1, 0):
        line = _line_shift(seen_px[:, axis], left, axis, _KNOT_MM * warp.px_per_mm)
        lines.append(line)
        left = left - line.at(seen_px)
    return replace(bare, lines=tuple(lines)), left


def _line_shift(at_px: FloatArray, left_px: FloatArray, axis: int, knot_px: float) -> LineShift:
    """Piecewise linear fit with a pull to straightness, robust; a knot that few lands are near stays near its neighbours."""
    start = float(at_px.min())
    knots = max(int(np.ceil((at_px.max() - start) / knot_px)) + 1, 3)
    empty = LineShift(axis=axis, start_px=start, step_px=knot_px, value_px=np.zeros((knots, 2)))
    before, share = empty.weights(at_px)
    n = len(at_px)
    rows = np.arange(n)
    # linear interpolation: each land has two knots, with weights that add up to 1
    a = sparse.csr_array(
        (np.concatenate([1 - share, share]), (np.tile(rows, 2), np.concatenate([before, before + 1]))), (n, knots)
    )
    ones = np.ones(knots - 1)
    slope = sparse.diags_array([-ones, ones], offsets=[0, 1], shape=(knots - 1, knots))
    per_knot = n / knots
    noise = 1.4826 * np.median(np.abs(left_px), axis=0)
    scale = np.maximum(noise, 1e-3)
    weight = np.ones((n, 2))
    value = np.zeros((knots, 2))
    for _ in range(3):
        for k in range(2):
            w = sparse.diags_array(weight[:, k])
            # a step between knots is worth as much as the mean of the lands between them is good to
            normal = (a.T @ w @ a + _SMOOTH * per_knot * (slope.T @ slope) + 1e-3 * per_knot * sparse.eye_array(knots)).tocsc()
            value[:, k] = spsolve(normal, a.T @ (weight[:, k] * left_px[:, k]))
        off = np.abs(left_px - a @ value) / scale
        # lands off by several scatters hardly count, in either direction by itself
        weight = 1.0 / (1.0 + (off / 3.0) ** 2) ** 2
    return replace(empty, value_px=value)


def symmetry_offset(picture: FloatArray, grid: PatchGrid, mask: BoolArray) -> FloatArray:
    """Where the centre of a two-fold symmetric picture lies in its grid, (a, b) mm, from the steepness of its edges.

    The mask is about the grid's centre and so pulls the answer there; the picture is moved under it until both agree. With
    one round lands were 1.3 um off across the parts, beside their shadows.
    """
    centred = picture.reshape(grid.shape)
    offset = np.zeros(2)
    for _ in range(_CENTRINGS):
        # rows are b, columns a
        at = shift(centred, -offset[::-1] / grid.step_mm, order=3, mode="nearest")
        offset = offset + _symmetry_step(at, grid, mask)
    return offset


def _symmetry_step(picture: FloatArray, grid: PatchGrid, mask: BoolArray) -> FloatArray:
    """One round of `symmetry_offset`.

    Edges alone count, whatever their contrast: a soft shadow or a bright side does not move them. The third power of the
    steepness keeps to where an edge is steepest: its square takes in a shadow's slope, which moved bodies by 2 um.
    """
    db, da = np.gradient(picture, grid.step_mm)
    steep = (np.square(da) + np.square(db)) ** 1.5 * mask.reshape(grid.shape)
    turned = steep[::-1, ::-1]
    # correlation with itself turned by half a turn: it is largest at twice the centre's offset, with rows and columns counted
    # round
    both = np.fft.irfft2(np.fft.rfft2(steep) * np.conj(np.fft.rfft2(turned)), s=steep.shape)
    reach = max(2, int(0.08 / grid.step_mm))
    rows, cols = np.arange(-reach, reach + 1), np.arange(-reach, reach + 1)
    near = both[np.ix_(rows % both.shape[0], cols % both.shape[1])]
    # a neighbour on each side for the parabola
    i, j = (int(np.clip(k, 1, 2 * reach - 1)) for k in np.unravel_index(int(near.argmax()), near.shape))
    di, dj = _vertex(near[i - 1 : i + 2, j]), _vertex(near[i, j - 1 : j + 2])
    return np.array([cols[j] + dj, rows[i] + di]) * grid.step_mm / 2


def _vertex(three: FloatArray) -> float:
    bend = three[0] - 2 * three[1] + three[2]
    return 0.0 if bend >= 0 else float(np.clip(0.5 * (three[0] - three[2]) / bend, -0.5, 0.5))
