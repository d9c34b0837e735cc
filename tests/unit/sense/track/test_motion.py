"""Motion of a contact: worked examples of velocity, prediction and slip, and the limits of what may be asked for."""

from __future__ import annotations

from dataclasses import fields, replace
from math import nextafter, radians
from typing import Any

import numpy as np
import pytest

from tactape_fab import Localizer, Motion
from tactape_fab.base.errors import SpecError
from tactape_fab.sense.track.change import Change
from tactape_fab.sense.track.motion import Pose, mean_pose, pose_of, predicted, slip_of, velocity_of, within
from tests.contacts import TAPE, dots


def pose(time: float, x: float, y: float, theta_deg: float, sigma_mm: float = 0.01, sigma_deg: float = 0.1) -> Pose:
    covariance = np.diag([sigma_mm**2, sigma_mm**2, radians(sigma_deg) ** 2])
    return Pose(timestamp=time, tape="a", at=np.array([x, y, radians(theta_deg)]), covariance=covariance)


def changed(shift_mm: float, shear: float = 0.0, sigma: float = 0.001) -> Change:
    return Change(
        shift=np.array([shift_mm, 0.0, 0.0]),
        covariance=sigma**2 * np.eye(3),
        strain=np.array([0.0, 0.0, shear]),
        strain_covariance=sigma**2 * np.eye(3),
        dots=20,
    )


def test_values_out_of_range_are_named_together() -> None:
    with pytest.raises(SpecError, match=r"(?s)radius_mm = -1.*patience = 0"):
        Motion(radius_mm=-1.0, patience=0)
    with pytest.raises(SpecError, match=r"(?s)floor_strain = -1.*shear_mm = 0"):
        Motion(floor_strain=-1.0, shear_mm=0.0)


def test_a_fix_without_a_place_has_no_pose(localizer: Localizer) -> None:
    fix = localizer.locate_dots(dots((30.0, 20.0), 37.0, (5.0, 5.0)))
    found = pose_of(fix, 2.0)
    assert found is not None and found.at == pytest.approx([30.0, 20.0, radians(37.0)], abs=0.05)
    assert (found.timestamp, found.tape, found.which) == (2.0, TAPE.name, (TAPE.sector, TAPE.origin))
    unknown: list[dict[str, Any]] = [{name: None} for name in ("position_mm", "theta_deg", "tape", "covariance")]
    assert [pose_of(replace(fix, **what), 2.0) for what in ({"located": False}, *unknown)] == [None] * 5


def test_turns_are_followed_across_half_a_turn() -> None:
    line = [pose(0.1 * k, 0.0, 0.0, angle) for k, angle in enumerate((170.0, 176.0, -178.0, -172.0))]
    velocity = velocity_of(line)
    assert velocity is not None and np.degrees(velocity[2]) == pytest.approx(60.0)
    prior = predicted(line, velocity, 0.4, Motion(reach_mm=50.0))
    assert prior is not None and prior.theta_deg == pytest.approx(-166.0)
    assert within(pose(0.4, 0.0, 0.0, -166.0), prior)
    assert not within(pose(0.4, 0.0, 0.0, 80.0), prior)
    assert mean_pose([pose(0, 0, 0, 179.0), pose(1, 0, 0, -179.0)]).at[2] == pytest.approx(np.pi)


def test_no_prediction_moves_faster_than_the_motion_and_a_velocity_is_what_the_fixes_say() -> None:
    for back in (1.0, -1.0):
        line = [pose(0.0, 0.0, 0.0, 0.0), pose(0.01, 3.0, 4.0, 90.0 * back)]
        velocity = velocity_of(line)
        assert velocity is not None and velocity.tolist() == pytest.approx([300.0, 400.0, radians(9000.0 * back)])
        prior = predicted(line, velocity, 0.11, Motion(speed_mm_s=50.0, turn_deg_s=100.0))
        assert prior is not None and prior.position_mm == pytest.approx((6.0, 8.0))
        assert prior.theta_deg == pytest.approx(100.0 * back)


def test_fixes_that_are_old_or_of_one_time_say_nothing_of_a_velocity() -> None:
    for gap_s in (1e-200, 1e-160, 1e-12, 0.6, 40.0):
        assert velocity_of([pose(0.0, 0, 0, 0), pose(gap_s, 3.0, 4.0, 90.0)]) is None


