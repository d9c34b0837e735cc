"""Tilted contacts: the weights of two laws, how far tops of other parts are drawn, and sensors without millimetres or a crown."""

from __future__ import annotations

from dataclasses import replace
from math import cos, inf, nan, pi, radians, sin, tan
from typing import Any

import numpy as np
import pytest

from tactape_fab import Localizer, TapeSpec, examine
from tactape_fab.sense import ElasticContact, Scene, iterate_frames, load_sensor
from tactape_fab.sense.decode.contact import tilted
from tactape_fab.sense.decode.contact.bent import Bend
from tactape_fab.sense.decode.contact.surface import LEAST_SLOPE, TOP_SHARE, ContactView, Lie, contact_view
from tactape_fab.sense.decode.contact.tilted import (
    AS_DRAWN,
    AT_BORDER,
    DRAWN_ERROR,
    DRAWN_SIGMA,
    FLOOR,
    LEAN_MM,
    UNSTRETCHED_MM,
    USUAL_PART_MM,
    WHOLLY,
    _drawn_by_slope_mm2,
    _drawn_mm,
    _laid,
    _relative_slopes,
    _share_not_drawn,
    _upright,
    tilted_pose,
)
from tactape_fab.sense.decode.grid.beliefs import beliefs_of
from tactape_fab.sense.decode.grid.long_parts import Drawn
from tactape_fab.sense.decode.grid.pose import Pose, fit_pose
from tactape_fab.sense.decode.rank import View
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart
from tests.contacts import CENTRE, TAPE, R, nees, pose_error


@pytest.mark.parametrize(
    ("drawn_mm", "undrawn_mm", "dots", "share"),
    [
        (0.01, 0.01, 12.0, 1.0 / (1.0 + AS_DRAWN)),
        (0.02, 0.01, 2.0, 1.0 / (1.0 + AS_DRAWN / 4.0)),
        (0.01, 1.0, 1000.0, 0.0),
        (1.0, 0.01, 1000.0, 1.0),
        (1e-300, 1e300, 1e6, 0.0),
        (1e300, 1e-300, 1e6, 1.0),
    ],
)
def test_the_law_that_fits_better_counts_more(drawn_mm: float, undrawn_mm: float, dots: float, share: float) -> None:
    assert _share_not_drawn(drawn_mm, undrawn_mm, dots) == pytest.approx(share, abs=1e-12)


@pytest.mark.parametrize("bad", [0.0, inf, nan])
def test_a_law_that_leaves_no_error_to_compare_by_is_taken_as_drawn(bad: float) -> None:
    assert _share_not_drawn(bad, 0.01, 12.0) == 0.0
    assert _share_not_drawn(0.01, bad, 12.0) == 0.0


@pytest.mark.parametrize(
    ("part", "body_mm", "pitch_mm", "most_um"),
    [("block", (1.0, 0.3, 0.2), 1.8, 10.0), ("block", (0.6, 0.6, 0.23), 1.6, 13.0), ("dome", (0.6, 0.6, 0.23), 1.5, 2.5)],
)  # of the last two 14 and 6 um where tops are drawn by the square of the side
def test_a_tilted_contact_on_other_parts_is_as_exact_as_said(
    part: str, body_mm: tuple[float, float, float], pitch_mm: float, most_um: float
) -> None:
    tape = examine(TapeSpec(sector=3, size_mm=(40, 30), part=part, body_mm=body_mm, pitch_mm=pitch_mm)).tape
    localizer = Localizer(tape, world="closed")
    off, nees = [], []
    for frame in iterate_frames(tape, 12, 4, scene=Scene(elastic=ElasticContact(force_n=2.0, tilt_deg=(2.0, -1.0)))):
        fix = localizer.locate(frame.depth)
        assert fix.position_mm is not None and fix.covariance is not None
        off.append(np.subtract(fix.position_mm, frame.position_mm))
        nees.append(off[-1] @ np.linalg.solve(fix.covariance[:2, :2], off[-1]) / 2)
    assert 1000.0 * np.sqrt(np.mean(np.square(off)) * 2) < most_um and np.mean(nees) < 2.0


