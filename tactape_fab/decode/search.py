"""All places of all registered tapes for the dots of one grid, a prior among them if there is one, and their rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, exp, inf, log

import numpy as np

from tactape_fab.decode.counting import Tally, new_tally
from tactape_fab.decode.evidence import Tables, tables_of
from tactape_fab.decode.groups import count_places, groups_of
from tactape_fab.decode.near import evidence_at, places_near
from tactape_fab.decode.sites import Family
from tactape_fab.decode.weigh import weigh_sites
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.tape import Tape

LEAST_DOTS = 6
LARGEST_CONTACT = 24
"""Cells; dots that reach farther are no contact."""
OVERHANG_SHARE = 0.1
"""Weight of all places where dots lie beyond a tape's edge, together."""
_RIVALS_NEGLIGIBLE = -15.5
"""As `counting.NEGLIGIBLE`: unregistered tapes have fewer groups of places."""
PRIOR_SHARE = 0.5
"""Weight of the places near a prior; the rest is spread over all places, so that a wrong prior cannot deceive."""


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
        ln of its evidence E.
    weight : float
        ln of its weight, all places of all registered tapes together weighing 1.
    tape, turn : int
        Registered tape; quarter turns.
    cells : ndarray of int, shape (n, 2)
        Column and row of each dot on the tape; outside it for dots that hang over.
    others : float
        Weighted evidence of all other registered places together, as a multiple of this one's.
    lead : float
        ln of how much likelier the dots are here than at any other registered place, whatever the weights.
    most_said : float
        ln of the most evidence that the dots could give anywhere.
    tables, groups : tuple
        Of each family, for `rivals`.
    turn_weights : ndarray, shape (4,)
    """

    score: float
    weight: float
    tape: int
    turn: int
    cells: IntArray
    others: float
    lead: float
    most_said: float
    tables: tuple[Tables, ...]
    groups: tuple[tuple[IntArray, IntArray, FloatArray], ...]
    turn_weights: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Rivals:
    """Tapes that nobody registered, held against the best place.

    Attributes
    ----------
    weight : float
        Weighted evidence of all their places together, as a multiple of the answer's.
    lead : float
        ln of how much likelier the dots are at the answer than at any of them.
    score : float
        ln E of the strongest.
    name : str
        Sector and code of the strongest.
    """

    weight: float
    lead: float
    score: float
    name: str


def search(
    tapes: Sequence[Tape],
    families: Sequence[Family],
    nodes: IntArray,
    q: FloatArray,
    turn_weights: FloatArray,
    grid: FloatArray,
    centre_px: FloatArray,
    prior: Prior | None,
) -> Place | None:
    """Hold soft symbols against every origin and quarter turn on every registered tape.

    Parameters
    ----------
    nodes, q, grid
        From `symbols.fit_grid` and `symbols.posteriors`.
    turn_weights : ndarray, shape (4,)
        How likely each quarter turn is by anything but the symbols; sums to 1.
    centre_px : ndarray, shape (2,)
        The image centre from the origin of the dots' coordinates.

    Returns
    -------
    Place or None
        None where the dots reach farther than any contact, or no place has enough of them on a tape.
    """
    tables = tuple(tables_of(nodes, q, family.registered.signs, LARGEST_CONTACT) for family in families)
    if tables[0].size.max() > LARGEST_CONTACT:
        return None
    groups = tuple(groups_of(t, family.registered.sizes, LEAST_DOTS) for t, family in zip(tables, families, strict=True))
    counts = sum(count_places(*g, family.registered.classes) for g, family in zip(groups, families, strict=True))
    near = [] if prior is None else _near(tapes, families, tables, grid, centre_px, prior)
    base = _weights(np.asarray(counts), turn_weights, 1.0 - PRIOR_SHARE if near else 1.0)
    cue = np.log(turn_weights)
    tallies = []
    for t, g, family in zip(tables, groups, families, strict=True):
        tallies.append(new_tally())
        weigh_sites(t, family.registered, g, base, cue, tallies[-1])
    of = max(range(len(tallies)), key=lambda k: tallies[k].sums[0])
    if tallies[of].best[0] < 0:
        return None
    best, total = float(tallies[of].sums[0]), sum(float(t.sums[1]) * exp(t.sums[0] - tallies[of].sums[0]) for t in tallies)
    answer = (of, *(int(v) for v in tallies[of].best[:4]))
    for found, (without, raised) in zip(near, _raised(near, turn_weights, base), strict=True):
        if raised > best:
            answer, total, best = (
                (found.family, found.turn, found.site, found.column, found.row),
                total * exp(best - raised),
                raised,
            )
        total += exp(raised - best) - exp(without - best)
    of, turn, site, column, row = answer
    family = families[of]
    score, _ = evidence_at(tables[of], family.registered, turn, site, column, row)
    return Place(
        score=score,
        weight=best - score,
        tape=family.tapes[site],
        turn=turn,
        cells=tables[of].cells[turn] + np.array([column, row]),
        others=max(total - 1.0, 0.0),
        lead=score + float(cue[turn]) - _next_best(tallies, answer),
        most_said=float(tables[of].most[turn, :, -1, -1].sum()),
        tables=tables,
        groups=groups,
        turn_weights=turn_weights,
    )


def rivals(families: Sequence[Family], place: Place, share: float) -> Rivals:
    """Hold the dots of an answer against every place of the tapes that nobody registered.

    Parameters
    ----------
    share : float
        Weight of all of them together; the registered ones have the rest.
    """
    cue = np.log(place.turn_weights)
    others = [family.unregistered for family in families if family.unregistered is not None]
    counts = sum(count_places(*g, sites.classes) for g, sites in zip(place.groups, others, strict=True))
    base = _weights(np.asarray(counts), place.turn_weights, share / (1.0 - share))
    found = Rivals(weight=0.0, lead=inf, score=-inf, name="")
    for t, g, sites, family in zip(place.tables, place.groups, others, families, strict=True):
        tally = new_tally(place.score + place.weight, _RIVALS_NEGLIGIBLE)
        weigh_sites(t, sites, g, base, cue, tally)
        strongest = max(float(tally.sums[2]), float(tally.sums[4]))
        weight = found.weight + float(tally.sums[1]) * exp(min(tally.sums[0] - place.score - place.weight, 700.0))
        lead = min(found.lead, place.score + float(cue[place.turn]) - strongest)
        if tally.strongest[0] >= 0 and tally.sums[2] - cue[tally.strongest[0]] > found.score:
            turn, _, _, _, u, v = tally.strongest.tolist()
            score, sector = float(tally.sums[2] - cue[turn]), u * (len(sites.signs) // 3) + v
            found = Rivals(weight=weight, lead=lead, score=score, name=f"sector {sector} of {family.code}")
        else:
            found = Rivals(weight=weight, lead=lead, score=found.score, name=found.name)
    return found


def _weights(counts: FloatArray, turn_weights: FloatArray, share: float = 1.0) -> FloatArray:
    """Ln of the weight of one place by turn, all dots on the tape or not; shape (4, 2). All of them have a share together."""
    out = np.full((4, 2), -inf)
    for turn, (inside, over) in enumerate(counts.tolist()):
        both = inside > 0.0 and over > 0.0
        if inside > 0.0:
            out[turn, 0] = log(share * float(turn_weights[turn]) * (1.0 - OVERHANG_SHARE if both else 1.0) / inside)
        if over > 0.0:
            out[turn, 1] = log(share * float(turn_weights[turn]) * (OVERHANG_SHARE if both else 1.0) / over)
    return out


def _next_best(tallies: Sequence[Tally], answer: tuple[int, ...]) -> float:
    """Ln L of the strongest registered place that is not the answer."""
    values = []
    for k, tally in enumerate(tallies):
        is_answer = k == answer[0] and tuple(tally.strongest[:4].tolist()) == answer[1:]
        values += [float(tally.sums[3 if is_answer else 2]), float(tally.sums[4])]
    return max(values)


@dataclass(frozen=True, slots=True)
class _Near:
    """A place near a prior: ln E there, and whether all dots lie on the tape."""

    family: int
    turn: int
    site: int
    column: int
    row: int
    evidence: float
    inside: bool


def _near(
    tapes: Sequence[Tape],
    families: Sequence[Family],
    tables: Sequence[Tables],
    grid: FloatArray,
    centre_px: FloatArray,
    prior: Prior,
) -> list[_Near]:
    """The places near a prior with enough dots on a tape."""
    found = []
    for of, (family, t) in enumerate(zip(families, tables, strict=True)):
        for turn in range(4):
            theta_deg = degrees(float(np.arctan2(grid[1], grid[0]))) + 90.0 * turn
            if abs((theta_deg - prior.theta_deg + 180.0) % 360.0 - 180.0) > prior.angle_deg:
                continue
            centre = _turned_point(grid, centre_px, turn) - t.corner[turn]  # in cells from the dots' corner
            for site, index in enumerate(family.tapes):
                tape = tapes[index]
                if prior.tape not in (None, tape.name):
                    continue
                at = np.asarray(prior.position_mm) / tape.pitch_mm - centre
                size, reach = (tape.columns, tape.rows), prior.radius_mm / tape.pitch_mm
                for column, row, evidence in places_near(t, family.registered, turn, site, at, reach, LEAST_DOTS):
                    wide, high = t.size[turn]
                    inside = 0 <= column <= size[0] - wide and 0 <= row <= size[1] - high
                    found.append(_Near(of, turn, site, int(column), int(row), evidence, inside))
    return found


def _raised(near: Sequence[_Near], turn_weights: FloatArray, base: FloatArray) -> list[tuple[float, float]]:
    """Ln of the weighted evidence of places near a prior, as it is without the prior and with it."""
    total = sum(float(turn_weights[place.turn]) for place in near)
    raised = []
    for place in near:
        without = float(base[place.turn, 0 if place.inside else 1])
        share = PRIOR_SHARE * float(turn_weights[place.turn]) / total
        raised.append((place.evidence + without, place.evidence + log(exp(without) + share)))
    return raised


def _turned_point(grid: FloatArray, point_px: FloatArray, turn: int) -> FloatArray:
    """A point in columns and rows of the grid after a quarter turn, as `evidence.turned` has it."""
    a, b, x, y = grid
    dx, dy = point_px[0] - x, point_px[1] - y
    norm = a * a + b * b
    k, j = (a * dx + b * dy) / norm, (a * dy - b * dx) / norm
    return np.array([(k, j), (j, -k), (-k, -j), (-j, k)][turn])
