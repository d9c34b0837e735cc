"""The tracker: what it says of a contact that comes, moves, is lost, jumps and ends; the fix itself is the localizer's."""

from __future__ import annotations

import warnings
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from tactape_fab import Localization, Localizer, Motion, Prior, Track, Tracker
from tactape_fab.base.errors import FrameError, SpecError
from tactape_fab.sense import load_sensor
from tactape_fab.sense.track.tracker import _NOTHING, TOUCHES, followed
from tests.bench import tracking
from tests.contacts import TAPE, dots, tape_of, texture_of

STEP_S = 0.04
SENSOR = load_sensor("gelsight-mini")


def follow(tracker: Tracker, frames: list[np.ndarray], start_s: float = 0.0) -> list[Track]:
    return [tracker.update_dots(xy, timestamp=start_s + k * STEP_S) for k, xy in enumerate(frames)]


def kinds(tracks: list[Track]) -> list[tuple[int, str]]:
    return [(k, event.kind) for k, track in enumerate(tracks) for event in track.events]


def at(x: float, y: float, theta_deg: float = 37.0, semi_mm: float = 5.0) -> np.ndarray:
    return dots((x, y), theta_deg, (semi_mm, semi_mm))


NOTHING = np.empty((0, 2))


def test_a_contact_begins_moves_and_ends(localizer: Localizer) -> None:
    frames = [NOTHING, *[at(30, 20)] * 4, *[at(30 + 0.5 * k, 20) for k in range(1, 8)], *[NOTHING] * 4]
    tracks = follow(Tracker(localizer), frames)
    assert kinds(tracks) == [(1, "begin"), (5, "slip"), (12, "lost"), (14, "end")]
    (end,) = tracks[14].events
    assert end.timestamp == pytest.approx(11 * STEP_S)  # when the tape was touched last
    assert [track.contact for track in tracks] == [False] + [True] * 13 + [False] * 2
    moving = tracks[10]
    assert moving.velocity_mm_s == pytest.approx((0.5 / STEP_S, 0.0), abs=0.1)
    assert moving.slip is not None
    assert moving.slip.total_mm == pytest.approx((3.0, 0.0), abs=0.01)
    assert moving.prediction is not None
    assert moving.prediction.position_mm == pytest.approx((33.0, 20.0), abs=0.05)
    assert all(track.velocity_mm_s is None and track.slip is None for track in tracks if not track.fix.located)


def test_the_fix_is_the_localizer_s_own(localizer: Localizer) -> None:
    frames = [at(30, 20), at(30.2, 20), at(30.4, 20, semi_mm=2.0), NOTHING, at(30.6, 20)]
    for track, xy in zip(follow(Tracker(localizer), frames), frames, strict=True):
        own = localizer.locate_dots(xy, prior=track.prediction, timestamp=track.timestamp).to_mapping(0)
        said = track.fix.to_mapping(0)
        assert {**own, "elapsed_ms": 0.0} == {**said, "elapsed_ms": 0.0}
        assert track.lost == (track.contact and not track.fix.located)


def test_a_place_is_lost_and_regained_within_a_contact(localizer: Localizer) -> None:
    few = at(30, 20, semi_mm=2.6)
    tracks = follow(Tracker(localizer), [*[at(30, 20)] * 3, few, few, at(30, 20)])
    assert not tracks[3].fix.located and tracks[3].fix.p_tape is not None and tracks[3].fix.p_tape <= 0.5
    assert kinds(tracks) == [(0, "begin"), (3, "lost"), (5, "regained")]
    assert [track.lost for track in tracks] == [False] * 3 + [True] * 2 + [False]
    assert all(track.fix.position_mm is None for track in tracks[3:5])


def test_a_jump_is_said_and_located_there(localizer: Localizer) -> None:
    tracks = follow(Tracker(localizer), [*[at(30, 20)] * 3, *[at(60, 30, -120.0)] * 3])
    assert kinds(tracks) == [(0, "begin"), (3, "jump")]
    assert tracks[3].fix.position_mm == pytest.approx((60, 30), abs=0.05)
    assert tracks[3].velocity_mm_s is None
    slip = tracks[5].slip
    assert slip is not None and not slip.detected and slip.total_mm == pytest.approx((0, 0), abs=0.02)


