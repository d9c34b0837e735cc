"""All places of all registered tapes for the dots of one grid, with those near a prior if there is one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, inf, log, nextafter

import numpy as np

from tactape_fab.sense.decode.rule import LEAST_DOTS, PRIOR_SHARE, place_weights
from tactape_fab.sense.decode.search.all_places import weigh_sites
from tactape_fab.sense.decode.search.evidence import Tables, tables_of
from tactape_fab.sense.decode.search.families import Family
from tactape_fab.sense.decode.search.groups import Groups, Weights, count_places, groups_of
from tactape_fab.sense.decode.search.matrices import LARGEST_CONTACT, Matrices, weigh_matrices
from tactape_fab.sense.decode.search.prior import Prior, near_prior, raised_by
from tactape_fab.sense.decode.search.single_place import NO_PART, evidence_at, shown_by
from tactape_fab.sense.decode.search.tally import (
    BEST,
    BOUNDED,
    LEFT_OUT,
    NEGLIGIBLE,
    NEXT_STRONGEST,
    STRONGEST,
    TOTAL,
    Tally,
    new_tally,
)
from tactape_fab.texture.frames import FloatArray, IntArray, SymbolArray
from tactape_fab.texture.tape import Tape

PLENTY = 0.05
"""From this weight of the other places on, as a multiple of the answer's, p_place is too large in any case: the search ends."""
_SAYS_NOTHING = 0.0
"""ln of the weighted evidence below which p_tape is 1: how many other places fit as badly is not counted."""
PRECISION = 1e-5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Place:
    """The best place for the dots of one grid.

    score: ln of its evidence E.
    weight: ln of its weight, all places of all registered tapes together weighing 1.
    tape, turn: Registered tape; quarter turns.
    cells (n, 2): Column and row of each dot on the tape; outside it for dots that hang over.
    shown (rows, columns): The tape's symbols, from `single_place.shown_by`.
    others: Weighted evidence of all other registered places together, as a multiple of this one's; infinite where it was not
        counted, as this place says nothing.
    lead: ln of how much likelier the dots are here than at any other registered place, whatever the weights; no more than that
        where `others` is infinite.
    most_evidence: ln of the most evidence that the dots could give anywhere.
    tables, groups: Of each family, for `rivals.rivals`.
    turn_weights (4,)
    weights (4, 2): From `place_weights`, for the places of registered tapes.
    as_built: Whether the dots were compared with measured places of the tape's parts.
    credit: ln of what these speak for it against places that were not, beyond the symbols.
    """

    score: float
    weight: float
    tape: int
    turn: int
    cells: IntArray
    shown: SymbolArray
    others: float
    lead: float
    most_evidence: float
    tables: tuple[Tables, ...]
    groups: tuple[Groups, ...]
    turn_weights: FloatArray
    weights: FloatArray
    as_built: bool = False
    credit: float = 0.0


