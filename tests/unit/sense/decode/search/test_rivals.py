"""Unregistered tapes beside an answer: their weight and lead from tallies made by hand, and their names from dots on them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import exp, inf, log
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab.sense.decode.search import rivals as module
from tactape_fab.sense.decode.search.families import families
from tactape_fab.sense.decode.search.groups import Groups
from tactape_fab.sense.decode.search.rivals import best_unregistered, rivals
from tactape_fab.sense.decode.search.search import PLENTY, Place, enough_of, search, strict_of
from tactape_fab.sense.decode.search.tally import (
    BEST,
    BOUNDED,
    LEAST_SHARE,
    LEFT_OUT,
    LIKELY,
    NEGLIGIBLE,
    ROUNDING,
    STRONGEST,
    TOTAL,
)
from tests.unit.sense.decode.search.test_search import CENTRE, GRID, SHARE, TURNS, enumerate_places, seen, tape_of, touch_of

SCORE, WEIGHT, TURN = 30.0, -9.0, 2
CUE = np.log(TURNS)
LENGTH = 63
SITES, PLACES = 5, 6
"""Sites of the made-up family, with two tapes each, and places of the only group that it has for each turn."""


def groups_by_hand(count: int = 200) -> Groups:
    """One group of each turn, among so many."""
    fields, limits = np.zeros((count, 9), dtype=np.int64), np.tile([5.0, 7.0, log(PLACES)], (count, 1))
    fields[:, [1, 5]] = (2, 3)  # columns and rows
    spans = np.array([[[turn, turn + 1]] for turn in range(4)])
    return Groups(fields, spans, limits)


PLACE = Place(
    score=SCORE,
    weight=WEIGHT,
    tape=0,
    turn=TURN,
    cells=np.zeros((6, 2), dtype=np.int64),
    shown=np.zeros((9, 9), dtype=np.uint8),
    others=0.0,
    lead=40.0,
    most_evidence=99.0,
    tables=(None,),  # type: ignore[arg-type]
    groups=(groups_by_hand(),),
    turn_weights=TURNS,
    weights=np.zeros((4, 2)),
)
ENOUGH = enough_of(1e-5, SCORE + WEIGHT)
STRICT = strict_of(PLACE.groups, ENOUGH)


def family_of(code: str = "microdots-4x4", sites: tuple[int, ...] = (SITES,)) -> Any:
    """A family whose unregistered sites are told from those beyond edges by a name; classes of so many sites."""
    edges = np.cumsum([0, *sites])
    classes = np.array([(a, b, 0, 2, 0, 0) for a, b in pairwise(edges)])
    of = {name: SimpleNamespace(name=name, classes=classes) for name in ("unregistered", "beyond")}
    return SimpleNamespace(code=code, signs=np.zeros(3 * LENGTH), registered=None, **of)


class Tallies:
    """A stand-in for the search: gives sums by their fields, one tally after the other, and keeps how each was asked for."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, *said: dict[int, float], at: tuple[int, ...] = (1, 0, 0, 0, 2, 5)
    ) -> None:
        self._said, self.at = list(said), [at]
        self.begun: list[Any] = []
        self.asked: list[tuple[Any, Groups, Any]] = []
        monkeypatch.setattr(module, "weigh_sites", self)

    def __call__(self, tables: object, sites: Any, groups: Groups, weights: Any, tally: Any) -> None:
        self.begun.append(tally.sums.copy())
        self.asked.append((sites, groups, weights))
        said = self._said.pop(0) if len(self._said) > 1 else self._said[0]
        for field, value in said.items():
            tally.sums[field] = value
        if STRONGEST in said:
            tally.strongest_place[:] = self.at.pop(0) if len(self.at) > 1 else self.at[0]


def test_without_unregistered_tapes_nothing_weighs_beside_the_answer() -> None:
    alone = SimpleNamespace(unregistered=None, beyond=None)
    for found in (rivals([alone], PLACE, SHARE), best_unregistered([alone], PLACE, SHARE, 0.0)):  # type: ignore[list-item]
        assert (found.weight, found.lead, found.score, found.name) == (0.0, inf, -inf, "")


