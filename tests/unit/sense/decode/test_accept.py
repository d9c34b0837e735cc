"""Acceptance of a place: every limit from both sides, NaN refused, and what an answer says of its dots and its place."""

from __future__ import annotations

from dataclasses import replace
from math import degrees, log, nan, pi
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab import Localizer, Tape
from tactape_fab.sense import ElasticContact, Scene, iterate_frames
from tactape_fab.sense.decode import accept
from tactape_fab.sense.decode.accept import _described, _Doubt, _doubt, _off_scale, _on_tape, _refusal, accept_place
from tactape_fab.sense.decode.contact.tilted import tilted_pose
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.grid.pose import Pose
from tactape_fab.sense.decode.rank import Reading
from tactape_fab.sense.decode.rule import GOOD_TRUST, LEAST_DOTS, MISREAD_SHARE, MOST_ACROSS, SCALE_ERROR, Limits
from tactape_fab.sense.decode.search.hypotheses import Registry
from tactape_fab.sense.decode.search.plane import PlanePlace
from tactape_fab.sense.decode.search.rivals import Rivals
from tactape_fab.sense.decode.search.search import Place
from tactape_fab.sense.decode.search.sequence_plane import SequencePlane
from tactape_fab.sense.decode.search.single_place import shown_by
from tactape_fab.texture.code import get_code
from tests.contacts import DELTA, POSE, TAPE, W, dots, is_near, seen, tape_of, texture_of
from tests.measured import measured

LIMITS = Limits(max_p_false=1e-3, kappa=30.0)
CLEAR = {"p_tape": 1e-9, "p_place": 1e-9, "lead": log(1e6), "agree": 40, "good": 40}


def refused(said: dict[str, float], limits: Limits = LIMITS, unregistered: str | None = None) -> str | None:
    """Why an answer is refused that is clear but in what is said here."""
    of = CLEAR | said
    doubt = _Doubt(p_place=of["p_place"], lead=of["lead"], unregistered=unregistered)
    return _refusal(of["p_tape"], doubt, limits, int(of["agree"]), int(of["good"]))


def test_what_is_clear_is_accepted() -> None:
    assert refused({}) is None


def test_a_scale_that_is_far_off_is_another_or_that_of_another_pitch() -> None:
    view = Localizer([TAPE])._view
    assert _off_scale(view.px_per_mm * (1.0 + view.scale_tolerance + 0.9 * SCALE_ERROR), view) is None
    said = _off_scale(1.2 * view.px_per_mm, view)
    assert said is not None and said.startswith(f"the tape is seen at {1.2 * view.px_per_mm:.4g} px/mm, +20.0% off")
    assert said.endswith(f"another scale, or a tape of W {1.2 * W:.3g} mm")


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        ({"p_tape": 5e-4, "p_place": 5e-4}, None),
        ({"p_tape": 6e-4, "p_place": 5e-4}, "may be no tape of ours: p_false 1.1e-03 exceeds 1.0e-03"),
        ({"p_tape": 5e-4, "p_place": 6e-4}, "several places fit: p_false 1.1e-03 exceeds 1.0e-03"),
        ({"p_tape": 1.0, "p_place": 1.0}, "may be no tape of ours: p_false 1.0e+00 exceeds 1.0e-03"),
        ({"p_tape": nan}, "several places fit: p_false"),
        ({"p_place": nan}, "several places fit: p_false"),
        ({"lead": log(30.0)}, None),
        ({"lead": log(29.9)}, "another place fits nearly as well: it leads by a factor of 29.9, less than 30"),
        ({"lead": 0.0}, "another place fits nearly as well: it leads by a factor of 1.0, less than 30"),
        ({"lead": nan}, "another place fits nearly as well"),
        ({"agree": LEAST_DOTS, "good": LEAST_DOTS}, None),
        ({"agree": LEAST_DOTS - 1, "good": LEAST_DOTS}, f"only {LEAST_DOTS - 1} of {LEAST_DOTS} dots agree with the place"),
        ({"agree": 20, "good": 40}, None),
        ({"agree": 19, "good": 40}, "only 19 of 40 dots agree with the place that their symbols name"),
    ],
)
def test_each_limit_from_both_sides(said: dict[str, float], reason: str | None) -> None:
    found = refused(said)
    assert found is None if reason is None else found is not None and found.startswith(reason)


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        ({"p_tape": 0.01}, None),
        ({"p_tape": 0.01 + 1e-9}, "may be no tape of ours: p_tape 1.0e-02 exceeds 1.0e-02"),
        ({"p_tape": 9e-3, "p_place": 1e-3}, None),
        ({"p_tape": 9e-3, "p_place": 1.1e-3}, "several places fit: p_place 1.1e-03 exceeds 1.0e-03"),
        ({"p_place": nan}, "several places fit: p_place"),
        ({"p_tape": nan}, "may be no tape of ours: p_tape"),
    ],
)
def test_a_limit_of_its_own_for_the_texture(said: dict[str, float], reason: str | None) -> None:
    found = refused(said, replace(LIMITS, max_p_tape=0.01))
    assert found is None if reason is None else found is not None and found.startswith(reason)


