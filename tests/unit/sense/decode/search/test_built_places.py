"""Measured places of parts: they locate what the design does not, and a file of another copy of the tape misleads nobody."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from tactape_fab import Localization, Localizer, SpecError, Tape, TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Frame, Parts, Scene, iterate_frames
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.grid.fit import fit_grid
from tactape_fab.sense.decode.search import built_places
from tactape_fab.sense.decode.search.built_places import (
    CANDIDATES,
    MOST_CREDIT,
    Built,
    _around,
    _best,
    _candidates,
    _design_odds,
    _Evidence,
    _fitted,
    _is_at,
    _looked_up,
    _Places,
    _weighed,
    as_built,
    built_of,
)
from tactape_fab.sense.decode.search.families import families
from tactape_fab.sense.decode.search.hypotheses import distinct
from tactape_fab.sense.decode.search.search import Place, search
from tactape_fab.sense.decode.settings import Method
from tactape_fab.texture.as_built import Film
from tactape_fab.texture.code import TOUCH_CODE
from tests.measured import measured

SMALL = Scene(contact_mm=(6.5, 6.5))


@cache
def tape_7() -> Tape:
    return examine(TapeSpec(sector=7)).tape


def frames(tape: Tape, parts: Parts, count: int, scene: Scene | None = None) -> list[Frame]:
    return list(iterate_frames(tape, count, 5, scene=scene, parts=parts))


def answers(localizer: Localizer, seen: Sequence[Frame]) -> list[tuple[Localization, float]]:
    """Answers that are located, each with its error in mm."""
    found = [(localizer.locate(frame.depth), frame) for frame in seen]
    return [(fix, float(np.hypot(*(np.array(fix.position_mm) - frame.position_mm)))) for fix, frame in found if fix.located]


def test_small_contacts_of_badly_placed_parts_are_located_by_their_measured_places() -> None:
    built, parts = measured(tape_7(), 0.1)
    seen = frames(built, parts, 16, SMALL)
    nominal, as_built = answers(Localizer(tape_7()), seen), answers(Localizer(built), seen)
    assert len(nominal) <= 8
    assert len(as_built) >= 14
    assert all(error < 0.01 for _, error in as_built)
    assert {fix.places for fix, _ in nominal} == {"nominal"}
    assert {fix.places for fix, _ in as_built} == {"as-built"}


def test_measured_places_make_the_pose_exact_with_dots_and_with_pixels() -> None:
    built, parts = measured(tape_7(), 0.05)
    seen = frames(built, parts, 8)
    rms = {}
    for name, localizer in {
        "nominal": Localizer(tape_7()),
        "dots": Localizer(built),
        "pixels": Localizer(built, refine="pixels"),
    }.items():
        found = answers(localizer, seen)
        assert len(found) == 8
        rms[name] = np.sqrt(np.mean([error**2 for _, error in found]))
        if name == "pixels":
            assert sum(fix.refined == "pixels" for fix, _ in found) >= 7
    assert rms["dots"] < rms["nominal"] / 3
    assert rms["pixels"] < rms["nominal"] / 3


def test_a_file_of_another_copy_of_the_tape_falls_back_to_the_design() -> None:
    _, parts = measured(tape_7(), 0.05, seed=1)
    other, _ = measured(tape_7(), 0.05, seed=2)
    found = answers(Localizer(other), frames(other, parts, 12))
    assert len(found) == 12
    assert {fix.places for fix, _ in found} == {"nominal"}
    assert all(error < 0.06 for _, error in found)


@pytest.mark.parametrize(("off_mm", "stretch"), [((0.16, 0.16), 1.0), ((0.0, 0.0), 1.006)])
def test_what_parts_are_off_together_is_looked_for_where_it_is(off_mm: tuple[float, float], stretch: float) -> None:
    """By nearly their displacement, and by a film's stretch, which is 0.5 mm at its far end."""
    built, parts = measured(tape_7(), 0.03, error_mm=0.001)
    assert built.as_built is not None
    dx_mm, dy_mm = built.as_built.dx_mm + off_mm[0], built.as_built.dy_mm + off_mm[1]
    built = replace(built, as_built=replace(built.as_built, dx_mm=dx_mm, dy_mm=dy_mm, film=Film(scale=(stretch, stretch))))
    parts = replace(parts, xy_mm=parts.xy_mm + off_mm + (stretch - 1.0) * tape_7().part_xy_mm())
    found = answers(Localizer(built), frames(built, parts, 20, Scene(contact_mm=(9.0, 8.0))))
    assert len(found) == 20
    assert {fix.places for fix, _ in found} == {"as-built"}
    assert all(error < 0.01 for _, error in found)


