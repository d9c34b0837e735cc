"""All places of all registered tapes for the dots of one grid, a prior among them if there is one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, exp, log

import numpy as np

from tactape_fab.decode.match import Floats, TapePlanes, others, score_places, turned
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.tape import Tape

_FAR_BELOW = 30.0
PRIOR_SHARE = 0.5
"""Weight of the places near a prior; the other half is spread over all places, so that a wrong prior cannot deceive."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Prior:
    """Where the contact is believed to be, such as the last fix: a place within a radius and a range of angles.

    Attributes
    ----------
    position_mm : (float, float)
        S on the texture.
    theta_deg : float
    radius_mm : float
    angle_deg : float
        Largest difference of theta.
    tape : str or None
        Name of the tape; None for any.
    """

    position_mm: tuple[float, float]
    theta_deg: float
    radius_mm: float = 2.0
    angle_deg: float = 10.0
    tape: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Place:
    """The best place for the dots of one grid.

    Attributes
    ----------
    score : float
        ln of its evidence E, times its weight over that of a place far from the prior.
    weight : float
        ln of the weight of a place far from the prior: ln(1 / places) without one.
    tape : int
    turn : int
        Quarter turns.
    cells : ndarray of int, shape (n, 2)
        Column and row of each dot on the tape; outside it for dots that hang over.
    other_sum, other_best : float
        Sum of weighted E over all other places as a share of this one's, and ln of the largest, as `score`.
    turns : tuple of (cells, evidence)
        Of the four quarter turns, for `rivals`.
    """

    score: float
    weight: float
    tape: int
    turn: int
    cells: IntArray
    other_sum: float
    other_best: float
    turns: tuple[tuple[IntArray, FloatArray], ...]


def search(
    tapes: Sequence[Tape],
    planes: Sequence[TapePlanes],
    nodes: IntArray,
    q: FloatArray,
    grid: FloatArray,
    centre_px: FloatArray,
    prior: Prior | None,
) -> Place | None:
    """Score every origin and quarter turn on every tape.

    Parameters
    ----------
    nodes, q, grid
        From `symbols.fit_grid` and `symbols.posteriors`.
    centre_px : ndarray, shape (2,)
        The image centre from the origin of the dots' coordinates.

    Returns
    -------
    Place or None
        None where the dots reach farther than any contact.
    """
    pad = planes[0].pad
    turns, lows, scored = [], [], []
    for turn in range(4):
        cells, evidence = turned(nodes, q, turn)
        low = cells.min(axis=0)
        cells = cells - low
        if cells.max() >= pad:
            return None
        turns.append((cells, evidence))
        lows.append(low)
        scored += [(score_places(p.planes, pad, cells, evidence), index, turn) for index, p in enumerate(planes)]
    places = float(sum(scores.size for scores, _, _ in scored))
    weight = -log(places)
    if prior is not None and _add_prior(scored, tapes, lows, grid, centre_px, prior, pad, places):
        weight += log(1.0 - PRIOR_SHARE)
    tops = [int(scores.argmax()) for scores, _, _ in scored]
    values = [float(scores.flat[top]) for (scores, _, _), top in zip(scored, tops, strict=True)]
    answer = int(np.argmax(values))
    total, largest = 0.0, -np.inf
    for k, (scores, _, _) in enumerate(scored):
        if k != answer and values[k] < values[answer] - _FAR_BELOW:
            share, most = scores.size * exp(values[k] - values[answer]), values[k]  # all counted as the best of them
        else:
            share, most = others(scores, values[answer], tops[k] if k == answer else -1)
        total += share
        largest = max(largest, most)
    scores, index, turn = scored[answer]
    row, column = divmod(tops[answer], scores.shape[1])
    return Place(
        score=values[answer],
        weight=weight,
        tape=index,
        turn=turn,
        cells=turns[turn][0] + np.array([column - pad, row - pad]),
        other_sum=total,
        other_best=largest,
        turns=tuple(turns),
    )


def _add_prior(
    scored: list[tuple[Floats, int, int]],
    tapes: Sequence[Tape],
    lows: list[IntArray],
    grid: FloatArray,
    centre_px: FloatArray,
    prior: Prior,
    pad: int,
    places: float,
) -> bool:
    """Raise the places near a prior by what their weight exceeds the others'; False where there are none."""
    near = []
    for scores, index, turn in scored:
        tape = tapes[index]
        theta_deg = degrees(float(np.arctan2(grid[1], grid[0]))) + 90.0 * turn
        if prior.tape not in (None, tape.name) or abs((theta_deg - prior.theta_deg + 180.0) % 360.0 - 180.0) > prior.angle_deg:
            continue
        first = _turned_point(grid, centre_px, turn) - lows[turn]  # the image centre, in cells from the dots' corner
        x = (np.arange(scores.shape[1]) - pad + first[0]) * tape.pitch_mm - prior.position_mm[0]
        y = (np.arange(scores.shape[0]) - pad + first[1]) * tape.pitch_mm - prior.position_mm[1]
        inside = np.hypot(*np.meshgrid(x, y)) <= prior.radius_mm
        if inside.any():
            near.append((scores, inside))
    count = sum(int(inside.sum()) for _, inside in near)
    if count == 0:
        return False
    gain = np.float32(log(1.0 + PRIOR_SHARE / (1.0 - PRIOR_SHARE) * places / count))
    for scores, inside in near:
        scores[inside] += gain
    return True


def _turned_point(grid: FloatArray, point_px: FloatArray, turn: int) -> FloatArray:
    """A point in columns and rows of the grid after a quarter turn, as `match.turned` has it."""
    a, b, x, y = grid
    dx, dy = point_px[0] - x, point_px[1] - y
    norm = a * a + b * b
    k, j = (a * dx + b * dy) / norm, (a * dy - b * dx) / norm
    return np.array([(k, j), (j, -k), (-k, -j), (-j, k)][turn])
