"""Localizer: signs of the contract with dots drawn by it, every field of an answer, every refusal, the registry."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from fractions import Fraction
from math import atan2, cos, degrees, radians, sin
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tactape_fab import Localization, Localizer, Prior, TapeSpec
from tactape_fab.base.errors import SpecError
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import load_sensor, simulate
from tactape_fab.sense.decode.settings import USUAL, given_settings, setting_problems
from tactape_fab.sense.geometry import Geometry
from tests.bench.impostors import plain_grid, random_symbols
from tests.contacts import CENTRE, DELTA, POSE, SHIFT, TAPE, R, W, dots, is_near, seen, tape_of, texture_of


def plain(fix: Localization) -> dict[str, Any]:
    """All fields but the time, to be compared."""
    return {k: v for k, v in fix.to_mapping(0).items() if k != "elapsed_ms"}


@pytest.fixture(scope="module")
def closed() -> Localizer:
    return Localizer([TAPE], world="closed")


# Conventions


def test_the_worked_example_of_the_contract(localizer: Localizer) -> None:
    point = np.array([[20 + cos(radians(30)), 12 - sin(radians(30))]])
    assert seen(point, (20.0, 12.0), 30.0)[0] == pytest.approx((175.5, 119.5))
    fix = localizer.locate_dots(dots((20.0, 12.0), 30.0))
    assert fix.located
    assert fix.position_mm == pytest.approx((20.0, 12.0), abs=1e-6)
    assert fix.theta_deg == pytest.approx(30.0, abs=1e-5)


def test_a_tape_without_parts_at_its_left_end_is_prepared_for() -> None:
    """As every tape: all kernels are compiled, with no warning, which is an error here."""
    bare = np.argwhere(np.ones((TAPE.rows, 9), dtype=bool))[:, ::-1].astype(np.int64)
    found = Localizer([replace(TAPE, omitted=bare)]).locate_dots(dots())
    assert found.located and is_near(found, *POSE, 1e-4, 1e-3)


@pytest.mark.parametrize("theta_deg", [0.0, 45.0, 90.0, 135.0, 179.9, 180.0, -45.0, -90.0, -135.0, -179.9, 7.3])
def test_any_turn_is_told(localizer: Localizer, theta_deg: float) -> None:
    fix = localizer.locate_dots(dots((47.7, 21.2), theta_deg))
    assert fix.located and is_near(fix, (47.7, 21.2), theta_deg, 1e-4, 1e-3)
    assert fix.theta_deg is not None and -180.0 < fix.theta_deg <= 180.0


def test_a_depth_map_gives_the_pose_that_it_was_drawn_at(localizer: Localizer, depth: npt.NDArray[np.float32]) -> None:
    fix = localizer.locate(depth, timestamp=12.5)
    assert fix.located and is_near(fix, *POSE, mm=0.02, deg=0.3)
    assert fix.timestamp == 12.5


# Fields


def test_every_field_of_an_answer(localizer: Localizer) -> None:
    xy = dots()
    fix = localizer.locate_dots(xy, np.ones(len(xy)), timestamp=3.25)
    assert (fix.status, fix.located, fix.reason, fix.tape, fix.sector) == ("solid", True, None, TAPE.name, 7)
    assert fix.position_mm == pytest.approx(POSE[0], abs=1e-6)
    x0, y0 = TAPE.board.texture_origin_mm
    assert fix.board_mm == pytest.approx((x0 + POSE[0][0], y0 - POSE[0][1]), abs=1e-6)
    assert fix.cell is not None and fix.contact_mm is not None
    column, row = fix.cell
    letter = TAPE.to_mapping()["symbols"][row][column]
    nominal = (column * W + DELTA * SHIFT[letter][0], row * W + DELTA * SHIFT[letter][1])
    assert fix.contact_mm == pytest.approx(nominal)
    middle_px = xy.mean(axis=0)
    nearest = xy[np.hypot(*(xy - middle_px).T).argmin()]
    assert seen(np.array([nominal]), *POSE)[0] == pytest.approx(nearest, abs=1e-6)
    assert fix.index == (TAPE.origin[0] + column, TAPE.origin[1] + row)
    assert fix.plane_mm is None
    assert fix.px_per_mm == pytest.approx(R)
    assert fix.covariance is not None and fix.covariance.shape == (3, 3)
    assert fix.covariance == pytest.approx(fix.covariance.T, rel=1e-6, abs=1e-12)
    assert (np.linalg.eigvalsh(fix.covariance) > 0).all()
    assert (fix.n_dots, fix.n_agree) == (len(xy), len(xy))
    assert fix.p_tape is not None and fix.p_place is not None and fix.p_false is not None
    assert fix.p_tape > 0 and fix.p_place > 0 and fix.p_false < 1e-4
    assert fix.p_false == pytest.approx(fix.p_tape + fix.p_place)
    assert fix.elapsed_ms > 0 and fix.timestamp == 3.25
    for stamp in (np.int64(1_700_000_000_123_456_789), np.float32(0.5), np.uint8(3)):  # of arrays of times
        found = localizer.locate_dots(xy, timestamp=stamp)  # type: ignore[arg-type]
        assert json.loads(json.dumps(found.to_mapping(np.int64(4))))["timestamp"] == stamp  # type: ignore[arg-type]
        assert type(found.timestamp) in (int, float)
    for exact in (Fraction(1, 4), np.longdouble(0.25)):
        found = localizer.locate_dots(xy, timestamp=exact)  # type: ignore[arg-type]
        assert found.timestamp == 0.25 and type(found.timestamp) is float
    for unknown in (float("nan"), np.inf):
        told = localizer.locate_dots(xy, timestamp=unknown).to_mapping()
        assert told["timestamp"] is None and json.dumps(told, allow_nan=False)


def test_an_answer_is_plain_json() -> None:
    fix = Localizer([TAPE]).locate_dots(dots())
    told = json.loads(json.dumps(fix.to_mapping(5)))
    contact = ["tilt_deg", "tilt_covariance", "indentation_mm", "indentation_sigma_mm", "force_n", "force_sigma_n"]
    names = ["frame", *(f.name for f in fields(Localization) if f.name not in ("dots", "contact")), *contact]
    assert sorted(told) == sorted(names)
    assert [told[name] for name in contact] == [None] * 6  # dots alone say nothing of depth
    assert told["frame"] == 5
    assert np.shape(told["covariance"]) == (3, 3)


def test_what_is_not_located_is_not_guessed(localizer: Localizer) -> None:
    fix = localizer.locate_dots(dots(semi_mm=(2.6, 2.6)))
    assert not fix.located and fix.reason
    for name in ("tape", "position_mm", "theta_deg", "board_mm", "contact_mm", "cell", "index", "covariance"):
        assert getattr(fix, name) is None, name


def test_equal_frames_give_equal_answers(localizer: Localizer, depth: npt.NDArray[np.float32]) -> None:
    first, again, other = localizer.locate(depth), localizer.locate(depth.copy()), Localizer([TAPE]).locate(depth)
    assert plain(first) == plain(again) == plain(other)


def test_a_frame_is_left_as_it_was(localizer: Localizer, depth: npt.NDArray[np.float32]) -> None:
    frame = depth.copy()
    frame[3, 4] = np.nan
    kept = frame.copy()
    localizer.locate(frame)
    assert np.array_equal(frame, kept, equal_nan=True)
    frame.setflags(write=False)
    assert localizer.locate(frame).located


@pytest.mark.parametrize("dtype", [np.float64, np.float16, np.int32, np.uint16])
def test_any_type_of_number_is_a_depth(localizer: Localizer, depth: npt.NDArray[np.float32], dtype: type) -> None:
    frame = ((depth - depth.min()) * (1000.0 if dtype is np.float16 else 50_000.0)).astype(dtype)
    assert is_near(localizer.locate(frame), *POSE, mm=0.02, deg=0.3)


def test_dots_need_no_order(localizer: Localizer) -> None:
    xy = dots() + np.random.default_rng(1).normal(0, 0.3, dots().shape)
    shuffled = np.random.default_rng(0).permutation(xy)
    a, b = localizer.locate_dots(xy), localizer.locate_dots(shuffled)
    assert a.position_mm == pytest.approx(b.position_mm, abs=1e-9)
    assert a.cell == b.cell


# Status and refusals


@pytest.mark.parametrize(("count", "status"), [(0, "none"), (1, "weak"), (15, "weak"), (16, "solid")])
def test_status_counts_dots(localizer: Localizer, count: int, status: str) -> None:
    fix = localizer.locate_dots(dots()[:count])
    assert (fix.status, fix.n_dots) == (status, count)
    if count < 6:
        assert not fix.located
        assert fix.reason == ("no dots" if count == 0 else f"only {count} dots")


def test_dots_on_no_grid_are_refused(localizer: Localizer) -> None:
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = CENTRE + 77.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    fix = localizer.locate_dots(ring)
    assert not fix.located and fix.reason


@pytest.mark.parametrize("world", ["open", "closed"])
def test_other_textures_are_not_ours(world: Any) -> None:
    found = Localizer([TAPE], world=world)
    for parts in (plain_grid(TAPE), random_symbols(TAPE, 5)):
        fix = found.locate(simulate(TAPE, POSE[0], POSE[1], parts=parts))
        assert not fix.located
        assert fix.p_false is None or fix.p_false > 1e-3
        assert fix.reason


def test_a_small_contact_says_what_is_missing(closed: Localizer) -> None:
    fix = closed.locate_dots(dots(semi_mm=(2.2, 2.2)))
    assert not fix.located and fix.reason is not None
    assert "p_false" in fix.reason and "1.0e-04" in fix.reason


@pytest.mark.parametrize("sector", [8, 24, 100, 246])
def test_a_tape_that_nobody_registered_is_named(localizer: Localizer, sector: int) -> None:
    fix = localizer.locate_dots(dots(texture_mm=texture_of(tape_of(sector))))
    assert not fix.located
    assert fix.reason is not None and f"sector {sector} " in fix.reason and "not registered" in fix.reason


def test_a_registered_tape_is_no_rival_of_itself_in_another_place() -> None:
    found = Localizer([TAPE, tape_of(24)])
    fix = found.locate_dots(dots(texture_mm=texture_of(tape_of(24))))
    assert fix.located and (fix.tape, fix.sector) == ("s24", 24)
    assert found.locate_dots(dots()).sector == 7


def test_the_closed_world_has_fewer_rivals(localizer: Localizer, closed: Localizer) -> None:
    xy = dots(semi_mm=(4.0, 4.0))
    wide, narrow = localizer.locate_dots(xy), closed.locate_dots(xy)
    assert wide.p_tape == pytest.approx(narrow.p_tape)
    assert wide.p_place is not None and narrow.p_place is not None
    assert 0 < narrow.p_place < wide.p_place


def test_equal_windows_are_never_answered() -> None:
    """Two tapes that overlap in the code plane: nothing tells them apart, whatever the limit."""
    other = replace(tape_of(7, (TAPE.origin[0] + 10, TAPE.origin[1])), name="shifted")
    found = Localizer([TAPE, other], max_p_false=0.9)
    fix = found.locate_dots(dots())
    assert not fix.located and fix.reason is not None
    assert fix.p_place is not None and fix.p_place == pytest.approx(0.5, abs=0.01)
    assert found.locate_dots(dots((8.0, 22.1))).tape == TAPE.name  # beyond the overlap


def test_tapes_whose_parts_lie_otherwise_are_located_in_any_order() -> None:
    """What the dots' shape says of a quarter turn holds for the tape whose parts lie so, and not for all that are registered."""
    turned = replace(tape_of(33), part=replace(TAPE.part, rotation_deg=135.0))
    depth = simulate(turned, *POSE, contact_mm=(7.0, 7.0), seed=4)
    first, last = (Localizer(tapes, world="closed").locate(depth) for tapes in ([turned, TAPE], [TAPE, turned]))
    assert first.tape == last.tape == turned.name
    assert first.theta_deg == last.theta_deg and is_near(last, *POSE, mm=0.02, deg=0.4)
    assert first.p_false == pytest.approx(last.p_false, rel=0.01)