def test_an_unregistered_tape_is_named_before_all_else() -> None:
    for key in ("p_tape", "lead", "agree"):
        assert refused({key: 0.0}, unregistered="s9") == "looks like s9, which is not registered"


# Doubt

FOUND = Rivals(weight=2.0, lead=1.0, score=60.0, name="s9")
P_TAPE = 1e-6


@pytest.fixture
def place() -> Place:
    """Any place: of its fields those that doubt looks at are given by each test."""
    said = {"score": 50.0, "weight": -9.0, "tape": 0, "turn": 0, "others": 1e-7, "lead": 40.0, "most_evidence": 99.0}
    arrays = {"cells": np.zeros((6, 2), dtype=np.int64), "shown": np.zeros((9, 9), dtype=np.uint8)}
    weights = {"turn_weights": np.full(4, 0.25), "weights": np.zeros((4, 2))}
    fields: dict[str, Any] = {**said, **arrays, **weights, "tables": (), "groups": ()}
    return Place(**fields)


def doubted(
    monkeypatch: pytest.MonkeyPatch, place: Place, found: Rivals = FOUND, p_tape: float = P_TAPE, share: float = 0.01
) -> tuple[_Doubt, dict[str, Any]]:
    """The doubt where `found` is what unregistered tapes say, and how these were asked."""
    asked: dict[str, Any] = {}

    def rivals(families: object, place: Place, share: float, precision: float, least: float, *, beyond: bool) -> Rivals:
        asked.update(rivals=(share, precision, least), beyond=beyond)
        return found

    def best_unregistered(families: object, place: Place, share: float, least: float) -> Rivals:
        asked.update(best_unregistered=(share, least))
        return found

    monkeypatch.setattr(accept, "rivals", rivals)
    monkeypatch.setattr(accept, "best_unregistered", best_unregistered)
    world = Registry(tapes=(TAPE,), families=(), unregistered_share=share)
    return _doubt(place, world, LIMITS, p_tape), asked


CLEAR_LN = log(1e6) - log(LIMITS.max_p_false)


def test_in_a_closed_world_only_registered_places_count(monkeypatch: pytest.MonkeyPatch, place: Place) -> None:
    found, asked = doubted(monkeypatch, place, share=0.0)
    assert asked == {} and (found.lead, found.unregistered) == (40.0, None)
    assert found.p_place == pytest.approx((1e-7 + MISREAD_SHARE * P_TAPE) / (1.0 + 1e-7 + MISREAD_SHARE * P_TAPE))


def test_unregistered_places_are_others_too(monkeypatch: pytest.MonkeyPatch, place: Place) -> None:
    weak = replace(FOUND, score=CLEAR_LN)
    found, asked = doubted(monkeypatch, place, weak)
    assert asked == {"rivals": (0.01, LIMITS.precision, log(LIMITS.kappa)), "beyond": True}
    assert found.p_place == pytest.approx(2.0 / 3.0, abs=1e-6)
    assert (found.lead, found.unregistered) == (1.0, None)
    assert doubted(monkeypatch, replace(place, lead=0.5), weak)[0].lead == 0.5


def test_chance_at_the_edges_counts_unless_the_dots_exclude_it(monkeypatch: pytest.MonkeyPatch, place: Place) -> None:
    for p_tape, beyond in ((1e-5 * LIMITS.max_p_false, False), (1.001e-5 * LIMITS.max_p_false, True)):
        assert doubted(monkeypatch, place, p_tape=p_tape)[1]["beyond"] is beyond