def search(
    tapes: Sequence[Tape],
    families: Sequence[Family],
    nodes: IntArray,
    q: FloatArray,
    turn_weights: FloatArray,
    grid: FloatArray,
    centre_px: FloatArray,
    prior: Prior | None,
    precision: float = PRECISION,
    *,
    least: float = -inf,
    built: bool = False,
) -> Place | None:
    """Compare soft symbols with every place and quarter turn on every registered tape.

    nodes, q, grid: From `fit.fit_grid` and `fit.posteriors`.
    turn_weights (4,): How likely each quarter turn is by anything but the symbols; sums to 1.
    centre_px (2,): The image centre from the origin of the dots' coordinates.
    precision: Largest error of `Place.others`, upward, where it matters.
    least: ln of the least weighted evidence of a place that is of use; without effect where there is a prior, or `built`.
    built: Whether the parts of some tapes were measured, and their places are weighed anew.
    Returns: None where the dots reach farther than any contact, or no place has enough of them on a tape or is of use.
    """
    tables = tuple(tables_of(nodes, q, family.signs, LARGEST_CONTACT) for family in families)
    if len(tables[0].dots[0]) == 1:  # the tables are empty: beyond `LARGEST_CONTACT`
        return None
    groups = tuple(groups_of(t, family.registered.sizes, LEAST_DOTS) for t, family in zip(tables, families, strict=True))
    counts = count_places(groups, [family.registered.classes for family in families])
    near = None if prior is None else near_prior(tapes, families, tables, grid, centre_px, prior)
    base = place_weights(counts, turn_weights, 1.0 if near is None else 1.0 - PRIOR_SHARE)
    # L = E times how likely the turn is by the shape of the dots: only in L, never in E (docs/trust.md)
    cue = np.log(turn_weights)
    without, raised = (np.empty(0), np.empty(0)) if near is None else raised_by(near, turn_weights, base)
    # where parts were measured, or near a prior, a place may say more than is found here
    floor = -inf if built or near is not None else least
    fits = -inf if built or (raised >= _SAYS_NOTHING).any() else max(_SAYS_NOTHING, nextafter(floor, inf))
    every = list(zip(tables, groups, families, strict=True))
    negligible = NEGLIGIBLE
    for last in (False, True):
        tallies = [_weighed(*of, Weights(base, cue), new_tally(floor, negligible, fits=fits)) for of in every]
        sums = [tally.sums.tolist() for tally in tallies]
        of = max(range(len(sums)), key=lambda k: sums[k][BEST])
        best, answer = sums[of][BEST], (of, *tallies[of].best_place[:4].tolist())
        if answer[1] < 0:
            return None
        for k, s in enumerate(sums):
            if best >= fits and s[TOTAL] == inf:  # a family says nothing: what it weighs beside another that does
                tallies[k] = _weighed(*every[k], Weights(base, cue), new_tally(best, negligible))
                sums[k] = tallies[k].sums.tolist()
        # the sum of pi L over all places, in multiples of the best (docs/trust.md)
        total = sum(s[TOTAL] * exp(s[BEST] - best) for s in sums)
        bounded = sum(s[BOUNDED] * exp(s[BEST] - best) for s in sums)
        enough = enough_of(precision, best)
        # places that are only bounded make p_place too large: done if that is little, or if p_place is large in any case
        if last or bounded <= enough or (near is None and total - 1.0 > PLENTY):  # else what was left out may count
            break
        negligible = strict_of(groups, enough)
    if near is not None:
        # these places are already in the total with their weight without the prior: only the increase by the prior is added
        top = int(raised.argmax())
        if raised[top] > best:
            answer, total, best = tuple(near.places[top].tolist()), total * exp(best - float(raised[top])), float(raised[top])
        total += float((np.exp(raised - best) - np.exp(without - best)).sum())
    of, turn, site, column, row = answer
    tape = families[of].tapes[site]
    symbols = shown_by(tapes[tape])
    score, _ = evidence_at(tables[of], symbols, turn, column, row)
    most = tables[of].most[turn, :, -1, -1]
    return Place(
        score=score,
        weight=best - score,
        tape=tape,
        turn=turn,
        cells=tables[of].cells[turn] + np.array([column, row]),
        shown=symbols,
        others=max(total - 1.0, 0.0),
        lead=score + float(cue[turn]) - _next_best(tallies, sums, answer),
        most_evidence=float(most[0] + most[1]),
        tables=tables,
        groups=groups,
        turn_weights=turn_weights,
        weights=base,
    )


def rehearse_search(families: Sequence[Family], directions: int) -> None:
    """Call every kernel that a search of these tapes needs, with a single dot, which is nowhere."""
    nodes, q = np.zeros((1, 2), dtype=np.int64), np.full((1, directions), 1.0 / directions)
    base, cue = np.zeros((4, 2)), np.zeros(4)
    for family in families:
        tables = tables_of(nodes, q, family.signs, LARGEST_CONTACT)
        groups = groups_of(tables, family.registered.sizes, LEAST_DOTS)
        count_places([groups], [family.registered.classes])
        evidence_at(tables, np.full((1, 1), NO_PART, dtype=np.uint8), 0, 0, 0)
        if isinstance(family.registered, Matrices):
            weigh_matrices(tables, family.registered, LEAST_DOTS, base, cue, new_tally())
            continue
        for sites in (family.registered, family.unregistered):
            if sites is not None:
                weigh_sites(tables, sites, groups, Weights(base, cue), new_tally())


def _weighed(tables: Tables, groups: Groups, family: Family, weights: Weights, tally: Tally) -> Tally:
    """A tally with the registered places of a family in it."""
    if isinstance(family.registered, Matrices):
        weigh_matrices(tables, family.registered, LEAST_DOTS, weights.place, weights.turn, tally)
    else:
        weigh_sites(tables, family.registered, groups, weights, tally)
    return tally


def enough_of(precision: float, ln_bound: float) -> float:
    """Allowed error of p_place: a tenth of what p_tape = exp(-ln_bound) leaves of max_p_false, at least 1 % of `precision`."""
    return max(precision - 0.1 * exp(-max(ln_bound, 0.0)), 0.01 * precision)


def strict_of(groups: Sequence[Groups], precision: float) -> float:
    """Negligible share (ln) of one group, so that all groups together add at most a tenth of `precision`."""
    return log(precision) - log(10.0 * sum(len(g.fields) for g in groups) + 1.0)


def _next_best(tallies: Sequence[Tally], sums: Sequence[list[float]], answer: tuple[int, ...]) -> float:
    """Ln L of the strongest registered place other than the answer; `sums` are those of the tallies."""
    values = []
    for k, (tally, s) in enumerate(zip(tallies, sums, strict=True)):
        is_answer = k == answer[0] and tuple(tally.strongest_place[:4].tolist()) == answer[1:]
        values += [s[NEXT_STRONGEST if is_answer else STRONGEST], s[LEFT_OUT]]
    return max(values)