def test_a_stricter_limit_refuses() -> None:
    strict = Localizer([TAPE], max_p_false=1e-30)
    fix = strict.locate_dots(dots())
    assert not fix.located and fix.reason is not None and "1.0e-30" in fix.reason


def test_the_limit_on_the_texture_may_be_wider(closed: Localizer) -> None:
    contacts = (
        dots((x, y), 30.0, (semi, semi)) for semi in np.linspace(2.4, 3.4, 11) for x in (20.3, 40.3, 60.3) for y in (15.2, 30.4)
    )
    for xy in contacts:
        fix = closed.locate_dots(xy)
        if (fix.p_false or 1.0) > 1.1e-4 and (fix.p_tape or 1.0) < 0.9e-2 and (fix.p_place or 1.0) < 0.9e-4:
            break
    else:
        pytest.fail("no contact is in between")
    assert not fix.located
    assert Localizer([TAPE], world="closed", max_p_tape=1e-2).locate_dots(xy).located


def test_a_narrower_limit_on_the_texture_is_kept() -> None:
    assert not Localizer([TAPE], max_p_tape=1e-30).locate_dots(dots()).located


def test_mirrored_dots_are_not_located(localizer: Localizer) -> None:
    for axis in ((-1.0, 1.0), (1.0, -1.0)):
        fix = localizer.locate_dots((dots() - CENTRE) * axis + CENTRE)
        assert not fix.located