@pytest.mark.parametrize("tilt_deg", [0.6, 0.7, 0.8, 0.9, 1.0, 1.2])
def test_a_tilt_of_a_degree_is_in_position_and_covariance(tilt_deg: float) -> None:
    localizer, nees = Localizer(TAPE, world="closed"), []
    for along in ((0.0, 1.0), (1.0, -0.5), (-1.0, 0.3)):
        contact = ElasticContact(force_n=1.0, tilt_deg=(along[0] * tilt_deg, along[1] * tilt_deg))
        for frame in iterate_frames(TAPE, 5, 11, scene=Scene(elastic=contact)):
            fix = localizer.locate(frame.depth)
            assert fix.position_mm is not None and fix.covariance is not None
            off = np.subtract(fix.position_mm, frame.position_mm)
            nees.append(off @ np.linalg.solve(fix.covariance[:2, :2], off) / 2)
    assert np.mean(nees) < 1.5


@pytest.mark.parametrize(
    ("sensor", "crown_mm"),
    # squared errors were 15 and 19 times the covariance where such a tilt was not looked for, or was taken for a cylinder's
    [("digit", (189.0, 113.0)), ("gelsight-mini", (250.0, 160.0))],
)
def test_a_tilt_is_taken_off_where_the_profile_has_no_unit_or_another_crown(sensor: str, crown_mm: tuple[float, float]) -> None:
    profile = load_sensor(sensor)
    localizer, errors, squares = Localizer(TAPE, profile, world="closed", refine="dots"), [], []
    for along in ((1.0, 1.0), (-1.0, 0.7)):
        contact = ElasticContact(force_n=4.0, tilt_deg=(4.2 * along[0], 4.2 * along[1]), crown_mm=crown_mm)
        for frame in iterate_frames(TAPE, 4, 11, profile, scene=Scene(elastic=contact)):
            fix = localizer.locate(frame.depth)
            assert (fix.tilt_deg is None) == (sensor == "digit")
            errors.append(pose_error(fix, frame))
            squares.append(nees(fix, frame))
    assert np.sqrt(np.mean(np.square(errors)[:, :2])) < 0.016 and np.mean(squares) < 2.5


def test_whole_dots_give_the_unit_of_a_frame() -> None:
    view = contact_view(load_sensor("digit"))
    found = view.in_mm(np.array([1.0, 4.0, 8.0, 8.0, 8.0]), 0.23)  # lower ones are at the rim
    assert found is not None and found.unit_mm == pytest.approx(TOP_SHARE * 0.23 / 8.0)
    assert view.in_mm(np.array([0.0, 0.0, nan]), 0.23) is None
    known = contact_view(load_sensor("gelsight-mini"))
    assert known.in_mm(np.ones(9), 0.23) is known


def test_a_dome_beside_the_centre_is_no_tilt_where_the_unit_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    digit = load_sensor("digit")
    localizer = Localizer(TAPE, digit, world="closed")
    frames = list(iterate_frames(TAPE, 4, 3, digit, scene=Scene(contact_offset_mm=(1.5, -1.0))))
    fixes = [localizer.locate(frame.depth) for frame in frames]
    monkeypatch.setattr(ContactView, "in_mm", lambda *_: None)
    assert [fix.position_mm for fix in fixes] == [localizer.locate(frame.depth).position_mm for frame in frames]
    assert all(fix.located for fix in fixes)


# By hand: tops drawn by a slope of the pressure, and a film that lies flat again

CHIP = TapePart(name="r0201", shape="block", body_mm=(0.6, 0.3, 0.23), rotation_deg=45.0)
SQUARE = TapePart(name="square", shape="block", body_mm=(0.6, 0.6, 0.23), rotation_deg=0.0)
VIEW = View(
    pitch_mm=1.5,
    displacement_mm=0.25,
    part=SQUARE,
    px_per_mm=R,
    scale_tolerance=0.03,
    centre_px=CENTRE,
    beliefs=beliefs_of(load_sensor("gelsight-mini"), fixed_scale=False),
)
GRID_MM = np.stack(np.meshgrid(np.linspace(-3.0, 3.0, 5), np.linspace(-3.0, 3.0, 5)), axis=-1).reshape(-1, 2)
PLACE_MM, THETA = np.array([20.0, 12.0]), 0.8
STEEP = np.array([0.06, 0.03])


def part_of(shape: str, length_mm: float, width_mm: float) -> TapePart:
    return TapePart(name="part", shape=shape, body_mm=(length_mm, width_mm, 0.23), rotation_deg=0.0)


