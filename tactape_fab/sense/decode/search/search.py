"""All places of all registered tapes for the dots of one grid, a prior among them if there is one, and their rivals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import degrees, exp, inf, isfinite, log, nextafter
from numbers import Real

import numpy as np

from tactape_fab.base.errors import Problem, refuse
from tactape_fab.base.fields import shown
from tactape_fab.sense.decode.rule import LEAST_DOTS, PRIOR_SHARE, place_weights
from tactape_fab.sense.decode.search.all_places import weigh_sites
from tactape_fab.sense.decode.search.evidence import Tables, tables_of
from tactape_fab.sense.decode.search.families import Family
from tactape_fab.sense.decode.search.groups import Groups, Weights, count_places, groups_of
from tactape_fab.sense.decode.search.matrices import LARGEST_CONTACT, Matrices, weigh_matrices
from tactape_fab.sense.decode.search.plane_sites import FIRST, LAST, SECTOR, TAPES, Sites
from tactape_fab.sense.decode.search.single_place import NO_PART, evidence_at, places_near, shown_by
from tactape_fab.sense.decode.search.tally import (
    BEST,
    BOUNDED,
    LEFT_OUT,
    NEGLIGIBLE,
    NEXT_STRONGEST,
    ROUNDING,
    STRONGEST,
    TOTAL,
    Tally,
    new_tally,
)
from tactape_fab.texture.frames import FloatArray, IntArray, SymbolArray
from tactape_fab.texture.tape import Tape

MOST_RADIUS_MM = 50.0
_PLENTY = 0.05
"""From this weight of the other places on, as a multiple of the answer's, p_place is too large in any case: the search ends."""
_SAYS_NOTHING = 0.0
"""ln of the weighted evidence below which p_tape is 1: how many other places fit as badly is not counted."""
_RIVALS_SHARE = 0.02
"""exp(`NEGLIGIBLE`) over the allowed error, where dots may hang over the edges of unregistered tapes: there are so many groups
of places then that half of the contacts of 7x7 mm and fewer were searched two or three times."""
PRECISION = 1e-5


@dataclass(frozen=True, slots=True, kw_only=True)
class Prior:
    """Expected region of a contact, such as round the last fix: a place within a radius and a range of angles.

    Attributes
    ----------
    position_mm : (float, float)
        S, the texture point under the image centre (texture frame, mm).
    theta_deg : float
        Turn of the sensor on the tape, degrees, counter-clockwise seen from above, as in `Localization`.
    radius_mm : float
        Largest distance of the true S from `position_mm`, mm.
    angle_deg : float
        Largest difference of the true theta from `theta_deg`, degrees.
    tape : str or None
        Name of the tape; None for any.

    Raises
    ------
    SpecError
        When a value is out of range.
    """

    position_mm: tuple[float, float]
    theta_deg: float
    radius_mm: float = 2.0
    angle_deg: float = 10.0
    tape: str | None = None

    def __post_init__(self) -> None:
        problems = []
        if not _are_numbers(self.position_mm, 2):
            problems.append(Problem("position_mm", f"position_mm = {shown(self.position_mm)} is no place; give (x, y) in mm"))
        if not _are_numbers([self.theta_deg], 1):
            problems.append(Problem("theta_deg", f"theta_deg = {shown(self.theta_deg)} is no angle; give degrees"))
        if not (_are_numbers([self.radius_mm], 1) and 0.0 <= self.radius_mm <= MOST_RADIUS_MM):
            message = f"radius_mm = {shown(self.radius_mm)} is not from 0 to {MOST_RADIUS_MM:g} mm; give how far off it may be"
            problems.append(Problem("radius_mm", message))
        if not (_are_numbers([self.angle_deg], 1) and 0.0 <= self.angle_deg <= 360.0):
            message = f"angle_deg = {shown(self.angle_deg)} is not from 0 to 360 degrees; give how far off it may be"
            problems.append(Problem("angle_deg", message))
        name: object = self.tape
        if not (name is None or isinstance(name, str)):
            problems.append(Problem("tape", f"tape = {shown(name)} is no name; give the tape's name, or None for any"))
        refuse(problems)


def _are_numbers(values: object, count: int) -> bool:
    """Whether `values` holds exactly `count` finite real numbers."""
    if not isinstance(values, Iterable):
        return False
    numbers = [v for v in values if isinstance(v, Real) and _is_finite(v)]
    return len(numbers) == len(list(values)) == count