def test_what_measured_places_say_is_credited_against_those_that_were_not_measured(
    monkeypatch: pytest.MonkeyPatch, place: Place
) -> None:
    weak = replace(FOUND, score=CLEAR_LN)
    found, _ = doubted(monkeypatch, replace(place, credit=log(2.0)), weak)
    assert found.p_place == pytest.approx(1.0 / 2.0, abs=1e-6)
    assert found.lead == pytest.approx(1.0 + log(2.0))
    against, _ = doubted(monkeypatch, replace(place, credit=-log(4.0)), weak)
    assert against.p_place == pytest.approx(2.0 / 3.0, abs=1e-6) and against.lead == 1.0


@pytest.mark.parametrize("p_tape", [P_TAPE, 0.5], ids=["clear", "refused"])
@pytest.mark.parametrize(
    ("score", "lead", "is_named"),
    [
        (CLEAR_LN + 1e-6, 1.0, True),
        (CLEAR_LN, 1.0, False),
        (60.0, log(LIMITS.kappa) - 1e-6, True),
        (60.0, log(LIMITS.kappa), False),
        (60.0, -5.0, True),
    ],
)
def test_a_stranger_is_named_if_it_would_be_accepted_itself(
    p_tape: float, score: float, lead: float, is_named: bool, monkeypatch: pytest.MonkeyPatch, place: Place
) -> None:
    found, asked = doubted(monkeypatch, place, replace(FOUND, score=score, lead=lead), p_tape=p_tape)
    assert found.unregistered == ("s9" if is_named else None)
    assert ("best_unregistered" in asked) is (p_tape > LIMITS.max_p_false)
    assert asked.get("best_unregistered", (0.01, CLEAR_LN)) == (0.01, pytest.approx(CLEAR_LN))


def test_what_is_refused_anyhow_is_searched_only_for_a_name(monkeypatch: pytest.MonkeyPatch, place: Place) -> None:
    found, asked = doubted(monkeypatch, replace(place, most_evidence=CLEAR_LN - 1e-6), p_tape=0.5)
    assert asked == {} and found.lead == place.lead
    assert "best_unregistered" in doubted(monkeypatch, replace(place, most_evidence=CLEAR_LN + 1e-6), p_tape=0.5)[1]
    unnamed, _ = doubted(monkeypatch, place, replace(FOUND, score=0.0), p_tape=0.5)
    assert unnamed.p_place == found.p_place and unnamed.lead == place.lead
    exact, asked = doubted(monkeypatch, replace(place, most_evidence=0.0), p_tape=LIMITS.max_p_false)
    assert "rivals" in asked and exact.p_place > 0.5


# Answers

POSE_OF = Pose(
    position_mm=np.array([12.0, 7.5]),
    theta_rad=-pi,
    px_per_mm=16.0,
    covariance=np.eye(3),
    agree=np.ones(6, dtype=bool),
    sigma_mm=0.01,
    camera=np.zeros((2, 3)),
)


def test_an_answer_in_the_frames_of_the_contract(place: Place) -> None:
    other = tape_of(9)
    world = Registry(tapes=(TAPE, other), families=(), unregistered_share=0.0)
    said = _described(replace(place, tape=1), world, np.array([5, 3]), np.array([7.4, 4.6]), POSE_OF)
    x0, y0 = other.board.texture_origin_mm
    assert (said["tape"], said["sector"], said["cell"]) == ("s9", 9, (5, 3))
    assert said["index"] == (other.origin[0] + 5, other.origin[1] + 3)
    assert (said["position_mm"], said["contact_mm"], said["px_per_mm"]) == ((12.0, 7.5), (7.4, 4.6), 16.0)
    assert said["board_mm"] == pytest.approx((x0 + 12.0, y0 - 7.5))
    assert said["theta_deg"] == 180.0
    for theta_rad, theta_deg in ((pi, 180.0), (0.5, degrees(0.5)), (-3.0, degrees(-3.0))):
        turned = _described(place, world, np.array([5, 3]), np.zeros(2), replace(POSE_OF, theta_rad=theta_rad))
        assert turned["theta_deg"] == pytest.approx(theta_deg)


def test_an_answer_in_the_plane_of_a_code_names_no_tape() -> None:
    code = get_code("microdots-4x4").sequences
    assert code is not None
    bits = np.zeros(6, dtype=np.int64)
    at: dict[str, Any] = {"score": 50.0, "weight": 0.0, "turn": 0, "sector": 33, "others": 0.0, "lead": 9.0}
    place = PlanePlace(**at, cells=np.zeros((6, 2), dtype=np.int64), x_bits=bits, y_bits=bits)
    said = _described(place, SequencePlane(code, 64), np.array([5, 3]), np.zeros(2), POSE_OF)
    assert (said["sector"], said["index"], said["plane_mm"]) == (33, (5, 3), (12.0, 7.5))
    assert not {"tape", "cell", "position_mm", "board_mm"} & set(said)