@pytest.mark.parametrize(
    ("part", "along_mm2", "across_mm2"),
    [
        (CHIP, 0.166, 0.0225),
        (part_of("block", 1.0, 0.5), 1.19, 0.0866),
        (SQUARE, 0.166, 0.166),
        (part_of("dome", 0.6, 0.6), 0.0324, 0.0324),
        (None, 0.0613, 0.0613),
    ],
)
def test_longer_tops_are_drawn_farther(part: TapePart | None, along_mm2: float, across_mm2: float) -> None:
    assert _drawn_by_slope_mm2(replace(VIEW, part=part)) == pytest.approx([along_mm2, across_mm2], rel=5e-3)


@pytest.mark.parametrize("theta", [0.0, 0.8, -2.5])
def test_tops_are_drawn_along_and_across_their_parts_and_no_farther_than_these_are(theta: float) -> None:
    """A part that is turned by 45 degrees on the board lies 45 degrees from the texture's x axis towards smaller y."""
    view, pose = replace(VIEW, part=CHIP), pose_of(theta)
    length, width = (np.array([cos(theta - pi / 4 + more), sin(theta - pi / 4 + more)]) for more in (0.0, pi / 2))
    for direction, slight_mm2, most_mm in ((length, 0.166, 0.078), (width, 0.0225, 0.039)):
        shifts = _drawn_mm(np.array([[0.001], [100.0], [-100.0]]) * direction, pose, view)
        expected = np.array([[0.001 * slight_mm2], [most_mm], [-most_mm]]) * direction
        assert shifts == pytest.approx(expected, rel=5e-3, abs=1e-9)
    longer = _drawn_mm(np.array([[100.0, 0.0]]), pose, replace(VIEW, part=part_of("block", 1.0, 1.0)))
    assert np.abs(longer).max() < 0.4 - 0.162 + 0.4 and np.hypot(*longer[0]) > 0.4 - 0.163
    unknown = _drawn_mm(np.array([[0.001, 0.0]]), pose, replace(VIEW, part=None))
    assert unknown[0] == pytest.approx([6.13e-5, 0.0], rel=5e-3)


AT_MM = np.random.default_rng(3).uniform((-2.0, -3.5), (4.0, 2.5), (4000, 2))
X, Y = (AT_MM - AT_MM.mean(axis=0)).T


@pytest.mark.parametrize("unit", [1.0, 1e-4, 1e5])
def test_slopes_of_the_pressure_are_those_of_a_surface_of_third_order(unit: float) -> None:
    heights = 1.0 + 0.05 * X - 0.03 * Y + 0.02 * X**2 + 0.01 * X * Y - 0.015 * Y**2
    heights += 0.003 * X**3 - 0.004 * X**2 * Y + 0.005 * X * Y**2 + 0.002 * Y**3
    u = 0.05 + 0.04 * X + 0.01 * Y + 0.009 * X**2 - 0.008 * X * Y + 0.005 * Y**2
    v = -0.03 + 0.01 * X - 0.03 * Y - 0.004 * X**2 + 0.01 * X * Y + 0.006 * Y**2
    assert heights.min() > 0.3
    expected = np.stack([u, v], axis=1) / heights[:, None]
    assert _relative_slopes(unit * heights, AT_MM) == pytest.approx(expected, abs=5e-3 * np.abs(expected).max())
    torn = heights.copy()
    torn[::10] = -1.0  # tops that are not there
    assert _relative_slopes(unit * torn, AT_MM) == pytest.approx(expected, abs=5e-3 * np.abs(expected).max())


@pytest.mark.parametrize("unit", [1.0, 1e-4])
def test_where_the_pressure_ends_slopes_are_over_a_share_of_full_dots(unit: float) -> None:
    heights = unit * (1.0 + 0.3 * X)
    whole = float(np.quantile(heights, 0.75))
    expected = unit * 0.3 / np.maximum(heights, FLOOR * whole)
    kept = heights > 0.0  # others take no part
    assert _relative_slopes(heights, AT_MM)[kept, 0] == pytest.approx(expected[kept], rel=0.01)
    assert (_relative_slopes(np.zeros(len(X)), AT_MM) == 0.0).all()


