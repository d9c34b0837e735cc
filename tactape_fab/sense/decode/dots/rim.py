"""Dots before the grid is known: which belong to the contact, and how far its slope shifted those at its rim inwards."""

from __future__ import annotations

import numpy as np

from tactape_fab.base.jit import inner_kernel, kernel
from tactape_fab.sense.decode.dots.clip import clip
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.dots.kth import select
from tactape_fab.sense.decode.rule import LEAST_TRUST
from tactape_fab.texture.frames import BoolArray, FloatArray

STRONG = 0.5
"""Dots from this weight on show where the contact is."""
LEVEL_FROM = 0.7
"""Most dots from this weight on are fully imprinted: their median is the level of fully imprinted dots."""
LEAST_SCATTER, MOST_SCATTER = 0.07, 0.2
"""Bounds of the relative standard deviation of the heights of fully imprinted dots."""
BELIEVED_SCATTERS = 2.0
"""Noise explains a height up to so many standard deviations below a fully imprinted dot's; the rim explains the rest."""
PULL = 0.2
"""Shift of a dot inwards by the rim, in pitches per unit of missing weight."""
ONE_SIDED = 0.35
"""From this length of the mean unit vector to its neighbours on, a dot counts as one at the rim, all neighbours on one side."""
SUPPORT, SUPPORT_STEP = 0.3, 0.05
"""Least support of a dot of the contact, where a neighbour one pitch away counts 1/4; width of the logistic step."""
COMPANY, LONELY, CROWDED, HOLE = 0.8, -5.0, -4.0, -5.0
"""Log odds that a dot is a part: with neighbours, with none, with a higher dot too near to be another part, and with a height too
low for a part surrounded by others."""
AMID, AMID_STEP = 0.45, 0.05
"""A dot is surrounded if the mean unit vector to its neighbours is shorter than this; width of the logistic step."""
LOW_SCATTERS, LOW_STEP = 6.0, 0.04
"""A surrounded part is not lower by so many standard deviations than a fully imprinted one; width of the step, in weight."""
NEAREST = 0.9
"""Of two dots nearer than this share of the least distance of two parts, the lower one is no part."""
_SAME = 1e-9


def settled(dots: Dots, pitch_px: float, shift: float) -> Dots:
    """Dots of the contact: noise rejected, weights relative to fully imprinted dots, and positions at the rim corrected.

    A part on the rim is imprinted less on its outer side. Its relief is the product of imprint and bump, whose maximum lies
    where the relative slopes of both cancel: inwards of the bump's own maximum by the squared width of the bump times the
    relative slope of the imprint. The imprint falls from 1 to 0 within less than a pitch, too fast to be seen in the
    neighbours' heights, but its relative slope grows as it falls; `PULL` is between that of a steep and of a gentle rim.
    Inwards is where the neighbours are. Surrounded dots, and dots no lower than noise explains, are not moved.

    Noise is spread over the whole image, and parts stand a pitch apart. So a low dot with neighbours as on a grid is more likely
    a part than its height alone says; one without neighbours, or too near a higher one, is not.

    dots: `xy_px` in square pixels.
    pitch_px: As the sensor's profile has it.
    shift: Displacement as a share of the pitch.
    """
    if len(dots.weights) == 0:
        return dots
    n = len(dots.weights)
    xy, share, trust, buffer = np.empty((n, 2)), np.empty(n), np.empty(n), np.empty((4, n))
    _settle(dots.xy_px, dots.weights, dots.trust, pitch_px, NEAREST * (1.0 - 2.0 * shift), buffer, xy, share, trust)
    seen_px = dots.xy_px if dots.seen_px is None else dots.seen_px
    dots = Dots(xy_px=xy, weights=share, trust=trust, elongation=dots.elongation, seen_px=seen_px)
    return chosen(dots, trust >= LEAST_TRUST)


def chosen(dots: Dots, kept: BoolArray) -> Dots:
    """Some of the dots."""
    which = kept.nonzero()[0]
    return Dots(
        xy_px=dots.xy_px.take(which, 0),
        weights=dots.weights.take(which),
        trust=dots.trust.take(which),
        elongation=None if dots.elongation is None else dots.elongation.take(which, 0),
        seen_px=None if dots.seen_px is None else dots.seen_px.take(which, 0),
        small=dots.small,
        high=dots.high,
    )