def test_a_file_of_another_copy_whose_parts_hardly_scatter_loses_no_answer() -> None:
    """The dots do not tell whether the parts are where it says: either way they name the place."""
    _, parts = measured(tape_7(), 0.01, seed=1)
    other, _ = measured(tape_7(), 0.01, seed=2)
    found = answers(Localizer(other), frames(other, parts, 12, Scene(contact_mm=(9.0, 8.0))))
    assert len(found) == 12 and all(error < 0.015 for _, error in found)


def test_parts_that_stand_evenly_on_a_stretched_film_are_where_they_were_measured() -> None:
    """Their dots hardly tell that from the design: chance alone must not move an answer by the stretch of the film, 0.2 mm."""
    film = Film(scale=(1.003, 0.998), shear=0.001)
    built, parts = measured(tape_7(), 0.0, error_mm=0.004)
    assert built.as_built is not None
    built = replace(built, as_built=replace(built.as_built, film=film))
    parts = replace(parts, xy_mm=parts.xy_mm @ film.matrix.T)
    found = answers(Localizer(built), frames(built, parts, 60, Scene(contact_mm=(10.0, 8.0))))
    assert len(found) >= 58 and all(error < 0.01 for _, error in found)


def test_what_is_not_measured_stays_as_it_was() -> None:
    seen = frames(tape_7(), measured(tape_7(), 0.03)[1], 4)
    other, _ = measured(examine(TapeSpec(sector=8)).tape, 0.05)
    alone, beside = Localizer([tape_7()]), Localizer([tape_7(), other])
    for frame in seen:
        first, second = alone.locate(frame.depth), beside.locate(frame.depth)
        assert (first.located, first.cell, first.position_mm) == (second.located, second.cell, second.position_mm)
        assert second.places == "nominal"


def test_a_dot_at_a_missing_part_is_no_dot_of_the_tape() -> None:
    built, parts = measured(tape_7(), 0.03, missing=0.3)
    frame = frames(built, parts, 1)[0]
    fix = Localizer(built).locate(frame.depth)
    assert fix.located and fix.dots is not None and fix.dots.inlier.sum() == fix.n_agree
    there = built.present
    cells = fix.dots.cell[fix.dots.cell[:, 0] >= 0]
    assert there[cells[:, 1], cells[:, 0]].all()


def test_eight_directions_have_measured_places_too() -> None:
    tape = examine(TapeSpec(sector=1, code=TOUCH_CODE, size_mm=(60.0, 30.0), models=False, tag="none")).tape
    built, parts = measured(tape, 0.05)
    seen = frames(built, parts, 8, Scene(contact_mm=(8.0, 8.0)))
    nominal, as_built = answers(Localizer(tape), seen), answers(Localizer(built), seen)
    assert len(as_built) == 8 > len(nominal) - 1
    assert all(error < 0.01 for _, error in as_built)
    assert {fix.places for fix, _ in as_built} == {"as-built"}


@pytest.mark.parametrize("method", ["ml", "paper"])
def test_every_located_answer_says_what_it_rests_on(method: Method) -> None:
    frame = frames(tape_7(), measured(tape_7(), 0.0)[1], 1)[0]
    fix = Localizer(tape_7(), method=method).locate(frame.depth)
    assert fix.located and fix.places == "nominal"
    assert fix.to_mapping()["places"] == "nominal"


def test_two_measured_copies_of_one_texture_are_refused() -> None:
    first, second = (measured(tape_7(), 0.05, seed=seed)[0] for seed in (1, 2))
    with pytest.raises(SpecError, match="cannot tell which of them was measured"):
        Localizer([first, second])
    with pytest.raises(SpecError, match="cannot tell"):
        Localizer([first, tape_7()])
    assert len(distinct([first, replace(first)])) == 1


# The bound, and the fit, on few dots by hand