@pytest.mark.parametrize("slope", [np.array([0.5, 0.0]), np.array([0.3, -0.4])])
def test_a_tilted_tape_is_longer_than_it_looks_along_its_slope(slope: FloatArray) -> None:
    along = slope / np.hypot(*slope)
    across = np.array([-along[1], along[0]])
    upright = _upright(np.stack([2.0 * along, 2.0 * across, along - across]), np.stack([slope, 1.5 * slope]))
    longer = 1.0 / cos(np.arctan(0.75))
    assert upright[1, 0] == pytest.approx(2.0 * longer * along)
    longer = 1.0 / cos(np.arctan(0.5))
    assert upright[0] == pytest.approx(np.stack([2.0 * longer * along, 2.0 * across, longer * along - across]))


BEND = Bend(
    across=np.array([1.0, 0.0]),
    sine=0.0,
    curvature=-0.1,
    along=0.0,
    middle_mm=0.0,
    angle_sigma=0.0,
    curvature_sigma=0.0,
    along_sigma=0.0,
)


@pytest.mark.parametrize(("part", "film_mm"), [(SQUARE, 10.0 - 0.23), (None, 10.0 - USUAL_PART_MM)])
def test_a_film_round_a_cylinder_is_as_long_as_under_its_parts(part: TapePart | None, film_mm: float) -> None:
    seen = np.array([[10.0 * sin(0.3), 1.0], [10.0 * sin(-0.2), -2.0]])
    flat = _laid(R * seen, BEND, replace(VIEW, part=part))[0] / R
    assert flat == pytest.approx(np.array([[0.3 * film_mm, 1.0], [-0.2 * film_mm, -2.0]]))


# Poses of dots whose places are known


def pose_of(theta: float = THETA, sigma_mm: float = 0.02, count: int = len(GRID_MM)) -> Pose:
    return Pose(
        position_mm=PLACE_MM.copy(),
        theta_rad=theta,
        px_per_mm=R,
        covariance=np.diag([4e-6, 9e-6, 1e-6]),
        agree=np.ones(count, dtype=np.bool_),
        sigma_mm=sigma_mm,
        camera=np.zeros((2, 3)),
    )


class Mean:
    """A stand-in for the dots of a fit: a pose that moves as they do on the whole, and does not turn."""

    def changes(self, moves_mm: FloatArray) -> FloatArray:
        return np.column_stack([moves_mm.mean(axis=1), np.zeros(len(moves_mm))])


