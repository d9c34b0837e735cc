"""Dots before the grid is known: which of them are of the contact, and how far its slope has drawn those at its rim inwards."""

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
"""Dots from this weight on are more often wholly imprinted than not: their median is the level of those that are."""
LEAST_SCATTER, MOST_SCATTER = 0.07, 0.2
"""Bounds of the relative scatter of heights of wholly imprinted dots."""
BELIEVED_SCATTERS = 2.0
"""Scatters below the height of a whole dot that noise explains; the rest of a dot's missing height is the rim's."""
PULL = 0.2
"""Shift of a dot inwards by the rim, in pitches per unit of missing weight."""
ONE_SIDED = 0.35
"""A dot whose neighbours' directions leave this mean stands at the rim, with them all to one side."""
SUPPORT, SUPPORT_STEP = 0.3, 0.05
"""Neighbours that a dot of the contact has at least, where one at a pitch counts 1/4; width of the step."""
COMPANY, LONELY, CROWDED, HOLE = 0.8, -5.0, -4.0, -5.0
"""Terms of the log odds that a dot is a part: for neighbours, for none, for one too near to be another part, and for a height
that no part amid others has."""
AMID, AMID_STEP = 0.45, 0.05
"""A dot is amid others where their directions, each of length 1, have a shorter mean than this; width of the step."""
LOW_SCATTERS, LOW_STEP = 6.0, 0.04
"""Scatters below the whole height from which no part amid others is; width of the step, in weight."""
NEAREST = 0.9
"""Share of the least distance of two parts below which the lower dot is none."""
_SAME = 1e-9


def settled(dots: Dots, pitch_px: float, shift: float) -> Dots:
    """Dots as a contact has them: noise beside it left out, heights over those of whole dots, those at the rim put back.

    A part on the rim is imprinted less on its outer side. Its top is that of a product, imprint times bump, and lies where
    the relative slopes of both cancel: off the bump's own top by the bump's width squared times the relative slope of
    the imprint, inwards. The imprint falls from 1 to 0 within less than a pitch, too fast to be seen in the
    neighbours' heights; but however it falls, its relative slope grows meanwhile, and `PULL` is between that of a steep and
    of a gentle rim.
    Inwards is where the neighbours are. Dots amid others, or no lower than noise makes them, are left where they are.

    Noise is spread over the whole image, parts stand a pitch apart: a low dot with the neighbours of a grid is more likely
    a part than its height alone says, one with none, or one too near a higher one, is none.

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
    """Weight of a wholly imprinted dot, and relative scatter of such weights: from the upper half, which no rim lowers."""
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
    """Fill in places, weights over that of a whole dot (at most 1), and trust; `buffer` is overwritten."""
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
            # `_SAME` keeps the dot's distance from itself above 0, so that there is no division by it; it is told by it below
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
        # Bayes' rule in odds: the prior's log odds and the terms add up
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