@pytest.mark.parametrize("measured_too", [True, False])
def test_measured_places_are_rivals_of_a_place_by_the_design(monkeypatch: pytest.MonkeyPatch, measured_too: bool) -> None:
    """Beside the answer its own measured place, and another tape's, a little less likely: by Bayes' rule, over all of them."""
    rng = np.random.default_rng(2)
    dots = _some_dots(rng, 8, 0.02)
    fit = fit_grid(dots.xy_px, dots.weights, dots.trust, 0.0, 24.0, 0.0, 0.0, 1.0 / 6.0, True)
    cells, some = np.stack([fit.nodes, fit.nodes + 3]), _measured_as_designed(tape_7())
    place = Place(
        score=20.0, weight=-9.0, tape=0, turn=1, cells=fit.nodes, shown=np.zeros((1, 1), dtype=np.uint8), others=1e-6, lead=15.0,
        most_evidence=25.0, tables=(), groups=(), turn_weights=np.array([0.4, 0.1, 0.4, 0.1]), weights=np.zeros((4, 2)),
    )  # fmt: skip
    found = _Places(tape=np.array([0, 1]), turn=np.array([1, 2]), cells=cells, weight=np.array([-9.0, -8.0]))
    # symbols that could say more: other places are looked at
    evidence = _Evidence(score=np.array([15.0, 16.0]), credit=np.array([0.0, 0.5]), q=np.full((2, 8, 4), 40.0))
    monkeypatch.setattr(built_places, "_candidates", lambda *_: found)
    monkeypatch.setattr(built_places, "_weighed", lambda *_: evidence)
    kinds = (some if measured_too else None, some)
    answer, _ = as_built(place, evidence.q[0], fit, dots.xy_px, dots, (1.5, 1.0 / 6.0), True, [tape_7(), tape_7()], kinds, ())
    assert (answer.as_built, answer.tape, answer.turn) == (False, 0, 1)
    own = np.exp(20.0 - 9.0) * (0.1 if measured_too else 1.0)
    rival = 0.9 * np.exp(16.0 + 0.5 - 8.0)
    assert answer.others * own == pytest.approx(1e-6 * np.exp(20.0 - 9.0) + rival)
    # of single places, whatever their weights; a turn's share is none of its place
    assert answer.lead == pytest.approx(np.log(own * np.exp(9.0) * 0.1) - np.log(0.9 * np.exp(16.5) * 0.4))


@pytest.mark.parametrize("same", [True, False])
def test_a_measured_place_is_compared_with_all_others_by_bayes_rule(same: bool) -> None:
    """By the design with a share of its own, and by what was measured; its lead is over the strongest single place."""
    cells = np.arange(16).reshape(8, 2)
    place = Place(
        score=14.0, weight=-9.0, tape=0, turn=1, cells=cells + (not same), shown=np.zeros((1, 1), dtype=np.uint8), others=1e-3,
        lead=4.0, most_evidence=25.0, tables=(), groups=(), turn_weights=np.array([0.4, 0.1, 0.3, 0.2]), weights=np.zeros((4, 2)),
    )  # fmt: skip
    stack = np.stack([cells + 3, cells, cells + 5])
    found = _Places(tape=np.array([1, 0, 1]), turn=np.array([2, 1, 0]), cells=stack, weight=np.array([-8.0, -9.5, -7.5]))
    evidence = _Evidence(
        score=np.array([9.0, 21.0, 8.5]), credit=np.array([0.5, 1.0, 0.0]), q=np.arange(3.0)[:, None, None] + np.zeros((3, 8, 4))
    )
    best, symbols = _best(place, found, evidence)
    assert (best.as_built, best.tape, best.turn, best.credit) == (True, 0, 1, 1.0)
    assert (best.score, best.weight) == (21.0 + np.log(0.9), -9.5)
    assert (best.cells == cells).all() and (symbols == 1.0).all()
    rivals = (1e-3 + (not same)) * np.exp(14.0 - 9.0) + np.exp(9.5 - 8.0) + np.exp(8.5 - 7.5)
    assert best.others * 0.9 * np.exp(22.0 - 9.5) == pytest.approx(rivals)
    strongest = max(np.exp(9.5) * 0.3, np.exp(8.5) * 0.4, np.exp(14.0 - (4.0 if same else 0.0)) * 0.1)
    assert best.lead == pytest.approx(np.log(0.9 * np.exp(22.0) * 0.1 / strongest))


def test_dots_beyond_the_tape_or_at_missing_parts_have_no_part() -> None:
    tape, _ = measured(tape_7(), 0.1, missing=0.3)
    built = built_of(tape)
    assert built is not None
    gone, there = (tuple(int(v) for v in np.argwhere(of)[0][::-1]) for of in (tape.placed & ~built.present, built.present))
    last = (tape.columns - 1, tape.rows - 1)
    beyond = [(-1, there[1]), (there[0], -1), (tape.columns, 0), (0, tape.rows)]
    cells = np.array([[*beyond, gone, there, last]])
    place = _Places(tape=np.array([0]), turn=np.array([0]), cells=cells, weight=np.zeros(1))
    inside, symbol, off, own = _looked_up(place, [tape], [built])
    assert inside[0].tolist() == [0.0] * 5 + [1.0, float(built.present[last[::-1]])]
    assert (off[0, :4] == 0.0).all()
    for k, (column, row) in ((5, there), (6, last)):
        assert (symbol[0, k], own[0, k]) == (tape.symbols[row, column], built.sigma_mm[row, column])
        assert (off[0, k] == built.shift_mm[row, column]).all()