def test_dots_in_a_code_s_plane_are_good_above_the_limit() -> None:
    trust = np.array([0.0, 0.5 * GOOD_TRUST, GOOD_TRUST, np.nextafter(GOOD_TRUST, 1.0), 1.0])
    bits = np.zeros(5, dtype=np.int64)
    at: dict[str, Any] = {"score": 50.0, "weight": 0.0, "turn": 0, "sector": 33, "others": 0.0, "lead": 9.0}
    place = PlanePlace(**at, cells=np.zeros((5, 2), dtype=np.int64), x_bits=bits, y_bits=bits)
    view: Any = SimpleNamespace(pitch_mm=W, displacement_mm=DELTA, centre_px=np.zeros(2))
    on = _on_tape(Dots(xy_px=np.zeros((5, 2)), weights=np.ones(5), trust=trust), place, view, None)
    assert on.good == 2 and on.weights == pytest.approx([0.0, 0.5, 1.0, 1.0, 1.0])


def test_half_a_contact_may_hang_over_the_edge() -> None:
    """Dots beyond the tape neither agree nor count; the contact dot is the one of the tape that is nearest to the contact."""
    texture = texture_of(TAPE)
    around = np.array([(c * W, r * W + DELTA) for c in range(-4, 0) for r in range(3, 12)])
    seen_px = dots((0.5, 11.0), 20.0, texture_mm=np.concatenate([texture, around]))
    own = dots((0.5, 11.0), 20.0, texture_mm=texture)
    fix = Localizer([TAPE], world="closed").locate_dots(seen_px)
    assert fix.located and fix.position_mm == pytest.approx((0.5, 11.0), abs=1e-5)
    assert fix.n_dots == len(seen_px) > len(own) == fix.n_agree
    assert fix.cell is not None and fix.cell[0] >= 0


# Poses


def judged(place: Place, on_tape: int, unregistered_share: float = 0.0) -> tuple[Any, bool]:
    """What is said of a place with so many dots on its tape, and four beside it."""
    cells = np.array([*[(c, r) for r in range(4, 9) for c in range(4, 9)][:on_tape], (-9, -9), (-8, -9), (-9, -8), (-8, -8)])
    index = {cell: n for n, cell in enumerate((c, r) for r in range(TAPE.rows) for c in range(TAPE.columns))}
    texture = texture_of(TAPE)
    xy_px = seen(np.array([texture[index[c, r]] if c >= 0 else (c * W, r * W) for c, r in cells.tolist()]), (9.0, 9.0), 0.0)
    n = len(cells)
    found = Dots(xy_px=xy_px, weights=np.ones(n), trust=np.ones(n), elongation=np.zeros((n, 2)))
    reading = Reading(place=replace(place, cells=cells, shown=shown_by(TAPE)), grid_weight=0.0)
    world = Registry(tapes=(TAPE,), families=(), unregistered_share=unregistered_share)
    return accept_place(found, reading, Localizer([TAPE])._view, world, LIMITS)


def test_enough_dots_must_lie_on_the_tape(place: Place) -> None:
    sure = replace(place, score=99.0, others=0.0)
    fix, explained = judged(sure, LEAST_DOTS)
    assert (fix.located, fix.n_agree, explained) == (True, LEAST_DOTS, False)
    assert is_near(fix, (9.0, 9.0), 0.0, 2e-3, 0.05)
    fix, explained = judged(sure, LEAST_DOTS - 1)
    assert (fix.located, fix.reason, explained) == (False, "too few dots lie on a tape", False)


