"""Middles of long bodies, between the edges of their tops, which pressure hardly moves.

Where a gel follows bodies closely, their tops are level, and the maximum of a band-pass is where the pressure is highest: in the
elastic simulator, under 0.5 to 10 N, 0.17 to 0.22 mm from the middle of an 0402, most of a displacement, and 0.02 to 0.04 mm from
that of an 0201. Edges are where the depth falls steepest, and stay where the body is: middles between them are off by 0.005 to
0.02 mm. At the contact's rim the gel leaves a top before its outer edge; the inner edge, and the body's length, tell then.
"""

from __future__ import annotations

from math import hypot

import numpy as np

from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.dots.clip import clip
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.rule import GOOD_TRUST, LEAST_GOOD
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.part import TapePart, is_long

LEAST_LENGTH_MM = 0.5
"""A shorter body has few pixels between its edges, and its maximum lies near its middle."""
STEPS, REACH = 16, 19
"""Samples along a body's side, and on each side of a dot: it is on the body, whose edges are at most a side away."""
ASIDE = 0.2
"""Share of a body's other side, on each side of a dot, at which two more lines are sampled."""
LEAST_PX = 0.75
"""Slopes are differences over at least so many pixels on each side: the image between pixels is interpolated."""
WHOLE, FIRST = 0.6, 8
"""Dots from this weight on show how long and how sharp the tops are; so many of them show first whether they are sharp at all."""
SURE = 3.0
"""Standard errors by which the mean elongation must differ from 0 to tell the bodies' direction; that is 6 and more."""
SHORTEST, LONGEST = 0.85, 1.35
"""Bounds of the distance of two edges, over the body's side: beyond them they are something else's."""
IN_PART, IN_FULL = 0.6, 0.9
"""Distances of two edges, over the usual one, between which the outer one goes from not counting to counting as the other."""
SHARP, BLUNT, CLEARLY_BLUNT = 0.42, 0.48, 0.52
"""Heights of tops over their steepest slope and the body's length, between which middles count wholly and not at all, and from
which on the first dots leave no doubt. In the elastic simulator with a blur of 0.04 mm that is 0.38 for 0201 and 0.25 to 0.33 for
0402, with 0.1 mm 0.58 and 0.40. In contacts of the imprint model with a blur of 0.08, 0.1 and 0.15 mm, of 0201 it is 0.40, 0.47
and 0.63, and poses by middles err as much as those by maxima, 1.5 and 3 times as much; of 0402 it is up to 0.44, and they err
less with each."""


def has_edges(part: TapePart | None) -> bool:
    """Whether edges of these bodies are looked for."""
    return part is not None and is_long(part.shape, part.body_mm) and max(part.body_mm[:2]) >= LEAST_LENGTH_MM


def middles(dots: Dots, image: Image, part: TapePart | None, px_per_mm: float, aspect: float) -> tuple[FloatArray, float] | None:
    """Middles of bodies from the maxima of their dots, square pixels (n, 2), and how far they count; None where they do not.

    dots: With `seen_px`.
    image (h, w): The canonical depth map.
    part: The tapes' part; None if they differ.
    px_per_mm: Scale of square pixels.
    aspect: Factor on v that makes the image's pixels square.
    """
    if part is None or dots.elongation is None or dots.seen_px is None or not has_edges(part):
        return None
    seen_px, whole = dots.seen_px, np.empty(len(dots.weights), dtype=np.int64)
    count, c, s = _direction(dots.elongation, dots.weights, dots.trust, whole)
    if count < LEAST_GOOD or c == s == 0.0:
        return None
    # sides of the body, along and across, in square pixels and in those of the image
    whole, length_px, width_px = whole[:count], max(part.body_mm[:2]) * px_per_mm, min(part.body_mm[:2]) * px_per_mm
    along_px = np.array((length_px * c, length_px * s / aspect))
    across_px = np.array((-width_px * s, width_px * c / aspect))
    first = edges_at(image, seen_px.take(whole[:FIRST], 0), along_px, ASIDE * across_px)
    if _sharpness(first) > CLEARLY_BLUNT:
        return None
    edges = edges_at(image, seen_px, along_px, ASIDE * across_px)
    share = min(max((BLUNT - _sharpness(edges.take(whole, 1))) / (BLUNT - SHARP), 0.0), 1.0)
    middle_px = dots.trust @ seen_px / dots.trust.sum()
    along = _between(edges, whole, seen_px, middle_px, along_px) if share > 0.0 else None
    if along is None:
        return None
    on_axis_px = seen_px + along[:, None] * along_px
    across = _between(edges_at(image, on_axis_px, across_px, ASIDE * along_px), whole, seen_px, middle_px, across_px)
    found = np.outer(along, along_px) + (0.0 if across is None else np.outer(across, across_px))
    return found * (1.0, aspect), share