def test_mirrored_frames_are_named(localizer: Localizer, depth: npt.NDArray[np.float32]) -> None:
    assert "mirror" in (localizer.locate(depth[:, ::-1]).reason or "")


def test_a_prior_is_refused_where_nothing_uses_it(localizer: Localizer) -> None:
    prior = Prior(position_mm=POSE[0], theta_deg=POSE[1])
    assert localizer.locate_dots(dots(), prior=prior).located
    for other in (Localizer([TAPE], method="paper"), Localizer.from_code(TAPE.code, W, DELTA)):
        with pytest.raises(SpecError, match="prior"):
            other.locate_dots(dots(), prior=prior)
        with pytest.raises(SpecError, match="prior"):
            other.locate(np.zeros((240, 320)), prior=prior)


@pytest.mark.parametrize("method", ["ml", "paper"])
def test_the_profile_s_camera_is_undone_before_a_frame_is_read(method: Any) -> None:
    sensor = replace(load_sensor("gelsight-mini"), geometry=Geometry(aspect=0.08, shear=0.1, k1=0.05))
    fix = Localizer([TAPE], sensor, method=method).locate(simulate(TAPE, *POSE, sensor=sensor, seed=4))
    assert fix.tape == TAPE.name and is_near(fix, *POSE, mm=0.08, deg=0.6)