@inner_kernel(fastmath=True)
def _level(weights: FloatArray, trust: FloatArray, heights: FloatArray) -> tuple[float, float]:
    """Weight of a fully imprinted dot, and relative scatter of such weights, from the upper half, which no rim lowers."""
    n = 0
    for i in range(len(weights)):
        if weights[i] > LEVEL_FROM and trust[i] > 0.5:
            heights[n] = weights[i]
            n += 1
    half = n // 2
    if half < 2:
        return 1.0, LEAST_SCATTER
    # weights are heights over an ordinary good dot's: a level above that is chance, or of a caller's own weights
    level = clip(select(heights[:n], half), 0.0, 1.0)
    upper = 0.0
    for k in range(half, n):
        upper += heights[k]
    # the mean of a normal variable above its median is 0.8 standard deviations from it
    scatter = 1.25 * (upper / (n - half) / level - 1.0)
    return level, clip(scatter, LEAST_SCATTER, MOST_SCATTER)


@kernel(fastmath=True)
def _settle(
    xy: FloatArray,
    weights: FloatArray,
    trust: FloatArray,
    pitch_px: float,
    nearest: float,
    buffer: FloatArray,
    moved: FloatArray,
    share: FloatArray,
    believed: FloatArray,
) -> None:
    """Fill in positions, weights relative to a fully imprinted dot (at most 1), and trust; `buffer` is a work buffer."""
    n = len(weights)
    xs, ys, heights, amounts = buffer[0], buffer[1], buffer[2], buffer[3]
    level, scatter = _level(weights, trust, heights)
    strong = 0
    for i in range(n):
        share[i] = clip(weights[i] / level, 0.0, 1.0)
        moved[i, 0], moved[i, 1] = xy[i, 0], xy[i, 1]
        if weights[i] >= STRONG:
            # strong dots are the neighbours of all others: places in pitches, heights, and weights as trust times height
            xs[strong], ys[strong] = xy[i, 0] / pitch_px, xy[i, 1] / pitch_px
            heights[strong], amounts[strong] = weights[i], trust[i] * share[i]
            strong += 1
    for i in range(n):
        x, y = xy[i, 0] / pitch_px, xy[i, 1] / pitch_px
        u = v = support = crowd = 0.0
        for k in range(strong):
            du, dv = xs[k] - x, ys[k] - y
            # `_SAME` keeps the dot's distance from itself above 0, against division by zero; below it identifies the dot itself
            square = du * du + dv * dv + _SAME
            crowd += 1.0 if square < nearest * nearest and heights[k] > weights[i] else 0.0
            distance = np.sqrt(square)
            # weight 1 / (1 + r^2)^2; divided by r, so that u and v sum unit vectors
            near = amounts[k] / ((1.0 + square) * (1.0 + square) * distance)
            near = near if square > 2.0 * _SAME else 0.0  # the dot itself
            support += near * distance
            u += near * du
            v += near * dv
        # length of the mean direction: near 0 amid neighbours, near 1 with all of them to one side
        mean = np.sqrt(u * u + v * v) / (support + 1e-9)
        # at one pitch the weight is 1/4: a whole neighbour gives 0.25, less than SUPPORT, two of them 0.5
        company = 1.0 / (1.0 + np.exp((SUPPORT - support) / SUPPORT_STEP))
        gain = LONELY + (COMPANY - LONELY) * company + (CROWDED if crowd > 0.0 else 0.0)
        low = 1.0 - share[i]
        if low > LOW_SCATTERS * scatter - 4.0 * LOW_STEP:  # below this the step is under 2 %
            hole = 1.0 / (1.0 + np.exp((mean - AMID) / AMID_STEP))
            gain += HOLE * company * hole / (1.0 + np.exp((LOW_SCATTERS * scatter - low) / LOW_STEP))
        # Bayes' rule: log odds add up
        odds = trust[i] * np.exp(gain)
        believed[i] = odds / (odds + 1.0 - trust[i])
        low -= BELIEVED_SCATTERS * scatter
        if low > 0.0:
            # outwards, away from the neighbours; amid others (u, v) is short, and so is the shift
            # (u, v) / support has the length `mean`: at a rim the shift is PULL low pitches however one-sided the neighbours
            # are, and from `ONE_SIDED` down it falls with the mean
            pull = PULL * pitch_px * low / clip(mean, ONE_SIDED, np.inf) / (support + 1e-9)
            moved[i, 0] -= pull * u
            moved[i, 1] -= pull * v