def test_another_tape_is_a_jump_and_an_unknown_one_no_fix(localizer: Localizer) -> None:
    other = tape_of(30)
    there = dots((30, 20), 37.0, (5.0, 5.0), texture_of(other))
    both = follow(Tracker(Localizer([TAPE, other])), [*[at(30, 20)] * 2, there])
    assert kinds(both)[-1] == (2, "jump") and both[2].fix.tape == other.name
    unknown = follow(Tracker(localizer), [*[at(30, 20)] * 2, *[there] * 4])
    assert not any(track.fix.located for track in unknown[2:])
    assert [kind for _, kind in kinds(unknown)][:2] == ["begin", "lost"]


def test_a_tape_of_the_same_name_is_another_tape() -> None:
    other = replace(tape_of(30), name=TAPE.name)
    there = dots((30, 20), 37.0, (5.0, 5.0), texture_of(other))
    tracks = follow(Tracker(Localizer([TAPE, other])), [*[at(30, 20)] * 2, *[there] * 2])
    assert tracks[2].fix.sector == 30 and kinds(tracks) == [(0, "begin"), (2, "jump")]


def test_a_velocity_is_that_of_recent_fixes_however_fast_or_not_said(localizer: Localizer) -> None:
    fast = follow(Tracker(localizer), [at(30 + 3 * k, 20) for k in range(3)])  # faster than Motion expects
    assert fast[2].velocity_mm_s == pytest.approx((3 / STEP_S, 0.0), abs=1.0)
    tracker = Tracker(localizer)
    slow = [tracker.update_dots(at(30 + k, 20), timestamp=float(k)) for k in range(3)]
    assert all(track.fix.located and track.velocity_mm_s is None and track.turn_deg_s is None for track in slow)


def test_what_was_known_lapses(localizer: Localizer) -> None:
    motion = Motion(radius_mm=1.0, speed_mm_s=10.0, reach_mm=4.05)
    tracker = Tracker(localizer, motion)
    tracker.update_dots(at(30, 20), timestamp=0.0)
    radii = []
    for time in (0.1, 0.2, 0.3, 0.31, 1.0):
        track = tracker.update_dots(NOTHING, timestamp=time)
        radii.append(None if track.prediction is None else track.prediction.radius_mm)
    assert radii == [pytest.approx(2.0), pytest.approx(3.0), pytest.approx(4.0), None, None]


def test_a_touch_down_is_a_new_contact_without_the_old_velocity(localizer: Localizer) -> None:
    sliding = [at(30 + 0.5 * k, 20) for k in range(4)]
    tracks = follow(Tracker(localizer), [*sliding, *[NOTHING] * 3, at(33, 20), at(33, 20)])
    assert kinds(tracks) == [(0, "begin"), (1, "slip"), (4, "lost"), (6, "end"), (7, "begin")]
    assert tracks[7].prediction is not None and tracks[7].prediction.position_mm == pytest.approx((31.5, 20), abs=0.02)
    assert tracks[8].velocity_mm_s == pytest.approx((0.0, 0.0), abs=0.3)


def test_a_contact_that_ended_in_a_slide_hides_no_slip_of_the_next(localizer: Localizer) -> None:
    sliding, next_one = [at(30 + 0.5 * k, 20) for k in range(4)], [at(60, 30), at(60.5, 30)]
    tracks = follow(Tracker(localizer), [*sliding, *[NOTHING] * 4, *next_one])
    assert kinds(tracks)[-3:] == [(6, "end"), (8, "begin"), (9, "slip")]
    jumped = follow(Tracker(localizer), [*sliding, *next_one])
    assert kinds(jumped)[-2:] == [(4, "jump"), (5, "slip")]


def test_a_fix_that_its_owner_changes_hides_no_slip(localizer: Localizer) -> None:
    tracker = Tracker(localizer)
    for k, x in enumerate((20.0, 20.0, 20.0, 31.0)):  # no part is in the last and the others: the slip is that of the poses
        track = tracker.update_dots(at(x, 20.0), timestamp=0.2 * k)
        assert track.fix.covariance is not None
        track.fix.covariance[:] *= 1e9
    assert track.slip is not None
    assert track.slip.detected
    assert track.slip.dots == 0


