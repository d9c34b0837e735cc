"""The weights of the two laws of a tilted contact, and how far tops of other parts than 0201 are drawn."""

from __future__ import annotations

from math import inf, nan

import numpy as np
import pytest

from tactape_fab import Localizer, TapeSpec, examine
from tactape_fab.sense import ElasticContact, Scene, iterate_frames
from tactape_fab.sense.decode.contact.tilted import AS_DRAWN, _share_not_drawn
from tests.contacts import TAPE


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