@pytest.mark.parametrize("method", ["ml", "paper"])
def test_oblong_pixels_are_the_same_contact(method: str) -> None:
    sensor = replace(load_sensor("gelsight-mini"), px_per_mm=(16.0, 12.0), height_px=180)
    square = dots((50.0, 25.0), 40.0, (6.0, 6.0))
    oblong = (square - CENTRE) * (1.0, 0.75) + sensor.centre_px
    fix = Localizer([TAPE], sensor, method=method).locate_dots(oblong)  # type: ignore[arg-type]
    assert fix.located and fix.position_mm is not None and fix.theta_deg is not None
    assert np.hypot(*np.subtract(fix.position_mm, (50.0, 25.0))) < 0.05
    assert abs(fix.theta_deg - 40.0) < 1.0


BENT = Geometry(aspect=0.05, shear=0.04, k1=0.05, center_px=(170.0, 100.0))


@pytest.mark.parametrize("fixed_scale", [False, True])
def test_dots_are_seen_through_the_profile_s_camera(localizer: Localizer, fixed_scale: bool) -> None:
    sensor = replace(load_sensor("gelsight-mini"), geometry=BENT)
    camera, square = sensor.camera, dots((50.0, 25.0), 40.0)
    xy = camera.to_px((square - CENTRE) / R + camera.from_px(sensor.centre_px))
    fix = Localizer([TAPE], sensor, fixed_scale=fixed_scale).locate_dots(xy)
    assert fix.located and is_near(fix, (50.0, 25.0), 40.0, 1e-4, 1e-3)
    assert fix.n_agree == len(xy) and fix.px_per_mm == pytest.approx(R)
    stock = localizer.locate_dots(xy)
    assert not stock.located or stock.n_agree < len(xy) or not is_near(stock, (50.0, 25.0), 40.0, 1e-4, 1e-3)