def test_slip_is_measured_in_the_errors_of_both_poses() -> None:
    motion = Motion(floor_mm=0.0, floor_deg=0.0)
    # by hand: 0.1 mm off, 0.01 mm each: 0.1 / (0.01 * sqrt 2) = 7.07; with 0.04 mm each 1.77
    assert slip_of(pose(1, 0.1, 0, 0), pose(0, 0, 0, 0), pose(0, 0, 0, 0), motion).sigmas == pytest.approx(7.071, abs=1e-3)
    wide = slip_of(pose(1, 0.1, 0, 0, 0.04), pose(0, 0, 0, 0, 0.04), pose(0, 0, 0, 0), motion)
    assert wide.sigmas == pytest.approx(1.768, abs=1e-3) and not wide.detected
    turned = slip_of(pose(1, 0, 0, 2.0), pose(0, 0, 0, 0), pose(0, 0, 0, 1.0), motion)
    assert turned.detected and [turned.turn_deg, turned.total_deg] == pytest.approx([2.0, 1.0])
    assert (turned.cause, turned.strain, turned.strain_sigma, turned.dots) == (None, None, None, 0)


def test_the_change_of_common_dots_replaces_that_of_the_poses() -> None:
    motion = Motion(floor_mm=0.0, floor_deg=0.0)
    wide = [pose(time, x, 0.0, 0.0, 0.04) for time, x in ((1.0, 0.1), (0.0, 0.0))]
    slip = slip_of(wide[0], wide[1], wide[1], motion, changed(0.09))
    assert slip.detected and slip.sigmas == pytest.approx(90.0) and slip.shift_mm == (0.09, 0.0) and slip.dots == 20
    assert slip.total_mm == pytest.approx((0.1, 0.0))  # of the poses


def test_what_moved_is_told_where_it_can_be() -> None:
    still, motion = pose(0.0, 0.0, 0.0, 0.0), Motion(floor_strain=0.0)
    known = replace(motion, shear_mm=0.5)
    assert slip_of(still, still, still, known, changed(0.001)).cause is None  # nothing changed
    # an even shift within what the gel may be sheared by: it may stick or slide
    assert [slip_of(still, still, still, m, changed(0.4)).cause for m in (motion, known)] == [None, None]
    assert [slip_of(still, still, still, m, changed(0.6)).cause for m in (motion, known)] == [None, "slip"]
    bent = slip_of(still, still, still, known, changed(0.4, shear=0.02))
    assert bent.cause == "shear" and bent.strain == (0.0, 0.02) and bent.strain_sigma == pytest.approx((0.001, 0.001))
    assert slip_of(still, still, still, Motion(), changed(0.0, shear=0.01)).cause is None  # below 6 times its floor


@pytest.mark.parametrize("name", [field.name for field in fields(Motion)])
def test_a_motion_that_cannot_be_is_refused(name: str) -> None:
    with pytest.raises(SpecError, match=rf"^{name} = -1"):
        Motion(**{name: -1})


@pytest.mark.parametrize(
    ("names", "least", "most"),
    [
        (("radius_mm", "reach_mm"), 5e-324, 50.0),
        (("angle_deg",), 5e-324, 360.0),
        (("speed_mm_s", "turn_deg_s"), 0.0, 1e5),
        (("slip_sigmas",), 1.0, 1000.0),
        (("floor_mm",), 0.0, 10.0),
        (("floor_deg",), 0.0, 90.0),
        (("floor_strain",), 0.0, 1.0),
        (("shear_mm",), 5e-324, 100.0),
    ],
)
def test_limits_of_a_motion_belong_to_it(names: tuple[str, ...], least: Any, most: Any) -> None:
    for name in names:
        for value, beyond in ((least, nextafter(least, -1.0)), (most, nextafter(most, np.inf))):
            assert getattr(Motion(**{name: value}), name) == value
            with pytest.raises(SpecError, match=f"^{name} = "):
                Motion(**dict[str, Any]({name: beyond}))


def test_the_patience_is_a_number_of_frames() -> None:
    assert [Motion(patience=frames).patience for frames in (1, 10_000)] == [1, 10_000]
    for frames in (0, 10_001, 2.5):
        with pytest.raises(SpecError, match=r"^patience = "):
            Motion(patience=frames)  # type: ignore[arg-type]