@pytest.mark.parametrize(("rotation_deg", "says"), [(45.0, "135 deg"), (0.0, "90 deg"), (90.0, "0 deg"), (135.0, "45 deg")])
def test_parts_that_lie_across_have_a_rotation_of_their_own(
    rotation_deg: float, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    tape = replace(TAPE, part=replace(TAPE.part, rotation_deg=rotation_deg))
    found = Dots(xy_px=np.zeros((6, 2)), weights=np.ones(6), trust=np.ones(6), elongation=np.zeros((6, 2)))
    for ratio, lies in ((-MOST_ACROSS, False), (-MOST_ACROSS - 0.01, True)):
        monkeypatch.setattr(accept, "parity_log_ratio", lambda *_, said=ratio: said)
        reason = accept._across(found, POSE_OF, tape)
        assert (reason is not None and reason.endswith(f"with a rotation of {says}")) if lies else reason is None
    assert accept._across(found, POSE_OF, None) is None


def test_dots_without_a_pose_are_not_located(monkeypatch: pytest.MonkeyPatch, place: Place) -> None:
    nowhere = replace(POSE_OF, covariance=np.full((3, 3), np.inf))
    monkeypatch.setattr(accept, "fit_pose", lambda *_, **__: nowhere)
    fix, explained = judged(replace(place, score=99.0, others=0.0), LEAST_DOTS)
    assert (fix.located, fix.reason, explained) == (False, "the dots give no pose", False)


def test_dots_beside_the_tape_may_be_those_of_another(monkeypatch: pytest.MonkeyPatch, place: Place) -> None:
    monkeypatch.setattr(accept, "rivals", lambda *_, **__: FOUND)
    fix, explained = judged(replace(place, score=99.0), LEAST_DOTS - 1, 0.01)
    assert (fix.located, fix.reason, explained) == (False, "looks like s9, which is not registered", True)


def drifting(tape: Tape, drift_mm: float) -> Tape:
    """Measured places that neighbours have wrong together by so much, besides what each is wrong by."""
    built = tape.as_built
    assert built is not None
    sigma_mm = np.hypot(built.sigma_mm, drift_mm)
    return replace(tape, as_built=replace(built, sigma_mm=sigma_mm, source=({"kind": "scan", "drift_mm": drift_mm},)))


def test_measured_places_are_where_the_dots_are_and_their_drift_is_the_answer_s() -> None:
    built, _ = measured(TAPE, 0.05)
    assert built.as_built is not None
    moved = texture_of(TAPE) + np.stack([built.as_built.dx_mm, -built.as_built.dy_mm], axis=1)
    xy_px = dots(texture_mm=moved)
    steady, unsteady = (Localizer([drifting(built, mm)], world="closed").locate_dots(xy_px) for mm in (0.0, 0.3))
    for fix in (steady, unsteady):
        assert fix.located and fix.places == "as-built" and is_near(fix, *POSE, 1e-5, 1e-4)
        assert np.abs(np.array(fix.contact_mm) - texture_of(TAPE)).max(axis=1).min() < 1e-9  # the nominal centre
    assert steady.covariance is not None and unsteady.covariance is not None
    np.testing.assert_allclose(unsteady.covariance - steady.covariance, np.diag([0.09, 0.09, 0.0]), atol=1e-9)
    assert steady.covariance[2, 2] < 1e-3  # a drift turns nothing
    nominal = Localizer([TAPE], world="closed").locate_dots(xy_px)
    assert nominal.located and not is_near(nominal, *POSE, 1e-4, 1e-3)


def test_without_tapes_a_contact_has_its_place_in_the_plane() -> None:
    fix = Localizer.from_code(TAPE.code, W, DELTA).locate_dots(dots())
    known = Localizer([TAPE], world="closed").locate_dots(dots())
    assert fix.located and (fix.sector, fix.index) == (7, known.index), fix.reason
    assert fix.plane_mm == pytest.approx(np.array(TAPE.origin) * W + POSE[0], abs=1e-5)
    assert fix.n_agree == len(dots()) and fix.theta_deg == pytest.approx(POSE[1], abs=1e-4)


def test_dots_of_a_tilted_tape_are_sharpened_as_they_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole dots, which the contact's rim does not move, are at the same places with the rim's correction and as detected."""
    given: list[tuple[Any, ...]] = []

    def tilted(*args: Any) -> Any:
        given.append(args)
        return tilted_pose(*args)

    monkeypatch.setattr(accept, "tilted_pose", tilted)
    scene = Scene(elastic=ElasticContact(tilt_deg=(5.0, 0.0)))
    (frame,) = iterate_frames(TAPE, 1, 3, scene=scene)
    assert Localizer([TAPE]).locate(frame.depth).located
    _, _, offset_px, seen_px, _, weights, *_ = given[0]
    whole = weights >= 1.0
    assert whole.sum() > 4 and seen_px[whole] == pytest.approx(offset_px[whole], abs=1e-6)