@pytest.mark.parametrize(
    ("said", "weight", "lead"),
    [
        ({TOTAL: 0.3}, 0.3, inf),
        ({TOTAL: 0.3, BEST: SCORE + WEIGHT + log(2.0), STRONGEST: 12.0}, 0.6, SCORE + CUE[TURN] - 12.0),
        ({TOTAL: 0.3, STRONGEST: 12.0, LEFT_OUT: 14.0}, 0.3, SCORE + CUE[TURN] - 14.0),
        ({TOTAL: 1e-9, BEST: SCORE + WEIGHT + 1e6}, 1e-9 * exp(600.0), inf),
    ],
)
def test_weight_and_lead_are_relative_to_the_answer(
    said: dict[int, float], weight: float, lead: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    Tallies(monkeypatch, said)
    found = rivals([family_of()], PLACE, SHARE)
    assert found.weight == pytest.approx(weight) and found.lead == pytest.approx(lead)


@pytest.mark.parametrize("strongest", [(40.0, 45.0), (45.0, 40.0)])
def test_families_add_their_weights_and_the_strongest_of_all_is_named(
    strongest: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    Tallies(monkeypatch, *({TOTAL: 0.01, STRONGEST: value} for value in strongest))
    place = replace(PLACE, tables=(None, None), groups=(groups_by_hand(), groups_by_hand()))  # type: ignore[arg-type]
    found = rivals([family_of("one"), family_of("other")], place, SHARE)
    assert found.weight == pytest.approx(0.02)
    assert found.lead == pytest.approx(SCORE + CUE[TURN] - 45.0)
    assert found.score == pytest.approx(45.0 - CUE[1])  # ln E, without what the shape of the dots says of the turn
    assert found.name == f"sector {2 * LENGTH + 5} of {'other' if strongest[1] > strongest[0] else 'one'}"


def test_what_fits_best_whatever_its_turn_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """L, by which places lead, has the shape of the dots in it, and E, by which they are named, has not."""
    told = Tallies(monkeypatch, {TOTAL: 0.01, STRONGEST: 40.0})
    place = replace(PLACE, tables=(None, None), groups=(groups_by_hand(), groups_by_hand()))  # type: ignore[arg-type]
    told.at = [(1, 0, 0, 0, 0, 1), (3, 0, 0, 0, 0, 2)]
    found = rivals([family_of(), family_of()], place, SHARE)
    assert found.name.startswith("sector 2 ") and found.score == pytest.approx(40.0 - CUE[3])


def test_no_place_is_named_where_none_was_evaluated(monkeypatch: pytest.MonkeyPatch) -> None:
    Tallies(monkeypatch, {TOTAL: 0.01, STRONGEST: 40.0}, at=(-1, -1, -1, -1, -1, -1))
    found = rivals([family_of()], PLACE, SHARE)
    assert (found.name, found.score) == ("", -inf)
    Tallies(monkeypatch, {TOTAL: 0.01, STRONGEST: 40.0}, at=(0, 0, 0, 0, 0, 3))
    assert rivals([family_of()], PLACE, SHARE).name == "sector 3 of microdots-4x4"


def test_unregistered_tapes_share_their_weight_as_multiples_of_the_registered_ones_(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Tallies(monkeypatch, {TOTAL: 0.0})
    rivals([family_of()], PLACE, 0.2)
    ((sites, _, weights),) = told.asked
    assert sites.name == "beyond"
    assert np.exp(weights.place[:, 0]) * 2 * SITES * PLACES == pytest.approx(0.2 / 0.8 * TURNS)
    assert np.isneginf(weights.place[:, 1]).all() and weights.turn == pytest.approx(CUE)
    rivals([family_of()], PLACE, 0.2, beyond=False)
    assert told.asked[-1][0].name == "unregistered"


@pytest.mark.parametrize(
    ("least_lead", "likely"), [(0.0, inf), (0.5, SCORE + CUE[TURN] - 0.5 - ROUNDING), (3.0, SCORE + CUE[TURN] - 3.0 - ROUNDING)]
)
def test_places_that_would_take_the_lead_are_looked_at(least_lead: float, likely: float, monkeypatch: pytest.MonkeyPatch) -> None:
    told = Tallies(monkeypatch, {TOTAL: 0.0})
    rivals([family_of()], PLACE, SHARE, least_lead=least_lead)
    (begun,) = told.begun
    assert begun[BEST] == SCORE + WEIGHT and begun[LIKELY] == pytest.approx(likely)
    rivals([family_of()], PLACE, SHARE)  # no lead is asked for
    assert told.begun[1][LIKELY] == inf


@pytest.mark.parametrize(
    ("precision", "beyond", "share"),
    [
        (1e-5, False, NEGLIGIBLE),
        (1e-4, True, NEGLIGIBLE),
        (1e-5, True, log(0.02 * ENOUGH)),
        (1e-12, True, log(0.02 * enough_of(1e-12, SCORE + WEIGHT))),
    ],
)
def test_less_is_negligible_where_dots_hang_over_edges(
    precision: float, beyond: bool, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = Tallies(monkeypatch, {TOTAL: 0.0})
    rivals([family_of()], PLACE, SHARE, precision, beyond=beyond)
    assert told.begun[0][LEAST_SHARE] == pytest.approx(share)
    rivals([family_of()], replace(PLACE, groups=(groups_by_hand(4),)), SHARE)  # of so few none needs to be as small
    assert told.begun[1][LEAST_SHARE] == pytest.approx(log(ENOUGH / 41.0))


def test_bounds_that_add_up_to_too_much_are_made_sharper(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Tallies(
        monkeypatch,
        {TOTAL: 4 * ENOUGH, BOUNDED: 4 * ENOUGH},
        {TOTAL: 4 * ENOUGH, BOUNDED: 2 * ENOUGH, BEST: SCORE + WEIGHT - log(2.001)},
    )
    found = rivals([family_of()], PLACE, SHARE, beyond=False)
    first, second = (begun[LEAST_SHARE] for begun in told.begun)
    assert first - second == pytest.approx(log(8.0))  # half of what is allowed is aimed at
    assert found.weight == pytest.approx(2 * ENOUGH, rel=1e-3)  # of the last search alone


@pytest.mark.parametrize(
    ("said", "rounds"),
    [
        ({TOTAL: ENOUGH, BOUNDED: ENOUGH}, 1),
        ({TOTAL: PLENTY + 2.1 * ENOUGH, BOUNDED: 2.0 * ENOUGH}, 1),  # too much is certain
        ({TOTAL: PLENTY + 1.9 * ENOUGH, BOUNDED: 2.0 * ENOUGH}, 5),
        ({TOTAL: 1e-9, BOUNDED: 1e-9, BEST: SCORE + WEIGHT + 1e6}, 2),
    ],
)
def test_a_search_is_repeated_until_bounds_matter_no_more_or_none_is_left(
    said: dict[int, float], rounds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = Tallies(monkeypatch, said)
    rivals([family_of()], PLACE, SHARE, beyond=False)
    assert len(told.begun) == rounds
    assert (told.begun[-1][LEAST_SHARE] == pytest.approx(STRICT)) == (rounds > 1)


def test_for_a_name_every_single_place_has_to_reach_the_score(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Tallies(monkeypatch, {TOTAL: 1.5, BEST: 33.0, STRONGEST: 38.0, LEFT_OUT: 39.0})
    found = best_unregistered([family_of(sites=(5, 2))], PLACE, 0.2, 31.0)
    ((sites, groups, weights),), (begun,) = told.asked, told.begun
    assert sites.name == "unregistered"
    assert (begun[BEST], begun[LEAST_SHARE], begun[LIKELY]) == (31.0, -ROUNDING, inf)
    # with the fewest tapes of a class, 4, a group has one place
    assert groups.limits == pytest.approx(np.tile([5.0, 7.0, -log(4.0)], (200, 1)))
    assert (weights.place[:, 0] == 0.0).all() and np.isneginf(weights.place[:, 1]).all()
    # what was left out is below the score: no bound of the lead
    assert found.lead == pytest.approx(SCORE + CUE[TURN] - 38.0) and found.score == pytest.approx(38.0 - CUE[1])
    most = 0.2 / 0.8 * TURNS.max() / (14 * PLACES)
    assert found.weight == pytest.approx(1.5 * most * exp(33.0 - SCORE - WEIGHT))


# From dots on tapes


@pytest.mark.parametrize(
    ("ours", "touched", "name"),
    [
        ([(7, None)], (104, None), "sector 104 of microdots-4x4"),
        ([(7, None)], (9, (84, 1428)), "sector 9 of microdots-4x4"),
        ([(104, (84, 1428)), (7, None)], (104, None), "sector 104 of microdots-4x4 at another origin"),
    ],
)
def test_a_stranger_has_its_name_score_and_lead(
    ours: list[tuple[int, tuple[int, int] | None]], touched: tuple[int, tuple[int, int] | None], name: str
) -> None:
    tapes, there = [tape_of(sector, origin=at) for sector, at in ours], tape_of(touched[0], origin=touched[1])
    nodes, q = seen(there, (20, 9), 1, np.random.default_rng(6), dots=24, doubt=0.02)
    world = families(tapes, open_world=True)
    place = search(tapes, world, nodes, q, TURNS, GRID, CENTRE, None)
    assert place is not None
    found = enumerate_places(there, there.sector, nodes, q)
    best = int((found.value + CUE[found.turn]).argmax())
    lead = place.score + CUE[place.turn] - found.value[best] - CUE[found.turn[best]]
    assert lead < -5.0
    for shown in (rivals(world, place, SHARE), best_unregistered(world, place, SHARE, float(found.value[best]) - 1.0)):
        assert shown.name == name
        assert shown.score == pytest.approx(found.value[best], abs=1e-3) and shown.lead == pytest.approx(lead, abs=1e-3)
    none = best_unregistered(world, place, SHARE, float(found.value[best]) + 1.0)
    assert none.score < found.value[best] + 1.0


def test_tapes_of_a_code_without_sequences_have_no_strangers() -> None:
    tapes = [touch_of(1)]
    nodes, q = seen(tapes[0], (20, 9), 1, np.random.default_rng(6), dots=24, doubt=0.02)
    world = families(tapes, open_world=True)
    place = search(tapes, world, nodes, q, TURNS, GRID, CENTRE, None)
    assert place is not None and rivals(world, place, SHARE).lead == inf