def test_a_velocity_is_the_line_through_the_fixes_of_the_last_half_second() -> None:
    times_s, x_mm = np.array([0.0, 0.125, 0.25, 0.5]), np.array([0.0, 1.0, 1.5, 4.0])
    for shift_s in (0.0, 7.0):
        line = [pose(shift_s + t, x, -2 * x, 0.0) for t, x in zip(times_s, x_mm, strict=True)]
        slope = float(np.polyfit(times_s, x_mm, 1)[0])
        for known in (line, [pose(shift_s - 0.001, 100.0, 100.0, 0.0), *line]):
            velocity = velocity_of(known)
            assert velocity is not None and velocity.tolist() == pytest.approx([slope, -2 * slope, 0.0])
    assert predicted([], None, 0.0, Motion()) is None


def test_a_prediction_grows_with_the_gap_up_to_its_reach() -> None:
    line, motion = (
        [pose(0.0, 1.0, 2.0, 170.0)],
        Motion(radius_mm=1.0, speed_mm_s=10.0, angle_deg=5.0, turn_deg_s=100.0, reach_mm=3.5),
    )
    prior = predicted(line, np.array([4.0, -8.0, radians(80.0)]), 0.25, motion)
    assert prior is not None and prior.position_mm == (2.0, 0.0) and prior.theta_deg == pytest.approx(-170.0)
    assert (prior.radius_mm, prior.angle_deg, prior.tape) == (3.5, 30.0, "a")
    assert predicted(line, np.zeros(3), 0.2501, motion) is None
    wide = predicted(line, np.zeros(3), 0.25, replace(motion, turn_deg_s=1e4))
    assert wide is not None and wide.angle_deg == 360.0  # a prior takes no more


@pytest.mark.parametrize(
    ("x", "y", "theta_deg", "tape", "inside"),
    [
        (3.0, 4.0, 0.0, "a", True),
        (0.0, -5.0, 30.0, "a", True),
        (3.0, 4.1, 0.0, "a", False),
        (0.0, 0.0, -30.1, "a", False),
        (0.0, 0.0, 30.1, "a", False),
        (0.0, 0.0, 0.0, "b", False),
    ],
)
def test_what_lies_at_the_edge_of_a_region_is_within(x: float, y: float, theta_deg: float, tape: str, inside: bool) -> None:
    motion = Motion(radius_mm=5.0, angle_deg=30.0)
    prior = predicted([pose(0.0, 0.0, 0.0, 0.0)], np.zeros(3), 0.0, motion)
    assert prior is not None
    assert within(replace(pose(0.0, x, y, theta_deg), tape=tape), prior) == inside
    assert within(pose(0.0, x, y, theta_deg), replace(prior, tape=None)) == (inside or tape == "b")


def test_a_mean_pose_has_the_mean_s_error_and_the_first_s_time() -> None:
    mean = mean_pose([pose(1.0, 0.0, 3.0, 10.0, 0.03), pose(2.0, 2.0, 3.0, 20.0, 0.04), pose(3.0, 4.0, 0.0, 60.0, 0.12)])
    assert (mean.timestamp, mean.tape) == (1.0, "a") and mean.at.tolist() == pytest.approx([2.0, 2.0, radians(30.0)])
    assert np.sqrt(mean.covariance[0, 0]) == pytest.approx(0.13 / 3)  # hypot(0.03, 0.04, 0.12) over their number


def test_floors_are_errors_that_no_covariance_holds() -> None:
    still, motion = pose(0.0, 0.0, 0.0, 0.0, 1e-9, 1e-9), Motion(floor_mm=0.03, floor_deg=0.5)
    moved = [
        slip_of(pose(1.0, *off, 1e-9, 1e-9), still, still, motion) for off in ((0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 2.0))
    ]
    assert [slip.sigmas for slip in moved] == pytest.approx([10.0, 10.0, 4.0])
    assert [slip.detected for slip in moved] == [True, True, False]
    # poses without any error are told apart from a nanometre on
    sure = [pose(0.0, x, 0.0, 0.0, 0.0, 0.0) for x in (0.0, 3e-9)]
    bare = replace(motion, floor_mm=0.0, floor_deg=0.0)
    assert [slip_of(there, sure[0], sure[0], bare).sigmas for there in sure] == pytest.approx([0.0, 3.0])
    # a gel follows a shift of as much as its shear, whichever way
    aside = replace(changed(0.0), shift=np.array([0.3, 0.4, 0.0]))
    for shear_mm, cause in ((0.5, None), (0.499, "slip")):
        slip = slip_of(still, still, still, Motion(shear_mm=shear_mm), aside)
        assert slip.detected and slip.cause == cause
    strained = slip_of(still, still, still, Motion(floor_strain=0.003), changed(0.0, shear=0.0, sigma=0.004))
    assert strained.strain_sigma == pytest.approx((0.005, 0.005))
