"""Ranking of grids and places: which grids are tried, in which order, and which of their places is the answer."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from math import inf, log, nan
from typing import Any

import numpy as np
import pytest

from tactape_fab.sense.decode import rank
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.grid.fit import Fit
from tactape_fab.sense.decode.rank import Reading, View, read
from tactape_fab.sense.decode.rule import EVEN_TURNS, GRID_SHARES, LEAST_GRID_POWER
from tactape_fab.sense.decode.search.hypotheses import Registry
from tactape_fab.sense.decode.search.plane import CodePlane
from tactape_fab.sense.decode.search.search import Place
from tactape_fab.texture.code import get_plane
from tactape_fab.texture.frames import FloatArray
from tests.contacts import TAPE

VIEW = View(
    pitch_mm=1.5,
    displacement_mm=0.25,
    part=TAPE.part,
    px_per_mm=16.0,
    scale_tolerance=0.06,
    centre_px=np.array([159.5, 119.5]),
    beliefs=None,  # type: ignore[arg-type]  # nothing here looks at them
)
DOTS = Dots(
    xy_px=np.array([(100.0, 50.0), (140.0, 60.0), (120.0, 90.0), (10.0, 200.0)]),
    weights=np.array([1.0, 0.5, 2.0, 1.5]),
    trust=np.array([1.0, 1.0, 0.5, 0.0]),
    elongation=np.full((4, 2), 0.1),
)
MIDDLE = np.array([120.0, 62.0])  # of 1, 1 and 1/2 of the first three dots
REGISTRY = Registry(tapes=(TAPE,), families=(), unregistered_share=0.0)
NEVER_CLEAR, SOON_CLEAR = 1e-300, 1.0


@dataclass
class World:
    """Grids that dots show, best first, and the score of the place on each; and what was asked of each step."""

    powers: tuple[float, ...] = (0.5, 0.4, 0.3)
    values: tuple[float, ...] = (1.0, 2.0, 3.0)
    expected: tuple[bool, ...] = (True, True, True)
    scores: tuple[float | None, ...] = (10.0, 10.0, 10.0)
    broken: tuple[int, ...] = ()
    asked: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))

    def find_lattices(self, xy: FloatArray, strength: FloatArray, pitch_px: float, tolerance: float, most: int) -> FloatArray:
        self.asked["grids"].append((xy, strength, pitch_px, tolerance, most))
        return np.array([(k, 24.0 + k, 0.1 * k, 0.2 * k, power) for k, power in enumerate(self.powers)][:most])

    def fit_grid(self, xy: FloatArray, weights: FloatArray, trust: FloatArray, *of: Any) -> Fit:
        self.asked["fits"].append((xy, weights, trust, *of))
        k = int(of[0])
        grid = np.array([k, 0.0, 0.0, nan if k in self.broken else 0.0])
        nodes = np.full((len(xy), 2), k)
        return Fit(grid, nodes, np.full((len(xy), 4), float(k)), 0.01 * (k + 1), self.values[k], self.expected[k])

    def posteriors(self, nodes: Any, squares: Any, weights: Any, trust: Any, sigma: float) -> FloatArray:
        assert weights is DOTS.weights and trust is DOTS.trust and sigma == 0.01 * (nodes[0, 0] + 1)
        return np.full((len(nodes), 4), float(nodes[0, 0]))

    def search(
        self, tapes: Any, families: Any, nodes: Any, q: Any, turns: Any, grid: Any, *of: Any, least: float, built: bool
    ) -> Any:
        assert tapes is REGISTRY.tapes and families is REGISTRY.families
        self.asked["of use"].append((least, built))
        return self._placed(int(nodes[0, 0]), (q, turns, grid, *of))

    def of_plane(self, nodes: Any, q: Any) -> Any:
        return self._placed(int(nodes[0, 0]), (q,))

    def _placed(self, k: int, told: tuple[Any, ...]) -> Any:
        self.asked["places"].append((k, *told))
        score = self.scores[k]
        return None if score is None else place_of(k, score)

    def turn_weights(self, *of: Any) -> FloatArray:
        self.asked["turns"].append(of)
        return np.array([0.7, 0.1, 0.1, 0.1])

    def as_built(self, place: Place, q: FloatArray, *of: Any) -> tuple[Place, FloatArray]:
        self.asked["built"].append(of)
        return replace(place, score=place.score + 0.5), q + 100.0

    @property
    def tried(self) -> list[int]:
        """Grids whose places were searched, in this order."""
        return [told[0] for told in self.asked["places"]]


def place_of(k: int, score: float) -> Place:
    arrays = {"cells": np.zeros((4, 2), dtype=np.int64), "shown": np.zeros((2, 2), dtype=np.uint8)}
    numbers = {"score": score, "weight": -2.0, "tape": k, "turn": 0, "others": 0.0, "lead": 9.0, "most_evidence": 9.0}
    rest: dict[str, Any] = {"tables": (), "groups": (), "turn_weights": EVEN_TURNS, "weights": np.zeros((4, 2))}
    return Place(**numbers, **arrays, **rest)  # type: ignore[arg-type]


def best_of(
    monkeypatch: pytest.MonkeyPatch,
    world: World,
    *,
    max_p_tape: float = NEVER_CLEAR,
    view: View = VIEW,
    registry: Registry | CodePlane = REGISTRY,
    dots: Dots = DOTS,
    least: float = -inf,
) -> Reading | None:
    for name in ("find_lattices", "fit_grid", "posteriors", "search", "turn_weights", "as_built"):
        monkeypatch.setattr(rank, name, getattr(world, name))
    return read(dots, view, registry, None, max_p_tape, 1e-5, least)


def test_a_view_s_pitch_and_displacement() -> None:
    assert VIEW.pitch_px == 24.0 and VIEW.shift == pytest.approx(1 / 6)


def test_a_reading_s_bound_is_its_evidence_and_both_weights() -> None:
    reading = Reading(place=place_of(0, 10.0), grid_weight=-3.0)
    assert reading.ln_bound == 10.0 - 2.0 - 3.0


def test_grids_are_asked_of_dots_about_their_middle(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World()
    best_of(monkeypatch, world, max_p_tape=SOON_CLEAR)
    ((xy, strength, pitch_px, tolerance, most),) = world.asked["grids"]
    assert xy == pytest.approx(DOTS.xy_px - MIDDLE) and (pitch_px, tolerance, most) == (24.0, 0.06, 1)
    assert strength.tolist() == [1.0, 0.5, 0.5, 0.0]  # trust, and less of low dots; high ones say no more than good ones
    ((fitted_xy, weights, trust, angle, pitch, phase_a, phase_b, shift, free, directions),) = world.asked["fits"]
    assert fitted_xy is xy and weights is DOTS.weights and trust is DOTS.trust
    assert (angle, pitch, phase_a, phase_b, shift, free, directions) == (0.0, 24.0, 0.0, 0.0, VIEW.shift, True, 4)
    ((k, q, turns, grid, centre_px, prior, precision),) = world.asked["places"]
    assert k == 0 and not q.any() and turns.tolist() == [0.7, 0.1, 0.1, 0.1] and grid.tolist() == [0.0] * 4
    assert centre_px == pytest.approx(VIEW.centre_px - MIDDLE) and (prior, precision) == (None, 1e-5)
    ((elongation, told_weights, told_trust, told_grid, part),) = world.asked["turns"]
    assert elongation is DOTS.elongation and told_weights is DOTS.weights and told_trust is DOTS.trust
    assert told_grid is grid and part is TAPE.part


def test_a_fixed_scale_fits_no_scale(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World()
    best_of(monkeypatch, world, max_p_tape=SOON_CLEAR, view=replace(VIEW, scale_tolerance=0.0, directions=8))
    assert world.asked["grids"][0][3] == 0.0 and world.asked["fits"][0][-2:] == (False, 8)


def test_tapes_of_several_parts_have_even_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World()
    best_of(monkeypatch, world, view=replace(VIEW, part=None))
    assert not world.asked["turns"] and all(told[2] is EVEN_TURNS for told in world.asked["places"])


def test_a_clear_first_grid_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Better by 2 in ln than is asked for: a place of another grid would need 18 times the evidence to win."""
    bound = 10.0 - 2.0 + log(GRID_SHARES[0])
    for more, tried in ((1e-9, [0]), (-1e-9, [0, 1, 2])):
        world = World()
        reading = best_of(monkeypatch, world, max_p_tape=float(np.exp(-bound + 2.0 + more)))
        assert world.tried == tried and reading is not None and reading.place.tape == 0  # type: ignore[union-attr]