def edges_at(image: Image, seen_px: FloatArray, side_px: FloatArray, aside_px: FloatArray) -> FloatArray:
    """Edges on both sides of points on bodies, (5, n), as `_find_edges` fills them in.

    seen_px (n, 2); side_px, aside_px (2,): A body's side, and the distance of the lines beside it, px of the image.
    """
    out = np.empty((5, len(seen_px)))
    span = min(max(2, round(LEAST_PX * STEPS / hypot(*side_px.tolist()))), REACH - 1)
    _find_edges(image, seen_px, side_px, aside_px, span, np.empty(2 * REACH + 1, dtype=np.float32), out)
    return out


def _sharpness(edges: FloatArray) -> float:
    """Height of the tops over their steepest slope, a length, over the body's side."""
    _, _, rises, falls, height = edges
    return _median(2.0 * height / np.maximum(rises + falls, 1e-30))


def _median(values: FloatArray) -> float:
    """The upper median: `np.median` takes ten times as long."""
    return float(np.sort(values)[len(values) // 2])


def _between(
    edges: FloatArray, whole: IntArray, seen_px: FloatArray, middle_px: FloatArray, side_px: FloatArray
) -> FloatArray | None:
    """Middles (n,) from the points that edges were looked for at, over the body's side; None where those are not as far apart.

    whole: Indices of dots that show how far apart edges are.
    seen_px (n, 2); middle_px, side_px (2,): Dots, the contact's middle and the body's side, px of the image.
    """
    near, far, *_ = edges
    usual = _median((far - near).take(whole))
    if not SHORTEST <= usual <= LONGEST:
        return None
    out = np.empty(len(seen_px))
    _find_between(edges, usual, seen_px, middle_px, side_px, out)
    return out


def rehearse_middles(dots: Dots, image: Image, part: TapePart | None) -> None:
    """Compile the kernels now, so that no frame waits, where there are bodies with edges."""
    if dots.elongation is None or not has_edges(part):
        return
    n, side = len(dots.weights), np.ones(2)
    _direction(dots.elongation, dots.weights, dots.trust, np.empty(n, dtype=np.int64))
    edges = edges_at(image, dots.xy_px, side, side)
    _find_between(edges, 1.0, dots.xy_px, side, side, np.empty(n))


@kernel()
def _direction(elongation: FloatArray, weights: FloatArray, trust: FloatArray, whole: IntArray) -> tuple[int, float, float]:
    """Fill in which dots are whole, and return how many are, and the bodies' direction in the image; zeros where none is sure."""
    count, mean_u, mean_v, squares = 0, 0.0, 0.0, 0.0
    for i in range(len(weights)):
        if weights[i] >= WHOLE and trust[i] >= GOOD_TRUST:
            u, v = elongation[i, 0], elongation[i, 1]
            mean_u, mean_v, squares = mean_u + u, mean_v + v, squares + u * u + v * v
            whole[count] = i
            count += 1
    if count == 0:
        return 0, 0.0, 0.0
    mean_u, mean_v = mean_u / count, mean_v / count
    square = mean_u * mean_u + mean_v * mean_v
    if count * square < SURE * SURE * (squares / count - square) or square == 0.0:
        return count, 0.0, 0.0
    # a top that is longest at an angle phi has the elongation -a (cos 2 phi, sin 2 phi)
    phi = np.arctan2(-mean_v, -mean_u) / 2.0
    return count, np.cos(phi), np.sin(phi)


@kernel(fastmath=True)
def _find_between(
    edges: FloatArray, usual: float, seen_px: FloatArray, middle_px: FloatArray, side_px: FloatArray, out: FloatArray
) -> None:
    """Fill in the middles of `_between`; `usual` is the distance of edges, over the side, of bodies that are seen in full."""
    for i in range(len(out)):
        near, far, of_near, of_far = edges[0, i], edges[1, i], edges[2, i] ** 2, edges[3, i] ** 2
        # where a body is not seen in full, its outer edge is where the gel leaves it
        outer = clip(((far - near) / usual - IN_PART) / (IN_FULL - IN_PART), 0.0, 1.0)
        inwards = (middle_px[0] - seen_px[i, 0]) * side_px[0] + (middle_px[1] - seen_px[i, 1]) * side_px[1]
        if inwards > 0.0:
            of_near *= outer
        else:
            of_far *= outer
        found = (of_near * (near + usual / 2.0) + of_far * (far - usual / 2.0)) / (of_near + of_far + 1e-30)
        out[i] = clip(found, -0.5, 0.5)  # the points are on their bodies


@kernel(fastmath=True)
def _find_edges(
    image: Image, seen_px: FloatArray, side_px: FloatArray, aside_px: FloatArray, span: int, line: Image, out: FloatArray
) -> None:
    """Fill in where the depth rises and falls steepest on either side of each point, both slopes, and its height.

    seen_px (n, 2); side_px, aside_px (2,): As for `edges_at`.
    span: Steps on each side over which a slope is taken.
    line (2 REACH + 1,): A work buffer, in single precision.
    out (5, n): Positions of the edges behind and ahead, in sides of the body from the point; slopes there, towards the point, at
        least 0; and its height over the feet of both. In sides and a third of the image's unit.
    """
    h, w = image.shape
    step_u, step_v = side_px[0] / STEPS, side_px[1] / STEPS
    for i in range(len(seen_px)):
        # beyond the border the image goes on as it ends
        reach_u, reach_v = REACH * abs(step_u) + abs(aside_px[0]), REACH * abs(step_v) + abs(aside_px[1])
        within = reach_u <= seen_px[i, 0] < w - 1 - reach_u and reach_v <= seen_px[i, 1] < h - 1 - reach_v
        for k in range(2 * REACH + 1):
            line[k] = 0.0
        for beside in range(-1, 2):
            u, v = seen_px[i, 0] + beside * aside_px[0] - REACH * step_u, seen_px[i, 1] + beside * aside_px[1] - REACH * step_v
            for k in range(2 * REACH + 1):
                x, y = u + k * step_u, v + k * step_v
                if not within:
                    x, y = clip(x, 0.0, w - 1.01), clip(y, 0.0, h - 1.01)
                column, row = np.int32(x), np.int32(y)
                a, b = np.float32(x - column), np.float32(y - row)
                upper = image[row, column] + a * (image[row, column + 1] - image[row, column])
                lower = image[row + 1, column] + a * (image[row + 1, column + 1] - image[row + 1, column])
                line[k] += upper + b * (lower - upper)
        feet = 0.0
        for ahead in range(2):
            # both sides alike, outwards
            way = 2 * ahead - 1
            steepest, at = 0.0, 0
            for k in range(REACH - span + 1):
                fall = line[REACH + way * (k - span)] - line[REACH + way * (k + span)]
                if fall > steepest:
                    steepest, at = fall, k
            off = 0.0
            if 0 < at < REACH - span:
                before = line[REACH + way * (at - 1 - span)] - line[REACH + way * (at - 1 + span)]
                after = line[REACH + way * (at + 1 - span)] - line[REACH + way * (at + 1 + span)]
                # the vertex of the parabola through three slopes
                bend = 2.0 * steepest - before - after
                off = clip((after - before) / (2.0 * bend), -0.5, 0.5) if bend > 0.0 else 0.0
            foot = line[REACH + way * at]
            for k in range(at, REACH + 1):
                foot = min(foot, line[REACH + way * k])
            out[ahead, i] = way * (at + off) / STEPS
            out[2 + ahead, i] = steepest * STEPS / (2.0 * span)
            feet += foot / 2.0
        out[4, i] = line[REACH] - feet