def test_times_run_forward_and_a_refused_frame_changes_nothing(localizer: Localizer) -> None:
    tracker = Tracker(localizer)
    tracker.update_dots(at(30, 20), timestamp=5.0)
    for time in (5.0, 4.9, float("nan"), "now", None):
        with pytest.raises(FrameError, match="timestamp"):
            tracker.update_dots(at(30, 20), timestamp=time)  # type: ignore[arg-type]
    with pytest.raises(FrameError, match="shape"):
        tracker.update(np.zeros((3, 3)), 5.1)
    assert tracker.update_dots(at(30, 20), timestamp=5.04).events == ()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert tracker.update_dots(at(30, 20), timestamp=np.float32(6.0)).contact  # type: ignore[arg-type]
        track = tracker.update_dots(at(30, 20), timestamp=Fraction(25, 4))  # type: ignore[arg-type]
    assert track.velocity_mm_s is not None and type(track.timestamp) is type(track.fix.timestamp) is float
    tracker.reset()
    assert [event.kind for event in tracker.update_dots(at(30, 20), timestamp=1.0).events] == ["begin"]


def test_localizers_without_a_prior_are_refused() -> None:
    with pytest.raises(SpecError, match="takes no prior"):
        Tracker(Localizer([TAPE], method="paper"))


# Simulated sequences


def test_a_tracker_locates_at_least_what_frames_alone_do_and_nothing_falsely() -> None:
    gained = 0
    for name in ("slide after a firm press", "lift-off"):
        row = tracking.measure(name, 6.0, 3)
        for world in ("open", "closed"):
            assert row[world]["tracked"]["right"] >= row[world]["single"]["right"]
            assert row[world]["tracked"]["false"] == 0
            gained += row[world]["tracked"]["right"] - row[world]["single"]["right"]
    assert gained > 10


def test_a_wrong_prediction_costs_one_bit_and_never_a_false_fix(localizer: Localizer) -> None:
    wrong = Prior(position_mm=(70.0, 40.0), theta_deg=-100.0)
    alone, told = localizer.locate_dots(at(30, 20)), localizer.locate_dots(at(30, 20), prior=wrong)
    assert alone.p_tape is not None and told.p_tape == pytest.approx(2 * alone.p_tape)
    row = tracking.measure("hop by whole pitches", 6.0, 2)
    assert row["open"]["tracked"]["false"] == row["closed"]["tracked"]["false"] == 0
    assert row["open"]["events"]["jump"] >= 3


def test_a_tape_that_nobody_registered_is_never_located() -> None:
    for name in tracking.STRANGE[:2]:
        row = tracking.measure(name, 8.0, 2)
        assert row["open"]["tracked"]["right"] == row["counted"] and row["open"]["tracked"]["false"] == 0
        assert row["open"]["events"]["end"] >= 2


def test_places_that_look_alike_show_nearly_the_same_dots_and_are_told_apart() -> None:
    first, second = tracking.look_alikes()[-1]  # of 6x6 windows
    shown = [dots((x, y), theta, (4.0, 4.0)) for x, y, theta in (first, second)]
    near = np.hypot(*(shown[0][:, None] - shown[1]).transpose(2, 0, 1)).min(axis=1) < 1.0
    assert near.mean() > 0.6  # dots of unrelated places agree by a quarter
    row = tracking.measure("to the place that looks most alike", 7.0, 2)
    assert row["open"]["tracked"]["false"] == row["closed"]["tracked"]["false"] == 0
    assert row["open"]["tracked"]["right"] > row["counted"] / 2


def test_a_step_is_told_and_rest_is_not() -> None:
    found = tracking.slips(0.2, 0.0, 8.0, 4)
    assert (found["at_once"], found["false"]) == (4, 0)


def test_noise_is_no_contact() -> None:
    tracker = Tracker(tracking.localizer())
    away = tracking.rest(np.random.default_rng(1), tracking.AWAY)
    tracks = [tracker.update(frame.depth, k) for k, (frame, _) in enumerate(tracking.frames_of(away, 1))]
    assert not any(track.contact or track.events for track in tracks)
    assert any(track.fix.status == "solid" for track in tracks)  # bumps of noise are dots, too


def test_a_trace_of_a_tape_is_a_contact() -> None:
    fix = Localization(status="weak", located=False, p_tape=TOUCHES / 2)
    state, track = followed(_NOTHING, fix, None, 0.0, Motion(), SENSOR)
    assert [event.kind for event in track.events] == ["begin"] and track.lost and track.contact
    faint = replace(fix, p_tape=2 * TOUCHES)
    assert followed(_NOTHING, faint, None, 0.0, Motion(), SENSOR)[1].contact is False
    assert followed(state, faint, None, 1.0, Motion(), SENSOR)[1].contact is True
