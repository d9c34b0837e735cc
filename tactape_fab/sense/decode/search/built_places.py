"""Evidence of places on tapes whose parts were measured: each dot is compared with its part's measured position.

A place h of such a tape assigns a part to every dot, and so the offset d(h) of that part from the design. The grid is fitted to
the dots minus d(h), and the posteriors of the symbols come from that fit: `fit.fit_grid` and `rule.posteriors` with known
offsets. Neither uses the symbols that h names, and measured offsets do not depend on the code. So for a texture independent of
the code the named bits are still fair coins, E(h) = product of 2 q(b) has the mean 1, and the bound of `rule` holds. The
hypothesis that the parts are where the design has them keeps a share of the place's weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, inf, log

import numpy as np

from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.grid.fit import HALF, Fit
from tactape_fab.sense.decode.rule import (
    GOOD_WEIGHT,
    LEAST_DOTS,
    LEAST_SIGMA,
    MOST_SIGMA,
    OUTLIER_SHARE,
    USUAL_COUNT,
    USUAL_SIGMA,
    WRONG_SHARE,
    squared_errors,
)
from tactape_fab.sense.decode.search.evidence import columns_by_symbol
from tactape_fab.sense.decode.search.families import Family
from tactape_fab.sense.decode.search.search import Place
from tactape_fab.sense.decode.search.single_place import NO_PART, places_near, shown_by
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray, SymbolArray
from tactape_fab.texture.tape import Tape

LN_SHARE, LN_REST = log(0.9), log(0.1)
"""ln of the prior weights of a tape's measured places, and of the design's: the file may be of another copy of the tape."""
CANDIDATES = 64
"""Number of places, those of most evidence by the design, that are weighed anew unless the best one is clear. Of 100 contacts of
6.5 mm with parts placed to 0.1 mm, 96 are located with so many, and with 2,000."""
CLEAR = 10.0
"""No other place is weighed anew if the best one's evidence is at most so much (ln) below the largest possible: one wrong dot in
another place costs ln 500 and more."""
CREDIT, MOST_CREDIT = 0.5, log(1000.0)
"""Share of the ln by which dots are likelier where parts were measured, whatever their symbols, that counts against other places,
and the most of it. All of it is a likelihood ratio, 2 to 3 a dot where parts are placed to 0.1 mm; chosen, as that is only as
good as the Gaussian errors. In p_tape none of it counts."""
LN_DOUBT = log(1000.0)
"""ln by which dots have to fit the design better before the measured places are taken for those of another copy. Of parts that
scatter by nothing on a film that is stretched by 0.3 % one contact in twenty fits the design better by 10 to 30: it was off by
0.2 mm with a standard deviation of 1 um."""
STEPS = 6
"""Steps of the grid's fit."""
_TO_GRID = np.array([[[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]], dtype=np.float64)
"""Texture vectors in the grid's axes, for each quarter turn; the inverse of `evidence.turned`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Built:
    """Measured positions of the parts of a tape, by grid point.

    shift_mm (rows, columns, 2): From the design's place, texture frame.
    sigma_mm (rows, columns): Standard deviation along each axis, of each part alone.
    present (rows, columns)
    shown (rows, columns): From `single_place.shown_by`, without the parts that are missing.
    drift_mm: Standard deviation along each axis of the error that neighbouring parts share.
    """

    shift_mm: FloatArray
    sigma_mm: FloatArray
    present: BoolArray
    shown: SymbolArray
    drift_mm: float


def built_of(tape: Tape) -> Built | None:
    """Measured places of a tape; None if there are none."""
    if tape.as_built is None:
        return None
    parts, placed = tape.built_parts(), tape.placed
    shift, sigma, present = np.zeros((*placed.shape, 2)), np.zeros(placed.shape), np.zeros(placed.shape, dtype=bool)
    shift[placed] = parts.shift_mm * (1.0, -1.0)  # board +y is up, texture +y down
    drift = tape.as_built.drift_mm
    # the common error of neighbours shifts a contact as a whole: it is no error of a dot relative to its grid, and is added to
    # the pose's covariance (`accept_place`)
    sigma[placed], present[placed] = np.sqrt(np.maximum(parts.sigma_mm**2 - drift**2, 0.0)), parts.present
    shown = np.where(present, shown_by(tape), NO_PART).astype(np.uint8)
    return Built(shift_mm=shift, sigma_mm=sigma, present=present, shown=shown, drift_mm=drift)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Places:
    """Some places: tape, turn (k,), cells of the dots (k, n, 2), ln of the weight (k,)."""

    tape: IntArray
    turn: IntArray
    cells: IntArray
    weight: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Evidence:
    """Of places: ln of the evidence (k,), other terms of the log likelihood (k,), posteriors of symbols (k, n, directions)."""

    score: FloatArray
    credit: FloatArray
    q: FloatArray


def as_built(
    place: Place,
    q: FloatArray,
    fit: Fit,
    xy: FloatArray,
    dots: Dots,
    design: tuple[float, float],
    free_scale: bool,
    tapes: Sequence[Tape],
    built: Sequence[Built | None],
    families: Sequence[Family],
) -> tuple[Place, FloatArray]:
    """The best place where the parts of some tapes were measured, and the symbols as they are there.

    place: The best one by the design.
    q (n, directions): Symbols by the design.
    fit: The grid by the design.
    xy (n, 2): Dots that it was fitted to.
    design: Pitch in mm, and displacement as a share of it.
    free_scale: Whether the pitch in px may change.
    tapes, built: Registered tapes, and what was measured of each.
    """
    by_design = _design_odds(fit, dots)
    own = _Places(
        tape=np.array([place.tape]),
        turn=np.array([place.turn]),
        cells=place.cells[None],
        weight=np.array([place.weight]),
    )
    found, measured = own, built[place.tape] is not None
    evidence = _weighed(own, fit, xy, dots, by_design, design, free_scale, tapes, built) if measured else None
    score, clear = (place.score, _most(q)) if evidence is None else (float(evidence.score[0]), _most(evidence.q[0]))
    if score < clear - CLEAR:
        found = _candidates(place, own, tapes, built, families)
        if len(found.tape):
            evidence = _weighed(found, fit, xy, dots, by_design, design, free_scale, tapes, built)
    # a tape that was measured has a tenth of its weight at the design's places, nine tenths at the measured ones
    share = LN_REST if measured else 0.0
    nominal = place.score + place.weight + share
    likely = np.array([-inf]) if evidence is None else evidence.score + evidence.credit + found.weight
    at = int(likely.argmax())
    if evidence is None or likely[at] + LN_SHARE <= nominal:
        best = _by_design(replace(place, score=place.score + share), share, found, evidence)
        # both say that it is this place; only where its parts stand is in question, and how far they are off together no dot says
        of = built[place.tape]
        if evidence is None or of is None or not _is_at(place, found)[at] or likely[at] + LN_SHARE + LN_DOUBT <= nominal:
            return best, q
        return replace(best, as_built=True, shown=of.shown), evidence.q[at]
    best, symbols = _best(place, found, evidence)
    of = built[best.tape]
    return best if of is None else replace(best, shown=of.shown), symbols


def _by_design(place: Place, share: float, found: _Places, evidence: _Evidence | None) -> Place:
    """The best place by the design, compared with all others by the design, and with some by what was measured."""
    others, lead = place.others * exp(-share), place.lead + share
    if evidence is not None:
        cue = np.log(place.turn_weights)
        # the same place is no rival, wherever its parts stand
        rival = ~_is_at(place, found)
        likely = (evidence.score + evidence.credit + LN_SHARE)[rival]
        others += float(np.exp(likely + found.weight[rival] - place.weight - place.score).sum())
        strongest = float((likely + cue[found.turn[rival]]).max(initial=-inf))
        lead = min(lead, place.score + float(cue[place.turn]) - strongest)
    return replace(place, others=others, lead=lead)


def _is_at(place: Place, found: _Places) -> BoolArray:
    """Which of some places is this one; (k,)."""
    return np.asarray((found.tape == place.tape) & (found.turn == place.turn) & (found.cells == place.cells).all(axis=(1, 2)))


def _best(place: Place, found: _Places, evidence: _Evidence) -> tuple[Place, FloatArray]:
    """The likeliest of some places, compared with all others: by the design, and by what was measured."""
    cue = np.log(place.turn_weights)
    likely = evidence.score + evidence.credit
    at = int((likely + found.weight).argmax())
    same = bool(_is_at(place, found)[at])
    mine, rest = float(likely[at]), np.delete(likely, at)
    # all places by the design, in multiples of the answer; the best of them is a rival if it is not the answer
    others = (place.others + (not same)) * exp(min(place.score + place.weight - float(found.weight[at]) - mine, 600.0))
    others += float(np.exp(np.minimum(rest + np.delete(found.weight, at) - float(found.weight[at]) - mine, 600.0)).sum())
    # the strongest place but the answer: by the design the next best, or the design's best itself where that is another place
    strongest = place.score + float(cue[place.turn]) - (place.lead if same else min(place.lead, 0.0))
    strongest = max(strongest, float((rest + cue[np.delete(found.turn, at)]).max(initial=-inf)))
    best = replace(
        place,
        score=float(evidence.score[at]) + LN_SHARE,
        weight=float(found.weight[at]),
        tape=int(found.tape[at]),
        turn=int(found.turn[at]),
        cells=found.cells[at],
        others=others * exp(-LN_SHARE),
        lead=mine + float(cue[found.turn[at]]) + LN_SHARE - strongest,
        as_built=True,
        credit=float(evidence.credit[at]),
    )
    return best, evidence.q[at]


def _candidates(
    place: Place, own: _Places, tapes: Sequence[Tape], built: Sequence[Built | None], families: Sequence[Family]
) -> _Places:
    """The places of most evidence by the design on tapes that were measured, the best one among them."""
    rows = []
    for of, (family, t) in enumerate(zip(families, place.tables, strict=True)):
        for tape in family.tapes:
            if built[tape] is None:
                continue
            size = np.array([tapes[tape].columns, tapes[tape].rows])
            for turn in range(4):
                # a reach beyond all of the tape: every place of it
                cells, values = places_near(t, shown_by(tapes[tape]), turn, np.zeros(2), float(size.sum() + 1000), LEAST_DOTS)
                over = (~((cells >= 0) & (cells <= size - t.size[turn])).all(axis=1)).astype(np.int64)
                row = np.column_stack([np.broadcast_to([of, tape, turn], (len(cells), 3)), cells, over])
                few = np.argsort(-values, kind="stable")[:CANDIDATES]
                rows.append((row[few], values[few], place.weights[turn, over[few]]))
    if not rows:
        return own
    where, nominal, weight = (np.concatenate([row[k] for row in rows]) for k in range(3))
    best = np.argsort(-(nominal + weight), kind="stable")[:CANDIDATES]
    where, weight = where[best], weight[best]
    cells = np.stack(
        [place.tables[of].cells[turn] + at for of, turn, at in zip(where[:, 0], where[:, 2], where[:, 3:5], strict=True)]
    )
    # the answer by the design may have more weight, of a prior
    places = _Places(tape=where[:, 1], turn=where[:, 2], cells=cells, weight=weight)
    return replace(places, weight=np.where(_is_at(place, places), np.maximum(weight, place.weight), weight))


def _design_odds(fit: Fit, dots: Dots) -> tuple[FloatArray, FloatArray]:
    """Of each dot the probability that it is a part, 0 unless the likeliest on its grid point, and ln of its density; (n,)."""
    likely = dots.trust * dots.weights
    same = (fit.nodes[:, None] == fit.nodes).all(axis=2)
    order = np.arange(len(likely))
    ahead = (likely > likely[:, None]) | ((likely == likely[:, None]) & (order < order[:, None]))
    # one part a grid point, as in `fit._fill_posteriors`
    part = np.where((same & ahead).any(axis=1), 0.0, dots.trust * (1.0 - OUTLIER_SHARE))
    variance = squared_errors(dots.weights, fit.sigma)
    # the mean over the symbols, a priori equally likely: the density marginalised over the symbol
    density = np.exp(-0.5 * fit.squares / variance[:, None]).mean(axis=1) / (2.0 * np.pi * variance)
    return part, np.log(part * density + 1.0 - part)


def _most(q: FloatArray) -> float:
    """Ln of the largest evidence that these posteriors can give."""
    return float(np.log(q.max(axis=1) * q.shape[1]).sum())


def _weighed(
    places: _Places,
    fit: Fit,
    xy: FloatArray,
    dots: Dots,
    by_design: tuple[FloatArray, FloatArray],
    design: tuple[float, float],
    free_scale: bool,
    tapes: Sequence[Tape],
    built: Sequence[Built | None],
) -> _Evidence:
    """Evidence of places by what was measured; each has its own grid."""
    pitch_mm, shift = design
    directions = fit.squares.shape[1]
    inside, symbol, off, own = _looked_up(places, tapes, built)
    off = np.einsum("kij,knj->kni", _TO_GRID[places.turn], off) / pitch_mm
    # the place's own variance, pitches squared; added to that of the dot
    own = (own / pitch_mm) ** 2
    part = by_design[0] * inside
    around = shift * _around(directions)
    variance, squares = _fitted(fit, xy, dots, part, off, own, around, free_scale)
    density = np.exp(-0.5 * squares / variance[..., None]) / (2.0 * directions * np.pi * variance[..., None])
    total = part * density.sum(axis=2) + 1.0 - part
    q = (part[..., None] * density + (1.0 - part[..., None]) / directions) / total[..., None]
    q = (1.0 - WRONG_SHARE) * q + WRONG_SHARE / directions
    named = np.take_along_axis(q, columns_by_symbol(directions)[places.turn[:, None], symbol][..., None], axis=2)[..., 0]
    # E with 4 q(symbol), of eight directions 8 q, in place of 2 q(b) for each bit: its mean is 1 as well where all symbols are
    # alike. A dot off the parts has the factor 1
    score = (np.log(directions * named) * inside).sum(axis=1)
    # a place where the dots are less likely than by the design, whatever their symbols, is worth less; the bound still holds
    likelier = ((np.log(total) - by_design[1]) * inside).sum(axis=1)
    credit = np.minimum(CREDIT * np.maximum(likelier, 0.0), MOST_CREDIT)
    return _Evidence(score=score + np.minimum(likelier, 0.0), credit=credit, q=q)


def _fitted(
    fit: Fit,
    xy: FloatArray,
    dots: Dots,
    part: FloatArray,
    off: FloatArray,
    own: FloatArray,
    around: FloatArray,
    free_scale: bool,
) -> tuple[FloatArray, FloatArray]:
    """`fit._fitted` for parts with known offsets: variances (k, n) and squared distances (k, n, directions), pitches squared."""
    k = len(part)
    point = fit.nodes + off
    grid = np.tile(fit.grid, (k, 1))
    # the design's grid is where all dots together are: what their parts are off together, as by a film's stretch, is in it, and
    # may be as much as a part is displaced
    mean = np.einsum("kn,kni->ki", part, off) / np.maximum(part.sum(axis=1), 1e-300)[:, None]
    grid[:, 2] -= grid[:, 0] * mean[:, 0] - grid[:, 1] * mean[:, 1]
    grid[:, 3] -= grid[:, 1] * mean[:, 0] + grid[:, 0] * mean[:, 1]
    sigma = np.full(k, MOST_SIGMA)
    good = dots.weights >= GOOD_WEIGHT
    for step in range(STEPS + 1):
        a, b = grid[:, :1], grid[:, 1:2]
        du, dv = xy[:, 0] - grid[:, 2:3], xy[:, 1] - grid[:, 3:4]
        norm = a * a + b * b
        left = np.stack([(a * du + b * dv) / norm, (a * dv - b * du) / norm], axis=2) - point
        apart = left[:, :, None] - around
        squares = (apart**2).sum(axis=3)
        variance = np.stack([squared_errors(dots.weights, float(s)) for s in sigma]) + own
        if step == STEPS:
            break
        # over the nearest place's, so that no sum of all is 0 where a dot is far from each
        at = np.exp(-0.5 * (squares - squares.min(axis=2, keepdims=True)) / variance[..., None])
        total = at.sum(axis=2)
        density = part * total * np.exp(-0.5 * squares.min(axis=2) / variance) / (2.0 * len(around) * np.pi * variance)
        fits = density / (density + 1.0 - part + 1e-300)
        share = at / total[..., None]
        grid = _moved(xy, point + share @ around, fits / variance, grid, free_scale)
        if step > 0:
            # two axes of the parts' own variance are known, and no error of the dots
            excess = np.maximum((share * squares).sum(axis=2) - 2.0 * own, 0.0)
            square = USUAL_COUNT * USUAL_SIGMA**2 + (fits * excess)[:, good].sum(axis=1)
            count = USUAL_COUNT + 2.0 * fits[:, good].sum(axis=1)
            sigma = np.clip(np.sqrt(square / count), LEAST_SIGMA, MOST_SIGMA)
    return variance, squares


def _moved(xy: FloatArray, ideal: FloatArray, weight: FloatArray, grid: FloatArray, free_scale: bool) -> FloatArray:
    """`fit._moved` for many grids: (k, n, 2), (k, n) and (k, 4)."""
    total = np.maximum(weight.sum(axis=1), 1e-300)
    middle, seen = (
        np.einsum("kn,kni->ki", weight, values) / total[:, None] for values in (ideal, np.broadcast_to(xy, ideal.shape))
    )
    u, p = ideal - middle[:, None], xy - seen[:, None]
    along = (weight * (u * p).sum(axis=2)).sum(axis=1)
    across = (weight * (u[..., 0] * p[..., 1] - u[..., 1] * p[..., 0])).sum(axis=1)
    square = np.maximum((weight * (u * u).sum(axis=2)).sum(axis=1), 1e-12)
    a, b = along / square, across / square
    length, before = np.hypot(a, b), np.hypot(grid[:, 0], grid[:, 1])
    # of a place that does not fit hardly a dot has weight: its grid stays as it was
    usable = np.isfinite(length) & (length > 0.5 * before) & (length < 2.0 * before)
    if not free_scale:
        a, b = a * before / np.maximum(length, 1e-300), b * before / np.maximum(length, 1e-300)
    moved = np.stack(
        [a, b, seen[:, 0] - (a * middle[:, 0] - b * middle[:, 1]), seen[:, 1] - (b * middle[:, 0] + a * middle[:, 1])], 1
    )
    return np.where(usable[:, None], moved, grid)


def _looked_up(
    places: _Places, tapes: Sequence[Tape], built: Sequence[Built | None]
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """Of each dot at some places: 1 if a part is there, its symbol, its offset from the design (texture frame, mm), its sigma."""
    k, n = places.cells.shape[:2]
    inside, symbol = np.zeros((k, n)), np.zeros((k, n), dtype=np.int64)
    off, own = np.zeros((k, n, 2)), np.zeros((k, n))
    for index in np.unique(places.tape).tolist():
        measured, tape = built[index], tapes[index]
        if measured is None:
            continue
        which = places.tape == index
        column, row = places.cells[which, :, 0], places.cells[which, :, 1]
        on = (column >= 0) & (column < tape.columns) & (row >= 0) & (row < tape.rows)
        column, row = np.clip(column, 0, tape.columns - 1), np.clip(row, 0, tape.rows - 1)
        inside[which] = on & measured.present[row, column]
        symbol[which] = tape.symbols[row, column]
        off[which] = measured.shift_mm[row, column] * on[..., None]
        own[which] = measured.sigma_mm[row, column]
    return inside, symbol, off, own


def _around(directions: int) -> FloatArray:
    """Unit vectors of the places round a grid point, in the order of `Fit.squares`; shape (directions, 2)."""
    if directions == 4:
        return np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
    h = float(HALF)
    return np.array([(1.0, 0.0), (h, h), (0.0, 1.0), (-h, h), (-1.0, 0.0), (-h, -h), (0.0, -1.0), (h, -h)])