class Fits:
    """A stand-in for the fit: the position is the mean of the places, mm; what it was asked for is kept."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **said: Any) -> None:
        self.said: dict[str, Any] = said
        self.places: list[FloatArray] = []
        self.weights: list[FloatArray] = []
        self.unsure: list[FloatArray] = []
        monkeypatch.setattr(tilted, "fit_pose", self)

    def __call__(
        self,
        places: FloatArray,
        texture: FloatArray,
        weights: FloatArray,
        scale: float,
        known: object,
        *,
        unsure_px: FloatArray | None = None,
    ) -> Pose:
        self.places.append(places)
        self.weights.append(weights)
        self.unsure.append(np.zeros((0, 2)) if unsure_px is None else unsure_px)
        seen: dict[str, Any] = {"fitted": Mean(), "used": np.arange(len(places))}
        found = replace(pose_of(), position_mm=PLACE_MM + places.mean(axis=0) / scale, covariance=np.diag([1e-6, 2e-6, 3e-6]))
        return replace(found, **(seen | self.said))


def asked(
    lie: Lie,
    *,
    pose: Pose | None = None,
    at_mm: FloatArray = GRID_MM,
    seen_px: FloatArray | None = None,
    weights: FloatArray | None = None,
    heights: FloatArray | None = None,
    border_mm: FloatArray | None = None,
    view: View = VIEW,
    by_maxima: float = 1.0,
) -> tuple[Pose, FloatArray, bool]:
    """The tilted pose of dots on a grid, whole and far from the border where nothing else is said."""
    ones, offset_px = np.ones(len(at_mm)), at_mm * R
    return tilted_pose(
        pose_of() if pose is None else pose,
        lie,
        offset_px,
        offset_px if seen_px is None else seen_px,
        at_mm,
        ones if weights is None else weights,
        ones if heights is None else heights,
        9.0 * ones if border_mm is None else border_mm,
        view,
        by_maxima,
    )


def lie_of(slope: FloatArray, *, unsure: float = 0.0, bend: Bend | None = None, film: bool = True, dome: float = 0.0) -> Lie:
    return Lie(slope=slope, unsure=unsure, bend=bend, film=film, dome=dome)


HALF_WAY = np.array([(LEAST_SLOPE + WHOLLY) / 2, 0.0])


@pytest.mark.parametrize("part", [CHIP, SQUARE])
def test_a_film_whose_tilt_is_too_slight_to_be_taken_off_is_less_sure_along_it(part: TapePart) -> None:
    """0.166 mm^2 times 190 mm over 25 dots of 2.25 mm^2 is 0.561 mm for a slope of 1."""
    slope = np.array([0.011, 0.004])
    found, places, drawn = asked(lie_of(slope), view=replace(VIEW, part=part))
    c, s = cos(THETA), sin(THETA)
    moved = 0.561 * np.array([c * 0.011 + s * 0.004, -s * 0.011 + c * 0.004, 0.0])  # on the texture
    assert found.covariance - pose_of().covariance == pytest.approx(np.outer(moved, moved), rel=0.01, abs=1e-12)
    assert found.position_mm == pytest.approx(PLACE_MM) and places == pytest.approx(GRID_MM * R) and not drawn


def test_half_of_a_slight_tilt_that_is_half_taken_off_is_left_in_the_covariance(monkeypatch: pytest.MonkeyPatch) -> None:
    Fits(monkeypatch)
    found, _, _ = asked(lie_of(HALF_WAY))
    monkeypatch.setattr(tilted, "SLIGHT_MM", 0.0)
    without, _, _ = asked(lie_of(HALF_WAY))
    moved = 0.5 * 0.561 * HALF_WAY[0] * np.array([cos(THETA), -sin(THETA), 0.0])
    assert found.covariance - without.covariance == pytest.approx(np.outer(moved, moved), rel=0.01, abs=1e-12)


@pytest.mark.parametrize(("slope", "share"), [(HALF_WAY, 0.5), (np.array([0.0, WHOLLY]), 1.0), (STEEP, 1.0)])
def test_a_correction_at_the_rim_is_taken_back_as_far_as_the_contact_is_tilted(
    slope: FloatArray, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    Fits(monkeypatch)
    _, places, drawn = asked(lie_of(slope), seen_px=GRID_MM * R + (0.8, -0.4))
    assert drawn and places.mean(axis=0) == pytest.approx([share * 0.8, -share * 0.4], rel=5e-3, abs=1e-6)


@pytest.mark.parametrize(("curvature", "share"), [(-0.01, 0.0), (0.02, 0.5), (-0.03, 1.0), (-0.2, 1.0)])
def test_a_bend_counts_as_a_tilt_does(curvature: float, share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    Fits(monkeypatch)
    bend = replace(BEND, curvature=curvature, along=0.0)
    _, places, _ = asked(lie_of(np.zeros(2), bend=bend), seen_px=GRID_MM * R + (0.0, 0.8))
    assert places[:, 1].mean() == pytest.approx(share * 0.8)


@pytest.mark.parametrize(
    ("weight", "border_mm", "believed"),
    [
        (1.0, 9.0, 1.0),
        (0.9, 9.0, 0.985),  # 0.15 of what it misses is left
        (0.4, 9.0, 1.0 - 0.6 * 0.2 / 0.45),
        (0.1, 9.0, 0.1),
        (1.0, 0.64, AT_BORDER),
        (0.1, 0.64, 0.1),
        (1.0, 0.65, 1.0),
    ],
)
def test_low_dots_of_a_tilted_contact_are_believed_more_and_those_at_the_border_less(
    weight: float, border_mm: float, believed: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    fits, ones = Fits(monkeypatch), np.ones(len(GRID_MM))
    asked(lie_of(STEEP), weights=weight * ones, border_mm=border_mm * ones)
    assert fits.weights[0] == pytest.approx(believed * ones)
    if border_mm > 1.0:
        asked(lie_of(HALF_WAY), weights=weight * ones)
        assert fits.weights[-1] == pytest.approx((believed + weight) / 2 * ones)


@pytest.mark.parametrize(("curvature", "drawn_mm"), [(-0.1, 0.0013), (0.05, 0.00065), (None, 0.0)])
def test_middles_on_a_bent_tape_are_drawn_by_the_curvature(
    curvature: float | None, drawn_mm: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.13 mm^3 times a relative slope of the pressure of 0.1/mm along u, and times the curvature: towards the pressure."""
    fits = Fits(monkeypatch)
    monkeypatch.setattr(tilted, "_relative_slopes", lambda heights, at_mm: np.tile((0.1, 0.0), (len(heights), 1)))
    bend = None if curvature is None else replace(BEND, curvature=curvature, along=0.0)
    lie = lie_of(STEEP, bend=bend)
    asked(lie, by_maxima=0.0)
    monkeypatch.setattr(tilted, "EDGES_DRAWN", 0.0)
    asked(lie, by_maxima=0.0)
    assert fits.unsure[0] == pytest.approx(0.25 * np.tile((drawn_mm * R, 0.0), (len(GRID_MM), 1)))
    assert (fits.places[0] - fits.places[1])[:, 0].mean() == pytest.approx(-drawn_mm * R, rel=0.2, abs=1e-9)