def _is_finite(value: Real) -> bool:
    try:
        return isfinite(value)
    except OverflowError:  # a whole number beyond all floats
        return False


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
    most_said: ln of the most evidence that the dots could give anywhere.
    tables, groups: Of each family, for `rivals`.
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
    near = None if prior is None else _near(tapes, families, tables, grid, centre_px, prior)
    base = place_weights(counts, turn_weights, 1.0 if near is None else 1.0 - PRIOR_SHARE)
    # L = E times how likely the turn is by the shape of the dots: only in L, never in E (docs/trust.md)
    cue = np.log(turn_weights)
    without, raised = (np.empty(0), np.empty(0)) if near is None else _raised(near, turn_weights, base)
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
        enough = _enough(precision, best)
        # places that are only bounded make p_place too large: done if that is little, or if p_place is large in any case
        if last or bounded <= enough or (near is None and total - 1.0 > _PLENTY):  # else what was left out may count
            break
        negligible = _strict(groups, enough)
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
    enough = _enough(precision, place.score + place.weight)
    strict = _strict(place.groups, enough)
    negligible = max(min(NEGLIGIBLE, log(_RIVALS_SHARE * enough)), strict) if beyond else NEGLIGIBLE
    while True:
        found, bounded = _NO_RIVALS, 0.0
        for t, g, sites, family in others:
            tally = new_tally(place.score + place.weight, negligible, likely)
            weigh_sites(t, sites, g, Weights(base, cue), tally)
            found = _strongest(found, tally, family, place, cue)
            # the tally's sums are multiples of its own best, which a strong rival has raised; 600 keeps exp from overflowing
            bounded += float(tally.sums[BOUNDED]) * exp(min(tally.sums[BEST] - place.score - place.weight, 600.0))
        if bounded <= enough or found.weight - bounded > _PLENTY or negligible <= strict:
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


def _enough(precision: float, ln_bound: float) -> float:
    """Allowed error of p_place: a tenth of what p_tape = exp(-ln_bound) leaves of max_p_false, at least 1 % of `precision`."""
    return max(precision - 0.1 * exp(-max(ln_bound, 0.0)), 0.01 * precision)


def _strict(groups: Sequence[Groups], precision: float) -> float:
    """Negligible share (ln) of one group, so that all groups together add at most a tenth of `precision`."""
    return log(precision) - log(10.0 * sum(len(g.fields) for g in groups) + 1.0)


def _next_best(tallies: Sequence[Tally], sums: Sequence[list[float]], answer: tuple[int, ...]) -> float:
    """Ln L of the strongest registered place other than the answer; `sums` are those of the tallies."""
    values = []
    for k, (tally, s) in enumerate(zip(tallies, sums, strict=True)):
        is_answer = k == answer[0] and tuple(tally.strongest_place[:4].tolist()) == answer[1:]
        values += [s[NEXT_STRONGEST if is_answer else STRONGEST], s[LEFT_OUT]]
    return max(values)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Near:
    """Places near a prior.

    ``places`` (n, 5) holds family, turn, site, column and row; ``evidence`` (n,) ln E there; ``over`` (n,) 1 where some dots lie
    beyond the tape's edge.
    """

    places: IntArray
    evidence: FloatArray
    over: IntArray


def _near(
    tapes: Sequence[Tape],
    families: Sequence[Family],
    tables: Sequence[Tables],
    grid: FloatArray,
    centre_px: FloatArray,
    prior: Prior,
) -> _Near | None:
    """The places near a prior with enough dots on a tape, if there are any."""
    found = []
    for of, (family, t) in enumerate(zip(families, tables, strict=True)):
        for turn in range(4):
            theta_deg = degrees(float(np.arctan2(grid[1], grid[0]))) + 90.0 * turn
            # the difference brought to -180 ... 180 degrees
            if abs((theta_deg - prior.theta_deg + 180.0) % 360.0 - 180.0) > prior.angle_deg:
                continue
            centre = _turned_point(grid, centre_px, turn) - t.corner[turn]  # in cells from the dots' corner
            for site, index in enumerate(family.tapes):
                tape = tapes[index]
                if prior.tape not in (None, tape.name):
                    continue
                # where the dots' corner would have to lie for the image centre to be at the prior's place, in cells
                at, reach = np.asarray(prior.position_mm) / tape.pitch_mm - centre, prior.radius_mm / tape.pitch_mm
                cells, evidence = places_near(t, shown_by(tape), turn, at, reach, LEAST_DOTS)
                inside = ((cells >= 0) & (cells <= np.array([tape.columns, tape.rows]) - t.size[turn])).all(axis=1)
                places = np.column_stack([np.broadcast_to([of, turn, site], (len(cells), 3)), cells])
                found.append(_Near(places=places, evidence=evidence, over=(~inside).astype(np.int64)))
    if sum(len(near.evidence) for near in found) == 0:
        return None
    return _Near(
        places=np.concatenate([near.places for near in found]),
        evidence=np.concatenate([near.evidence for near in found]),
        over=np.concatenate([near.over for near in found]),
    )


def _raised(near: _Near, turn_weights: FloatArray, base: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ln of the weighted evidence of places near a prior, without the prior and with it."""
    turn = near.places[:, 1]
    # the prior weight of a place is a sum: its part of all places, and its part of `PRIOR_SHARE` by its turn
    without, share = base[turn, near.over], PRIOR_SHARE * turn_weights[turn] / turn_weights[turn].sum()
    return near.evidence + without, near.evidence + np.log(np.exp(without) + share)


def _turned_point(grid: FloatArray, point_px: FloatArray, turn: int) -> FloatArray:
    """A point in columns and rows of the grid after a quarter turn, as `evidence.turned` has it."""
    a, b, x, y = grid
    dx, dy = point_px[0] - x, point_px[1] - y
    norm = a * a + b * b
    k, j = (a * dx + b * dy) / norm, (a * dy - b * dx) / norm
    return np.array([(k, j), (j, -k), (-k, -j), (-j, k)][turn])