def test_another_grid_s_place_has_to_be_better_than_the_first_one_s(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, third = (log(share) for share in GRID_SHARES)
    world = World(scores=(10.0, 1.0, 20.0))
    best_of(monkeypatch, world)
    bound = 10.0 - 2.0 + first
    assert world.asked["of use"] == [(-inf, False), (pytest.approx(bound - second), False), (pytest.approx(bound - third), False)]
    world = World(scores=(None, 1.0, 20.0))
    best_of(monkeypatch, world, least=7.0)
    assert [least for least, _ in world.asked["of use"]] == pytest.approx([7.0 - first, 7.0 - second, 7.0 - third])


def test_only_the_first_grid_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each other grid is asked, however clear the second one's place is."""
    world = World(scores=(None, 1000.0, 1.0))
    reading = best_of(monkeypatch, world, max_p_tape=0.5)
    assert world.tried == [0, 1, 2] and reading is not None and reading.place.score == 1000.0


def test_the_best_bound_wins_and_grids_weigh_what_they_do_by_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    step = log(GRID_SHARES[0] / GRID_SHARES[1])
    for scores, best in [
        ((10.0, 10.0 + step - 0.01, 0.0), 0),
        ((10.0, 10.0 + step + 0.01, 0.0), 1),
        ((10.0, 0.0, 10.0 + step + 0.01), 2),
        ((0.0, 10.0, 10.0), 1),
    ]:
        reading = best_of(monkeypatch, World(scores=scores))
        assert reading is not None and reading.place.tape == best  # type: ignore[union-attr]
        assert reading.grid_weight == log(GRID_SHARES[best])
        assert reading.q is not None and (reading.q == best).all()


@pytest.mark.parametrize("first", [None, -inf, nan])
def test_a_grid_without_a_place_is_passed_over(monkeypatch: pytest.MonkeyPatch, first: float | None) -> None:
    world = World(scores=(first, 5.0, None))
    reading = best_of(monkeypatch, world)
    assert world.tried == [0, 1, 2] and reading is not None and reading.place.score == 5.0
    assert best_of(monkeypatch, World(scores=(first, None, None))) is None


def test_the_other_grids_are_found_only_where_they_are_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World()
    best_of(monkeypatch, world)
    assert [told[4] for told in world.asked["grids"]] == [1, len(GRID_SHARES)]


def test_a_first_grid_that_does_not_fit_as_it_should_is_put_in_order_with_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """By their likelihoods, the largest first."""
    world = World(expected=(False, True, True), values=(2.0, 1.0, 3.0))
    reading = best_of(monkeypatch, world)
    assert world.tried == [2, 0, 1] and [told[4] for told in world.asked["grids"]] == [1, len(GRID_SHARES)]
    assert reading is not None and reading.place.tape == 2 and reading.grid_weight == log(GRID_SHARES[0])  # type: ignore[union-attr]


def test_two_grids_that_were_put_in_order_are_not_looked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(powers=(0.5, 0.4), expected=(False, True), values=(1.0, 2.0))
    best_of(monkeypatch, world)
    assert world.tried == [1, 0] and len(world.asked["grids"]) == 2


def test_a_single_grid_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    for expected in (True, False):
        world = World(powers=(0.5,), expected=(expected,), values=(1.0,))
        reading = best_of(monkeypatch, world)
        assert world.tried == [0] and reading is not None and reading.place.tape == 0  # type: ignore[union-attr]


def test_grids_of_hardly_any_power_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    assert best_of(monkeypatch, World(powers=(LEAST_GRID_POWER - 1e-9,) * 3)) is None
    world = World(powers=(LEAST_GRID_POWER, LEAST_GRID_POWER - 1e-9, 0.0))
    assert best_of(monkeypatch, world) is not None and world.tried == [0]


def test_grids_whose_fit_broke_down_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next one comes into its place; where the first one broke down there is no answer."""
    world = World(broken=(1,), scores=(0.0, 99.0, 10.0))
    reading = best_of(monkeypatch, world)
    assert world.tried == [0, 2] and reading is not None and reading.grid_weight == log(GRID_SHARES[1])
    assert best_of(monkeypatch, World(broken=(0,))) is None


def test_measured_places_are_compared_where_a_tape_has_some(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World()
    built = replace(REGISTRY, built=(None,))
    reading = best_of(monkeypatch, world, registry=built, max_p_tape=SOON_CLEAR)
    assert reading is not None and reading.place.score == 10.5 and reading.q is not None and (reading.q == 100.0).all()
    ((fit, xy, dots, design, free, tapes, told, families),) = world.asked["built"]
    assert fit.value == 1.0 and xy == pytest.approx(DOTS.xy_px - MIDDLE) and dots is DOTS
    assert (design, free) == ((1.5, VIEW.shift), True)
    assert tapes is built.tapes and told is built.built and families is built.families
    best_of(monkeypatch, world, registry=built, max_p_tape=SOON_CLEAR, view=replace(VIEW, scale_tolerance=0.0))
    assert world.asked["built"][1][4] is False and world.asked["of use"][-1][1] is True
    none = World()
    best_of(monkeypatch, none)
    assert none.asked["built"] == []


def test_a_code_alone_is_asked_for_its_plane(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(scores=(1.0, 9.0, 1.0))

    class Plane(CodePlane):
        def search(self, nodes: Any, q: Any) -> Any:
            return world.of_plane(nodes, q)

    Plane.__abstractmethods__ = frozenset()
    reading = best_of(monkeypatch, world, registry=Plane(get_plane(TAPE.code)))
    assert reading is not None and reading.place.score == 9.0 and world.tried == [0, 1, 2]
    assert not world.asked["turns"] and not world.asked["built"]
