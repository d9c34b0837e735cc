"""Tilted contacts: the weights of two laws, how far tops of other parts are drawn, and sensors without millimetres or a crown."""

from __future__ import annotations

from math import inf, nan

import numpy as np
import pytest

from tactape_fab import Localizer, TapeSpec, examine
from tactape_fab.sense import ElasticContact, Scene, iterate_frames, load_sensor
from tactape_fab.sense.decode.contact.surface import TOP_SHARE, ContactView, contact_view
from tactape_fab.sense.decode.contact.tilted import AS_DRAWN, _share_not_drawn
from tests.contacts import TAPE, nees, pose_error


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
    [("block", (1.0, 0.3, 0.2), 1.8, 50.0), ("block", (0.6, 0.6, 0.23), 1.6, 13.0), ("dome", (0.6, 0.6, 0.23), 1.5, 2.5)],
)  # 103, 14 and 6 um where tops are drawn by the square of the side
def test_a_tilted_contact_on_other_parts_is_as_exact_as_said(
    part: str, body_mm: tuple[float, float, float], pitch_mm: float, most_um: float
) -> None:
    tape = examine(TapeSpec(sector=3, size_mm=(40, 30), part=part, body_mm=body_mm, pitch_mm=pitch_mm)).tape
    localizer = Localizer(tape, world="closed")
    off, nees = [], []
    for frame in iterate_frames(tape, 6, 4, scene=Scene(elastic=ElasticContact(force_n=2.0, tilt_deg=(2.0, -1.0)))):
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