def test_a_depth_map_is_seen_through_the_profile_s_camera() -> None:
    sensor = replace(load_sensor("gelsight-mini"), geometry=BENT)
    fix = Localizer([TAPE], sensor).locate(simulate(TAPE, *POSE, sensor=sensor, seed=4))
    assert fix.located and is_near(fix, *POSE, mm=0.03, deg=0.4)


def test_what_the_profile_knows_of_its_camera_makes_the_covariance_smaller() -> None:
    known = Geometry(sigma_px_per_mm=0.01, sigma_aspect=0.001, sigma_shear=0.001, sigma_k1=0.001)
    xy = dots() + np.random.default_rng(3).normal(0.0, 0.3, dots().shape)
    wide, narrow = (
        Localizer([TAPE], replace(load_sensor("gelsight-mini"), geometry=geometry)).locate_dots(xy)
        for geometry in (Geometry(), known)
    )
    assert wide.covariance is not None and narrow.covariance is not None
    assert (np.diag(narrow.covariance) < np.diag(wide.covariance)).all()
    assert narrow.covariance[2, 2] < 0.7 * wide.covariance[2, 2]


# Registry


def test_equal_tapes_are_one() -> None:
    found = Localizer([TAPE, replace(TAPE, name="second roll")])
    assert [tape.name for tape in found.tapes] == [TAPE.name]
    assert found.locate_dots(dots()).tape == TAPE.name


def test_the_larger_of_two_equal_tapes_counts_under_the_first_name() -> None:
    small = replace(tape_of(7, columns=20, rows=20), name="first")
    found = Localizer([small, TAPE])
    fix = found.locate_dots(dots((70.0, 40.0)))
    assert fix.located and fix.tape == "first"


def test_equal_tapes_are_the_union_of_their_grids() -> None:
    wide, high = replace(tape_of(7, columns=62, rows=12), name="wide"), replace(tape_of(7, columns=14, rows=32), name="high")
    found = Localizer([wide, high])
    assert found.locate_dots(dots((80.0, 8.0), texture_mm=texture_of(wide))).tape == "wide"
    assert found.locate_dots(dots((9.0, 40.0), texture_mm=texture_of(high))).tape == "wide"


@pytest.mark.parametrize("method", ["ml", "paper"])
def test_equal_tapes_that_lie_elsewhere_on_their_boards_have_no_board_frame(method: Any) -> None:
    small = examine(TapeSpec(sector=7, size_mm=(60.0, 30.0), name="small")).layout.tape
    alone, both = Localizer([TAPE], method=method), Localizer([small, TAPE], method=method)
    assert alone.locate_dots(dots()).board_mm is not None
    fix = both.locate_dots(dots())
    assert fix.tape == "small" and fix.position_mm is not None and fix.board_mm is None
    assert Localizer([TAPE, replace(TAPE, name="copy")], method=method).locate_dots(dots()).board_mm is not None