def test_a_long_part_s_own_draw_is_put_back_before_that_of_the_tilt_is_taken_off(monkeypatch: pytest.MonkeyPatch) -> None:
    Fits(monkeypatch)
    shift = np.array([0.3, -0.2])
    monkeypatch.setattr(tilted, "drawn_px", lambda *_: Drawn(shift_px=np.tile(shift, (len(GRID_MM), 1)), covariance=None))
    _, places, _ = asked(lie_of(STEEP))
    assert places.mean(axis=0) == pytest.approx(shift, rel=5e-3)


@pytest.mark.parametrize(
    ("sigma_mm", "own"),
    # (25 + 3 (0.011 / sigma)^2) / 28, at least 1, less 0.36 (0.0085 / sigma)^2 of at most 0.36
    [(0.0055, 37.0 / 28.0 - 0.36), (0.02, 1.0 - 0.36 * 0.180625), (0.0085, (25.0 + 5.0242) / 28.0 - 0.36)],
)
def test_the_covariance_of_dots_is_theirs_and_what_usual_dots_leave(
    sigma_mm: float, own: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    Fits(monkeypatch, sigma_mm=sigma_mm)
    slope = np.array([0.06, 0.0])
    found, _, drawn = asked(lie_of(slope))
    lean = np.diag([(LEAN_MM * 0.06) ** 2, 0.0, 0.0])  # no slope of the pressure, and a centre in the middle
    assert drawn and found.covariance == pytest.approx(own * np.diag([1e-6, 2e-6, 3e-6]) + lean, rel=1e-4)


def test_what_the_draw_and_the_tilt_leave_unsure_is_in_the_covariance(monkeypatch: pytest.MonkeyPatch) -> None:
    fits, at_mm = Fits(monkeypatch, sigma_mm=1.0), GRID_MM + np.array([4.0, 0.0])
    bare, places, _ = asked(lie_of(np.array([0.0, 0.06])), at_mm=at_mm)
    pressed, moved, _ = asked(lie_of(np.array([0.0, 0.06])), at_mm=at_mm, heights=1.0 + 0.1 * GRID_MM[:, 0])
    shift_mm = (places - moved).mean(axis=0) / R  # towards the pressure
    assert 0.005 < shift_mm[0] < 0.05 and abs(shift_mm[1]) < 1e-5
    assert fits.unsure[-1].mean(axis=0) / R == pytest.approx(DRAWN_SIGMA * shift_mm, abs=1e-5)
    more = np.diag([(DRAWN_ERROR * shift_mm[0]) ** 2, 0.0, 0.0])
    assert pressed.covariance - bare.covariance == pytest.approx(more, rel=1e-3, abs=1e-8)
    # a slope of 0.06 that is 50 % more lengthens 4 mm by half of 0.09^2 - 0.06^2, nearly
    steep = lie_of(np.array([0.06, 0.0]), unsure=0.5)
    sure, unsure = (asked(lie, at_mm=at_mm)[0].covariance for lie in (steep._replace(unsure=0.0), steep))
    assert (unsure - sure)[0, 0] == pytest.approx((4.0 * 0.00225) ** 2, rel=0.02)


@pytest.mark.parametrize(("part", "height_mm"), [(SQUARE, UNSTRETCHED_MM), (None, USUAL_PART_MM)])
def test_a_bend_s_parameters_and_the_height_of_its_layer_are_unsure(
    part: TapePart | None, height_mm: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A point 4 mm from the line that touches, which is one of 10 mm radius, is at an arc of 10 asin(0.4)."""
    Fits(monkeypatch, sigma_mm=1.0)
    at_mm, view = np.tile([[4.0, 1.0]], (25, 1)), replace(VIEW, part=part)
    rest = 1.0 - 0.23 / 10.0
    known = asked(lie_of(np.zeros(2), bend=BEND), at_mm=at_mm, view=view)[0].covariance
    arc_mm = 10.0 * np.arcsin(0.4)
    assert known[0, 0] == pytest.approx(1e-6 + (height_mm / 10.0 * arc_mm) ** 2, rel=1e-3)
    along = asked(lie_of(np.zeros(2), bend=replace(BEND, along_sigma=0.1)), at_mm=at_mm, view=view)[0].covariance
    assert (along - known)[1, 1] == pytest.approx((np.hypot(1.0, 0.1) - 1.0) ** 2, rel=1e-6)
    turned = asked(lie_of(np.zeros(2), bend=replace(BEND, angle_sigma=1e-4)), at_mm=at_mm, view=view)[0].covariance
    # arcs from the image's centre, which turns, too: 1e-4 / cos at either end
    assert (turned - known)[0, 0] == pytest.approx((10.0 * rest * 1e-4 * (1.0 / cos(np.arcsin(0.4)) - 1.0)) ** 2, rel=0.01)


def test_tops_of_no_film_are_drawn_or_not_by_what_fits_better(monkeypatch: pytest.MonkeyPatch) -> None:
    apart = np.array([0.01, -0.02])
    Fits(monkeypatch, position_mm=PLACE_MM - apart, theta_rad=pi - 1e-4, sigma_mm=0.02)
    lie, heights = lie_of(np.array([0.06, 0.0]), film=False), np.ones(len(GRID_MM))
    before = pose_of(-pi + 1e-4)
    found, places, drawn = asked(lie, pose=before, heights=heights)
    p = 1.0 / (1.0 + AS_DRAWN)  # both fit alike
    assert not drawn and places == pytest.approx(GRID_MM * R)
    assert found.position_mm == pytest.approx(PLACE_MM - (1.0 - p) * apart)
    assert abs(found.theta_rad) == pytest.approx(pi + 1e-4 - p * 2e-4)
    both = np.array([*apart, 2e-4])
    own = 1.0 - 0.36 * 0.180625
    expected = (1.0 - p) * own * np.diag([1e-6, 2e-6, 3e-6]) + p * before.covariance + p * (1.0 - p) * np.outer(both, both)
    expected[0, 0] += (LEAN_MM * 0.06) ** 2
    assert found.covariance == pytest.approx(expected, rel=1e-6)
    worse = asked(lie, pose=pose_of(-pi + 1e-4, sigma_mm=0.03))  # without the draw
    assert worse[2] and worse[0].position_mm == pytest.approx(PLACE_MM - apart, abs=1e-5)
    film = asked(lie._replace(film=True), pose=before)
    assert film[2] and film[0].position_mm == pytest.approx(PLACE_MM - apart)


def test_an_amount_by_which_no_pose_changes_by_a_number_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here the lean of the tops; all others count."""

    class Singular(Mean):
        def changes(self, moves_mm: FloatArray) -> FloatArray:
            return np.where(np.arange(len(moves_mm))[:, None] == 1, nan, super().changes(moves_mm))

    found = []
    for dots in (Mean(), Singular()):
        Fits(monkeypatch, fitted=dots, sigma_mm=0.02)
        found.append(asked(lie_of(np.array([0.06, 0.0])))[0].covariance)
    assert found[0][0, 0] - found[1][0, 0] == pytest.approx((LEAN_MM * 0.06) ** 2)
    assert found[0][1:, 1:] == pytest.approx(found[1][1:, 1:])


def test_tops_that_fit_far_better_undrawn_are_not_drawn_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    Fits(monkeypatch, position_mm=PLACE_MM - 0.01, sigma_mm=1.0)
    found, _, drawn = asked(lie_of(np.array([0.06, 0.0]), film=False), pose=pose_of(sigma_mm=0.001))
    assert not drawn and found.position_mm == pytest.approx(PLACE_MM)
    assert found.covariance[1:, 1:] == pytest.approx(pose_of().covariance[1:, 1:])


@pytest.mark.parametrize(("film", "dome"), [(False, 0.0), (False, 0.25), (True, 0.25)])
def test_tops_with_a_bend_are_those_of_a_film_or_of_a_dome_on_a_flat_one(
    film: bool, dome: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A point 4 mm from the line that touches is at an arc of 10 asin(0.4), less what its part is higher."""
    Fits(monkeypatch, covariance=np.zeros((3, 3)), sigma_mm=0.02)
    at_mm, rest = np.tile([[4.0, 1.0]], (25, 1)), 1.0 - 0.23 / 10.0
    arc_mm, before = (
        10.0 * np.arcsin(0.4) * rest,
        replace(pose_of(), position_mm=PLACE_MM + np.array([4.0, 1.0]), covariance=np.zeros((3, 3))),
    )
    lie = lie_of(np.zeros(2), bend=BEND, film=film, dome=dome)
    pose, places, drawn = asked(lie, pose=before, at_mm=at_mm, view=replace(VIEW, part=SQUARE))
    flat = dome if film else dome / (1.0 + AS_DRAWN)  # both fit alike
    assert pose.position_mm[0] - PLACE_MM[0] == pytest.approx(4.0 * flat + arc_mm * (1.0 - flat), abs=1e-4)
    height = pose.covariance[0, 0] - flat * (1.0 - flat) * (arc_mm - 4.0) ** 2
    assert height == pytest.approx((UNSTRETCHED_MM / 10.0 * 10.0 * np.arcsin(0.4)) ** 2, rel=0.01)
    assert drawn == film and places[0, 0] / R == pytest.approx(arc_mm)


def test_a_film_that_fits_nowhere_without_the_draw_is_taken_for_flat_then(monkeypatch: pytest.MonkeyPatch) -> None:
    class Undrawn(Fits):
        def __call__(self, *args: Any, unsure_px: FloatArray | None = None) -> Pose:
            found = super().__call__(*args, unsure_px=unsure_px)
            return found if unsure_px is not None else replace(found, covariance=np.full((3, 3), inf))

    Undrawn(monkeypatch, sigma_mm=0.02)
    pose, places, drawn = asked(lie_of(np.zeros(2), bend=BEND, film=False), pose=pose_of(sigma_mm=0.02))
    assert pose.finite and not drawn and places == pytest.approx(GRID_MM * R)


@pytest.mark.parametrize("said", [{"sigma_mm": 0.0}, {"sigma_mm": inf}, {"covariance": np.full((3, 3), inf)}])
def test_a_pose_that_is_none_under_the_tilt_stays_as_it_was(said: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    Fits(monkeypatch, **said)
    before = pose_of()
    found, places, drawn = asked(lie_of(STEEP), pose=before)
    assert found is before and not drawn and places == pytest.approx(GRID_MM * R)


@pytest.mark.parametrize("tilt_deg", [(8.0, 0.0), (-4.0, 8.0)])
def test_a_tape_that_is_seen_foreshortened_is_where_its_parts_are(tilt_deg: tuple[float, float]) -> None:
    """Of a contact 4 mm off the image's centre, under a pressure that is the same everywhere."""
    rng, slope = np.random.default_rng(8), np.array([tan(radians(tilt)) for tilt in tilt_deg])
    cells = np.stack(np.meshgrid(np.arange(-3, 4), np.arange(-3, 4)), axis=-1).reshape(-1, 2)
    at_mm = 1.5 * cells + 0.25 * np.array([[0, -1], [0, 1], [-1, 0], [1, 0]])[rng.integers(0, 4, len(cells))] + (4.0, -2.0)
    along = slope / np.hypot(*slope)
    seen = R * (at_mm - np.outer((1.0 - cos(np.arctan(np.hypot(*slope)))) * at_mm @ along, along))
    c, s = cos(THETA), sin(THETA)
    texture, ones = PLACE_MM + at_mm @ np.array([[c, -s], [s, c]]), np.ones(len(seen))
    view = replace(VIEW, beliefs=replace(VIEW.beliefs, sigmas=np.zeros(4)))  # no camera that explains it as well
    before = fit_pose(seen, texture, ones, R, view.beliefs)
    found, places, drawn = tilted_pose(before, lie_of(slope), seen, seen, texture, ones, ones, 9.0 * ones, view)
    off_um, was_um = (1000.0 * np.hypot(*(p.position_mm - PLACE_MM)) for p in (found, before))
    assert drawn and off_um < 0.5 and was_um > 3.0 and found.theta_rad == pytest.approx(THETA, abs=1e-5)
    assert places == pytest.approx(R * at_mm, abs=0.01)