def test_places_of_most_evidence_are_weighed_anew_and_right_symbols_say_all_they_can() -> None:
    tape, _ = measured(tape_7(), 0.1)
    built = built_of(tape)
    assert built is not None
    cells = np.array(list(product(range(20, 25), range(10, 14))))
    column, row = cells.T
    symbols = tape.symbols[row, column]
    towards = np.array([(0.0, -1.0), (-1.0, 0.0), (1.0, 0.0), (0.0, 1.0)])[symbols]
    xy = 24.0 * (cells + towards / 6.0 + built.shift_mm[row, column] / 1.5)
    dots = Dots(xy_px=xy, weights=np.ones(20), trust=np.full(20, 0.99))
    fit = fit_grid(xy, dots.weights, dots.trust, 0.0, 24.0, 0.0, 0.0, 1.0 / 6.0, True)
    # the order of the directions in q is E, S, W, N
    q = np.full((20, 4), 0.05)
    q[np.arange(20), np.array([3, 2, 0, 1])[symbols]] = 0.85
    world = families([tape], open_world=False)
    place = search([tape], world, cells, q, np.full(4, 0.25), fit.grid, np.zeros(2), None)
    assert place is not None and (place.cells == cells).all()
    own = _Places(tape=np.array([0]), turn=np.array([0]), cells=cells[None], weight=np.array([place.weight]))
    found = _candidates(place, own, [tape], [built], world)
    assert len(found.tape) == CANDIDATES and np.flatnonzero(_is_at(place, found)).tolist() == [0]
    assert found.weight[0] == pytest.approx(place.weight)
    evidence = _weighed(own, fit, xy, dots, _design_odds(fit, dots), (1.5, 1.0 / 6.0), True, [tape], [built])
    # likelier than by the design, which is a credit and no evidence
    assert 1.0 < evidence.credit[0] <= MOST_CREDIT
    assert evidence.score[0] == pytest.approx(np.log(4.0 * evidence.q[0].max(axis=1)).sum())


@pytest.mark.parametrize("directions", [4, 8])
def test_places_round_a_grid_point_are_in_clockwise_order_from_e(directions: int) -> None:
    turn = np.arange(directions) * 2.0 * np.pi / directions
    assert _around(directions) == pytest.approx(np.stack([np.cos(turn), np.sin(turn)], axis=1), abs=1e-7)


def _measured_as_designed(tape: Tape) -> Built | None:
    return built_of(measured(tape, 0.0)[0])


def _some_dots(rng: np.random.Generator, count: int, noise: float) -> Dots:
    cells = np.array(list(product(range(4), range(4))))[rng.permutation(16)[:count]]
    around = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])[rng.integers(0, 4, count)]
    xy = (cells + around / 6.0 + rng.normal(0.0, noise, (count, 2))) * 24.0
    return Dots(xy_px=xy, weights=np.ones(count), trust=np.full(count, 0.99), elongation=np.zeros((count, 2)))


def test_the_mean_evidence_over_all_symbols_is_at_most_1() -> None:
    rng = np.random.default_rng(3)
    dots = _some_dots(rng, 4, 0.05)
    fit = fit_grid(dots.xy_px, dots.weights, dots.trust, 0.0, 24.0, 0.0, 0.0, 1.0 / 6.0, True)
    built, _ = measured(tape_7(), 0.1)
    said = _design_odds(fit, dots)
    cells = fit.nodes - fit.nodes.min(axis=0) + 5
    for turn in range(4):
        place = _Places(tape=np.array([0]), turn=np.array([turn]), cells=cells[None], weight=np.zeros(1))
        values = []
        for symbols in product(range(4), repeat=4):
            changed = built.symbols.copy()
            changed[cells[:, 1], cells[:, 0]] = symbols
            tape = replace(built, symbols=changed)
            # places of the design with these symbols stay where they were: only what they are called changes
            measure = built_of(built)
            found = _weighed(place, fit, dots.xy_px, dots, said, (1.5, 1.0 / 6.0), True, [tape], [measure])
            values.append(float(np.exp(found.score[0])))
        assert 0.0 < np.mean(values) <= 1.0 + 1e-9


@pytest.mark.parametrize("free_scale", [True, False])
def test_without_shifts_the_fit_is_that_of_the_design(free_scale: bool) -> None:
    dots = _some_dots(np.random.default_rng(5), 16, 0.015)
    fit = fit_grid(dots.xy_px, dots.weights, dots.trust, 0.0, 24.0, 0.0, 0.0, 1.0 / 6.0, free_scale)
    around = np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]) / 6.0
    part = dots.trust[None] * 0.99
    nothing = np.zeros((1, 16))
    variance, squares = _fitted(fit, dots.xy_px, dots, part, np.zeros((1, 16, 2)), nothing, around, free_scale)
    np.testing.assert_allclose(squares[0], fit.squares, atol=2e-4)
    np.testing.assert_allclose(np.sqrt(variance[0]), fit.sigma, rtol=0.02)
