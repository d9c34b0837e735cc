"""All places of the tapes that nobody registered, compared with the best registered one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, inf, log

import numpy as np

from tactape_fab.sense.decode.rule import place_weights
from tactape_fab.sense.decode.search.all_places import weigh_sites
from tactape_fab.sense.decode.search.evidence import Tables
from tactape_fab.sense.decode.search.families import Family
from tactape_fab.sense.decode.search.groups import Groups, Weights, count_places
from tactape_fab.sense.decode.search.plane_sites import FIRST, LAST, SECTOR, TAPES, Sites
from tactape_fab.sense.decode.search.search import PLENTY, PRECISION, Place, enough_of, strict_of
from tactape_fab.sense.decode.search.tally import (
    BEST,
    BOUNDED,
    LEFT_OUT,
    NEGLIGIBLE,
    ROUNDING,
    STRONGEST,
    TOTAL,
    Tally,
    new_tally,
)
from tactape_fab.texture.frames import FloatArray

_RIVALS_SHARE = 0.02
"""exp(`NEGLIGIBLE`) over the allowed error, where dots may hang over the edges of unregistered tapes: there are so many groups
of places then that half of the contacts of 7x7 mm and fewer were searched two or three times."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rivals:
    """Unregistered tapes, compared with the best place.

    weight: Weighted evidence of all their places together, as a multiple of the answer's.
    lead: ln of how much likelier the dots are at the answer than at any of them.
    score: ln E of the strongest.
    name: Sector and code of the strongest.
    """

    weight: float
    lead: float
    score: float
    name: str


_NO_RIVALS = Rivals(weight=0.0, lead=inf, score=-inf, name="")


def rivals(
    families: Sequence[Family],
    place: Place,
    share: float,
    precision: float = PRECISION,
    least_lead: float = 0.0,
    *,
    beyond: bool = True,
) -> Rivals:
    """Compare the dots of an answer with every place of the unregistered tapes.

    share: Weight of all of them together; the registered ones have the rest.
    precision: Largest error of `Rivals.weight`, upward, where it matters.
    least_lead: A lead (ln) that is smaller is not told from bounds.
    beyond: Whether dots may hang over the edges of tapes at default origins.
    """
    others = _unregistered(families, place, beyond=beyond)
    if not others:
        return _NO_RIVALS
    cue, base = np.log(place.turn_weights), _unregistered_weights(others, place, share)
    # from this ln L on a rival would take the answer's lead: such a place is looked at, however little it weighs
    likely = place.score + float(cue[place.turn]) - least_lead - ROUNDING if least_lead > 0.0 else inf
    enough = enough_of(precision, place.score + place.weight)
    strict = strict_of(place.groups, enough)
    negligible = max(min(NEGLIGIBLE, log(_RIVALS_SHARE * enough)), strict) if beyond else NEGLIGIBLE
    while True:
        found, bounded = _NO_RIVALS, 0.0
        for t, g, sites, family in others:
            tally = new_tally(place.score + place.weight, negligible, likely)
            weigh_sites(t, sites, g, Weights(base, cue), tally)
            found = _strongest(found, tally, family, place, cue)
            # the tally's sums are multiples of its own best, which a strong rival has raised; 600 keeps exp from overflowing
            bounded += float(tally.sums[BOUNDED]) * exp(min(tally.sums[BEST] - place.score - place.weight, 600.0))
        if bounded <= enough or found.weight - bounded > PLENTY or negligible <= strict:
            return found
        # bounds add up in proportion to the share: half of what is allowed is aimed at
        negligible = max(negligible - log(2.0 * bounded / enough), strict)


def best_unregistered(families: Sequence[Family], place: Place, share: float, least_score: float) -> Rivals:
    """The unregistered tape that fits best, if its evidence (ln) reaches `least_score`: for answers that are refused in any case.

    `weight` is a bound, and `lead` is over the places found only; if none reaches the score, both are of the evaluated places.
    """
    others = _unregistered(families, place, beyond=False)
    if not others:
        return _NO_RIVALS
    cue, base = np.log(place.turn_weights), _unregistered_weights(others, place, share)
    even = np.where(np.isfinite(base), 0.0, base)  # every place counts by its evidence
    found = _NO_RIVALS
    for t, g, sites, family in others:
        tapes = (sites.classes[:, LAST] - sites.classes[:, FIRST]) * sites.classes[:, TAPES]
        # each single place has to reach the score: a group's number of places is set so that its product with the fewest tapes
        # of a class is 1
        single = np.column_stack([g.limits[:, :2], np.full(len(g.limits), -log(tapes.min()))])
        tally = new_tally(least_score, negligible=-ROUNDING)
        weigh_sites(t, sites, g._replace(limits=single), Weights(even, cue), tally)
        tally.sums[LEFT_OUT] = -inf
        tally.sums[BEST] += base.max()
        found = _strongest(found, tally, family, place, cue)
    return found


_Others = list[tuple[Tables, Groups, Sites, Family]]


def _unregistered(families: Sequence[Family], place: Place, *, beyond: bool) -> _Others:
    """Tables, groups and sites of the families of which there are tapes that nobody registered."""
    found = []
    for t, g, family in zip(place.tables, place.groups, families, strict=True):
        sites = family.beyond if beyond else family.unregistered
        if sites is not None:
            found.append((t, g, sites, family))
    return found


def _unregistered_weights(others: _Others, place: Place, share: float) -> FloatArray:
    """`place_weights` of the tapes that nobody registered, in multiples of what the registered ones have."""
    counts = count_places([g for _, g, _, _ in others], [sites.classes for _, _, sites, _ in others])
    return place_weights(counts, place.turn_weights, share / (1.0 - share))


def _strongest(found: Rivals, tally: Tally, family: Family, place: Place, cue: FloatArray) -> Rivals:
    """The rivals found so far together with those of a tally of another family."""
    weight = found.weight + float(tally.sums[TOTAL]) * exp(min(tally.sums[BEST] - place.score - place.weight, 600.0))
    lead = min(found.lead, place.score + float(cue[place.turn]) - max(float(tally.sums[STRONGEST]), float(tally.sums[LEFT_OUT])))
    score, name = found.score, found.name
    turn, _, _, _, u, v = tally.strongest_place.tolist()
    if turn >= 0 and tally.sums[STRONGEST] - cue[turn] > score:
        length = len(family.signs) // 3
        ours = isinstance(family.registered, Sites) and (family.registered.table[:, SECTOR] == (u, v)).all(axis=1).any()
        name = f"sector {u * length + v} of {family.code}{' at another origin' if ours else ''}"
        score = float(tally.sums[STRONGEST] - cue[turn])
    return Rivals(weight=weight, lead=lead, score=score, name=name)