def test_omitted_points_do_not_count_against_a_place() -> None:
    holed = examine(TapeSpec(sector=7, holes_mm=[(47.0, 26.0, 3.0)])).layout.tape
    assert 4 <= len(holed.omitted) <= 20
    fix = Localizer([holed]).locate_dots(dots(texture_mm=texture_of(holed)))
    assert fix.located and is_near(fix, *POSE, mm=1e-4)


@pytest.mark.parametrize("code", ["debruijn-4x4", "anoto-6x6"])
def test_other_codes(code: str) -> None:
    tape = examine(TapeSpec(sector=7, code=code)).layout.tape
    fix = Localizer([tape], world="closed").locate_dots(dots(texture_mm=texture_of(tape)))
    assert fix.located and is_near(fix, *POSE, mm=1e-4)


def test_contacts_over_the_edge(localizer: Localizer) -> None:
    fix = localizer.locate_dots(dots((1.2, 20.0), 200.0))
    assert fix.located and is_near(fix, (1.2, 20.0), 200.0, mm=1e-4)


def test_all_that_is_wrong_with_a_localizer_is_said_at_once() -> None:
    with pytest.raises(SpecError) as caught:
        Localizer([], world="half", max_p_false=0.0, max_p_tape=2.0, unregistered_share=float("nan"), kappa=0.5)  # type: ignore[arg-type]
    assert {p.key for p in caught.value.problems} == {
        "tape", "world", "max_p_false", "max_p_tape", "unregistered_share", "kappa",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("max_p_false", 1e-6),
        ("max_p_tape", 1e-6),
        ("world", "closed"),
        ("unregistered_share", 0.1),
        ("kappa", 100.0),
        ("fixed_scale", True),
        ("refine", "dots"),
        ("refine", "pixels"),
    ],
)
def test_a_setting_that_has_no_effect_with_the_paper_s_method_is_refused(key: str, value: Any) -> None:
    settings: dict[str, Any] = {key: value}
    said = "method 'paper' needs tapes, bounds nothing and takes its scale as it is; leave it out, or give method='ml'"
    with pytest.raises(SpecError) as caught:
        Localizer([TAPE], method="paper", **settings)
    assert [(p.key, p.message) for p in caught.value.problems] == [(key, f"{key} = {value!r}: {said}")]
    assert [p.key for p in setting_problems({"method": "paper", **settings}, code="microdots-4x4")] == ["code", key]
    assert not setting_problems({"method": "paper", **given_settings(USUAL)})


@pytest.mark.parametrize(("key", "value"), [("world", "open"), ("max_p_tape", 0.1), ("refine", "dots")])
def test_a_setting_of_tapes_has_no_effect_on_a_code_alone(key: str, value: Any) -> None:
    (problem,) = setting_problems({key: value}, code="microdots-4x4")
    assert problem.message == (
        f"{key} = {value!r}: without tapes every place of the code may be touched, with one bound; leave it out, or give the kits"
    )
    assert not setting_problems({key: value})


def test_unregistered_tapes_have_no_share_in_a_closed_world() -> None:
    with pytest.raises(SpecError, match=r"^unregistered_share = 0\.1: in a closed world .*; leave it out, or give world='open'$"):
        Localizer([TAPE], world="closed", unregistered_share=0.1)


def test_tapes_of_two_sizes_need_two_localizers() -> None:
    other = examine(TapeSpec(sector=8, pitch_mm=1.8, displacement_mm=0.3)).layout.tape
    with pytest.raises(SpecError, match="differ in pitch or displacement"):
        Localizer([TAPE, other])


def test_angles_are_those_of_atan2() -> None:
    """The helper above against the contract once more: a part to the right is seen turned clockwise, at atan2(v, u) = theta."""
    du, dv = (seen(np.array([[21.0, 12.0]]), (20.0, 12.0), 25.0) - CENTRE)[0]
    assert degrees(atan2(dv, du)) == pytest.approx(25.0)
